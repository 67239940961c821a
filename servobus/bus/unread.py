# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Answers that a program has received and not read, and questions of which that may be so.

Theory of operation. A monitor on the wire hears an answer when it is sent. A tap inside the
program hears it when the program reads it, which may be much later: a program that asks A, asks B
and then reads twice seems to ask A in vain, and the answer of A comes after question B. So a tap
reports more than bytes, and this module uses it:

- UNREAD n: n bytes waited in the receive queue. Of what is read from then on, the first n bytes
  are old: they answer earlier questions, the oldest first.
- GAVE_UP: the program looked for bytes until its time was up. What did not come then is missed.
- PURGED: the program discarded what waited, or what it was about to send.

Where a source never reports UNREAD, each question is judged when the next one comes.

Each question has one state. PENDING is the one that the tracker waits for. When it is over and
answers are due, it moves on as NEXT says, and so it does with each later event:

- DEFERRED: its answers may wait unread or still come. An old answer that fits it ends it, a
  damaged one has it judged, and so does time (judge_expired).
- UNCERTAIN: its answers may have been discarded, or it is unknown whether any were due. It is not
  judged; the size of its answers may explain what is discarded later.
- LAST: it was open when the port closed. judge_last() decides, as soon as it is known how the
  program ended.
- MISSED: the tracker has it judged. DONE: it says nothing more.

A question that was MISSED after the program looked for its answer may still be answered, too late
to be read: `_given_up` keeps it for as long as an answer may be late.
"""

from collections import deque
from collections.abc import Iterable
from itertools import accumulate

from msg_defs.dxl_instruction import ALERT
from msg_defs.event import IN
from msg_defs.servo_frame import Flaw
from msg_defs.servo_frame import Frame
from msg_defs.servo_frame import Frames
from msg_defs.servo_frame import GLITCH
from servobus.bus import evidence as ev
from servobus.bus.device import Device
from servobus.bus.device import OWED_REPLY_MAX_NS
from servobus.bus.evidence import Evidence
from servobus.bus.plan import Due
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.plan import STATUS_OVERHEAD
from servobus.bus.plan import STATUS_OVERHEAD_1
from servobus.bus.registry import DeviceRegistry
from servobus.bus.reply_policy import OpenQuestion
from servobus.bus.reply_policy import ReplyPolicy
from servobus.bus.report import Wait
from servobus.bus.table import READ

UNREAD_REPLY_NS = 10_000_000_000   # for so long an answer may wait unread
ADAPTER_DELAY_NS = 17_000_000      # a latency timer of 16 ms, and Return Delay Time
ADAPTER_SPARE_NS, ADAPTER_SLOWDOWN = 5_000_000, 2  # an adapter gets slower by no more
NO_WAIT_NS = 500_000               # who looks no longer than that did not wait for an answer
READ_PACKET_BYTES = 14             # bytes of a Read of Protocol 2.0
AT_ONCE_NS = 500_000               # after a read: the next question follows from it
HUNG_WAIT_NS = 2_000_000_000       # a program that waits longer has no time-out
ACKS_READ_MIN = 10                 # answers to one write: it does not go on without them
QUESTIONS_KEPT = 16
OWN_ANSWERS_MIN = 3                # what waits then is not of an earlier program
ALIVE_MAX_MISSED = 2               # in a row: after more it may be dead
STALE_MIN_QUESTIONS = 20           # in a row, each while an answer waited

PENDING, DEFERRED, UNCERTAIN, LAST, MISSED, DONE = (
    'pending', 'deferred', 'uncertain', 'last', 'missed', 'done')

NOT_SENT = 'not sent'              # it was discarded before it was sent
WAITED = 'waited'                  # the next one came, after time enough for an answer
NOT_READ = 'not read'              # the next one came, before the program read an answer
NOT_READ_PURGED = 'not read, purged'       # the same, and it has discarded bytes since it asked
ANSWERED = 'answered'              # by all devices
DAMAGED = 'damaged'                # its last answer came, and was damaged
EXPIRED = 'expired'                # all answers would have come by now
PURGED = 'purged'                  # the program discards bytes that waited
PURGED_NOTHING = 'purged nothing'  # it discards what may come in this moment
CLOSED = 'closed'                  # the port
LOST = 'lost'                      # events were, or nothing was pending when the port was closed

# Any other event leaves a question in its state.
NEXT = {
    PENDING: {NOT_SENT: DONE, WAITED: MISSED, NOT_READ: DEFERRED, NOT_READ_PURGED: UNCERTAIN,
              CLOSED: LAST, LOST: DONE},
    DEFERRED: {ANSWERED: DONE, DAMAGED: MISSED, EXPIRED: MISSED, PURGED: DONE,
               PURGED_NOTHING: UNCERTAIN, CLOSED: LAST, LOST: DONE},
    UNCERTAIN: {PURGED: DONE},
}


class UnreadAnswers:
    """
    The receive queue of the master, and the questions that are over.

    old_until: what comes before this offset of the stream to the master is old, 0: nothing is.
    reported_ns: stamp of the last UNREAD, 0: never. vain_read_ns: until when the program looked
    for bytes, and there were none. deferred, uncertain: the questions in that state, oldest first.
    discarded: how many bytes were since the last question.
    """

    def __init__(self, registry: DeviceRegistry, evidence: Evidence, policy: ReplyPolicy) -> None:
        self._registry = registry
        self._evidence = evidence
        self._policy = policy
        self.old_until = self.reported_ns = self.discarded = 0
        self._reported_at = 0              # offset of the stream at the last UNREAD
        self.vain_read_ns = self._purged_ns = self._closed_ns = 0     # stamps of the last ones
        self._stale_questions = 0          # in a row
        self._left_unread = False          # bytes waited when the port was closed
        self._unsent_ns = -1               # stamp of the question that was not sent
        self._late_ns = -1                 # stamp of the question of which the answer was late
        self._questions = {state: deque[OpenQuestion](maxlen=kept) for state, kept in (
            (UNCERTAIN, QUESTIONS_KEPT), (DEFERRED, QUESTIONS_KEPT), (LAST, None), (DONE, 0))}
        self.deferred, self.uncertain = self._questions[DEFERRED], self._questions[UNCERTAIN]
        self._given_up: deque[tuple[Slot, int]] = deque(maxlen=QUESTIONS_KEPT)
        self._old_answers: deque[tuple[int, int]] = deque(maxlen=2)   # their ID and stamp

    @property
    def waiting(self) -> int:
        """How many bytes waited at the last report, if they are not read yet."""
        return self.old_until and self.old_until - self._reported_at

    @property
    def late_reply_ns(self) -> int:
        """For how long an answer that was given up may still come."""
        return UNREAD_REPLY_NS if self.reported_ns else OWED_REPLY_MAX_NS

    # --- what the tap reports -------------------------------------------------------------------

    def report_waiting(self, waiting: int, received: int, stamp: int) -> None:
        """Set how many bytes wait, after `received` that were read."""
        if not waiting:
            self._stale_questions = 0
        elif received > self._reported_at:
            self._stale_questions += 1
            if self._stale_questions % STALE_MIN_QUESTIONS == 0:
                self._evidence.add_incident(stamp, ev.STALE, ev.NO_DEVICE)
        self.old_until = waiting and received + waiting
        self._reported_at, self.reported_ns = received, stamp

    def report_unsent(self, asked: int, stamp: int) -> None:
        """Note that the program discarded what it was about to send: its question, if just now."""
        if stamp < asked + NO_WAIT_NS:
            self._unsent_ns = asked

    def report_purge(self, plan: Plan, slots: dict[int, Slot], asked: int, received: int,
                     stamp: int) -> bool:
        """
        Note that the program discarded what waited; return whether all awaited answers were there.

        slots: the awaited answers to `plan`; received: the offset where they begin. If the program
        never looked for them, and what waited has just their size, or that of them and of earlier
        ones, it discarded them. Else it may be the answer that it gave up last; or, where it has
        all that it asked one device for, as many bytes again are from a second one with that ID.
        """
        waiting, awaited = self.waiting, [*slots.values()]
        if waiting > _status_bytes(awaited):
            awaited = [slot for state in (DEFERRED, UNCERTAIN) for question in
                       self._questions[state] for slot in question.due
                       if stamp - question.asked < OWED_REPLY_MAX_NS] + awaited
        is_all = bool(slots) and self.vain_read_ns <= asked and waiting == _status_bytes(awaited)
        if is_all:
            if self._reported_at == received:
                self._evidence.add_incident(stamp, ev.THROWN_AWAY, plan.request.id,
                                            plan.request.instruction)
            self.discarded = 0
            for slot in awaited:
                self._registry.accept_status(slot.device, 0, stamp)
                if slot.due is Due.ACK:
                    slot.device.accept_ack()
        else:
            self._explain_discarded(slots, plan, asked, stamp)
        self._move_all(PURGED if waiting else PURGED_NOTHING)
        self.old_until = self._stale_questions = 0
        self._purged_ns = stamp
        return is_all

    def _explain_discarded(self, slots: dict[int, Slot], plan: Plan, asked: int,
                           stamp: int) -> None:
        """Find whose late or second answer was discarded; slots: of those that did not come."""
        waiting = self.waiting
        given_up = [one for one in self._given_up if stamp - one[1] < OWED_REPLY_MAX_NS]
        late = [slot for slot, _ in given_up]
        late += slots.values() if len(slots) == 1 and self.vain_read_ns > asked else ()
        sizes = [0, *accumulate(slot.status_size for slot in late)]
        begin, end = (0, sizes.index(waiting)) if waiting in sizes else next(
            ((at, at + 1) for at, slot in enumerate(late) if slot.status_size == waiting), (0, 0))
        for slot in late[begin:end]:
            self._registry.accept_status(slot.device, 0, stamp)
            self._evidence.add_incident(stamp, ev.LATE, slot.device.number, 0)
        if end > len(given_up):
            self._late_ns = asked
        self._given_up = deque(given_up[:begin] + given_up[end:], QUESTIONS_KEPT)
        answered = None if slots or end else plan.slots.get(plan.request.id)
        if answered is not None and waiting == answered.status_size:
            self._evidence.add_incident(stamp, ev.SECOND_ANSWER, answered.device.number,
                                        plan.request.instruction)

    # --- a question is over ---------------------------------------------------------------------

    def end_question(self, question: OpenQuestion, now: int) -> bool:
        """Accept a question with answers that are due; return whether these are missed."""
        if self._old_answers:
            self._note_mistaken_answer(question, now)
        if self._unsent_ns == question.asked:
            self._note_unsent(question, now)
            event = NOT_SENT
        elif not self.old_until and (
                not self.reported_ns or question.is_spoilt or self._has_waited(question)
                or self._has_had_time(question, now)):
            return True                    # WAITED
        else:
            event = NOT_READ if self._purged_ns < question.asked else NOT_READ_PURGED
            waited, slot = now - question.asked, question.due[0]
            # No answer is over sooner.
            least = self._registry.byte_ns * (STATUS_OVERHEAD_1 + slot.size)
            if waited < (least if slot.due is Due.ACK or self.old_until
                         else max(least, NO_WAIT_NS)):
                self._evidence.add_wait(Wait(now, waited // 1000, slot.device.number, False,
                                             question.plan.request.instruction))
        self._questions[NEXT[PENDING][event]].append(question)
        return False

    def note_old_answer(self, number: int, stamp: int) -> None:
        """Note that the answer to an earlier question is read."""
        self._old_answers.append((number, stamp))

    def _note_mistaken_answer(self, question: OpenQuestion, now: int) -> None:
        """Note that the program asks on after it has read one answer, that of another device."""
        # It may read on at once.
        written = question.asked - self._registry.byte_ns * READ_PACKET_BYTES
        read = [one for one in self._old_answers if one[1] > written]
        self._old_answers.clear()
        asked = question.due[0].device.number
        if len(read) != 1 or read[0][0] == asked:
            return
        [(number, stamp)] = read
        if now - stamp < AT_ONCE_NS:
            self._evidence.add_frequent(now, ev.TAKEN_FOR, asked, number)
        else:
            self._evidence.counts[ev.NOT_TAKEN] += 1

    def keep_given_up(self, slot: Slot, asked: int, now: int) -> None:
        """Keep a missed answer that was looked for, if it may be late: it lives, or it is soon."""
        device = slot.device
        lives = device.heard and device.missed_in_a_row <= ALIVE_MAX_MISSED
        if self.vain_read_ns > asked != self._late_ns and (
                lives or now - asked < ADAPTER_DELAY_NS):
            self._given_up.append((slot, now))

    def judge_expired(self, now: int) -> None:
        """Judge what was deferred long enough ago, where nothing waits."""
        while not self.old_until and self.deferred \
                and self._has_had_time(self.deferred[0], now):
            self._end_deferred(self.deferred[0], EXPIRED, now)

    def close(self, pending: OpenQuestion | None, stamp: int) -> None:
        """End all: the port is closed, or events were lost; pending: the question till then."""
        if pending is not None:
            self._closed_ns, self._left_unread = stamp, self.old_until > 0
            self._questions[LAST].clear()
        self.old_until = 0                     # what waited is gone with the port
        self._move_all(LOST if pending is None else CLOSED)
        if pending is not None:
            self._questions[LAST].append(pending)

    def _move_all(self, event: str) -> None:
        """Move the questions that are over as NEXT says."""
        moved = [(NEXT[state].get(event, state), [*self._questions[state]])
                 for state in (UNCERTAIN, DEFERRED)]
        for state in (UNCERTAIN, DEFERRED):
            self._questions[state].clear()
        for state, questions in moved:
            self._questions[state].extend(questions)

    def _end_deferred(self, question: OpenQuestion, event: str, stamp: int) -> None:
        self.deferred.remove(question)
        if NEXT[DEFERRED][event] == MISSED:
            self._policy.judge_question(question, stamp, stamp)

    def _note_unsent(self, question: OpenQuestion, now: int) -> None:
        request = question.plan.request
        self._evidence.add_incident(now, ev.NOT_SENT, request.id, request.instruction)

    def _has_waited(self, question: OpenQuestion) -> bool:
        """Return whether the program looked for the answer for some time."""
        return self.vain_read_ns > question.asked + NO_WAIT_NS

    def _has_had_time(self, question: OpenQuestion, now: int,
                      delay_ns: float = ADAPTER_DELAY_NS) -> bool:
        """Return whether all answers would have come by now."""
        size = sum(slot.size + STATUS_OVERHEAD for slot in question.due)
        return now - question.asked >= delay_ns + self._registry.byte_ns * size

    # --- what the program reads -----------------------------------------------------------------

    def take_old_answers(self, frames: Frames, stamp: int, received: int,
                         before: Plan) -> Frames:
        """Take answers to earlier questions; return the other frames; before: the plan before."""
        rest = []
        for frame in frames:
            begin, _, kind, number, code, data, flaw = frame
            is_old = begin < self.old_until
            if kind or not (is_old or self.deferred) \
                    or self._registry.is_impossible_id(number) \
                    or (self.discarded and flaw is not None and flaw.reason == 'cut'):
                rest.append(frame)
            elif flaw is not None and flaw.reason:
                self._evidence.add_damage(stamp, frame, flaw, IN)
                self._judge_damaged(number, stamp)
            elif not self._answer_deferred(number, code, data, stamp):
                if begin < self._reported_at:      # it was hidden by damage
                    self._registry.accept_status(self._registry.device(number), code, stamp)
                elif is_old:
                    self._accept_extra(self._registry.device(number), code, data, stamp, before)
                else:
                    rest.append(frame)
        if received >= self.old_until:             # all of it is read
            self.old_until = 0
        return rest

    def _answer_deferred(self, number: int, code: int, data: bytes, stamp: int) -> bool:
        """Give an answer to the oldest question that it fits; return whether there is one."""
        error = code & ~ALERT
        found = next(((question, slot) for question in self.deferred for slot in question.due
                      if slot.device.number == number and (error or len(data) == slot.size)), None)
        if found is None:
            return False
        question, slot = found
        device = slot.device
        self.note_old_answer(number, stamp)
        question.due.remove(slot)
        if not question.due:
            self._end_deferred(question, ANSWERED, stamp)
        device.counts.answers += 1
        self._registry.accept_status(device, code, stamp)
        device.last_error = error
        if error:
            self._policy.count_refusal(slot, question.plan.request.instruction, error, stamp)
        elif slot.accept(slot.span, data, stamp, READ) and question.effect is not None:
            action, arguments = question.effect
            action(*arguments)
        return True

    def _accept_extra(self, device: Device, code: int, data: bytes, stamp: int,
                      before: Plan) -> None:
        """Accept an answer that waited and that nothing asked for, as far as is known."""
        self._registry.accept_status(device, code, stamp)
        self.note_old_answer(device.number, stamp)
        if device.accept_late_reply(stamp, self.late_reply_ns):
            self._evidence.add_incident(stamp, ev.LATE, device.number, 0)
        elif not data and device.counts.writes:
            device.accept_ack()                # it acknowledges an earlier write
        elif before.asks(device, len(data)) or (
                len(self.deferred) < QUESTIONS_KEPT and device.counts.answers > OWN_ANSWERS_MIN):
            self._evidence.add_incident(stamp, ev.SECOND_ANSWER, device.number,
                                        before.request.instruction)

    def _judge_damaged(self, number: int, stamp: int) -> None:
        """Accept a damaged answer: that to the oldest question, or to one to this device."""
        found = [(question, slot) for question in self.deferred for slot in question.due]
        found.sort(key=lambda one: one[1].device.number != number)
        for question, slot in found[:1]:
            slot.device.count_damaged(question.damaged_ids, 1)
            if len(question.due) == 1:
                self._end_deferred(question, DAMAGED, stamp)

    def accept_truncated_reply(self, frame: Frame, flaw: Flaw, noise: int, slots: dict[int, Slot],
                               stamp: int) -> bool:
        """Accept an answer of which the program discarded just the end; or return False."""
        begin, end, _, number, *_ = frame
        slot = slots.get(number) if self.discarded and noise <= GLITCH else None
        if slot is None or end - begin + self.discarded != slot.status_size:
            return False
        self.discarded = 0
        self._evidence.note_stuffed(stamp, frame, flaw, IN)
        slot.device.counts.answers += 1
        self._registry.accept_status(slot.device, 0, stamp)
        self._evidence.counts[ev.GLITCH] += noise > 0
        self._evidence.add_wait(Wait(stamp, 0, number, True))      # it got no whole answer
        return True

    def count_overlong_reply(self, plan: Plan, received: int, is_noisy: bool) -> None:
        """Count an answer that was longer, by no stray byte; is_noisy: no packet was its end."""
        if (is_noisy or self.discarded) and len(plan.slots) == 1 \
                and not (self.deferred or self.old_until):
            slot = next(iter(plan.slots.values()))
            slot.device.counts.overlong_replies += received + self.discarded > slot.status_size + 1
        self.discarded = 0

    # --- the program has ended ------------------------------------------------------------------

    def judge_last(self, end: int, failed: bool) -> None:
        """
        Judge the questions that a program ended with, if their answers had their time.

        end: when it was heard last; failed: it ended by itself with an error.
        """
        questions = self._questions[LAST]
        end = max(end, self.reported_ns, self.vain_read_ns, self._closed_ns)
        for question in questions:
            slot, waited = next(iter(question.due), None), end - question.asked
            if waited > HUNG_WAIT_NS and slot is not None and not self._left_unread \
                    and (slot.due is not Due.ACK or self._reads_acks(question, slot)) \
                    and max(self.vain_read_ns, self._purged_ns) < question.asked:
                self._evidence.add_incident(end, ev.HUNG, slot.device.number, waited // 1000)
            else:
                self._judge_open(question, failed, question is questions[-1])
        questions.clear()

    def _reads_acks(self, question: OpenQuestion, slot: Slot) -> bool:
        """Return whether a program reads the acknowledgements of a write, or nothing waits."""
        plan = question.plan
        return bool(slot.device.acks) and (
            self.reported_ns > question.asked or (plan.asked > ACKS_READ_MIN and not plan.missed))

    def _judge_open(self, question: OpenQuestion, failed: bool, is_last: bool) -> None:
        now = max(self.reported_ns, self.vain_read_ns)
        slots = [*question.plan.slots.values()]
        is_passed = bool(slots) and slots[-1] not in question.due      # the others had a turn
        if is_passed:
            now = max(now, question.asked + 1)
        has_waited = failed and (question.is_spoilt or self._has_waited(question))
        due = [slot for slot in question.due if self._policy.judge_silence(slot)
               or (has_waited and slot.device.acks is None)]
        us = (now - question.asked) // 1000
        if not due or now < question.asked:
            return
        if self._unsent_ns == question.asked:
            self._note_unsent(question, now)
        elif failed and (is_passed or question.is_spoilt or question.damaged_ids
                       or self._had_time_at_end(question, due, now)):
            self._policy.judge_question(question._replace(due=due), now, now, us)
        elif is_last and (failed or not due[0].device.heard):
            self._evidence.add_incident(now, ev.LEFT_OPEN, due[0].device.number, us)

    def _had_time_at_end(self, question: OpenQuestion, due: list[Slot], now: int) -> bool:
        """Return whether all answers would have come, to a program that read all that did."""
        delay_ns = ADAPTER_DELAY_NS if any(slot.due is Due.ACK for slot in due) \
            else self._slowest_ns()
        return self._has_had_time(question, now, delay_ns) \
            and not self._left_unread and self._purged_ns < question.asked

    def _slowest_ns(self) -> float:
        """Return how long to wait for data, by how soon answers came before."""
        known = [device.latency.total() for device in self._registry.devices.values()]
        return min(ADAPTER_DELAY_NS, ADAPTER_SPARE_NS + ADAPTER_SLOWDOWN * 1e6 * max(
            (one.maximum for one in known if one is not None), default=ADAPTER_DELAY_NS))


def _status_bytes(slots: Iterable[Slot]) -> int:
    """Return how many bytes these answers have on the wire."""
    return sum(slot.status_size for slot in slots)
