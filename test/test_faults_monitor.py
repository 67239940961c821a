# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The fault table of docs/reliability.md for the monitor: a real node on a scripted cable.

As test_faults_bridge.py. `recovery` is the time from the end of the fault to the first report
after it in which the devices answer again; the node reports 10 times a second here.
"""
from contextlib import contextmanager
import resource
import signal
import time

from harness import loose_contact
from harness import no_descriptors
from harness import Program
from harness import starving
from harness import wait
import pytest

from benchmark.cable import Cable
from dxl_monitor.capture import Reader

pytestmark = pytest.mark.ros
BUS, DEVICE = 'dxl_monitor: bus', 'dxl_monitor: 001'
ALONE = 'alone'                             # the node of a test that has its own


class Node(Program):
    """A monitor on one bus, and what it says about it."""

    def __init__(self, graph, port, name='dxl_monitor', **parameters):
        self._graph = graph
        self._device = f'{name}: 001'
        given = {'ports': f"['{port}']", 'publish_rate': 10.0, 'silent_after': 1.0, **parameters}
        super().__init__('dxl_monitor.main', '--ros-args', '-r', f'__node:={name}', *(
            part for key, value in given.items() for part in ('-p', f'{key}:={value}')))

    def value(self, name, key):
        status = self._graph.statuses.get(name)
        return next((pair.value for pair in status.values if pair.key == key), '') \
            if status is not None else ''

    def answers(self):
        return int(self.value(self._device, 'Answers') or 0)

    def _is_connected(self):
        return self.value(self._device, 'State') == 'connected'

    def hears(self):
        """Wait until devices have answered anew and are connected, as a report says."""
        self._graph.statuses.clear()
        wait(self._is_connected)
        before = self.answers()
        wait(lambda: self.answers() > before and self._is_connected())

    def recovers(self, begin):
        """Return how long after `begin` (monotonic s) that was so."""
        self.hears()
        return time.monotonic() - begin

    def bytes_are_accounted_for(self):
        status = self._graph.wait_status(BUS, 'Pending Bytes')
        values = {pair.key: pair.value for pair in status.values}
        assert int(values['Bytes']) == sum(int(values[f'{kind} Bytes'])
                                           for kind in ('Packet', 'Noise', 'Pending'))


@contextmanager
def fake_bus(folder):
    """Run a bus of four devices; yield its port."""
    link = folder / 'bus'
    with Program('dxl_monitor.fake_bus', '--link', str(link), '--devices', '1-4:MX-106',
                 '--rate', '50') as bus:
        wait(link.exists)
        yield str(link)
        assert 'Traceback' not in bus.text


@pytest.fixture
def own_bus(tmp_path):
    with fake_bus(tmp_path) as port:
        yield port


@pytest.fixture(scope='module')
def cable(tmp_path_factory):
    with fake_bus(tmp_path_factory.mktemp('dev')) as port, \
            Cable(port, tmp_path_factory.mktemp('cable') / 'port') as cable:
        yield cable


@pytest.fixture(scope='module')
def reports(graph, ros):
    """Hear the whole tables too: they come at publish_rate."""
    graph.listen(ros.DiagnosticArray, '/dxl/diagnostics')
    return graph


@pytest.fixture(scope='module')
def module_node(reports, cable):
    with Node(reports, cable.path) as node:
        yield node
        assert 'Traceback' not in node.text


@pytest.fixture
def node(module_node):
    """Begin with all well and end with every byte accounted for."""
    module_node.hears()
    yield module_node
    module_node.bytes_are_accounted_for()


# --- the cable ---

@pytest.mark.parametrize('fault', [{'drop': 0.3}, {'flip': 0.3}], ids=['drop', 'flip'])
def test_bytes_are_lost_or_turned(node, cable, reports, recovery, fault):
    begin = int(node.value(BUS, 'CRC Errors')) + int(node.value(BUS, 'Truncated Packets'))
    with cable.while_damaged(**fault):
        wait(lambda: int(node.value(BUS, 'CRC Errors') or 0)
             + int(node.value(BUS, 'Truncated Packets') or 0) > begin + 5)
        assert reports.level(DEVICE) is not None
    recovery(f'cable: {next(iter(fault))}', node.recovers(time.monotonic()))


def test_everything_comes_late(node, cable, reports, recovery):
    """A late stream is a stream: nobody is missed."""
    missed = node.value(DEVICE, 'Missed Answers')
    with cable.while_damaged(delay_s=0.15):
        node.hears()
    recovery('cable: 150 ms late', node.recovers(time.monotonic()))
    assert int(node.value(DEVICE, 'Missed Answers')) <= int(missed) + 2


def test_unplugged(node, cable, reports, recovery):
    before = node.answers()
    cable.cut()
    reports.wait_status(BUS, 'is not there', level=2)
    begin = time.monotonic()
    cable.reopen()
    recovery('cable: unplugged for a moment', node.recovers(begin))
    assert node.answers() > before              # what was known and counted is kept


def test_closes_and_reopens_again_and_again(node, cable, recovery):
    begin = loose_contact(cable) / 1e9
    recovery('cable: a loose contact, six cuts in a second', node.recovers(begin))


def test_silence(node, cable, reports, recovery):
    cable.stall()
    reports.wait_status(DEVICE, 'silent', level=3)
    assert node.value(DEVICE, 'State') == 'silent'
    begin = time.monotonic()
    cable.calm()
    recovery('cable: silent for seconds', node.recovers(begin))


def test_a_flood_of_noise(node, cable, reports, recovery):
    noise = int(node.value(BUS, 'Noise Bytes'))
    cable.flood(1.5)
    wait(lambda: int(node.value(BUS, 'Noise Bytes') or 0) > noise + 100_000)
    cable.calm()
    recovery('cable: noise, 200 kB/s', node.recovers(time.monotonic()))


def test_the_name_goes_while_it_is_open(node, cable, recovery):
    cable.remove_name()
    node.hears()
    cable.restore_name()
    recovery('symlink of the port removed', 0.0)


# --- the system ---

def test_frozen_and_continued(node, cable, recovery):
    node.signal(signal.SIGSTOP)
    time.sleep(1.0)
    begin = time.monotonic()
    node.signal(signal.SIGCONT)
    recovery('SIGSTOP, SIGCONT', node.recovers(begin))


def test_no_cpu_left(node, cable, recovery):
    with starving():
        node.hears()
    recovery('CPU starved', node.recovers(time.monotonic()))


def test_no_descriptors_left(node, cable, reports, recovery):
    cable.cut()
    reports.wait_status(BUS, 'is not there', level=2)
    with no_descriptors(node.pid):
        cable.reopen()
        reports.wait_status(BUS, 'no file descriptor is left', level=2)
    recovery('no file descriptors left', node.recovers(time.monotonic()))


@pytest.mark.parametrize('step_s', [3600, -3600])
def test_the_system_clock_jumps(own_bus, reports, clock, recovery, step_s):
    """Ages, rates and time-outs do not notice; stamps of messages follow the clock."""
    with clock.faked(), Node(reports, own_bus, ALONE) as node:
        node.hears()
        clock.step(step_s)
        recovery(f'system clock {step_s:+} s', node.recovers(time.monotonic()))
        wait(lambda: any(abs(one.header.stamp.sec - time.time() - step_s) < 60
                         for one in reports.heard['/dxl/diagnostics'][-20:]))
        node.signal(signal.SIGTERM)
        assert node.exit_code() == 0
        assert 'Traceback' not in node.text


# --- the capture ---

def test_the_disk_is_full(own_bus, reports, tmp_path, recovery):
    """The capture ends and says so; the node goes on; what was written can be read."""
    path = tmp_path / 'bus.txt'
    with Node(reports, own_bus, ALONE, capture=path) as node:
        node.hears()
        wait(lambda: path.stat().st_size > 5000)
        size = path.stat().st_size + 10_000
        resource.prlimit(node.pid, resource.RLIMIT_FSIZE, (size, size))
        node.wait_for('ERROR', f'{path}: File too large; make room')
        recovery('capture: disk full', node.recovers(time.monotonic()))
        node.signal(signal.SIGINT)
        assert node.exit_code() == 0
        assert 'Traceback' not in node.text
    with open(path, 'rb') as file:
        reader = Reader(file)
        kept = sum(len(chunk.data) for chunk in reader)
    assert reader.bad_lines <= 1                # the one that the disk had no room for
    assert 2.2 * kept > size - 8000


def test_the_disk_is_full_from_the_start(own_bus, reports, recovery):
    with Node(reports, own_bus, ALONE, capture='/dev/full') as node:
        node.wait_for('ERROR', '/dev/full: No space left on device')
        recovery('capture: disk full from the start', node.recovers(time.monotonic()))
        assert 'Traceback' not in node.text
