# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Half a minute of `scripts/bench --soak`, within the soak's limits; and what must fail it."""
import os
from pathlib import Path
import signal
import subprocess
import sys

import pytest

from rigs.harness import Child
from rigs.harness import family
from rigs.harness import Figure
from rigs.harness import own_mb

pytestmark = pytest.mark.ros
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
    from rigs.soak_figures import figures
    assert any('growth of memory' in line for line in soak.problems(figures({}, [], {})))


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


def said(hearing, stamp, topic, name, level=0, **values):
    """Let a status be heard; `values` by key, with _ for a space."""
    from diagnostic_msgs.msg import DiagnosticArray
    from diagnostic_msgs.msg import DiagnosticStatus
    from diagnostic_msgs.msg import KeyValue
    array = DiagnosticArray(status=[DiagnosticStatus(
        name=name, level=bytes([level]), message='as it is', values=[
            KeyValue(key=key.replace('_', ' '), value=str(value))
            for key, value in values.items()])])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(stamp, S)
    hearing.take(topic, array)


def all_said(hearing, stamp, *but):
    from rigs.soak_watch import WANTED
    for topic, name in WANTED:
        if (topic, name) not in but:
            state = {} if not name[-3:].isdigit() else {'State': 'connected'}
            said(hearing, stamp, topic, name if ':' in name else f'{name}: timing/x', **state)


@pytest.fixture
def hearing(ros):
    from rigs.soak_watch import Hearing
    return Hearing()


def test_an_old_status_is_silence(hearing):
    assert sorted(line.partition(', ')[0] for line in hearing.silent(BEGIN)) == [
        f'{node}: says nothing any more on {topic}' for node, topic in (
            ('dxl_monitor', '/diagnostics'), ('dxl_monitor', 'dxl/diagnostics'),
            ('dxl_monitor', 'dxl/timing'), ('vel2d_bridge', '/diagnostics'),
            ('vel2d_bridge', 'vel2d/timing'))]
    all_said(hearing, BEGIN)
    assert hearing.not_well(BEGIN) == []
    all_said(hearing, BEGIN + S, ('dxl/diagnostics', 'dxl_monitor: 003'))
    [line] = hearing.silent(BEGIN + S)
    assert line.startswith('dxl_monitor: 003: says nothing any more on dxl/diagnostics')


def test_a_verdict_is_false_both_ways(hearing):
    all_said(hearing, BEGIN)
    assert hearing.wrong(BEGIN) == []
    assert hearing.wrong(BEGIN, {5}) == ['dxl_monitor: calls 005 connected, which does not answer']
    said(hearing, BEGIN, 'dxl/diagnostics', 'dxl_monitor: 005', 2, State='disconnected')
    assert hearing.wrong(BEGIN, {5}) == []
    assert hearing.wrong(BEGIN) == ['dxl_monitor: calls 005 disconnected, which answers']
    said(hearing, BEGIN, 'dxl/diagnostics', 'dxl_monitor: 006', 1, State='waiting')
    assert hearing.denied == [(BEGIN, 5, 'disconnected')]


def test_a_count_is_steady_since_it_last_changed(hearing):
    for seconds, count in enumerate((7, 9, 9, 9)):
        said(hearing, BEGIN + seconds * S, 'dxl/diagnostics', 'dxl_monitor: bus', Bytes=count,
             Packet_Bytes=7, Noise_Bytes=1, Pending_Bytes=0)
    assert hearing.counted == (9, BEGIN + S, BEGIN + 3 * S)
    assert hearing.unaccounted == 1


def test_only_a_freeze_or_a_lost_port_explains_a_late_drive(hearing):
    link = '/diagnostics', 'vel2d_bridge: link'
    said(hearing, BEGIN, *link, State='open', Freezes=0)
    assert not hearing.explained(BEGIN, BEGIN + S)
    said(hearing, BEGIN + S, *link, State='open', Freezes=1)
    assert hearing.explained(BEGIN, BEGIN + S)
    assert not hearing.explained(BEGIN + 9 * S, BEGIN + 10 * S)
    said(hearing, BEGIN + 9 * S, *link, State='closed', Freezes=1)
    assert hearing.explained(BEGIN + 9 * S, BEGIN + 10 * S)


def test_a_machine_that_stands_still_buys_time(ros, monkeypatch):
    from rigs.soak_watch import Machine
    machine = Machine([])
    machine.stop()
    monkeypatch.setattr(machine, 'held_s', lambda: 5.0)
    assert machine.patience_s(2.0, held_s=5.0) == 2.0
    assert machine.patience_s(2.0, held_s=4.0) == 3.0
    assert machine.patience_s(2.0, held_s=0.0) == 6.0
