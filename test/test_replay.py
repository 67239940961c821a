# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A run that was captured and is replayed leads to what it led to live."""
import io
import os
import random
import signal
import stat

from harness import Program
from harness import wait
import pytest

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.event import Chunk
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.sources.listener import Listener
from servobus.sources.packet_file import PacketWriter

pytestmark = pytest.mark.realtime(bears=0.01)

REPLAY = 'servobus.tools.replay'
MODELS = Models()
SECOND = 1_000_000_000
BAUD = 1_000_000
WIRE = Wire('bus', BAUD)


def run(*faults, seconds=4, seed=1):
    """Return what a tap would hear of a simulated run: chunks of any size, and stamps."""
    line = Line(make_devices(['1-4:MX-64', '5:XL430-W250', '6:BitFoot'], MODELS, BAUD), BAUD)
    master = Master(line, PATTERNS['mixed'], rate=50, faults=[parse(text) for text in faults])
    rng = random.Random(seed)
    chunks, waiting, end = [], b'', 0
    for burst in master.bursts(int(seconds * SECOND)):
        if waiting and burst.start - end > SECOND // 500:      # no master waits for so long
            chunks.append((waiting, SECOND + end))
            waiting = b''
        waiting += burst.data
        end = burst.end
        if rng.random() < 0.6:
            cut = rng.randrange(len(waiting)) if rng.random() < 0.3 else len(waiting)
            if cut:
                chunks.append((waiting[:cut], SECOND + burst.end))
                waiting = waiting[cut:]
    return [*chunks, (waiting, SECOND + burst.end)] if waiting else chunks


def listen(chunks, models=MODELS):
    monitor = Monitor('bus', models, Settings(baud=BAUD), clock=lambda: 0)
    stamp = 0
    for data, stamp in chunks:
        monitor.feed(data, stamp)
    return monitor.report(stamp + 2 * SECOND)


def capture(chunks):
    file = io.BytesIO()
    writer = Writer(file, ClockReading(1_790_000_000 * SECOND, SECOND))
    for data, stamp in chunks:
        writer.write_chunk(WIRE, Chunk(stamp, WIRE.name, data))
    return file.getvalue()


@pytest.mark.parametrize('faults', [
    (), ('silent:3:1:1', 'flip:2:2:1'), ('latched:4:1:2', 'wrong_map:2:1:1'),
    ('reboot:1:2:1', 'glitch:3:0:3', 'header:5:1:1'),
], ids=lambda faults: '+'.join(faults) or 'none')
def test_a_captured_run_replayed_gives_the_same_report(faults):
    chunks = run(*faults)
    live = listen(chunks)
    again = listen((chunk.data, chunk.stamp) for chunk in Reader(io.BytesIO(capture(chunks))))
    assert again == live
    assert live.counters['Packets'] > 1000
    assert live.incidents or not faults


class Collector:
    """A listener and a monitor on a port, as the node has them."""

    def __init__(self, path):
        self.monitor = Monitor('bus', MODELS, Settings(baud=BAUD))
        self._last = 0
        self.fed = 0                    # bytes; the listener counts them before they are fed
        self.listener = Listener(str(path), BAUD, self._feed, self.monitor.flush_if_idle)

    def _feed(self, chunks):
        self._last = chunks[-1].stamp
        self.monitor.feed_chunks(chunks)
        self.fed += sum(len(one.data) for one in chunks)

    def __enter__(self):
        self.listener.start()
        return self

    def __exit__(self, *_):
        self.listener.stop()

    def report(self, later=2 * SECOND):
        return self.monitor.report(self._last + later)


def test_faster_and_again_and_again(tmp_path):
    chunks = run(seconds=1)
    path, link = tmp_path / 'bus.txt', tmp_path / 'bus'
    path.write_bytes(capture(chunks))
    size = sum(len(data) for data, _ in chunks)
    with Program(REPLAY, str(path), '--link', str(link), '--speed', '0',
                 '--loop') as replay, Collector(link) as collector:
        wait(lambda: collector.listener.bytes > 3 * size)
        assert collector.report(later=0).counters['Noise Bytes'] == 0
        replay.signal(signal.SIGINT)
        assert replay.exit_code() == 0
    assert 'Traceback' not in replay.text


@pytest.mark.parametrize('form', ['capture', 'pcapng'])
def test_every_bus_has_its_pty(tmp_path, form):
    path, link = tmp_path / 'two.txt', tmp_path / 'bus'
    file = io.BytesIO()
    writer = Writer(file, ClockReading(1, 1)) if form == 'capture' else PacketWriter(file)
    for number in range(3):
        for bus, data in (('left', b'\x01'), ('right/arm', b'\x02\x03')):
            if form == 'capture':
                writer.write_chunk(Wire(bus, BAUD), Chunk(10 + number, bus, data))
            else:
                writer.write(Wire(bus, BAUD), 10 + number, data)
    path.write_bytes(file.getvalue())
    with Program(REPLAY, str(path), '--link', str(link), '--stay') as replay:
        replay.wait_for('waiting')
        with Collector(tmp_path / 'bus_left') as left, \
                Collector(tmp_path / 'bus_right%2Farm') as right:
            wait(lambda: left.listener.bytes == 3 and right.listener.bytes == 6)
            replay.wait_for('played 6 chunks, 9 bytes')
        replay.signal(signal.SIGTERM)
        assert replay.exit_code() == 0


def test_raw_bytes_play_at_the_speed_of_the_wire(tmp_path):
    chunks = run(seconds=0.5)
    path, link = tmp_path / 'bus.bin', tmp_path / 'bus'
    path.write_bytes(b''.join(data for data, _ in chunks))
    with Program(REPLAY, str(path), '--link', str(link), '-b', str(BAUD)) as replay:
        replay.wait_for('waiting')
        with Collector(link) as collector:
            replay.wait_for('played')
            wait(lambda: collector.fed == path.stat().st_size)
            assert collector.report().counters['Noise Bytes'] == 0


def test_a_file_in_the_place_of_the_link_stays(tmp_path):
    path, link = tmp_path / 'bus.txt', tmp_path / 'notes'
    path.write_bytes(capture(run(seconds=0.1)))
    link.write_text('keep me')
    with Program(REPLAY, str(path), '--link', str(link)) as replay:
        assert replay.exit_code() == 1
    assert link.read_text() == 'keep me'
    assert stat.S_ISREG(os.lstat(link).st_mode)
