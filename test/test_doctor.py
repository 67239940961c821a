# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor by itself: how claims stand, fall and hide others; docs/doctor.md has each."""

from collections.abc import Iterator
from pathlib import Path
import random
import re
import struct

import heard_bus
from heard_bus import MODELS
from heard_bus import MS
from heard_bus import PING
from heard_bus import PONG
from heard_bus import READ
from heard_bus import REPLY
import pytest

from dxl_monitor import doctor as doctor_module
from dxl_monitor.bus.report import BusReport
from dxl_monitor.bus.report import Cycle
from dxl_monitor.doctor import Doctor
from dxl_monitor.doctor import RULES
from dxl_monitor.doctor.case import Case
from dxl_monitor.doctor.case import Names
from dxl_monitor.doctor.case import OPTIONS
from dxl_monitor.doctor.case import PARAMETERS
from dxl_monitor.doctor.rate import likely_rate
from dxl_monitor.doctor.rhythm import is_independent
from dxl_monitor.doctor.rhythm import is_multiple
from dxl_monitor.doctor.rhythm import rhythms
from dxl_monitor.doctor.rhythm import spread_of
from dxl_monitor.doctor.rule import Claim
from dxl_monitor.doctor.rule import Found
from dxl_monitor.doctor.rule import Rule
from dxl_monitor.monitor import Monitor
from dxl_monitor.monitor_status import bus_status
from dxl_monitor.monitor_status import device_status
from dxl_monitor.monitor_status import PortState
from dxl_monitor.port.driver import LineErrors
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.reports import Level
from msg_defs.uart import heard_at

DOCS = Path(__file__).parents[1] / 'docs'
TRACE = Path(__file__).parents[2] / 'shared' / 'data' / 'bus_trace_head.bin'
S = 1_000_000_000


class Bus(heard_bus.Bus):
    every_ms = 10.0

    def told(self, errors: LineErrors | None = None) -> dict[str, Level]:
        return {one.rule: one.level for one in self.report(errors).findings}


def read(address: int, data: bytes, error: int = 0) -> tuple[bytes, bytes]:
    """Return a read of device 1 and its answer."""
    return (encode(1, I.READ, struct.pack('<HH', address, len(data))),
            encode(1, STATUS, data, error=error))


# --- how claims stand ------------------------------------------------------------------------

def plain_report(stamp: int) -> BusReport:
    return Monitor('arm', MODELS).report(stamp)


def with_rules(monkeypatch: pytest.MonkeyPatch, *rules: Rule) -> Doctor:
    monkeypatch.setattr(doctor_module, 'RULES', rules)
    monkeypatch.setattr(doctor_module, '_RANK', {one.name: n for n, one in enumerate(rules)})
    return Doctor()


def saying(*claims: Claim, until: int = 1 << 60) -> object:
    def check(case: Case) -> Iterator[Found]:
        if case.now < until:
            yield from claims
    return check


def rule(name: str, check: object, *explains: str, level: Level = Level.WARN,
         holds: bool = True) -> Rule:
    return Rule(name, level, check, explains, 0.0, holds)  # type: ignore[arg-type]


def names(report: BusReport) -> list[tuple[str, int | None]]:
    return [(one.rule, one.device) for one in report.findings]


def test_a_claim_outlives_its_evidence_a_little(monkeypatch: pytest.MonkeyPatch) -> None:
    doctor = with_rules(monkeypatch, rule('bad', saying(Claim(None, 'words'), until=2 * S)))
    seen = [bool(doctor.examine(plain_report(at * S)).findings) for at in range(1, 8)]
    assert seen == [True, True, True, True, False, False, False]


def test_what_needs_to_last_is_told_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = rule('bad', saying(Claim(None, 'words')))._replace(onset_s=2.0)
    doctor = with_rules(monkeypatch, slow)
    assert [bool(doctor.examine(plain_report(at * S)).findings) for at in range(1, 5)] \
        == [False, False, True, True]


def test_a_state_ends_with_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    doctor = with_rules(monkeypatch, rule('bad', saying(Claim(None, 'words'), until=2 * S),
                                          holds=False))
    assert doctor.examine(plain_report(S)).findings
    assert not doctor.examine(plain_report(2 * S)).findings


@pytest.mark.parametrize(('cause', 'consequence', 'hidden'), [
    (Claim(None, 'a'), Claim(5, 'b'), True),
    (Claim(5, 'a'), Claim(5, 'b'), True),
    (Claim(5, 'a'), Claim(None, 'b'), True),
    (Claim(5, 'a'), Claim(6, 'b'), False),
    (Claim(5, 'a', covers=(5, 6)), Claim(6, 'b'), True),
])
def test_a_cause_hides_its_consequence(monkeypatch: pytest.MonkeyPatch, cause: Claim,
                                       consequence: Claim, hidden: bool) -> None:
    doctor = with_rules(monkeypatch, rule('effect', saying(consequence)),
                        rule('cause', saying(cause), 'effect'))
    expected = [('cause', cause.device)] + [('effect', consequence.device)] * (not hidden)
    assert sorted(names(doctor.examine(plain_report(S))), key=str) == sorted(expected, key=str)


def test_the_worst_comes_first_and_is_the_message(monkeypatch: pytest.MonkeyPatch) -> None:
    doctor = with_rules(monkeypatch, rule('some', saying(Claim(None, 'a warning'))),
                        rule('worse', saying(Claim(None, 'an error')), level=Level.ERROR))
    report = doctor.examine(plain_report(S))
    assert names(report) == [('worse', None), ('some', None)]
    assert report.message == 'an error'


def test_advice_is_no_alarm() -> None:
    bus = Bus()
    bus.hear(PING, PONG, *read(9, b'\xfa'), *[READ, REPLY] * 5)
    device = bus.report().devices[0]
    assert 'return_delay' in bus.told()
    assert (device.level, device.message) == (Level.OK, 'connected')


def test_nothing_is_left_after_a_reset() -> None:
    bus = Bus()
    bus.hear(PING, PONG, *[*read(562, b'\0')[:1], encode(1, STATUS, error=7)] * 5)
    assert 'wrong_address' in bus.told()
    bus.monitor.reset_statistics(bus.now)
    bus.hear(*[READ, REPLY] * 500)
    assert bus.told() == {}


# --- rules that no fault of the simulated bus makes true ---------------------------------------

def test_overrun_accounts_for_damage() -> None:
    bus = Bus()
    bus.hear(PING, PONG)
    bus.told(LineErrors())
    for _ in range(30):
        bus.hear(READ, REPLY[:7] + REPLY[8:])
    assert bus.told(LineErrors(overrun=4)) == {'overrun': Level.WARN}


def test_answers_missing_now_and_then() -> None:
    bus = Bus()
    bus.hear(PING, PONG)
    for _ in range(10):
        bus.hear(*[READ, REPLY] * 10, READ)
    assert bus.told() == {'missed_answers': Level.WARN}


def test_who_was_never_heard_may_be_waiting_too() -> None:
    bus = Bus()
    bus.hear(PING, PONG)
    ask = encode(254, I.SYNC_READ, struct.pack('<HH', 132, 4) + b'\x01\x02\x03')
    bus.hear(*[ask, REPLY] * 200, every_ms=20.0)
    assert names(bus.report()) == [('sync_read_stops', 2)]


def test_an_alert_of_unknown_reason() -> None:
    bus = Bus()
    bus.hear(PING, PONG, READ, encode(1, STATUS, bytes(4), error=0x80))
    assert bus.told() == {'hardware_error': Level.WARN}
    bus.hear(*read(70, b'\x20', 0x80))
    assert bus.told() == {'hardware_error': Level.ERROR}
    bus.hear(READ, REPLY)
    assert bus.told() == {}


@pytest.mark.parametrize(('address', 'limit', 'value_at', 'value', 'expected'), [
    (31, b'\x50', 146, b'\x4a', {}),
    (31, b'\x50', 146, b'\x4b', {'too_hot': Level.WARN}),
    (31, b'\x50', 146, b'\x50', {'too_hot': Level.ERROR}),
    (31, b'\x3c', 146, b'\x3c', {'too_hot': Level.ERROR}),         # its own, not that of its model
    (34, b'\x5f\x00', 144, b'\x62\x00', {}),
    (34, b'\x5f\x00', 144, b'\x61\x00', {'voltage': Level.WARN}),
    (34, b'\x5f\x00', 144, b'\x5e\x00', {'voltage': Level.ERROR}),
    (32, b'\xa0\x00', 144, b'\x9e\x00', {'voltage': Level.WARN}),
    (32, b'\xa0\x00', 144, b'\xa1\x00', {'voltage': Level.ERROR}),
])
def test_near_a_limit_and_beyond(address: int, limit: bytes, value_at: int, value: bytes,
                                 expected: dict[str, Level]) -> None:
    bus = Bus()
    bus.hear(PING, PONG, *read(address, limit), *read(value_at, value))
    assert bus.told() == expected


def test_without_the_limit_it_cannot_tell() -> None:
    bus = Bus()
    bus.hear(PING, encode(1, STATUS, b'\xf2\x03\x29', error=0), *read(146, b'\x60'))
    report = bus.report()          # the factory limits of this model are not known here
    assert report.findings == ()
    assert ('too_hot', '001: Temperature Limit never read') in [
        (doubt.rule, doubt.message) for doubt in report.doubts]


@pytest.mark.parametrize(('identity', 'names', 'message'), [
    (b'', PARAMETERS, "connected; model unknown, so its registers have no names: add '1:MODEL' to "
     '`devices`, or let the master read Model Number'),
    (b'', OPTIONS, "connected; model unknown, so its registers have no names: add '1:MODEL' to "
     '--devices, or let the master read Model Number'),
    (b'\x67\x12\x01', PARAMETERS,
     'connected; no model file, so its registers have no names: add one to `model_dirs`'),
])
def test_a_device_whose_registers_have_no_names_says_so(identity: bytes, names: Names,
                                                        message: str) -> None:
    bus = Bus()
    bus.monitor = Monitor('arm', MODELS, names=names)
    bus.hear(*(PING, encode(1, STATUS, identity, error=0)) * bool(identity), *[READ, REPLY] * 200)
    report = bus.report()
    [device] = report.devices
    assert (device.level, device.message) == (Level.OK, message)
    assert report.message == ('1 of 1 devices connected; not all models known: '
                              f'set {names.devices}')


def test_an_error_register_without_an_alert_is_over() -> None:
    bus = Bus()
    bus.hear(PING, PONG, *read(70, b'\x20', 0x80))
    assert bus.report().devices[0].level is Level.ERROR
    bus.hear(*[READ, REPLY] * 3)       # it was switched off and on; the register is not read again
    assert (bus.report().devices[0].level, bus.told()) == (Level.OK, {})


def test_without_its_own_limit_that_of_its_model_counts() -> None:
    bus = Bus()
    bus.hear(PING, PONG, *read(146, b'\x60'))
    [finding] = bus.report().findings
    assert (finding.rule, finding.level) == ('too_hot', Level.ERROR)
    assert 'its shutdown limit of 80 °C from the factory' in finding.message


def test_a_reboot_that_was_ordered_is_no_finding() -> None:
    bus = Bus()
    bus.hear(PING, PONG, *[READ, REPLY] * 20, encode(1, I.REBOOT), encode(1, STATUS, error=0))
    bus.hear(*[READ] * 10, every_ms=40)
    for _ in range(6):
        bus.hear(*[READ, REPLY] * 25)
        bus.told()
    assert bus.told() == {}


@pytest.mark.parametrize('rate', [57_600, 115_200, 1_000_000, 3_000_000, 4_000_000])
def test_the_real_rate_from_garbled_headers(rate: int) -> None:
    baud = 2_000_000
    noise = b''.join(heard_at(one, baud / rate) for one in [PING, READ, PONG, REPLY] * 12)
    assert likely_rate(noise[-256:], baud) in (rate, None)


def test_the_real_rate_where_it_is_certain() -> None:
    noise = b''.join(heard_at(one, 2.0) for one in [PING, READ, PONG, REPLY] * 4)
    assert likely_rate(noise[-256:], 2_000_000) == 1_000_000
    assert likely_rate(bytes(256), 2_000_000) is None


def test_one_program_with_two_rhythms_is_not_two() -> None:
    def blurred(period: int, phase: int, seed: int) -> Cycle:
        rng = random.Random(seed)
        return Cycle(I.READ, (seed,), 132, 4, 32, 0, tuple(
            n * period * MS + phase + rng.randrange(2 * MS) for n in range(32)))
    same = rhythms((blurred(10, 0, 1), blurred(10, 4 * MS, 2)), 320 * MS, 2_000_000)
    assert is_multiple(*same)
    other = rhythms((blurred(20, 0, 1), blurred(37, 0, 2)), 1000 * MS, 2_000_000)
    assert is_independent(*other) and not is_multiple(*reversed(other))


@pytest.mark.parametrize(('count', 'places', 'is_told'), [
    (8, 5, True), (7, 5, False), (8, 3, False), (32, 7, False), (32, 8, True)])
def test_another_rhythm_is_found_in_many_places_of_the_cycle(count: int, places: int,
                                                             is_told: bool) -> None:
    def cycle(*stamps: float) -> Cycle:
        return Cycle(I.READ, (1,), 132, 4, 32, 0, tuple(int(one * MS) for one in stamps))
    one, other = rhythms((
        cycle(*(10 * n for n in range(150))),
        cycle(*(40 * n + (n % places + 0.5) * 10 / 16 for n in range(count)),
              *(1500 + n for n in range(13)))), 1500 * MS, 2_000_000)
    assert is_independent(one, other) == is_told


@pytest.mark.parametrize(('periods', 'spread'), [
    ([7], 0.0), ([2, 1], 0.5), ([*range(1, 11)], 7 / 6), ([*range(20, 0, -1)], 15 / 11),
    ([0, 0, 5], 0.0)])
def test_the_spread_is_that_without_the_tenth_at_each_end(periods: list[int],
                                                          spread: float) -> None:
    assert spread_of(periods) == spread


def test_a_little_spread_is_told_as_it_is() -> None:
    stamps = [n * 20 * MS + (n % 3) * MS for n in range(24)]
    cycle = Cycle(I.READ, (1,), 132, 4, 32, 0, tuple(stamps))
    (rhythm,) = rhythms((cycle,), stamps[-1], 1_000_000)
    assert rhythm.jitter == rhythm.spread == 3 / 21


def test_a_change_of_pace_is_no_jitter() -> None:
    stamps = [n * 20 * MS for n in range(16)]
    stamps += [stamps[-1] + n * 50 * MS for n in range(1, 17)]
    cycle = Cycle(I.READ, (1,), 132, 4, 32, 0, tuple(stamps))
    (rhythm,) = rhythms((cycle,), stamps[-1], 2_000_000)
    assert rhythm.jitter < 0.1 < rhythm.spread


def test_a_master_that_asks_two_things_in_turn_does_not_repeat_itself() -> None:
    stamps = [n * 20 * MS + part for n in range(16) for part in (0, 2 * MS)]
    cycle = Cycle(I.READ, (1,), 132, 4, 32, 0, tuple(stamps))
    assert [one.repeats for one in rhythms((cycle,), stamps[-1], 2_000_000)] == [[]]


@pytest.mark.parametrize(('instruction', 'behind_ms', 'every', 'found'), [
    (I.READ, 1.0, 16, 1),
    (I.READ, 1.5, 16, 1),
    (I.READ, 1.7, 16, 0),          # the answer was over before
    (I.READ, 1.0, 2, 0),           # so often it is part of the cycle
    (I.WRITE, 1.0, 16, 0),         # to another device, or with other data
])
def test_a_question_that_is_asked_again_at_once(instruction: int, behind_ms: float, every: int,
                                                found: int) -> None:
    stamps = [int((20 * n + late) * MS) for n in range(24)
              for late in ((0, behind_ms) if n % every == every // 2 else (0,))]
    cycle = Cycle(instruction, (1,), 132, 4, 32, 0, tuple(stamps))
    (rhythm,) = rhythms((cycle,), stamps[-1], 2_000_000)
    assert len(rhythm.repeats) == found
    assert all(int(behind_ms * MS) == again - before for before, again in rhythm.repeats)


# --- what a user sees --------------------------------------------------------------------------

def test_the_robot_trace() -> None:
    if not TRACE.is_file():
        pytest.skip('skipped: the robot trace is not here')
    data = TRACE.read_bytes()
    bus = Bus()
    bus.hear(*(data[at:at + 400] for at in range(0, len(data), 400)), every_ms=2.0)
    assert set(names(bus.report())) == {('no_answer', 101), ('turnaround', None), ('noise', None)}


def test_findings_and_doubts_are_keys_of_their_status() -> None:
    bus = Bus()
    pong = encode(1, STATUS, b'\xf2\x03\x29', error=0)
    bus.hear(PING, pong, *read(146, b'\x60'), READ, encode(1, STATUS, bytes(4), error=0x80))
    report = bus.report()
    device = dict(device_status('n', '', report.devices[0], report.findings, False).values)
    assert device['finding.hardware_error'].startswith('alert in its answers')
    values = dict(bus_status('n', '', report, PortState('p', '', ()), False).values)
    assert values['cannot tell.too_hot'] == '001: Temperature Limit never read'
    assert not any(key.startswith('finding.') for key in values)


def test_the_page_has_every_rule_and_no_other() -> None:
    page = (DOCS / 'doctor.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| `(\w+)` ([A-Z]+)[^|]* \| [^| ][^|]* \| [^| ][^|]* \|$', page, re.M)
    assert sorted(rows) == sorted((one.name, one.level.name) for one in RULES)


def test_rules_explain_rules() -> None:
    known = {one.name for one in RULES}
    assert len(known) == len(RULES)
    for one in RULES:
        assert set(one.explains) <= known, one.name


def test_no_bytes_make_it_raise() -> None:
    rng = random.Random(7)
    good = [PING, PONG, READ, REPLY, encode(254, I.SYNC_READ, b'\x84\x00\x04\x00\x01\x02\x03')]
    bus = Bus()
    for _ in range(300):
        chunk = bytearray(b''.join(rng.choices(good, k=6)))
        for _ in range(rng.randrange(6)):
            chunk[rng.randrange(len(chunk))] = rng.randrange(256)
        bus.hear(bytes(chunk) if rng.random() < 0.8 else rng.randbytes(40), every_ms=30.0)
        assert all(len(one.message) < 200 for one in bus.report().findings)
