# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The listening port thread on real ptys and sockets: complete, read-only, found again, quick."""

import os
from pathlib import Path
import socket
import termios
import threading
import time

from harness import wait
import pytest
from terminal_server import TerminalServer

from servobus.bus.report import LineErrors
from servobus.port.pty import Pty
from servobus.sources.listener import Listener
from servobus.sources.serial_driver import adapter
from servobus.sources.serial_driver import latency_timer_ms
from servobus.sources.serial_driver import shorten_latency_timer

pytestmark = pytest.mark.realtime(bears=0.02)


def _wait_longer(found, than):
    wait(lambda: len(found) > than)


class Collector:
    """A tap, and what it hands on."""

    def __init__(self, port, baud=2_000_000):
        self.chunks = []
        self.idle = []
        self.listener = Listener(
            port, baud, lambda chunks: self.chunks.extend((one.data, one.stamp) for one in chunks),
            self.idle.append)
        self.listener.start()

    @property
    def data(self):
        return b''.join(chunk for chunk, _ in self.chunks)

    def wait_open(self):
        wait(lambda: self.listener.state.is_open)


@pytest.fixture
def cable(tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty:
        yield pty


@pytest.fixture
def collector(cable):
    collector = Collector(str(cable.link))
    collector.wait_open()
    yield collector
    collector.listener.stop()


def test_tells_that_the_line_is_idle_and_how_far_it_listened(cable, collector):
    for _ in range(3):
        os.write(cable.master, b'x')
        _wait_longer(collector.idle, len(collector.idle) + 1)
    wait(lambda: len(collector.data) == 3)
    wait(lambda: collector.idle[-1] > collector.chunks[-1][1])
    wait(lambda: collector.listener.listened == collector.idle[-1])
    assert collector.idle == sorted(collector.idle)


def test_idle_time_covers_latency_timer_and_slow_rates(tmp_path):
    def listening(baud, latency):
        listener = Listener(str(tmp_path / 'absent'), baud, lambda chunks: None)
        listener.latency_timer_ms = latency
        return listener
    assert listening(2_000_000, None).idle_s == 0.02
    assert listening(2_000_000, 16).idle_s == 0.032
    assert listening(1200, None).idle_s == pytest.approx(200 / 1200)


def test_descriptor_is_read_only(cable, collector):
    device = os.stat(cable.path).st_rdev
    own = {cable.master, cable._slave}
    flags = []
    for entry in Path('/proc/self/fd').iterdir():
        number = int(entry.name)
        try:
            same = os.stat(entry).st_rdev == device
        except OSError:
            continue
        if same and number not in own:
            flags += [line.split()[1] for line in
                      Path(f'/proc/self/fdinfo/{number}').read_text().splitlines()
                      if line.startswith('flags')]
    assert flags
    assert all(int(flag, 8) & os.O_ACCMODE == os.O_RDONLY for flag in flags)


def test_sends_nothing(cable, collector):
    os.write(cable.master, b'hello')
    wait(lambda: collector.data)
    collector.listener.stop()
    with pytest.raises(BlockingIOError):
        os.read(cable.master, 1)
    collector.listener = Collector(str(cable.link)).listener


def test_is_lost_and_found_ten_times(tmp_path):
    link = str(tmp_path / 'bus')
    before = len(os.listdir('/proc/self/fd'))
    collector = Collector(link)
    wait(lambda: collector.listener.state.kind == 'absent')
    assert 'is not there' in collector.listener.state.text
    for round_ in range(10):
        _plug_in_and_out(link, collector, bytes([round_]))
    assert collector.data == bytes(range(10))
    assert collector.listener.openings == 10
    collector.listener.stop()
    assert collector.listener.state.kind == 'stopped'
    assert len(os.listdir('/proc/self/fd')) == before


def test_no_mistake_ends_the_listening(cable):
    """Not one of ours either: the port is opened again."""
    mistakes = [TypeError('expected str, not NoneType')]

    def feed(chunks):
        if mistakes:
            raise mistakes.pop()
        heard.extend(one.data for one in chunks)

    heard = []
    listener = Listener(str(cable.link), 2_000_000, feed)
    listener.start()
    wait(lambda: listener.state.is_open)
    os.write(cable.master, b'x')
    wait(lambda: listener.openings > 1 and listener.state.is_open)
    os.write(cable.master, b'y')
    wait(lambda: b'y' in b''.join(heard))
    listener.stop()


def _plug_in_and_out(link, collector, byte):
    with Pty(link) as cable:
        collector.wait_open()
        os.write(cable.master, byte)
        wait(lambda: collector.data.endswith(byte))
    wait(lambda: not collector.listener.state.is_open)


def test_stops_at_once_whatever_it_is_doing(tmp_path):
    def stopping_s(collector):
        begin = time.monotonic()
        collector.listener.stop()
        return time.monotonic() - begin

    assert stopping_s(Collector(str(tmp_path / 'absent'))) < 0.5
    with Pty() as one, Pty() as two, Pty() as three:
        collectors = [Collector(cable.path) for cable in (one, two, three)]
        for collector in collectors:
            collector.wait_open()
        assert max(map(stopping_s, collectors)) < 0.5
    assert not [one for one in threading.enumerate() if one.name.startswith('listener')]


def test_stop_may_come_before_the_start_is_through(tmp_path):
    for _ in range(20):
        Collector(str(tmp_path / 'absent')).listener.stop()


def test_hears_a_socket():
    with socket.create_server(('127.0.0.1', 0)) as server:
        collector = Collector(f'socket://127.0.0.1:{server.getsockname()[1]}')
        connection, _ = server.accept()
        with connection:
            collector.wait_open()             # pyserial drops what came before
            connection.sendall(b'over the net')
            wait(lambda: collector.data == b'over the net')
            connection.setblocking(False)
            with pytest.raises(BlockingIOError):
                connection.recv(1)
        wait(lambda: not collector.listener.state.is_open)
    collector.listener.stop()


def test_hears_a_terminal_server_and_finds_it_again(cable):
    with TerminalServer(cable.path) as server:
        collector = Collector(server.url, 1_000_000)
        for opening in (1, 2):
            wait(lambda: collector.listener.openings == opening)  # noqa: B023
            collector.wait_open()
            os.write(cable.master, b'over the net')
            wait(lambda: collector.data == opening * b'over the net')        # noqa: B023
            server.hang_up()
        with pytest.raises(BlockingIOError):
            os.read(cable.master, 1)
        collector.listener.stop()


def test_latency_timer_of_an_ftdi_adapter_is_lowered_where_allowed(tmp_path):
    folder = tmp_path / 'class/tty/ttyUSB7/device'
    folder.mkdir(parents=True)
    (folder / 'latency_timer').write_text('16\n')
    assert latency_timer_ms('/dev/ttyUSB7', tmp_path) == 16
    shorten_latency_timer('/dev/ttyUSB7', tmp_path)
    assert latency_timer_ms('/dev/ttyUSB7', tmp_path) == 1
    shorten_latency_timer('/dev/ttyUSB8', tmp_path)
    assert latency_timer_ms('/dev/ttyUSB8', tmp_path) is None


def test_line_errors_count_from_the_opening_on():
    begin = LineErrors(overrun=5, frame=2)
    assert LineErrors(overrun=7, frame=2).since(begin) == LineErrors(overrun=2)
    assert LineErrors().since(begin) == LineErrors()            # another adapter came
    assert LineErrors(overrun=1) + LineErrors(overrun=2, breaks=1) == LineErrors(3, 0, 0, 0, 1)


def test_lost_port_is_set_up_anew_at_its_rate(tmp_path):
    link = str(tmp_path / 'bus')
    collector = Collector(link, 1_000_000)
    for _ in range(2):
        with Pty(link) as cable:
            collector.wait_open()
            assert termios.tcgetattr(cable._slave)[4] == termios.B1000000
        wait(lambda: not collector.listener.state.is_open)
    collector.listener.stop()


def test_what_a_usb_adapter_says_of_itself(tmp_path):
    """As in sysfs: the tty's device is an interface, two levels below the adapter."""
    usb = tmp_path / 'devices/usb1/1-2'
    (usb / '1-2:1.0/ttyUSB7').mkdir(parents=True)
    for name, text in (('idVendor', '0403'), ('product', 'FT232R USB UART'), ('serial', 'A50\n')):
        (usb / name).write_text(text)
    (tmp_path / 'class/tty/ttyUSB7').mkdir(parents=True)
    (tmp_path / 'class/tty/ttyUSB7/device').symlink_to(usb / '1-2:1.0/ttyUSB7')
    assert adapter('/dev/ttyUSB7', tmp_path) == [
        ('Adapter', 'FT232R USB UART'), ('Adapter Serial Number', 'A50')]
    (usb / 'serial').unlink()
    assert adapter('/dev/ttyUSB7', tmp_path) == [('Adapter', 'FT232R USB UART')]
    assert adapter('/dev/ttyAMA0', tmp_path) == []
