# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Findings that rest on a value: while it is read, when it is not read any more, when it is well.

value_findings.yaml has them. Each goes through the three phases on simulated time, and is looked
at where a user meets it: report, log of dxl_doctor, status, history.
"""

from dataclasses import replace
from pathlib import Path
import struct

import doctor_case
from doctor_case import claims_of_row
import pytest
from test_doctor_edges import ENOUGH
import yaml

from mecarover_dashboard.history_recorder import HistorySampler
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TABLES
from msg_defs import dxl1_packet
from msg_defs import dxl_packet
from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import parse_all
from servobus.doctor import RULES
from servobus.doctor.case import PARAMETERS
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.doctor.rule import Claim
from servobus.doctor.standing import dated_claim
from servobus.doctor.standing import Reading
from servobus.doctor.standing import StandingClaim
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import PortState
from servobus.status import statuses_of
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import make_verdict

MODELS = Models()
S, MS = 1_000_000_000, 1_000_000
NIGHT = 1_790_000_000              # Unix s
READ_S, STOPPED_S, WELL_S = 6, 20, 18
OF_VALUES = yaml.safe_load(Path(__file__).with_name('value_findings.yaml').read_text(
    encoding='utf-8'))
DYNAMIXEL = [row for row in OF_VALUES if row.get('protocol', '2') == '2'
             and not row.get('keeps its words')]


class Watched:
    """A simulated bus with servos, and all who look at what the doctor says of it."""

    def __init__(self, row, names=PARAMETERS):
        self.row, self.rule, self.whom = row, row['rule'], row.get('whom', 1)
        self.protocol, self.number = row.get('protocol', '2'), row.get('asked', 1)
        model = row.get('model', 'XL430-W250')
        self.model = MODELS.by_name(model)
        self.now, self.turn, self.events = 100 * S, 0, []
        self.monitor = Monitor('', MODELS, Settings(
            devices=parse_all([f'1-3:{model}']), protocol=self.protocol,
            baud=1_000_000), names=names)
        self._log, self._state, self._sampler = FindingLog(), State(), HistorySampler()

    def say(self, *packets):
        for packet in packets:
            self.now += MS
            self.monitor.feed(packet, self.now)

    def packet(self, number, code, params=b''):
        if self.protocol == '2':
            return dxl_packet.encode(number, code, params)
        return dxl1_packet.encode(number, code, params)

    def answer(self, number, params=b'', error=0):
        if self.protocol == '2':
            return dxl_packet.encode(number, dxl_packet.STATUS, params, error=error)
        return dxl1_packet.encode(number, error, params)

    def access(self, number, code, name, raw, error=0, is_answered=True):
        """Read or write a register of a servo; raw: its value, or values by turns."""
        field = self.model.by_name[name]
        data = field.bytes_of(raw[self.turn % len(raw)] if isinstance(raw, list) else raw)
        form = '<HH' if self.protocol == '2' else '<BB'
        if code == I.READ:
            asks, answers = struct.pack(form, field.at, field.size), data
        else:
            asks, answers = struct.pack(form[:2], field.at) + data, b''
        self.say(self.packet(number, code, asks),
                 *[self.answer(number, answers, error)] * is_answered)

    def turns(self, seconds, what, is_answered=True, is_blocked=False):
        """Let the master do what it does every 100 ms; another servo is well all the time."""
        end = self.now + seconds * S
        while self.now < end:
            begin, self.turn = self.now, self.turn + 1
            for number in (2, 3)[is_blocked:]:
                self.access(number, I.READ, 'Present Position', 2048)
            for number in what.get('ids', [self.number]):
                for code, kind in ((I.WRITE, 'write'), (I.READ, 'read')):
                    for name, raw in what.get(kind, {}).items():
                        raw = raw[number] if isinstance(raw, dict) else raw
                        self.access(number, code, name, raw, what.get('error', 0),
                                    is_answered and not what.get('is silent'))
            if is_blocked:             # servo 2 is dead, so the turn of servo 1 does not come
                at = struct.pack('<HH', self.model.by_name['Present Position'].at, 4)
                self.say(self.packet(BROADCAST, I.SYNC_READ, at + b'\x02\x01'))
            self.now = begin + 100 * MS
            if not self.turn % 5:
                self.look()

    def look(self):
        """Report, and let everybody see it."""
        self.report = report = self.monitor.report(self.now)
        self._log.add_report(report)
        statuses = statuses_of('dxl_monitor', '', report, PortState('/dev/ttyUSB0', '', ()), True)
        self.statuses = {status.name.rpartition(': ')[2]: status for status in statuses}
        self._state.store_message(TABLES, statuses, self.now / S)
        self._sampler.sample_state(self._state, self.now / S, NIGHT + self.now / S)
        who = 'bus' if self.whom is None else f'{self.whom:03}'
        self.events += [event for event in self._sampler.take_batch()[1]
                        if event.source.name.rpartition(': ')[2] == who]

    def finding(self):
        """Return what the doctor says now, None if it says nothing."""
        found = [one for one in self.report.findings
                 if (one.rule, one.device) == (self.rule, self.whom)]
        assert len(found) <= 1
        return found[0] if found else None

    def status(self):
        return self.statuses['bus' if self.whom is None else f'{self.whom:03}']

    def logged(self):
        """Return what dxl_doctor would say: its evidence, and the finding in its JSON."""
        bus = BusSummary.of('', self.report, self._log, True)
        said = make_verdict('bus.txt', [bus], 1.0, True)
        found = as_json(said, [bus], 1.0)['buses'][0]['findings']
        [one] = [one for one in found if (one['rule'], one['device']) == (self.rule, self.whom)]
        [evidence] = [one.evidence for one in said.wrong
                      if (one.rule, one.who) == (self.rule, bus.who(self.whom))]
        return evidence, one

    def stands(self, level, message):
        """Check that all say that it is so."""
        found, status = self.finding(), self.status()
        assert found is not None
        assert (found.level, found.message) == (level, message)
        assert dict(status.values)[f'finding.{self.rule}'] == message
        if level is not Level.OK:
            assert status.level != Level.OK
        evidence, as_told = self.logged()
        assert as_told['stands'] and 'not since' not in evidence
        ended = {event.text for event in self.events if event.kind == 'over'}
        assert ended <= {'eeprom wear'}        # some cases are made of writes
        return found

    def is_over(self):
        """Check that all say that it is over."""
        assert self.finding() is None
        assert f'finding.{self.rule}' not in dict(self.status().values)
        evidence, as_told = self.logged()
        assert not as_told['stands'] and ' s, not since' in evidence
        assert as_told['read_s'] is None
        if as_told['level'] != 'OK':
            assert Level.OK in [event.level for event in self.events if event.kind == 'state'
                                or event.text == self.rule.replace('_', ' ')]


@pytest.fixture(params=OF_VALUES, ids=lambda row: row['rule'])
def row(request):
    return request.param


def read_until_it_is_said(row, names=PARAMETERS):
    """Return a bus on which the first phase is over, and the finding."""
    bus = Watched(row, names)
    bus.turns(READ_S, row['while read'])
    found = bus.finding()
    assert found is not None, bus.report.findings
    assert found.level.name == row['level']
    assert row['says'] in found.message
    assert found.read_at == 0
    bus.stands(found.level, found.message)
    return bus, found


def expected_of(row, bus, message):
    """Return what is to be said when it was not read for so long."""
    if row.get('keeps its words'):
        assert row['says'] in bus.finding().message     # an average in it may go on
        return bus.finding().message
    return f'{row["when it stops"]} {STOPPED_S} s ago; {message}'


def test_every_finding_that_rests_on_a_value_is_in_the_table():
    resting = {rule for rule, parts, *_ in ENOUGH
               for claim in claims_of_row(rule, parts) if claim.rests_on}
    assert len(resting) > 5
    assert resting <= {row['rule'] for row in OF_VALUES}


def test_what_is_said_when_nobody_reads_it_any_more(row):
    bus, found = read_until_it_is_said(row)
    bus.turns(STOPPED_S, row.get('goes on', {}))
    now = bus.stands(found.level, expected_of(row, bus, found.message))
    evidence, as_told = bus.logged()
    if row.get('keeps its words'):
        assert (now.read_at, as_told['read_s']) == (0, None)
    else:
        assert READ_S - 0.2 < as_told['read_s'] < READ_S
        assert f'its value is of {as_told["read_s"]:.1f} s' in evidence
    bus.turns(WELL_S, row['well'])
    bus.is_over()


@pytest.mark.parametrize('row', DYNAMIXEL, ids=lambda row: row['rule'])
@pytest.mark.parametrize('why', ['its turn does not come', 'it does not answer'])
def test_what_is_said_of_a_servo_that_cannot_be_read_any_more(row, why):
    bus, found = read_until_it_is_said(row)
    asked = {'read': {'Present Position': 0}}
    bus.turns(STOPPED_S, asked if why == 'it does not answer' else {}, is_answered=False,
              is_blocked=why == 'its turn does not come')
    if bus.whom is None:
        return                         # none of them answers: that is another finding of the bus
    found = bus.stands(found.level, expected_of(row, bus, found.message))
    if why == 'it does not answer':
        assert bus.status().message.startswith('no answer, silent for more than 10 s')
        assert bus.report.findings[0].rule == 'no_answer'
        return
    assert {one.rule for one in bus.report.findings if one.device == 2} == {'sync_read_stops'}
    if found.level is Level.ERROR:
        assert (bus.status().level, bus.status().message) == (Level.ERROR, found.message)
    bus.turns(WELL_S, row['well'])
    bus.is_over()


@pytest.mark.parametrize('row', [row for row in DYNAMIXEL if row.get('whom', 1) is not None],
                         ids=lambda row: row['rule'])
def test_after_a_restart_nothing_is_known_so_it_is_not_over(row):
    bus, found = read_until_it_is_said(row)
    bus.say(bus.packet(1, I.REBOOT), bus.answer(1))
    bus.turns(STOPPED_S, {})
    if not row.get('answers the Reboot'):
        bus.stands(found.level, f'{row["when it stops"]} {STOPPED_S} s ago, restarted since; '
                                f'{found.message}')
        bus.turns(WELL_S, row['well'])
    bus.is_over()


def test_a_clock_gives_the_time_of_day():
    row = next(one for one in OF_VALUES if one['rule'] == 'too_hot')
    seen = []

    def time_of_day(stamp):
        seen.append(stamp)
        return '20:46:30'

    bus, found = read_until_it_is_said(row, PARAMETERS._replace(time_of_day=time_of_day))
    last = bus.now
    bus.turns(STOPPED_S, {})
    bus.stands(Level.ERROR, f'82 °C, last read at 20:46:30; {found.message}')
    assert all(0 < last - stamp < 100 * MS for stamp in seen)
    bus.now += 12 * 3600 * S           # then it could be that of another day
    bus.look()
    assert bus.finding().message.startswith('82 °C, last read 12 h ago; ')


def test_a_stamp_of_the_future_is_of_now():
    """A broken source may stamp its bytes with anything; no clock can spell it."""
    seen = []
    now = doctor_case.case()
    now = replace(now, names=PARAMETERS._replace(time_of_day=lambda at: str(seen.append(at))))
    hot = Reading(10 ** 27, 'read', '82 °C', ())
    dated_claim(now, StandingClaim(RULES[0], Claim('it is hot'), now.now, hot, has_restarted=True))
    assert seen == [now.now]


def test_a_monitor_that_was_started_again_clears_nothing():
    """It has not read the temperature yet: the history does not say that it is well."""
    row = next(one for one in OF_VALUES if one['rule'] == 'too_hot')
    bus, _ = read_until_it_is_said(row)
    bus.monitor = Monitor('', MODELS, Settings(baud=1_000_000))
    bus.now += 60 * S
    bus._state.expire(bus.now / S)
    bus._sampler.sample_state(bus._state, bus.now / S, NIGHT + bus.now / S)
    bus.turns(5, {'read': {'Present Position': 2048}})
    assert bus.finding() is None
    assert 'over' not in [event.kind for event in bus.events]
