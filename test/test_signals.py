# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Registers at the rate of the bus: what is recorded is what was sent; it is bounded."""
from random import Random
import struct

from heard_bus import MS
from heard_bus import SECOND
import pytest
from tracked_bus import GOAL
from tracked_bus import POSITION
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import words

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.signal import PointRing
from msg_defs.signal import POINTS_MAX
from servobus.bus.decoder import Settings
from servobus.bus.expected_devices import Expected
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
FIELD = {field.key: field for field in MODELS.by_name('XM430-W350').fields}
PRESENT, SET = 'Present Position (rad)', 'Goal Position (rad)'
REGISTERS = ('Present Current (A)', 'Present Velocity (rad/s)', PRESENT,
             'Present Temperature (\u00b0C)')
FRONT, SIZE = FIELD[REGISTERS[0]].at, 21            # one Sync Read has all four


def bus_of(*numbers):
    monitor = Monitor('arm', MODELS, Settings(devices=tuple(
        Expected(number, 'XM430-W350', '') for number in numbers)))
    monitor.signals.start()
    return monitor


def points(monitor, number, key, after=0, since_s=0.0):
    found = monitor.signals.read(number, key, after, since_s)
    return list(struct.iter_unpack('<dd', found.data))


def hear(monitor, *packets, at_s):
    for nth, packet in enumerate(packets):
        monitor.feed(packet, int(at_s * SECOND) + nth * MS)


def fed(sent, monitor, servos, rate, seconds, silent=(0, 0.0, 0.0)):
    """Feed Sync Reads with random answers, a chunk a cycle: sent[ID] = [(s, bytes), ...]."""
    random = Random(1)
    sent |= {number: [] for number in servos}
    ask = encode(0xFE, I.SYNC_READ, words(FRONT, SIZE) + bytes(servos))
    number, begin_s, end_s = silent
    for cycle in range(int(seconds * rate)):
        stamp = SECOND + cycle * SECOND // rate
        chunks = [ask]
        for servo in servos:
            if servo == number and begin_s <= cycle / rate < end_s:
                break                               # those after it wait for their turn
            data = random.randbytes(SIZE)
            chunks.append(reply(servo, data))
            sent[servo].append((stamp / 1e9, data))
        monitor.feed(b''.join(chunks), stamp)
        yield stamp


def value(key, data):
    field = FIELD[key]
    return field.decode(data[field.at - FRONT:field.end - FRONT]).number


def check_what_is_recorded(servos, rate, seconds, chosen):
    """Ask ten times a second, as a page does; return how many points came."""
    monitor = bus_of(*servos)
    found = {one: [] for one in chosen}
    after = dict.fromkeys(chosen, 0)
    asked = 0
    for one in chosen:
        points(monitor, *one)
    sent = {}
    for stamp in fed(sent, monitor, servos, rate, seconds):
        if stamp - asked < SECOND // 10:
            continue
        asked = stamp
        for one in chosen:
            some = monitor.signals.read(*one, after[one], stamp / 1e9 - 60)
            found[one] += struct.iter_unpack('<dd', some.data)
            after[one] = some.first + len(some.data) // 16
    for number, key in chosen:
        some = found[number, key]
        assert some == [(at_s, value(key, data)) for at_s, data in sent[number][:len(some)]]
        assert len(some) > len(sent[number]) - rate / 5
    return sum(map(len, found.values()))


@pytest.mark.parametrize(('servos', 'rate', 'seconds', 'chosen'), [
    (range(1, 7), 60, 20, [(number, key) for number in range(1, 7) for key in REGISTERS]),
    (range(1, 21), 500, 2, [(number, key) for number in (1, 20) for key in REGISTERS])])
def test_points_are_what_was_sent(servos, rate, seconds, chosen):
    assert check_what_is_recorded(list(servos), rate, seconds, chosen) > 0


def test_a_register_that_is_chosen_now_has_the_last_minute():
    monitor, sent = bus_of(1, 2), {}
    for _ in fed(sent, monitor, [1, 2], 10, 200):
        pass
    last_s = 1 + 199.9
    for key in REGISTERS:
        late = points(monitor, 2, key, 0, last_s - 59.95)
        assert late == [(at_s, value(key, data)) for at_s, data in sent[2][-600:]]
    kept = sum(len(log.data) for one in monitor.signals._recorders.values()
               for log in one.logs.values())
    assert kept < 2 * 2 * 600 * (8 + SIZE)


def test_all_spans_together_are_bounded(monkeypatch):
    monkeypatch.setattr('servobus.signals.BYTES_MAX', 100_000)
    monkeypatch.setattr('servobus.signals.LOGS_MAX', 32)
    monitor = bus_of(1, 2)
    for cycle in range(20_000):                     # a minute has more than there is room for
        hear(monitor, read(1), reply(1, bytes(4)), at_s=cycle / 1000)
    for address in range(600):                      # and no span comes twice
        hear(monitor, read(2, address, 4), reply(2, bytes(4)), at_s=21 + address / 100)
    logs = [log for one in monitor.signals._recorders.values() for log in one.logs.values()]
    assert sum(log.limit for log in logs) < 150_000
    assert max(len(one.logs) for one in monitor.signals._recorders.values()) == 32
    late = points(monitor, 1, PRESENT)
    assert len(late) > 2000
    assert late[-1][0] == pytest.approx(20.0)


def test_the_past_begins_where_registers_began_to_mean_what_they_do():
    monitor = bus_of(1)
    data = FIELD['Indirect Data 1'].at
    for begin_s, target in ((1.0, POSITION), (3.0, FIELD['Present Current (A)'].at)):
        hear(monitor, point_at(1, *range(target, target + 4)), reply(1), at_s=begin_s)
        for nth in range(5):
            hear(monitor, read(1, data, 4), reply(1, struct.pack('<i', 3072)),
                 at_s=begin_s + nth / 10 + 0.1)
            hear(monitor, read(1, FIELD['Indirect Address 1'].at, 2),       # as it was written
                 reply(1, words(target)), at_s=begin_s + nth / 10 + 0.15)
    assert points(monitor, 1, PRESENT) == []
    assert len(points(monitor, 1, 'Present Current (A)')) == 5


def test_memory_is_bounded_and_numbers_go_on():
    ring = PointRing()
    for number in range(POINTS_MAX + 5000):
        ring.add(number / 1000, float(number))
    found = ring.after(0, 0.0)
    assert (found.first, len(found.data)) == (5000, POINTS_MAX * 16)
    assert next(struct.iter_unpack('<dd', found.data)) == (5.0, 5000.0)
    assert ring.after(POINTS_MAX + 4999, 0.0).data == found.data[-16:]
    assert ring.after(POINTS_MAX + 5000, 0.0).data == b''
    assert ring.after(10**12, 0.0) == found             # unknown: all


def test_goals_are_recorded_as_written_unless_refused():
    monitor = bus_of(1)
    goal = encode(1, I.WRITE, words(GOAL) + struct.pack('<i', 3072))
    hear(monitor, goal, reply(1), at_s=1.0)
    hear(monitor, goal, reply(1, error=4), at_s=2.0)    # out of range
    hear(monitor, encode(0xFE, I.SYNC_WRITE, words(GOAL, 4) + b'\1' + struct.pack('<i', 1024)),
         at_s=3.0)
    assert points(monitor, 1, SET) == [(1.0, pytest.approx(1.5708, abs=1e-4)),
                                       (3.0, pytest.approx(-1.5708, abs=1e-4))]
    assert monitor.signals.read(1, SET, 0, 0.0).is_written
    hear(monitor, read(1, GOAL), reply(1, bytes(4)), at_s=4.0)
    assert not monitor.signals.read(1, SET, 0, 0.0).is_written


def point_at(first, *targets):
    address = FIELD[f'Indirect Address {first}'].at
    return encode(1, I.WRITE, words(address, *targets))


def test_a_register_in_indirect_data_follows_where_that_points():
    monitor = bus_of(1)
    points(monitor, 1, PRESENT)
    data = FIELD['Indirect Data 1'].at
    hear(monitor, point_at(1, 7, *range(POSITION, POSITION + 4)), reply(1), at_s=1.0)
    hear(monitor, read(1, data, 5), reply(1, b'\7' + struct.pack('<i', 3072)), at_s=2.0)
    hear(monitor, point_at(1, *range(POSITION, POSITION + 4)), reply(1), at_s=3.0)
    hear(monitor, read(1, data, 5), reply(1, struct.pack('<i', 1024) + b'\7'), at_s=4.0)
    hear(monitor, point_at(1, 7, 7, 7), reply(1), at_s=5.0)
    hear(monitor, read(1, data, 5), reply(1, bytes(5)), at_s=6.0)
    hear(monitor, read(1), reply(1, struct.pack('<i', 2048)), at_s=7.0)
    assert points(monitor, 1, PRESENT) == [
        (pytest.approx(2.001), pytest.approx(1.5708, abs=1e-4)),
        (pytest.approx(4.001), pytest.approx(-1.5708, abs=1e-4)),
        (pytest.approx(7.001), pytest.approx(0, abs=1e-9))]


def test_a_device_is_recorded_from_its_first_byte_and_as_what_it_is():
    """What its registers are is known later; its past goes with it to another ID."""
    monitor = Monitor('arm', MODELS)
    monitor.signals.start()
    assert monitor.signals.read(1, PRESENT, 0, 0.0) is None
    hear(monitor, read(1), reply(1, struct.pack('<i', 1024)), at_s=0.1)
    hear(monitor, encode(1, I.PING), reply(1, words(1020) + b'\x2d'), at_s=0.5)
    hear(monitor, read(1), reply(1, struct.pack('<i', 3072)), at_s=1.0)
    times = [pytest.approx(0.101), pytest.approx(1.001)]
    assert [at_s for at_s, _ in points(monitor, 1, PRESENT)] == times
    hear(monitor, encode(1, I.WRITE, words(7) + b'\2'), reply(2), at_s=2.0)        # another ID
    hear(monitor, read(2), reply(2, struct.pack('<i', 1024)), at_s=3.0)
    assert monitor.signals.read(1, PRESENT, 0, 0.0) is None
    assert [at_s for at_s, _ in points(monitor, 2, PRESENT)] == [*times, pytest.approx(3.001)]


def test_another_model_at_an_id_has_no_past():
    monitor = bus_of(1)
    hear(monitor, read(1), reply(1, struct.pack('<i', 1024)), at_s=1.0)
    hear(monitor, encode(1, I.PING), reply(1, words(1060) + b'\x2d'), at_s=2.0)
    hear(monitor, read(1), reply(1, struct.pack('<i', 1024)), at_s=3.0)
    assert [at_s for at_s, _ in points(monitor, 1, PRESENT)] == [pytest.approx(3.001)]


def test_nothing_is_kept_where_no_page_is():
    monitor = Monitor('arm', MODELS)
    hear(monitor, read(1), reply(1, bytes(4)), at_s=1.0)
    table = monitor.decoder.registry.devices[1].table
    assert type(table._latest) is dict
    assert monitor.signals.read(1, PRESENT, 0, 0.0) is None
    monitor.signals.start()
    assert type(table._latest) is not dict
    points(monitor, 1, PRESENT)
    monitor.signals.drop(1, PRESENT)
    assert monitor.signals._recorder(1).rings == {}
