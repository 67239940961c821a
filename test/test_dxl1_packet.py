# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Packets of the 1.0 family: published vectors and both SDKs both ways, any damage, any split."""

from importlib.util import find_spec
from pkgutil import resolve_name

from packets import fed
from packets import packets_1_in
import pytest

from msg_defs.dxl1_packet import BROADCAST
from msg_defs.dxl1_packet import Dxl1Framer
from msg_defs.dxl1_packet import encode
from msg_defs.dxl1_packet import HEADER
from msg_defs.dxl1_packet import MAX_FRAME
from msg_defs.servo_frame import EITHER_1
from msg_defs.servo_frame import is_good

# As published: the e-Manual (Protocol 1.0) and Feetech's protocol text. ID, code, parameters.
VECTORS = {
    'ping 1': ('FFFF010201FB', 1, 0x01, ''),
    'write': ('FFFF0105030C64AADC', 1, 0x03, '0C64AA'),
    'status overload, overheating': ('FFFF010224D8', 1, 0x24, ''),
    'sync write': ('FFFFFE0E831E040010005001012002600367', BROADCAST, 0x83,
                   '1E0400100050010120026003'),
    'bulk read': ('FFFFFE09920002011E0202241D', BROADCAST, 0x92, '0002011E020224'),
    'read position': ('FFFF0104023802BE', 1, 0x02, '3802'),
    'status position': ('FFFF0104001805DD', 1, 0x00, '1805'),
    'action': ('FFFFFE0205FA', BROADCAST, 0x05, ''),
    'reset': ('FFFF01020AF2', 1, 0x0A, ''),
    'write goal': ('FFFF0109032A00080000E803D5', 1, 0x03, '2A00080000E803'),
}
PING = encode(1, 0x01)
READ = encode(1, 0x02, b'\x38\x02')
REPLY = encode(1, 0, b'\x18\x05')
BAD_REPLY = REPLY[:-1] + bytes([REPLY[-1] ^ 1])


def feed(data, sizes=()):
    return fed(Dxl1Framer(), packets_1_in, MAX_FRAME, data, sizes)


def summary(framer):
    return (framer.packets, *framer.damaged.values(),
            framer.noise_bytes)


def damaged(frames):
    return [(frame[6].reason, frame[6].noise_length) for frame in frames
            if frame[6] is not None and frame[6].reason]


@pytest.mark.parametrize('name', VECTORS)
def test_published_packets_both_ways(name):
    text, number, code, params = VECTORS[name]
    wire = bytes.fromhex(text)
    assert encode(number, code, bytes.fromhex(params)) == wire
    for data, sizes in ((wire, []), (wire, [1] * len(wire)), (bytes(5) + wire + b'\x01', [3, 9])):
        [packet], framer = feed(data, sizes)
        assert packet == (data.find(wire), number, code, bytes.fromhex(params))
        assert summary(framer) == (1, 0, 0, 0, len(data) - len(wire))


class Line:
    """What a port of either SDK is to its packet handler: a byte string that was received."""

    is_using = False

    def __init__(self, received=b''):
        self.received = received
        self.written = b''

    def clearPort(self):
        self.received = b''

    def writePort(self, packet):
        self.written += bytes(packet)
        return len(packet)

    def readPort(self, size):
        taken, self.received = self.received[:size], self.received[size:]
        return list(taken)

    def isPacketTimeout(self):
        return not self.received

    def setPacketTimeout(self, size):
        pass


SDKS = [pytest.param(module, protocol, id=name, marks=pytest.mark.skipif(
            find_spec(module) is None, reason=f'skipped: {name} is not installed'))
        for name, module, protocol in (('dynamixel-sdk', 'dynamixel_sdk', 1.0),
                                       ('feetech-servo-sdk', 'scservo_sdk', 0))]


@pytest.mark.parametrize(('module', 'protocol'), SDKS)
def test_what_the_sdks_write_and_read_is_what_we_mean(module, protocol):
    sdk = resolve_name(f'{module}:PacketHandler')(protocol)
    line = Line()
    sdk.writeTxOnly(line, 7, 42, 3, [1, 2, 3])
    line.is_using = False
    sdk.readTx(line, 253 % 252, 56, 2)
    assert line.written == encode(7, 3, b'\x2a\1\2\3') + encode(1, 2, b'\x38\2')
    for number, error, data in ((1, 0, b''), (250, 0x24, b'\xff\xff\xfd\xff'), (0, 1, bytes(200))):
        wire = encode(number, error, data)
        packet, result = sdk.rxPacket(Line(b'\x00' + wire))
        assert (bytes(packet), result) == (wire, 0)


def test_what_is_wrong_is_said_exactly():
    cases = [
        (BAD_REPLY, 'crc', (1, 0, 0)),
        (REPLY[:-1], 'cut', (0, 1, 0)),
        (READ[:6] + PING, 'cut', (0, 1, 0)),
        (b'\xff\xff\x01\x01\x00\x00', 'length', (0, 0, 1)),
    ]
    for wire, reason, counts in cases:
        framer = Dxl1Framer()
        framer.frames(PING + b'\x00' * 3)
        frames = framer.frames(wire) + framer.flush_frames()
        assert damaged(frames) == [(reason, 3)], wire.hex()
        assert tuple(framer.damaged.values()) == counts
        begin, end, kind, number, _, data, _ = next(one for one in frames if not is_good(one))
        assert (begin, kind, number) == (len(PING) + 3, EITHER_1, wire[2])
        assert data == wire[2:2 + len(data)]
        assert end == begin + 2 + len(data)


def test_no_broadcast_and_no_length_is_too_large():
    wire = encode(BROADCAST, 0x83, b'\x1e\x04' + bytes(range(251)))
    assert len(wire) == MAX_FRAME
    [packet], _ = feed(wire, [200])
    assert len(packet.params) == 253
    with pytest.raises(ValueError, match='bytes must be in range'):
        encode(1, 3, bytes(254))


@pytest.mark.parametrize(('first', 'second', 'codes', 'noise'), [
    (READ[:5], READ[5:], [2], 0),                          # the delivery paused
    (READ[:5], REPLY + PING, [0, 1], 5),                   # the line did
    (READ[:3], b'\xff', [], 4),
    (encode(1, 0, HEADER)[:5], HEADER + b'\xfe', [], 8),
    (encode(1, 0, HEADER)[:5], encode(1, 0, HEADER)[5:] + PING, [0, 1], 0),
])
def test_after_a_pause_the_next_chunk_decides(first, second, codes, noise):
    framer = Dxl1Framer()
    found = packets_1_in(framer, first)
    framer.interrupt()
    found += packets_1_in(framer, second) + packets_1_in(framer, None)
    assert [packet.code for packet in found] == codes
    assert framer.noise_bytes == noise
