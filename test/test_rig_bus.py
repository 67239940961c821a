# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The second bus: packets, line, servos, adapters; and what the doctor says of it."""

from pathlib import Path

import pytest

from benchmark import baseline
from rigs.bus import adapter
from rigs.bus import frames
from rigs.bus import masters
from rigs.bus.scene import Scene
from rigs.bus.score import SCENES
from rigs.bus.wire import render
from rigs.bus.wire import S
from rigs.bus.wire import Talk
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

BYTE_NS = 10_000.0


RIGS = Path(adapter.__file__).parent
# One of each kind: all of them take minutes.
SAMPLE = ('sdk loop, USB hub', 'dead, item by item', 'loose plug, fast reads',
          'noise on all, bitbots', 'answers of the wrong length, sdk',
          'scan of all IDs, then tables', 'same ID, other delay', 'same ID, sdk',
          'answers too late', 'impatient', 'impatient, item by item', 'two programs, fast reads',
          'supply sags, limits never read', 'flood of broadcast Pings')


# --- packets: examples of the e-Manual (Protocol 2.0, Instruction Details) -------------------

@pytest.mark.parametrize(('packet', 'published'), [
    (frames.instruction(1, frames.PING), 'FF FF FD 00 01 03 00 01 19 4E'),
    (frames.read(1, 132, 4), 'FF FF FD 00 01 07 00 02 84 00 04 00 1D 15'),
    (frames.write(1, 116, b'\x00\x02\x00\x00'), 'FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89'),
    (frames.sync_read((1, 2), 132, 4), 'FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA'),
    (frames.status(1, 0, b'\x06\x04\x26'), 'FF FF FD 00 01 07 00 55 00 06 04 26 65 5D'),
], ids=['Ping', 'Read', 'Write', 'Sync Read', 'answer to a Ping'])
def test_packets_are_those_of_the_manual(packet, published):
    assert packet == bytes.fromhex(published)
    assert len(frames.parse(packet)) == 1


# --- the line --------------------------------------------------------------------------------

def test_bits_that_are_sampled_are_those_that_were_sent():
    talks = Talk(0, bytes(range(256)), BYTE_NS), Talk(9_000_000, b'\xff\x00', BYTE_NS)
    alone = render(talks, BYTE_NS)
    assert alone.data == bytes(range(256)) + b'\xff\x00'
    twice = render((talks[0], talks[0]), BYTE_NS)     # two that say the same are one
    assert (twice.data, list(twice.ends)) == (talks[0].data, list(alone.ends)[:256])


def test_two_talkers_at_once_pull_the_line_low_together():
    heard = render((Talk(0, b'\xf0', BYTE_NS), Talk(0, b'\x3c', BYTE_NS)), BYTE_NS)
    assert heard.data == b'\x30'


# --- servos ----------------------------------------------------------------------------------


# --- adapters ------------------------------------------------------------------------------------


def test_books_agree_with_the_counters_of_the_monitor():
    rig = Scene('', masters.hardware_interface).rig(1)
    monitor = Monitor('bus', Models(), Settings(baud=1_000_000))
    rig.listen(adapter.FINE, monitor.feed, lambda now: None)
    rig.clock.run(2 * S)
    rig.ports[0].stop()
    rig.clock.run(3 * S)
    report = monitor.report(3 * S)
    assert {one.id: (one.totals.answers, one.totals.missed) for one in report.devices} \
        == {number: (servo.answered, 0) for number, servo in rig.servos.items()}


# --- what it is for --------------------------------------------------------------------------

def test_it_shares_nothing_with_what_it_judges():
    for path in RIGS.glob('*.py'):
        ours = [line for line in path.read_text().splitlines()
                if line.startswith(('from dxl_monitor', 'from msg_defs'))]
        assert not ours or path.name == 'score.py', ours
        assert not any('fake' in line or 'dxl_packet' in line for line in ours)


@pytest.mark.more
@pytest.mark.parametrize('name', SAMPLE)
def test_it_is_as_in_the_baseline(name):
    scene = next(scene for scene in SCENES if scene.name == name)
    assert baseline.scene_cells(scene) == {
        **baseline.saved_of('other programs'),
        **baseline.saved_of('other programs, healthy')}[name], \
        'run: scripts/python -m benchmark.baseline --write'
