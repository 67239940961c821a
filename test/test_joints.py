# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Joint states: what was read, when it was read, and nothing else."""
import struct

from harness import later
from heard_bus import Bus
from heard_bus import MODELS
from heard_bus import SECOND
import pytest

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.values import Sine
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.reports import Joint
from servobus.bus.decoder import Settings
from servobus.bus.expected import Expected
from servobus.monitor import Monitor

BAUD = 2_000_000
TICK = 0.0015339807879             # rad: the resolution of an encoder of 4096 steps
RATE = 100                         # the master's cycle, Hz
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


@pytest.mark.parametrize(('fault', 'rate'), later(
    [(fault, rate) for fault in ('', 'silent:3:1:1', 'noise:2:1:1', 'drop:2:1:1')
     for rate in (20, 200)], [('', 20), ('drop:2:1:1', 200)]))
def test_a_sine_is_followed_within_a_tick_whatever_is_lost(fault, rate):
    """A position is the truth of a moment at most a cycle before its stamp, to the encoder."""
    ids = range(1, 7)
    devices = make_devices(['1-6:MX-106'], MODELS, BAUD)
    sines = {device.id: Sine(phase=0.35 * device.id) for device in devices}
    master = Master(Line(devices, BAUD), PATTERNS['moving'], rate=RATE,
                    faults=[parse(fault)] if fault else [])
    monitor = Monitor('', MODELS, Settings(
        baud=BAUD, devices=tuple(Expected(number, 'MX-106') for number in ids)))
    since, due, told = 0, SECOND, []
    for burst in master.bursts(4 * SECOND):
        now = SECOND + burst.end
        while due < now:
            joints, stamp = monitor.joints(since)
            if joints:
                since = stamp
                told.append((stamp, joints))
            due += int(SECOND / rate)
        monitor.feed(burst.data, now)
    cycle = 1 / min(rate, RATE)
    for stamp, joints in told:
        at = (stamp - SECOND) / 1e9
        for joint in joints:
            sine = sines[int(joint.name)]
            truths = [sine.angle(at - cycle * part / 50) for part in range(51)]
            assert min(truths) - TICK <= joint.position <= max(truths) + TICK
    stamps = [stamp for stamp, _ in told]
    assert stamps == sorted(set(stamps))
    heard = {joint.name for _, joints in told for joint in joints}
    assert heard == {f'{number:03}' for number in ids}
    if not fault:
        assert len(told) >= 3.5 * min(rate, RATE)
