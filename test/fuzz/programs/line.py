# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A port like pyserial's, its adapter and its wire, in simulated time.

A call takes as long as it would: a read ends with its bytes or its time-out, a sleep when it is
over. So a program is a plain function.
"""
import heapq

MS, S = 1_000_000, 1_000_000_000
CALL_NS = 15_000                   # what a call of Python and the kernel takes


class Clock:
    """The time of a machine; `stutter`: how often a second it stands still, 20 to 500 ms."""

    def __init__(self, chance, stutter=0.0):
        self.now = S
        self._chance, self._stutter = chance, stutter
        self._stop = self._next_stop()

    def _next_stop(self):
        return self.now + int(self._chance.expovariate(self._stutter) * S) \
            if self._stutter else 1 << 62

    def until(self, stamp):
        """Let time pass; the machine may stand still in it."""
        self.now = max(self.now, stamp)
        if self.now >= self._stop:
            self.now += int(self._chance.uniform(0.02, 0.5) * S)
            self._stop = self._next_stop()

    def sleep(self, seconds):
        self.until(self.now + int(seconds * S))

    def monotonic_ns(self):
        return self.now

    def monotonic(self):
        self.until(self.now + CALL_NS)
        return self.now / S

    time = perf_counter = monotonic

    def thread_time_ns(self):
        """Return the CPU time of a program that waits nearly all the time."""
        return self.now // 50


class Wire:
    """
    One data line, half duplex. `devices` answer: [(ns after the end, bytes), ...] to a packet.

    What two send at once is damaged. damage(data): what becomes of an answer on its way.
    """

    def __init__(self, clock, chance, devices, baud, damage=lambda data: data, *, echo=False,
                 latency_ms=1.0):
        self.clock, self.chance, self.devices, self.damage = clock, chance, devices, damage
        self.byte_ns = 10 * S // baud
        self.echo, self.latency_ns = echo, int(latency_ms * MS)
        self.begins = self.quiet = 0           # from when to when answers are on it
        self.sent = 0                         # when the last byte of the program is out
        self._arrivals, self._count, self._last = [], 0, 0

    def send(self, data):
        begin = max(self.clock.now, self.sent)
        self.sent = end = begin + len(data) * self.byte_ns
        if self.echo:
            self._arrive(end, data)
        if begin < self.quiet and end > self.begins:       # into an answer: the servos hear mud
            self._arrivals = [(when, at, self._mud(one) if when > begin else one)
                              for when, at, one in self._arrivals]
            return
        self.talk(data, end)

    def talk(self, data, end):
        """Let the devices answer to a packet whose last byte was there at `end`."""
        self.begins = free = 0
        for delay, answer in sorted(self.devices(data, end), key=lambda one: one[0]):
            begin = end + delay
            self.begins = self.begins or begin
            answer = self._mud(answer) if begin < free else self.damage(answer)
            free = max(free, begin + len(answer) * self.byte_ns)
            self._arrive(free, answer)
        self.quiet = free

    def _mud(self, data):
        """Return what is heard of bytes that another sender pulls low here and there."""
        return bytes(one & self.chance.randrange(256) for one in data)

    def _arrive(self, end, data):
        """Hand bytes over as an adapter does: in order, before its latency timer is over."""
        self._count += 1
        late = self.chance.randint(0, self.latency_ns)
        self._last = max(self._last, end + late)       # at once with what was on the line before
        heapq.heappush(self._arrivals, (self._last, self._count, data))

    def arrived(self, until):
        """Return the bytes that are there at a time."""
        found = b''
        while self._arrivals and self._arrivals[0][0] <= until:
            found += heapq.heappop(self._arrivals)[2]
        return found

    def next_arrival(self):
        return self._arrivals[0][0] if self._arrivals else 1 << 62


class Port:
    """What a program has of pyserial's Serial."""

    def __init__(self, clock, wire, baud):
        self.clock, self.wire, self.baudrate, self.port = clock, wire, baud, '/dev/ttyUSB0'
        self._timeout, self._inbox, self.is_open = 0.1, bytearray(), True

    @property
    def timeout(self):
        return self._timeout

    @timeout.setter
    def timeout(self, seconds):
        self._timeout = seconds

    @property
    def in_waiting(self):
        self.clock.until(self.clock.now + CALL_NS)
        self._inbox += self.wire.arrived(self.clock.now)
        return len(self._inbox)

    def read(self, size=1):
        end = self.clock.now + int((self._timeout or 0) * S)
        self._inbox += self.wire.arrived(self.clock.now)
        while len(self._inbox) < size and self.wire.next_arrival() <= end:
            self.clock.until(self.wire.next_arrival())
            self._inbox += self.wire.arrived(self.clock.now)
        self.clock.until(end if len(self._inbox) < size else self.clock.now + CALL_NS)
        data = bytes(self._inbox[:size])
        del self._inbox[:size]
        return data

    def write(self, data):
        self.clock.until(self.clock.now + CALL_NS)
        self.wire.send(bytes(data))
        return len(data)

    def flush(self):
        self.clock.until(self.wire.sent)

    def reset_input_buffer(self):
        del self._inbox[:self.in_waiting]

    def fileno(self):
        return 3
