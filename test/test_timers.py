# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The timers of the monitor: on time, never twice for one that was missed, no silent end."""

from threading import Event
from types import SimpleNamespace

import pytest

from dxl_monitor import timers as module
from dxl_monitor.timers import Timers


@pytest.fixture
def timers(monkeypatch):
    monkeypatch.setattr(module, 'time', SimpleNamespace(monotonic=lambda: 10.0))
    return Timers()


def test_a_call_comes_each_period_and_is_not_made_up_for(timers):
    called = []
    timers.add(1.0, lambda: called.append(now))
    for now in (10.9, 11.0, 11.9, 12.1, 12.9, 13.0, 19.5, 19.6, 20.4, 20.5):
        timers.call_due(now)
    assert called == [11.0, 12.1, 13.0, 19.5, 20.5]


def test_a_call_may_change_its_period(timers):
    called = []

    def call():
        called.append(now)
        one.period_s = 0.25

    one = timers.add(1.0, call)
    for now in (11.0, 11.2, 11.25, 11.5):
        timers.call_due(now)
    assert called == [11.0, 11.25, 11.5]


def test_a_mistake_is_raised_where_somebody_checks():
    def call():
        raise ZeroDivisionError

    timers = Timers()
    timers.add(0.0, call)
    timers.check()
    timers.start()
    timers._thread.join(20.0)
    with pytest.raises(ZeroDivisionError):
        timers.check()
    timers.stop()


def test_no_memory_ends_one_call():
    def call():
        called.append(None)
        if len(called) == 1:
            raise MemoryError
        again.set()

    called, again = [], Event()
    timers = Timers()
    timers.add(0.001, call)
    timers.start()
    assert again.wait(20.0)
    assert timers.is_alive()
    with pytest.raises(MemoryError):
        timers.check()
    timers.check()
    timers.stop()


def test_who_checks_waits_for_a_call_that_goes_on_and_none_comes_after_the_stop():
    entered, leave = Event(), Event()
    called = []

    def call():
        called.append(timers._turning.locked())     # check() would have to wait
        entered.set()
        leave.wait(20.0)
        timers.stop()                               # it does not wait for itself

    timers = Timers()
    timers.add(0.0, call)
    timers.add(0.0, lambda: called.append(False))
    timers.start()
    assert entered.wait(20.0)
    leave.set()
    timers._thread.join(20.0)
    timers.check()
    assert called == [True]
