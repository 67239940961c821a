# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""USB events as pcap and pcapng files of all link types."""

import struct

LINUX, MMAPPED, USBPCAP = 189, 220, 249
_WORD = 0xFFFFFFFF


def packet(link, event):
    """Return one event (header and data, as usbmon gives it) as a packet of a link type."""
    head, data = event[:64], event[64:]
    if link == MMAPPED:
        return event
    if link == LINUX:
        return head[:48] + data
    (number, kind, transfer, endpoint, device, bus) = struct.unpack_from('<QBBBBH', head)
    status = struct.unpack_from('<i', head, 28)[0]
    is_back = kind == ord('C')
    status = {0: 0, -115: 0, -32: 0xC0000004, -108: 0xC0007000}.get(status, 0xC0000001)
    setup = head[40:48] if transfer == 2 and not is_back else b''
    stage = bytes([0 if setup else 3]) if transfer == 2 else b''
    size = 27 + len(stage)
    return struct.pack('<HQIHBHHBBI', size, number, status, 9, is_back, bus, device, endpoint,
                       transfer, len(setup) + len(data)) + stage + setup + data


def cut(records):
    """Return the events of a stream, each with its stamp (s, us)."""
    found = []
    while records:
        size = 64 + struct.unpack_from('<I', records, 36)[0]
        found.append((struct.unpack_from('<qi', records, 16), records[:size]))
        records = records[size:]
    return found


def pcap(link, records, order='<', change=bytes):
    """
    Return a pcap file; change: what is done to each packet.

    order '>': of the file; the events must be of that order too.
    """
    whole = struct.pack(order + 'IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, link)
    for (seconds, us), event in cut(records):
        data = change(packet(link, event))
        whole += struct.pack(order + 'IIII', seconds & _WORD, us & _WORD, len(data),
                             len(data)) + data
    return whole


def block(kind, body):
    body += bytes(-len(body) % 4)
    size = struct.pack('<I', len(body) + 12)
    return struct.pack('<I', kind) + size + body + size


def pcapng(link, records, digits=6, change=bytes):
    """Return a pcapng file with stamps of so many decimals, with an interface of another."""
    whole = block(0x0A0D0D0A, struct.pack('<IHHq', 0x1A2B3C4D, 1, 0, -1))
    whole += block(1, struct.pack('<HHI', 1, 0, 0))
    whole += block(1, struct.pack('<HHI', link, 0, 0) + struct.pack('<HHBxxx', 9, 1, digits)
                   + struct.pack('<HH', 0, 0))
    whole += block(6, struct.pack('<IIIII', 0, 0, 0, 4, 4) + b'none')
    for (seconds, us), event in cut(records):
        stamp = (seconds * 1_000_000 + us) * 10 ** (digits - 6)
        data = change(packet(link, event))
        whole += block(6, struct.pack('<IIIII', 1, stamp >> 32 & _WORD, stamp & _WORD, len(data),
                                      len(data)) + data + bytes(-len(data) % 4)
                       + struct.pack('<HHI', 2, 4, 1) + struct.pack('<HH', 0, 0))
    return whole
