# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Healthy buses: no device may be accused."""

from functools import partial

from rigs.bus import ear
from rigs.bus import masters as m
from rigs.bus.faults import busy_host
from rigs.bus.scene import scene

CHAIN = ('1-6:XL430-W250',)
MANY = tuple(range(1, 26))

SCENES = (
    scene('sdk loop', m.sdk_loop),
    scene('sdk loop, each burst by itself', m.sdk_loop, ear=ear.FINE),
    scene('sdk loop, latency timer 16 ms at the ear', m.sdk_loop, ear=ear.COARSE),
    scene('sdk loop, lumps of 8 ms', m.sdk_loop, ear=ear.LUMPS),
    scene('sdk loop, busy computer', m.sdk_loop, ear=ear.BUSY),
    scene('sdk loop, USB hub', m.sdk_loop, ear=ear.HUB),
    scene('sdk loop without a pause', m.unpaced),
    scene('hardware_interface, Fast Sync Read', m.hardware_interface, devices=CHAIN),
    scene('hardware_interface, busy computer', m.hardware_interface, ear=ear.BUSY),
    scene('hardware_interface, USB hub', m.hardware_interface, ear=ear.HUB),
    scene('hardware_interface, coarse', m.hardware_interface, ear=ear.COARSE),
    scene('hardware_interface, heard from the middle',
          partial(m.hardware_interface, pings=False, volts=False)),
    scene('hardware_interface, plain Sync Read', partial(m.hardware_interface, fast=False)),
    scene('bitbots with a board', partial(m.bitbots, board=30), model='MX-106', baud=2_000_000,
          ids=tuple(range(1, 21)), spares=(30,), ear=ear.BUSY),
    scene('bitbots, USB hub', m.bitbots, model='MX-64', baud=2_000_000, ear=ear.HUB),
    scene('bitbots, lumps', m.bitbots, model='MX-64', baud=2_000_000, ear=ear.LUMPS),
    scene('lerobot', m.lerobot),
    scene('lerobot, USB hub', m.lerobot, ear=ear.HUB),
    scene('lerobot, busy computer of the master', m.lerobot, (), busy_host(0.5)),
    scene('scan of all IDs, then tables', m.scan),
    scene('scan in the middle of a loop', m.setup_then(partial(m.scan, again=False), m.sdk_loop),
          ear=ear.HUB),
    scene('print loop at 57600', m.beginner, ids=(1,), baud=57_600, delay=250),
    scene('print loop of two, busy computer', m.beginner, ids=(1, 2), baud=57_600, ear=ear.BUSY),
    scene('print loop, lumps', m.beginner, ids=(1, 2), baud=57_600, ear=ear.LUMPS),
    scene('item by item', partial(m.poller, torque=True, ping=True)),
    scene('item by item, USB hub', partial(m.poller, torque=True), ear=ear.HUB, devices=CHAIN),
    scene('25 servos at 3 MBd', partial(m.sdk_loop, rate=50.0), ids=MANY, baud=3_000_000,
          ear=ear.HUB),
    scene('loaded computer of the master', m.hardware_interface, (), busy_host(0.8),
          ear=ear.COARSE),
)
