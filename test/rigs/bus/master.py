# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a program on the bus is made of: it says a packet, waits for answers, and goes on.

Programs are generators of steps (masters.py); here they are run against the wire. How long they
wait and when they give up follows DynamixelSDK (packet and port handlers): bytes expected, two
latency timers of 16 ms and 2 ms more; the first good status of the wanted ID ends the wait, a
status that fails its CRC ends it as well.
"""

from functools import partial
from typing import NamedTuple

from rigs.bus import frames
from rigs.bus.wire import S

MS = 1_000_000
SDK_WAIT_MS = 34.0                 # 2 x LATENCY_TIMER + 2 (DynamixelSDK, port_handler)


class Say(NamedTuple):
    """Put these bytes into the output buffer; the program goes on at once."""

    data: bytes


class Sleep(NamedTuple):
    """Do nothing until this time."""

    until: int


class Listen(NamedTuple):
    """Go on when more bytes came in, or at this time."""

    until: int


class Port:
    """
    One program's serial port: an output queue, an input buffer, an adapter.

    latency_ms: of the adapter: what comes in is handed over so long after its first byte.
    """

    def __init__(self, wire, random, *, name, latency_ms=0.2, wait_ms=SDK_WAIT_MS,
                 form=frames.FORM):
        self.wire = wire
        self.clock = wire.clock
        self.random = random
        self.latency_ms = latency_ms
        self.name = name
        self.wait_ms = wait_ms
        self.form = form
        self.is_stopped = False
        self.slow_ms = lambda: 0.0      # its computer is busy, each time
        self.input = bytearray()
        self._sent = 0                 # when the output queue is empty
        self._held = bytearray()
        self._program = None
        self._epoch = 0                # number of the wait that is under way
        self._is_listening = False
        wire.listeners.append(self._hear)

    @property
    def now(self):
        return self.clock.now

    def run(self, program, at=0):
        self._program = program
        self.clock.at(at, self._go)

    def stop(self):
        """End the program between two steps, as a killed process."""
        self.is_stopped = True

    def _go(self):
        while self._program is not None and not self.is_stopped:
            step = next(self._program, None)
            if step is None:
                return
            if isinstance(step, Say):
                self._say(step.data)
                continue
            self._epoch += 1
            self._is_listening = isinstance(step, Listen)
            late = round(self.slow_ms() * MS)
            self.clock.at(step.until + late, partial(self._wake, self._epoch))
            return

    def _wake(self, epoch):
        if epoch == self._epoch:
            self._go()

    def _say(self, data):
        start = max(self.now, self._sent)
        self._sent = start + round(len(data) * self.wire.byte_ns)
        self.clock.at(start, lambda: self._talk(data))

    def _talk(self, data):
        if not self.is_stopped:
            self.wire.talk(self.name, data)

    def _hear(self, heard):
        if all(talk.who == self.name for talk in heard.talks):
            return                     # the adapter does not listen while it talks
        if not self._held:
            self.clock.at(self.now + round(self.latency_ms * MS), self._deliver)
        self._held += heard.data

    def _deliver(self):
        self.input += self._held
        self._held.clear()
        if self._is_listening:
            self._epoch += 1
            self._go()

    # --- what programs are made of -----------------------------------------------------------

    def clear(self):
        """Drop what came in, as each txPacket() does."""
        self.input.clear()

    def patience(self, size):
        """Return until when an answer of so many bytes is waited for."""
        return self.now + round(size * self.wire.byte_ns) + round(self.wait_ms * MS)

    def receive(self, wanted, until):
        """Return the next status of this ID, None for a time-out or a damaged one."""
        while True:
            start = self.input.find(self.form.start)
            if start >= 0 and len(self.input) >= start + self.form.smallest:
                size = self.form.size(self.input[start:])
                if not size:
                    del self.input[:start + 1]
                    continue
                if len(self.input) >= start + size:
                    raw = bytes(self.input[start:start + size])
                    del self.input[:start + size]
                    found = self.form.parse(raw)
                    if not found or found[0].id == wanted:
                        return found[0] if found else None
                    continue
            if self.now >= until:
                return None
            yield Listen(until)

    def ask(self, packet, wanted, size=0):
        """Say an instruction to one device and return its status (txRxPacket)."""
        self.clear()
        yield Say(packet)
        return (yield from self.receive(wanted, self.patience(size + self.form.smallest)))

    def ask_all(self, packet, ids, size):
        """Say a group read; return the answers up to the first that does not come."""
        wanted = list(ids)
        self.clear()
        yield Say(packet)
        until = self.patience((size + self.form.smallest) * len(wanted))
        found = {}
        for number in wanted:
            answer = yield from self.receive(number, until)
            if answer is None:
                break
            found[number] = answer
        return found

    def ask_fast(self, packet, ids, size):
        """Say a fast group read; return whether the combined status came whole."""
        wanted = list(ids)
        self.clear()
        yield Say(packet)
        until = self.patience(8 + (size + 4) * len(wanted))
        return (yield from self.receive(frames.EVERYBODY, until)) is not None

    def ping(self, number):
        return self.ask(self.form.whole(number, frames.PING, b''), number, self.form.ping_size)

    def read(self, number, at, size):
        return self.ask(self.form.read(number, at, size), number, size)

    def write(self, number, at, data):
        return self.ask(self.form.write(number, at, data), number)

    def sync_read(self, ids, at, size):
        return self.ask_all(self.form.sync_read(ids, at, size), ids, size)

    def turns(self, rate):
        """Return the sleeps to the next turns of a loop that begins now; it drops late ones."""
        return self._turns(self.now, round(1000 / rate * MS))

    def _turns(self, due, period):
        while True:
            due += period
            while due < self.now:
                due += period
            yield Sleep(due)

    def seconds(self):
        return self.now / S
