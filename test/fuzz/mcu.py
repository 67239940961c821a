# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The fake MCU's receiver: any bytes at any time."""

from collections import deque
import struct

from fuzz import reference
from fuzz.script import Script
from fuzz.vel2d import value
from mecarover_fakes.receiver import BadCable
from mecarover_fakes.receiver import Receiver

SIZE = 28
LOOP_NS = 30_000_000
DEPTH = 10
PAUSES_NS = (0, 0, 50_000, 90_000, 200_000, 2_500_000, 30_000_000, 400_000_000)


def check(data):
    """
    Check one stretch of what a UART brings.

    Never raises; every byte ends in a callback or is still in the buffer, and after an overrun
    in `unheard`; callbacks come when the buffer is full or the line was idle for a character, in
    any split; every good frame is taken, queued or dropped; 10 wait at most, the newest is
    dropped; one set-point per turn of the pose loop, in order, and the wheels follow nothing
    that was not sent. What was sent is judged by fuzz/reference.py.
    """
    script = Script(data)
    baud = script.pick((9600, 115200, 1_000_000))
    receiver, twin = Receiver(baud=baud), Receiver(baud=baud)
    line = Line(-(-10_000_000_000 // baud))
    cable = BadCable(drop=script.byte() % 4, flip=script.byte() % 4, deaf_after=script.byte(),
                     seed=script.byte())
    now = 0
    assert receiver.arrivals.maxlen is not None
    arrivals, taken = [], []
    while script:
        chunk = carried(cable, piece(script))
        at = script.byte()
        receiver.feed(chunk, now)
        for part in (chunk[:at], chunk[at:]):
            twin.feed(part, now)
        line.feed(chunk, now)
        if cable.overruns():
            receiver.overrun()
            twin.overrun()
            line.overrun(now)
        now = max(now, receiver.line_free) + script.pick(PAUSES_NS)
        taken += receiver.advance(now)
        twin.advance(now)
        new = [as_bits(one) for one in receiver.arrivals]
        assert [as_bits(one) for one in twin.arrivals] == new
        assert bits(twin.wheels[1:]) == bits(receiver.wheels[1:])
        arrivals += new
        receiver.arrivals.clear()
        twin.arrivals.clear()
        counts(receiver, line, sum(size for _, size, _ in arrivals))
    assert arrivals == line.arrivals(now)
    expected, dropped = followed(arrivals, now)
    assert [(one.stamp, bits(one[1:])) for one in taken] == expected
    assert receiver.totals.queue_full == dropped
    assert not taken or receiver.wheels is taken[-1]


class Line:
    """What comes over a UART, byte by byte with the ns at which each has ended."""

    def __init__(self, character):
        self.character = character
        self.free = self.fed = self.unheard = 0
        self.heard = []
        self.deaf_from = None          # ns

    def feed(self, chunk, now):
        self.fed += len(chunk)
        if self.deaf_from is not None:
            self.unheard += len(chunk)
            return
        for byte in chunk:
            self.free = max(self.free, now) + self.character
            self.heard.append((self.free, byte))

    def overrun(self, now):
        """Go deaf; what is in the buffer and was not followed by silence has no callback."""
        self.deaf_from = now

    def arrivals(self, now):
        """Return the callbacks up to now: (ns, bytes, the bits of the velocity or None)."""
        found, group, last = [], b'', 0
        idle = now if self.deaf_from is None else self.deaf_from
        for end, byte in [*self.heard, (idle + self.character, None)]:
            if group and end - 2 * self.character >= last:
                found.append((last + self.character, len(group), None))
                group = b''
            if byte is not None:
                group += bytes([byte])
                last = end
            if len(group) == SIZE:
                is_good = group[24:] == reference.crc32(group[:24]).to_bytes(4, 'little')
                found.append((end, SIZE, group[:24] if is_good else None))
                group = b''
        return found


def bits(values):
    return struct.pack('<ddd', *values)


def as_bits(arrival):
    return (arrival.stamp, arrival.size,
            None if arrival.velocity is None else bits(arrival.velocity))


def followed(arrivals, now):
    """Return what the pose loop takes up to now, and how many set-points find the queue full."""
    good = deque((stamp, velocity) for stamp, _, velocity in arrivals if velocity is not None)
    queue, taken, dropped = deque(), [], 0
    for turn in [*range(LOOP_NS, now + 1, LOOP_NS), None]:
        while good and good[0][0] <= (now if turn is None else turn):
            if len(queue) < DEPTH:
                queue.append(good.popleft()[1])
            else:
                good.popleft()
                dropped += 1
        if queue and turn is not None:
            x, y, omega = struct.unpack('<ddd', queue.popleft())
            taken.append((turn, bits((x * 1000, y * 1000, omega))))
    return taken, dropped


def piece(script):
    if script.byte() < 100:
        return script.take(script.byte() % (3 * SIZE))
    if script.byte() < 40:
        values = b''.join(value(script) for _ in range(3))
    else:
        values = bits((script.byte() / 100, -script.byte() / 100, script.byte() / 10))
    frame = values + reference.crc32(values).to_bytes(4, 'little')
    return frame * (1 + script.byte() % (15 if script.byte() > 200 else 3))


def carried(cable, sent):
    """Hold that a cable changes a byte of a frame at most, and counts what it changed."""
    damaged = cable.damaged
    arrived = cable.carry(sent)
    assert len(sent) - 1 <= len(arrived) <= len(sent)
    assert cable.damaged - damaged == (arrived != sent)
    return arrived


def counts(receiver, line, arrived):
    totals = receiver.totals
    assert totals.received == line.fed
    assert totals.unheard == line.unheard
    if line.deaf_from is None:
        assert line.fed == arrived + len(receiver._buffer)
    assert len(receiver._buffer) < SIZE
    assert receiver.queued <= DEPTH
    assert totals.frames == totals.taken + totals.queue_full + receiver.queued + len(
        receiver._good)
