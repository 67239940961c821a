# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_monitor as users meet it: a process on a (fake) bus, its topics, its words, its silence."""
import json
import os
from pathlib import Path
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import time

from harness import Program
from harness import wait
import pytest
import yaml

from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.port.inspection import INSPECT_EVERY_S
from servobus.port.pty import Pty
from servobus.settings import Bus
from servobus.sources.listener import ListenerState
from servobus.sources.recorders import Recorders

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.05)]
S = 1_000_000_000
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def monitor(ports, **parameters):
    """Start the node on ports (a list of paths)."""
    options = [f'-p {name}:={value}'.split() for name, value in parameters.items()]
    return Program('dxl_monitor.start', '--ros-args', '-p', f'ports:={list(map(str, ports))}',
                   *(part for option in options for part in option))


def fake_bus(link, *arguments):
    return Program('mecarover_fakes.fake_bus', '--link', str(link), *arguments)


def devices(graph, bus=''):
    """Return the statuses of devices by ID, the newest of each."""
    pattern = re.compile(rf'dxl_monitor: {bus}(\d+)\b')
    return {int(match[1]): status for name, status in list(graph.statuses.items())
            if (match := pattern.match(name))}


@pytest.fixture
def heard(graph):
    """Listen to the whole tables too, and forget what earlier tests left."""
    graph.statuses.clear()
    graph.heard.clear()
    if not hasattr(graph, 'hears_dxl'):
        graph.hears_dxl = True
        for topic in ('/dxl/diagnostics', '/dxl/timing'):
            graph.listen(graph_message(), topic)
    return graph


def graph_message():
    from ros_side import DiagnosticArray
    return DiagnosticArray


def values(status):
    return {pair.key: pair.value for pair in status.values}


@pytest.mark.smoke
def test_the_robot_on_the_topics(tmp_path, heard):
    with fake_bus(tmp_path / 'bus', '--devices', '1-3:MX-106,4:BitFoot', '--fault',
                  'silent:3:8:5'), \
            monitor([tmp_path / 'bus'], devices="['1-2:MX-106','3:MX-106:knee','4:BitFoot']"):
        wait(lambda: set(devices(heard)) == {1, 2, 3, 4})
        wait(lambda: 'Present Position (rad)' in values(heard.statuses['dxl_monitor: 001'])
             or any('Present Position (rad)' in values(status)
                    for message in list(heard.heard['/dxl/diagnostics'])
                    for status in message.status))
        tables = {status.name: values(status)
                  for message in heard.heard['/dxl/diagnostics'] for status in message.status}
        table = tables['dxl_monitor: 001']
        assert table['Model'] == 'MX-106'
        assert abs(float(table['Present Position (rad)'])) < 3.2
        age_s, source = json.loads(table['observed'])['Present Position']
        assert 0 <= age_s < 30
        assert source == 'r'
        assert int(table['Fields not observed']) > 0
        knee = next(name for name in tables if name.startswith('dxl_monitor: 003'))
        assert 'knee' in knee
        wait(lambda: (2, 'disconnected') in [
            (status.level[0], values(status)['State']) for message in heard.heard['/diagnostics']
            for status in message.status if status.name == knee])
        assert heard.level('dxl_monitor: 001') == 0
        wait(lambda: [[status.name for status in message.status][:2]
                      for message in list(heard.heard['/dxl/diagnostics'])][-1]
             == ['dxl_monitor: bus', knee])
        wait(lambda: values(heard.statuses[knee])['State'] == 'connected')
        assert 'dxl_monitor: timing/bus_load' in heard.statuses
        assert float(values(heard.statuses['dxl_monitor: timing/bus_load'])['value (%)']) > 0


def test_two_buses_have_names(tmp_path, heard):
    with fake_bus(tmp_path / 'left', '--devices', '1:MX-64'), \
            fake_bus(tmp_path / 'right', '--devices', '1:MX-64'), \
            monitor([tmp_path / 'left', tmp_path / 'right'], bauds=2_000_000):
        heard.wait_status('dxl_monitor: left/001', 'connected')
        heard.wait_status('dxl_monitor: right/001', 'connected')
        heard.wait_status('dxl_monitor: bus right', '1 of 1')
        assert heard.statuses['dxl_monitor: left/001'].hardware_id == 'servo bus left/ID 1'
        heard.wait_status('dxl_monitor: timing/left/bus_load')
        assert heard.statuses['dxl_monitor: timing/left/bus_load'].hardware_id == 'servo bus left'


def rights_on(port, pid):
    """Return the access modes of the descriptors that a process has of a port."""
    fds = [fd for fd in Path(f'/proc/{pid}/fd').iterdir()
           if os.path.realpath(fd) == os.path.realpath(port)]
    infos = [Path(f'/proc/{pid}/fdinfo/{fd.name}').read_text() for fd in fds]
    return [int(re.search(r'flags:\s+(\d+)', info)[1], 8) & os.O_ACCMODE for info in infos]


def test_it_never_transmits(tmp_path, heard):
    """The descriptor is read-only, no call writes to it, and not one byte arrives."""
    with Pty(str(tmp_path / 'bus')) as pty, monitor([tmp_path / 'bus']) as node:
        node.wait_for('open at 2000000 baud')
        [reader] = wait(node.children)
        wait(lambda: 'dxl_reader' in Path(f'/proc/{reader}/comm').read_text())
        assert all(rights_on(pty.path, pid) == [os.O_RDONLY] for pid in (node.pid, reader))
        noise = random.Random(3).randbytes(60_000)
        while noise:
            select.select([], [pty.master], [])
            noise = noise[os.write(pty.master, noise[:600]):]
        heard.wait_status('dxl_monitor: bus', 'Bytes=60000')
        with pytest.raises(BlockingIOError):
            os.read(pty.master, 1)


@pytest.mark.skipif(shutil.which('strace') is None, reason='skipped: strace is not installed')
def test_no_system_call_writes_to_the_port(tmp_path, heard):
    trace = tmp_path / 'trace'
    with fake_bus(tmp_path / 'bus', '--devices', '1:MX-64') as bus:
        bus.wait_for('2000000 baud')
        target = os.path.realpath(tmp_path / 'bus')
        with monitor([tmp_path / 'bus']) as node:
            [reader] = wait(node.children)
            tracer = subprocess.Popen(
                ['strace', '-f', '-y', '-e', 'trace=write,writev,pwrite64,sendto,sendmsg',
                 '-o', str(trace), '-p', str(node.pid), '-p', str(reader)],
                stderr=subprocess.DEVNULL)
            try:
                heard.wait_status('dxl_monitor: 001', 'connected')
                before = len(heard.heard['/dxl/diagnostics'])
                wait(lambda: len(heard.heard['/dxl/diagnostics']) > before + 4)
            finally:
                tracer.terminate()
                tracer.wait()
    calls = trace.read_text()
    assert re.search(rf'^{reader} +write.*pipe:', calls, re.M), 'strace saw nothing of the reader'
    assert target not in calls


def test_a_report_waits_until_what_waited_is_read(ros):
    """After a freeze; but not for ever, if it is the reader that hangs."""
    from servobus.monitored_bus import MonitoredBus
    bus = Bus('bus', '', '/does/not/exist', Settings())
    watched = MonitoredBus(bus, Models(), Recorders(None, None), 0.0)
    listener = watched.listener
    assert not watched.is_late(1 * S)            # nothing is open
    listener.state = ListenerState(True)
    listener.listened = 10 * S
    assert [watched.is_late(now) for now in (10 * S + S // 2, 20 * S)] == [False, True]
    listener.listened = 20 * S
    assert not watched.is_late(20 * S + S // 10)
    assert [watched.is_late(now * S) for now in (30, 32, 33, 60)] == [True, True, False, False]
    assert 'its reader is not responding' in watched.port_state().warning
    watched.monitor.feed(encode(1, STATUS, error=0), 20 * S)
    assert watched.report(60 * S).devices[0].state == 'silent'
    listener.listened = 61 * S
    assert not watched.is_late(61 * S)
    assert not watched.port_state().warning
    listener.start()
    listener.stop()


def test_lost_and_found(tmp_path, heard, again):
    link = tmp_path / 'bus'
    with monitor([link]) as node:
        node.wait_for(f'{link}: is not there')
        heard.wait_status('dxl_monitor: bus', 'is not there', level=2)
        with fake_bus(link, '--devices', '1:MX-64'):
            heard.wait_status('dxl_monitor: 001', 'connected', level=0)
        node.wait_for('lost')
        heard.wait_status('dxl_monitor: bus', 'is not there', level=2)
        with fake_bus(link, '--devices', '1:MX-64'):
            heard.wait_status('dxl_monitor: bus', '1 of 1', level=0)


def test_a_bus_is_heard_on_the_adapter_of_another_program(tmp_path, heard):
    usb = tmp_path / 'usb'
    with monitor([f'usb:{usb}'], bauds='[0]') as node:
        node.wait_for(f'usb:{usb}: ')
        with fake_bus(tmp_path / 'bus', '--usbmon', str(usb), '--devices', '1-3:MX-64'):
            node.wait_for(f'usb:{usb}: listening to a stream of USB events')
            heard.wait_status('dxl_monitor: bus', '3 of 3 devices connected', level=0)
            assert values(heard.statuses['dxl_monitor: bus'])['Baud (bit/s)'] == '2000000'
        heard.wait_status('dxl_monitor: bus', f'usb:{usb}: ', level=2)


def test_who_opens_the_port_beside_it_is_named_at_once(tmp_path, heard):
    opens = 'import os, sys, time; os.open(sys.argv[1], os.O_NOCTTY); time.sleep(99)'
    link = tmp_path / 'bus'
    with fake_bus(link, '--devices', '1:MX-64') as fake:
        fake.wait_for('2000000 baud')
        with monitor([link]):
            heard.wait_status('dxl_monitor: bus', '1 of 1', level=0)
            begin = time.monotonic()
            with Program('', str(link), script=opens) as other:
                heard.wait_status('dxl_monitor: bus', f'(pid {other.pid}) has it open too',
                                  level=1)
            heard.wait_status('dxl_monitor: bus', '1 of 1', level=0)
            assert time.monotonic() - begin < INSPECT_EVERY_S / 2


@pytest.mark.parametrize('number', ENDINGS, ids=lambda number: number.name)
def test_every_ending_signal_ends_it_well(tmp_path, heard, again, number):
    with fake_bus(tmp_path / 'bus', '--devices', '1-20:MX-64'), \
            monitor([tmp_path / 'bus']) as node:
        node.wait_for('open at')
        node.signal(number)
        node.signal(number)
        assert node.exit_code(5.0) == 0
        assert 'Traceback' not in node.text


@pytest.mark.parametrize(('parameters', 'line'), yaml.safe_load(
    Path(__file__).with_name('monitor_mistakes.yaml').read_text(encoding='utf-8')))
def test_mistakes_are_one_line(ros, parameters, line):
    with monitor(['/dev/null-port'], **parameters) as node:
        assert node.exit_code() == 2
        [said] = node.lines
        assert said.startswith(f'dxl_monitor: {line}')
        assert '; ' in said


def test_ports_in_one_word_are_a_mistake(ros):
    with monitor(['/dev/a,/dev/b']) as node:
        assert node.exit_code() == 2
    assert node.lines == ["dxl_monitor: ports: '/dev/a,/dev/b' is the name of one port; write a "
                          "list: ports:=\"['/dev/a', '/dev/b']\""]


def test_time_without_a_clock_is_said(tmp_path, heard):
    with monitor([tmp_path / 'bus'], use_sim_time='true') as node:
        node.wait_for('WARN', 'use_sim_time: it is true and no node publishes /clock, ')
        heard.wait_status('dxl_monitor: bus', 'no node publishes /clock', level=2)


def test_statistics_begin_anew(tmp_path, heard, ros):
    with fake_bus(tmp_path / 'bus', '--devices', '1:MX-64'), monitor([tmp_path / 'bus']):
        heard.wait_status('dxl_monitor: 001', 'connected')
        wait(lambda: int(values(heard.statuses['dxl_monitor: bus'])['Packets']) > 2000)
        response = heard.call(ros.Trigger, '/dxl_monitor/reset_statistics')
        assert response.success
        wait(lambda: int(values(heard.statuses['dxl_monitor: bus'])['Packets']) < 2000)


def test_a_fault_is_in_a_file_and_so_is_what_is_asked_for(tmp_path, heard, ros):
    folder = tmp_path / 'faults'
    with fake_bus(tmp_path / 'bus', '--devices', '1-3:MX-64', '--fault', 'silent:2:2'), \
            monitor([tmp_path / 'bus'], flight_recorder=folder):
        wait(lambda: list(folder.glob('flight_*_002.txt')))
        response = heard.call(ros.Trigger, '/dxl_monitor/save_recording')
    assert response.success and Path(response.message).parent == folder
    [path] = folder.glob('flight_*_002.txt')
    result = subprocess.run([sys.executable, '-m', 'servobus.tools.dxl_doctor', path],
                            capture_output=True, text=True, check=False)
    assert re.search('002 before it does not answer|002, (unknown|no answer)', result.stdout)
    assert 'unplug all but 002' in result.stdout or 'no answer' in result.stdout


def test_a_lost_servo_is_one_line_in_the_log_and_its_return_another(tmp_path, heard):
    with fake_bus(tmp_path / 'bus', '--devices', '1-3:MX-64', '--fault', 'silent:3:6:6'), \
            monitor([tmp_path / 'bus'], devices="['1-3:MX-64']") as node:
        lost = node.wait_for('WARN', 'bus: 2 of 3 devices connected; lost: 003 (')
        assert node.wait_for('WARN', 'bus: 3 of 3 devices connected; back: 003')
        assert node.said('WARN', 'lost: ') == [lost]
