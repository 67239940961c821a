# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a node logs about the devices of a bus, report by report."""
from doctor_case import case
from doctor_case import device
from doctor_case import S

from dxl_monitor.bus_log import BusLog
from msg_defs.diagnostics import Level
from servobus.bus import report as words
from servobus.bus.report import Finding

HOT = 'near its shutdown limit of 72 °C: reduce load or holding torque, let it cool'


def lost(number, **other):
    return device(number, **{
        'state': words.DISCONNECTED, 'message': 'disconnected: 5 answers missed',
        'totals': {'reads': 9}, **other})


class Bus:
    """A bus that reports twice a second."""

    def __init__(self, count, name=''):
        self.log = BusLog(name)
        self.devices = {number: device(number) for number in range(1, count + 1)}
        self.findings = ()
        self.s = 100.0

    def lines(self, seconds=3.0, **changes):
        """Have devices changed, by ID, at once; return the lines of so many s after it."""
        self.devices |= {int(name[1:]): one for name, one in changes.items()}
        found = []
        for _ in range(int(2 * seconds)):
            self.s += 0.5
            report = case(*self.devices.values(), stamp=int(self.s * S),
                          findings=tuple(self.findings)).report
            found += self.log.lines(report)
        return found

    def lose(self, *numbers, **options):
        return self.lines(**{f'_{one}': lost(one) for one in numbers}, **options)

    def mend(self, *numbers, **options):
        return self.lines(**{f'_{one}': device(one) for one in numbers}, **options)


def test_one_line_at_the_loss_and_one_at_the_return():
    bus = Bus(6)
    assert bus.lines() == []
    assert bus.lines(_3=lost(3, name='003 elbow')) == [
        'bus: 5 of 6 devices connected; lost: 003 elbow (disconnected: 5 answers missed)']
    assert bus.lines(60) == []
    assert bus.mend(3) == ['bus: 6 of 6 devices connected; back: 003']
    assert bus.lines(60) == []


def test_a_bus_that_loses_its_power_is_one_line_that_counts():
    """Devices go one after the other, as they are asked."""
    bus = Bus(253, 'arm')
    lines = [line for first in range(1, 254, 50)
             for line in bus.lose(*range(first, min(first + 50, 254)), seconds=0.5)]
    lines += bus.lines(30)
    assert lines == ['bus arm: 0 of 253 devices connected; lost: 001, 002, 003, 004, 005, 006 '
                     'and 247 more']
    assert bus.mend(*range(1, 254)) == [
        'bus arm: 253 of 253 devices connected; back: 001, 002, 003, 004, 005, 006 and 247 more']


def test_what_the_doctor_says_of_the_bus_comes_first():
    bus = Bus(2)
    bus.findings = [Finding('all_silent', Level.ERROR, None, 'nothing answers: check the power')]
    assert bus.lose(1, 2) == [
        'bus: 0 of 2 devices connected; nothing answers: check the power; lost: 001, 002']


def test_losses_that_go_on_for_long_do_not_wait_for_the_last():
    bus = Bus(100)
    lines = [line for number in range(1, 41) for line in bus.lose(number, seconds=0.5)]
    assert len(lines) >= 3
    assert lines[0].startswith('bus: 89 of 100 devices connected; lost: 001, ')


def test_a_loose_contact_does_not_fill_the_log():
    """It comes and goes for ten minutes; in the end it stays away, and the log says so."""
    bus = Bus(2)
    lines = []
    for _ in range(150):
        lines += bus.lose(2, seconds=2)
        lines += bus.mend(2, seconds=2)
    assert 30 < len(lines) <= 4 + 600 / 10
    lines += bus.lose(2, seconds=20)
    assert '; lost: 002 (' in lines[-1]


def test_heat_begins_and_ends_where_the_temperature_is_read():
    bus = Bus(2)
    cool = device(1, registers={'Present Temperature': 40})
    bus.findings = [Finding('too_hot', Level.WARN, 1, HOT)]
    assert bus.lines(_1=cool) == [f'bus: 2 of 2 devices connected; too hot: 001 ({HOT})']
    bus.findings = []
    old = device(1, registers={'Present Temperature': 71}, age_s=11.0)
    assert bus.lines(20, _1=old) == []              # it is not read: it may be as hot as before
    assert bus.lines(20, _1=device(1)) == []
    assert bus.lines(_1=cool) == [
        'bus: 2 of 2 devices connected; not too hot any more: 001']


def test_a_hardware_error_begins_and_ends_where_its_device_answers():
    bus = Bus(2)
    bus.findings = [Finding('hardware_error', Level.ERROR, 2, 'overload error latched')]
    assert bus.lines() == [
        'bus: 2 of 2 devices connected; hardware error: 002 (overload error latched)']
    bus.findings = []
    [line] = bus.lose(2)
    assert line.endswith('lost: 002 (disconnected: 5 answers missed)')
    assert bus.mend(2) == ['bus: 2 of 2 devices connected; back: 002',
                           'bus: 2 of 2 devices connected; no hardware error any more: 002']


def test_an_id_that_is_only_searched_for_is_not_lost():
    bus = Bus(1)
    assert bus.lines(10, _9=lost(9, totals={}, last_heard_s=None)) == []


def test_a_reset_of_the_statistics_is_no_return():
    bus = Bus(2)
    assert len(bus.lose(2)) == 1
    del bus.devices[2]
    assert bus.lines() == []
    assert len(bus.lose(2)) == 1
