# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
USB events to bytes with a side: real captures, all families of adapters, files of all kinds.

The real captures do not come from the authors of the decoders; tshark, if installed, is asked too.
"""

from functools import partial
import io
import os
from pathlib import Path
import struct
import subprocess
import sys

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest
from usb_files import changes
from usb_files import events
from usb_files import hear
from usb_files import log
from usb_files import ports_in
from usb_files import REAL
from usb_files import side

from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.usb_adapter import FAMILIES
from msg_defs.event import IN
from msg_defs.event import OUT
from rigs.tables import rows_of
from rigs.usb_pcap import cut
from rigs.usb_pcap import LINUX
from rigs.usb_pcap import MMAPPED
from rigs.usb_pcap import pcap
from rigs.usb_pcap import pcapng
from rigs.usb_pcap import USBPCAP
from servobus.sources import adapters
from servobus.sources.adapters import adapter_of
from servobus.sources.adapters import CdcAcm
from servobus.sources.adapters import Ch341
from servobus.sources.adapters import Cp210x
from servobus.sources.adapters import Ftdi
from servobus.sources.adapters import Setup
from servobus.sources.adapters import UsbIdentity
from servobus.sources.pcap import PcapReader
from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_source import is_usb
from servobus.sources.usb_source import UsbEvents
from servobus.sources.usbmon import Records

SESSIONS = ('healthy', 'missing', 'acm')
FEW_EXAMPLES = settings(max_examples=60)
BEGAN = 1_795_329_340_000_000_000
CHUNKS = st.lists(st.tuples(st.sampled_from((OUT, IN)), st.binary(min_size=1, max_size=1500)),
                  min_size=1, max_size=6)
ALL_BYTES = bytes(range(256)) * 5


def read(data):
    found = UsbEvents(io.BytesIO(data))
    return list(found), found.problems


def stream(adapter, chunks, baud=1_000_000):
    """Return the events of an adapter that is plugged in, opened and used."""
    whole = adapter.plug(BEGAN) + adapter.set_baud(baud, BEGAN)
    for number, (which, data) in enumerate(chunks):
        tell = adapter.sent if which == OUT else adapter.received
        whole += tell(data, BEGAN + 1_000_000 * number)
    return whole


# --- real captures -----------------------------------------------------------------------------


@pytest.mark.parametrize('session', SESSIONS)
@pytest.mark.parametrize('kind', ['pcap', 'bin'])
def test_real_capture_is_what_the_master_wrote_and_read(session, kind):
    found, problems = read((REAL / f'{session}.{kind}').read_bytes())
    assert not problems
    heard = hear(found)
    wrote, got = log(session)
    assert side(heard, OUT) == wrote
    incoming = side(heard, IN)
    if session == 'missing':
        assert len(incoming) == len(got) + 60      # late answers, thrown away by the SDK unread
    else:
        assert incoming == got
    rates = [value for what, value in changes(heard) if what == 'baud']
    assert rates[:2] == [9600, 1_000_000]
    assert ('rts', 1) in changes(heard)


# --- adapters ----------------------------------------------------------------------------------


@pytest.mark.parametrize('family', FAMILIES)
@given(chunks=CHUNKS, transfer_size=st.integers(1, 1200))
@FEW_EXAMPLES
def test_what_an_adapter_carries_comes_back(family, chunks, transfer_size):
    heard = hear(events(stream(FakeAdapter(family, transfer_size), chunks)))
    for which in (OUT, IN):
        assert side(heard, which) == b''.join(data for one, data in chunks if one == which)
    assert ('baud', 1_000_000) in changes(heard)
    assert sorted({one.stamp for one in heard if one.data}) == [
        BEGAN + 1_000_000 * number for number in range(len(chunks))]
    order = [one.side for one in heard if one.data]
    assert [one for n, one in enumerate(order) if not n or order[n - 1] != one] == [
        one for n, (one, _) in enumerate(chunks) if not n or chunks[n - 1][0] != one]


@pytest.mark.parametrize(('divisor', 'baud'), [
    (0xC034, 57_600), (0x1A, 115_200), (0x3, 1_000_000), (0x1, 2_000_000), (0x0, 3_000_000),
    (0x300D0, 57_600), (0x2C068, 115_200), (0x2000C, 1_000_000), (0x20006, 2_000_000),
    (0x20004, 3_000_000), (0x20003, 4_000_000), (0x34002, 4_500_000)])
@pytest.mark.parametrize('is_multi', [False, True])
def test_ftdi_divisor(divisor, baud, is_multi):
    upper = divisor >> 16
    target = upper << 8 | 1 if is_multi else upper
    setup = Setup(0x40, 3, divisor & 0xFFFF, target)
    assert Ftdi(is_multi=is_multi).control(setup, b'') == [('baud', baud)]


@pytest.mark.parametrize('size', [64, 512])
def test_ftdi_status_bytes(size):
    first = b'\x01\x60' + bytes(range(1, size - 1 & 0xFF)) + bytes(size)
    first = first[:size]
    data, found = Ftdi(size).received(first + b'\x31\x6a\xff\xfe')
    assert data == first[2:] + b'\xff\xfe'
    assert found == [('overrun', 1), ('framing', 1)]
    assert Ftdi(size).received(b'\x01\x6a') == (b'', [])           # no byte that it is about
    assert Ftdi(size).received(b'') == (b'', [])


def test_errors_of_a_cdc_adapter():
    assert CdcAcm().interrupt(bytes.fromhex('a1200000010002005000')) == [
        ('framing', 1), ('overrun', 1)]


@pytest.mark.parametrize(('family', 'kind', 'code', 'value', 'said'), rows_of(
    Path(__file__).with_name('usb_requests.tsv')))
def test_what_the_requests_of_a_driver_set(family, kind, code, value, said):
    setup = Setup(*(int(one, 16) for one in (kind, code, value)), 0)
    changes = getattr(adapters, family)().control(setup, b'')
    assert ', '.join(f'{one.what} {one.value}' for one in changes) == said


@pytest.mark.parametrize(('registers', 'baud'), [
    (0xB282, 9600), (0xCC83, 115_200), (0xF383, 460_800), (0xFA83, 1_000_000),
    (0xFA87, 2_000_000), (0xFC87, 3_000_000)])
def test_ch341_divisor(registers, baud):
    assert Ch341().control(Setup(0x40, 0x9A, 0x1312, registers), b'') == [('baud', baud)]


def test_what_is_no_notice_of_a_cdc_adapter_says_nothing():
    for data in (b'', bytes.fromhex('a120000001000200'), bytes.fromhex('a1000000010002005000')):
        assert CdcAcm().interrupt(data) == []


@pytest.mark.parametrize('size', range(1, 11))
def test_notice_of_a_cdc_adapter_may_come_in_several_packets(size):
    notice = bytes.fromhex('a1200000010002001000')
    acm = CdcAcm()
    for _ in range(2):
        said = [one for at in range(0, len(notice), size)
                for one in acm.interrupt(notice[at:at + size])]
        assert said == [('framing', 1)]
    assert acm.interrupt(notice[:8]) == []         # its end was not heard: the next one is whole
    assert acm.interrupt(notice) == [('framing', 1)]
    assert acm.interrupt(notice[8:]) == []


@pytest.mark.parametrize(('told', 'used'), [(0, 64), (64, 64), (512, 512)])
def test_a_chip_that_does_not_say_its_packet_size_has_small_ones(told, used):
    assert adapter_of(UsbIdentity(0x0403, 0x6001, 0x0600, 0xFF), told).packet_size == used


@given(data=st.binary(max_size=200).map(lambda data: data.replace(b'\1', b'\xec')),
       size=st.integers(1, 20))
@FEW_EXAMPLES
def test_escapes_of_a_cp210x_may_be_cut_anywhere(data, size):
    adapter = FakeAdapter('cp210x', size, has_events=True)
    heard = hear(events(stream(adapter, [(OUT, b'\xff\xff'), (IN, data or b'x')])))
    assert side(heard, IN) == (data or b'x')


def test_byte_with_an_error_in_the_data_of_a_cp210x():
    adapter = Cp210x()
    adapter.control(Setup(0x41, 0x15, 0xEC, 0), b'')
    assert adapter.received(b'a\xec\x01\x08\xec\x00b\xec\x02\x20\xec\x03\x10c') == (
        b'a\xec\x00bc', [('framing', 1)])
    assert adapter.received(b'd\xec') == (b'd', [])
    assert adapter.received(b'\x00e') == (b'\xece', [])


@pytest.mark.parametrize('name', [one.name for one in adapters.FAMILIES])
def test_the_page_names_every_family(name):
    page = Path(__file__).parents[1] / 'docs' / 'wiring.md'
    assert name.partition('/')[0] in page.read_text()


def test_every_family_has_a_fake():
    assert {type(ports_in(events(FakeAdapter(name).plug(BEGAN)))[0].adapter)
            for name in FAMILIES} == {*adapters.FAMILIES}


def test_what_never_left_the_host_and_unplugging():
    adapter = FakeAdapter('ft232r')
    sent = bytearray(stream(adapter, [(OUT, b'\xff\xff\xfd\x00')]))
    done = cut(bytes(sent))[-1][1]
    struct.pack_into('<iI', sent, len(sent) - len(done) + 28, -108, 1)
    heard = hear(events(bytes(sent) + adapter.unplug(BEGAN)))
    assert changes(heard)[-3:] == [('not_sent', 3), ('unplugged', 1), ('unplugged', 1)]


@pytest.mark.parametrize('family', FAMILIES)
@given(chunks=CHUNKS, transfer_size=st.integers(1, 1200), data=st.data())
@FEW_EXAMPLES
def test_the_short_way_through_the_stream_says_the_same(family, chunks, transfer_size, data):
    """Records.events() with UsbPort.skim(), in pieces of any size, against one event at a time."""
    adapter = FakeAdapter(family, transfer_size, has_events=data.draw(st.booleans()))
    whole = bytearray(stream(adapter, chunks) + adapter.idle(BEGAN) + adapter.unplug(BEGAN))
    head = len(adapter.plug(BEGAN))
    for at in data.draw(st.lists(st.integers(head, len(whole) - 1), max_size=3)):
        whole[at] ^= data.draw(st.sampled_from((1, 0x0E, 0x80)))
    one, *_ = ports_in(events(bytes(whole[:head])))
    place, kind = one.place, type(one.adapter)
    size = FAMILIES[family].packet_size
    slow, fast = (UsbPort(place, kind(size), 'bus') for _ in range(2))
    expected = [one for event in Records().events(bytes(whole))
                for one in slow.decode_event(event)]
    records, found = Records(), []
    borders = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=8)))
    for begin, end in zip([0, *borders], [*borders, len(whole)], strict=True):
        for event in records.events(bytes(whole[begin:end]), partial(fast.skim, decoded=found)):
            found += fast.decode_event(event)
    assert found == expected


def test_nearly_all_of_a_real_capture_goes_the_short_way():
    whole = (REAL / 'healthy.bin').read_bytes()
    one, = ports_in(events(whole))
    port, found = UsbPort(one.place, one.adapter, 'bus'), []
    list(Records().events(whole, partial(port.skim, decoded=found)))
    assert len(found) > 0.9 * len([heard for heard in hear(events(whole)) if heard.data])


def test_port_is_known_without_its_descriptors():
    for family in FAMILIES:
        adapter = FakeAdapter(family, 1024)
        body = adapter.sent(b'\xff\xff\xfd\x00' + ALL_BYTES, BEGAN) \
            + adapter.received(ALL_BYTES, BEGAN)
        for opening in (adapter.set_baud(57_600, BEGAN), b''):
            heard = hear(events(opening + body))
            assert side(heard, IN) == ALL_BYTES
            assert side(heard, OUT).endswith(ALL_BYTES)


def test_keyboards_and_disks_are_no_serial_ports():
    adapter = FakeAdapter('cp210x')
    said = adapter.sent(b'USBC1234', BEGAN) + adapter.received(b'data', BEGAN)
    assert ports_in(events(said)) == []


# --- files -------------------------------------------------------------------------------------


@pytest.mark.parametrize('link', [LINUX, MMAPPED, USBPCAP])
@pytest.mark.parametrize('wrap', [pcap, pcapng, lambda link, whole: pcapng(link, whole, 9)])
@pytest.mark.parametrize('family', FAMILIES)
def test_every_kind_of_file_says_the_same(link, wrap, family):
    chunks = [(OUT, b'\xff\xff\xfd\x00' + ALL_BYTES), (IN, ALL_BYTES), (OUT, b'\x01')]
    whole = stream(FakeAdapter(family), chunks)
    file = wrap(link, whole)
    assert is_usb(file[:64])
    found, problems = read(file)
    assert [text for text in problems if 'link type 1 ' not in text] == []
    heard, expected = hear(found), hear(events(whole))
    assert [(one.stamp, one.side, one.data) for one in heard if one.data] == [
        (one.stamp, one.side, one.data) for one in expected if one.data]
    assert changes(heard) == changes(expected)


def test_big_endian_file():
    small = cut(stream(FakeAdapter('ftdi'), [(OUT, b'\xff\xff'), (IN, b'abc')]))
    form = 'QBBBBHBBqiiII8siiII'
    big = b''.join(
        struct.pack('>' + form, *struct.unpack('<' + form, event[:64])) + event[64:]
        for _, event in small)
    rows = []
    for _, event in small:
        swapped, big = big[:len(event)], big[len(event):]
        rows.append(struct.pack('>IIII', 1, 2, len(swapped), len(swapped)) + swapped)
    file = struct.pack('>IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, MMAPPED) + b''.join(rows)
    found, problems = read(file)
    assert not problems
    assert side(hear(found), IN) == b'abc'


@pytest.mark.parametrize('wrap', [lambda whole: whole, lambda whole: pcap(MMAPPED, whole),
                                  lambda whole: pcapng(MMAPPED, whole)])
def test_cut_anywhere_what_is_in_front_is_used(wrap):
    pieces = [event for _, event in cut((REAL / 'healthy.bin').read_bytes()[:4000])[:20]]
    borders = {len(wrap(b''.join(pieces[:n]))): n for n in range(len(pieces) + 1)}
    whole = wrap(b''.join(pieces))
    for size in range(min(borders) + 64, len(whole)):
        found, problems = read(whole[:size])
        assert len(found) == max(n for border, n in borders.items() if border <= size)
        cut_off = [text for text in problems if 'cut off' in text]
        assert bool(cut_off) == (size not in borders), size


@given(data=st.data())
@FEW_EXAMPLES
def test_damage_is_told_and_never_raises(data):
    whole = bytearray(pcapng(MMAPPED, stream(FakeAdapter('ftdi'), [(OUT, ALL_BYTES)])))
    for _ in range(data.draw(st.integers(1, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    reader = PcapReader(io.BytesIO(bytes(whole)))
    packets = list(reader)
    assert packets or reader.problem
    hear_all(bytes(whole))


@given(data=st.binary(max_size=400))
@FEW_EXAMPLES
def test_any_bytes_never_raise(data):
    hear_all(data)
    hear_all(pcap(MMAPPED, b'')[:24] + data)
    hear_all(pcap(USBPCAP, b'')[:24] + struct.pack('<IIII', 1, 1, len(data), len(data)) + data)


def hear_all(data):
    """Read a file with any content, and hear every port."""
    found, _ = read(data)
    for one in ports_in(found):
        port = UsbPort(one.place, one.adapter, 'bus')
        for event in found:
            port.decode_event(event)


@pytest.mark.parametrize('link', [LINUX, MMAPPED, USBPCAP])
@pytest.mark.parametrize('family', FAMILIES)
def test_packets_that_are_cut_short_are_passed_over(family, link):
    adapter = FakeAdapter(family)
    whole = b''.join((adapter.plug(BEGAN), adapter.set_baud(1_000_000, BEGAN),
                      adapter.sent(b'\xff\xff', BEGAN), adapter.received(b'\1', BEGAN)))
    for size in range(100):
        hear_all(pcap(link, whole) + pcap(link, whole, change=lambda data, size=size: data[:size])[
            24:])


def test_other_packets_are_named():
    whole = pcapng(MMAPPED, stream(FakeAdapter('ftdi'), [(OUT, b'\xff\xff')]))
    assert read(whole)[1] == ['1 packets of link type 1 were left out; usbmon has 189 and 220, '
                              'USBPcap 249']


def test_a_time_far_out_is_passed_over(tmp_path):
    adapter, far = FakeAdapter('cdc-acm'), 1 << 90
    (tmp_path / 'far.bin').write_bytes(
        adapter.plug(far) + adapter.sent(b'\1', far) + adapter.sent(b'\2', BEGAN))
    done = subprocess.run(
        [sys.executable, '-m', 'servobus.tools.dxl_dump', 'far.bin', '-w', 'bus.txt'],
        cwd=tmp_path, env=os.environ | {'PYTHONPATH': str(Path(__file__).parents[1])},
        capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in (tmp_path / 'bus.txt').read_text().splitlines()
            if line.startswith('(')][-2:] == ['(0.000000000)', '(1795329340.000000000)']
