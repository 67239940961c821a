# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Tracker: pairs every status with the instruction it answers.

Rules: an instruction closes the one before, and who had to answer it and did not is missed; any
status is life; only a status that surely answers the pending instruction touches a table. After
a damaged packet, or noise long enough to hide one, nothing is sure until the next instruction.
Nothing on the wire raises, and nothing here grows with what is on the wire.
"""

from dxl_monitor import evidence as ev
from dxl_monitor.device import Device
from dxl_monitor.duty import Duty
from dxl_monitor.evidence import Evidence
from dxl_monitor.plan import Due
from dxl_monitor.plan import Plan
from dxl_monitor.plan import Slot
from dxl_monitor.planner import NO_PLAN
from dxl_monitor.planner import Planner
from dxl_monitor.roster import MAX_ID
from dxl_monitor.roster import Roster
from dxl_monitor.table import READ
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import split_combined
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import Flaw
from msg_defs.dxl_packet import Frame
from msg_defs.dxl_packet import STATUS
from msg_defs.dxl_packet import unstuff

# A line that turns round leaves a byte or two of noise, on a real robot in front of one packet in
# thirteen. The shortest instruction has 10 bytes: 3 cannot hide one.
GLITCH = 3
_NOBODY: dict[int, Slot] = {}
_PING_SIZE = 8                     # the body of the answer to a Ping


class Tracker:
    """Follows one bus. Feed it what the Framer finds, in order."""

    __slots__ = ('_asked', '_byte_ns', '_doubtful', '_duty', '_evidence', '_given_up', '_known',
                 '_last', '_missed_limit', '_plan', '_planner', '_roster', '_slots', '_spoke',
                 '_unresolved')

    def __init__(self, roster: Roster, evidence: Evidence, byte_ns: float,
                 missed_limit: int, write_acks: str) -> None:
        self._roster = roster
        self._planner = Planner(roster, evidence)
        self._known = self._planner.known
        self._evidence = evidence
        self._byte_ns = byte_ns
        self._missed_limit = missed_limit
        self._duty = Duty(write_acks, evidence)
        self._plan: Plan = NO_PLAN             # of the pending instruction
        self._last = b''                       # its body
        self._asked = (0, 0, 0)                # its end, the end of its chunk, the stamp
        self._slots: dict[int, Slot] = {}      # who has not answered it yet
        self._unresolved = False               # nobody has: the first answer tells a latency
        self._spoke: set[int] = set()          # whose answers to it came damaged
        self._doubtful = True                  # whether it is certain that answers are to it
        self._given_up = _NOBODY               # who did not answer the one before

    def track(self, frames: list[Frame], stamp: int, received: int) -> None:
        """Take the frames of one chunk; received is the stream offset behind the chunk."""
        slots = self._slots
        for end, body, flaw in frames:
            if flaw is not None and self._flawed(body, flaw, stamp):
                continue
            if body[3] != STATUS:
                slots = self._instruct(body, end, received, stamp)
                continue
            slot = slots.pop(body[0], None)
            if slot is None:
                self._unasked(body, stamp)
                continue
            device = slot.device
            if self._unresolved:
                self._unresolved = False
                device.asked_first += 1
                if end - len(body) - 6 >= self._asked[1]:
                    self._sample_latency(device, end - len(body) - 6, received, stamp)
            if len(body) != slot.size or body[4] or device.odd or self._doubtful:
                self._unusual(slot, body, stamp)
            else:
                device.answers += 1
                device.heard = stamp
                slot.take(slot.address, body[5:], stamp, READ)

    def settle(self, stamp: int) -> None:
        """Give up waiting: the line is idle for longer than any answer takes."""
        if self._slots or self._planner.deferred is not None:
            self._close(b'', 0, 0, stamp)
        self._plan = NO_PLAN
        self._slots = {}

    @property
    def pending(self) -> Plan:
        """The instruction that answers belong to now."""
        return self._plan

    def instructions(self) -> int:
        """Return how many instructions there were since start."""
        return self._planner.instructions()

    def plans(self) -> list[Plan]:
        """Return the instructions that the master repeats."""
        return self._planner.plans()

    def _instruct(self, body: bytes, end: int, received: int, stamp: int) -> dict[int, Slot]:
        if self._slots or self._planner.deferred is not None:
            self._close(body, end - len(body) - 6, received, stamp)
        else:
            self._given_up = _NOBODY
        if self._doubtful:
            self._spoke.clear()
        plan = self._known.get(body) or self._planner.plan_for(body, stamp)
        self._plan = plan
        self._last = body
        plan.asked += 1
        plan.stamps.append(stamp)
        if plan.begin is not None:
            plan.begin(body, stamp)
        self._asked = end, received, stamp
        self._unresolved = True
        self._doubtful = False
        self._slots = slots = plan.slots.copy()
        return slots

    # --- answers that need more than storing -----------------------------------------------

    def _unusual(self, slot: Slot, body: bytes, stamp: int) -> None:
        """Take an awaited status that is damaged in its context, stuffed, an error or a return."""
        if body[0] == BROADCAST:
            self._combined(body + body_crc(body).to_bytes(2, 'little'), stamp)
        else:
            self._answer(slot, body[4], unstuff(body[5:]), stamp)

    def _answer(self, slot: Slot, error: int, data: bytes, stamp: int) -> None:
        device = slot.device
        device.answers += 1
        self._roster.heard(device, error, stamp)
        if self._doubtful:
            return
        device.last_error = code = error & ~ALERT
        if code:
            self._refused(slot, code, stamp)
        elif len(data) != slot.size - 5:
            self._evidence.note(stamp, ev.WRONG_SIZE, device.number, len(data), slot.size - 5)
        else:
            slot.take(slot.address, data, stamp, READ)

    def _refused(self, slot: Slot, code: int, stamp: int) -> None:
        instruction = self._plan.request.instruction
        if slot.due is Due.ACK:
            self._planner.deferred = None
            slot.device.acks = True
            slot.device.acks_missing = 0
        slot.device.note_error(instruction, slot.address, code)
        self._evidence.note(stamp, ev.REFUSED, slot.device.number, instruction, slot.address, code)

    def _combined(self, body: bytes, stamp: int) -> None:
        """Split a fast reply; body as split_combined() takes it."""
        accesses = self._plan.request.accesses
        blocks = split_combined(body, accesses)
        for block in blocks:
            slot = self._slots.pop(block.id, None)
            if slot is not None:
                self._answer(slot, block.error, block.data, stamp)
        if len(blocks) < len(accesses) and not self._doubtful:
            self._evidence.note(stamp, ev.FAST_CUT, accesses[len(blocks)].id, len(blocks),
                                len(accesses))

    def _unasked(self, body: bytes, stamp: int) -> None:
        """Take a status that nobody is waiting for: a sign of life, no more."""
        number = body[0]
        if number > MAX_ID:
            self._evidence.note(stamp, ev.BAD_ID, ev.NOBODY, number)
            return
        device = self._roster.device(number)
        self._roster.heard(device, body[4], stamp)
        request = self._plan.request
        if request.answers is Answers.EVERYBODY and len(body) == _PING_SIZE:
            device.answers += 1
            if not self._doubtful:
                self._roster.pinged(device, 0, body[5:], stamp, READ)
        elif self._doubtful:       # it may well have been asked, by what was damaged
            if number in self._plan.slots:
                self._evidence.note(stamp, ev.ANEW, number, request.instruction)
        elif number in self._plan.slots:
            self._evidence.note(stamp, ev.SECOND_ANSWER, number, request.instruction)
        elif not self._plan.is_understood and request.id in (number, BROADCAST):
            pass                   # who knows who answers that
        elif number in self._given_up:
            self._evidence.note(stamp, ev.LATE, number, self._since_asked(stamp))
        else:
            self._evidence.note(stamp, ev.UNASKED, number, request.instruction, body[4])

    # --- damage --------------------------------------------------------------------------------

    def _flawed(self, body: bytes, flaw: Flaw, stamp: int) -> bool:
        """Note what is wrong about a frame; return whether it is lost."""
        if flaw.reason:
            self._doubtful |= flaw.noise_length > GLITCH
            self._damaged(body, flaw.reason, stamp)
            self._doubtful = True
            return True
        device = self._roster.devices.get(body[0]) if body[3] == STATUS else None
        if flaw.noise_length > GLITCH:
            self._doubtful = True
        elif flaw.noise_length:
            self._evidence.counts[ev.GLITCH] += 1
            if device is not None:
                device.glitches += 1
        if flaw.repaired and device is not None:
            device.repaired += 1
        return False

    def _damaged(self, body: bytes, reason: str, stamp: int) -> None:
        number, length, instruction = body[0], body[1] | body[2] << 8, (body[3:4] or b'\0')[0]
        is_status = instruction == STATUS
        if is_status and number == BROADCAST and BROADCAST in self._slots:
            del self._slots[BROADCAST]
            self._combined(body, stamp)        # each block that holds proves itself
        if reason == 'length':
            self._evidence.note(stamp, ev.BAD_LENGTH, ev.NOBODY, length)
        elif reason == 'cut':
            self._evidence.note(stamp, ev.CUT, ev.NOBODY, instruction, length)
        else:
            kind = ev.DAMAGED_STATUS if is_status else ev.DAMAGED_INSTRUCTION
            self._evidence.note(stamp, kind, number, instruction, length)
        if is_status and number != BROADCAST and number in self._plan.slots:
            self._spoke.add(number)
            self._plan.slots[number].device.damaged += 1

    # --- answers that did not come -------------------------------------------------------------

    def _close(self, following: bytes, began: int, received: int, stamp: int) -> None:
        """
        End the pending instruction and judge who did not answer.

        following is the body of the next one, began the stream offset at which it begins.
        """
        slots = self._given_up = self._slots
        slots.pop(BROADCAST, None)
        due = [slot for slot in slots.values() if self._duty.is_due(slot)]
        if due:
            now = int(self._on_wire(began, received, stamp))
            self._judge(due, now)
            if following == self._last:
                self._evidence.note(now, ev.REPEATED, due[0].device.number, following[3],
                                    self._since_asked(now))
        if not due or self._doubtful:
            self._planner.carry_out()
        self._planner.deferred = None

    def _judge(self, due: list[Slot], now: int) -> None:
        """Count who is missed, and who was not served because the master gave up before."""
        waiting, silent = 0, set(due)
        for slot in reversed(self._plan.slots.values()):
            if slot not in silent or slot.device.number in self._spoke:
                break
            waiting += 1
        served = len(due) - max(0, waiting - 1)
        for slot in due[:served]:
            self._miss(slot, now)
        for slot in due[served:]:
            device = slot.device
            device.not_served += 1
            device.asked_stamp = now
            device.waiting_behind = due[served - 1].device.number
            device.odd = True
        self._evidence.note_wait(now, self._since_asked(now), due[0].device.number)

    def _miss(self, slot: Slot, now: int) -> None:
        device = slot.device
        self._plan.missed += 1
        device.miss(now, self._doubtful)
        if device.missed_in_a_row == 1:
            self._evidence.note(now, ev.MISSED, device.number, self._plan.request.instruction,
                                slot.address)
        elif device.missed_in_a_row == self._missed_limit + 1:
            self._evidence.note(now, ev.DISCONNECTED, device.number, device.missed_in_a_row)

    def _since_asked(self, now: int) -> int:
        """Return the us since the end of the pending instruction."""
        return int(now - self._on_wire(*self._asked)) // 1000

    def _on_wire(self, offset: int, received: int, stamp: int) -> float:
        """Return when this offset was on the wire, from the end and the stamp of its chunk."""
        return stamp - (received - offset) * self._byte_ns

    def _sample_latency(self, device: Device, began: int, received: int, stamp: int) -> None:
        if self._doubtful or device is not next(iter(self._plan.slots.values())).device:
            return                             # somebody else had his turn before it
        device.latency_resolved += 1
        wait = self._on_wire(began, received, stamp) - self._on_wire(*self._asked)
        device.latency.add(max(0.0, wait / 1e6), stamp)
