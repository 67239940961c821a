# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The dead man in simulated time, through each row of the table in vel2d_bridge/deadman_process.py.

Its code runs as it is, with a real board, channel, queue and pty; only the clock is ours.
"""
import os
import re
import signal
import socket

import pytest

from msg_defs.vel2d import encode
from msg_defs.vel2d import STOP
from servobus.port.pty import Pty
from vel2d_bridge import deadman_process as watching
from vel2d_bridge import lost_port
from vel2d_bridge.claim import PortClaim
from vel2d_bridge.deadman_process import SEARCH_S
from vel2d_bridge.deadman_process import SILENCE
from vel2d_bridge.deadman_process import STOP_FRAMES
from vel2d_bridge.deadman_process import STOP_PERIOD_S
from vel2d_bridge.deadman_process import Watch
from vel2d_bridge.shared_memory import AWAY
from vel2d_bridge.shared_memory import BEATEN
from vel2d_bridge.shared_memory import GOODBYE
from vel2d_bridge.shared_memory import HELD
from vel2d_bridge.shared_memory import OWED
from vel2d_bridge.shared_memory import PortRecord
from vel2d_bridge.shared_memory import SharedBoard

TABLE = [tuple(cell.strip() for cell in row.split('|'))
         for row in re.findall(r'^\| (?!state \|)(.*) \|$', watching.__doc__, re.MULTILINE)]
OPENS, LOSES, DIES = ('the bridge opens the port', 'the bridge loses the port while it drives',
                      'the bridge dies')
SILENT, BEATS, FOUND = 'no beat for SILENCE', 'a beat', 'the port is there'
WAY = {                                 # the events that lead from idle to a state
    'idle': [], 'guarding': [OPENS], 'waiting': [OPENS, LOSES], 'stopping': [OPENS, SILENT],
    'searching': [OPENS, LOSES, SILENT], 'last stops': [OPENS, DIES],
    'last search': [OPENS, LOSES, DIES]}
ZERO = encode(STOP)
MARK = b'\xff'                          # written to the port after what the dead man writes


class OutOfEvents(Exception):
    """The script has ended and the dead man has not."""


class Rehearsal:
    """
    A dead man on a pty, whose waits bring one event of a script after the other.

    seen: (state, what it did since the event) after each event; zeros: all that it wrote.
    """

    def __init__(self, folder, script):
        self.now_s = 1000.0
        self.seen = []
        self.zeros = 0
        self._script = iter(script)
        self._waits = 0                 # still to pass before the next event
        self._is_silent = False
        self._link = str(folder / 'mcu')
        self._pty = None
        self.plug_in()
        self._claim, self._stranger = PortClaim(), PortClaim()
        self._channel, its_channel = socket.socketpair()
        self._queue, its_queue = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        its_queue.setblocking(False)
        self.watch = Watch(SharedBoard(), its_channel, its_queue)
        self._number = 0
        self._fd = -1                   # its port when the event came
        self._beat()

    def run(self):
        """Run the dead man to its end, or that of the script."""
        try:
            self.watch.run(lambda: None)
            self._see('over')
        except OutOfEvents:
            pass
        finally:
            self._stranger.drop()
            if self._pty is not None:
                self.unplug()

    # In place of the modules time and readable.

    def monotonic(self):
        return self.now_s

    def monotonic_ns(self):
        return round(1e9 * self.now_s)

    def sleep(self, seconds):
        self.now_s += seconds
        if seconds == STOP_PERIOD_S:    # and not for an idle line
            self._wake()

    def readable(self, fds, seconds):
        self.now_s += seconds
        self._wake()
        return watching_readable(fds, 0)

    # The script.

    def _wake(self):
        if not self._is_silent:
            self._beat()
        if self._waits:
            self._waits -= 1
            return
        self._see(self._state())
        event = next(self._script, None)
        if event is None:
            raise OutOfEvents
        self._fd = self.watch._fd
        self._read_zeros()
        self._waits = STOP_FRAMES if event == 'STOP_FRAMES zeros' else 0
        EVENTS[event](self)

    def _see(self, state):
        action = 'writes a zero' if self._read_zeros() else ''
        if self._fd >= 0 and not is_port(self._fd):
            action = 'closes the port'
        self.seen.append((state, action))

    def _state(self):
        watch = self.watch
        has_port = watch._fd >= 0
        if watch._is_dead:
            return 'last stops' if has_port else 'last search' if watch._is_on_duty else 'over'
        if not watch._is_on_duty:
            return 'idle'
        if self.monotonic_ns() - watch.board.words[BEATEN] < SILENCE:
            return 'guarding' if has_port else 'waiting'
        return 'stopping' if has_port else 'searching'

    def _read_zeros(self):
        if self._pty is None:
            return 0
        os.write(self._end, MARK)       # comes after them, however late the kernel is
        data = b''
        while not data.endswith(MARK):
            watching_readable([self._pty.master], 1.0)
            data += os.read(self._pty.master, 4096)
        data = data.removesuffix(MARK)
        count = len(data) // len(ZERO)
        assert data == ZERO * count
        self.zeros += count
        return count

    def _beat(self):
        self.watch.board.words[BEATEN] = self.monotonic_ns()

    # What may happen.

    def _record(self, what, **changes):
        self._number += 1
        self.watch.board.write(PortRecord(
            self._number, what, ZERO, 115200, self._link, claim=self._claim.token, **changes))
        self._channel.send(b'!')

    def open_port(self):
        self.plug_in()
        slave = os.open(self._link, os.O_RDWR | os.O_NOCTTY)
        socket.send_fds(self._queue, [(self._number + 1).to_bytes(watching.NUMBER, 'little')],
                        [slave])
        self._record(HELD, settings=lost_port.settings(slave))
        os.close(slave)

    def close_port(self):
        self._record(AWAY)

    def lose_port(self):
        self.unplug()
        self._record(OWED)

    def leave(self):
        self._record(GOODBYE)

    def die(self):
        self._channel.close()

    def fall_silent(self):
        self._is_silent = True
        self.now_s += SILENCE / 1e9

    def beat_again(self):
        self._is_silent = False
        self._beat()

    def plug_in(self):
        if self._pty is None:
            self._pty = Pty(self._link)
            self._end = os.open(self._pty.path, os.O_WRONLY | os.O_NOCTTY)

    def unplug(self):
        os.close(self._end)
        self._pty.close()
        self._pty = None

    def plug_in_claimed(self):
        self.plug_in()
        with open(self._link, 'rb', buffering=0) as port:
            self._stranger.claim_port(port.fileno(), self._link)

    def pass_time(self):
        self.now_s += SEARCH_S


EVENTS = {
    OPENS: Rehearsal.open_port, LOSES: Rehearsal.lose_port, DIES: Rehearsal.die,
    SILENT: Rehearsal.fall_silent, BEATS: Rehearsal.beat_again, FOUND: Rehearsal.plug_in,
    'the bridge closes the port': Rehearsal.close_port,
    'the bridge gives up the port': Rehearsal.close_port,
    'the bridge leaves': Rehearsal.leave,
    'the port fails': Rehearsal.unplug,
    'another bridge has the port': Rehearsal.plug_in_claimed,
    'STOP_FRAMES zeros': lambda rehearsal: None,
    'SEARCH_S': Rehearsal.pass_time}
watching_readable = watching.readable


def is_port(fd):
    """Tell whether a descriptor is open, and a terminal."""
    try:
        return os.readlink(f'/proc/self/fd/{fd}').startswith('/dev/pts/')
    except OSError:
        return False


@pytest.fixture
def rehearse(monkeypatch, tmp_path):
    """Return a function that runs a dead man through a script and returns the rehearsal."""
    sigterm = signal.getsignal(signal.SIGTERM)

    def run(script):
        rehearsal = Rehearsal(tmp_path, script)
        monkeypatch.setattr(watching, 'time', rehearsal)
        monkeypatch.setattr(watching, 'readable', rehearsal.readable)
        rehearsal.run()
        return rehearsal
    yield run
    signal.signal(signal.SIGTERM, sigterm)


@pytest.mark.parametrize(('state', 'event', 'next_state', 'action'), TABLE)
def test_the_code_does_what_the_table_says(rehearse, state, event, next_state, action):
    seen = rehearse([*WAY[state], event]).seen
    assert seen[len(WAY[state])][0] == state
    assert seen[len(WAY[state]) + 1] == (next_state, action)


def test_a_port_that_it_found_is_closed_when_the_bridge_beats_again(rehearse):
    seen = rehearse([OPENS, LOSES, SILENT, FOUND, BEATS]).seen
    assert seen[-2:] == [('stopping', 'writes a zero'), ('waiting', 'closes the port')]


def test_after_its_death_a_whole_burst_is_sent_and_the_port_is_free(rehearse):
    rehearsal = rehearse([OPENS, DIES, 'STOP_FRAMES zeros'])
    assert rehearsal.seen[-1] == ('over', 'closes the port')
    assert rehearsal.zeros == STOP_FRAMES


def test_the_table_has_each_state_and_each_event():
    assert {row[0] for row in TABLE} == {*WAY}
    assert {row[1] for row in TABLE} == {*EVENTS}
