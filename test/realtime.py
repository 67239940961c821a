# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Tests that judge real time know how long the machine kept their processes waiting.

A test of the mark realtime(bears=SECONDS) that fails is run again, three times at most, if its
processes waited longer than that: for a core, or because all of them were stopped. The figure is
smaller than the shortest time-out that the test judges. A failure without such a wait is final.

The figure is the largest sum of waits of all processes of the test, within SPAN_S or twice what it
bears: an upper limit of how late a chain of them was. test/waits.py measures it.
"""
from pathlib import Path

from _pytest.runner import CallInfo
from _pytest.runner import runtestprotocol
import pytest
from waits import Machine

RERUNS = 3
SPAN_S = 1.0


def bears(item):
    """Return how many seconds of waiting a test of real time bears, None for any other."""
    mark = item.get_closest_marker('realtime')
    if mark is None or not Path('/proc/self/schedstat').exists():
        return None
    return mark.kwargs['bears']


class Rerun:
    """The plugin: runs a test again that failed while its processes waited too long."""

    def __init__(self):
        self._machine = Machine()
        self._reruns = []               # from all workers, where the summary is printed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item, nextitem):
        limit = bears(item)
        if limit is None:
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reruns = []
        while True:
            self._machine.begin()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            waited = self._machine.longest(max(SPAN_S, 2 * limit))
            failed = [report for report in reports if report.failed]
            if not failed or waited <= limit or len(reruns) == RERUNS:
                break
            reruns.append(waited)
            # What waited may be what tests share. If it does not end well: that is run again too.
            CallInfo.from_call(lambda: item.session._setupstate.teardown_exact(None), 'teardown',
                               reraise=(KeyboardInterrupt, pytest.exit.Exception))
            item._initrequest()
        for report in failed:
            report.sections.append(
                ('machine', f'Its processes waited {waited:.3f} s; this test bears {limit:g} s.'))
        if reruns:
            reports[-1].reruns = (limit, reruns, 'failed' if failed else 'passed')
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_runtest_logreport(self, report):
        if hasattr(report, 'reruns'):
            limit, reruns, end = report.reruns
            self._reruns.append(
                f'{report.nodeid}: {end} in the end; failed while its processes waited '
                f'{", ".join(f"{waited:.3f} s" for waited in reruns)} (it bears {limit:g} s)')

    def pytest_terminal_summary(self, terminalreporter):
        if self._reruns:
            terminalreporter.section(f'{len(self._reruns)} tests run again: the machine was late')
            for line in self._reruns:
                terminalreporter.write_line(line)

    def pytest_unconfigure(self):
        self._machine.close()
