# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The fault table of docs/reliability.md for the monitor: a real node on a scripted cable.

As test_faults_bridge.py. `recovery` is the time from the end of the fault to the first report
after it in which the devices answer again; the node reports 10 times a second here. What holds
in every row is in Node.recovers(). The rows in which the user must see nothing come first: a WARN
about damage stands for 10 s.
"""
from contextlib import contextmanager
from contextlib import nullcontext
import os
import re
import resource
import shutil
import signal
import time

from conftest import SteppedClock
from harness import loose_contact
from harness import no_descriptors
from harness import starving
from harness import wait
from monitored_bus import BUS
from monitored_bus import DAMAGE
from monitored_bus import DEVICES
from monitored_bus import ERROR
from monitored_bus import listen
from monitored_bus import monitored
from monitored_bus import OK
from monitored_bus import SILENT_AFTER_S
from monitored_bus import STALE
from monitored_bus import WARN
import pytest

from servobus.sources.capture import Reader

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.05)]


@pytest.fixture(scope='module')
def reports(graph, ros):
    return listen(graph, ros.DiagnosticArray)


@pytest.fixture(scope='module')
def stepped(tmp_path_factory):
    """Return the system clock of the node, None where there is no C compiler to fake it."""
    return SteppedClock(tmp_path_factory.mktemp('clock')) if shutil.which('cc') else None


@pytest.fixture(scope='module')
def module_node(reports, stepped, tmp_path_factory):
    with stepped.faked() if stepped else nullcontext(), \
            monitored(tmp_path_factory.mktemp('bus'), reports, 'dxl_monitor') as node:
        yield node


@pytest.fixture
def node(module_node):
    """Begin with all well."""
    module_node.begin()
    return module_node


@pytest.fixture
def cable(node):
    return node.cable


@pytest.fixture
def alone(tmp_path, reports):
    """Return what runs a monitor of one's own, on a bus of its own."""
    @contextmanager
    def run(**parameters):
        with monitored(tmp_path, reports, f'alone_{tmp_path.name}', **parameters) as node:
            node.begin()
            yield node
    return run


# --- nothing is to be seen ---

def test_everything_comes_late(node, cable, recovery):
    """A late stream is a stream: no device is missed."""
    with cable.held():                          # else a packet may be torn apart
        cable.damage(delay_s=0.15)
    node.hears()
    cable.calm()
    recovery('cable: 150 ms late', node.recovers(time.monotonic()))
    assert int(node.newest.values['001']['Missed Answers']) <= 2 * (not node.newest.is_clean())
    node.told_nothing()


def test_no_cpu_left(node, recovery):
    with starving():
        node.hears()
        node.hears()
    recovery('CPU starved', node.recovers(time.monotonic()))
    node.told_nothing()


@pytest.mark.parametrize('step_s', [3600, -3600])
def test_the_system_clock_jumps(node, stepped, recovery, step_s):
    """Ages, rates and time-outs do not notice; stamps of messages follow the clock."""
    if stepped is None:
        pytest.skip('skipped: no C compiler for clock_step.c')
    stepped.step(step_s)
    try:
        recovery(f'system clock {step_s:+} s', node.recovers(time.monotonic()))
        report = node.wait_report(lambda one: abs(one.stamp_s - time.time() - step_s) < 60)
    finally:
        stepped.step(0)
    rate = float(report.values[BUS]['bytes (1/s)'])
    assert 1_000 < rate < 100_000, rate
    for name in DEVICES:
        assert report.fields(name)['Present Position'][0] < 60
    node.told_nothing()


def test_frozen_and_continued(node, cable, recovery):
    """Its reader is a process of its own, and reads on: nothing is lost, no device was silent."""
    frozen = cable.delivered
    node.signal(signal.SIGSTOP)
    time.sleep(1.3 * SILENT_AFTER_S)
    wait(lambda: cable.delivered > frozen and not cable.unread)
    assert node.state() == 'T'
    begin = time.monotonic()
    node.signal(signal.SIGCONT)
    recovery('SIGSTOP, SIGCONT', node.recovers(begin))
    node.told_nothing(late_is_silent=False)


def test_frozen_with_its_reader(node, cable, recovery):
    """What the driver still has room for is kept."""
    reader, = node.children()
    lost = cable.lost
    for pid in (node.pid, reader):
        os.kill(pid, signal.SIGSTOP)
    wait(lambda: cable.lost > lost)
    begin = time.monotonic()
    for pid in (reader, node.pid):
        os.kill(pid, signal.SIGCONT)
    recovery('SIGSTOP, SIGCONT, its reader too', node.recovers(begin))


def test_the_name_goes_while_it_is_open(node, cable, recovery):
    """A port is known by its descriptor: its name is needed for the next opening only."""
    begin = time.monotonic()
    cable.remove_name()
    assert not os.path.lexists(cable.path)
    recovery('symlink of the port removed', node.recovers(begin))
    node.told_nothing()
    node.cut()
    node.wait_told(ERROR, f'{cable.path}: is not there; plug it in')
    with taken_number():                        # it comes back under another number
        begin = time.monotonic()
        cable.reopen()
    recovery('symlink of the port removed, then unplugged', node.recovers(begin))


# --- the cable ---

def test_silence(node, cable, recovery):
    """The last values stay, with their age."""
    cable.stall()
    first = node.wait_report(lambda one: set(map(one.levels.get, DEVICES)) == {STALE})
    later = node.wait_report(lambda one: True)
    for name in DEVICES:
        assert later.messages[name].startswith('silent: not asked for ')
        assert later.values[name]['State'] == 'silent'
        values, ages_s = ([one.values[name]['Present Position (rad)'] for one in (first, later)],
                          [one.fields(name)['Present Position'][0] for one in (first, later)])
        assert values[0] == values[1]
        assert SILENT_AFTER_S / 2 < ages_s[0] < ages_s[1]
    begin = time.monotonic()
    cable.calm()
    recovery('cable: silent for seconds', node.recovers(begin))


def test_unplugged(node, cable, recovery):
    node.cut()
    node.wait_told(ERROR, f'{cable.path}: is not there; plug it in')
    wait(lambda: node.logged('[ERROR]', f'{cable.path}: is not there; plug it in'))
    begin = time.monotonic()
    cable.reopen()
    recovery('cable: unplugged for a moment', node.recovers(begin))
    assert node.newest.levels[BUS] in (OK, WARN)


def test_closes_and_reopens_again_and_again(node, cable, recovery):
    node.cut()
    begin = loose_contact(cable) / 1e9
    recovery('cable: a loose contact, six cuts in a second', node.recovers(begin))
    assert node.told(ERROR, cable.path)


@contextmanager
def taken_number():
    """Have the number of the pty that was closed last taken by another one."""
    ends = os.openpty()
    try:
        yield
    finally:
        for end in ends:
            os.close(end)


def test_no_descriptors_left(node, cable, recovery):
    with no_descriptors(node.pid):
        node.cut()
        cable.reopen()
        node.wait_told(ERROR, f'{cable.path}: no file descriptor is left to open it; raise')
    recovery('no file descriptors left', node.recovers(time.monotonic()))


def test_a_flood_of_noise(node, cable, recovery):
    before = node.newest
    cable.damage(flip=0.1)                      # the flood itself mostly falls between packets
    cable.flood(60)
    node.wait_report(
        lambda one: one.levels[BUS] == WARN and damaged_told(one)
        and one.count(BUS, *DAMAGE) > before.count(BUS, *DAMAGE)
        and one.count(BUS, 'Noise Bytes') > before.count(BUS, 'Noise Bytes') + 50_000)
    cable.calm()
    recovery('cable: noise, 200 kB/s', node.recovers(time.monotonic()))


def damaged_told(report):
    """Return whether the doctor calls packets damaged and says what to check."""
    return bool(re.search(r'of the packets damaged, .*: check termination',
                          report.values[BUS].get('finding.noise', '')))


@pytest.mark.parametrize('fault', [{'drop': 0.3}, {'flip': 0.3}], ids=['drop', 'flip'])
def test_bytes_are_lost_or_turned(node, cable, recovery, fault):
    before = node.newest
    with cable.while_damaged(**fault):
        node.wait_report(lambda one: one.count(BUS, *DAMAGE) > before.count(BUS, *DAMAGE) + 10)
        told = node.wait_report(lambda one: all(
            one.levels[name] == WARN and missed_told(one, name) and one.count(
                name, 'Missed Answers') > before.count(name, 'Missed Answers')
            for name in DEVICES))
    recovery(f'cable: {next(iter(fault))}', node.recovers(time.monotonic()))
    assert told.levels[BUS] == WARN
    assert damaged_told(told)
    assert told.values[BUS]['error 00'] != before.values[BUS].get('error 00')
    errors = [text for key, text in told.values[BUS].items() if key.startswith('error ')]
    assert any('with a wrong CRC' in text for text in errors)
    assert any('no answer to Sync Read' in text for text in errors)


def missed_told(report, name):
    """Return how many answers the message of a device calls missed, 0 if it is about others."""
    found = re.match(r'(\d+) of (\d+) answers missed', report.messages[name])
    return int(found[1]) if found else 0


# --- nodes of their own: the capture ---

def test_the_disk_is_full(alone, tmp_path, recovery):
    """The capture ends and says so; the node goes on; what was written can be read."""
    path = tmp_path / 'bus.txt'
    with alone(capture=path) as node:
        assert node.newest.values[BUS]['Capture'] == f'recording to {path}'
        size = path.stat().st_size + 10_000
        resource.prlimit(node.pid, resource.RLIMIT_FSIZE, (size, size))
        recovery('capture: disk full', tells_of_the_capture(node, f'{path}: File too large'))
        node.signal(signal.SIGINT)
        assert node.exit_code() == 0
    assert path.stat().st_size == size
    lines = path.read_bytes().splitlines()
    reader = Reader(lines)
    kept = [chunk.data for chunk in reader]
    assert len(kept) > 2
    assert reader.bad_lines <= 1                # the one that the disk had no room for
    assert len(kept) + reader.bad_lines >= sum(line[:1] == b'(' for line in lines)
    heard = bytes(node.cable.heard)
    assert heard.startswith(b''.join(kept))


def test_the_disk_is_full_from_the_start(alone, recovery):
    with alone(capture='/dev/full') as node:
        recovery('capture: disk full from the start', tells_of_the_capture(
            node, '/dev/full: No space left on device'))


def tells_of_the_capture(node, reason):
    """Wait until the node says that its capture has ended; return how soon it is well again."""
    words = f'capture stopped: {reason}; make room and restart the node'
    wait(lambda: node.said('[ERROR]', words))
    begin = time.monotonic()
    told = node.wait_told(WARN, words)
    assert told.values[BUS]['Capture'] == words
    return node.recovers(begin)
