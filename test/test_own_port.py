# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Listening to the port that the master itself uses: usb:, tap: and files of USB events."""

import ctypes
import json
import os
import socket
import subprocess
import sys
import time

import forked
from harness import wait
import pytest
from usb_files import events
from usb_files import log
from usb_files import ports_in
from usb_files import REAL

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.usb_adapter import FakeAdapter
from mecarover_fakes.virtual_usb import VirtualUsb
from msg_defs.event import IN
from msg_defs.event import OUT
from rigs.usb_pcap import cut
from rigs.usb_pcap import MMAPPED
from rigs.usb_pcap import pcap
from servobus.bus.expected_devices import parse_all
from servobus.errors import UsageError
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.monitor import Settings
from servobus.port.port_error import PortError
from servobus.port.pty import Pty
from servobus.sources import usb_listener
from servobus.sources import usb_ring
from servobus.sources.listeners import listener_on
from servobus.sources.opening import open_source
from servobus.sources.source_name import bus_name
from servobus.sources.usb_find import find
from servobus.sources.usb_port import Place
from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_ring import wanted_size
from servobus.sources.usbmon import HEADER_SIZE
from servobus.tools.start_program import environment

MODELS = Models()


BAUD = 1_000_000
DEVICES = ['1-4:MX-106', '101:BitFoot']
DEADLINE_S = 20.0
BEGAN = 1_795_329_340_000_000_000


def dump(*arguments, **more):
    return forked.run_text('servobus.tools.dxl_dump', *arguments, **more)


# --- where an adapter is -----------------------------------------------------------------------


def plug(root, name, bus, number, vendor, product, interfaces, version='0900'):
    """Make what /sys shows of a device; interfaces: (class, {endpoint: packet size}, tty)."""
    device = root / 'devices/pci/usb1' / name
    (root / 'bus/usb/devices').mkdir(parents=True, exist_ok=True)
    (root / 'class/tty').mkdir(parents=True, exist_ok=True)
    device.mkdir(parents=True)
    (root / 'bus/usb/devices' / name).symlink_to(device)
    for file, text in (('busnum', bus), ('devnum', number), ('idVendor', vendor),
                       ('idProduct', product)):
        (device / file).write_text(f'{text}\n')
    described = bytes((18, 1)) + bytes(6) + b''.join(
        int(text, 16).to_bytes(2, 'little') for text in (vendor, product, version)) + bytes(4)
    described += bytes((9, 2)) + bytes(7)
    for index, (kind, ends, tty) in enumerate(interfaces):
        folder = device / f'{name}:1.{index}'
        folder.mkdir()
        (folder / 'bInterfaceNumber').write_text(f'{index:02x}\n')
        described += bytes((9, 4, index, 0, len(ends), int(kind, 16), 0, 0, 0))
        for address, size in ends.items():
            described += bytes((7, 5, address, 2 if size > 16 else 3)) \
                + size.to_bytes(2, 'little') + bytes(1)
        if tty:
            port = folder / tty if tty.startswith('ttyUSB') else folder
            port.mkdir(exist_ok=True)
            (root / 'class/tty' / tty).mkdir()
            (root / 'class/tty' / tty / 'device').symlink_to(port)
    (device / 'descriptors').write_bytes(described)


def test_adapter_is_found_by_its_tty_its_socket_and_its_number(tmp_path):
    plug(tmp_path, '1-1.2', 1, 7, '0403', '6014', [('ff', {0x81: 512, 0x02: 512}, 'ttyUSB0')])
    plug(tmp_path, '1-1.3', 1, 8, '1a86', '55d3', [
        ('02', {0x83: 16}, 'ttyACM0'), ('0a', {0x82: 64, 0x02: 64}, '')])
    plug(tmp_path, '2-1', 2, 3, '0403', '6010', [
        ('ff', {0x81: 512, 0x02: 512}, 'ttyUSB1'), ('ff', {0x83: 512, 0x04: 512}, 'ttyUSB2')],
        '0700')
    (tmp_path / 'devices/pci/usb1/1-1.2/1-1.2:1.0/ttyUSB0/latency_timer').write_text('16\n')
    for name in ('/dev/ttyUSB0', '1-1.2', '1.7', '001.007'):      # the last: as lsusb prints it
        target = find(name, tmp_path)
        assert target.place == Place(1, 7, 1, 2)
        assert (target.adapter.name, target.adapter.packet_size) == ('FTDI', 512)
        assert target.latency_timer_ms == 16
        assert target.words == 'FTDI 0403:6014 at 1-1.2'
    assert find('/dev/ttyACM0', tmp_path)[:1] == (Place(1, 8, 2, 2),)
    assert find('/dev/ttyACM0', tmp_path).adapter.name == 'CDC-ACM'
    second = find('/dev/ttyUSB2', tmp_path)
    assert (second.place, second.adapter.is_multi) == (Place(2, 3, 3, 4), True)


def test_what_is_no_adapter_is_told(tmp_path):
    plug(tmp_path, '1-1', 1, 2, '046d', 'c31c', [('03', {0x81: 8}, '')])
    plug(tmp_path, '1-2', 1, 3, '0781', '5567', [('08', {0x81: 64, 0x02: 64}, '')])
    (tmp_path / 'class/tty/ttyAMA0').mkdir()
    for name, words in (('/dev/ttyUSB9', 'is not there'), ('1-7', 'is not there'),
                        ('1.9', 'is not there'), ('/dev/ttyAMA0', 'is not on USB'),
                        ('1-1', '046d:c31c'), ('1.3', '0781:5567')):
        with pytest.raises(PortError, match=words):
            find(name, tmp_path)


def test_usbmon_that_is_not_there_or_not_allowed(monkeypatch, tmp_path):
    with pytest.raises(PortError, match='sudo modprobe usbmon'):
        usb_listener._open('usb:x', '/dev/usbmon_of_no_kernel')

    def refuse(*_):
        raise PermissionError
    monkeypatch.setattr(os, 'open', refuse)
    with pytest.raises(PortError, match='belongs to root, because it shows keyboards'):
        usb_listener._open('usb:x', '/dev/usbmon1')


# --- the ring ----------------------------------------------------------------------------------


@pytest.mark.parametrize('name', ['healthy', 'missing', 'acm'])
def test_what_the_ring_leaves_out_says_nothing(name):
    whole = (REAL / f'{name}.bin').read_bytes()
    one, = ports_in(events(whole))
    ends = frozenset((one.place.bulk_in | 0x80, one.place.bulk_out))
    kept, at = [], 0
    for _, event in cut(whole):
        size = wanted_size(whole, at, one.place.device, ends,
                           2 if one.adapter.name == 'FTDI' else 0)
        if size >= 0:
            assert HEADER_SIZE + size == len(event)
            kept.append(event)
        at += len(event)
    assert len(kept) < len(cut(whole))
    few, all_of_it = (UsbPort(one.place, one.adapter, 'bus') for _ in range(2))
    assert [few.decode_event(event) for event in events(b''.join(kept))
            if few.decode_event(event)] == [
        all_of_it.decode_event(event) for event in events(whole) if all_of_it.decode_event(event)]


def test_other_devices_are_never_copied():
    adapter = FakeAdapter('ftdi')
    event = adapter.sent(b'password', BEGAN)
    assert wanted_size(event, 0, 7, frozenset((0x81, 2)), 2) == 8
    assert wanted_size(event, 0, 6, frozenset((0x81, 2)), 2) == -1
    assert wanted_size(event, 0, 7, frozenset((0x83, 4)), 2) == -1
    assert wanted_size(adapter.idle(BEGAN), 0, 7, frozenset((0x81, 2)), 2) == -1


def test_what_was_seen_is_let_go_and_what_found_no_room_is_counted(monkeypatch):
    adapter = FakeAdapter('ftdi')
    ours, memory = adapter.received(b'answer', BEGAN), bytearray(100)
    other = bytearray(ours)
    other[11] += 1                                     # its device
    places = [len(memory), len(memory) + len(ours)]
    memory += ours + other
    gone, dropped = [], [3, 0]

    def ioctl(fd, request, argument=0):
        if request == usb_ring._FETCH:
            gone.append(argument.flush)
            argument.count, found = min(argument.count, len(places)), places[:argument.count]
            if not found:
                raise BlockingIOError
            (ctypes.c_uint32 * len(found)).from_address(argument.offsets)[:] = found
            del places[:argument.count]
        elif request == usb_ring._STATISTICS:
            argument[4:] = dropped.pop(0).to_bytes(4, 'little')

    monkeypatch.setattr(usb_ring.fcntl, 'ioctl', ioctl)
    monkeypatch.setattr(usb_ring.mmap, 'mmap', lambda *_: memory)
    ring = usb_ring.Ring(-1, 7, frozenset((0x81, 2)), 2)
    assert (ring.read(), ring.dropped, sum(gone)) == (ours, 3, 2)
    assert (ring.read(), ring.dropped, sum(gone)) == (b'', 3, 2)
    monkeypatch.setattr(usb_ring, 'FETCH_MAX_EVENTS', 1)   # more than one look takes at a time
    places += [100, 100 + len(ours), 100]
    dropped += [0]
    assert (ring.read(), sum(gone)) == (2 * ours, 5)


# --- live --------------------------------------------------------------------------------------


class Collector:
    """A monitor behind a listener on a live source."""

    def __init__(self, name):
        self.monitor = Monitor('bus', MODELS, Settings(0, tuple(parse_all(DEVICES))),
                               idle_is_told=True)
        self.changes = []
        self.listener = listener_on(name, 0, self._feed, self.monitor.flush_if_idle)
        self.listener.start()

    def _feed(self, chunks):
        self.changes += [one.change for one in chunks if one.change]
        self.monitor.feed_chunks(chunks)

    def report(self):
        return self.monitor.report(time.monotonic_ns())


@pytest.mark.realtime(bears=0.05)
@pytest.mark.parametrize('family', ['ftdi', 'cp210x'])
def test_bus_is_heard_through_usb(meeting_place, family):
    path = os.path.join(meeting_place, 'usb')
    line = Line(make_devices(DEVICES, MODELS, BAUD), BAUD)
    bus = FakeBus(Master(line, PATTERNS['moving'], rate=50.0),
                  usb=VirtualUsb(path, family, BAUD))
    collector = Collector(f'usb:{path}')
    try:
        wait(lambda: collector.listener.state.is_open)
        bus.start()
        wait(lambda: collector.report().counters['Packets'] > 300)
        report = collector.report()
    finally:
        bus.stop()
        wait(lambda: collector.listener.state.kind == 'lost')
        collector.listener.stop()
    assert report.baud == BAUD
    assert {device.id for device in report.devices} == {1, 2, 3, 4, 101}
    assert sum(device.totals.missed for device in report.devices) == 0
    assert report.counters['Noise Bytes'] == report.counters['CRC Errors'] == 0
    assert set(collector.monitor.decoder.framers) == {'', OUT, IN}


@pytest.mark.realtime(bears=0.05)
def test_adapter_that_is_unplugged_is_looked_for(meeting_place):
    path = os.path.join(meeting_place, 'usb')
    adapter = FakeAdapter('cdc-acm')
    told = adapter.plug(BEGAN) + adapter.sent(b'\xff\xff\xfd\x00', BEGAN) + adapter.unplug(BEGAN)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path)
        server.listen()
        server.settimeout(DEADLINE_S)
        collector = Collector(f'usb:{path}')
        try:
            for openings in (1, 2):
                stream, _ = server.accept()
                stream.sendall(told)
                wait(lambda n=openings: collector.listener.openings == n
                         and collector.listener.state.kind == 'lost')
                assert 'the adapter was unplugged' in collector.listener.state.text
                stream.close()
        finally:
            collector.listener.stop()
    assert [change.what for change in collector.changes].count('unplugged') == 2


@pytest.mark.realtime(bears=0.05)
def test_tap_hears_the_port_that_is_named(meeting_place, monkeypatch):
    monkeypatch.setenv('XDG_RUNTIME_DIR', meeting_place)
    script = 'import serial, sys, time\n' \
             'ports = [serial.Serial(path, 57600) for path in sys.argv[1:]]\n' \
             'for number, port in enumerate(ports): port.write(b"%d" % number * 5)\n' \
             'time.sleep(60)\n'
    with Pty() as first, Pty() as second:
        heard = {}
        names = 'tap:arm', f'tap:arm/{os.path.basename(second.path)}', 'tap:other'
        listeners = [listener_on(name, 0, lambda chunks, name=name: [heard.setdefault(
            name, (one.side, one.data)) for one in chunks if one.data]) for name in names]
        for listener in listeners:
            listener.start()
        wait(lambda: all(one.state.is_open for one in listeners))
        child = subprocess.Popen([sys.executable, '-c', script, first.path, second.path],
                                 env=environment('arm'))
        try:
            wait(lambda: len(heard) == 2)
            assert heard == dict(zip(names[:2], [(OUT, b'0' * 5), (OUT, b'1' * 5)], strict=True))
            assert second.path in listeners[0].problems()[0]
            assert listeners[2].state.is_open
        finally:
            child.kill()
            child.wait()
            for listener in listeners:
                listener.stop()


def test_names_of_sources():
    assert [bus_name(name) for name in ('/dev/ttyUSB0', 'usb:/dev/ttyUSB0', 'usb:1-1.2',
                                        'tap:arm', 'tap:arm/ttyUSB1', 'socket://host:1')] == [
        'ttyUSB0', 'ttyUSB0', '1-1.2', 'arm', 'ttyUSB1', 'host:1']


# --- files -------------------------------------------------------------------------------------


def test_dump_of_a_real_capture_and_of_what_it_recorded(tmp_path):
    wrote, got = log('missing')
    copy = tmp_path / 'copy.txt'
    first = dump(REAL / 'missing.pcap', '--json')
    assert dump(REAL / 'missing.bin', '-w', copy).returncode == 0
    packets = [json.loads(line) for line in first.stdout.splitlines()]
    assert {packet['side'] for packet in packets if packet['instruction'] == 'Status'} == {IN}
    assert {packet['side'] for packet in packets if packet['instruction'] != 'Status'} == {OUT}
    again = [json.loads(line) for line in dump(copy, '--json').stdout.splitlines()]
    assert len(again) == len(packets)
    assert [one['params'] for one in again] == [one['params'] for one in packets]
    assert all('no answer' not in packet.get('notes', ()) for packet in packets)
    summary = json.loads(dump(copy, '--summary').stdout)
    assert str(len(wrote) + len(got) + 60) in json.dumps(summary)
    lines = dump(REAL / 'healthy.pcap').stdout.splitlines()
    assert ' out > 001' in lines[0]
    assert ' in  < 001' in lines[1]


def test_pcap_from_a_pipe():
    with open(REAL / 'acm.pcap', 'rb') as file:
        done = dump('-', '--count', '3', stdin=file)
        assert len(done.stdout.splitlines()) == 3
    cat = subprocess.Popen(['cat', REAL / 'acm.pcap'], stdout=subprocess.PIPE)
    assert dump('-', '--count', '3', stdin=cat.stdout).stdout == done.stdout
    cat.stdout.close()
    cat.wait()


def test_adapter_is_chosen_where_there_are_several(tmp_path):
    file = tmp_path / 'two.pcap'
    file.write_bytes(pcap(MMAPPED, (REAL / 'healthy.bin').read_bytes()
                          + (REAL / 'acm.bin').read_bytes()))
    wrong = dump(file)
    assert wrong.returncode == 2
    assert '1.5 FTDI 0403:6001' in wrong.stderr
    assert '3.4 CDC-ACM' in wrong.stderr
    assert len(dump(file, '--adapter', '3.4', '--json').stdout.splitlines()) == len(
        dump(REAL / 'acm.bin', '--json').stdout.splitlines()) > 100
    assert 'no adapter 9.9 in it: ' in dump(file, '--adapter', '9.9').stderr
    assert 'not a file of USB events' in dump(REAL / 'README.md', '--adapter', '1.1').stderr


def test_file_without_an_adapter(tmp_path):
    file = tmp_path / 'none.pcap'
    file.write_bytes(pcap(MMAPPED, b''))
    with pytest.raises(UsageError, match='no serial adapter found in it; record'):
        open_source('dxl_dump', str(file), None)
    file.write_bytes(pcap(MMAPPED, FakeAdapter('ftdi').idle(BEGAN))[:-1])
    with pytest.raises(UsageError, match=r'no serial adapter found in it \(.*cut off'):
        open_source('dxl_dump', str(file), None)


def test_the_only_adapter_of_a_file_is_read_though_it_carried_nothing(tmp_path):
    file = tmp_path / 'quiet.pcap'
    adapter = FakeAdapter('ftdi')
    file.write_bytes(pcap(MMAPPED, adapter.plug(BEGAN) + adapter.idle(BEGAN))[:-1])
    done = dump(file)
    assert (done.returncode, done.stdout) == (0, '')
    assert 'cut off' in done.stderr
