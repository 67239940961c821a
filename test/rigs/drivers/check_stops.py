# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Every way in which the bridge, its node apart, stops the rover: 8250, ftdi_sio, cdc_acm."""
from __future__ import annotations

import pytest

from rigs.drivers.adapters import KINDS
from rigs.drivers.rover import rover_on

REPLUGS = 10


@pytest.fixture(scope='module', params=KINDS, ids=lambda kind: kind.driver)
def rover(request, guest):
    with rover_on(request.param, guest) as rover:
        yield rover


def test_the_rover_stops_when_the_commands_end(rover, record_property):
    stop_by(rover, 'USR1', record_property)
    rover.bridge.signal('USR2')
    rover.drive()


def test_the_rover_stops_when_the_bridge_is_frozen(rover, record_property):
    stop_by(rover, 'STOP', record_property)
    rover.bridge.signal('CONT')
    rover.drive()


def stop_by(rover, signal, record_property):
    """Drive, send the bridge a signal, and see the rover stop and stand."""
    rover.drive()
    rover.bridge.signal(signal)
    rover.stopped(record_property)
    assert rover.stands(1)


def test_the_rover_stops_first_each_time_that_the_cable_is_back(rover, record_property):
    for _ in range(REPLUGS):
        rover.drive()
        rover.adapter.unplug()
        rover.guest.until(lambda: rover.mcu.has_taken(rover.adapter.handed))
        known = len(rover.mcu.set_points)
        rover.adapter.plug()
        rover.guest.until(
            lambda known=known: len(rover.mcu.set_points) > known)
        assert rover.mcu.set_points[known].is_stop
    rover.drive()
    record_property('figure', f'{REPLUGS} times')


def test_the_rover_stops_when_the_bridge_is_killed(rover, record_property):
    stop_by(rover, 'KILL', record_property)


def test_the_rover_stops_when_the_bridge_is_ended(rover, record_property):
    rover.drive()
    rover.bridge.signal('TERM')
    rover.stopped(record_property)
    rover.guest.until(lambda: not rover.bridge.is_active())
    assert 'Traceback' not in rover.bridge.log()
