# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the soak hears of the nodes, and how long the machine held them up.

A status counts from the moment that its node stamped it (ns since the epoch), not from when it
was last looked at. What takes too long is judged by the time in which the machine ran us.
"""

from contextlib import suppress
from functools import partial
from pathlib import Path
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy

from rigs.harness import family

S = 1_000_000_000
BRIDGE, MONITOR = NODES = ('vel2d_bridge', 'dxl_monitor')
IDS = range(1, 9)
TABLES = 'dxl/diagnostics'
# What must be heard of all the time: (topic, name of a status, or of a node: any status of it).
WANTED = [
    *(('/diagnostics', f'{BRIDGE}: {what}') for what in ('link', 'commands')),
    ('vel2d/timing', BRIDGE), ('dxl/timing', MONITOR),
    *((topic, f'{MONITOR}: {what}') for topic in ('/diagnostics', TABLES)
      for what in ('bus', *(f'{number:03}' for number in IDS)))]
TICK_S, LATE_TICK_S = 0.02, 0.02
PATIENCE = 3                    # times as long, at most, for a machine that stands still


class Machine:
    """Measures for how long the machine ran neither us nor the nodes, though they were ready."""

    def __init__(self, pids):
        self._pids = pids
        self._late_s = 0.0
        self._ticked_s = time.monotonic()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='machine', daemon=True)
        self._thread.start()

    def stop(self):
        self._done.set()
        self._thread.join()

    def held_s(self):
        """Return the sum since the start: differences count."""
        return self._late_s + self._overdue_s() + sum(map(_waited_s, self._pids))

    def is_over(self, begin_s, seconds, held_s):
        """Return whether `seconds` since begin_s are over, as the machine ran us."""
        passed_s = time.monotonic() - begin_s       # first: what follows reads a hundred files
        return passed_s > seconds and passed_s > self._patience_s(seconds, held_s)

    def wait_until(self, condition, seconds):
        """Wait for a condition; return whether it came true in time."""
        held_s, begin_s = self.held_s(), time.monotonic()
        while not condition():
            if self.is_over(begin_s, seconds, held_s):
                return False
            time.sleep(0.05)
        return True

    def _patience_s(self, seconds, held_s):
        """Return what `seconds` come to if held_s() was `held_s` when they began."""
        return seconds + min(max(0.0, self.held_s() - held_s), (PATIENCE - 1) * seconds)

    def _run(self):
        while not self._done.wait(TICK_S):
            self._late_s += self._overdue_s()
            self._ticked_s = time.monotonic()

    def _overdue_s(self):
        late_s = time.monotonic() - self._ticked_s - TICK_S
        return late_s if late_s > LATE_TICK_S else 0.0


def _waited_s(pid):
    """Return for how long the threads of a process and its children have waited for a CPU."""
    waited = 0
    for one in family(pid):
        with suppress(OSError):                     # it has ended
            for task in Path(f'/proc/{one}/task').iterdir():
                waited += int((task / 'schedstat').read_text().split()[1])
    return waited / S


class Watch:
    """Hears the statuses of both nodes, in a thread of its own."""

    def __init__(self):
        self.unaccounted = 0                        # bytes, most of all reports
        self._stamps = {}
        self._complaints = {}       # '' while it is OK
        self.node = rclpy.create_node('bench_soak')
        for topic in sorted({topic for topic, _ in WANTED}):
            self.node.create_subscription(
                DiagnosticArray, topic, partial(self.accept_statuses, topic), 100)
        self._is_stopping = False
        self._thread = threading.Thread(target=self._spin, name='watch')
        self._thread.start()

    def stop(self):
        self._is_stopping = True
        self._thread.join()

    def accept_statuses(self, topic, array):
        stamp = array.header.stamp.sec * S + array.header.stamp.nanosec
        for status in array.status:
            values = {pair.key: pair.value for pair in status.values}
            self._complaints[topic, status.name] = status.message if status.level[0] else ''
            if values.get('State') not in ('disconnected', 'silent'):
                self._stamps[topic, status.name] = stamp
            self._stamps[topic, status.name.partition(':')[0]] = stamp
            if topic == TABLES and 'Noise Bytes' in values:
                parts = sum(int(values[f'{kind} Bytes'])
                            for kind in ('Packet', 'Noise', 'Pending'))
                self.unaccounted = max(self.unaccounted, abs(int(values['Bytes']) - parts))

    def silent(self, since):
        """Return a line for each status that is older, the last of a lost device too."""
        seconds = (time.time_ns() - since) / S
        return [f'{name}: not heard on {topic}, or disconnected, for {seconds:.0f} s at least'
                for topic, name in WANTED if self._stamps.get((topic, name), 0) < since]

    def not_well(self, since):
        """Return what is silent and what is not OK."""
        return self.silent(since) + [f'{name}: {complaint}' for (_, name), complaint
                                     in list(self._complaints.items()) if complaint]

    def _spin(self):
        while not self._is_stopping:
            rclpy.spin_once(self.node, timeout_sec=0.1)
