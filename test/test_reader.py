# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The process that reads for a listener: complete, ended with the node, replaced, done without."""

import os
from pathlib import Path
import random
import resource
import select
import signal
import subprocess
import sys
import threading
import time

from harness import wait
import pytest
from test_listener import Collector

from rigs.harness import is_alive
from servobus.port.pty import Pty
from servobus.sources import reader
from servobus.sources import reader_process
from servobus.sources.listener import Listener

pytestmark = pytest.mark.realtime(bears=0.01)

MS = 1_000_000


@pytest.fixture
def cable():
    with Pty() as pty:
        yield pty


@pytest.fixture
def collector(cable):
    collector = Collector(cable.path)
    wait(lambda: collector.listener.reader_pid)
    yield collector
    if collector.listener.state.kind != 'stopped':
        collector.listener.stop()


def send(cable, data):
    """Write all of it; a pty takes 17 KiB at a time."""
    while data:
        select.select([], [cable.master], [])
        data = data[os.write(cable.master, data):]


def pid_of(collector):
    wait(lambda: collector.listener.reader_pid)
    return collector.listener.reader_pid


@pytest.mark.parametrize('in_thread', [False, True], ids=['process', 'thread'])
def test_equal_bytes_in_equal_order(cable, in_thread):
    chunks = []
    listener = Listener(cable.path, 2_000_000, chunks.extend,
                        in_thread=in_thread)
    listener.start()
    wait(lambda: listener.state.is_open)
    sent = random.Random(4).randbytes(300_000)
    send(cable, sent)
    wait(lambda: listener.bytes == len(sent))
    listener.stop()
    assert b''.join(chunk.data for chunk in chunks) == sent
    stamps = [chunk.stamp for chunk in chunks]
    assert stamps == sorted(stamps)
    assert stamps[-1] <= time.monotonic_ns()
    assert listener.reads == len(chunks)
    assert listener.openings == 1


def test_only_the_process_reads_and_nobody_can_write(cable, collector):
    pid = pid_of(collector)
    wait(lambda: 'dxl_reader' in Path(f'/proc/{pid}/comm').read_text())
    name, fds = f'/proc/{pid}/comm', Path(f'/proc/{pid}/fd')    # still open while it is written
    wait(lambda: name not in map(os.path.realpath, fds.iterdir()))
    flags = {}
    for entry in fds.iterdir():
        info = Path(f'/proc/{pid}/fdinfo/{entry.name}').read_text()
        flags[int(entry.name)] = (os.readlink(entry), int(info.split('flags:')[1].split()[0], 8))
    ports = [flag for path, flag in flags.values() if path == cable.path]
    assert [flag & os.O_ACCMODE for flag in ports] == [os.O_RDONLY]
    assert {path.partition(':')[0] for path, _ in flags.values()} == {
        cable.path, 'pipe', os.devnull}, 'it holds what is none of its business'


def test_ends_at_once_with_its_listener(cable, collector):
    pid = pid_of(collector)
    collector.listener.stop()
    assert not is_alive(pid)
    assert not [one for one in threading.enumerate() if one.name.startswith('listener')]


def test_ends_when_nobody_takes_what_it_says(cable):
    """A reader that waits for room in its pipe must not outlive the listener, nor hold it up."""
    entered, leave = threading.Event(), threading.Event()
    listener = Listener(cable.path, 2_000_000, lambda *_: entered.set() or leave.wait(20.0))
    listener.start()
    wait(lambda: listener.reader_pid)
    pid = listener.reader_pid or 0
    send(cable, bytes(10))
    assert entered.wait(20.0)
    while select.select([], [cable.master], [], 0.5)[1]:        # until pipe and pty are full
        os.write(cable.master, bytes(4096))
    leave.set()
    listener.stop()
    assert not is_alive(pid)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_leaves_endings_to_the_node(cable, collector, number):
    pid = pid_of(collector)
    send(cable, b'ready')
    wait(lambda: collector.data)
    os.kill(pid, number)
    send(cable, b' still')
    wait(lambda: collector.data == b'ready still')
    assert collector.listener.reader_pid == pid


def test_a_killed_one_is_replaced_and_nothing_lost(cable, collector):
    sent = b''
    for round_ in range(3):
        sent += bytes([round_]) * 500
        send(cable, sent[-500:])
        _wait_for_bytes(collector, len(sent))
        _kill_reader(collector)
        assert 'the reader process ended with signal 9' in collector.listener.state.text
        assert collector.listener.state.is_open
    assert collector.data == sent
    assert collector.listener.openings == 1


def _wait_for_bytes(collector, count):
    wait(lambda: len(collector.data) == count)


def _kill_reader(collector):
    pid = pid_of(collector)
    os.kill(pid, signal.SIGKILL)
    wait(lambda: collector.listener.reader_pid not in (pid, None))


def test_none_is_left_when_the_node_is_killed(cable):
    program = ('import sys, time; from servobus.sources.listener import Listener\n'
               f'listener = Listener({cable.path!r}, 2000000, lambda *_: None); listener.start()\n'
               'while not listener.reader_pid: time.sleep(0.01)\n'
               'print(listener.reader_pid, flush=True); time.sleep(100)')
    with subprocess.Popen([sys.executable, '-c', program], text=True, stdout=subprocess.PIPE,
                          cwd=Path(__file__).parents[1]) as node:
        pid = int(node.stdout.readline())
        assert is_alive(pid)
        node.kill()
    wait(lambda: not is_alive(pid))


@pytest.mark.parametrize(('program', 'reason'), [
    ('/does/not/exist', 'No such file or directory'), ('/bin/false', 'it ends at once')])
def test_without_a_process_the_thread_reads_and_says_so(cable, monkeypatch, program, reason):
    monkeypatch.setattr(reader_process.sys, 'executable', program)
    collector = Collector(cable.path)
    wait(lambda: 'so the node reads it' in collector.listener.state.text)
    assert reason in collector.listener.state.text
    assert collector.listener.state.is_open
    send(cable, b'heard')
    wait(lambda: collector.data == b'heard')
    assert collector.listener.reader_pid is None
    collector.listener.stop()


def test_few_descriptors_are_no_end_and_none_is_lost(cable):
    """Without enough descriptors it listens, or says why it does not."""
    before = len(os.listdir('/proc/self/fd'))
    found = {_state_with_descriptors(cable, spare) for spare in range(18)}
    assert found == {'closed', 'thread', 'process'}
    assert len(os.listdir('/proc/self/fd')) == before


def _state_with_descriptors(cable, spare):
    """Return how a listener gets on that can open so many more descriptors."""
    listener = Listener(cable.path, 2_000_000, lambda chunks: None)

    def state():
        if listener.reader_pid:
            return 'process'
        if listener.state.is_open:
            return 'thread' if 'so the node reads it' in listener.state.text else ''
        return '' if listener.state.kind == 'starting' else 'closed'

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = set(map(int, os.listdir('/proc/self/fd')))      # earlier tests may have left some
    free = [number for number in range(len(used) + spare + 1) if number not in used]
    resource.setrlimit(resource.RLIMIT_NOFILE, (free[spare], hard))
    try:
        listener.start()
        wait(state)
        return state()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        listener.stop()


class Line:
    """A line on a clock of its own: a script of (time to wait in ns, bytes)."""

    def __init__(self, monkeypatch, script):
        self.now = 0
        self.due = 0
        self.waits = 0
        self.script = script
        self.heard = []
        self.idle = []
        monkeypatch.setattr(reader, 'time', self)
        self.due = script[0][0]

    def monotonic_ns(self):
        return self.now

    def sleep(self, seconds):
        self.now += round(seconds * 1e9)

    def wait(self, seconds):
        self.waits += 1
        end = self.now + round(seconds * 1e9)
        is_ready = bool(self.script) and self.due <= end
        self.now = max(self.now, self.due) if is_ready else end
        return is_ready

    def read(self):
        data = b''
        while self.script and self.due <= self.now:
            data += self.script.pop(0)[1]
            self.due += self.script[0][0] if self.script else 0
        return data

    def run(self, byte_ns=0.0):
        loop = reader.Loop(self.wait, self.read, lambda *chunk: self.heard.append(chunk),
                           self.idle.append, idle_s=0.02, byte_ns=byte_ns)
        loop.run(lambda: not self.script and bool(self.idle))
        return loop


def test_a_busy_line_is_let_gather_and_a_pause_ends_that(monkeypatch):
    line = Line(monkeypatch, [(50 * MS, b'a'), (5 * MS, b'b'), (MS, b'c'), (MS // 2, b'd')])
    loop = line.run()
    assert line.heard == [(b'a', 50 * MS), (b'b', 55 * MS), (b'cd', 57 * MS)]
    assert line.idle == [77 * MS]
    assert loop.largest_gap == 0                # it never came late


def test_a_line_without_pauses_is_let_gather_for_longer(monkeypatch):
    full = [(MS, b'f' * 100)] * 20              # 1 MBd: 100 bytes take 1 ms
    line = Line(monkeypatch, [(50 * MS, b'a'), *full, (2 * MS, b'b'), (5 * MS, b'c')])
    line.run(10_000)
    sizes = [len(chunk) for chunk, _ in line.heard]
    assert sizes[:4] == [1, 200, 200, 400]      # what gathered for 1 ms beside a wait, 2 and 4 ms
    assert set(sizes[4:-3]) == {400}
    assert line.waits == 4                      # for a and its follower, in the pause, at the end
    assert line.heard[-2:] == [(b'b', 74 * MS), (b'c', 77 * MS)]    # a pause: for 1 ms again


def test_the_largest_gap_counts_only_while_bytes_waited(monkeypatch):
    line = Line(monkeypatch, [(50 * MS, b'a'), (MS, b'b'), (MS, b'c')])
    line.heard = Late(line)
    assert line.run().largest_gap == 8 * MS


def test_how_long_nothing_came_is_said_again_and_again(monkeypatch):
    line = Line(monkeypatch, [(50 * MS, b'a'), (700 * MS, b'b')])
    line.run()
    assert line.idle == [70 * MS, 320 * MS, 570 * MS]


def test_after_a_freeze_it_says_no_more_than_it_knows(monkeypatch):
    """Stopped behind a wait in vain: what came since is unknown."""
    line = Line(monkeypatch, [(50 * MS, b'a'), (1000 * MS, b'b')])
    wait = line.wait

    def and_freeze(seconds):
        is_ready = wait(seconds)
        line.now += 0 if is_ready else 5000 * MS
        return is_ready
    monkeypatch.setattr(line, 'wait', and_freeze)
    line.run()
    assert line.idle == [70 * MS]
    assert line.heard[-1] == (b'b', 5070 * MS)


class Late(list):
    """A caller that takes 8 ms for its first chunk."""

    def __init__(self, line):
        super().__init__()
        self.line = line

    def append(self, chunk):
        if not self:
            self.line.now += 8 * MS
        super().append(chunk)
