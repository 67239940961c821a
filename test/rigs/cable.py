# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A scripted cable: a pty in the middle between a node under test and its fake device.

The node opens `path`, the cable opens the device's pty, one thread carries the bytes. Faults are
set from outside at any time; `calm` ends them all. Damage is seeded.
"""
from contextlib import contextmanager
from contextlib import suppress
import os
import random
import select
import termios
import threading
import time
import tty
from typing import NamedTuple

from rigs.damage import flip_bit
from rigs.damage import lose_byte
from servobus.port.pty import Pty

TICK_S = 0.002
PAUSE_TURNS = 2
PAUSE_WITHIN_S = 1.0
ARRIVALS_PER_TURN = 8                           # four times what comes: a pty takes 17 KiB
FLOOD_BYTES_PER_S = 200_000
KEPT_BYTES = 2048               # the beginning of a line
NO_FAULT = {'drop': 0.0, 'flip': 0.0, 'delay_s': 0.0}


class Line(NamedTuple):
    """
    A line since it was plugged in, or freed after a stall.

    `until`: when its predecessor ended or stalled, monotonic ns; `written`: what the node wrote
    on it first, before any damage.
    """

    until: int
    written: bytearray


class Cable:
    """
    Carries bytes both ways between `path` and the pty of a device.

    drop, flip: the share of chunks that lose a byte or get a bit turned; delay_s: how late they
    arrive. `stalled`: the node's writes are not taken, and nothing reaches it. `lines` holds one
    for each time that it was plugged in or freed.
    """

    def __init__(self, device, link, seed=1):
        self.path = str(link)
        self.carried = 0
        self.lost = 0                           # bytes that were not taken
        self.delivered = 0                      # bytes that the node's side took
        self.lines = []
        self._device = device                   # path of the device's pty
        self._chance = random.Random(seed)
        self._lock = threading.RLock()
        self._faults = dict(NO_FAULT)
        self._stalled = False
        self._is_holding = False
        self._idle_turns = 0                    # in which nothing came from the device
        self._late = []                         # [due, write, chunk]
        self._flood = None                      # until when, bytes per tick
        self._near = self._far = None
        self._before = None                     # the slave of the pty before, see cut
        self._until = 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='cable')

    def __enter__(self):
        self.reopen()
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        self.cut()
        self._let_go()

    # --- what may be done to it, from any thread ---------------------------------------------

    def damage(self, **faults):
        """Set drop, flip (shares of chunks) or delay_s from now on."""
        with self._lock:
            self._faults.update(faults)

    def stall(self):
        """Take nothing any more, as with flow control that never comes back."""
        with self._lock:
            termios.tcflow(self._near._slave, termios.TCOOFF)
            self._turn()                        # what was taken before arrives
            self._stalled = True
            self._until = time.monotonic_ns()

    def flood(self, seconds):
        """Send noise to the node for a while."""
        with self._lock:
            self._flood = time.monotonic() + seconds, int(FLOOD_BYTES_PER_S * TICK_S)

    def calm(self):
        """End all faults but a cut."""
        with self._lock:
            self._faults = dict(NO_FAULT)
            self._flood = None
            if self._stalled and self._near is not None:
                termios.tcflow(self._near._slave, termios.TCOON)
                self.lines.append(Line(self._until, bytearray()))
            self._stalled = False

    def cut(self):
        """Be unplugged: the node's port hangs up, its name is gone."""
        with self._lock:
            if self._near is not None:
                self._until = time.monotonic_ns()
                self._before = os.dup(self._near._slave)
                self._near.close()
                self._far.close()
            self._near = self._far = None
            self._late.clear()

    def reopen(self, named=True):
        """Be plugged in again, under the same name, as another device; or without the name."""
        with self._lock:
            if self._near is None:
                self._far = _End(self._device)
                self._near = Pty(self.path if named else None)
                self.lines.append(Line(self._until, bytearray()))
            self._let_go()

    def _let_go(self):
        """Give the number of the pty before back: the next one has got another."""
        if self._before is not None:
            os.close(self._before)
        self._before = None

    def remove_name(self):
        """Take the symlink away and leave the line as it is, as udev does when it re-reads."""
        os.unlink(self.path)

    def restore_name(self):
        with self._lock:
            os.symlink(self._near.path, self.path)
            self._near.link = self.path

    @contextmanager
    def while_damaged(self, **faults):
        self.damage(**faults)
        try:
            yield
        finally:
            self.calm()

    @contextmanager
    def held(self):
        """Let nothing arrive meanwhile; what comes is kept, and arrives afterwards, whole."""
        # From a pause of the device on, if there is one soon: else a packet may be cut in two.
        deadline = time.monotonic() + PAUSE_WITHIN_S
        while not self._is_holding:
            with self._lock:
                self._is_holding = self._idle_turns >= PAUSE_TURNS or time.monotonic() > deadline
            time.sleep(TICK_S / 2)
        try:
            yield
        finally:
            self._is_holding = False

    # --- the thread ----------------------------------------------------------------------------

    def _run(self):
        while not self._done.wait(TICK_S):
            with self._lock, suppress(OSError):     # a device that has gone
                if self._near is not None:
                    self._turn()

    def _turn(self):
        near, far = self._near.master, self._far.fd
        if not self._stalled:
            self._carry(near, far)
            self._idle_turns = 0 if self._carry(far, near) else self._idle_turns + 1
        self._deliver()
        if self._flood is not None:
            until, size = self._flood
            self._write(near, self._chance.randbytes(size))
            if time.monotonic() > until:
                self._flood = None

    def _carry(self, source, target):
        if not select.select([source], [], [], 0)[0]:
            return False
        chunk = os.read(source, 4096)
        self.carried += len(chunk)
        if source == self._near.master and len(self.lines[-1].written) < KEPT_BYTES:
            self.lines[-1].written.extend(chunk)
        self._late.append((time.monotonic() + self._faults['delay_s'], target, self._spoil(chunk)))
        return True

    def _spoil(self, chunk):
        chance, faults = self._chance, self._faults
        if chance.random() < faults['drop']:
            chunk = lose_byte(chance, chunk)
        if chunk and chance.random() < faults['flip']:
            chunk = flip_bit(chance, chunk)
        return chunk

    def _deliver(self):
        now = time.monotonic()
        for _ in range(ARRIVALS_PER_TURN):
            if self._is_holding or not self._late or self._late[0][0] > now:
                break
            _, target, chunk = self._late.pop(0)
            self._write(target, chunk)

    def _write(self, fd, data):
        """Write what is taken; the rest is lost, as on a wire."""
        taken = 0
        with suppress(BlockingIOError):
            taken = os.write(fd, data)
        if fd == self._near.master:
            self.delivered += taken
        self.lost += len(data) - taken


class _End:
    """The cable's end in the device's socket."""

    def __init__(self, path):
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd)

    def close(self):
        os.close(self.fd)
