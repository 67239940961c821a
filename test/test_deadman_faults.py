# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Two faults at a time, against real processes: the rover stops, and no process is left.

Each with a judge of its own (bridge_family.py); --times N repeats them.
"""
from contextlib import suppress
import os
import random
import signal
import sys
import time

from bridge_family import BareMcu
from bridge_family import driving
from bridge_family import Family
from bridge_family import FULL
from bridge_family import give_back
from bridge_family import holds_port
from bridge_family import occupy
from harness import LATE_S
from harness import wait
import pytest

from rigs.harness import state

pytestmark = [pytest.mark.realtime(bears=0.1), pytest.mark.usefixtures('again')]
BOUND_S = 0.3 + LATE_S
KILL, STOP, CONT = signal.SIGKILL, signal.SIGSTOP, signal.SIGCONT


@pytest.fixture
def mcu(tmp_path):
    with BareMcu(tmp_path / 'mcu') as mcu:
        yield mcu


def test_with_more_than_a_thousand_descriptors(mcu):
    with driving(mcu, prefix=[sys.executable, '-c', FULL]) as family:
        begin = time.monotonic()
        family.kill()
        assert mcu.stopped_after(begin) <= BOUND_S


def kill_holders(family):
    """As `fuser -k PORT`: kill all that have the port open."""
    for pid in [pid for pid in [family.bridge, *family.living()] if holds_port(pid)]:
        os.kill(pid, KILL)


def test_all_that_hold_the_port_are_killed(mcu):
    with driving(mcu) as family:
        begin = time.monotonic()
        kill_holders(family)
        assert mcu.stopped_after(begin) <= BOUND_S
        wait(lambda: not family.living())
        assert 0 < len(mcu.stops_since(begin)) <= 7      # the first one may have begun
        give_back(occupy(mcu.path))


def test_another_device_at_that_path_gets_nothing(mcu, tmp_path):
    with BareMcu(tmp_path / 'other') as other, driving(mcu) as family:
        os.unlink(mcu.path)
        os.rename(other.path, mcu.path)
        begin = time.monotonic()
        kill_holders(family)
        assert mcu.stopped_after(begin) <= BOUND_S
        wait(lambda: not family.living())
        assert other.bytes == 0


@pytest.mark.parametrize('number', [KILL, STOP])
@pytest.mark.parametrize('pause_s', [0.0, 0.01, 0.03, 0.1])
def test_dead_man_then_bridge(mcu, pause_s, number):
    with driving(mcu) as family:
        os.kill(family.guards()[0], KILL)
        time.sleep(pause_s)
        begin = time.monotonic()
        os.kill(family.bridge, number)
        assert mcu.stopped_after(begin) <= BOUND_S


def lost_and_killed(mcu, family):
    mcu.unplug()
    wait(lambda: not any(map(holds_port, [family.bridge, *family.living()])))
    family.kill()


def test_a_port_that_comes_back_in_use_is_waited_for(mcu):
    held = []
    with driving(mcu) as family:
        lost_and_killed(mcu, family)
        mcu.plug(lambda path: held.append(occupy(path)))
        time.sleep(1.0)
        assert mcu.drives
        begin = time.monotonic()
        give_back(held[0])
        assert mcu.stopped_after(begin) <= BOUND_S
        wait(lambda: not family.living())
        assert 0 < len(mcu.stops_since(begin)) <= 6


def test_another_device_after_a_loss_gets_nothing(mcu, tmp_path):
    """A pty has no identity: here a file says what it is."""
    name = tmp_path / 'identity'
    name.write_text('the MCU')
    patch = ('import pathlib\nfrom vel2d_bridge import deadman, lost_port\n'
             'deadman.identity = lost_port.identity = '
             f'lambda device: pathlib.Path("{name}").read_text()')
    with driving(mcu, patch=patch) as family:
        lost_and_killed(mcu, family)
        name.write_text('another')
        mcu.plug()
        before = mcu.bytes
        time.sleep(0.5)
        assert mcu.bytes == before
        begin = time.monotonic()
        name.write_text('the MCU')
        assert mcu.stopped_after(begin) <= BOUND_S


@pytest.mark.parametrize('exit_by', [KILL, None], ids=['killed', 'ended'])
def test_where_the_next_bridge_takes_over_the_old_dead_man_is_silent(mcu, exit_by):
    """At a random moment; then the cable is lost again, and comes back."""
    with driving(mcu) as family:
        lost_and_killed(mcu, family)
        pause_s = random.random() * 0.6
        if pause_s < 0.3:
            mcu.plug()
            time.sleep(pause_s)
        with Family(mcu.path, speed=0.25) as successor:
            if pause_s >= 0.3:
                time.sleep(pause_s - 0.3)
                mcu.plug()
            wait(lambda: mcu.frames[-1][1] == 0.25)
            commanded = time.monotonic()
            wait(lambda: not family.living())
            assert not mcu.stops_since(commanded)
            if exit_by is None:
                successor.end()
            else:
                successor.kill()
            wait(lambda: not mcu.drives)
        wait(successor.is_gone)


@pytest.mark.parametrize('pause_s', [0.0, 0.3, 0.9, 3.0])
def test_a_frozen_dead_man_is_no_guard(mcu, pause_s):
    with driving(mcu) as family:
        os.kill(family.guards()[0], STOP)
        time.sleep(pause_s)
        begin = time.monotonic()
        family.kill()
        assert mcu.stopped_after(begin) <= BOUND_S


def test_a_frozen_dead_man_is_replaced(mcu):
    with driving(mcu) as family:
        frozen, server = family.guards()
        os.kill(frozen, STOP)
        wait(lambda: frozen not in family.living())
        assert family.guards()[1] == server
        begin = time.monotonic()
        os.kill(family.bridge, STOP)
        assert mcu.stopped_after(begin) <= BOUND_S
        os.kill(family.bridge, CONT)
        wait(lambda: mcu.drives)
        assert family.end()['deadman'][0] in ('starting', 'ready')


def freeze_and_wake(server, dead_man):
    """Freeze both for 2 s; wake the server."""
    for pid in (server, dead_man):
        os.kill(pid, STOP)
    time.sleep(2.0)
    os.kill(server, CONT)


def test_a_family_that_was_frozen_as_a_whole_is_left_as_it_is(mcu):
    """As the machine is suspended, or a container paused; the server wakes up first."""
    with driving(mcu) as family:
        dead_man, server = family.guards()
        freeze_and_wake(server, dead_man)
        time.sleep(0.1)
        os.kill(dead_man, CONT)
        time.sleep(1.5)
        assert family.guards() == [dead_man, server]


def test_the_state_is_true(mcu):
    """Frozen, both killed: it is said, and no longer when it is over."""
    with driving(mcu) as family:
        dead_man, server = family.guards()
        freeze_and_wake(server, dead_man)
        wait(lambda: dead_man not in family.living())
        dead_man, server = family.guards()
        time.sleep(0.5)
        for pid in (server, dead_man):
            os.kill(pid, KILL)
        time.sleep(0.2)
        states = family.end()['deadman']
    assert [state for state in states if state != 'starting'] == [
        'ready', 'frozen', 'ready', 'lost']


@pytest.mark.parametrize('victims', [[STOP, STOP], [STOP, KILL], [KILL, STOP]],
                         ids=['both frozen', 'server frozen', 'dead man frozen'])
def test_frozen_guards_wake_up_when_the_bridge_dies(mcu, victims):
    with driving(mcu) as family:
        dead_man, server = family.guards()
        for pid, number in zip((server, dead_man), victims, strict=True):
            os.kill(pid, number)
        time.sleep(0.05)
        begin = time.monotonic()
        family.kill()
        assert mcu.stopped_after(begin) <= BOUND_S


def test_without_a_bridge_they_obey(mcu):
    with driving(mcu) as family:
        lost_and_killed(mcu, family)
        time.sleep(2.5)
        os.kill(family.living()[0], signal.SIGTERM)
        wait(lambda: not family.living())


def test_a_bridge_that_ends_beside_a_frozen_dead_man_leaves_none(mcu):
    with driving(mcu) as family:
        os.kill(family.guards()[0], STOP)
        family.end()
        wait(lambda: not family.living())
        assert not mcu.drives


def named(family, number):
    """
    Return what the bridge's end meets: '' where the rover stops, else a pair of the hazard table.

    A bridge that is killed wakes up guards that were stopped; one that is frozen does not.
    """
    guards = family.living()
    frozen = [pid for pid in guards if state(pid) == 'T']
    if not guards:
        return 'both killed'
    if number == STOP and len(frozen) == len(guards):
        return 'both frozen'
    return 'late' if number == STOP and frozen and frozen[0] == guards[0] else ''


def test_random_history(mcu, again):
    """Server, dead man and cable meet random accidents; then the bridge is killed or frozen."""
    chance = random.Random(again)
    done = []
    with driving(mcu) as family:
        for _ in range(chance.randrange(1, 5)):
            victim, number = chance.choice([0, 1]), chance.choice([KILL, STOP, CONT, KILL, STOP])
            done.append((victim, number))
            with suppress(IndexError, ProcessLookupError):
                os.kill(family.living()[victim], number)
            time.sleep(chance.choice([0.0, 0.02, 0.1, 0.5, 1.5]))
        is_lost = chance.random() < 0.3
        number = chance.choice([KILL, STOP])
        wait(lambda: mcu.drives)
        if is_lost:
            mcu.unplug()
            time.sleep(chance.choice([0.0, 0.1, 0.5]))
        pair = named(family, number)
        begin = time.monotonic()
        os.kill(family.bridge, number)
        if is_lost:
            time.sleep(chance.random())
            begin = time.monotonic()
            mcu.plug()
        if pair in ('', 'late'):
            allowed_s = BOUND_S + 0.05 * is_lost + 1.5 * (pair == 'late')
            stopped_s = mcu.stopped_after(begin)
            assert stopped_s <= allowed_s, (again, done, number, is_lost, pair, stopped_s)
    print(f'history {again}: {pair or "stops"}')
