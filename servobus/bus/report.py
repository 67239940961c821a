# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a bus monitor knows at one moment: plain values, safe to use without any lock.

Made by Monitor.report(now); judged in servobus/doctor/, published by monitor_node.py, shown by
the dashboard and the terminal. Keys of counters are spelt as a user reads them, unit in the key.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from operator import attrgetter
from operator import sub
from typing import Any
from typing import Generic
from typing import NamedTuple
from typing import TypeVar

from msg_defs import diagnostics
from msg_defs import status_keys as keys
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.event import UNKNOWN
from msg_defs.running_statistics import Summary
from servobus.bus.table import Observed
from servobus.model.control_table import Model

PROTOCOL_2 = 'Dynamixel 2.0'       # besides the names of the dialects of the 1.0 family
PROTOCOL_SHOWN_BYTES = 64          # fewer without a packet do not show the 1.0 family

# State words of a device.
CONNECTED = diagnostics.CONNECTED
DISCONNECTED = 'disconnected'      # more answers missed in a row than missed_limit
SILENT = 'silent'                  # not asked, and silent, for silent_after
EXPECTED = 'expected'              # listed in `devices`, never heard
ASKED = 'asked'                    # addressed by the master, never heard, not listed
WAITING = 'waiting'                # asked, but after a silent device in the same Sync Read
MOVED = 'moved'                    # its Baud Rate or ID was written: not here any more
NEW_ID = 'ID '                     # in front of the ID in `moved_to`

# How a program ended by itself, if not well.
FAILED = 'failed'                  # with an exit code that is not 0
RAISED = 'raised'                  # by an exception of its servo library
# Packages that drive servos; an exception that came through one is about the bus.
SERVO_LIBRARIES = frozenset((
    'lerobot', 'dynamixel_sdk', 'scservo_sdk', 'pypot', 'dynio', 'rustypot', 'st3215',
    'python_st3215', 'vassar_feetech_servo_sdk', 'vassar_feetech', 'serial', 'dynamixel_easy_sdk',
    'dynamixel_api', 'pyax12', 'feetech_cli'))
RATE_REFUSED = 'rate refused'      # by an exception of the driver of its port, as it set a rate


# Who else uses its port: a program that it started, or itself where it opens the port twice.
OTHER_PART = 'another part of this program'
STOLE_REPLIES = f'{OTHER_PART}, which took its answers,'


class Error(NamedTuple):
    """One line of the error log; stamp in monotonic ns."""

    stamp: int
    text: str


class Finding(NamedTuple):
    """
    A named cause, from the doctor; device None = the bus; covers: who else suffers from it.

    read_at: stamp of the value that it rests on, where that is not read any more; 0 where it is.
    step: of a doubt about what a user would call broken: what to do to decide between its causes.
    """

    rule: str
    level: Level
    device: int | None
    message: str                   # what a person does about it
    evidence: tuple[tuple[str, str], ...] = ()
    covers: tuple[int, ...] = ()
    read_at: int = 0
    step: str = ''

    @property
    def who(self) -> str:
        """Who has it: '003', or 'the bus'."""
        return 'the bus' if self.device is None else f'{self.device:03}'


D = TypeVar('D')


class IncidentKind(str, Generic[D]):
    """The name of a kind of incident, and what is known of each: detail (evidence.py)."""

    detail: Callable[..., D]

    def __new__(cls, name: str, detail: Callable[..., D]) -> IncidentKind[D]:
        kind = super().__new__(cls, name)
        kind.detail = detail
        return kind


@dataclass(slots=True)
class Incident(Generic[D]):
    """A rare event for the doctor; device -1 = none in particular."""

    stamp: int
    kind: IncidentKind[D]
    device: int
    detail: D


class Wait(NamedTuple):
    """The master waited for an answer in vain; is_spoilt: damage or noise came in its place."""

    stamp: int                     # when it went on, monotonic ns
    us: int                        # since the end of its question
    device: int                    # the first that did not answer
    is_spoilt: bool
    instruction: int = 0


def _shown(key: str) -> int:
    """Return a counter that starts at 0 and is published under this key."""
    count: int = field(default=0, metadata={'key': key})
    return count


@dataclass(slots=True)
class Counts:
    """
    What happened to a device: since start or reset, or in the last 10 s.

    A new counter is one more line here, and the place that counts.
    """

    answers: int = _shown(keys.ANSWERS)
    missed: int = _shown(keys.MISSED_ANSWERS)
    not_served: int = _shown('Not Served')         # the master gave up before its turn
    damaged: int = _shown('Damaged Answers')       # they failed their CRC
    repaired: int = _shown('Repaired Answers')     # their first header byte was damaged
    refused: int = _shown('Refused Instructions')
    alerts: int = _shown('Alert Answers')          # answers with the alert bit
    writes: int = _shown('Writes')
    reads: int = 0
    eeprom_writes: int = 0
    spoilt: int = 0                # missed answers with damage or noise in their place
    first_byte_lost: int = 0              # answers that only their first byte was missing of (1.0)
    model_changes: int = 0         # how often it said to be another model
    garbled: int = 0               # damage where its answer was due
    fast_answers: int = 0          # its parts of fast replies
    pongs: int = 0                 # answers to Pings
    overlong_replies: int = 0               # bytes came after its answer, or too many in its place
    data_missed: int = 0           # `missed` without the acks: data that it was asked for

    @property
    def asked(self) -> int:
        """How many answers were due."""
        return self.answers + self.missed

    @property
    def loss(self) -> float:
        """The share of answers that were missed, 0 to 1."""
        return self.missed / self.asked if self.asked else 0.0

    def copy(self) -> Counts:
        return Counts(*_values(self))

    def since(self, past: Counts) -> Counts:
        """Return what was counted after `past`, an earlier copy."""
        return Counts(*map(sub, _values(self), _values(past)))

    def published(self) -> dict[str, int]:
        """Return the counters that a status shows, by key."""
        return {key: getattr(self, name) for name, key in _KEYS}


# All counters in order, by one call: twice as fast as one by one.
_values = attrgetter(*(one.name for one in fields(Counts)))
_KEYS = [(one.name, one.metadata['key']) for one in fields(Counts) if one.metadata]


class ReplyLatency(NamedTuple):
    """
    reply_latency (ms): end of the instruction to start of the status.

    resolved: the share of answers of which the chunks tell it, 0 to 1; below 0.2 window and total
    are None.
    """

    window: Summary | None
    total: Summary | None
    resolved: float


class DeviceReport(NamedTuple):
    """
    One device. level and message say the worst about it in a few words.

    | attributes | who writes them |
    |---|---|
    | state, level, message | the doctor; blank until then |
    | all others | Monitor, under its lock |
    """

    id: int
    name: str                      # '011', with the joint name where `devices` gives one
    joint: str                     # '' if none
    protocol: str                  # what it speaks, in words
    model: Model                   # control_table.UNKNOWN until it is learned
    model_number: int | None
    model_name: str                # 'MX-106', or 'unknown', or 'unknown (1234)'
    firmware: int | None
    state: str                     # one of the words above
    level: Level
    message: str
    totals: Counts                 # since start or reset
    window: Counts                 # the last 10 s
    missed_in_a_row: int
    waiting_behind: int | None     # ID of the silent device in front of it
    last_heard_s: float | None     # age of its last answer
    alert: bool                    # the alert bit of its last answer
    last_error: str                # in its last answer: 'Access', 'voltage'; '' if none
    status_return_level: int | None
    acks: bool | None              # whether it acknowledges writes, None while unknown
    acks_missing: int              # writes without an acknowledgement, in a row
    observed: tuple[Observed, ...]
    unobserved: int                # fields of the model that were never seen
    latency: ReplyLatency
    errors: dict[tuple[int, int, int], int]     # (instruction, address, error number): how often
    expected: bool = False         # listed in `devices`
    moved_to: str = ''             # the baud rate or ID that was written to it, in words
    quiet_s: float = 0.0           # neither heard nor asked for so long, while the port was open
    place: bytes | None = None     # Present Position, some time after the report before


class Cycle(NamedTuple):
    """An instruction that the master repeats: what, to whom, its recent periods."""

    instruction: int
    ids: tuple[int, ...]
    address: int | None
    length: int
    asked: int                     # since start
    missed: int                    # answers to it that were missed
    stamps: tuple[int, ...]        # the last 64, monotonic ns


class CycleTimes(NamedTuple):
    """
    The mean cycle of the last 10 s, in ms: cycle is the sum of the others.

    waiting: by device that did not answer; tracer: what strace adds. unknown: why there are no
    parts, '' where there are; is_blurred: waiting includes what the program did after it gave up;
    asleep: of `program`, while an answer may have been there and it did not read it; busy: of
    `program`, CPU time, None where the source does not know it.
    """

    cycle: float
    wire: float = 0.0
    device: float = 0.0
    program: float = 0.0
    tracer: float = 0.0
    waiting: tuple[tuple[int, float], ...] = ()
    is_blurred: bool = False
    unknown: str = ''
    asleep: float = 0.0
    busy: float | None = None


class LineErrors(NamedTuple):
    """Errors that the driver counted on the line since the port was first opened."""

    overrun: int = 0             # the UART's FIFO was full
    buf_overrun: int = 0         # the kernel's buffer was full: we were too late
    frame: int = 0
    parity: int = 0
    breaks: int = 0

    def __add__(self, other: tuple[int, ...]) -> LineErrors:  # type: ignore[override]
        return LineErrors(*(mine + its for mine, its in zip(self, other, strict=True)))

    def since(self, begin: LineErrors) -> LineErrors:
        """Return what came on top of `begin`."""
        return LineErrors(*(max(0, now - then) for now, then in zip(self, begin, strict=True)))


class IdWrite(NamedTuple):
    """An ID that was written, to the devices that had these IDs."""

    number: int                    # the new one
    ids: tuple[int, ...]
    stamp: int
    baud: int                      # the code of Baud Rate, which the same write reached; or -1
    is_locked: bool = False        # Feetech: as far as heard, nothing unlocked the EEPROM
    back: int = 0                  # stamp of the first answer since by one of the old IDs


class BusReport(NamedTuple):
    """
    One bus at one moment.

    | attributes | who writes them |
    |---|---|
    | level, message, findings, doubts | the doctor; blank until then |
    | all others | Monitor; line_errors: the driver of the port |
    """

    name: str
    stamp: int                     # now, monotonic ns
    started: int                   # stamp of the first chunk (0: none yet) or of the reset
    baud: int
    level: Level
    message: str
    devices: tuple[DeviceReport, ...]           # by ID
    counters: dict[str, int]                    # since start or reset
    rates: dict[str, float]                     # per s, last 10 s: bytes, packets, errors
    errors: tuple[Error, ...]                   # the last 50, oldest first
    incidents: tuple[Incident[Any], ...]        # the last 1000, oldest first
    waits: tuple[Wait, ...]                     # vain ones of the master
    cycles: tuple[Cycle, ...]                   # the 32 instructions asked most
    metrics: tuple[Metric, ...]                 # about the bus; per device: DeviceReport.latency
    noise: bytes                                # the last 256 bytes of noise
    last_byte_s: float | None                   # age of the last chunk
    kinds: dict[str, int]                       # incidents by kind, since start or reset
    protocol: str = ''                          # what the bus speaks, in words; '' unheard
    asked: int = 0                              # stamp of the last instruction (0: none yet)
    scanned: tuple[int, ...] = ()               # IDs that were pinged and never heard, if many
    chain: tuple[int, ...] = ()                 # the IDs of `devices`, in the order of the cable
    has_sides: bool = False                     # TX and RX of the master are known apart
    is_over: bool = False                       # the program that asks has ended
    is_closed: bool = False                     # it has closed its port
    id_writes: tuple[IdWrite, ...] = ()         # the last of each new ID
    tried: frozenset[int] = frozenset()         # baud rates of the master, one after the other
    is_answered: bool = True                    # something came to the master, as far as known
    line_mode: int = 0                          # as LINE_MODE says of the program's port
    failed: str = ''                            # how the program that asks ended, if by an error
    users: tuple[str, ...] = ()                 # who else had the port of that program open
    line_errors: LineErrors | None = None       # since start, where the driver counts them
    cycle: CycleTimes | None = None             # where a cycle's time goes
    noise_side: str = UNKNOWN                   # on which side the noise was
    deaf: int = 0                               # stamp of the last report without an open port
    findings: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()            # what the doctor cannot tell, and why
