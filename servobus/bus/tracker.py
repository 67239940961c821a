# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Tracker: pairs every status with the instruction it answers.

Rules: an instruction closes the one before, and a device that had to answer that one and did not
is missed; any status is life; only a status that surely answers the pending instruction touches a
table (certainty.py). What comes to the master as an instruction is an echo, or another master's.
Nothing on the wire raises, and nothing here grows with what is on the wire.
"""

from msg_defs.dxl1_instruction import ADAPTER_IDS
from msg_defs.dxl1_instruction import split_adapter_status
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import Answers
from msg_defs.dxl_instruction import blocks_in
from msg_defs.dxl_instruction import NAMES
from msg_defs.dxl_instruction import split_combined
from msg_defs.dxl_packet import body_crc
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import fast_wire
from msg_defs.event import IN
from msg_defs.event import UNKNOWN
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import GLITCH
from msg_defs.servo_frame import INSTRUCTION_2
from msg_defs.servo_frame import IS_STATUS
from servobus.bus import certainty
from servobus.bus import evidence as ev
from servobus.bus.certainty import DOUBTFUL
from servobus.bus.certainty import SURE
from servobus.bus.device import Device
from servobus.bus.evidence import Evidence
from servobus.bus.instruction_plans import NO_PLAN
from servobus.bus.instruction_plans import Planner
from servobus.bus.instruction_plans import RawInstruction
from servobus.bus.plan import Due
from servobus.bus.plan import Effect
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.registry import DeviceRegistry
from servobus.bus.reply_policy import OpenQuestion
from servobus.bus.reply_policy import ReplyPolicy
from servobus.bus.table import READ
from servobus.bus.unread import UnreadAnswers

_NO_SLOTS: dict[int, Slot] = {}
_PING_SIZE = 3                     # the data of the answer to a Ping; none in the 1.0 family
_NOTHING = (-1, -1, -1, b'')


class Tracker:
    """Follows one bus. Feed it what the Framer finds, in order."""

    def __init__(self, registry: DeviceRegistry, evidence: Evidence, missed_limit: int,
                 write_acks: str) -> None:
        self._registry = registry
        self.planner = planner = Planner(registry, evidence)
        self._known = planner.known
        self._evidence, self._add_incident = evidence, evidence.add_incident
        self._policy = ReplyPolicy(write_acks, missed_limit, registry, evidence)
        self._state, self._noise = DOUBTFUL, 0     # bytes ahead of the last flawed frame
        self.quiet_from = 0                    # offset of what it received after it asked
        self.pending: Plan = NO_PLAN           # the instruction that answers belong to
        self._last = _NOTHING                  # its kind, ID, code and parameters
        self._asked = (0, 0, 0)                # its end, the end of its chunk, the stamp
        self._deferred: Effect | None = None   # what it does once it is accepted
        self.slots: dict[int, Slot] = {}      # the statuses that are still to come
        self._unresolved = False               # no status yet: the first one gives a latency
        self._damaged_ids: set[int] = set()          # the devices that answered it with damage
        self._before, self._given_up = NO_PLAN, _NO_SLOTS      # the one before, what it lacked
        self.unread = UnreadAnswers(registry, evidence, self._policy)

    def process_frames(self, frames: Frames, stamp: int, received: int,
                       side: str = UNKNOWN) -> None:
        """Process the frames of one chunk, in the order of time; received: the offset after it."""
        is_in = side == IN
        if is_in and (self.unread.old_until or self.unread.deferred):
            frames = self.unread.take_old_answers(frames, stamp, received, self._before)
        slots = self.slots
        for frame in frames:
            begin, end, kind, number, code, data, flaw = frame
            if flaw is not None and self._process_flaw(frame, flaw, stamp, side):
                continue
            if kind:
                raw = kind, number, code, data
                if not (is_in and self._is_echo(raw, stamp)):
                    slots = self._process_instruction(raw, flaw, begin, end, received, stamp)
                continue
            if (slot := slots.pop(number, None)) is None:
                self._process_unasked(number, code, data, stamp)
                continue
            device = slot.device
            if self._unresolved:
                self._unresolved = False
                device.asked_first += 1
                if side or begin >= self._asked[1]:
                    self._sample_latency(device, begin, received, stamp)
            if len(data) != slot.size or code or device.is_unusual or self._state:
                self._process_unusual(slot, number, code, data, stamp)
            else:
                device.counts.answers += 1
                device.heard = stamp
                accept = slot.accept       # calling it as an attribute costs more
                if accept(slot.span, data, stamp, READ):
                    self._carry_out()

    def _is_echo(self, raw: RawInstruction, stamp: int) -> bool:
        """Accept an instruction that came to the master; return whether it is its own."""
        is_own = raw == self._last or self._evidence.has_echo
        if not is_own:
            self._add_incident(stamp, ev.FOREIGN, raw[1], raw[2])
        return is_own

    def discount_latency(self, us: int, stamp: int) -> None:
        """Note that the answer that follows may have been there for so long."""
        self._unresolved &= 2000 * us < stamp - self._asked[2]

    def drop_unsent(self, stamp: int) -> None:
        """Note that the pending instruction did not get to the bus, or not all of it."""
        if self.pending is not NO_PLAN:
            self._add_incident(stamp, ev.NOT_SENT, self._last[1], self._last[2])
        self._forget_pending()

    def lose_port(self, stamp: int, error: int) -> None:
        """Note that the program's port went away: what is pending says nothing of the bus."""
        self._add_incident(stamp, ev.PORT_LOST, ev.NO_DEVICE, error)
        self._forget_pending()

    def lose_track(self, stamp: int, lost: int) -> None:
        """Judge nothing that is pending: `lost` events were not heard, or the port was closed."""
        if lost:
            self._add_incident(stamp, ev.SOURCE_LOST, ev.NO_DEVICE, lost)
        self.slots.pop(BROADCAST, None)
        self.unread.close(None if lost or self.pending is NO_PLAN
                          else self._open_question([*self.slots.values()]), stamp)
        self._forget_pending()
        self._state = DOUBTFUL

    def accept_purge(self, stamp: int) -> None:
        """Note that the program discarded what waited, perhaps all that is still to come."""
        if self.unread.report_purge(self.pending, self.slots, self.asked, self.quiet_from, stamp):
            self.slots.clear()

    def _open_question(self, due: list[Slot]) -> OpenQuestion:
        return OpenQuestion(self.pending, due, self._damaged_ids, self._state >= certainty.SPOILT,
                            self._asked[2], self._deferred)

    def _forget_pending(self) -> None:
        self.pending, self.slots = NO_PLAN, {}
        self._given_up = _NO_SLOTS
        self._deferred = None

    def stop_waiting(self, stamp: int) -> None:
        """Give up waiting: the line is idle for longer than any answer takes."""
        if self.slots or self._deferred is not None:
            self._close_question(_NOTHING, 0, 0, stamp)
        self.pending, self.slots = NO_PLAN, {}

    @property
    def asked(self) -> int:
        """The stamp of the last instruction, 0 before the first."""
        return self._asked[2]

    def _process_instruction(self, raw: RawInstruction, flaw: Flaw | None, begin: int, end: int,
                             received: int, stamp: int) -> dict[int, Slot]:
        if self.slots or self._deferred is not None:
            self._close_question(raw, begin, received, stamp)
        else:
            self._given_up = _NO_SLOTS
        if self._damaged_ids:
            self._damaged_ids = set()
        if not self._registry.plans_hold:
            self.planner.forget_plans()
        plan = self._known.get(raw) or self.planner.plan_for(raw, stamp)
        self._before = self.pending
        self.pending = plan
        self._last = raw
        plan.asked += 1
        plan.stamps.append(stamp)
        if (start := plan.begin) is not None:  # nothing waits: _close_question() has ended that
            if flaw is not None and flaw.unstuffed and plan.request.accesses:
                self._add_incident(stamp, ev.UNSTUFFED, raw[1], raw[2])
            self._deferred = start(raw[3], stamp)
        self._asked = end, received, stamp
        self._unresolved = True
        self._state = SURE
        self.slots = slots = plan.slots.copy()
        return slots

    def _process_unusual(self, slot: Slot, number: int, error: int, data: bytes,
                         stamp: int) -> None:
        """Accept an awaited status that is damaged in its context, an error or a return."""
        if number == BROADCAST:
            if self.is_doubtful or not self._accept_whole(error, data, stamp):
                if self.pending.request.answers is Answers.ADAPTER:
                    self._accept_adapter_status(data, stamp)
                    return
                wire = fast_wire(error, data)
                self._split_combined(wire + body_crc(wire).to_bytes(2, 'little'), stamp)
        else:
            self._accept_answer(slot, error, data, stamp)

    def _accept_whole(self, error: int, data: bytes, stamp: int) -> bool:
        """Accept a fast reply of which every part holds; leave any other as it is."""
        reply = self.pending.fast_reply
        if reply is None or len(self.slots) != len(reply.slots) \
                or not (fields := reply.unpack(fast_wire(error, data))):
            return False
        for slot, error, data in zip(reply.slots, fields[::4], fields[2::4], strict=True):
            device = slot.device
            device.counts.fast_answers += 1
            if error or device.is_unusual:
                self._accept_answer(slot, error, data, stamp)
            else:
                device.counts.answers += 1
                device.heard = stamp
                device.last_error = 0
                accept = slot.accept
                accept(slot.span, data, stamp, READ)
        self.slots.clear()
        return True

    def _accept_adapter_status(self, data: bytes, stamp: int) -> None:
        """Accept what an adapter has read of each device; those that it lacks are missed."""
        self._evidence.counts[ev.READ_BY_ADAPTER] += 1
        accesses = self.pending.request.accesses
        blocks = split_adapter_status(data, accesses)
        if blocks is None:
            self._add_incident(stamp, ev.WRONG_SIZE, accesses[0].id, len(data),
                               sum(access.length for access in accesses))
            return
        for block in blocks:
            if (slot := self.slots.pop(block.id, None)) is not None:
                self._accept_answer(slot, 0, block.data, stamp)
        for slot in filter(self._policy.judge_silence, self.slots.values()):
            self._policy.count_missed(self.pending, slot, stamp, stamp, self.is_doubtful)
        self.slots.clear()

    def _accept_answer(self, slot: Slot, error: int, data: bytes, stamp: int) -> None:
        device = slot.device
        device.counts.answers += 1
        is_again = self._before.asks(device, len(data)) and device.has_just_answered(stamp)
        self._registry.accept_status(device, error, stamp)
        code = error & ~ALERT
        if code and (self.is_doubtful or slot.due is Due.ACK):
            self._deferred = None              # where it is doubtful: it may answer this write
        if self.is_doubtful:
            return
        device.last_error = code
        if code:
            self._policy.count_refusal(slot, self.pending.request.instruction, code, stamp)
        elif len(data) == slot.size:
            if slot.accept(slot.span, data, stamp, READ):
                self._carry_out()
        elif self.planner.has_answer(device.number, len(data)):
            if not is_again:
                self.slots[device.number] = slot       # a late one: its own may still come
            self._add_extra_answer(device.number, is_again, stamp)
        else:
            self._add_incident(stamp, ev.WRONG_SIZE, device.number, len(data), slot.size)

    def _carry_out(self) -> None:
        """Do what the pending instruction asked for: it was accepted, or not refused."""
        if self._deferred is not None:
            (action, arguments), self._deferred = self._deferred, None
            action(*arguments)

    def _split_combined(self, body: bytes, stamp: int) -> bool:
        """Accept the parts of a fast reply; return whether it breaks off after a whole one."""
        accesses = self.pending.request.accesses
        blocks = split_combined(body, accesses)        # each part that holds proves itself
        there = max(len(blocks), blocks_in(body, accesses))
        for block in blocks:
            if (slot := self.slots.pop(block.id, None)) is not None:
                slot.device.counts.fast_answers += 1
                self._accept_answer(slot, block.error, block.data, stamp)
        if len(blocks) < there:
            damaged, unknown = self.pending.damaged_parts(there, blocks[-1].id if blocks else -1,
                                                 self.slots)
            for slot in damaged:
                slot.device.count_damaged(self._damaged_ids, 1)
            for number in unknown:
                del self.slots[number]
        if there < len(accesses) and self._state < certainty.SPOILT:
            self._add_incident(stamp, ev.FAST_CUT, accesses[there].id, there, len(accesses))
        return len(blocks) == there < len(accesses)

    def _process_unasked(self, number: int, error: int, data: bytes, stamp: int) -> None:
        """Accept a status that was not due: a sign of life, no more."""
        if number in ADAPTER_IDS and self.pending.request.answers is Answers.ADAPTER \
                and self.slots.pop(BROADCAST, None) is not None:
            self._accept_adapter_status(data, stamp)
            return
        if number > self._registry.highest:
            self._add_incident(stamp, ev.BAD_ID, ev.NO_DEVICE, number)
            return
        if self.slots and self._deferred and self._registry.is_new_id(self._deferred, number):
            _, slot = self.slots.popitem()
            self._accept_answer(slot, error, data, stamp)
            self._registry.renumber(slot.device, number, stamp)
            return
        device = self._registry.device(number)
        is_again = self._before.asks(device, len(data)) and device.has_just_answered(stamp)
        self._registry.accept_status(device, error, stamp)
        plan = self.pending
        request = plan.request
        if request.answers is Answers.EVERYBODY and len(data) == (
                _PING_SIZE if self._last[0] == INSTRUCTION_2 else 0):
            self._registry.accept_pong(device, data, stamp, self.is_doubtful)
        elif self.is_doubtful:       # it may well have been asked, by what was damaged
            if number in plan.slots:
                self._add_incident(stamp, ev.ANSWERED_AGAIN, number, request.instruction)
        elif not plan.is_understood and request.id in (number, BROADCAST):
            self._evidence.counts[ev.UNKNOWN_ANSWERED] += 1    # it may have asked for this
        elif (device.owed and device.accept_late_reply(stamp, self.unread.late_reply_ns)) \
                or (number in self._given_up and number not in plan.slots):
            self._add_extra_answer(number, False, stamp)
            if not data and device.dialect is None and not error & ~ALERT:
                device.accept_ack()          # Pings and reads are answered with data
        elif number in plan.slots or is_again:
            self._add_extra_answer(number, True, stamp)
        else:
            self.unread.note_old_answer(number, stamp)
            self._add_incident(stamp, ev.UNASKED, number)

    def _add_extra_answer(self, number: int, is_second: bool, stamp: int) -> None:
        """Note an answer more than is due: a second one, or a late one."""
        if is_second:
            plan = self.pending if number in self.pending.slots else self._before
            self._add_incident(stamp, ev.SECOND_ANSWER, number, plan.request.instruction)
        else:
            self.unread.note_old_answer(number, stamp)
            self._add_incident(stamp, ev.LATE, number, self._since_asked(stamp))

    def _process_flaw(self, frame: Frame, flaw: Flaw, stamp: int, side: str) -> bool:
        """Note what is wrong about a frame; return whether it is lost."""
        reason, is_repaired, noise, is_unstuffed, _ = flaw
        if is_unstuffed and not (noise or is_repaired):
            return False
        if noise > GLITCH and side == IN:      # what came before the question is no matter
            noise = min(noise, max(0, frame[0] - self.quiet_from))
        self._noise = noise
        if reason == 'cut' and self.unread.accept_truncated_reply(
                frame, flaw, noise, self.slots, stamp):
            del self.slots[frame[3]]
            return True
        if noise > GLITCH:
            damage, loud = certainty.TO_MASTER if side == IN else certainty.ON_THE_WIRE
            self._state = certainty.NEXT[self._state][damage if reason else loud]
        elif noise and not reason:
            self._evidence.counts[ev.GLITCH] += 1
        if reason:
            damage = self._process_damaged(frame, flaw, stamp, side)
            self._state = certainty.NEXT[self._state][damage]
        elif is_repaired and frame[2] == IS_STATUS and frame[3] in self._registry.devices:
            self._registry.devices[frame[3]].counts.repaired += 1
            self._damaged_ids.add(frame[3])  # whether the others understood it, is not known
        return bool(reason)

    def process_noise(self, noise: int) -> None:
        """Note noise to the master since it asked, which no frame followed."""
        if noise > GLITCH and self.slots and self._state < certainty.SPOILT:
            self._noise = noise // 2           # two may have answered
            self._state = certainty.NEXT[self._state][certainty.NOISE_IN]

    @property
    def is_doubtful(self) -> bool:
        """Whether an answer may not belong to what is pending."""
        return self._state == DOUBTFUL

    def _process_damaged(self, frame: Frame, flaw: Flaw, stamp: int, side: str) -> int:
        """Note a damaged frame; return what happened to the pairing."""
        damage, _ = certainty.TO_MASTER if side == IN else certainty.ON_THE_WIRE
        _, _, kind, number, code, data, _ = frame
        is_status = kind == IS_STATUS
        if is_status and number == BROADCAST and BROADCAST in self.slots \
                and self.pending.request.answers is Answers.COMBINED:
            del self.slots[BROADCAST]
            if self._split_combined(data, stamp):    # nothing is damaged: the next one is silent
                return certainty.BROKE_OFF
        self._evidence.add_damage(stamp, frame, flaw, side)
        if is_status and number == BROADCAST:
            return damage
        slot = self.pending.slots.get(number) if is_status else None
        if slot is not None:
            slot.device.count_damaged(self._damaged_ids, 1)
        elif self.slots and (is_status or code not in NAMES):
            waited_for = next(iter(self.slots.values()))       # it is its turn
            waited_for.device.count_damaged(self._damaged_ids)
        return damage

    def _close_question(self, following: RawInstruction, began: int, received: int,
                        stamp: int) -> None:
        """End the pending instruction; following: the next one, which began there."""
        slots = self._given_up = self.slots
        slots.pop(BROADCAST, None)
        due = [*filter(self._policy.judge_silence, slots.values())]
        if due:
            self._end_question(self._open_question(due), following,
                               int(stamp - (received - began) * self._registry.byte_ns), stamp)
        elif slots and self.unread.reported_ns:        # only a tap says what waits
            self.unread.uncertain.append(self._open_question([*slots.values()]))
        if self._deferred is not None and (not due or self._state >= certainty.SPOILT):
            self._carry_out()
        self._deferred = None

    def _end_question(self, question: OpenQuestion, following: RawInstruction, now: int,
                      stamp: int) -> None:
        """Judge a question with answers that were due and did not come, or have it deferred."""
        if not self.unread.end_question(question, now):
            self._given_up = _NO_SLOTS
            return
        first = question.due[0]
        if question.is_spoilt:
            self._policy.attribute_noise(question, self._noise, self.slots.values(), now)
        elif len(self.slots) == 1:
            self.unread.keep_given_up(first, question.asked, now)
        self._policy.judge_question(question, now, stamp, us := self._since_asked(now))
        if following == self._last:
            self._add_incident(now, ev.REPEATED, first.device.number, following[2], us)

    def _since_asked(self, now: int) -> int:        # in us, from its end
        end, received, stamp = self._asked
        return int(now - (stamp - (received - end) * self._registry.byte_ns)) // 1000

    def _sample_latency(self, device: Device, began: int, received: int, stamp: int) -> None:
        if device is not self.pending.first or self._state == DOUBTFUL:
            return                             # another device had its turn before it
        device.latency_resolved += 1
        end, asked_received, asked = self._asked
        wait = stamp - asked - (received - began - asked_received + end) * self._registry.byte_ns
        device.latency.add(wait / 1e6 if wait > 0 else 0.0, stamp)
