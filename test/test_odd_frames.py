# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Packets with a right checksum that no device and no master says: they end nothing."""

import forked
import pytest

from msg_defs.crc import crc16
from msg_defs.dxl1_packet import encode as encode_1
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from servobus.bus.decoder import PROTOCOL_CHOICES
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
BAUD = 1_000_000
# What makes a bus of each family known, so that the odd packet is one of its packets.
START = {'1.0': b''.join(encode_1(1, 1) + encode_1(1, 0) for _ in range(3)),
         '2.0': encode(1, 1) + encode(1, 0x55, b'\x37\1\x29', 0)}


def bare(number, code):
    """Return a packet of 2.0 with nothing after its instruction."""
    frame = HEADER + bytes((number, 3, 0, code))
    return frame + crc16(frame).to_bytes(2, 'little')


ODD = {
    **{f'1.0: {code:02x} to {number} with {size}': ('1.0', encode_1(number, code, bytes(size)))
       for code in (0x02, 0x0B, 0x10, 0x20, 0x55, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A)
       for number in (1, 0xFE) for size in (0, 1, 2)},
    **{f'2.0: {code:02x} to {number} with nothing': ('2.0', bare(number, code))
       for code in (0x02, 0x03, 0x04, 0x10, 0x20, 0x55, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A)
       for number in (1, 0xFD, 0xFE)},
    '2.0: a status of all': ('2.0', encode(0xFE, 0x55, b'', 0)),
    '1.0: ff ff 01 02 93 69': ('1.0', bytes.fromhex('ffff01029369')),
}


@pytest.mark.parametrize('name', ODD)
def test_an_odd_packet_ends_nothing_and_each_byte_is_counted(name):
    family, odd = ODD[name]
    for protocol in PROTOCOL_CHOICES:
        for side in (UNKNOWN, OUT, IN):
            monitor = Monitor('bus', MODELS, Settings(baud=BAUD, protocol=protocol))
            now = 1_000_000_000
            for chunk in (START[family], odd, odd, START[family]):
                now += 20_000_000
                monitor.feed(chunk, now, side)
            found = monitor.report(now + 2_000_000_000).counters
            assert found['Bytes'] == 2 * len(START[family] + odd)
            assert found['Bytes'] == (found['Packet Bytes'] + found['Noise Bytes']
                                      + found['Pending Bytes'])


@pytest.mark.parametrize('options', [[], ['--json'], ['--summary'], ['--stats']],
                         ids=lambda options: ' '.join(options) or 'lines')
def test_odd_packets_are_shown(options, tmp_path):
    file = tmp_path / 'odd.bin'
    file.write_bytes(b''.join(START[family] + odd for family, odd in ODD.values()))
    done = forked.run('servobus.tools.dxl_dump', file, '--baud', str(BAUD), *options)
    assert (done.returncode, b'Traceback' in done.stderr) == (0, False)
    assert done.stdout
