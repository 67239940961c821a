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
from itertools import islice
from operator import attrgetter
from typing import Any
from typing import NamedTuple

from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl_instruction import error_text
from msg_defs.dxl_instruction import name_of
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import is_good
from msg_defs.servo_frame import IS_STATUS
from msg_defs.servo_frame import OPEN
from servobus.bus.report import Error
from servobus.bus.report import Incident
from servobus.bus.report import IncidentKind
from servobus.bus.report import Wait

NO_DEVICE = -1
RegisterNamer = Callable[[int, int], str]        # what a device calls the register at an address


# --- what is known of an incident besides its device -------------------------------------------

class NoDetail(NamedTuple):
    """That it happened is all."""


class Code(NamedTuple):
    """The instruction byte: of the packet itself, or of the instruction that was pending."""

    instruction: int


class PacketHeader(NamedTuple):
    """The instruction byte and the Length of a packet, as they were read."""

    instruction: int
    length: int


class Length(NamedTuple):
    """The Length of a packet, which none can have."""

    length: int


class Unanswered(NamedTuple):
    """What was asked; address -1: of none."""

    instruction: int
    address: int


class Refusal(NamedTuple):
    """What was refused, and the error number of the answer."""

    instruction: int
    address: int
    error: int


class Repetition(NamedTuple):
    """An instruction, so many us after the first one (an echo: 0)."""

    instruction: int
    us: int


class SilentFor(NamedTuple):
    """ms of silence; torque: Torque Enable before it, -1 unknown; answers missed in a row."""

    ms: int
    torque: int
    missed: int


class Lateness(NamedTuple):
    """us after the end of the pending instruction."""

    us: int


class Sizes(NamedTuple):
    """How much came and how much was asked for: bytes, or the parts of a fast reply."""

    got: int
    wanted: int


class Count(NamedTuple):
    """A number: of answers missed in a row, of bytes or events lost; an ID, an errno."""

    number: int


class Offsets(NamedTuple):
    """Homing Offset of Feetech, raw: now, and before; Present Position before it, 0 unknown."""

    now: int
    before: int
    place: int


class Written(NamedTuple):
    """What was written, or an ID that none can have."""

    value: int


# --- kinds of incidents, each with what is known of it -----------------------------------------

DAMAGED_STATUS = IncidentKind('damaged status', PacketHeader)
DAMAGED_INSTRUCTION = IncidentKind('damaged instruction', PacketHeader)
BAD_LENGTH = IncidentKind('bad length', Length)
CUT = IncidentKind('cut', PacketHeader)                              # it ends too early
GLITCH = IncidentKind('glitch', NoDetail)                      # counted only: a byte or two ahead
MISSED = IncidentKind('missed', Unanswered)                     # the first of a row
DISCONNECTED = IncidentKind('disconnected', Count)
RETURNED = IncidentKind('returned', SilentFor)
REFUSED = IncidentKind('refused', Refusal)
ALERT = IncidentKind('alert', NoDetail)                        # it began
SECOND_ANSWER = IncidentKind('second answer', Code)           # already answered by this ID
ANSWERED_AGAIN = IncidentKind('answered again', Code)         # after damage that hid another
UNASKED = IncidentKind('unasked answer', NoDetail)
LATE = IncidentKind('late answer', Lateness)
TOO_LONG = IncidentKind('noise too long', Sizes)              # for all answers that were due
WRONG_SIZE = IncidentKind('wrong size', Sizes)
FAST_CUT = IncidentKind('fast reply cut', Sizes)
REPEATED = IncidentKind('repeated', Repetition)
UNSTUFFED = IncidentKind('unstuffed', Code)                   # FF FF FD without its FD
BAUD_WRITTEN = IncidentKind('Baud Rate written', Written)     # the code
LOCKED = IncidentKind('locked', Written)                      # EEPROM; the address
UNDECIDED_PACKET = IncidentKind('undecided packet', Code)     # an instruction or a status (1.0)
CALIBRATED = IncidentKind('calibrated', NoDetail)              # the position became the middle
OFFSET_WRITTEN = IncidentKind('offset written', Offsets)       # Homing Offset of Feetech
REBOOTED = IncidentKind('rebooted', NoDetail)
REPLACED = IncidentKind('Reg Write replaced', Count)     # in a row, before an Action
ACKS_STOPPED = IncidentKind('acks stopped', Count)
UNKNOWN_INSTRUCTION = IncidentKind('unknown instruction', Code)
MALFORMED = IncidentKind('malformed', PacketHeader)                  # length: parameter bytes
BAD_ID = IncidentKind('bad id', Written)                      # in a status, or in an instruction
PROTOCOL_1 = IncidentKind('protocol 1.0', Code)
ECHO = IncidentKind('echo', NoDetail)                          # counted only: the master's
FOREIGN = IncidentKind('foreign instruction', Code)           # it came to the master
READ_BY_ADAPTER = IncidentKind('read by the adapter', NoDetail)      # counted only: its status
UNKNOWN_ANSWERED = IncidentKind('unknown instruction answered', NoDetail)      # counted only
NOT_SENT = IncidentKind('not sent', Code)
THROWN_AWAY = IncidentKind('answers thrown away', Code)       # unread
WRONG_PACKET = IncidentKind('wrong packet', Code)             # the master's: none takes it
HUNG = IncidentKind('question never given up', Lateness)
RETURN_ADDED = IncidentKind('sent with 0D before 0A', Code)   # by the driver of the port
SPLIT = IncidentKind('answer read in part', NoDetail)          # the program asked before its end
TAKEN_FOR = IncidentKind('taken for another', Count)   # the ID that answered; asked on at once
NOT_TAKEN = IncidentKind('not taken at once', NoDetail)         # counted only: the same, later
STUFFED = IncidentKind('stuffing left unread', NoDetail)       # as many bytes as that added
STALE = IncidentKind('stale answers', NoDetail)                # it reads those, not the new ones
SESSION_UNANSWERED = IncidentKind('vain session', NoDetail)    # from opening to closing
SESSION_ANSWERED_LATE = IncidentKind('answered later', NoDetail)     # asked long after the opening
SESSION_ANSWERED = IncidentKind('answered soon', NoDetail)     # counted only
PORT_LOST = IncidentKind('port lost', Count)                   # the errno
SOURCE_LOST = IncidentKind('source lost', Count)
LEFT_OPEN = IncidentKind('last question open', Lateness)      # it ended too soon to know

_INCIDENTS_KEPT = 1000
_STUFFED = b'\xff\xff\xfd\xfd'
_LENGTH_END = 3                    # in a damaged frame: its ID and Length
_FREQUENT_APART_NS = 100_000_000   # between two that are kept, where each packet may be one
_ERRORS_KEPT = 50
WAITS_KEPT = 256
NOISE_DATA_END = 63                # parameters: noise with more of them is no packet

# The lines of the error log; what is not listed here is not an error. {place}: at which
# register, nothing where the instruction names none.
_TEXTS: dict[str, str] = {
    DAMAGED_STATUS: 'status with a wrong CRC or checksum',
    DAMAGED_INSTRUCTION: '{instruction} with a wrong CRC or checksum',
    BAD_LENGTH: 'packet with Length {length}',
    CUT: '{instruction} that ends before its Length of {length}',
    MISSED: 'no answer to {instruction}{place}',
    DISCONNECTED: 'disconnected: {number} answers missed',
    REFUSED: '{instruction}{place} refused: {error}',
    ALERT: 'alert',
    SECOND_ANSWER: 'second answer to one {instruction}',
    UNASKED: 'answer that was not asked for',
    LATE: 'answer {us} us too late',
    WRONG_SIZE: 'answer of {got} bytes to a read of {wanted}',
    FAST_CUT: 'fast reply ends after {got} of {wanted} devices',
    UNKNOWN_INSTRUCTION: 'unknown {instruction}',
    MALFORMED: '{instruction} that makes no sense ({length} bytes)',
    BAD_ID: 'packet with ID {value}',
    WRONG_PACKET: '{instruction} with a wrong CRC, checksum or Length',
    FOREIGN: '{instruction} of another master',
    RETURN_ADDED: '{instruction} that the driver sent with 0D before 0A',
    NOT_SENT: '{instruction} that did not leave the adapter',
    PORT_LOST: 'the program lost its port: error {number}',
    SOURCE_LOST: '{number} events or bytes that were not heard',
}


class Evidence:
    """What was noted on one bus."""

    def __init__(self) -> None:
        self.incidents: deque[Incident[Any]] = deque(maxlen=_INCIDENTS_KEPT)
        self._errors: deque[Incident[Any]] = deque(maxlen=_ERRORS_KEPT)
        self.waits: deque[Wait] = deque(maxlen=WAITS_KEPT)
        self.counts: Counter[str] = Counter()          # by kind, since start
        self.has_echo = False                  # the master hears itself
        self._kept: dict[str, int] = {}  # stamp of the last that add_frequent() kept
        self.incidents_added = self.waits_added = 0                   # incidents and waits so far

    def add_incident(self, stamp: int, kind: IncidentKind[Any], device: int,
                     *detail: int) -> None:
        """Note an incident; detail: the fields of what is known of each of its kind."""
        incident = Incident(stamp, kind, device, kind.detail(*detail))
        self.incidents.append(incident)
        self.counts[kind] += 1
        self.incidents_added += 1
        if kind in _TEXTS:
            self._errors.append(incident)

    def add_wait(self, wait: Wait) -> None:
        self.waits.append(wait)
        self.waits_added += 1

    def add_frequent(self, stamp: int, kind: IncidentKind[Any], device: int,
                     *detail: int) -> None:
        """Note what may come with each packet: counted each time, kept once in a while."""
        if stamp - self._kept.get(kind, -_FREQUENT_APART_NS) >= _FREQUENT_APART_NS:
            self._kept[kind] = stamp
            self.add_incident(stamp, kind, device, *detail)
        else:
            self.counts[kind] += 1

    def add_damage(self, stamp: int, frame: Frame, flaw: Flaw, side: str) -> None:
        """Note a damaged frame, or one of which it is open what it is; what goes out is whole."""
        _, _, kind, number, code, _, _ = frame
        code = STATUS if kind == IS_STATUS else code
        if flaw.reason == OPEN:
            self.add_incident(stamp, UNDECIDED_PACKET, number, code)
        elif side == OUT:
            # One FF more in front is ID 255 of the 1.0 family, taken for a header.
            number = 0xFF if flaw.noise_length == 1 else number
            self.add_incident(stamp, WRONG_PACKET, number, code)
        elif flaw.reason == 'length':
            self.add_incident(stamp, BAD_LENGTH, NO_DEVICE, flaw.length)
        elif flaw.reason == 'cut':
            self.note_stuffed(stamp, frame, flaw, side)
            self.add_incident(stamp, CUT, NO_DEVICE, code, flaw.length)
        else:
            damaged = DAMAGED_STATUS if kind == IS_STATUS else DAMAGED_INSTRUCTION
            self.add_incident(stamp, damaged, number, code, flaw.length)

    def note_stuffed(self, stamp: int, frame: Frame, flaw: Flaw, side: str) -> None:
        """Note an answer of which the program left as many bytes as byte stuffing had added."""
        body, added = frame[5], frame[5].count(_STUFFED)
        if side == IN and 0 < added == flaw.length + _LENGTH_END - len(body):
            self.add_incident(stamp, STUFFED, frame[3])

    def search_noise(self, noise: bytes, fresh: int, stamp: int) -> None:
        """Search for packets of Protocol 1.0 that end in the last `fresh` bytes of noise."""
        framer = Dxl1Framer()
        for frame in framer.frames(noise) + framer.flush_frames():
            _, end, _, number, code, data, _ = frame
            if is_good(frame) and end > len(noise) - fresh and number < BROADCAST - 1 \
                    and len(data) < NOISE_DATA_END:
                self.add_incident(stamp, PROTOCOL_1, number, code)

    def newest_incidents(self, count: int) -> tuple[Incident[Any], ...]:
        """Return the last incidents, oldest first."""
        return tuple(islice(reversed(self.incidents), count))[::-1]

    def errors(self, register: RegisterNamer) -> tuple[Error, ...]:
        """Return the error log, the oldest line first: what is noted later may be older."""
        return tuple(Error(incident.stamp, _line(incident, register))
                     for incident in sorted(self._errors, key=attrgetter('stamp')))


def text_of(incident: Incident[Any],
            register: RegisterNamer = lambda device, address: str(address)) -> str:
    """Return what happened in words, without the device; '' for what is not an error."""
    words = incident.detail._asdict()
    if 'instruction' in words:
        words['instruction'] = name_of(words['instruction'])
    if 'error' in words:
        words['error'] = error_text(words['error'])
    address = words.get('address', -1)
    place = f' at {register(incident.device, address)}' if address >= 0 else ''
    return _TEXTS.get(incident.kind, '').format(**words, place=place)


def _line(incident: Incident[Any], register: RegisterNamer) -> str:
    text = text_of(incident, register)
    return text if incident.device < 0 else f'{incident.device:03}: {text}'
