# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the doctor says of the scenes, and how right that is.

right: the first of its findings is the expected one, in the last report; wrong: at any time there
was a WARN or ERROR that is not true of this bus; vague: neither, but something true was told;
silent: nothing was. Time counts from the first byte that the fault altered or removed.
"""

from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

from msg_defs.diagnostics import Level
from rigs.bus.scene import Key
from rigs.bus.scene import SECONDS
from rigs.bus.scenes import BROKEN
from rigs.bus.scenes import HEALTHY as WELL
from rigs.bus.wire import S
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.model.models import Models
from servobus.monitor import Monitor

RIGHT, VAGUE, SILENT, WRONG = 'right', 'vague', 'silent', 'wrong'
REPORT_NS = S // 2
SEED = 1
NOTHING, HEALTHY = 'nothing', 'healthy'
FEW = 6                            # false findings that a row shows
BOOT = 1000 * S                    # no clock that counts from start-up begins at 0
SCENES = (*BROKEN, *WELL)
_MODELS = Models()


class Result(NamedTuple):
    """What was said of a scene; after_s: when the expected was first, None if it never was."""

    expected: tuple[Key, ...]
    verdict: str
    told: tuple[Key, ...]              # at the end, the worst first
    false: tuple[tuple[float, Key], ...]   # when it was said first, what
    after_s: float | None


def reports(scene, rig, seconds=SECONDS):
    """Yield the reports, two per second, each with the seconds since the fault showed."""
    monitor = Monitor('bus', _MODELS, Settings(
        baud=scene.adapter.baud or scene.baud, devices=tuple(parse_all(list(scene.devices)))),
        idle_is_told=True)
    rig.listen(scene.adapter, lambda data, stamp: monitor.feed(data, BOOT + stamp),
               lambda now: monitor.flush_if_idle(BOOT + now))
    for number in range(1, int(seconds * S) // REPORT_NS + 1):
        rig.clock.run(number * REPORT_NS)
        since = None if rig.altered is None else (rig.clock.now - rig.altered) / S
        yield monitor.report(BOOT + rig.clock.now), since


def judge(scene, seed=SEED):
    """Run a scene and compare what is said with what is so."""
    rig = scene.rig(seed)
    return compare(scene, rig, reports(scene, rig), BOOT)


def compare(scene, rig, told_of_it, begin):
    """Return what reports say, each with the seconds since the fault showed, and what is so."""
    true = {*scene.expected, *scene.also}
    false = {}
    after = None
    told = ()
    for report, since in told_of_it:
        told = tuple((one.rule, one.device) for one in report.findings)
        for key in _accused(report, scene, true):
            false.setdefault(key, (report.stamp - begin) / S)
        if after is None and since is not None and told and told[0] in scene.expected:
            after = since
    if not scene.expected:
        false.update(_misses(report, rig))
    return Result(scene.expected, verdict_of(scene, told, bool(false)), told,
                  tuple((when, key) for key, when in false.items()), after)


def _accused(report, scene, true):
    """Return what is said at WARN or worse and is false; on a healthy bus levels count too."""
    found = [(one.rule, one.device) for one in report.findings
                        if one.level in (Level.WARN, Level.ERROR)
                        and (one.rule, one.device) not in true]
    if not scene.expected:
        found += [('level', one.id) for one in report.devices
                  if one.level in (Level.WARN, Level.ERROR)]
        if report.level in (Level.WARN, Level.ERROR):
            found.append(('level', None))
    return found


def _misses(report, rig):
    """Return who missed answers by the monitor's count, though by its own books it gave them."""
    return {(f'missed: {device.totals.missed}', device.id): SECONDS for device in report.devices
            if device.totals.missed and device.id in rig.servos
            and rig.servos[device.id].asked == rig.servos[device.id].answered}


def verdict_of(scene, told, is_wrong):
    """Return the verdict of what was told, the first of it first; is_wrong: some was false."""
    if is_wrong:
        return WRONG
    if not scene.expected:
        return RIGHT
    if told and told[0] in scene.expected:
        return RIGHT
    return VAGUE if {*told} & {*scene.expected, *scene.also} else SILENT


def cells(result):
    """Return what was expected, what was told, after how many s, and the verdict."""
    said = spell(result.told) or NOTHING
    if result.false:
        said += '; false: ' + ', '.join(f'{spell((key,))} at {when:.1f} s'
                                        for when, key in result.false[:FEW])
        said += f' and {len(result.false) - FEW} more' if len(result.false) > FEW else ''
    after = '' if result.after_s is None else f'{result.after_s:.1f}'
    return spell(result.expected) or HEALTHY, said, after, result.verdict


def spell(keys):
    """Return rules with their devices: 'no_answer 003 004, noise bus'."""
    return ', '.join(' '.join((rule, *('bus' if device is None else f'{device:03}'
                                       for _, device in some)))
                     for rule, some in groupby(keys, itemgetter(0)))
