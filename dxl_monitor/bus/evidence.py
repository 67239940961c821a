# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Rare things seen on a bus, kept for the error log and for the doctor; bounded in every way.

The tracker notes what happened, never why: causes are the doctor's.
What happens with each packet is a counter of the device, not an incident.
"""

from collections import Counter
from collections import deque
from collections.abc import Callable
from functools import partial

from dxl_monitor.bus.report import Error
from dxl_monitor.bus.report import Incident
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import STATUS

NO_DEVICE = -1
Register = Callable[[int, int], str]        # what a device calls the register at an address

# Kinds of incidents, each with what its detail holds.
DAMAGED_STATUS = 'damaged status'              # instruction byte as read, length as read
DAMAGED_INSTRUCTION = 'damaged instruction'    # instruction byte as read, length as read
BAD_LENGTH = 'bad length'                      # length
CUT = 'cut'                                    # instruction byte, length: it ends too early
GLITCH = 'glitch'                              # counted only: a byte or two of noise ahead
MISSED = 'missed'                              # instruction, address; the first of a row
DISCONNECTED = 'disconnected'                  # missed in a row
RETURNED = 'returned'                          # ms of silence, Torque Enable before (-1 unknown)
REFUSED = 'refused'                            # instruction, address, error number
ALERT = 'alert'                                # it began
SECOND_ANSWER = 'second answer'                # instruction: already answered by this ID
ANSWERED_AGAIN = 'answered again'              # instruction; behind damage that hid another
UNASKED = 'unasked answer'                     # instruction that ran, error byte
LATE = 'late answer'                           # us after its instruction was given up
WRONG_SIZE = 'wrong size'                      # bytes, bytes asked for
FAST_CUT = 'fast reply cut'                    # blocks that came, blocks asked for
REPEATED = 'repeated'                          # instruction, us after the first (an echo: 0)
UNSTUFFED = 'unstuffed'                        # instruction: FF FF FD without its FD
MODEL = 'model changed'                        # number before, number now
ID_WRITTEN = 'ID written'                      # new ID
BAUD_WRITTEN = 'Baud Rate written'             # code
OPEN = 'undecided packet'                      # code byte: an instruction or a status (1.0)
CALIBRATED = 'calibrated'                      # nothing: the present position became the middle
REBOOTED = 'rebooted'                          # instruction
ACKS_STOPPED = 'acks stopped'                  # writes without an answer
UNKNOWN_INSTRUCTION = 'unknown instruction'    # instruction
MALFORMED = 'malformed'                        # instruction, parameter bytes
BAD_ID = 'bad id'                              # ID of a status, or of an instruction
PROTOCOL_1 = 'protocol 1.0'                    # instruction byte
ECHO = 'echo'                                  # counted only: the master's own, heard back
FOREIGN = 'foreign instruction'                # instruction: it came to the master
NOT_SENT = 'not sent'                          # instruction
SOURCE_LOST = 'source lost'                    # events or bytes

_KEPT = 1000
_APART_NS = 100_000_000             # between two that are kept, where each packet may be one
_ERRORS_KEPT = 50
_WAITS_KEPT = 256

# The lines of the error log; what is not listed here is no error. at(address) is the
# name of a register, or its address.
_TEXTS: dict[str, Callable[[tuple[int, ...], Callable[[int], str]], str]] = {
    DAMAGED_STATUS: lambda d, at: 'status with a wrong CRC',
    DAMAGED_INSTRUCTION: lambda d, at: f'{name_of(d[0])} with a wrong CRC',
    BAD_LENGTH: lambda d, at: f'packet with Length {d[0]}',
    CUT: lambda d, at: f'{name_of(d[0])} that ends before its Length of {d[1]}',
    MISSED: lambda d, at: f'no answer to {name_of(d[0])}' + (
        f' at {at(d[1])}' if d[1] >= 0 else ''),
    DISCONNECTED: lambda d, at: f'disconnected: {d[0]} answers missed',
    REFUSED: lambda d, at: f'{name_of(d[0])} at {at(d[1])} refused: {error_text(d[2])}',
    ALERT: lambda d, at: 'alert',
    SECOND_ANSWER: lambda d, at: f'second answer to one {name_of(d[0])}',
    UNASKED: lambda d, at: 'answer that was not asked for',
    LATE: lambda d, at: f'answer {d[0]} us too late',
    WRONG_SIZE: lambda d, at: f'answer of {d[0]} bytes to a read of {d[1]}',
    FAST_CUT: lambda d, at: f'fast reply ends after {d[0]} of {d[1]} devices',
    UNKNOWN_INSTRUCTION: lambda d, at: f'unknown {name_of(d[0])}',
    MALFORMED: lambda d, at: f'{name_of(d[0])} that makes no sense ({d[1]} bytes)',
    BAD_ID: lambda d, at: f'packet with ID {d[0]}',
    FOREIGN: lambda d, at: f'{name_of(d[0])} of another master',
    NOT_SENT: lambda d, at: f'{name_of(d[0])} that did not leave the adapter',
    SOURCE_LOST: lambda d, at: f'{d[0]} events or bytes that were not heard',
}


class Evidence:
    """What was noted on one bus."""

    __slots__ = ('_errors', '_incidents', '_kept', '_waits', 'counts', 'noted')

    def __init__(self) -> None:
        self._incidents: deque[Incident] = deque(maxlen=_KEPT)
        self._errors: deque[Incident] = deque(maxlen=_ERRORS_KEPT)
        self._waits: deque[tuple[int, int, int]] = deque(maxlen=_WAITS_KEPT)
        self.counts: Counter[str] = Counter()          # by kind, since start
        self._kept: dict[str, int] = {}                # stamp of the last that note_often() kept
        self.noted = 0                                 # incidents so far

    def note(self, stamp: int, kind: str, device: int = NO_DEVICE, *detail: int) -> None:
        incident = Incident(stamp, kind, device, detail)
        self._incidents.append(incident)
        self.counts[kind] += 1
        self.noted += 1
        if kind in _TEXTS:
            self._errors.append(incident)

    def note_damage(self, stamp: int, reason: str, device: int, instruction: int,
                    length: int) -> None:
        """Note a damaged frame with its fields as they were read; reason: of its Flaw."""
        if reason == 'length':
            self.note(stamp, BAD_LENGTH, NO_DEVICE, length)
        elif reason == 'cut':
            self.note(stamp, CUT, NO_DEVICE, instruction, length)
        else:
            self.note(stamp, DAMAGED_STATUS if instruction == STATUS else DAMAGED_INSTRUCTION,
                      device, instruction, length)

    def note_often(self, stamp: int, kind: str, device: int, *detail: int) -> None:
        """Note what may come with each packet: counted each time, kept once in a while."""
        if stamp - self._kept.get(kind, -_APART_NS) >= _APART_NS:
            self._kept[kind] = stamp
            self.note(stamp, kind, device, *detail)
        else:
            self.counts[kind] += 1

    def note_wait(self, stamp: int, wait_us: int, device: int) -> None:
        """Keep how long the master waited for an answer before it went on."""
        self._waits.append((stamp, wait_us, device))

    def look_at_noise(self, noise: bytes, fresh: int, stamp: int) -> None:
        """Look for packets of Protocol 1.0 that end in the last `fresh` bytes of noise."""
        for at, end in _protocol_1(noise):
            if end > len(noise) - fresh:
                self.note(stamp, PROTOCOL_1, noise[at + 2], noise[at + 4])

    def newest(self, count: int) -> tuple[Incident, ...]:
        """Return the last incidents, oldest first."""
        count = min(count, len(self._incidents))
        return tuple(self._incidents[index] for index in range(-count, 0))

    def incidents(self) -> tuple[Incident, ...]:
        return tuple(self._incidents)

    def waits(self) -> tuple[tuple[int, int, int], ...]:
        return tuple(self._waits)

    def errors(self, register: Register) -> tuple[Error, ...]:
        """Return the error log, the oldest line first."""
        return tuple(Error(incident.stamp, _line(incident, register))
                     for incident in self._errors)


def text_of(incident: Incident, register: Register = lambda device, address: str(address)) -> str:
    """Return what happened in words, without the device; '' for what is not an error."""
    text = _TEXTS.get(incident.kind)
    return text(incident.detail, partial(register, incident.device)) if text is not None else ''


def _line(incident: Incident, register: Register) -> str:
    text = text_of(incident, register)
    return text if incident.device < 0 else f'{incident.device:03}: {text}'


def _protocol_1(data: bytes) -> list[tuple[int, int]]:
    """
    Return where packets of Protocol 1.0 begin and end.

    They are FF FF, ID, length, instruction, parameters, checksum.
    """
    found = []
    at = data.find(b'\xff\xff')
    while 0 <= at < len(data) - 5:
        end = at + 4 + data[at + 3]
        if (data[at + 2] < 0xFD and 2 <= data[at + 3] <= 0x40 and end <= len(data)
                and sum(data[at + 2:end]) & 0xFF == 0xFF):
            found.append((at, end))
            at = end - 1
        at = data.find(b'\xff\xff', at + 1)
    return found
