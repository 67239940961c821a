# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Joint states: what was read, when it was read, and nothing else."""
import struct

from heard_bus import Bus
from heard_bus import MODELS
import pytest

from msg_defs.diagnostics import Joint
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from servobus.bus.expected_devices import Expected

TICK = 0.0015339807879             # rad: the resolution of an encoder of 4096 steps


READ = encode(1, I.READ, struct.pack('<HH', 126, 10))


def answer(current, velocity, position):
    return encode(1, STATUS, struct.pack('<hii', current, velocity, position), error=0)


def test_values_in_si_units_with_the_stamp_of_their_bytes():
    bus = Bus(Expected(1, 'MX-106', 'knee'))
    stamp = bus.hear(READ, answer(100, -10, 3072))
    joints, at = bus.monitor.joints(0)
    assert at == stamp
    [joint] = joints
    assert joint.name == 'knee'
    assert joint.position == pytest.approx(1024 * TICK)
    assert joint.velocity == pytest.approx(-10 * 0.229 * 6.283185 / 60, rel=1e-3)
    assert joint.effort == pytest.approx(100 * 0.00336 * 1.615)


def test_nothing_is_told_twice():
    bus = Bus(Expected(1, 'MX-106'))
    bus.hear(READ, answer(0, 0, 2048))
    _, stamp = bus.monitor.joints(0)
    assert bus.monitor.joints(stamp) == ((), 0)
    bus.hear(READ)
    assert bus.monitor.joints(stamp) == ((), 0)
    later = bus.hear(READ, answer(0, 0, 2049))
    assert bus.monitor.joints(stamp)[1] == later


@pytest.mark.parametrize(('model', 'code', 'params', 'data', 'joints'), [
    ('XL430-W250', I.READ, struct.pack('<HH', 132, 4), struct.pack('<i', 2048),
     (Joint('001', pytest.approx(0.0, abs=1e-9)),)),
    ('MX-106', I.WRITE, struct.pack('<Hi', 116, 3000), b'', ()),    # what the master writes
    ('MX-106', I.WRITE, struct.pack('<Hi', 132, 3000), b'', ()),
    ('BitFoot', I.READ, struct.pack('<HH', 36, 16), bytes(16), ())])       # has no position
def test_only_positions_that_were_read(model, code, params, data, joints):
    bus = Bus(Expected(1, model))
    stamp = bus.hear(encode(1, code, params), encode(1, STATUS, data, error=0))
    assert bus.monitor.joints(0) == (joints, stamp if joints else 0)


def test_no_effort_without_a_torque_constant():
    bus = Bus(Expected(1, 'XW540-H260'))
    assert MODELS.by_name('XW540-H260').torque_constant is None
    bus.hear(READ, answer(100, 0, 2048))
    [joint] = bus.monitor.joints(0)[0]
    assert joint.effort is None
    assert joint.velocity == 0


def test_an_unknown_device_is_no_joint_until_it_is_known():
    bus = Bus()
    bus.hear(READ, answer(0, 0, 2048))
    assert bus.monitor.joints(0) == ((), 0)
    stamp = bus.hear(encode(1, I.PING), encode(1, STATUS, b'\x41\x01\x2a', error=0))
    bus.monitor.report(stamp)
    assert bus.monitor.joints(stamp) == ((), 0)
    bus.hear(READ, answer(0, 0, 2048))
    assert len(bus.monitor.joints(stamp)[0]) == 1
