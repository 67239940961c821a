# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The fake MCU's receiver: any bytes at any time."""

from fuzz.script import Script
from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import Vel2d
from vel2d_bridge.receiver import Cable
from vel2d_bridge.receiver import LOOP
from vel2d_bridge.receiver import QUEUE_DEPTH
from vel2d_bridge.receiver import Receiver

PAUSES_NS = (0, 0, 50_000, 90_000, 200_000, 2_500_000, 30_000_000, 400_000_000)


def check(data):
    """
    Check one stretch of what a UART brings.

    Never raises; every byte ends in a callback or is still in the buffer; every good frame is
    taken, queued or dropped; 10 wait at most; the wheels follow nothing that was not sent, one
    set-point per turn of the pose loop.
    """
    script = Script(data)
    receiver = Receiver(baud=script.pick((9600, 115200, 1_000_000)))
    cable = Cable(drop=script.byte() % 4, flip=script.byte() % 4, deaf_after=script.byte(),
                  seed=script.byte())
    now = arrived = 0
    velocities = {(0.0, 0.0, 0.0)}
    while script:
        chunk = cable.carry(piece(script))
        receiver.feed(chunk, now)
        now = max(now, receiver.line_free) + script.pick(PAUSES_NS)
        if cable.overruns():
            receiver.overrun()
            break
        stamps = [0]
        for point in receiver.advance(now):
            assert point.stamp >= stamps[-1] + LOOP * (stamps[-1] > 0)
            stamps.append(point.stamp)
        while receiver.arrivals:
            arrival = receiver.arrivals.popleft()
            arrived += arrival.size
            if arrival.velocity is not None:
                velocities.add(tuple(map(repr, scaled(arrival.velocity))))
        assert tuple(map(repr, receiver.wheels[1:])) in velocities | {('0.0',) * 3}
        counts(receiver, arrived)


def scaled(velocity):
    return velocity.x * 1000.0, velocity.y * 1000.0, velocity.omega


def piece(script):
    if script.byte() < 100:
        return script.take(script.byte() % (3 * FRAME_SIZE))
    frame = encode(Vel2d(script.byte() / 100, -script.byte() / 100, script.byte() / 10))
    assert decode(frame) is not None
    return frame * (1 + script.byte() % 3)


def counts(receiver, arrived):
    totals = receiver.totals
    assert totals.received == arrived + len(receiver._buffer)
    assert len(receiver._buffer) < FRAME_SIZE
    assert receiver.queued <= QUEUE_DEPTH
    assert totals.frames == totals.taken + totals.queue_full + receiver.queued + len(
        receiver._good)
