# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol 1.0 and Feetech on a wire: what is a packet, which way it goes, which dialect it is."""

import random
import struct

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest

from dxl_monitor.bus.decoder import Settings
from dxl_monitor.bus.dxl1_classifier import MEANINGS_KEPT
from dxl_monitor.bus.expected import Expected
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from msg_defs.dxl1_detector import Detector
from msg_defs.dxl1_packet import encode
from msg_defs.dxl_mixed import MixedFramer
from msg_defs.dxl_packet import encode as encode_2
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.frame import EITHER_1
from msg_defs.frame import is_good

MODELS = Models()
BAUD = 1_000_000
BYTE_NS = 10_000
MS = 1_000_000
STEADY = settings(derandomize=True, deadline=None, database=None)
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


def counters(bus):
    found = bus.report().counters
    return tuple(found[name] for name in (
        'Bytes', 'Packet Bytes', 'Noise Bytes', 'Pending Bytes', 'Packets', 'Instructions'))


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
def test_an_so_101_is_followed_from_the_first_byte_on(protocol):
    bus = Bus(protocol)
    for step in range(100):
        sent = cycle(step)
        bus.ask(*sent[:-1])
        bus.say(sent[-1])
    size = 100 * sum(map(len, sent))
    assert counters(bus) == (size, size, 0, 0, 800, 200)
    found = bus.devices()
    assert {number: (device.totals.answers, device.totals.missed, device.totals.writes)
            for number, device in found.items()} == dict.fromkeys(SO_101, (100, 0, 100))
    assert bus.report().findings == ()


def test_an_error_without_data_is_the_answer_to_a_read():
    bus = Bus('1')
    bus.ask(encode(1, 2, b'\x24\2'), encode(1, 0, b'\0\2'))
    bus.ask(encode(1, 2, b'\x24\2'), encode(1, 1))         # it looks like a Ping of 1
    assert bus.report().counters['Instructions'] == 2
    assert bus.devices()[1].totals.answers == 2


def test_a_model_that_is_read_names_the_registers():
    bus = Bus()
    bus.ask(encode(3, 1), encode(3, 0))
    bus.ask(encode(3, 2, b'\3\2'), encode(3, 0, b'\x09\x03'))
    bus.ask(encode(3, 2, b'\x38\2'), encode(3, 0, b'\1\x80'))
    bus.ask(encode(3, 3, b'\x2a\0\x0c'), encode(3, 0))
    assert bus.devices()[3].model_name == 'STS3215'
    shown = bus.shown(3)
    assert (shown['Model Number'], shown['Present Position'], shown['Goal Position']) == (
        '777', '-3.14313', '1.5708')


def test_an_ax_12_is_known_by_its_number_and_its_level():
    bus = Bus()
    bus.ask(encode(7, 1), encode(7, 0))
    bus.ask(encode(7, 2, b'\0\3'), encode(7, 0, b'\x0c\0\x18'))
    bus.ask(encode(7, 2, b'\x10\1'), encode(7, 0, b'\1'))
    bus.ask(encode(7, 3, b'\x18\1'))           # not acknowledged at this level
    bus.ask(encode(7, 2, b'\x24\2'), encode(7, 0, b'\0\2'))
    device = bus.devices()[7]
    assert (device.model_name, device.firmware, device.status_return_level) == ('AX-12A', 24, 1)
    assert device.totals.missed == 0
    assert bus.shown(7)['Present Position'] == '0'
    assert bus.shown(7)['Torque Enable'] == 'on'


def test_a_feetech_level_counts_from_0():
    bus = Bus('feetech')
    bus.ask(encode(1, 2, b'\3\2'), encode(1, 0, b'\x09\x03'))
    bus.ask(encode(1, 2, b'\x08\1'), encode(1, 0, b'\0'))
    assert bus.devices()[1].status_return_level == 1
    bus.ask(encode(1, 2, b'\x08\1'), encode(1, 0, b'\1'))
    assert bus.devices()[1].status_return_level == 2


# ---- instruction or status ----------------------------------------------------------------------

PING = encode(1, 1)                # and the answer of 1 with "voltage"


def test_a_ping_and_an_answer_with_voltage_error_are_the_same_bytes():
    assert PING == encode(1, 0x01) == bytes.fromhex('FFFF010201FB')
    bus = Bus('feetech', Expected(1, 'STS3215'))
    bus.ask(encode(1, 2, b'\x3e\1'), encode(1, 1, b'\x79'))    # proves the error in a read
    for _ in range(5):
        bus.ask(PING, PING)
    device = bus.devices()[1]
    assert (device.totals.answers, device.totals.missed, device.alert) == (6, 0, True)
    assert bus.shown(1)['Present Input Voltage'] == '12.1'
    assert bus.report().counters['Instructions'] == 6


def test_a_silent_servo_that_is_pinged_again_and_again_does_not_answer_itself():
    bus = Bus('feetech')
    for _ in range(6):
        bus.ask(PING, after_ms=40)
    device = bus.devices()[1]
    assert (device.totals.answers, device.last_heard_s) == (0, None)
    assert device.totals.missed >= 4
    assert bus.report().kinds.get('undecided packet', 0) == 0


def test_no_answer_is_awaited_to_what_is_answered_no_more():
    """What was learned from an instruction does not outlive the Status Return Level."""
    bus = Bus('1', Expected(1, 'AX-12A'))
    bus.ask(encode(1, 5), encode(1, 0))
    bus.ask(encode(1, 3, b'\x10\1'), encode(1, 0))
    bus.ask(encode(1, 2, b'\x10\1'), encode(1, 0, b'\1'))
    bus.ask(encode(1, 5))                      # not acknowledged at this level
    bus.say(PING, encode(1, 0), after_ms=1)
    device = bus.devices()[1]
    assert bus.report().counters['Instructions'] == 5
    assert (device.totals.answers, device.totals.missed, device.alert) == (4, 0, False)


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


def test_what_may_be_either_is_counted_and_changes_nothing():
    bus = Bus('feetech')
    bus.ask(PING, PING)            # nothing proves that this servo lives
    bus.ask(PING, after_ms=40)
    report = bus.report()
    assert report.kinds['undecided packet'] == 1
    assert report.devices[0].last_heard_s is None
    assert report.devices[0].totals.answers == 0


def test_answers_with_error_bits_look_like_instructions_and_are_none():
    """02 and two bytes is a Read, 04 a Reg Write, 05 an Action, by their form."""
    bus = Bus('feetech')
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    for error in (0x02, 0x04, 0x05, 0x21):
        bus.ask(encode(1, 2, b'\x38\2'), encode(1, error, b'\1\x08'))
    device = bus.devices()[1]
    assert (device.totals.answers, device.totals.missed) == (5, 0)
    assert bus.report().counters['Instructions'] == 5


def test_the_error_byte_is_kept_as_hardware_error_status():
    bus = Bus('feetech', Expected(4, 'STS3215'))
    bus.ask(encode(4, 2, b'\x38\2'), encode(4, 0x24, b'\0\x08'))
    assert bus.shown(4)['Hardware Error Status'] == 'overheating, overload'
    assert bus.devices()[4].alert
    [finding] = [one for one in bus.report().findings if one.rule == 'hardware_error']
    assert 'let it cool' in finding.message and 'Reboot' not in finding.message
    bus.ask(encode(4, 2, b'\x38\2'), encode(4, 0, b'\0\x08'))
    assert bus.shown(4)['Hardware Error Status'] != 'overheating, overload'
    assert not bus.devices()[4].alert


def test_a_refusal_of_dynamixel_is_one_and_a_state_is_none():
    bus = Bus('1')
    bus.ask(encode(5, 3, b'\x1e\xff\xff'), encode(5, 0x08))                # range
    bus.ask(encode(5, 2, b'\x24\2'), encode(5, 0x20, b'\0\2'))             # overload, with data
    device = bus.devices()[5]
    assert device.totals.refused == 1
    assert list(device.errors) == [(3, 30, 4)]
    assert device.alert
    assert device.totals.answers == 2


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


@pytest.mark.parametrize(('protocol', 'asked'), [
    ('feetech', encode(1, 3, b'\x2a\0\x08')), ('feetech', encode(1, 0x0B)),
    ('1', encode(1, 8))])
def test_an_acknowledgement_may_look_like_a_ping(protocol, asked):
    bus = Bus(protocol, Expected(1))
    for count in (1, 2):
        bus.ask(asked, PING)                       # it is of "voltage"
        assert bus.report().counters['Instructions'] == count
        assert bus.devices()[1].totals.answers == count


# ---- the sides are known ------------------------------------------------------------------------

def sided(bus, *said):
    for side, packet in said:
        bus.now += MS
        bus.monitor.feed(packet, bus.now, side)


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
def test_with_sides_nothing_stays_open(protocol):
    bus = Bus(protocol)
    for _ in range(5):
        sided(bus, (OUT, PING), (IN, PING))            # an answer with "voltage"
        sided(bus, (OUT, PING))                        # none
    device = bus.devices()[1]
    assert (device.totals.answers, device.totals.missed, device.alert) == (5, 4, True)
    assert bus.report().counters['Instructions'] == 10
    assert 'undecided packet' not in bus.report().kinds


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
def test_an_so_101_with_sides_is_followed_from_the_first_byte_on(protocol):
    bus = Bus(protocol)
    for step in range(50):
        sent = cycle(step)
        sided(bus, (OUT, sent[0]), *((IN, one) for one in sent[1:-1]), (OUT, sent[-1]))
    size = 50 * sum(map(len, sent))
    assert counters(bus) == (size, size, 0, 0, 400, 100)
    assert {number: (device.totals.answers, device.totals.missed, device.totals.writes)
            for number, device in bus.devices().items()} == dict.fromkeys(SO_101, (50, 0, 50))


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
    assert (kinds['echo'], kinds.get('bad id', 0)) == (40, 0)


# ---- what is proof ------------------------------------------------------------------------------

def test_one_right_sum_makes_no_device():
    chance = random.Random(1)
    bus = Bus()
    for _ in range(4000):
        bus.say(b'\0\xff\xff' + chance.randbytes(40), after_ms=1)
    framer = bus.monitor.decoder.framers['']
    assert framer._second.packets > 10             # right by chance
    assert bus.report().devices == ()
    assert bus.report().counters['Packets'] == 0


def test_three_behind_each_other_are_proof_and_none_of_them_is_lost():
    bus = Bus()
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    assert bus.report().devices == ()
    assert counters(bus) == (16, 0, 0, 16, 0, 0)
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    assert counters(bus) == (32, 24, 0, 8, 3, 2)               # the end of it might be 2.0
    bus.ask(encode(1, 2, b'\x38\2'))
    assert counters(bus) == (40, 40, 0, 0, 5, 3)
    assert bus.devices()[1].totals.answers == 2
    assert bus.monitor.decoder.framers[''].pending == 0        # nothing is held back from now on


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


@pytest.mark.parametrize('protocol', ['auto', 'feetech'])
def test_a_new_servo_is_there_with_its_first_answer(protocol):
    bus = Bus(protocol)
    bus.ask(*cycle())
    bus.ask(encode(9, 1), encode(9, 0))
    bus.ask(encode(10, 1), after_ms=40)            # silent
    bus.ask(*cycle(), after_ms=40)
    found = bus.devices()
    assert (found[9].totals.answers, found[9].totals.missed) == (1, 0)
    assert (found[10].totals.answers, found[10].totals.missed) == (0, 1)
    assert bus.report().counters['Instructions'] == 6


def test_a_new_servo_is_found_where_a_stray_byte_is_ahead_of_each_packet():
    bus = Bus()
    bus.ask(*cycle())
    for _ in range(4):
        for one in [*cycle(), encode(9, 2, b'\x38\2'), encode(9, 0, b'\xd0\7')]:
            bus.say(b'\0' + one)
    assert bus.devices()[9].totals.answers >= 1


def packets_of_2_0(bus):
    framer = bus.monitor.decoder.framers['']
    assert framer.claimed == 0
    return framer._first.packets


def test_noise_of_all_kinds_makes_no_device():
    chance = random.Random(2)
    bus = Bus()
    packets = [encode_2(1, 2, b'\x84\0\4\0'), encode_2(1, STATUS, bytes(4), 0)]
    for _ in range(400):
        damaged = bytearray(b''.join(chance.choices(packets, k=20)))
        for _ in range(6):
            damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        bus.say(bytes(damaged), chance.randbytes(600), after_ms=1)
    assert set(bus.devices()) <= {1}
    assert bus.report().counters['Packets'] == packets_of_2_0(bus)


def test_damage_is_counted_and_makes_the_next_answer_doubtful():
    bus = Bus('feetech')
    good = encode(1, 0, b'\0\x08')
    bus.ask(encode(1, 2, b'\x38\2'), good)
    bus.ask(encode(1, 2, b'\x38\2'), good[:-1] + b'\0')
    bus.ask(encode(1, 2, b'\x38\2'), good[:5])
    bus.ask(encode(1, 2, b'\x38\2'), good)
    device = bus.devices()[1]
    found = bus.report().counters
    assert (found['CRC Errors'], found['Truncated Packets']) == (1, 1)
    assert (device.totals.answers, device.totals.missed, device.totals.damaged) == (2, 2, 2)


def test_an_answer_without_its_first_byte_may_come_in_two_chunks():
    bus = Bus('feetech', Expected(1, 'STS3215'))
    question, answer = encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08')
    bus.ask(question, answer)
    bus.ask(question, answer[1:4], answer[4:])
    bus.ask(question, answer)
    assert bus.devices()[1].totals.beheaded == 1


BEHEADED = encode(1, 0, b'\0\x08')[1:]


@pytest.mark.parametrize(('noise', 'count'), [
    (BEHEADED, 1), (BEHEADED * 2, 2), (encode(1, 0)[1:], 1), (b'\0\1' + BEHEADED + b'\0', 1),
    (BEHEADED[:-1], 0), (BEHEADED[:-1] + b'\0', 0), (encode(9, 0, b'\0\x08')[1:], 0),
])
def test_answers_that_lack_their_first_byte_are_counted(noise, count):
    bus = Bus('feetech', Expected(9))
    for answer in (encode(1, 0, b'\0\x08'), noise, encode(1, 0, b'\0\x08')):
        bus.ask(encode(1, 2, b'\x38\2'), answer)
    assert {number: device.totals.beheaded for number, device in bus.devices().items()} \
        == {1: count, 9: 0}


def test_an_answer_that_lacks_its_first_byte_is_counted_once():
    bus = Bus('feetech', Expected(1))
    for count in range(1, 6):
        for answer in (encode(1, 0, b'\0\x08'), BEHEADED, encode(1, 0, b'\0\x08')):
            bus.ask(encode(1, 2, b'\x38\2'), answer)
        assert bus.devices()[1].totals.beheaded == count


@pytest.mark.parametrize(('number', 'errors'), [(6, 1), (77, 0)])
def test_a_damaged_packet_counts_as_one_where_its_id_is_known(number, errors):
    bus = Bus()
    bus.ask(*cycle())
    bus.ask(encode(number, 2, b'\x38\2')[:-1] + b'\0', after_ms=40)
    bus.ask(*cycle(), after_ms=40)
    found = bus.report().counters
    assert (found['CRC Errors'], found['Noise Bytes']) == (errors, 8)


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
    assert counters(mixed)[2:4] == (0, 0)
    assert counters(mixed)[4] == 200
    assert [one.rule for one in mixed.report().findings] == ['protocol_1']


def test_a_2_0_frame_is_never_searched():
    bus = Bus()
    inside = encode(9, 2, b'\x24\2') * 4
    for _ in range(5):
        bus.ask(encode_2(1, 3, b'\x40\0' + inside, stuffed=False), encode_2(1, STATUS, b'', 0))
    assert set(bus.devices()) == {1}


def test_2_only_hears_no_other_protocol():
    bus = Bus('2')
    for _ in range(5):
        bus.ask(*cycle())
    assert bus.report().devices == ()
    assert (bus.report().counters['Packets'], bus.report().protocol) == (0, '')
    bus.ask(READ_2)
    assert bus.report().protocol == 'Dynamixel 2.0'


def test_a_bus_says_what_was_heard_on_it():
    bus = Bus()
    assert bus.report().protocol == ''
    bus.ask(*cycle())
    assert bus.report().protocol == 'Feetech'
    bus.ask(READ_2, REPLY_2)
    assert bus.report().protocol == 'Dynamixel 2.0, Feetech'


class Told(Detector):
    """Believes all or nothing."""

    def __init__(self, believes_all):
        super().__init__()
        self._believes_all = believes_all

    def proves(self, one):
        if self._believes_all:
            one.framer.claim(one.frame)
        return self._believes_all


pieces = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([READ_2, REPLY_2, READ_2[:9], REPLY_2[1:], PING, b'\xff\xff', b'\xff',
                     b'\xff\xff\xfd', b'\xff\xfd\0', encode(1, 0, b'\0\x08'),
                     encode(1, 0, b'\xff\xff\xfd')]),
    st.builds(encode, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=20)))


@settings(STEADY, max_examples=400)
@given(st.lists(pieces, max_size=14).map(b''.join), st.lists(st.integers(1, 30), max_size=30),
       st.booleans())
def test_any_split_of_mixed_traffic_gives_the_same(data, sizes, claimed):
    def feed(chunks):
        framer = MixedFramer(Told(claimed), is_shared=claimed)
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


@settings(STEADY, max_examples=300)
@given(st.lists(pieces, max_size=14).map(b''.join))
def test_the_packets_of_2_0_are_those_that_its_own_framer_finds(data):
    mixed, plain = MixedFramer(Told(False)), Framer()
    found = [one for one in mixed.frames(data) + mixed.flush_frames() if one[2] < EITHER_1]
    assert found == plain.frames(data) + plain.flush_frames()
    assert (mixed.packets, mixed.crc_errors, mixed.truncated, mixed.bad_length,
            mixed.noise_bytes, mixed.repaired, mixed.noise) == (
                plain.packets, plain.crc_errors, plain.truncated, plain.bad_length,
                plain.noise_bytes, plain.repaired, plain.noise)


def test_a_packet_of_1_0_in_an_earlier_chunk_is_no_noise_in_front_of_one_of_2_0():
    framer = MixedFramer(Told(True), is_shared=True)
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


@pytest.mark.parametrize(('said', 'name'), [
    ([encode(0xFE, 0x82, b'\x38\2\1\2')], 'Feetech'),
    ([encode(1, 0x0B)], 'Feetech'),
    ([encode(0xFE, 0x92, b'\0\2\1\x24')], 'Dynamixel 1.0'),
    ([encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08')] * 4, 'Feetech'),
    ([encode(1, 2, b'\x24\2'), encode(1, 0, b'\0\2')] * 4, 'Dynamixel 1.0'),
    ([encode(1, 2, b'\3\2'), encode(1, 0, b'\x09\3')], 'Feetech'),
    ([encode(1, 2, b'\0\3'), encode(1, 0, b'\x0c\0\1')], 'Dynamixel 1.0'),
    ([encode(1, 1), encode(1, 0)] * 9, 'Dynamixel 1.0 or Feetech'),
    ([encode(1, 2, b'\x24\2'), encode(1, 0, b'\0\2'), encode(1, 2, b'\x38\2'),
      encode(1, 0, b'\0\2')] * 9, 'Dynamixel 1.0 or Feetech'),
    ([encode(0xFE, 0x83, b'\x2a\2\1\0\4')] * 4, 'Feetech'),
    ([encode(0xFE, 0x83, b'\x1e\2\1\0\4')] * 4, 'Dynamixel 1.0'),
    # What was decided stays, however often something speaks against it.
    ([encode(0xFE, 0x92, b'\0\2\1\x24'), *[encode(0xFE, 0x83, b'\x2a\2\1\0\4')] * 40],
     'Dynamixel 1.0'),
    ([encode(0xFE, 0x92, b'\0\2\1\x24'),
      *[encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\2')] * 40], 'Dynamixel 1.0'),
])
def test_signs_of_a_dialect(said, name):
    bus = Bus()
    bus.ask(*[encode(9, 1), encode(9, 0), encode(9, 1), encode(9, 0)])
    bus.say(*said, after_ms=1)
    assert dialect(bus) == name


def test_listed_devices_and_the_parameter_decide_too():
    assert dialect(Bus('auto', Expected(1, 'AX-12A'))) == 'Dynamixel 1.0'
    assert dialect(Bus('auto', Expected(1, 'SCS0009'))) == 'Feetech'
    assert dialect(Bus('auto', Expected(1, 'MX-106'))) == 'Dynamixel 1.0 or Feetech'
    assert dialect(Bus('feetech')) == 'Feetech'
    assert dialect(Bus('1')) == 'Dynamixel 1.0'


def test_what_was_read_before_the_dialect_was_known_counts():
    bus = Bus()
    bus.ask(encode(2, 2, b'\0\x08'), encode(2, 0, b'\3\x0a\0\x09\3\2\0\0'))
    bus.ask(encode(2, 1), encode(2, 0))
    assert dialect(bus) == 'Feetech'               # its number is of no Dynamixel
    assert bus.devices()[2].model_name == 'STS3215'


def test_the_model_number_that_decides_tells_the_model_as_well():
    bus = Bus()
    bus.ask(encode(1, 1), encode(1, 0), encode(1, 1), encode(1, 0))
    bus.ask(encode(1, 2, b'\0\3'), encode(1, 0, b'\x0c\0\1'))
    device = bus.devices()[1]
    assert (dialect(bus), device.model_name, device.firmware) == ('Dynamixel 1.0', 'AX-12A', 1)


def test_a_question_from_before_the_dialect_was_known_tells_the_model_then():
    bus = Bus()
    for _ in range(3):
        bus.ask(encode(2, 2, b'\3\2'), encode(2, 0, b'\0\0'))
    assert dialect(bus) == 'Dynamixel 1.0 or Feetech'
    bus.ask(encode(0xFE, 0x82, b'\x38\2\2'), encode(2, 0, b'\0\x08'))
    bus.ask(encode(2, 2, b'\3\2'), encode(2, 0, b'\x09\3'))
    assert bus.devices()[2].model_name == 'STS3215'


def test_a_model_number_that_is_the_last_word_counts_too():
    bus = Bus()
    for _ in range(2):
        bus.ask(encode(2, 2, b'\x3e\1'), encode(2, 0, b'\x79'))
    bus.ask(encode(2, 2, b'\3\2'), encode(2, 0, b'\x09\3'))
    assert bus.devices()[2].model_name == 'STS3215'


def test_a_reboot_of_feetech_is_not_answered_and_that_is_no_loss():
    bus = Bus('feetech')
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    bus.ask(encode(1, 8))
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'), after_ms=900)
    assert bus.devices()[1].totals.missed == 0
    assert bus.report().kinds['rebooted'] == 1


def test_calibrate_and_reset():
    bus = Bus('feetech', Expected(1, 'STS3215'))
    bus.ask(encode(1, 2, b'\x38\2'), encode(1, 0, b'\0\x08'))
    bus.ask(encode(1, 0x0B), encode(1, 0))
    bus.ask(encode(1, 0x0A), encode(1, 0))
    assert 'Present Position' not in bus.shown(1)
    found = bus.report()
    assert found.kinds['calibrated'] == 1
    assert found.counters['Unknown Instructions'] == 0
    assert bus.devices()[1].totals.answers == 3


def test_a_broadcast_ping_is_answered_one_after_the_other():
    bus = Bus('feetech')
    bus.ask(encode(0xFE, 1), *(encode(one, 0) for one in SO_101))
    assert {device.protocol for device in bus.devices().values()} == {'Feetech'}
    assert {number: device.totals.answers for number, device in bus.devices().items()} \
        == dict.fromkeys(SO_101, 1)
    assert bus.report().counters['Unasked Answers'] == 0


@settings(STEADY, max_examples=150)
@given(st.lists(pieces, max_size=20), st.sampled_from(['auto', '1', 'feetech']))
def test_nothing_raises_and_every_byte_is_counted(said, protocol):
    bus = Bus(protocol)
    bus.say(*cycle(), *said)
    found = bus.report().counters
    assert found['Bytes'] == (found['Packet Bytes'] + found['Noise Bytes']
                              + found['Pending Bytes'])
