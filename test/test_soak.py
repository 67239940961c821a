# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Half a minute of `scripts/bench --soak`, within the soak's limits; and what must fail it."""
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
from unittest.mock import MagicMock

import pytest

from rigs.harness import Child
from rigs.harness import family
from rigs.harness import Figure
from rigs.harness import own_mb

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
COMMAND = [sys.executable, '-m', 'benchmark', '--soak', '0.5']
ROOT = Path(__file__).parents[1]
BEGIN, S = 1_000_000_000_000, 1_000_000_000


def test_half_a_minute_with_faults(ros):
    done = subprocess.run(COMMAND, text=True, capture_output=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'stops too late' in done.stdout


def test_a_bridge_that_is_killed_fails_it(ros):
    with subprocess.Popen(COMMAND, text=True, cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as soak:
        try:
            assert any('faults from now on' in line for line in soak.stderr)
            os.kill(child_of(soak.pid, 'vel2d_bridge.main'), signal.SIGKILL)
            out, err = soak.communicate()
        finally:
            soak.terminate()        # it ends its nodes; nothing if it has ended
    assert soak.returncode == 1, out + err
    assert 'soak: vel2d_bridge: ended with signal 9' in err
    assert 'nodes ended: 1, at most 0 is right' in err


def child_of(pid, module):
    [found] = [one for one in family(pid)
               if module in Path(f'/proc/{one}/cmdline').read_text().split('\0')]
    return found


def test_what_exceeds_a_limit_is_a_problem(ros):
    from rigs import soak
    names = ('growth of memory, bridge', 'faults', 'nodes ended')
    assert soak.problems([Figure('soak', name, '', [5.0]) for name in names]) == [
        'nodes ended: 5, at most 0 is right']
    assert soak.problems([Figure('soak', 'nodes ended', '', [float('nan')])])


def test_what_proves_nothing_is_a_problem(ros):
    from rigs import soak
    assert soak.problems([Figure('soak', name, '', [0.0]) for name in ('drives', 'faults')]) == [
        'drives: 0, less than 1 proves nothing']
    assert math.isnan(soak.growth([]))
    assert soak.growth([1.0, 9.0, 2.0]) == 1.0


def test_a_zombie_is_not_alive():
    with Child('json.tool') as child:         # waits for its input
        assert family(child.pid) == [child.pid]
        assert child.end == ''
        os.kill(child.pid, signal.SIGKILL)
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)     # ended, and still listed
        assert Path(f'/proc/{child.pid}').exists()
        assert family(child.pid) == []
        assert child.end == 'signal 9'


def test_memory_is_what_a_process_filled():
    me = [os.getpid()]
    before = own_mb(me)
    filled = bytearray(b'x' * 30_000_000)
    assert 25 < own_mb(me) - before < 60
    assert own_mb([*me, *me]) > 1.9 * before
    del filled


def said(watch, stamp, topic, name, **values):
    """Let a status be heard; `values` by key, with _ for a space."""
    from diagnostic_msgs.msg import DiagnosticArray
    from diagnostic_msgs.msg import DiagnosticStatus
    from diagnostic_msgs.msg import KeyValue
    array = DiagnosticArray(status=[DiagnosticStatus(name=name, level=b'\0', values=[
        KeyValue(key=key.replace('_', ' '), value=str(value)) for key, value in values.items()])])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(stamp, S)
    watch.accept_statuses(topic, array)


def test_an_old_status_and_a_lost_device_are_silent(ros, monkeypatch):
    from rigs import soak_watch
    monkeypatch.setattr(soak_watch, 'rclpy', MagicMock())
    watch = soak_watch.Watch()
    watch.stop()
    assert len(watch.silent(BEGIN)) == len(soak_watch.WANTED)
    for topic, name in soak_watch.WANTED:
        said(watch, BEGIN, topic, name if ':' in name else f'{name}: timing/x', State='connected')
    assert watch.not_well(BEGIN) == []
    said(watch, BEGIN + S, 'dxl/diagnostics', 'dxl_monitor: 003', State='disconnected')
    lost = 'dxl_monitor: 003: not heard on dxl/diagnostics, or disconnected'
    assert lost in [line.partition(', for')[0] for line in watch.silent(BEGIN + S)]
    said(watch, BEGIN, 'dxl/diagnostics', 'dxl_monitor: bus', Bytes=9, Packet_Bytes=7,
         Noise_Bytes=0, Pending_Bytes=1)
    assert watch.unaccounted == 1


def test_a_machine_that_stops_us_buys_time(ros, monkeypatch):
    from rigs.soak_watch import Machine
    machine = Machine([])
    machine.stop()
    monkeypatch.setattr(machine, 'held_s', lambda: 5.0)
    assert [machine._patience_s(2.0, held_s=held) for held in (5.0, 4.0, 0.0)] == [2.0, 3.0, 6.0]
