# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Where a cycle's time goes: masters with planted delays, in simulated time."""

from pathlib import Path
import random

import pytest
from tracked_bus import reply
from tracked_bus import words
import yaml

from msg_defs.diagnostics import Level
from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_packet import encode
from msg_defs.event import AWAY
from msg_defs.event import BUSY
from msg_defs.event import Change
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import TRACED
from msg_defs.event import UNKNOWN
from servobus.bus.cycle_time import NO_RATE
from servobus.bus.cycle_time import NO_SIDES
from servobus.doctor.case import History
from servobus.doctor.case import PARAMETERS
from servobus.doctor.finding_log import BusSummary
from servobus.doctor.finding_log import FindingLog
from servobus.doctor.rules.timing import cycle_time
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.monitor import Settings
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import make_verdict

MODELS = Models()
BAUD, BYTE_NS = 1_000_000, 10_000
S, MS = 1_000_000_000, 1_000_000
SIX = range(1, 7)
POSITION = b'\x05\x00\x00\x00'


def read(number, dead=()):
    answers = [] if number in dead else [(number, reply(number, POSITION))]
    return encode(number, 2, words(132, 4)), answers


def first_ids(code, params, dead=()):
    return encode(0xFE, code, params), [(number, reply(number, POSITION)) for number in SIX
                                        if number not in dead]


def sync_read(dead=()):
    return first_ids(0x82, words(132, 4) + bytes(SIX), dead)


SYNC_WRITE = encode(0xFE, 0x83, words(116, 4) + b''.join(
    bytes((number,)) + POSITION for number in SIX)), []
# What a master asks in a cycle: instruction, answers; dead: IDs that do not answer.
PATTERNS = {
    'a Read each': lambda dead: [read(number, dead) for number in SIX],
    'Sync Read': lambda dead: [sync_read(dead)],
    'Sync Write': lambda dead: [SYNC_WRITE],
    'Protocol 1.0': lambda dead: [
        (encode_1(number, 2, b'\x24\x02'),
         [] if number in dead else [(number, encode_1(number, 0, b'\x10\x02'))])
        for number in SIX],
    'Feetech': lambda dead: [(encode_1(0xFE, 0x82, b'\x38\x02' + bytes(SIX)), [
        (number, encode_1(number, 0, b'\x10\x02')) for number in SIX if number not in dead])],
}


def is_cut(instruction, answers):
    """Return whether answers are missing: of six that are asked at once, or of one."""
    return instruction != SYNC_WRITE[0] and len(answers) in (0, 5)


class Robot:
    """A master and its servos. traced_us: what strace takes of each cycle."""

    def __init__(self, program_ms, servo_ms, timeout_ms=0.0, gives_up=True, traced_us=0,
                 baud=BAUD, has_sides=True):
        self.bus = Monitor('bus', MODELS, Settings(baud=baud))
        self.program, self.servo = int(program_ms * MS), int(servo_ms * MS)
        self.timeout, self.gives_up, self.traced = timeout_ms * MS, gives_up, traced_us
        self.has_sides = has_sides
        self.now = S
        self.gave_up = 0

    def say(self, data, stamp, side):
        self.bus.feed(data, stamp, side if self.has_sides else UNKNOWN)

    def turn(self, asked):
        if self.traced:
            self.bus.change(Change(TRACED, self.traced), self.now)
        for instruction, answers, dead in asked:
            began, self.now = self.now, self.now + len(instruction) * BYTE_NS
            if self.gave_up and self.gives_up:
                self.bus.change(Change(GAVE_UP, (began - self.gave_up) // 1000), began)
            self.gave_up = 0
            self.say(instruction, began if self.has_sides else self.now, OUT)
            for _, answer in answers:
                self.now += self.servo + len(answer) * BYTE_NS
                self.say(answer, self.now, IN)
            if dead:
                self.now = self.gave_up = int(began + self.timeout)
        self.now += self.program + 1000 * self.traced

    def run(self, pattern, dead=(), seconds=2.5):
        asked = [(instruction, answers, dead and is_cut(instruction, answers))
                 for instruction, answers in PATTERNS[pattern](dead)]
        end = self.now + seconds * S
        while self.now < end:
            self.turn(asked)
        return self.bus.report(self.now)


def truth(pattern, robot, dead):
    """Return the planted parts in ms: wire, device, waiting."""
    wire = device = waiting = 0.0
    for instruction, answers in PATTERNS[pattern](dead):
        sent = len(instruction) * BYTE_NS
        came = sum(len(answer) for _, answer in answers) * BYTE_NS
        wire, device = wire + sent + came, device + robot.servo * len(answers)
        if dead and is_cut(instruction, answers):
            waiting += robot.timeout - sent - came - robot.servo * len(answers)
    return wire / MS, device / MS, waiting / MS


@pytest.mark.parametrize('pattern', PATTERNS)
@pytest.mark.parametrize(('program', 'servo', 'timeout'), [
    (1.0, 2.0, 0.0), (20.0, 0.25, 100.0)])
def test_each_part_of_a_cycle(pattern, program, servo, timeout):
    dead = (3,) if timeout else ()
    robot = Robot(program, servo, timeout)
    times = robot.run(pattern, dead).cycle
    wire, device, waiting = truth(pattern, robot, dead)
    assert not times.unknown and not times.is_blurred
    near = {'rel': 0.001, 'abs': 0.002}
    assert times.wire == pytest.approx(wire, **near)
    assert times.device == pytest.approx(device, **near)
    assert dict(times.waiting) == ({3: pytest.approx(waiting, **near)} if waiting else {})
    assert times.program == pytest.approx(program, **near)
    assert times.cycle == pytest.approx(wire + device + waiting + program, **near)


def test_what_strace_takes_is_not_the_programs():
    times = Robot(10.0, 0.5, traced_us=400).run('Sync Read').cycle
    assert (times.program, times.tracer) == pytest.approx((10.0, 0.4), abs=0.01)


@pytest.mark.parametrize('away_ms', [19, 5, 0])
def test_a_sleep_before_an_answer_is_the_programs_and_no_latency(away_ms):
    robot = Robot(1.0, 0.5)
    instruction, answers = sync_read(dead=())
    data = b''.join(answer for _, answer in answers)
    while robot.now < 6 * S:
        robot.say(instruction, robot.now, OUT)
        robot.now += 20 * MS
        if away_ms:
            robot.bus.change(Change(AWAY, 1000 * away_ms), robot.now)
        robot.say(data, robot.now, IN)
        robot.now += robot.program
        report = robot.bus.report(robot.now)
    wire = (len(instruction) + len(data)) * BYTE_NS / MS
    device = max(0, 20 - wire - away_ms)
    assert report.cycle.device == pytest.approx(device, abs=0.01)
    assert report.cycle.program == pytest.approx(21 - wire - device, abs=0.01)
    assert (report.devices[0].latency.total is None) == (away_ms == 19)
    assert any('not sleep before' in one.message for one in report.findings) == (away_ms == 19)


def test_bytes_that_come_when_time_is_up_are_waited_for():
    """A read that blocks for all bytes returns those that came at its time-out."""
    robot = Robot(5.0, 0.5)
    instruction, answers = sync_read(dead=(3,))
    while robot.now < 6 * S:
        robot.bus.change(Change(GAVE_UP, robot.program // 1000), robot.now)
        robot.say(instruction, robot.now, OUT)
        robot.now += 30 * MS
        robot.say(b''.join(answer for _, answer in answers), robot.now, IN)
        robot.now += robot.program
    times = robot.bus.report(robot.now).cycle
    wire = (len(instruction) + 5 * 15) * BYTE_NS / MS
    assert (times.program, times.device) == pytest.approx((5.0, 0.0), abs=0.01)
    assert dict(times.waiting) == {3: pytest.approx(30.0 - wire, abs=0.01)}


@pytest.mark.parametrize('is_marked', [True, False], ids=['marked', 'old capture'])
def test_a_read_of_too_many_bytes_waits_for_its_time_out_and_not_for_the_servo(is_marked):
    """A read of 32 for an answer of 15 returns them when its time is up."""
    robot = Robot(2.0, 0.5)
    instruction, [(_, data)] = read(1)
    while robot.now < 12 * S:
        robot.bus.change(Change(GAVE_UP, robot.program // 1000), robot.now)
        robot.say(instruction, robot.now, OUT)
        robot.now += 300 * MS
        if is_marked:
            robot.bus.change(Change(AWAY, 300_000), robot.now)
        robot.say(data, robot.now, IN)
        robot.now += robot.program
        report = robot.bus.report(robot.now)
    times = report.cycle
    wire = (len(instruction) + len(data)) * BYTE_NS / MS
    assert (times.device, times.waiting) == (pytest.approx(0.0, abs=0.01), ())
    assert (times.asleep, times.program) == pytest.approx((300 - wire, 302 - wire), abs=0.01)
    assert (report.devices[0].latency.total is None) == is_marked
    [said] = [one.message for one in report.findings if one.rule == 'cycle_time']
    assert 'more bytes than an answer has' in said


def test_looking_once_more_after_the_answer_is_the_programs():
    robot = Robot(2.0, 0.5)
    asked = [(*read(1), False)]
    while robot.now < 4 * S:
        robot.turn(asked)
        robot.now += 18 * MS
        robot.bus.change(Change(GAVE_UP, robot.program // 1000), robot.now)
    times = robot.bus.report(robot.now).cycle
    assert (times.asleep, times.program) == pytest.approx((18.0, 20.0), abs=0.01)


@pytest.mark.parametrize(('options', 'why'), [
    ({'has_sides': False}, NO_SIDES), ({'baud': 0}, NO_RATE)])
def test_what_is_not_known_is_said(options, why):
    report = Robot(10.0, 0.5, **options).run('Sync Read')
    assert report.cycle.unknown == why
    assert report.cycle.cycle == pytest.approx(14.08, abs=0.1)
    assert not [one for one in report.metrics if one.name.startswith('cycle')]
    said = make_verdict('x', [BusSummary.of('', report, FindingLog(), True)], 6.0, is_timed=True)
    assert f'  14 ms a cycle; its parts are unknown: {why}' in screen(said)


def test_waiting_and_program_are_one_where_the_source_cannot_know():
    times = Robot(10.0, 0.5, 20.0, gives_up=False).run('Sync Read', dead=(3,)).cycle
    assert times.is_blurred and times.program == pytest.approx(0.0, abs=0.01)


def test_metrics_screen_and_json_say_the_same():
    report = Robot(27.0, 0.5, 8.0).run('a Read each', dead=(3,))
    values = {one.name: one for one in report.metrics if one.name.startswith('cycle')}
    assert {one.unit for one in values.values()} == {'ms'}
    mean = {name: one.window.mean for name, one in values.items()}
    assert mean.pop('cycle') == pytest.approx(sum(mean.values()))
    assert set(mean) == {'cycle_wire', 'cycle_device', 'cycle_waiting', 'cycle_program'}
    buses = [BusSummary.of('', report, FindingLog(), True)]
    said = make_verdict('x', buses, 6.0, is_timed=True)
    line = '  39 ms a cycle: program 27, waiting for 003 7.9, devices 2.5, wire 1.6'
    assert line in screen(said)
    found = as_json(said, buses, 6.0)['buses'][0]['cycle']
    assert found.pop('waiting') == ((3, pytest.approx(mean['cycle_waiting'])),)
    assert found == {
        'cycle': values['cycle'].window.mean, 'wire': mean['cycle_wire'],
        'device': mean['cycle_device'], 'program': mean['cycle_program'],
        'tracer': pytest.approx(0.0, abs=1e-6), 'is_blurred': False, 'unknown': '',
        'asleep': 0.0, 'busy': None}


def test_a_pause_is_no_cycle():
    robot = Robot(10.0, 0.5)
    robot.run('Sync Read', seconds=4.0)
    robot.now += 3 * S
    report = robot.run('Sync Read', seconds=4.0)
    assert report.cycle.cycle == pytest.approx(14.08, abs=0.1)


@pytest.mark.parametrize(('pattern', 'robot', 'dead', 'device', 'word'), yaml.safe_load(
    Path(__file__).with_name('cycle_advice.yaml').read_text(encoding='utf-8')))
def test_what_takes_most_of_a_cycle_is_advice(pattern, robot, dead, device, word):
    report = Robot(**robot).run(pattern, dead)
    found = list(cycle_time.check(History(PARAMETERS).make_case(report)))
    assert [one.device for one in found] == ([device] if word else [])
    assert all(word in one.message for one in found)
    assert {one.level for one in report.findings if one.rule == 'cycle_time'} <= {Level.OK}


@pytest.mark.parametrize(('busy', 'is_named'), [(None, True), (0.9, True), (0.2, False)])
def test_a_program_that_takes_long_each_time_otherwise_is_named(busy, is_named):
    """Unless the source knows that it does not work for most of that time."""
    robot = Robot(0, 0.1)
    asked = [(*sync_read(), False)]
    chance = random.Random(1)
    for _ in range(200):
        robot.program = chance.randint(20, 50) * MS
        robot.turn(asked)
        if busy:
            robot.bus.change(Change(BUSY, int(busy * robot.program) // 1000), robot.now)
    report = robot.bus.report(robot.now)
    assert report.cycle.busy == (busy and pytest.approx(busy * report.cycle.program, rel=0.05))
    found = list(cycle_time.check(History(PARAMETERS).make_case(report)))
    assert ['the program itself' in one.message for one in found] == [True] * is_named


@pytest.mark.parametrize('stamps', [range(9 * S, 8 * S, -S // 10),
                                    range(1 << 61, 1 << 65, 1 << 61)])
def test_stamps_that_go_backwards_or_are_ages_apart_make_no_cycle(stamps):
    bus = Monitor('bus', MODELS, Settings(baud=BAUD))
    bus.feed(read(1)[0], 1, OUT)
    bus.report(1)
    for stamp in stamps:
        bus.feed(read(1)[0], stamp, OUT)
        assert bus.report(max(stamp, 9 * S)).cycle is None
