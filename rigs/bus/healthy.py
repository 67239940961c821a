# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Healthy buses: no device may be accused."""

from __future__ import annotations

from functools import partial

from rigs.bus import ear
from rigs.bus import masters as m
from rigs.bus.faults import busy_host
from rigs.bus.scene import Scene

CHAIN = ('1-6:XL430-W250',)
MANY = tuple(range(1, 26))

SCENES: tuple[Scene, ...] = (
    Scene('sdk loop', m.sdk_loop),
    Scene('sdk loop, each burst by itself', m.sdk_loop, ear=ear.FINE),
    Scene('sdk loop, latency timer 16 ms at the ear', m.sdk_loop, ear=ear.COARSE),
    Scene('sdk loop, lumps of 8 ms', m.sdk_loop, ear=ear.LUMPS),
    Scene('sdk loop, busy computer', m.sdk_loop, ear=ear.BUSY),
    Scene('sdk loop, USB hub', m.sdk_loop, ear=ear.HUB),
    Scene('sdk loop without a pause', m.unpaced),
    Scene('hardware_interface, Fast Sync Read', m.hardware_interface, devices=CHAIN),
    Scene('hardware_interface, busy computer', m.hardware_interface, ear=ear.BUSY),
    Scene('hardware_interface, USB hub', m.hardware_interface, ear=ear.HUB),
    Scene('hardware_interface, coarse', m.hardware_interface, ear=ear.COARSE),
    Scene('hardware_interface, heard from the middle',
          partial(m.hardware_interface, pings=False, volts=False)),
    Scene('hardware_interface, plain Sync Read', partial(m.hardware_interface, fast=False)),
    Scene('bitbots with a board', partial(m.bitbots, board=30), model='MX-106', baud=2_000_000,
          ids=tuple(range(1, 21)), spares=(30,), ear=ear.BUSY),
    Scene('bitbots, USB hub', m.bitbots, model='MX-64', baud=2_000_000, ear=ear.HUB),
    Scene('bitbots, lumps', m.bitbots, model='MX-64', baud=2_000_000, ear=ear.LUMPS),
    Scene('lerobot', m.lerobot),
    Scene('lerobot, USB hub', m.lerobot, ear=ear.HUB),
    Scene('lerobot, busy computer of the master', m.lerobot, (), (busy_host(0.5),)),
    Scene('scan of all IDs, then tables', m.scan),
    Scene('scan in the middle of a loop', m.setup_then(partial(m.scan, again=False), m.sdk_loop),
          ear=ear.HUB),
    Scene('print loop at 57600', m.beginner, ids=(1,), baud=57_600, delay=250),
    Scene('print loop of two, busy computer', m.beginner, ids=(1, 2), baud=57_600, ear=ear.BUSY),
    Scene('print loop, lumps', m.beginner, ids=(1, 2), baud=57_600, ear=ear.LUMPS),
    Scene('item by item', partial(m.poller, torque=True, ping=True)),
    Scene('item by item, USB hub', partial(m.poller, torque=True), ear=ear.HUB, devices=CHAIN),
    Scene('25 servos at 3 MBd', partial(m.sdk_loop, rate=50.0), ids=MANY, baud=3_000_000,
          ear=ear.HUB),
    Scene('loaded computer of the master', m.hardware_interface, (), (busy_host(0.8),),
          ear=ear.COARSE),
)
