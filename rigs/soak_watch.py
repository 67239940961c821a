# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What the soak hears of the nodes, and how long the machine held them up.

A status counts from the moment that its node stamped it (ns since the epoch), not from when it
was last looked at. What takes too long is judged by the time in which the machine ran us.
"""

from collections.abc import Callable
from collections.abc import Container
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
import threading
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import rclpy

from rigs.harness import family

S = 1_000_000_000
BRIDGE, MONITOR = NODES = ('vel2d_bridge', 'dxl_monitor')
MODULES = ('vel2d_bridge.main', 'dxl_monitor.start')
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
FREEZE_BEFORE_S = 3.0           # a freeze is followed by new subscriptions,
FREEZE_AFTER_S = 3.0            # and told with the next status


class Machine:
    """Measures for how long the machine ran neither us nor the nodes, though they were ready."""

    def __init__(self, pids: Sequence[int]) -> None:
        self._pids = pids
        self._late_s = 0.0
        self._ticked_s = time.monotonic()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name='machine', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        self._thread.join()

    def held_s(self) -> float:
        """Return the sum since the start: differences count."""
        return self._late_s + self._overdue_s() + sum(map(_waited_s, self._pids))

    def patience_s(self, seconds: float, held_s: float) -> float:
        """Return what `seconds` come to if held_s() was `held_s` when they began."""
        return seconds + min(max(0.0, self.held_s() - held_s), (PATIENCE - 1) * seconds)

    def is_over(self, begin_s: float, seconds: float, held_s: float) -> bool:
        """Return whether `seconds` since begin_s are over, as the machine ran us."""
        passed_s = time.monotonic() - begin_s       # first: what follows reads a hundred files
        return passed_s > seconds and passed_s > self.patience_s(seconds, held_s)

    def waited(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for a condition; return whether it came true in time."""
        held_s, begin_s = self.held_s(), time.monotonic()
        while not condition():
            if self.is_over(begin_s, seconds, held_s):
                return False
            time.sleep(0.05)
        return True

    def _run(self) -> None:
        while not self._done.wait(TICK_S):
            self._late_s += self._overdue_s()
            self._ticked_s = time.monotonic()

    def _overdue_s(self) -> float:
        late_s = time.monotonic() - self._ticked_s - TICK_S
        return late_s if late_s > LATE_TICK_S else 0.0


def _waited_s(pid: int) -> float:
    """Return for how long the threads of a process and its children have waited for a CPU."""
    waited = 0
    for one in family(pid):
        with suppress(OSError):                     # it has ended
            for task in Path(f'/proc/{one}/task').iterdir():
                waited += int((task / 'schedstat').read_text().split()[1])
    return waited / S


class Heard(NamedTuple):
    """The newest of a status."""

    stamp: int
    complaint: str = ''                             # '' while it is OK
    state: str = ''


class Still(NamedTuple):
    """A count, and the stamps of the first and the newest status that told it."""

    count: int = -1
    since: int = 0
    until: int = 0


class Hearing:
    """What the statuses say, and since when they say it."""

    def __init__(self) -> None:
        self.unaccounted = 0                        # bytes, most of all reports
        self.counted = Still()                      # 'Bytes' of the monitor
        # Stamp, ID and state of devices that are called other than connected. Those behind a cut
        # in an exchange are `waiting` until the next one, and rightly so.
        self.denied: list[tuple[int, int, str]] = []
        self._heard: dict[tuple[str, str], Heard] = {}
        self._freezes = '0'
        self._hindered: list[int] = []              # stamps: bridge was frozen, or without a port

    def take(self, topic: str, array: DiagnosticArray) -> None:
        stamp = array.header.stamp.sec * S + array.header.stamp.nanosec
        for status in array.status:
            values = {pair.key: pair.value for pair in status.values}
            complaint = status.message if status.level[0] else ''
            heard = Heard(stamp, complaint, values.get('State', ''))
            self._heard[topic, status.name] = heard
            self._heard[topic, status.name.partition(':')[0]] = Heard(stamp)
            if 'Freezes' in values:
                self._take_link(stamp, values)
            elif 'Noise Bytes' in values and topic == TABLES:
                self._take_bus(stamp, values)
            elif topic == TABLES and heard.state not in ('', 'connected', 'waiting'):
                self.denied.append((stamp, int(status.name[-3:]), heard.state))

    def silent(self, since: int, *topics: str) -> list[str]:
        """Return a line for all that was not said again since a moment; topics: only these."""
        wanted = [key for key in WANTED if not topics or key[0] in topics]
        old = [key for key in wanted if self._stamp(*key) < since]
        for topic, node in sorted({(topic, name.partition(':')[0]) for topic, name in old}):
            its = [key for key in wanted if key[0] == topic and key[1].startswith(node)]
            if len(its) > 1 and all(key in old for key in its):
                old = [(topic, node), *(key for key in old if key not in its)]
        seconds = (time.time_ns() - since) / S
        return [f'{name}: says nothing any more on {topic}, for {seconds:.0f} s at least'
                for topic, name in old]

    def not_well(self, since: int) -> list[str]:
        """Return what is silent and what is not OK."""
        return self.silent(since) + [f'{name}: {one.complaint}' for (_, name), one
                                     in dict(self._heard).items() if one.complaint]

    def wrong(self, since: int, dumb: Container[int] = ()) -> list[str]:
        """Return what is said since a moment and is wrong: all devices answer but `dumb`."""
        lines = []
        for number in IDS:
            one = self._heard.get((TABLES, f'{MONITOR}: {number:03}'), Heard(0))
            if one.stamp >= since and (one.state == 'connected') == (number in dumb):
                lines.append(f'{MONITOR}: calls {number:03} {one.state}, which '
                             + ('does not answer' if number in dumb else 'answers'))
        return lines

    def explained(self, begin: int, end: int) -> bool:
        """Return whether a freeze or a lost port explains that the rover drove late."""
        return any(begin - FREEZE_BEFORE_S * S < stamp < end + FREEZE_AFTER_S * S
                   for stamp in self._hindered)

    def _stamp(self, topic: str, name: str) -> int:
        return self._heard.get((topic, name), Heard(0)).stamp

    def _take_link(self, stamp: int, values: dict[str, str]) -> None:
        if values['Freezes'] != self._freezes or values['State'] != 'open':
            self._freezes = values['Freezes']
            self._hindered.append(stamp)

    def _take_bus(self, stamp: int, values: dict[str, str]) -> None:
        count = int(values['Bytes'])
        parts = sum(int(values[f'{kind} Bytes']) for kind in ('Packet', 'Noise', 'Pending'))
        self.unaccounted = max(self.unaccounted, abs(count - parts))
        since = self.counted.since if count == self.counted.count else stamp
        self.counted = Still(count, since, stamp)


class Ears(Hearing):
    """Hears the statuses of both nodes, in a thread of its own."""

    def __init__(self) -> None:
        super().__init__()
        self.node = rclpy.create_node('bench_soak')
        for topic in sorted({topic for topic, _ in WANTED}):
            self.node.create_subscription(
                DiagnosticArray, topic, lambda array, topic=topic: self.take(topic, array), 100)
        self._is_stopping = False
        self._thread = threading.Thread(target=self._spin, name='ears')
        self._thread.start()

    def stop(self) -> None:
        self._is_stopping = True
        self._thread.join()

    def _spin(self) -> None:
        while not self._is_stopping:
            rclpy.spin_once(self.node, timeout_sec=0.1)
