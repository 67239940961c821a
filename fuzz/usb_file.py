# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Files of USB events: any bytes, and a written stream with damage."""

import io
import struct

from dxl_monitor.fake.usb_adapter import FakeAdapter
from dxl_monitor.fake.usb_adapter import FAMILIES
from dxl_monitor.port.usb_port import UsbPort
from dxl_monitor.port.usb_survey import Survey
from dxl_monitor.record.usb_events import UsbEvents
from fuzz.script import Script
from msg_defs.heard import IN
from msg_defs.heard import OUT

STAMP = 1_795_329_340_000_000_000
PCAP = {link: struct.pack('<IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, link)
        for link in (189, 220, 249)}
FRONTS = (*PCAP.values(), b'', bytes.fromhex(
    '0a0d0d0a1c0000004d3c2b1a01000000ffffffffffffffff1c000000'
    '0100000014000000dc0000000000000014000000'))


def check(data):
    """
    Check one file.

    Any bytes behind any header never raise, and no byte is heard that is not in the file. What an
    adapter carried comes back to the byte and with its side, at transfers of any size; the same
    stream with damage never raises.
    """
    any_bytes(FRONTS[data[0] % len(FRONTS)] + data[1:] if data else b'')
    script = Script(data)
    family = script.pick(tuple(FAMILIES))
    adapter = FakeAdapter(family, 1 + script.word() % 1100)
    whole = adapter.plug(STAMP) + adapter.set_baud(1_000_000, STAMP)
    sides = {OUT: b'', IN: b''}
    while script:
        side = script.pick((OUT, IN))
        piece = script.take(1 + script.byte()) or b'\0'
        whole += (adapter.sent if side == OUT else adapter.received)(piece, STAMP)
        sides[side] += piece
    heard = hear(whole)
    if sides[OUT] or sides[IN]:
        assert {side: b''.join(one.data for one in heard if one.side == side)
                for side in sides} == sides
    for at in range(0, len(data) - 2, 3):
        place = (data[at] << 8 | data[at + 1]) % len(whole)
        whole = whole[:place] + data[at + 2:at + 3] + whole[place + 1:]
    hear(whole)


def any_bytes(data):
    heard = hear(data)
    assert sum(len(one.data) for one in heard) <= len(data)


def hear(data):
    found = list(UsbEvents(io.BytesIO(data), data[:64]))
    survey = Survey()
    for event in found:
        survey.take(event)
    heard = []
    for one in survey.ports():
        port = UsbPort(one.place, one.adapter)
        heard += [said for event in found if (said := port.take(event)) is not None]
    return heard
