# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol 1.0 and Feetech on a wire: what is a packet, which way it goes, which dialect it is."""

from pathlib import Path
import struct

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest
import yaml

from msg_defs.dxl1_detector import Detector
from msg_defs.dxl1_packet import encode
from msg_defs.dxl_mixed import ALONE_PACKETS
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import encode as encode_2
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import is_good
from servobus.bus.decoder import Settings
from servobus.bus.dxl1_classifier import MEANINGS_KEPT
from servobus.bus.expected_devices import Expected
from servobus.bus.expected_devices import parse_all
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
BAUD = 1_000_000
BYTE_NS = 10_000
MS = 1_000_000
SO_101 = range(1, 7)


class Bus:
    """A monitor and its time; each packet is a chunk of its own, read when its last byte came."""

    def __init__(self, protocol='auto', *devices):
        self.monitor = Monitor('arm', MODELS, Settings(baud=BAUD, protocol=protocol,
                                                       devices=devices))
        self.now = 100_000 * MS

    def say(self, *packets, after_ms=0.3):
        for packet in packets:
            self.now += int(after_ms * MS) + len(packet) * BYTE_NS
            self.monitor.feed(packet, self.now)

    def ask(self, *packets, after_ms=10.0):
        """Say an instruction after a pause, and the answers at once."""
        self.say(packets[0], after_ms=after_ms)
        self.say(*packets[1:])

    def report(self):
        return self.monitor.report(self.now + 300 * MS)

    def devices(self):
        return {device.id: device for device in self.report().devices}

    def shown(self, number):
        return {one.field.name: one.value.text for one in self.devices()[number].observed}


def cycle(step=0):
    """Return a cycle of LeRobot on an SO-101: all positions read, then all goals written."""
    where = struct.pack('<H', 2000 + step % 100)
    return [encode(0xFE, 0x82, bytes((56, 2, *SO_101))),
            *(encode(one, 0, where) for one in SO_101),
            encode(0xFE, 0x83, bytes((42, 2)) + b''.join(bytes([one]) + where for one in SO_101))]


HEARD = yaml.safe_load(Path(__file__).with_name('dialects.yaml').read_text(encoding='utf-8'))
CODES = {'ping': (1, 0), 'read': (2, 2), 'write': (3, 1), 'code': (0, 0), 'status': (0, 0)}


def packets(text):
    """Return the packets that a few words are; dialects.yaml says which."""
    what, *words = text.split()
    if what == 'cycle':
        return cycle()
    if what == 'turn':
        return [packet for one in (1, 2, 3) for packet in (
            encode(one, 2, b'\x38\2'), encode(one, 0, b'\0\x08'))]
    if what == '2.0':
        return [READ_2 if words == ['read'] else REPLY_2]
    if what == 'hex':
        return [bytes.fromhex(words[0])]
    said, _, error = ' '.join(words).partition(' error ')
    number, *words = said.split()
    code, decimal = CODES[what]
    code = int(words.pop(0)) if what == 'code' else int(error or code)
    return [encode(int(number), code, bytes(map(int, words[:decimal]))
                   + bytes.fromhex(''.join(words[decimal:])))]


def hear(bus, entry):
    """Let an entry be said, as often as it says."""
    times, x, rest = entry.partition(' x ')
    for _ in range(int(times) if x else 1):
        *said, = (rest or entry).split('; ')
        if said[0].startswith('wait'):
            bus.now += int(said.pop(0).split()[1]) * MS
        if said[0].startswith(('in ', 'out ')):
            sided(bus, *((side, packet) for side, _, words in (one.partition(' ') for one in said)
                         for packet in packets(words)))
        else:
            bus.ask(*(packet for one in said for packet in packets(one)))


def known(bus, key):
    what, *numbers = key.split()
    report = bus.report()
    if key in ('dialect', 'protocol', 'devices', 'findings', 'rules'):
        return {'dialect': dialect(bus), 'protocol': report.protocol,
                'findings': [one.message for one in report.findings],
                'rules': {one.rule: one.device or 'bus' for one in report.findings},
                'devices': [one.id for one in report.devices]}[key]
    if not key[-1].isdigit():
        return report.counters.get(key, report.kinds.get(key, 0))
    found = [known_of(bus, what, int(number)) for number in numbers]
    return found if len(found) > 1 else found[0]


def known_of(bus, what, number):
    device = bus.devices()[number]
    if what == 'shown':
        return bus.shown(number)
    found = getattr(device.totals if hasattr(device.totals, what) else device, what)
    return [*map(list, found)] if what == 'errors' else found


ROWS = [(name, protocol) for name, rows in HEARD.items()
        for protocol in ({} if isinstance(rows[0], list) else rows[0]).get('protocols', ['auto'])]


@pytest.mark.parametrize(('name', 'protocol'), ROWS)
def test_what_is_heard_and_known(name, protocol):
    bus = Bus(protocol)
    for step in HEARD[name]:
        if isinstance(step, list):
            for entry in step:
                hear(bus, entry)
        elif 'protocols' in step or 'listed' in step:
            bus = Bus(protocol, *parse_all(step.get('listed', ())))
        else:
            found = {key: known(bus, key) for key in step}
            for key, value in step.items():
                if isinstance(value, dict):
                    found[key] = {register: found[key].get(register) for register in value}
            assert found == step


# ---- instruction or status ----------------------------------------------------------------------

PING = encode(1, 1)                # and the answer of 1 with "voltage"


def test_the_first_instruction_of_a_bus_counts_in_its_cycle():
    bus = Bus('feetech', Expected(1, 'STS3215'))
    for _ in range(3):
        bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    assert [one.asked for one in bus.report().cycles] == [3]


def test_what_is_remembered_of_instructions_is_bounded():
    bus = Bus('1', Expected(1))
    classifier = bus.monitor.decoder.classifier
    sizes = set()
    for number in range(1, MEANINGS_KEPT + 3):
        bus.ask(encode(1, 2, bytes((number & 0xFF, 1 + (number >> 8)))))
        sizes.add(len(classifier._meanings))
    assert sizes == set(range(1, MEANINGS_KEPT + 1))


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
def test_ff_ff_fd_in_the_data_is_neither_stuffed_nor_a_header(protocol):
    bus = Bus(protocol, Expected(2, 'STS3215'))
    bus.ask(*cycle())
    data = b'\xff\xff\xfd\xfd\xff\xff\xfd\0\1\2\3'
    bus.ask(encode(2, 3, b'\x64' + data), encode(2, 0))
    bus.ask(encode(2, 2, b'\x64\x0b'), encode(2, 0, data), after_ms=40)
    bus.report()                   # looks like 2.0 as long as more may come
    table = bus.monitor.decoder.registry.devices[2].table
    assert table.bytes(100, len(data)) == data
    found = bus.report().counters
    assert (found['Noise Bytes'], found['Truncated Packets'], found['Bad Lengths']) == (0, 0, 0)
    assert 'unstuffed' not in bus.report().kinds


@pytest.mark.parametrize(('waited_ns', 'instructions', 'answers', 'still_open'), [
    (3_000_000, 2, 3, 0), (3_000_001, 2, 2, 1), (8_999_999, 2, 2, 1), (9_000_000, 3, 2, 0)])
def test_what_has_the_form_of_both_is_told_by_when_it_came(waited_ns, instructions, answers,
                                                           still_open):
    bus = Bus('feetech')
    bus.ask(PING, encode(1, 0))
    bus.ask(PING)
    bus.now += len(PING) * BYTE_NS + waited_ns
    bus.monitor.feed(PING, bus.now)
    report = bus.report()
    assert (report.counters['Instructions'], report.devices[0].totals.answers,
            report.kinds.get('undecided packet', 0)) == (instructions, answers - 1, still_open)


# ---- the sides are known ------------------------------------------------------------------------

def sided(bus, *said):
    for side, packet in said:
        bus.now += MS
        bus.monitor.feed(packet, bus.now, side)


def test_an_adapter_that_echoes_is_no_servo():
    bus = Bus('feetech')
    for step in range(10):
        sent = cycle(step)
        sided(bus, (OUT, sent[0]), *((IN, one) for one in sent[:-1]), (OUT, sent[-1]),
              (IN, sent[-1]))
        sided(bus, (OUT, PING), (IN, PING), (IN, encode(1, 0)))
        sided(bus, (OUT, encode(9, 1)), (IN, encode(9, 1)))
    found = bus.devices()
    assert {number: device.totals.answers for number, device in found.items()} == {
        **dict.fromkeys(SO_101, 10), 1: 20, 9: 0}
    assert bus.report().counters['Instructions'] == 40
    kinds = bus.report().kinds
    assert (kinds['echo'], kinds.get('bad id', 0)) == (30, 0)      # a Ping alone may be an answer


def test_a_reset_of_the_statistics_does_not_forget_the_echo():
    bus = Bus('1')
    for _ in range(5):
        sided(bus, (OUT, PING), (IN, PING + encode(1, 0)))
    bus.monitor.reset_statistics(bus.now)
    sided(bus, *[(OUT, encode(9, 1)), (IN, encode(9, 1))] * 3)
    assert bus.devices()[9].totals.answers == 0


# ---- what is proof ------------------------------------------------------------------------------

TORN = (encode(0xFE, 0x82, b'\x38\2\1\2\4\5\6\x19'),     # it lost a byte, and took one too many
        encode(0xFE, 0x83, b'\x2a\2\7\xd0\7\2\xd0\7'),
        encode(0x82, 0x38, b'\2\1\2\3'), encode(9, 2, b'\x38\2'))


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
@pytest.mark.parametrize('torn', TORN)
def test_a_frame_that_damage_made_names_no_device(protocol, torn):
    """Its sum is right by chance, and behind it is the rest of the packet that it ran into."""
    bus = Bus(protocol)
    for step in range(2):
        bus.ask(*cycle(step))
        bus.ask(torn + PING[1:], *(encode(one, 0, b'\xd0\7') for one in SO_101))
    bus.say(*cycle())
    assert set(bus.devices()) == set(SO_101)
    assert bus.report().kinds['undecided packet'] >= 1


def test_a_frame_that_ends_with_a_whole_packet_names_no_device():
    bus = Bus('feetech')
    answer = encode(1, 0)                          # what makes the sum of the outer one right
    for code in range(256):
        torn = encode(9, code, answer[:-1])
        if torn.endswith(answer):
            bus.ask(*cycle())
            bus.ask(torn)
            bus.ask(*cycle())
            assert set(bus.devices()) == set(SO_101)
            return
    raise AssertionError('no code makes one')


def test_a_new_servo_is_found_where_a_stray_byte_is_ahead_of_each_packet():
    bus = Bus()
    bus.ask(*cycle())
    for _ in range(4):
        for one in [*cycle(), encode(9, 2, b'\x38\2'), encode(9, 0, b'\xd0\7')]:
            bus.say(b'\0' + one)
    assert bus.devices()[9].totals.answers >= 1


# ---- both on one wire ---------------------------------------------------------------------------

READ_2, REPLY_2 = encode_2(11, 2, b'\x84\0\4\0'), encode_2(11, STATUS, b'\0\x08\0\0', 0)


def test_a_2_0_robot_with_one_servo_of_1_0():
    """Those of 2.0 have the same books as without it, and both are there."""
    alone, mixed = Bus('2'), Bus()
    for bus in (alone, mixed):
        for _ in range(50):
            bus.ask(READ_2, REPLY_2, after_ms=5)
            if bus is mixed:
                bus.ask(encode(3, 2, b'\x24\2'), encode(3, 0, b'\0\2'), after_ms=5)
    assert mixed.devices()[11].totals == alone.devices()[11].totals
    assert mixed.devices()[3].totals.answers == 50
    report = mixed.report()
    assert report.counters['Noise Bytes'] == report.counters['Pending Bytes'] == 0
    assert report.counters['Packets'] == 200
    assert [one.rule for one in report.findings] == ['protocol_1']


@pytest.mark.parametrize('size', [1, 14, 100, 4000])
def test_the_framer_of_2_0_reads_alone_again_and_what_is_of_1_0_then_is_found(size):
    count = ALONE_PACKETS
    said = PING * 4 + (READ_2 + REPLY_2) * count + PING * 4 + READ_2 + REPLY_2
    framer, alone = MixedFramer(Detector()), []
    for at in range(0, len(said), size):
        framer.frames(said[at:at + size])
        alone.append(framer._is_2_alone)
    framer.flush_frames()
    assert any(alone) and not framer._is_2_alone
    assert (framer.packets, framer.noise_bytes, framer.pending) == (2 * count + 10, 0, 0)


def test_a_2_0_frame_is_never_searched():
    bus = Bus()
    inside = encode(9, 2, b'\x24\2') * 4
    for _ in range(5):
        bus.ask(encode_2(1, 3, b'\x40\0' + inside, stuffed=False), encode_2(1, STATUS, b'', 0))
    assert set(bus.devices()) == {1}


@pytest.mark.parametrize(('pieces', 'devices'), [
    ([(OUT, PING), (IN, PING)], [1]),
    ([(OUT, encode(9, 2, b'\x38\2'))], [9]),
    ([(OUT, PING[:3]), (OUT, PING[3:])], []),
    ([(OUT, PING + b'\0')], []), ([(OUT, b'\0' + PING)], []), ([(IN, PING)], []),
])
def test_one_packet_that_the_program_wrote_as_a_whole_is_enough(pieces, devices):
    bus = Monitor('', Models())
    for number, (side, data) in enumerate(pieces):
        bus.feed(data, (1 + number) * 1_000_000, side)
    bus.flush_if_idle(1_000_000_000)
    report = bus.report(1_000_000_000)
    assert [one.id for one in report.devices] == devices
    assert report.counters['Packets'] == (len(pieces) if devices else 0)


class Told(Detector):
    """Believes all or nothing."""

    def __init__(self, believes_all):
        super().__init__()
        self.proven.update({1} if believes_all else ())
        self._believes_all = believes_all

    def add_candidate(self, one, is_whole):
        if self._believes_all:
            one.framer.claim(one.frame)
        return self._believes_all


pieces = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([READ_2, REPLY_2, READ_2[:9], REPLY_2[1:], PING, b'\xff\xff', b'\xff',
                     b'\xff\xff\xfd', b'\xff\xfd\0', encode(1, 0, b'\0\x08'),
                     encode(1, 0, b'\xff\xff\xfd')]),
    st.builds(encode, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=20)))


@settings(max_examples=400)
@given(st.lists(pieces, max_size=14).map(b''.join), st.lists(st.integers(1, 30), max_size=30),
       st.booleans())
def test_any_split_of_mixed_traffic_gives_the_same(data, sizes, claimed):
    def feed(chunks):
        framer = MixedFramer(Told(claimed))
        found = []
        for chunk in chunks:
            found += framer.frames(chunk)
            assert framer.bytes == framer.packet_bytes + framer.noise_bytes + framer.pending
        found += framer.flush_frames()
        assert framer.pending == 0
        good = [frame[1:2] + frame[3:6] for frame in found if is_good(frame)]
        assert [frame[0] for frame in good] == sorted(frame[0] for frame in good)
        return good, framer.packets, framer.noise_bytes, framer.repaired

    split, at = [], 0
    for size in [*sizes, len(data)]:
        split.append(data[at:at + size])
        at += size
    assert feed(split) == feed([data])


@settings(max_examples=300)
@given(st.lists(pieces, max_size=14).map(b''.join))
def test_the_packets_of_2_0_are_those_that_its_own_framer_finds(data):
    mixed, plain = MixedFramer(Told(False)), Framer()
    found = [one for one in mixed.frames(data) + mixed.flush_frames() if one[2] < EITHER_1]
    assert found == plain.frames(data) + plain.flush_frames()
    assert (mixed.packets, mixed.damaged,
            mixed.noise_bytes, mixed.repaired, mixed.noise) == (
                plain.packets, plain.damaged,
                plain.noise_bytes, plain.repaired, plain.noise)


def test_a_packet_of_1_0_in_an_earlier_chunk_is_no_noise_in_front_of_one_of_2_0():
    framer = MixedFramer(Told(True))
    for chunk in (PING, PING + b'\0'):
        framer.frames(chunk)
    [frame] = framer.frames(READ_2)
    assert frame[6] is not None and frame[6].noise_length == 1


def test_a_wrong_length_of_2_0_is_not_taken_for_one_of_the_1_0_family():
    [frame] = [one for one in MixedFramer(Told(False)).frames(b'\xff\xff\xfd\0\1\0\0' + READ_2)
               if not is_good(one)]
    assert frame[2] < EITHER_1


# ---- which dialect ------------------------------------------------------------------------------

def dialect(bus):
    bus.report()                   # the line is idle: nothing waits for what is behind it
    return bus.monitor.decoder.choice.dialect.name
