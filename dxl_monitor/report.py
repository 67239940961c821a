# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a bus monitor knows at one moment: plain values, safe to use without any lock.

Made by Monitor.report(now); published by node.py, judged by doctor.py, shown by the dashboard and
the terminal. Keys of counters are spelt as a user reads them, unit in the key.
"""

from typing import NamedTuple

from dxl_monitor.control_table import Model
from dxl_monitor.table import Observed
from dxl_monitor.tap_driver import LineErrors
from msg_defs.reports import Level
from msg_defs.reports import Metric
from msg_defs.timing import Summary

# State words of a device.
CONNECTED = 'connected'
DISCONNECTED = 'disconnected'      # more answers missed in a row than missed_limit
SILENT = 'silent'                  # nobody asked it and it said nothing for silent_after
EXPECTED = 'expected'              # listed in `devices`, never heard
ASKED = 'asked'                    # addressed by the master, never heard, not listed
WAITING = 'waiting'                # asked, but behind a silent device in the same Sync Read
MOVED = 'moved'                    # its Baud Rate was written: not on this bus any more


class Error(NamedTuple):
    """One line of the error log; stamp in monotonic ns."""

    stamp: int
    text: str


class Finding(NamedTuple):
    """A named cause, from the doctor; device None = the bus."""

    rule: str
    level: Level
    device: int | None
    message: str                   # what a person does about it
    evidence: tuple[tuple[str, str], ...] = ()


class Incident(NamedTuple):
    """A rare event for the doctor; kinds are in evidence.py; device -1 = nobody in particular."""

    stamp: int
    kind: str
    device: int
    detail: tuple[int, ...]


class Window(NamedTuple):
    """What happened to a device in the last 10 s."""

    asked: int                     # = answers + missed
    answers: int
    missed: int
    not_served: int
    damaged: int                   # its answers that failed their CRC
    alerts: int
    loss: float                    # missed / asked, 0 to 1
    spoilt: int = 0                # of the missed: with damage or noise in their place
    repaired: int = 0              # answers with a damaged first header byte
    glitches: int = 0              # answers with a byte or two of noise in front
    writes: int = 0
    eeprom_writes: int = 0
    model_changes: int = 0


class Latency(NamedTuple):
    """
    reply_latency (ms): end of the instruction to start of the status.

    resolved: the share of answers of which the chunks tell it, 0 to 1; below 0.2 window and total
    are None.
    """

    window: Summary | None
    total: Summary | None
    resolved: float


class DeviceReport(NamedTuple):
    """One device. level and message say the worst about it in a few words."""

    id: int
    name: str                      # '011', with the joint name where `devices` gives one
    joint: str                     # '' if none
    model: Model                   # control_table.UNKNOWN until it is learned
    model_number: int | None
    model_name: str                # 'MX-106', or 'unknown', or 'unknown (1234)'
    firmware: int | None
    state: str                     # one of the words above
    level: Level
    message: str
    counters: tuple[tuple[str, float], ...]     # since start: ('Answers', 123), ...
    totals: Window                 # since start or reset
    window: Window                 # the last 10 s
    missed_in_a_row: int
    waiting_behind: int | None     # ID of the silent device in front of it
    last_heard_s: float | None     # age of its last answer
    alert: bool                    # the alert bit of its last answer
    last_error: str                # of its last answer: 'Access'; '' if none
    status_return_level: int | None
    acks: bool | None              # whether it acknowledges writes, None while unknown
    acks_missing: int              # writes without an acknowledgement, in a row
    observed: tuple[Observed, ...]
    unobserved: int                # fields of the model that were never seen
    latency: Latency
    errors: dict[tuple[int, int, int], int]     # (instruction, address, error number): how often
    reads: int                     # accesses by the master since start
    writes: int
    eeprom_writes: int
    model_changes: int             # how often it said to be another model
    repaired: int                  # its answers with a damaged first header byte
    glitches: int                  # its answers with a byte or two of noise in front


class Cycle(NamedTuple):
    """An instruction that the master repeats: what, to whom, its recent periods."""

    instruction: int
    ids: tuple[int, ...]
    address: int | None
    length: int
    asked: int                     # since start
    missed: int                    # answers to it that were missed
    stamps: tuple[int, ...]        # of the last 64, monotonic ns


class BusReport(NamedTuple):
    """One bus at one moment."""

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
    incidents: tuple[Incident, ...]             # the last 1000, oldest first
    waits: tuple[tuple[int, int, int], ...]     # vain ones of the master: stamp, us, device
    cycles: tuple[Cycle, ...]                   # the 32 instructions asked most
    metrics: tuple[Metric, ...]                 # of the bus; per device: DeviceReport.latency
    noise: bytes                                # the last 256 bytes of noise
    last_byte_s: float | None                   # age of the last chunk
    kinds: dict[str, int]                       # incidents by kind, since start or reset
    chain: tuple[int, ...] = ()                 # the IDs of `devices`, in the order of the cable
    line_errors: LineErrors | None = None       # since start, where the driver counts them
    findings: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()            # what the doctor cannot tell, and why
