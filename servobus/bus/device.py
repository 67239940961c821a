# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Device: all that is kept of one device on the bus. Changed by the tracker only.

Counters are bare attributes, because some change with each packet; what a rule of time needs (the
last 10 s) is had from a snapshot per second, so that it costs nothing on the packet path.
"""

from collections import Counter
from collections import deque
from functools import lru_cache

from msg_defs.diagnostics import Level
from msg_defs.dxl1_instruction import Dialect
from msg_defs.dxl1_instruction import error_text as bits_text
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl_instruction import error_text
from msg_defs.running_statistics import Series
from msg_defs.running_statistics import WINDOW_S
from servobus.bus.report import Counts
from servobus.bus.report import DeviceReport
from servobus.bus.report import PROTOCOL_2
from servobus.bus.report import ReplyLatency
from servobus.bus.table import kept_end
from servobus.bus.table import Span
from servobus.bus.table import Table
from servobus.model.control_table import Field
from servobus.model.control_table import Model
from servobus.model.control_table import UNKNOWN
from servobus.model.model_guesses import GOAL_AT
from servobus.model.model_guesses import order_of
from servobus.model.model_guesses import POSITION_AT
from servobus.model.model_guesses import SPEED_AT
from servobus.model.model_guesses import Use
from servobus.model.model_guesses import USE_MAX_BYTES

RESOLVED_MIN_SHARE = 0.2           # the share of answers that makes a latency worth a figure
OWED_REPLY_MAX_NS = 100_000_000    # no servo takes as long: its Return Delay Time ends at 0.5 ms
_ERRORS_KEPT = 64                  # distinct (instruction, address, error)
RETURN_LEVEL = 'Status Return Level'
OFFSET = 'Homing Offset'
TORQUE = 'Torque Enable'
PLACE = 'Present Position'
_SPECIAL = ('ID', 'Baud Rate', RETURN_LEVEL)
_CALIBRATING_REGISTERS = (OFFSET, TORQUE)  # how it is calibrated
_USES_KEPT = 64
_SECOND_REPLY_MAX_NS = 3_000_000   # by Return Delay Time 0.5 ms, and as much as USB adds
UNKNOWN_EEPROM_END = 9             # ID and Baud Rate, in a table that is not known
_MODEL_NUMBER_BYTES = 2


class Device:
    r"""
    One device.

    | attributes | who writes them |
    |---|---|
    | number, joint, expected | DeviceRegistry, where a device is new or an ID was written |
    | model, model_number, firmware, followed_end | DeviceRegistry.resolve(), set_model(): the \
    model that it said it is; no write from followed_end on changes what it is or does |
    | dialect | DeviceRegistry.set_device_dialect(): that of the 1.0 family; None with 2.0 |
    | identity, identity_stamp, is_unresolved | identify(): what it said it is, as bytes; the \
    model of that was not looked up yet |
    | return_level, acks, acks_missing | set_return_level(), accept_ack(), ReplyPolicy; acks: \
    whether it acknowledges writes, None while unknown |
    | heard, alert, is_unusual, missed_in_a_row | DeviceRegistry.accept_status(), Tracker, \
    count_missed(); is_unusual: it was away or had an error, so its next answer needs more than \
    storing |
    | asked_stamp, owed, waiting_behind | count_missed(), count_not_served(), \
    accept_late_reply(); owed: answers that the master gave up lately; waiting_behind: the \
    silent device in front of it in a group read |
    | error_bits | DeviceRegistry.store_error_bits() |
    | last_error, asked_first, latency, latency_resolved | Tracker, with an answer |
    | registered, replaced, moved_to | DeviceRegistry: a Reg Write before its Action; how many to \
    the same register before it; the baud rate that was written, in words |
    | used | record_use(): what a program reads and writes of it while its model is unknown |
    | table, counts, errors, snapshots, place | all who store or count; place: Present Position \
    as it was some time after the last report |
    """

    def __init__(self, number: int, joint: str = '', expected: bool = False) -> None:
        self.number = number                       # its ID
        self.joint = joint
        self.expected = expected
        self.table = Table()
        self.place: bytes | None = None
        self.dialect: Dialect | None = None
        self.identity = b''                        # model number, firmware: as it said, as bytes
        self.identity_stamp = 0
        self.is_unresolved = False
        self.model_number: int | None = None
        self.firmware: int | None = None
        self.registered: tuple[int, bytes, bool] | None = None  # for DeviceRegistry.write()
        self.replaced = 0                          # so many of them in a row
        self.moved_to = ''
        self.used: set[Use] = set()
        self.waiting_behind: int | None = None
        self.alert = False
        self.last_error = 0
        self.error_bits = 0                        # the last answer had these, in the 1.0 family
        self.missed_in_a_row = 0
        self.heard = 0                             # stamp of the last status, 0 = never
        self.asked_stamp = 0                       # when it last did not answer
        self.owed = 0
        self._given_up = -OWED_REPLY_MAX_NS       # when an answer was last given up
        self.is_unusual = True
        self.forget_answering()
        self.reset_statistics()
        self.set_model(UNKNOWN)

    def reset_statistics(self) -> None:
        """Start all counts at 0; what is known of the device and its state stay."""
        self.counts = Counts()
        self.errors: Counter[tuple[int, int, int]] = Counter()
        self.latency = Series()
        self.latency_resolved = 0
        self.asked_first = 0                       # answers that could tell a latency
        self.snapshots: deque[Counts] = deque([Counts()], WINDOW_S)

    def set_model(self, model: Model) -> None:
        """Take on a model; what was seen of the table stays, and may tell the return level."""
        self.model = model
        self._special, self._eeprom_end, self._level_at = _special_of(model)
        self.followed_end = max(self._eeprom_end, self._level_at + 1)
        self.table.limit = kept_end(model)
        level = self.table.bytes(self._level_at, 1) if self._level_at >= 0 else None
        for _, value in self.special_values(self._level_at, level or b''):
            self.set_return_level(value)

    def record_use(self, address: int, size: int) -> None:
        """Note what a program reads or writes of it, where that may say what it is."""
        if self.model_number is None and size <= USE_MAX_BYTES and len(self.used) < _USES_KEPT:
            self.used.add((address, size))

    def all_uses(self) -> frozenset[Use]:
        """Return what a program uses of it, and the order of bytes that makes sense there."""
        if self.dialect is FEETECH:
            seen = self.table.bytes
            self.used |= order_of(seen(POSITION_AT, 2) or seen(SPEED_AT, 2), seen(GOAL_AT, 2))
        return frozenset(self.used)

    def is_defined_by(self, address: int, size: int) -> bool:
        """Return whether these bytes, read, may tell what the device is or does."""
        return (address <= self.identity_at <= address + size - _MODEL_NUMBER_BYTES
                or address <= self._level_at < address + size)

    @property
    def identity_at(self) -> int:
        """The address of Model Number, -1 while that is not known."""
        return self.dialect.identity_at if self.dialect is not None else 0

    @property
    def protocol(self) -> str:
        """What it speaks, as model files call it."""
        return self.dialect.protocol if self.dialect is not None else '2'

    @property
    def error_words(self) -> str:
        """The error in its last answer, in words."""
        return error_text(self.last_error) if self.dialect is None \
            else bits_text(self.error_bits, self.dialect)

    def is_changed_by(self, address: int, size: int) -> bool:
        """Return whether these bytes, written, may change what the device is or does."""
        return address < self._eeprom_end or address <= self._level_at < address + size

    def special_values(self, address: int, data: bytes) -> list[tuple[str, int]]:
        """Return what these bytes say of the registers that are followed: (name, raw)."""
        end = address + len(data)
        return [(field.name, _special_value(field, data[field.at - address:field.end - address]))
                for field in self._special if address <= field.at and field.end <= end]

    def seen_code(self, name: str) -> int | None:
        """Return the raw number that was seen in a register, None while it is unknown."""
        field = self.model.by_name.get(name)
        data = self.table.bytes(field.at, field.size) if field is not None else None
        return None if field is None or data is None else field.code_of(data)

    def accept_pong(self, span: Span, data: bytes, stamp: int, source: int) -> None:
        """Keep the answer to a Ping: model number, firmware version; none in the 1.0 family."""
        self.counts.pongs += 1
        self.identify(data, stamp)

    def identify(self, data: bytes, stamp: int) -> None:
        """Keep what it says it is: model number, firmware version."""
        if data == self.identity or not data:
            return
        if self.identity and data[:2] != self.identity[:2]:
            self.counts.model_changes += 1     # what was seen belongs to another device
            self.table.clear()
        self.identity = data
        self.identity_stamp = stamp
        self.is_unresolved = True              # DeviceRegistry.resolve() makes use of it

    def forget_answering(self) -> None:
        """Forget what it answers: it is another device, or was never heard."""
        self.return_level: int | None = None
        self.acks: bool | None = None
        self.acks_missing = 0

    def set_return_level(self, level: int) -> None:
        """Note what its Status Return Level is."""
        self.return_level = level
        self.acks = level == 2
        self.acks_missing = 0

    def accept_ack(self, *_: object) -> bool:
        """Note that it answered a write; return that, as plan.Take."""
        self.acks = True
        self.acks_missing = 0
        return True

    def count_damaged(self, damaged_ids: set[int], surely: int = 0) -> None:
        """Count damage where its answer was due, surely 1: in that; damaged_ids: it is one."""
        damaged_ids.add(self.number)
        self.counts.garbled += 1
        self.counts.damaged += surely

    def count_missed(self, now: int, stamp: int, doubtful: bool) -> None:
        """Count an answer that did not come, or perhaps came damaged; stamp: of the chunk."""
        self.counts.missed += 1
        self.counts.spoilt += doubtful
        self.missed_in_a_row += 1
        self._owe(stamp, not doubtful)
        self.asked_stamp = now
        self.waiting_behind = None
        self.is_unusual = True

    def count_not_served(self, now: int, stamp: int, blocker: int) -> None:
        """Count an answer whose turn did not come: the master gave up at the one before."""
        self.counts.not_served += 1
        self._owe(stamp)
        self.asked_stamp = now
        self.waiting_behind = blocker
        self.is_unusual = True

    def accept_late_reply(self, stamp: int, late_ns: int = OWED_REPLY_MAX_NS) -> bool:
        """Take an answer that is not due: whether one that was given up lately is still owed."""
        if not self.owed or stamp - self._given_up >= late_ns:
            return False
        self.owed -= 1
        return True

    def has_just_answered(self, stamp: int) -> bool:
        """Return whether all its answers have come, the last just now: a next one is another's."""
        return not self.owed and stamp - self.heard < _SECOND_REPLY_MAX_NS

    def _owe(self, stamp: int, answers: int = 1) -> None:
        # Stamps of chunks: the time on the wire is only as good as the chunk is short.
        self.owed = (self.owed if stamp - self._given_up < OWED_REPLY_MAX_NS else 0) + answers
        self._given_up = stamp

    def count_refusal(self, instruction: int, address: int, error: int) -> None:
        self.counts.refused += 1
        key = (instruction, address, error)
        if key in self.errors or len(self.errors) < _ERRORS_KEPT:
            self.errors[key] += 1

    def keep_place(self) -> None:
        """Keep where the joint is, for the next report."""
        field = self.model.by_name.get(PLACE)
        self.place = self.table.bytes(field.at, field.size) if field is not None else None

    def window(self) -> Counts:
        """Return what happened in the last 10 s (up to a second less)."""
        return self.counts.since(self.snapshots[0])

    def latency_report(self, now: int) -> ReplyLatency:
        resolved = self.latency_resolved / self.asked_first if self.asked_first else 0.0
        if resolved < RESOLVED_MIN_SHARE:
            return ReplyLatency(None, None, resolved)
        return ReplyLatency(self.latency.summary(now), self.latency.total(), resolved)


def report_device(device: Device, now: int, quiet_s: float) -> tuple[DeviceReport, Table]:
    """Return what is known of a device, and a copy of its table: that is decoded later."""
    model = device.model
    name = model.name
    place, device.place = device.place, None
    if model.number is None:           # a layout by use has a name
        name = 'unknown' if model is UNKNOWN else f'unknown (as {name})'
        name = name if device.model_number is None else f'unknown ({device.model_number})'
    return DeviceReport(
        id=device.number, name=f'{device.number:03} {device.joint}'.rstrip(), joint=device.joint,
        protocol=device.dialect.name if device.dialect is not None else PROTOCOL_2,
        model=model, model_number=device.model_number, model_name=name, firmware=device.firmware,
        state='', level=Level.OK, message='', totals=device.counts.copy(),
        window=device.window(), missed_in_a_row=device.missed_in_a_row,
        waiting_behind=device.waiting_behind,
        last_heard_s=(now - device.heard) / 1e9 if device.heard else None, alert=device.alert,
        last_error=device.error_words, status_return_level=device.return_level,
        acks=device.acks, acks_missing=device.acks_missing, observed=(), unobserved=0,
        latency=device.latency_report(now), errors=dict(device.errors), expected=device.expected,
        moved_to=device.moved_to, quiet_s=quiet_s, place=place), device.table.copy()


@lru_cache(maxsize=256)
def _special_of(model: Model) -> tuple[list[Field], int, int]:
    """Return the registers to follow; where those in EEPROM end; where Status Return Level is."""
    names = _SPECIAL + (_CALIBRATING_REGISTERS if model.protocol == FEETECH.protocol else ())
    special = [field for name in names if (field := model.by_name.get(name)) is not None]
    ends = [field.end for field in special if field.name != RETURN_LEVEL]
    ends += [field.end for field in model.fields
             if field.memory == 'eeprom' and 'w' in field.access]
    level_at = next((field.at for field in special if field.name == RETURN_LEVEL), -1)
    return special, max(ends, default=UNKNOWN_EEPROM_END), level_at


def _special_value(field: Field, raw: bytes) -> int:
    """Return the code; of a return level that counts otherwise: that of Dynamixel."""
    number = field.decode(raw).number if field.name == RETURN_LEVEL else None
    return field.code_of(raw) if number is None else int(number)
