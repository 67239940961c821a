# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both nodes where no thread and no process can be started any more: nothing ends, all goes on.

The limit is the kernel's (RLIMIT_NPROC), which does not bind root: there the nodes run as another
user, who may read what root may.
"""
from contextlib import contextmanager
import os
from pathlib import Path
import resource
import select
import signal
import socket
import subprocess
import tempfile
import time

from harness import Program
from harness import wait
import pytest
from running_bridge import bridge

from rigs.cable import Cable
from rigs.harness import children

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
AS_A_USER = () if os.geteuid() else (
    'setpriv', '--reuid=12345', '--inh-caps=+dac_override,+kill', '--bounding-set=+all',
    '--ambient-caps=+dac_override,+kill')
# Looks for other users of the port and retries come often, so that many fall into the limit.
HASTY = """
import sys
from servobus.port import inspection
from servobus.sources import listener
from {module} import main
inspection.INSPECT_EVERY_S = 0.1
listener.PROCESS_RETRY_NS = 300_000_000
{patch}
sys.exit(main())"""
CUTS = 3
WATCHDOG_S = 0.6


def limited(pid):
    """Return a process and all that it started, which have a limit each."""
    return [pid, *(one for child in children(pid) for one in limited(child))]


@contextmanager
def no_tasks(pid):
    """Let a process, and all that it started, start nothing more."""
    found = limited(pid)
    for one in found:
        set_limit(one, 1)
    try:
        yield
    finally:
        for one in found:
            if Path(f'/proc/{one}').exists():
                set_limit(one, resource.getrlimit(resource.RLIMIT_NPROC)[0])


def set_limit(pid, tasks):
    subprocess.run([*AS_A_USER, 'prlimit', f'--pid={pid}', f'--nproc={tasks}:'], check=True)


class Watchdog:
    """systemd's end of the notification socket."""

    def __init__(self, path, monkeypatch):
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        path.chmod(0o777)
        self._socket.settimeout(10.0)
        monkeypatch.setenv('NOTIFY_SOCKET', str(path))
        monkeypatch.setenv('WATCHDOG_USEC', str(int(1e6 * WATCHDOG_S)))

    def wait_for(self, word):
        while self._socket.recv(100) != word:
            pass

    def starves(self):
        """Tell whether it hears nothing for as long as systemd is patient."""
        return not select.select([self._socket], [], [], WATCHDOG_S)[0]

    def is_fed(self):
        """Forget what came before; tell whether it is fed three times from now on."""
        self._socket.setblocking(False)
        try:
            while True:
                self._socket.recv(100)
        except BlockingIOError:
            self._socket.settimeout(10.0)
        return [self._socket.recv(100) for _ in range(3)] == 3 * [b'WATCHDOG=1']


@pytest.fixture
def watchdog(tmp_path, monkeypatch):
    tmp_path.chmod(0o777)
    return Watchdog(tmp_path / 'notify', monkeypatch)


@pytest.fixture
def flights():
    """Return a folder that another user may write to, by all of its path."""
    with tempfile.TemporaryDirectory(prefix='flights_') as folder:
        os.chmod(folder, 0o777)
        yield folder


@pytest.mark.usefixtures('again')
def test_a_driving_bridge(ros, graph, mcu, cmd_vel, watchdog, tmp_path):
    """It drives on, through losses of its cable, and has a dead man again afterwards."""
    script = HASTY.format(module='vel2d_bridge.main', patch='')
    with Cable(mcu.path, tmp_path / 'port') as cable, \
            bridge(cable.path, script=script, prefix=AS_A_USER) as running, \
            ros.Teleop(cmd_vel, lambda: ros.twist(0.3)):
        mcu.wait_drive(0, 300.0)
        with no_tasks(running.pid):
            mcu.since(time.monotonic_ns(), 20)          # inspections fall due meanwhile
            for _ in range(CUTS):
                begin = time.monotonic_ns()
                graph.statuses.clear()
                cable.cut()
                graph.wait_status('vel2d_bridge: link', 'State=closed', level=2)
                assert watchdog.is_fed()
                cable.reopen()
                mcu.wait_drive(begin, 300.0)
            [server] = running.children()
            os.kill(children(server)[0], signal.SIGKILL)
            graph.wait_status('vel2d_bridge: link', 'Deadman=frozen')
            assert watchdog.is_fed()
            mcu.since(time.monotonic_ns(), 20)
        graph.wait_status('vel2d_bridge: link', 'Deadman=ready', level=0)
        running.signal(signal.SIGTERM)
        assert running.exit_code() == 0
    assert 'Traceback' not in running.text
    assert not running.said('may be driving on')


@pytest.mark.usefixtures('again')
def test_a_listening_monitor(ros, graph, watchdog, tmp_path, flights):
    """It hears on, through losses of its cable, and records what went wrong."""
    graph.statuses.clear()
    with Program('mecarover_fakes.fake_bus', '--link', str(tmp_path / 'bus'),
                 '--devices', '1-3:MX-64') as fake:
        fake.wait_for('2000000 baud')
        with Cable(tmp_path / 'bus', tmp_path / 'port') as cable, monitor(
                cable.path, flight_recorder=flights) as node:
            graph.wait_status('dxl_monitor: bus', '3 of 3', level=0)
            with no_tasks(node.pid):
                for _ in range(CUTS):
                    graph.statuses.clear()
                    cable.cut()
                    graph.wait_status('dxl_monitor: bus', 'State=closed', level=2)
                    assert watchdog.is_fed()
                    cable.reopen()
                    graph.wait_status('dxl_monitor: bus', '3 of 3', level=0)
                    graph.wait_status('dxl_monitor: bus', 'Read by=a thread of the node')
                node.wait_for('its reader process did not start (Resource temporarily')
                saved = graph.call(ros.Trigger, '/dxl_monitor/save_recording')
                assert saved.success, saved.message
                wait(lambda: b' bus ' in Path(saved.message).read_bytes())
                assert watchdog.is_fed()
            graph.wait_status('dxl_monitor: bus', 'Read by=a process of its own', level=0)
            node.signal(signal.SIGTERM)
            assert node.exit_code() == 0
    assert 'Traceback' not in node.text


def monitor(port, patch='', **parameters):
    given = {'ports': f'[{port}]', **parameters}
    return Program('', '--ros-args', *(part for name, value in given.items()
                                       for part in ('-p', f'{name}:={value}')),
                   script=HASTY.format(module='dxl_monitor.start', patch=patch),
                   prefix=AS_A_USER)


@pytest.mark.parametrize(('module', 'patch'), [
    ('vel2d_bridge.main', 'from vel2d_bridge.link import Link as Worker'),
    ('dxl_monitor.start', 'from servobus.sources.listener import Listener as Worker'),
    ('dxl_monitor.start', 'from dxl_monitor.timers import Timers as Worker'),
])
def test_a_watchdog_starves_without_the_thread_that_does_the_work(
        ros, graph, watchdog, tmp_path, module, patch):
    """The thread ends at once, here; the executor spins on."""
    script = HASTY.format(module=module, patch=f'{patch}\nWorker._run = lambda self: None')
    port = 'port' if module.startswith('vel2d') else 'ports'
    with Program('', '--ros-args', '-p', f'{port}:={tmp_path}/none', script=script) as node:
        watchdog.wait_for(b'READY=1')
        assert watchdog.starves()
        name = module.partition('.')[0]
        assert graph.call(ros.Trigger, f'/{name}/reset_statistics').success
        assert watchdog.starves()
        node.signal(signal.SIGTERM)
        watchdog.wait_for(b'STOPPING=1')


