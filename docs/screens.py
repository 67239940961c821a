# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The screens of dxl_doctor that README and docs/ show: simulated arms, in simulated time.

A page has `<!-- screen: NAME -->` above a block, or `<!-- wrong: NAME -->` for its second half;
docs/generate.py fills the block. The program of the SO-101 asks what lerobot-teleoperate asks
(LeRobot 7427f31), and waits as long; fake_bus with such a program on its pty gave the same
screens, but for their figures.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
import re
from typing import NamedTuple

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Burst
from mecarover_fakes.line import MASTER
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import none
from mecarover_fakes.traffic import PATTERNS
from msg_defs.event import Change
from msg_defs.event import Chunk
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.sources.capture import Wire
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.program_source import Ending
from servobus.tools.doctor.verdict import make_verdict

BAUD = 1_000_000
S, MS = 1_000_000_000, 1_000_000
CYCLE_NS = 16_666_667              # 60 Hz
TIME_OUT_NS = 51 * MS              # LeRobot sets it for its port
PAUSE_NS = MS                      # what program and USB take between two questions
PING, READ, WRITE, SYNC_READ, SYNC_WRITE, ALL = 1, 2, 3, 0x82, 0x83, 0xFE
SO101 = range(1, 7)
TRIES = 3                          # LeRobot reads the follower so often: num_read_retries is 2
FOLLOWER, LEADER = 'ttyACM0', 'ttyACM1'
MISSING = "RuntimeError: FeetechMotorsBus motor check failed on port '/dev/ttyACM0': Missing " \
    'motor IDs: - {} (expected model: 777)'
FAILED = "ConnectionError: Failed to sync read 'Present_Position' on ids=[1, 2, 3, 4, 5, 6] " \
    'after 3 tries. [TxRxResult] There is no status packet!'


class Run(NamedTuple):
    """A source and the fault on its bus; error: with which the program ends then."""

    source: str
    fault: str = ''
    error: str = ''
    seconds: float = 6.0


TELEOPERATE = 'lerobot-teleoperate --robot.type=so101_follower ...'
HEARD_USB = 'usb:/dev/ttyUSB0'
RUNS = {
    'healthy': Run(TELEOPERATE),
    'missing': Run(TELEOPERATE, 'silent:3', MISSING.format(3)),
    'lost': Run(TELEOPERATE, 'silent:3:4', FAILED),
    'overload': Run(TELEOPERATE, 'latched:6:2'),
    'usb': Run(HEARD_USB, 'silent:13:3'),
}


def show(name: str) -> str:
    """Return the screen of a run by its name, as in a terminal of 80 columns."""
    run = RUNS[name]
    examination = Examination(Models())
    ports = dict[str, None]()
    for chunk in teleoperate(run) if run.source == TELEOPERATE else control(run):
        examination.feed_chunk(chunk, Wire(chunk.bus, BAUD))
        ports[chunk.bus] = None
    now = chunk.stamp
    ending = Ending(bool(run.error), run.error, packages=frozenset(['lerobot']))
    examination.finish(examination.last, True, ending.failed)
    said = make_verdict(run.source, examination.buses(True), now / S - 1, True, (), [*ports],
                        ending.trouble())
    return '\n'.join(line.rstrip() for line in screen(said)) + '\n'


def teleoperate(run: Run) -> Iterator[Chunk]:
    """Yield what two SO-101 and lerobot-teleoperate exchange, as the tap hears it."""
    masters = {port: so101(fault) for port, fault in ((LEADER, ''), (FOLLOWER, run.fault))}
    now, missing = 0, set[int]()
    for port, ask, due in questions():
        if max(now, due) > run.seconds * S or (missing and ask.instruction == WRITE):
            break
        if ask.id in missing:
            continue
        found, now, is_answered = exchange(masters[port], port, ask, max(now, due))
        yield from found
        if ask.instruction == SYNC_READ and not is_answered:
            break
        if not is_answered:
            missing.add(ask.id)
    for port in masters:
        yield Chunk(S + now, port, change=Change(CLOSED, 1))


def exchange(master: Master, port: str, ask: Ask, now: int) -> tuple[list[Chunk], int, bool]:
    """Return what is heard of a question and its answers, when it is over, and if all came."""
    answers = {SYNC_READ: len(SO101), SYNC_WRITE: 0}.get(ask.instruction, 1)
    heard: list[Chunk] = []
    for _ in range(TRIES if ask.instruction == SYNC_READ else 1):
        bursts = master.respond(ask, now)
        heard += chunks(port, bursts)
        now = bursts[-1].end + PAUSE_NS
        if len(bursts) > answers:
            return heard, now, True
        now += TIME_OUT_NS
        heard.append(Chunk(S + now, port, change=Change(GAVE_UP, 0)))
    return heard, now, False


def chunks(port: str, bursts: Iterable[Burst]) -> Iterator[Chunk]:
    """Yield bursts as they are written and read."""
    for burst in bursts:
        side = OUT if burst.sender == MASTER else IN
        now = burst.start if side == OUT else burst.end
        yield Chunk(S + now, port, burst.data, side)


def so101(fault: str) -> Master:
    """Return the master of an arm."""
    devices = make_devices([f'{SO101[0]}-{SO101[-1]}:STS3215'], Models(), BAUD, moving=False,
                           dialect='feetech')
    return Master(make_line(devices, BAUD, 'feetech'), none,
                  faults=[parse(fault)] if fault else [])


def questions() -> Iterator[tuple[str, Ask, int]]:
    """Yield the port and each instruction of lerobot-teleoperate, and its earliest time (ns)."""
    for port in (LEADER, FOLLOWER):
        for one in SO101:
            yield port, Ask(one, PING), 0
            yield port, Ask(one, READ, bytes((3, 0, 2, 0))), 0
        for one in SO101:
            for address, value in ((40, 0), (55, 0), (7, 0), (85, 254), (41, 254), (33, 0)):
                yield port, Ask(one, WRITE, bytes((address, 0, value))), 0
    for one in SO101:
        yield FOLLOWER, Ask(one, WRITE, bytes((40, 0, 1))), 0
    read = Ask(ALL, SYNC_READ, bytes((56, 0, 2, 0, *SO101)))
    for cycle in range(10**6):
        goal = (2048 + cycle % 300).to_bytes(2, 'little')
        yield FOLLOWER, read, 2 * S + cycle * CYCLE_NS
        yield LEADER, read, 0
        yield FOLLOWER, Ask(ALL, SYNC_WRITE, bytes((42, 0, 2, 0)) + b''.join(
            bytes([one]) + goal for one in SO101)), 0


def control(run: Run) -> Iterator[Chunk]:
    """Return what an OpenMANIPULATOR-X and its ROS 2 controller exchange."""
    devices = make_devices(['11-15:XM430-W350'], Models(), BAUD)
    master = Master(make_line(devices, BAUD), PATTERNS['sync'], rate=100,
                    faults=[parse(run.fault)])
    return chunks('ttyUSB0', master.bursts(round(run.seconds * S)))


def with_screens(page: str) -> str:
    """Return a page with the screens that its marks name."""
    def block(mark: re.Match[str]) -> str:
        whole = show(mark['name'])
        begin = whole.index('Wrong:') if mark['part'] == 'wrong' else 0
        return f"{mark['head']}{whole[begin:]}```"

    return re.sub(r'(?P<head><!-- (?P<part>screen|wrong): (?P<name>\w+) -->\n```text\n).*?^```',
                  block, page, flags=re.M | re.S)
