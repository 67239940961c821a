# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
ReplyPolicy: which device really had to answer, so that only a loss counts as one, and the losses.

Status Return Level decides (e-Manual): 0 answers Pings, 1 reads too, 2 acknowledges writes as
well. It is known where the register was seen; else a device that acknowledged once is taken to do
so always, until it stops while it goes on answering reads.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from msg_defs.servo_frame import GLITCH
from servobus.bus import evidence as ev
from servobus.bus.evidence import Evidence
from servobus.bus.plan import Due
from servobus.bus.plan import Effect
from servobus.bus.plan import Plan
from servobus.bus.plan import Slot
from servobus.bus.plan import STATUS_OVERHEAD
from servobus.bus.registry import DeviceRegistry
from servobus.bus.report import Wait

ACKS_MISSING_MAX = 3               # writes without an answer, from a device that answers reads


class OpenQuestion(NamedTuple):
    """A question that is over: its answers that did not come, and what came in their place."""

    plan: Plan
    due: list[Slot]
    damaged_ids: set[int]                # IDs with a damaged answer
    is_spoilt: bool                # there was damage
    asked: int = 0                 # stamp
    effect: Effect | None = None   # what it does once it is accepted


@dataclass
class ReplyPolicy:
    """write_acks: 'auto', 'always' or 'never'; missed_limit: both as the parameters."""

    _write_acks: str
    _missed_limit: int
    _registry: DeviceRegistry
    _evidence: Evidence

    def judge_silence(self, slot: Slot) -> bool:
        """Return whether this status, which did not come, had to come."""
        device = slot.device
        if device.is_unresolved:
            self._registry.resolve(device)       # its model says where its level is
        if slot.due is Due.READ:
            return device.return_level != 0
        if slot.due is Due.ALWAYS or self._write_acks == 'always':
            return True
        if self._write_acks == 'never' or device.acks is False:
            return False
        device.acks_missing += 1
        if device.acks is None:
            return False
        if device.missed_in_a_row < ACKS_MISSING_MAX - 1 \
                and device.acks_missing >= ACKS_MISSING_MAX:
            device.acks = False                # it answers reads, so it is there
            self._evidence.add_incident(device.asked_stamp, ev.ACKS_STOPPED, device.number,
                                        device.acks_missing)
        return bool(device.acks)

    def count_refusal(self, slot: Slot, instruction: int, code: int, stamp: int) -> None:
        """Note a refusal, which is an acknowledgement too."""
        if slot.due is Due.ACK:
            slot.device.accept_ack()
        refusal = instruction, slot.span[0], code
        slot.device.count_refusal(*refusal)
        self._evidence.add_incident(stamp, ev.REFUSED, slot.device.number, *refusal)

    def judge_question(self, question: OpenQuestion, now: int, stamp: int, us: int = -1) -> None:
        """
        Count the missed, and those not served because the master gave up before them.

        now: when, on the wire; stamp: of the chunk. us: for how long the master waited, if known.
        """
        plan, due, damaged_ids, is_spoilt, *_ = question
        if us >= 0:
            self._evidence.add_wait(Wait(now, us, due[0].device.number, is_spoilt,
                                         plan.request.instruction))
        served, behind = plan.find_blocker(due, damaged_ids)
        for slot in due[:served]:
            self.count_missed(plan, slot, now, stamp,
                              is_spoilt or slot.device.number in damaged_ids)
        for slot in due[served:]:
            slot.device.count_not_served(now, stamp, behind)

    def attribute_noise(self, question: OpenQuestion, noise: int, slots: Iterable[Slot],
                      now: int) -> None:
        """Note who the noise may come from; slots: of all answers that did not come."""
        most = sum(slot.size + STATUS_OVERHEAD for slot in slots)
        first = question.due[0].device
        if noise > most + GLITCH:
            self._evidence.add_frequent(now, ev.TOO_LONG, first.number, noise, most)
        elif not question.damaged_ids:
            first.count_damaged(question.damaged_ids)

    def count_missed(self, plan: Plan, slot: Slot, now: int, stamp: int,
                     is_doubtful: bool) -> None:
        """Count an answer that had to come and did not; is_doubtful: damage was in its place."""
        device = slot.device
        plan.missed += 1
        device.count_missed(now, stamp, is_doubtful)
        device.counts.data_missed += slot.due is Due.READ
        if device.missed_in_a_row == 1:
            self._evidence.add_incident(now, ev.MISSED, device.number, plan.request.instruction,
                                        slot.span[0])
        elif device.missed_in_a_row == self._missed_limit + 1:
            self._evidence.add_incident(now, ev.DISCONNECTED, device.number,
                                        device.missed_in_a_row)
