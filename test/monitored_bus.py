# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What test_faults_monitor.py stands on: a monitor on a bus behind a cable that remembers.

A row of the fault table lies between two marks, moments at which the line rests and everything
that the cable delivered has been read. Between them Node.recovers() holds what every row
promises. The figures to compare with are the cable's, never the monitor's own.
"""
from __future__ import annotations

import array
from bisect import bisect_left
from collections import Counter
from collections import defaultdict
from contextlib import contextmanager
import fcntl
from itertools import pairwise
import json
import signal
import termios
import time
from typing import NamedTuple

from harness import DEADLINE_S
from harness import LATE_S
from harness import Program
from harness import wait

from msg_defs.crc import crc16
from msg_defs.dxl_packet import STATUS
from rigs.cable import Cable

BUS, DEVICES = 'bus', ('001', '002', '003', '004')
OK, WARN, ERROR, STALE = range(4)
SILENT_AFTER_S = 1.0
RECOVERY_S = 5.0                # at most, plus LATE_S: two waits of the back-off and a report
SHORTEST = 10                   # bytes of a packet
SEAMS = 3                       # packets that a moment without CPU may cut in two, in one row
COUNTERS = {
    BUS: ('Bytes', 'Packet Bytes', 'Noise Bytes', 'Packets', 'Instructions', 'Repaired Packets',
          'CRC Errors', 'Truncated Packets', 'Bad Lengths', 'Unasked Answers',
          'Unknown Instructions', 'Bytes read', 'Reads', 'Openings'),
    **dict.fromkeys(DEVICES, (
        'Answers', 'Missed Answers', 'Not Served', 'Damaged Answers', 'Repaired Answers',
        'Refused Instructions', 'Alert Answers', 'Writes'))}
# What its devices are is said when the bus begins, and never again: so begin when it is heard.
# Five times, as a machine that is too busy may tear a packet apart.
BUS_THAT_WAITS = """
import os, signal
from mecarover_fakes import fake_bus
from mecarover_fakes import master
once = master.start_up
def start_up(*arguments):
    for _ in range(5):
        yield from once(*arguments)
master.start_up = start_up
class Waiting(fake_bus.FakeBus):
    def start(self, seconds=None):
        os.kill(os.getpid(), signal.SIGSTOP)
        super().start(seconds)
fake_bus.FakeBus = Waiting
fake_bus.main()
"""
DAMAGE = ('CRC Errors', 'Truncated Packets', 'Bad Lengths')


class Witness(Cable):
    """A cable that remembers what the node's side took."""

    def __init__(self, device, link):
        super().__init__(device, link)
        self.heard = bytearray()
        self.moments = [0.0]            # monotonic s, at which `totals` bytes were delivered
        self.totals = [0]

    def age_s(self, count, now):
        """Return how long ago (s) the last of so many bytes was delivered."""
        return now - self.moments[bisect_left(self.totals, count)]

    def longest_pause_s(self, count):
        """Return the longest time without a byte behind so many."""
        moments = self.moments[bisect_left(self.totals, count):]
        return max(b - a for a, b in pairwise([*moments, time.monotonic()]))

    @property
    def unread(self):
        """How many bytes wait in the pty for the node."""
        count = array.array('i', [0])
        fcntl.ioctl(self._near._slave, termios.FIONREAD, count)
        return count[0]

    def _write(self, fd, data):
        before = self.delivered
        super()._write(fd, data)
        if taken := self.delivered - before:
            self.heard += data[:taken]
            self.moments.append(time.monotonic())
            self.totals.append(self.delivered)


def packets_in(data):
    """Return the good packets in bytes, how many bytes that are, and how many packets failed."""
    packets = []
    size = failed = done = at = 0
    while (at := data.find(b'\xff\xfd\x00', at)) >= 0:
        length = int.from_bytes(data[at + 4:at + 6], 'little')
        end = at + 6 + length
        packet = b'\xff' + data[at:end]         # the first byte may be damaged: it is known
        if length > 2 and end <= len(data) and crc16(packet[:-2]) == int.from_bytes(
                packet[-2:], 'little'):
            packets.append(packet)
            size += end - max(done, at - 1)
            done = at = end
        else:
            failed += data[at - 1:at] == b'\xff' and at > done
            at += 1
    return packets, size, failed


class Report:
    """One message of dxl/diagnostics, by the last part of the names: 'bus', '001' ..."""

    def __init__(self, message):
        self.heard_s = time.monotonic()
        self.stamp_s = message.header.stamp.sec
        self.levels, self.messages, self.values = {}, {}, {}
        for status in message.status:
            name = status.name.partition(': ')[2]
            self.levels[name] = status.level[0]
            self.messages[name] = status.message
            self.values[name] = {pair.key: pair.value for pair in status.values}

    def count(self, name, *keys):
        return sum(int(self.values[name][key]) for key in keys)

    def is_well(self):
        """Tell whether all devices are there and connected, and the bus is heard."""
        return self.levels[BUS] in (OK, WARN) and all(
            name in self.values and self.values[name]['State'] == 'connected'
            and self.levels[name] in (OK, WARN) for name in DEVICES)

    def fields(self, name):
        """Return what is known of a control table: [age in s, source] by field."""
        return json.loads(self.values[name]['observed'])

    def missed(self):
        return sum(self.count(name, 'Missed Answers') for name in DEVICES)

    def is_clean(self):
        """Tell whether nothing was damaged or missed since the start."""
        return not self.count(BUS, 'Noise Bytes', *DAMAGE) + self.missed()


def listen(graph, kind):
    """Return the reports of dxl/diagnostics by name of the node; they go on coming."""
    reports = defaultdict(list)

    def hear(message):
        if message.status:
            reports[message.status[0].name.partition(': ')[0]].append(Report(message))
    graph.node.create_subscription(kind, '/dxl/diagnostics', hear, 100)
    return reports


class Mark(NamedTuple):
    """A moment at which all that was delivered had been read."""

    report: Report
    index: int                  # this report's
    delivered: int              # bytes by the cable
    unheard: int                # the part lost in a pty that was hung up or flushed
    lines: int                  # lines in the log


class Node(Program):
    """A monitor on a cable, and what it says."""

    def __init__(self, reports, cable, name, **parameters):
        given = {'ports': f"['{cable.path}']", 'publish_rate': 10.0,
                 'silent_after': SILENT_AFTER_S, **parameters}
        self.reports = reports[name]
        self.cable = cable
        self._mark = self._row = None   # the newest, and the one at which this row began
        self._unheard = 0               # None: not known, as after a row that failed
        self._read_at_cut = None
        super().__init__('dxl_monitor.start', '--ros-args', '-r', f'__node:={name}', *(
            part for key, value in given.items() for part in ('-p', f'{key}:={value}')))

    # --- what it says ------------------------------------------------------------------------

    @property
    def newest(self):
        return self.reports[-1]

    def wait_report(self, condition):
        """Wait for a report that comes from now on and meets a condition; return it."""
        at = len(self.reports)
        try:
            return wait(lambda: next(filter(condition, self.reports[at:]), None))
        except AssertionError:
            last = self.newest if self.reports else None
            raise AssertionError(
                f'no such report within {DEADLINE_S} s; delivered {self.cable.delivered}, the '
                f'last says: {last and (last.levels, last.messages, last.values)}\n{self.text}'
            ) from None

    def told(self, level, *parts, name=BUS, key=None):
        """Return the first report of this row with this level and these words, or None."""
        return next((one for one in self.reports[self._row.index:]
                     if _tells(one, level, parts, name, key)), None)

    def wait_told(self, level, *parts, name=BUS, key=None):
        """Wait for a report from now on with this level and these words; return it."""
        return self.wait_report(lambda one: _tells(one, level, parts, name, key))

    def logged(self, *parts):
        """Return the lines of this row's log that hold all of `parts`."""
        return [line for line in self.lines[self._row.lines:]
                if all(part in line for part in parts)]

    def told_nothing(self, *, late_is_silent=True):
        """
        Hold that the user has seen nothing in this row so far.

        A WARN is right where something arrived cut in two, and STALE where nothing arrived, or,
        if late_is_silent, where the machine was too busy to have it read.
        """
        row = self._row
        limit_s = 0.8 * SILENT_AFTER_S
        was_silent = self.cable.longest_pause_s(row.delivered) > limit_s
        right = {OK} if self.newest.is_clean() else {OK, WARN}
        for report in self.reports[row.index:]:
            age_s = self.cable.age_s(report.count(BUS, 'Bytes read') + row.unheard, report.heard_s)
            if was_silent or (late_is_silent and age_s > limit_s):
                continue
            assert report.values[BUS].get('Devices connected') == str(len(DEVICES)), report.values
            for name, level in report.levels.items():
                assert level in right, (name, report.messages[name], report.values)
        assert not self.logged('[ERROR]') + self.logged('[WARN]')

    # --- what it must do in every row --------------------------------------------------------

    def begin(self):
        """Begin a row where the last one ended, if that ended well."""
        if self._mark is None:
            if self._unheard is None:
                self.hears()
            self._mark = self._settle(self._unheard)
        self._row = self._mark
        self._read_at_cut = None

    def hears(self):
        """Wait until all devices have answered again and are connected, as a report says."""
        self._hears_more_than(self.wait_report(Report.is_well))

    def _hears_more_than(self, before, openings=1):
        self.wait_report(lambda one: one.is_well() and _openings(one) >= openings and all(
            one.count(name, 'Answers') > before.count(name, 'Answers') for name in DEVICES))

    def cut(self):
        """Unplug the cable; what is lost from here on, until the next opening, is forgiven."""
        if self._read_at_cut is None:
            self._read_at_cut = self.newest.count(BUS, 'Bytes read')
        self.cable.cut()

    def recovers(self, begin):
        """
        Hold what every row promises, and return how long after `begin` (monotonic s) it was so.

        The devices answer again; each byte that was delivered is counted once; what was known is
        kept.
        """
        before = self._mark
        self._mark = self._unheard = None           # a row that fails does not spoil the next one
        forgiven = 0
        if self._read_at_cut is None:
            self.hears()
        else:
            self._hears_more_than(self.newest, _openings(before.report) + 1)
            forgiven = self.cable.delivered - before.unheard - self._read_at_cut
            self._read_at_cut = None
        seconds = time.monotonic() - begin
        after = self._settle(None if forgiven else before.unheard)
        assert 0 <= after.unheard - before.unheard <= forgiven
        self._counts(before, after)
        for one, other in pairwise(self.reports[before.index:after.index + 1]):
            _keeps(one, other)
        assert after.report.values[BUS]['Read by'] == before.report.values[BUS]['Read by']
        assert seconds < RECOVERY_S + LATE_S
        self._mark = after
        return seconds

    def _settle(self, unheard):
        """Let the line rest and return a mark; unheard: what must be missing, None: any number."""
        with self.cable.held():
            delivered, at = self.cable.delivered, len(self.reports)

            def all_is_read(report):
                read = report.count(BUS, 'Bytes read')
                if report.count(BUS, 'Pending Bytes'):
                    return False
                if unheard is not None:
                    return read == delivered - unheard
                last = [one.count(BUS, 'Bytes read') for one in self.reports[at:][-3:]]
                return last == [read] * 3 and not self.cable.unread
            report = self.wait_report(all_is_read)
            if report.count(BUS, 'Bytes') != report.count(BUS, 'Bytes read'):
                report = self.wait_report(all_is_read)      # the latter is asked a little later
            index = self.reports.index(report)
            return Mark(report, index, delivered, delivered - report.count(BUS, 'Bytes read'),
                        len(self.lines))

    def _counts(self, before, after):
        """Compare the monitor's counters with what the cable delivered."""
        def grown(*keys, name=BUS):
            return after.report.count(name, *keys) - before.report.count(name, *keys)
        lost = after.unheard - before.unheard
        assert grown('Bytes') == grown('Bytes read') == after.delivered - before.delivered - lost
        assert grown('Packet Bytes') + grown('Noise Bytes') == grown('Bytes')
        packets, size, failed = packets_in(bytes(
            self.cable.heard[before.delivered:after.delivered]))
        cut = SEAMS + max(0, grown(*DAMAGE) - failed)       # whole here, but not when they came
        assert 0 <= size - grown('Packet Bytes') <= lost + cut * max(map(len, packets))
        assert 0 <= len(packets) - grown('Packets') <= lost // SHORTEST + cut
        statuses = Counter(packet[4] for packet in packets if packet[7] == STATUS)
        for name in DEVICES:
            answers = grown('Answers', name=name)
            assert answers <= statuses[int(name)]
            assert failed or lost or answers >= statuses[int(name)] - cut


def _tells(report, level, parts, name, key):
    text = report.messages.get(name, '') if key is None else report.values.get(name, {}).get(key)
    return report.levels.get(name) == level and text is not None \
        and all(part in text for part in parts)


def _openings(report):
    return report.count(BUS, 'Openings')


def _keeps(report, later):
    """Hold that a report has forgotten nothing that the one before it knew."""
    for name, keys in COUNTERS.items():
        for key in keys:
            assert later.count(name, key) >= report.count(name, key), (name, key)
    for name in DEVICES:
        values, known = later.values[name], later.fields(name)
        assert (values['Model'], values['Firmware Version']) != ('unknown', 'unknown')
        for key in ('Model', 'Firmware Version', 'Torque Enable'):      # told once, at the start
            assert values[key] == report.values[name][key], (name, key)
        assert set(known) >= set(report.fields(name)), name
        assert all(-1 < age_s < 600 for age_s, _ in known.values()), (name, known)


@contextmanager
def monitored(folder, reports, name, **parameters):
    """Run a bus of four devices and a monitor that hears it from its very first byte."""
    link = folder / 'bus'
    cable = Witness(str(link), folder / 'port')
    options = '--link', str(link), '--devices', '1-4:MX-106'
    with Program('', *options, script=BUS_THAT_WAITS) as bus, \
            Node(reports, cable, name, **parameters) as node:
        wait(lambda: bus.state() == 'T')
        with cable:
            node.wait_report(lambda one: _openings(one) == 1)
            bus.signal(signal.SIGCONT)
            node.wait_report(lambda one: one.is_well() and all(
                'Torque Enable' in one.values[name] for name in DEVICES))
            yield node
        if not node.has_ended:
            node.signal(signal.SIGTERM)
        assert node.exit_code() == 0
        assert 'Traceback' not in node.text + bus.text
