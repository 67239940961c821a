# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a program has received and not read: only a tap knows it (Change UNREAD).

Answers that waited when it asked the next thing belong to what it asked before. And what was not
there when it closed its port did not come at all.
"""

from collections.abc import Callable

from dxl_monitor.bus import evidence as ev
from dxl_monitor.bus.device import OWED_NS
from dxl_monitor.bus.evidence import Evidence
from dxl_monitor.bus.plan import Due
from dxl_monitor.bus.planner import NO_PLAN
from dxl_monitor.bus.registry import DeviceRegistry
from dxl_monitor.bus.reply_policy import OpenQuestion
from dxl_monitor.bus.reply_policy import ReplyPolicy
from dxl_monitor.bus.table import READ
from msg_defs.dxl_instruction import ALERT
from msg_defs.frame import Frames

AROUND = 11                        # bytes of a status without its data
READ_LATE_NS = 10_000_000_000
ADAPTER_NS = 17_000_000            # a latency timer of 16 ms, and Return Delay Time
_NOTHING = OpenQuestion(NO_PLAN, [], set(), False)


class Unread:
    """
    The answers of one bus that were not read when their question was over.

    until: the offset of the stream to the master up to which it is old, 0: nothing; stamp: when
    that was said, 0: never. left: the question whose answers may be there. patience_ns: for how
    long an answer that was given up may still come.
    """

    def __init__(self, registry: DeviceRegistry, evidence: Evidence, duty: ReplyPolicy) -> None:
        self.until = self.stamp = self._purged = 0
        self.patience_ns = OWED_NS
        self.left = _NOTHING
        self._registry = registry
        self._evidence = evidence
        self._duty = duty

    def say(self, until: int, stamp: int) -> None:
        """Take note of what is not read yet: up to an offset, 0: all is read."""
        self.until, self.stamp, self.patience_ns = until, stamp, READ_LATE_NS
        if not until:
            self.left = _NOTHING

    def purge(self, stamp: int) -> None:
        """Take note that the program threw away what it had received."""
        self.until, self.left, self._purged = 0, _NOTHING, stamp

    def take(self, frames: Frames, stamp: int, received: int) -> Frames:
        """Take the answers that are old; return the other frames."""
        _, due, spoke, is_spoilt = self.left
        rest = []
        for frame in frames:
            begin, _, kind, number, code, data, flaw = frame
            if begin >= self.until or kind:
                rest.append(frame)
                continue
            slot = next((one for one in due if one.device.number == number), None)
            if flaw is not None and flaw.reason:
                self._evidence.note_damage(stamp, frame, flaw)
                is_spoilt = True
                if slot is not None:
                    spoke.add(number)
                    slot.device.counts.garbled += 1
                    slot.device.counts.damaged += 1
                continue
            device = self._registry.device(number)
            self._registry.heard(device, code, stamp)
            if slot is not None:
                due.remove(slot)
                device.counts.answers += 1
                if slot.due is Due.ACK:
                    device.acknowledged()
                elif not code & ~ALERT and len(data) == slot.size:
                    slot.take(slot.span, data, stamp, READ)
        if received >= self.until:             # all of it is read: the others did not answer
            if due:
                self._duty.judge(self.left._replace(is_spoilt=is_spoilt), stamp, stamp)
            self.say(0, stamp)
        return rest

    def end(self, failed: bool, asked: int, since_asked: Callable[[int], int],
            byte_ns: float) -> None:
        """
        Judge the question that a program ended with, if its answer had its time.

        failed: it ended by itself with an error; asked: stamp of the question; since_asked: the us
        from its end to a stamp.
        """
        due, now = [slot for slot in self.left.due if self._duty.is_due(slot)], self.stamp
        if not due or now < asked:
            return
        us = since_asked(now)
        enough_ns = ADAPTER_NS + byte_ns * sum(slot.size + AROUND for slot in due)
        is_known = self.left.is_spoilt or (    # it came, and was damaged; or it did not come
            1000 * us >= enough_ns and not self.until and self._purged < asked)
        if failed and is_known:
            self._duty.judge(self.left._replace(due=due), now, now, us)
        elif failed or not due[0].device.heard:
            self._evidence.note(now, ev.LEFT_OPEN, due[0].device.number, ev.Lateness(us))
        self.left = _NOTHING
