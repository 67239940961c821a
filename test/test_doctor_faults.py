# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor against every fault of the simulated bus: named, and nothing else; two at a time."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from harness import later
import pytest
import test_doctor_edges
import test_doctor_time

from benchmark.baseline import fault_cells
from benchmark.baseline import saved_of
from benchmark.confusion import examine
from benchmark.confusion import label
from benchmark.confusion import reports
from benchmark.confusion import SIDED
from benchmark.confusion import told
from benchmark.confusion import WITHIN_S
from benchmark.confusion_cases import Case
from benchmark.confusion_cases import CASES
from benchmark.confusion_cases import DXL1
from benchmark.confusion_cases import DXL1_BULK
from benchmark.confusion_cases import DXL1_CASES
from benchmark.confusion_cases import FAST
from benchmark.confusion_cases import FAST_ROBOT
from benchmark.confusion_cases import FEETECH
from benchmark.confusion_cases import FEETECH_BEHIND
from benchmark.confusion_cases import FEETECH_CASES
from benchmark.confusion_cases import Scene
from benchmark.confusion_cases import SCENES
from mecarover_fakes.fake_bus import DEFAULT_DEVICES
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.faults import KINDS
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import FAMILY_1
from mecarover_fakes.traffic import PATTERNS
from rigs.bus.scene import keys
from rigs.tables import rows_of
from servobus.bus.decoder import Settings
from servobus.doctor import RULES
from servobus.doctor.rules import feetech
from servobus.doctor.rules import setup
from servobus.model.models import Models
from servobus.monitor import Monitor

LONG = 140                         # characters of a line that one reads at a glance
ENOUGH = 25                        # faults of each protocol
MS, S = 1_000_000, 1_000_000_000
MODELS = Models()


class Family(NamedTuple):
    """A family of cases in the baseline; sided: the monitor knows who said what."""

    name: str
    protocol: str
    cases: tuple[Case, ...]
    sided: bool = False


FAMILIES = (Family('Protocol 2.0', '2', CASES), Family('Feetech', 'feetech', FEETECH_CASES),
            Family('Protocol 1.0', '1', DXL1_CASES),
            Family('Protocol 2.0, sides known', '2', SIDED, sided=True))
PLAYED = [(family, case) for family in FAMILIES for case in family.cases]


@cache
def result_of(case, sided):
    return examine(case, sided)


def name_of(part):
    return part.name if isinstance(part, Family) else label(part)


@pytest.mark.parametrize(('family', 'case'), later(PLAYED, len(CASES)), ids=name_of)
def test_a_fault_is_named_and_nothing_else(family, case):
    result = result_of(case, family.sided)
    assert set(result.told) == set(case.told)
    assert 0 <= result.after_s <= WITHIN_S
    for finding in result.findings:
        assert 30 < len(finding.message) <= LONG, finding.message
        assert '\n' not in finding.message
        assert all(name and value for name, value in finding.evidence)


@pytest.mark.parametrize('family', later(FAMILIES, 1), ids=name_of)
def test_it_is_as_in_the_baseline(family):
    assert {label(case): fault_cells(case, result_of(case, family.sided))
            for case in family.cases} == saved_of(family.name), \
        'run: scripts/python -m benchmark.baseline --write'


@pytest.mark.parametrize('family', FAMILIES[:3], ids=name_of)
def test_every_fault_is_among_the_cases(family):
    faults = {case.fault.partition(':')[0] for case in family.cases}
    assert faults == {name for name, kind in KINDS.items() if family.protocol in kind.protocols}
    assert len(faults) >= ENOUGH


def test_every_rule_has_a_fault_or_a_case_made_by_hand():
    played = {rule for _, case in PLAYED for rule, _ in case.told}
    assert played >= {rule.name for rule in feetech.RULES + setup.RULES}
    by_hand = {rule for rule, *_ in (*test_doctor_edges.ENOUGH, *test_doctor_time.DOUBTS)}
    assert {rule.name for rule in RULES} - played - by_hand == {'cycle_time'}  # test_cycle_time.py


SLOW = {'read_write': 4.0, 'mixed': 10.0, 'bulk': 20.0, 'registered': 20.0}
HEALTHY = [
    *((Scene(name, rate=SLOW.get(name, 30.0))._replace(
        **{'devices': FAST_ROBOT} if name == 'fast' else {}), 60.0)
      for name in PATTERNS if name != 'none'),
    *((scene._replace(pattern=name, rate=20.0), 15.0) for scene in (FEETECH, FEETECH_BEHIND, DXL1)
      for name in FAMILY_1['1' if scene is DXL1 else 'feetech'] if name != 'none'),
    *((scene._replace(gather=16 * MS), 15.0) for scene in (FEETECH, DXL1, DXL1_BULK)),
    *((Scene(name, rate=SLOW.get(name, 50.0), gather=gather), 15.0)
      for gather in (2 * MS, 16 * MS)
      for name in ('moving', 'sync', 'read_write', 'mixed', 'ping', 'idle'))]


def scene_name(one):
    return f'{one.dialect} {one.pattern} {one.gather // MS} ms' if isinstance(one, Scene) \
        else f'{one:g} s'


@pytest.mark.parametrize(('scene', 'seconds'), later(HEALTHY, 1), ids=scene_name)
def test_good_traffic_is_no_finding(scene, seconds):
    """At OK there is advice, only of one broadcast Ping after the other."""
    assert {key for report in reports([], scene, seconds) for key in told(report)} \
        == ({('scan', None)} if scene.pattern == 'broadcast' else set())


# What needs no times finer than an adapter of 2 ms tells is found through it too.
BLURRED = ('silent:3', 'duplicate:3', 'baud:3', 'latched:3', 'reboot:3', 'echo', 'wrong_map:3',
           'no_ack:3', 'noise', 'hot:3', 'protocol1', 'header', 'latency')


@pytest.mark.more
@pytest.mark.parametrize('name', BLURRED)
def test_found_through_an_adapter_that_gathers_bytes(name):
    case = next(one for one in CASES if one.fault.replace(':{at}', '').rstrip(':') == name)
    assert set(examine(case._replace(scene=case.scene._replace(gather=2 * MS))).told) \
        == set(case.told)


PAIRS = rows_of(Path(__file__).with_name('fault_pairs.tsv'))


@pytest.mark.more
@pytest.mark.parametrize(('scene', 'one', 'other', 'said'), PAIRS)
def test_two_faults_at_once_are_both_named(scene, one, other, said):
    faults = [f'{fault}:2' if ':' in fault else f'{fault}::2' for fault in (one, other)]
    *_, last = reports(faults, SCENES[scene], 7.0)
    assert set(told(last)) == set(keys(said))


def test_a_fault_that_is_over_is_forgotten():
    *_, last = reports(['noise::1:2', 'wrong_map:3:1:2'], Scene(rate=20.0), 17.0)
    assert last.findings == ()


def test_a_dead_device_at_the_end_of_the_chain_is_no_broken_cable():
    *_, last = reports(['silent:100:2'], Scene(), 7.0)
    assert told(last) == (('no_answer', 100),)


def test_no_fast_reads_at_all():
    *_, last = reports(['old_firmware::2'], FAST, 7.0)
    assert {rule for rule, _ in told(last)} == {'fast_read_unsupported'}


def test_two_masters_are_named_in_chunks_as_a_pty_has_them():
    scene = Scene(devices=DEFAULT_DEVICES, rate=100.0, gather=2 * MS)
    *_, last = reports(['two_masters::2'], scene, 8)
    assert told(last) == (('two_masters', None),)


@pytest.mark.parametrize(('fault', 'scene'), [
    ('impatient::2', Scene(gather=2 * MS)), ('impatient::2', DXL1._replace(gather=2 * MS)),
    ('two_masters::2', FEETECH._replace(rate=100.0, gather=2 * MS)),
    ('two_masters::2', DXL1_BULK._replace(rate=100.0, gather=2 * MS))], ids=str)
def test_packets_that_overlap_are_no_noise_in_chunks_as_a_pty_has_them(fault, scene):
    *before, last = reports([fault], scene, 8)
    assert 'noise' not in {rule for report in (*before, last) for rule, _ in told(report)}
    assert told(last) or any(one.message.startswith('packets overlap')
                             or one.message.endswith('second program') for one in last.doubts)


def heard(monitor, *runs):
    """Return what is said of healthy runs, each (from, to) in s, reported twice a second."""
    said, now = set(), S // 2
    for begin, end in runs:
        while now < begin * S:
            said.update(one.message for one in monitor.report(now).findings)
            now += S // 2
        line = make_line(make_devices(['1-5:MX-106'], MODELS, 2_000_000), 2_000_000)
        for burst in Master(line, PATTERNS['sync'], rate=20.0).bursts(round((end - begin) * S)):
            while now < begin * S + burst.end:
                said.update(one.message for one in monitor.report(now).findings)
                now += S // 2
            monitor.feed(burst.data, round(begin * S) + burst.end)
    for _ in range(80):
        said.update(one.message for one in monitor.report(now).findings)
        now += S // 2
    return said


def test_a_short_command_on_an_idle_bus_is_no_master_that_stopped():
    assert heard(Monitor('bus', MODELS, Settings()), (60, 61.5)) == set()
    assert heard(Monitor('bus', MODELS, Settings()), (60, 61.5), (80, 81.5)) == set()


def test_a_master_that_stops_is_named_with_the_time_of_its_last_run():
    [said] = heard(Monitor('bus', MODELS, Settings()), (20, 21), (35, 39))
    assert said.startswith('the master stopped after it had asked for 4.0 s: ')
