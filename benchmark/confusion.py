# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The doctor against two generators of traffic, in simulated time.

    python -m benchmark.confusion            both, to the terminal
    python -m benchmark.confusion --write    both, to docs/doctor_confusion.md and doctor_scenes.md

The first is `fake_bus`: every fault against every finding; the monitor hears each burst by itself,
which is finer than most adapters tell; once more as the master's own port has it, with the sides
known. The second, `rigs/bus`, shares nothing with it. One seed:
the tables are the same on every machine, and tests hold the files to them.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
import sys
from typing import NamedTuple

from dxl_monitor.bus.conversation import Settings
from dxl_monitor.bus.expected import parse_all
from dxl_monitor.bus.report import BusReport
from dxl_monitor.bus.report import Finding
from dxl_monitor.doctor import RULES
from dxl_monitor.fake.fake_bus import make_devices
from dxl_monitor.fake.faults import parse
from dxl_monitor.fake.line import by_sides
from dxl_monitor.fake.line import Line
from dxl_monitor.fake.master import Master
from dxl_monitor.fake.traffic import PATTERNS
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from msg_defs.heard import UNKNOWN
from rigs.bus import page

DOCS = Path(__file__).parents[1] / 'docs'
S = 1_000_000_000
BAUD = 2_000_000
SEED = 1
REPORT_NS = S // 2
ONSET_S = 2.0
WITHIN_S = 5.0
ROBOT = ('1-5:MX-106', '6-8:MX-64', '100:Rhoban DXL Board')
FAST_ROBOT = ('1-5:XL430-W250', '6-8:XM540-W270')
MODELS = Models()

Key = tuple[str, int | None]       # rule, device


class Scene(NamedTuple):
    """What is on the bus beside the faults."""

    pattern: str = 'moving'
    devices: tuple[str, ...] = ROBOT
    waits_in_line: bool = True
    rate: float = 50.0
    gather: int = 0                # ns that an adapter collects bytes for; 0: each burst by itself


class Case(NamedTuple):
    """A fault, written as for fake_bus, with {at} for its time, and what must be told."""

    fault: str
    told: tuple[Key, ...]
    scene: Scene = Scene()
    about: str = ''


class Result(NamedTuple):
    """What was told at the end, and when each of it was told first (s after the fault)."""

    told: tuple[Key, ...]
    after_s: float
    findings: tuple[Finding, ...]


ANSWERS_BEHIND = Scene(waits_in_line=False)
FAST = Scene(devices=FAST_ROBOT)
CASES: tuple[Case, ...] = (
    Case('silent:3:{at}', (('sync_read_stops', 3),)),
    Case('silent:3:{at}', (('no_answer', 3),), ANSWERS_BEHIND, 'others answer behind it'),
    Case('silent:3:{at}:0.6', (('dropout', 3),), ANSWERS_BEHIND, 'for 0.6 s'),
    Case('cable:3:{at}', (('broken_cable', 3),)),
    Case('cable:1:{at}', (('all_silent', None),)),
    Case('duplicate:3:{at}', (('duplicate_id', 3),)),
    Case('baud:3:{at}', (('baud_moved', 3),)),
    Case('wrong_baud::{at}', (('wrong_baud', None),)),
    Case('impatient::{at}', (('impatient_master', None),)),
    Case('latency::{at}', (('latency_timer', None),)),
    Case('late:3:{at}', (('late_answers', 3),)),
    Case('return_delay:3:{at}', (('return_delay', 3),), Scene('read_write', rate=20.0)),
    Case('overload::{at}', (('bus_too_slow', None),)),
    Case('latched:3:{at}', (('hardware_error', 3),)),
    Case('reboot:3:{at}', (('rebooted', 3),)),
    Case('brownout::{at}', (('brown_out', None),)),
    Case('header:3:{at}', (('turnaround', 3),)),
    Case('header::{at}', (('turnaround', None),), about='all devices'),
    Case('turnaround:3:{at}', (('turnaround', 3),)),
    Case('turnaround::{at}', (('turnaround', None),), about='all devices'),
    Case('glitch::{at}', (('stray_bytes', None),)),
    Case('echo::{at}', (('echo', None),)),
    Case('two_masters::{at}', (('two_masters', None),)),
    Case('foreign:3:{at}', (('foreign_answers', 3),)),
    Case('wrong_map:3:{at}', (('wrong_address', 3),)),
    Case('eeprom:3:{at}', (('eeprom_locked', 3),)),
    Case('eeprom_wear:3:{at}', (('eeprom_wear', 3),)),
    Case('no_ack:3:{at}', (('no_acks', 3),)),
    Case('ping_only:3:{at}', (('ping_only', 3),)),
    Case('old_firmware:3:{at}', (('fast_read_unsupported', 3),), FAST),
    Case('unstuffed::{at}', (('unstuffed', None),)),
    Case('noise::{at}', (('noise', None),)),
    Case('noise:3:{at}', (('damaged_answers', 3),), about='of one device'),
    Case('flip::{at}', (('noise', None),)),
    Case('drop::{at}', (('noise', None),)),
    Case('watchdog:3:{at}', (('watchdog', 3),), FAST),
    Case('protocol1::{at}', (('protocol_1', None),)),
    Case('hot:3:{at}', (('too_hot', 3),)),
    Case('low_voltage:3:{at}', (('voltage', 3),)),
    Case('unwritten:3:0', (('never_written', 3),)),
    Case('jitter::{at}', (('jitter', None),)),
)

SIDED = tuple(case for case in CASES if case.told != (('wrong_baud', None),))
ONLY_SIDES = (
    'Only the sides tell:', '',
    '- an instruction that never left the adapter (`not_sent`): on the wire there is nothing, and '
    'its', '  answer is not missed;',
    '- an echo from an instruction that the program said twice: each is known by itself;',
    '- one instruction of another master: it came to the program that did not send it;',
    '- an answer after damage: each side is framed by itself, so damage in one direction costs '
    'the other', '  nothing, and an answer that was cut is decided before the next instruction;',
    '- what the kernel dropped: what was not heard is said, and nothing is judged by it.')


def reports(faults: list[str], scene: Scene, seconds: float,
            has_sides: bool = False) -> Iterator[BusReport]:
    """
    Yield the reports of a monitor on a simulated bus, two per second of its time.

    has_sides: it hears the master's own port, as usb: and tap: do.
    """
    line = Line(make_devices(list(scene.devices), MODELS, BAUD), BAUD,
                waits_in_line=scene.waits_in_line)
    master = Master(line, PATTERNS[scene.pattern], rate=scene.rate, seed=SEED,
                    faults=[parse(fault) for fault in faults])
    monitor = Monitor('bus', MODELS, Settings(
        baud=BAUD, devices=tuple(parse_all(list(scene.devices)))))
    report_at, end = REPORT_NS, round(seconds * S)
    heard = own_port(master, end) if has_sides else chunks(master, end, scene.gather)
    for chunk, stamp, side in heard:
        while stamp > report_at:
            yield monitor.report(report_at)
            report_at += REPORT_NS
        monitor.feed(chunk, stamp, side)
    while report_at <= end:
        yield monitor.report(report_at)
        report_at += REPORT_NS


def own_port(master: Master, end: int) -> list[tuple[bytes, int, str]]:
    """Return what the port of the master writes and reads, in order of time."""
    told = [(stamp, side, data) for burst in master.bursts(end)
            for stamp, side, data in by_sides(burst, BAUD)]
    return [(data, stamp, side) for stamp, side, data in sorted(told, key=itemgetter(0))]


def chunks(master: Master, end: int, gather: int) -> Iterator[tuple[bytes, int, str]]:
    """Yield the bursts as an adapter hands them over: each at once, or some time's together."""
    gathered, due = b'', 0
    for burst in master.bursts(end):
        if gathered and burst.end > due:
            yield gathered, due, UNKNOWN
            gathered = b''
        if burst.data and not gather:
            yield burst.data, burst.end, UNKNOWN
        elif burst.data:
            due = due if gathered else (burst.end // gather + 1) * gather
            gathered += burst.data
    if gathered:
        yield gathered, due, UNKNOWN


def told(report: BusReport) -> tuple[Key, ...]:
    """Return what a report claims, without the words."""
    return tuple((finding.rule, finding.device) for finding in report.findings)


def examine(case: Case, has_sides: bool = False) -> Result:
    """Play a fault and see what is told."""
    at = ONSET_S if '{at}' in case.fault else 0.0
    first: dict[Key, float] = {}
    findings: tuple[Finding, ...] = ()
    for report in reports([case.fault.format(at=at)], case.scene, at + WITHIN_S, has_sides):
        findings = report.findings
        for key in told(report):
            first.setdefault(key, report.stamp / S - at)
    return Result(tuple((one.rule, one.device) for one in findings),
                  max((first[key] for key in case.told if key in first), default=-1.0), findings)


def render(results: list[tuple[Case, Result]], sided: list[tuple[Case, Result]]) -> str:
    """Return the page; sided: what is told with the sides known."""
    names = [rule.name for rule in RULES]
    used = [name for name in names
            if any(name == rule for _, result in results for rule, _ in result.told)]
    numbers = {name: number for number, name in enumerate(used, 1)}
    right = sum(set(result.told) == set(case.told) for case, result in results)
    lines = [
        '# Faults against findings', '',
        'Made by `python -m benchmark.confusion --write` with `fake_bus` in simulated time; a '
        'test holds', 'this page to it. Each fault of `fake_bus` is played alone, on a robot of '
        'nine devices that walks;', f'this is what the doctor says {WITHIN_S:.0f} s later. '
        f'{right} of {len(results)} are told as the one cause they are, on the',
        'right device, and nothing else.', '',
        '| fault | told | on | after |', '|---|---|---|---|']
    for case, result in results:
        for rule, device in result.told:
            where = 'bus' if device is None else f'{device:03}'
            lines.append(f'| {_label(case)} | {rule} | {where} | {result.after_s:.1f} s |')
        if not result.told:
            lines.append(f'| {_label(case)} | nothing | | |')
    lines += ['', 'All findings across: `#` the cause, `x` a false one, `.` not told. Not in the '
              'columns because', 'no fault alone makes them told: '
              + ', '.join(name for name in names if name not in used) + '.', '', '```']
    lines += [f'{number:2} {name}' for name, number in numbers.items()]
    width = max(len(_label(case)) for case, _ in results)
    lines += ['', ' ' * width + ' '.join(f'{number:3}'[1:] for number in numbers.values())]
    lines += [_label(case).ljust(width) + ' '.join(
        _mark(name, case, result) for name in used).rstrip() for case, result in results]
    return '\n'.join([*lines, '```', '', *_sides(results, sided)]) + '\n'


def _sides(results: list[tuple[Case, Result]], sided: list[tuple[Case, Result]]) -> list[str]:
    """Return the section on the same faults, heard on the master's own port."""
    right = sum(set(result.told) == set(case.told) for case, result in sided)
    without = dict(results)
    lines = [
        '## With the sides known', '',
        "The same faults as the master's own port has them (`usb:`, `tap:`): what it wrote is "
        'whole,', 'whatever the wire made of it, and while it writes it hears nothing. '
        f'{right} of {len(sided)} are told as the',
        'one cause they are, on the right device, and nothing else. `wrong_baud` is not among '
        'them: the rate', 'comes with the source. What is told otherwise, or at another time:', '',
        '| fault | without sides | with sides |', '|---|---|---|']
    lines += [f'| {_label(case)} | {_words(without[case])} | {_words(result)} |'
              for case, result in sided if _words(result) != _words(without[case])]
    return [*lines, '', *ONLY_SIDES]


def _words(result: Result) -> str:
    rules = ', '.join(rule for rule, _ in result.told) or 'nothing'
    return f'{rules} after {result.after_s:.1f} s'


def _label(case: Case) -> str:
    name = case.fault.replace(':{at}', '').removesuffix(':0').rstrip(':')
    return f'{name} ({case.about})' if case.about else name


def _mark(name: str, case: Case, result: Result) -> str:
    if name not in [rule for rule, _ in result.told]:
        return ' .'
    return ' #' if {key for key in result.told if key[0] == name} <= set(case.told) else ' x'


def main() -> int:
    """Write the pages to where they belong, or to the terminal."""
    sided = [(case, examine(case, has_sides=True)) for case in SIDED]
    pages = {'doctor_confusion.md': render([(case, examine(case)) for case in CASES], sided),
             'doctor_scenes.md': page.render(page.results())}
    for name, text in pages.items():
        if sys.argv[1:] == ['--write']:
            (DOCS / name).write_text(text, encoding='utf-8')
        else:
            print(text)
    return 0


if __name__ == '__main__':
    sys.exit(main())
