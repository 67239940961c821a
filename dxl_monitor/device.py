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

from dxl_monitor.control_table import Model
from dxl_monitor.control_table import UNKNOWN
from dxl_monitor.report import Latency
from dxl_monitor.report import Window
from dxl_monitor.table import size_of
from dxl_monitor.table import Table
from msg_defs.timing import Series

WINDOW_S = 10
RESOLVED_NEEDED = 0.2              # of the answers, for a latency that is worth a figure
_ERRORS_KEPT = 64                  # distinct (instruction, address, error)
EVERYWHERE = 1 << 16                # an eeprom_end behind every address
RETURN_LEVEL = 'Status Return Level'
_SPECIAL = ('ID', 'Baud Rate', RETURN_LEVEL)


class Device:
    """
    One device. `odd`: the next answer needs more than storing (it was away, or had an alert).

    `acks`: whether it acknowledges writes, None while unknown; `moved`: the Baud Rate code that
    was written to it; `waiting_behind`: the silent device in front of it in a Sync or Bulk Read.
    """

    __slots__ = (
        '_special', 'acks', 'acks_missing', 'alert', 'alerts', 'answers', 'asked_first',
        'asked_stamp', 'damaged', 'eeprom_end', 'eeprom_writes', 'errors', 'expected', 'firmware',
        'glitches', 'heard', 'identity', 'identity_stamp', 'joint', 'last_error', 'latency',
        'latency_resolved', 'level_at', 'missed', 'missed_in_a_row', 'model', 'model_changes',
        'model_number', 'moved', 'not_served', 'number', 'odd', 'reads', 'registered', 'repaired',
        'return_level', 'snapshots', 'spoilt', 'table', 'waiting_behind', 'writes')

    def __init__(self, number: int, joint: str = '', expected: bool = False) -> None:
        self.number = number                       # its ID
        self.joint = joint
        self.expected = expected
        self.table = Table()
        self.identity = b''                        # model number, firmware: as it said, as bytes
        self.identity_stamp = 0
        self.model_number: int | None = None
        self.firmware: int | None = None
        self.acks: bool | None = None
        self.acks_missing = 0
        self.return_level: int | None = None
        self.registered: tuple[int, bytes, bool] | None = None     # as Roster.write() takes it
        self.moved: int | None = None
        self.waiting_behind: int | None = None
        self.alert = False
        self.last_error = 0
        self.missed_in_a_row = 0
        self.heard = 0                             # stamp of the last status, 0 = never
        self.asked_stamp = 0                      # of the last time it was asked in vain
        self.odd = True
        self.reset_statistics()
        self.become(UNKNOWN)

    def reset_statistics(self) -> None:
        """Start all counts anew; what is known of the device and its state stay."""
        self.answers = 0
        self.missed = 0
        self.not_served = 0
        self.damaged = 0
        self.spoilt = 0                            # missed, with damage or noise in their place
        self.repaired = 0                          # its answers with a damaged first byte
        self.glitches = 0                          # its answers with a byte or two of noise ahead
        self.alerts = 0
        self.reads = 0
        self.writes = 0
        self.eeprom_writes = 0
        self.model_changes = 0
        self.errors: Counter[tuple[int, int, int]] = Counter()
        self.latency = Series(WINDOW_S)
        self.latency_resolved = 0
        self.asked_first = 0                       # answers that could tell a latency
        self.snapshots: deque[tuple[int, ...]] = deque([self._counts()], WINDOW_S)

    def become(self, model: Model) -> None:
        """Take on a model; what was seen of the table stays."""
        self.model = model
        self._special, self.eeprom_end, self.level_at = _special_of(model)
        self.table.limit = size_of(model)

    def special_values(self, address: int, data: bytes) -> list[tuple[str, int]]:
        """Return what these bytes say of ID, Baud Rate and Status Return Level: (name, raw)."""
        return [(name, int.from_bytes(data[at - address:end - address], 'little'))
                for name, at, end in self._special if address <= at and end <= address + len(data)]

    def set_return_level(self, level: int) -> None:
        """Note what its Status Return Level is."""
        self.return_level = level
        self.acks = level == 2
        self.acks_missing = 0

    @property
    def unresolved(self) -> bool:
        """Whether it said what it is, and nobody has looked up the model yet."""
        return self.eeprom_end == EVERYWHERE

    def miss(self, now: int, doubtful: bool) -> None:
        """Count an answer that did not come, or perhaps came damaged."""
        self.missed += 1
        self.missed_in_a_row += 1
        self.spoilt += doubtful
        self.asked_stamp = now
        self.waiting_behind = None
        self.odd = True

    def note_error(self, instruction: int, address: int, error: int) -> None:
        key = (instruction, address, error)
        if key in self.errors or len(self.errors) < _ERRORS_KEPT:
            self.errors[key] += 1

    def tick(self) -> None:
        """Take the snapshot of a second."""
        self.snapshots.append(self._counts())

    def totals(self) -> Window:
        return _window(self._counts())

    def window(self) -> Window:
        """Return what happened in the last 10 s (up to a second less)."""
        now = self._counts()
        return _window(tuple(n - past for n, past in zip(now, self.snapshots[0], strict=True)))

    def latency_report(self, now: int) -> Latency:
        resolved = self.latency_resolved / self.asked_first if self.asked_first else 0.0
        if resolved < RESOLVED_NEEDED:
            return Latency(None, None, resolved)
        return Latency(self.latency.summary(now), self.latency.total(), resolved)

    def _counts(self) -> tuple[int, ...]:
        return (self.answers, self.missed, self.not_served, self.damaged, self.alerts,
                self.spoilt, self.repaired, self.glitches, self.writes, self.eeprom_writes,
                self.model_changes)


@lru_cache(maxsize=256)
def _special_of(model: Model) -> tuple[list[tuple[str, int, int]], int, int]:
    """Return the registers to follow; where those in EEPROM end; where Status Return Level is."""
    special = [(name, field.at, field.end) for name in _SPECIAL
               if (field := model.by_name.get(name)) is not None]
    ends = [end for name, _, end in special if name != RETURN_LEVEL]
    ends += [field.end for field in model.fields if field.memory == 'eeprom']
    level_at = next((at for name, at, _ in special if name == RETURN_LEVEL), -1)
    return special, max(ends, default=0), level_at


def _window(counts: tuple[int, ...]) -> Window:
    answers, missed, not_served, damaged, alerts, *others = counts
    asked = answers + missed
    return Window(asked, answers, missed, not_served, damaged, alerts,
                  missed / asked if asked else 0.0, *others)
