# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a program has received and not read: only a tap knows it (Changes UNREAD, GAVE_UP, PURGED).

Answers that waited when it asked the next thing belong to what it asked before, and so do those to
questions that it did not wait for. What was not there when it closed its port did not come at all.
"""

from collections import deque
from itertools import accumulate

from msg_defs.dxl_instruction import ALERT
from msg_defs.event import IN
from msg_defs.frame import Frame
from msg_defs.frame import Frames
from msg_defs.frame import GLITCH
from servobus.bus import evidence as ev
from servobus.bus.device import Device
from servobus.bus.device import OWED_NS
from servobus.bus.evidence import Evidence
from servobus.bus.plan import AROUND
from servobus.bus.plan import AROUND_1
from servobus.bus.plan import Due
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.registry import DeviceRegistry
from servobus.bus.reply_policy import OpenQuestion
from servobus.bus.reply_policy import ReplyPolicy
from servobus.bus.report import Wait
from servobus.bus.table import READ

READ_LATE_NS = 10_000_000_000
ADAPTER_NS = 17_000_000            # a latency timer of 16 ms, and Return Delay Time
SPARE_NS, TIMES = 5_000_000, 2     # what an adapter is at most slower than it was before
AT_ONCE_NS = 500_000               # who looks no longer than that did not wait for an answer
HUNG_NS = 2_000_000_000            # a program that waits longer has no time-out
KEPT = 16                          # questions
ALIVE = 3                          # missed in a row, before it may be dead
STALE = 20                         # in a row, each while an answer waited


class Unread:
    """
    The answers of one bus that were not read when their question was over.

    until: the offset of the stream to the master up to which it is old, 0: nothing; stamp: when
    that was said, 0: never. left: the questions whose answers may be there or come, the oldest
    first; last: what was open when the port was closed. patience_ns: for how long an
    answer that was given up may still come. waiting: how many bytes wait. dropped: how many were
    thrown away since the question. unsent: the stamp of the question that was thrown away while
    it was sent.
    """

    def __init__(self, registry: DeviceRegistry, evidence: Evidence, duty: ReplyPolicy) -> None:
        self.until = self.stamp = self._purged = self.waiting = self._looked = self._since = 0
        self.dropped = self._stale = 0
        self.patience_ns, self.unsent, self._came_late = OWED_NS, -1, -1
        self.left: deque[OpenQuestion] = deque(maxlen=KEPT)
        self._unknown: deque[OpenQuestion] = deque(maxlen=KEPT)    # left, or thrown away
        self.last: list[OpenQuestion] = []
        self._given_up: deque[tuple[Slot, int]] = deque(maxlen=KEPT)
        self._registry = registry
        self._evidence = evidence
        self._duty = duty

    def say(self, waiting: int, received: int, stamp: int) -> None:
        """Take note of how many bytes wait, after `received` that were read."""
        if not waiting:
            self._stale = 0
        elif received > self._since:
            self._stale += 1
            if self._stale % STALE == 0:
                self._evidence.note(stamp, ev.STALE, ev.NO_DEVICE, ev.NOTHING)
        self.waiting, self.until = waiting, waiting and received + waiting
        self._since = received
        self.stamp, self.patience_ns = stamp, READ_LATE_NS

    def look(self, stamp: int) -> None:
        """Take note that the program looked for bytes in vain."""
        self._looked = stamp

    def leaves(self, question: OpenQuestion, now: int, byte_ns: float) -> bool:
        """Take a question that is over; return whether its answer may be there or come."""
        if self._notes_unsent(question, now):
            return True
        if not self.until and (
                not self.stamp or question.is_spoilt or self._looked > question.asked + AT_ONCE_NS
                or self._has_had_time(question, now, byte_ns)):
            return False
        waited, slot = now - question.asked, question.due[0]
        if waited < byte_ns * (AROUND_1 + slot.size):      # no answer is over so soon
            self._evidence.waits.append(Wait(now, waited // 1000, slot.device.number, False))
        (self.left if self._purged < question.asked else self._unknown).append(question)
        return True

    def pass_over(self, question: OpenQuestion) -> None:
        """Take a write that is over, of which it is unknown whether it is acknowledged."""
        self._unknown.append(question)

    def _notes_unsent(self, question: OpenQuestion, now: int) -> bool:
        """Note a question that was thrown away while it was sent; return whether it was."""
        is_unsent, request = self.unsent == question.asked, question.plan.request
        if is_unsent:
            self._evidence.note(now, ev.NOT_SENT, request.id, ev.Code(request.instruction))
        return is_unsent

    def expire(self, now: int, byte_ns: float) -> None:
        """Judge what was left long enough ago, where nothing waits."""
        while not self.until and self.left and self._has_had_time(self.left[0], now, byte_ns):
            self._duty.judge(self.left.popleft(), now, now)

    def _has_had_time(self, question: OpenQuestion, now: int, byte_ns: float,
                      adapter_ns: float = ADAPTER_NS) -> bool:
        size = sum(slot.size + AROUND for slot in question.due)
        return now - question.asked >= adapter_ns + byte_ns * size

    def _slowest_ns(self) -> float:
        """Return how long to wait for data, by how soon answers came before."""
        known = [device.latency.total() for device in self._registry.devices.values()]
        return min(ADAPTER_NS, SPARE_NS + TIMES * 1e6 * max(
            (one.maximum for one in known if one is not None), default=ADAPTER_NS))

    def purge(self, plan: Plan, slots: dict[int, Slot], asked: int, received: int,
              stamp: int) -> None:
        """
        Take note that the program threw away what it had received.

        slots: what it waits for; received: the offset where that begins. If it never looked for
        it, and just that is there, or with it what it left, it throws away what it asked for; it
        may have taken other bytes for that. Else that may be the answer that it gave up last; or,
        where it has all that it asked one device for, as many bytes again are from a second
        device with that ID.
        """
        request = plan.request
        left = [slot for question in (*self.left, *self._unknown) for slot in question.due
                if stamp - question.asked < OWED_NS]
        thrown = [*slots.values()]
        if self.waiting > sum(slot.status_size for slot in thrown):
            thrown = [*left, *thrown]
        if slots and self._looked <= asked and self.waiting == sum(
                slot.status_size for slot in thrown):
            if self._since == received:
                self._evidence.note(
                    stamp, ev.THROWN_AWAY, request.id, ev.Code(request.instruction))
            self.dropped = 0
            for one in thrown:
                self._registry.heard(one.device, 0, stamp)
                if one.due is Due.ACK:
                    one.device.acknowledged()
            slots.clear()
        else:
            self._take_rest(slots, plan, asked, stamp)
        if self.waiting:
            self._unknown.clear()
        else:
            self._unknown.extend(self.left)
        self.until = self.waiting = self._stale = 0
        self._purged = stamp
        self.left.clear()

    def give_up(self, slot: Slot, asked: int, now: int) -> None:
        """Take an answer that was looked for and may come late: of one that lives, or soon."""
        device = slot.device
        lives = device.heard and device.missed_in_a_row < ALIVE
        if self._looked > asked != self._came_late and (lives or now - asked < ADAPTER_NS):
            self._given_up.append((slot, now))

    def _take_rest(self, slots: dict[int, Slot], plan: Plan, asked: int, stamp: int) -> None:
        """Take what is thrown away; slots: what was looked for in vain since it was asked."""
        given_up = [one for one in self._given_up if stamp - one[1] < OWED_NS]
        due = [slot for slot, _ in given_up]
        due += slots.values() if len(slots) == 1 and self._looked > asked else ()
        sizes = [0, *accumulate(slot.status_size for slot in due)]
        begin, end = (0, sizes.index(self.waiting)) if self.waiting in sizes else next(
            ((at, at + 1) for at, slot in enumerate(due) if slot.status_size == self.waiting),
            (0, 0))
        for slot in due[begin:end]:
            self._registry.heard(slot.device, 0, stamp)
            self._evidence.note(stamp, ev.LATE, slot.device.number, ev.Lateness(0))
        if end > len(given_up):
            self._came_late = asked
        self._given_up = deque(given_up[:begin] + given_up[end:], KEPT)
        answered = None if slots or end else plan.slots.get(plan.request.id)
        if answered is not None and self.waiting == answered.status_size:
            self._evidence.note(stamp, ev.SECOND_ANSWER, answered.device.number,
                                ev.Code(plan.request.instruction))

    def cuts(self, frame: Frame, noise: int, slots: dict[int, Slot], stamp: int) -> bool:
        """Take an answer of which the program threw the end away, after noise; or return False."""
        begin, end, _, number, _, _, flaw = frame
        if not self.dropped or flaw is None:
            return False
        slot = slots.get(number)
        if slot is None or noise > GLITCH or end - begin + self.dropped != slot.status_size:
            return False
        del slots[number]
        self.dropped = 0
        slot.device.counts.answers += 1
        self._registry.heard(slot.device, 0, stamp)
        self._evidence.counts[ev.GLITCH] += noise > 0
        self._evidence.waits.append(Wait(stamp, 0, number, True))      # it got no whole answer
        return True

    def end_answer(self, plan: Plan, received: int, is_noisy: bool) -> None:
        """Count an answer that was longer, by no stray byte; is_noisy: no packet was its end."""
        if (is_noisy or self.dropped) and len(plan.slots) == 1 and not (self.left or self.until):
            slot = next(iter(plan.slots.values()))
            slot.device.counts.surplus += received + self.dropped > slot.status_size + 1
        self.dropped = 0

    def take(self, frames: Frames, stamp: int, received: int, before: Plan) -> Frames:
        """Take the answers that are old; return the other frames; before: the last but one."""
        rest = []
        for frame in frames:
            begin, _, kind, number, code, data, flaw = frame
            is_old = begin < self.until
            if kind or not (is_old or self.left):
                rest.append(frame)
            elif flaw is not None and flaw.reason:
                self._evidence.note_damage(stamp, frame, flaw, IN)
                self._spoil(number, stamp)
            elif not self._answer(number, code, data, stamp):
                if begin < self._since:        # it was hidden by damage
                    self._registry.heard(self._registry.device(number), code, stamp)
                elif is_old:
                    self._take_extra(self._registry.device(number), code, data, stamp, before)
                else:
                    rest.append(frame)
        if received >= self.until:             # all of it is read
            self.until = self.waiting = 0
        return rest

    def _take_extra(self, device: Device, code: int, data: bytes, stamp: int,
                    before: Plan) -> None:
        """Take an answer that waited and that nothing asked for, as far as is known."""
        self._registry.heard(device, code, stamp)
        if device.pays(stamp, self.patience_ns):
            self._evidence.note(stamp, ev.LATE, device.number, ev.Lateness(0))
        elif before.asks(device, len(data)):
            self._evidence.note(stamp, ev.SECOND_ANSWER, device.number,
                                ev.Code(before.request.instruction))

    def _answer(self, number: int, code: int, data: bytes, stamp: int) -> bool:
        """Take an answer to the oldest question that it fits; return whether there is one."""
        error = code & ~ALERT
        for question in self.left:
            for slot in question.due:
                device = slot.device
                if device.number != number or not (error or len(data) == slot.size):
                    continue
                question.due.remove(slot)
                if not question.due:
                    self.left.remove(question)
                device.counts.answers += 1
                self._registry.heard(device, code, stamp)
                device.last_error = error
                if error:
                    self._duty.refuse(slot, question.plan.request.instruction, error, stamp)
                elif slot.due is not Due.ACK:
                    slot.take(slot.span, data, stamp, READ)
                else:
                    device.acknowledged()
                    if question.effect is not None:
                        action, arguments = question.effect
                        action(*arguments)
                return True
        return False

    def _spoil(self, number: int, stamp: int) -> None:
        """Take a damaged answer: that to the oldest question, or to one to this device."""
        found = [(question, slot) for question in self.left for slot in question.due]
        found.sort(key=lambda one: one[1].device.number != number)
        for question, slot in found[:1]:
            question.spoke.add(slot.device.number)
            slot.device.counts.garbled += 1
            slot.device.counts.damaged += 1
            if len(question.due) == 1:
                self.left.remove(question)
                self._duty.judge(question, stamp, stamp)

    def end(self, end: int, failed: bool, byte_ns: float) -> None:
        """
        Judge the questions that a program ended with, if their answers had their time.

        end: when it was heard last; failed: it ended by itself with an error.
        """
        end = max(end, self.stamp, self._looked)
        for question in self.last:
            first, waited = next(iter(question.due), None), end - question.asked
            if waited > HUNG_NS and first is not None and first.due is not Due.ACK \
                    and not self.until and max(self._looked, self._purged) < question.asked:
                self._evidence.note(end, ev.HUNG, first.device.number, ev.Lateness(waited // 1000))
                continue
            now = max(self.stamp, self._looked)
            slots = [*question.plan.slots.values()]
            is_passed = bool(slots) and slots[-1] not in question.due      # the others had a turn
            if is_passed:
                now = max(now, question.asked + 1)
            waited = failed and (question.is_spoilt
                                 or self._looked > question.asked + AT_ONCE_NS)
            due = [slot for slot in question.due if self._duty.is_due(slot)
                   or (waited and slot.device.acks is None)]
            if not due or now < question.asked or self._notes_unsent(question, now):
                continue
            us = (now - question.asked) // 1000
            is_known = is_passed or question.is_spoilt or question.spoke or (
                self._has_had_time(question, now, byte_ns, self._slowest_ns() if all(
                    slot.due is not Due.ACK for slot in due) else ADAPTER_NS)
                and not self.until and self._purged < question.asked)
            if failed and is_known:
                self._duty.judge(question._replace(due=due), now, now, us)
            elif question is self.last[-1] and (failed or not due[0].device.heard):
                self._evidence.note(now, ev.LEFT_OPEN, due[0].device.number, ev.Lateness(us))
        self.last = []
