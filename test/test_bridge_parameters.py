# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the bridge: what a user reads, changes while driving, and gets wrong."""
from contextlib import ExitStack
import fcntl
from itertools import pairwise
import math
import os
from pathlib import Path
import random
import shutil
import signal
import subprocess
import time

from harness import DEADLINE_S
from harness import Program
from harness import ROOT
import pytest
from running_bridge import bridge
from running_bridge import Mcu
import yaml

from msg_defs.vel2d import STOP
from servobus.port.pty import Pty
from vel2d_bridge.bridge_settings import PARAMETERS

pytestmark = [pytest.mark.ros, pytest.mark.realtime(bears=0.1)]
NODE = '/vel2d_bridge'
CONFIG = ROOT / 'config' / 'bridge.yaml'
# Root may open any file; without this capability it has to obey as everybody else.
OBEDIENT = ('setpriv', '--bounding-set=-dac_override') if os.geteuid() == 0 else ()
REFUSED = (                     # parameter, value, part of the reason
    ('max_rate', 1000.0, 'range'),
    ('max_rate', 0.5, 'range'),
    ('max_rate', 'fast', 'set a double in Hz (>= 2, <= 400), e.g. 30.0'),
    ('max_rate', [30.0, 31.0], 'set a double in Hz'),
    ('max_rate', True, 'set a double in Hz'),
    ('max_rate', float('nan'), 'range'),
    ('resend_rate', 1.0, 'is not possible; set a double in Hz'),
    ('cmd_vel_timeout', 0.01, 'set a double in s (>= 0.05, <= 10 or 0), e.g. 0.5'),
    ('max_linear_x', -1.0, 'range'),
)


@pytest.fixture(scope='module')
def running(mcu):
    """Run a bridge with the file of defaults; an argument wins over it."""
    with Program('vel2d_bridge.main', '--ros-args', '--params-file', str(CONFIG),
                 '-p', f'port:={mcu.path}', '-p', 'cmd_vel_timeout:=1') as running:
        running.wait_for('open at 115200 baud')
        yield running
        assert 'Traceback' not in running.text


def test_every_parameter_describes_itself(graph, running):
    descriptors = graph.describe(NODE, [parameter.name for parameter in PARAMETERS])
    for parameter in PARAMETERS:
        one = descriptors[parameter.name]
        assert one.read_only != parameter.run_time
        assert parameter.description in one.description
        for text in (parameter.unit, parameter.range_text):
            assert text in one.description
        ranges = [*one.floating_point_range, *one.integer_range]
        assert len(ranges) == (parameter.maximum < math.inf)
        assert not ranges or ranges[0].to_value == parameter.maximum
    assert not running.said('no such parameter')
    assert {parameter.name for parameter in PARAMETERS} <= set(graph.parameters(NODE))


def test_an_integer_is_stored_as_the_double_that_is_wanted(graph, running):
    """From the command line and at run time: who reads double_value of an integer reads 0."""
    assert graph.get(NODE, ['cmd_vel_timeout']) == [1.0]
    doubles = [one for one in PARAMETERS if isinstance(one.default, float) and one.run_time]
    for one in doubles:
        whole = math.ceil(one.minimum)
        assert graph.set(NODE, **{one.name: whole}) == ['']
        [stored] = graph.get(NODE, [one.name])
        assert (stored, type(stored)) == (whole, float)
        assert graph.set(NODE, **{one.name: one.default}) == ['']
    assert len(doubles) == 8
    [stored] = graph.get(NODE, ['cmd_vel_timeout'])
    assert type(stored) is float


@pytest.mark.parametrize(('name', 'value', 'reason'), REFUSED)
def test_refused_with_a_reason(graph, running, name, value, reason):
    [said] = graph.set(NODE, **{name: value})
    assert name in said
    assert reason in said


def test_read_only_is_refused(graph, running):
    for parameter in PARAMETERS:
        if not parameter.run_time:
            [said] = graph.set(NODE, **{parameter.name: parameter.default})
            assert 'read-only' in said
            assert said.endswith('write it to the settings file, or give it with -p, and start '
                                 'the node again')


@pytest.mark.parametrize('zero', [0, 0.0])
def test_holding_for_ever_is_refused_at_run_time(graph, running, zero):
    [before] = graph.get(NODE, ['cmd_vel_timeout'])
    [said] = graph.set(NODE, cmd_vel_timeout=zero)
    assert said.startswith('cmd_vel_timeout: 0 holds the last command for ever and is accepted ')
    assert '; set 0.5, or write 0 to the settings file and restart' in said
    assert graph.get(NODE, ['cmd_vel_timeout']) == [before]


def test_what_is_risky_is_said_once(graph, mcu, running):
    for _ in range(2):
        assert graph.set(NODE, resend_rate=0) == ['']
    running.wait_for('WARN', 'resend_rate: 0 sends each set-point once')
    assert graph.set(NODE, resend_rate=20) == ['']
    assert len(running.said('resend_rate: 0 sends')) == 1


def test_holding_for_ever_is_taken_at_a_start_and_said(graph, tmp_path):
    with bridge(tmp_path / 'mcu', '-r', '__node:=held', cmd_vel_timeout=0) as running:
        running.wait_for('WARN', 'cmd_vel_timeout: 0 holds the last command for ever')
        graph.wait_status('held: commands', 'cmd_vel_timeout: 0 holds', level=1)
        assert graph.get('/held', ['cmd_vel_timeout']) == [0.0]


@pytest.mark.parametrize(('node', 'module'), [('vel2d_bridge', 'vel2d_bridge.main'),
                                              ('dxl_monitor', 'dxl_monitor.start')])
def test_a_settings_file_for_another_node_is_refused(tmp_path, node, module):
    """A typo in its header, another namespace: the limits in it would not be in force."""
    mine, other = tmp_path / 'mine.yaml', tmp_path / 'other.yaml'
    mine.write_text(f'/rover1/{node}:\n  ros__parameters: {{timing_topics: all}}\n')
    other.write_text('planner:\n  ros__parameters: {a: 1}\n')
    words = ['--ros-args', '--params-file', str(mine), '--params-file', str(other)]
    with Program(module, *words) as running:
        assert running.exit_code() == 2
    [line] = running.said(f'{node}: ')
    assert line.startswith(f'{node}: {mine}, {other}: has no parameters for the node /{node}, it '
                           f'is for /rover1/{node}, /planner; put them below /{node}: or /**:')
    with Program(module, *words, '-r', '__ns:=/rover1') as running:
        running.wait_for('is not there')


def random_change(rng):
    """Return one valid change, of those that leave commands at 100 Hz as they are."""
    name, low, high = rng.choice([
        ('max_rate', 200, 400), ('cmd_vel_timeout', 1, 10), ('max_linear_x', 50, 100),
        ('max_linear_y', 0, 100), ('max_angular_z', 0, 100), ('max_stamp_age', 0, 3600),
        ('write_timeout', 0.5, 1)])             # a busy machine holds up the fake MCU
    return {name: rng.uniform(low, high)}


def test_200_changes_while_driving_at_100_hz(ros, graph, tmp_path):
    """
    Every command becomes one frame, in order.

    But for those that came in a bunch, because the machine was busy: only their last one does,
    which is counted. When it stood still for so long that the bridge was frozen, what came then
    is refused, which is counted, or not even heard, as the bridge subscribes again. Without
    resends, as these are frames that repeat a command on purpose.
    """
    rng = random.Random(6)
    node, commands = '/tuned/tuned', 'tuned/tuned: commands'
    count = iter(range(1, 100_000))
    with Mcu(str(tmp_path / 'mcu')).running() as mcu, bridge(
            mcu, '-r', '__ns:=/tuned', '-r', '__node:=tuned',
            '-p', 'qos_overrides./tuned/cmd_vel.subscription.depth:=100',
            max_rate=400, resend_rate=0, write_timeout=1) as running:
        running.wait_for('open at')
        publisher = graph.publisher('/tuned/cmd_vel', profile=ros.qos(100))
        with ros.Teleop(publisher, lambda: ros.twist(next(count) / 1000), rate=100) as teleop:
            mcu.since(0, 10)
            for _ in range(200):
                change = random_change(rng)
                assert graph.set(node, **change) == [''], change
            for name, value, _ in REFUSED:
                assert graph.set(node, **{name: value}) != [''], name
        assert publisher.wait_for_all_acked(ros.Duration(seconds=DEADLINE_S))
        assert graph.set(node, cmd_vel_timeout=0.5) == ['']
        graph.wait_status(commands, 'State=stopped')
        values = graph.values(commands)
        frames = [frame.velocity.x for frame in mcu.arrivals if frame.velocity.x]
        assert running.said('ERROR') == []
    assert all(before < after for before, after in pairwise(frames))
    received, *missing = (int(values[key]) for key in (
        'Commands received', 'Commands replaced', 'Refused: bridge was frozen'))
    assert len(frames) + sum(missing) == received, values
    assert received == teleop.sent or int(values['Stops: bridge was frozen']), values
    assert values['Commands limited'] == '0'


def blocked_port(path):
    """Open a port as another program that locks it does."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    return fd


def test_ports_that_cannot_be_used_yet(ros, graph, tmp_path):
    """Absent, forbidden, busy: one clear line, it keeps running, and recovers by itself."""
    link = tmp_path / 'mcu'
    tmp_path.chmod(0o755)
    with Pty() as forbidden, Pty() as busy, ExitStack() as stack:
        os.chmod(forbidden.path, 0)
        lock = blocked_port(busy.path)
        missing = stack.enter_context(bridge(str(link), '-r', '__ns:=/missing'))
        denied = stack.enter_context(
            bridge(forbidden.path, '-r', '__ns:=/denied', prefix=OBEDIENT))
        locked = stack.enter_context(bridge(busy.path, '-r', '__ns:=/locked'))
        line = missing.wait_for('ERROR', f'{link}: is not there')
        assert 'plug it in or set another port; ' in line
        line = denied.wait_for('ERROR', f'{forbidden.path}: a pty of user ')
        assert '; run both ends as one user' in line
        line = locked.wait_for('ERROR', f'{busy.path}: in use by ')
        assert f'(pid {os.getpid()}); stop that program' in line
        link.symlink_to('nowhere')
        missing.wait_for('ERROR', f'{link}: points to nowhere, which is not there')
        # Recovery: what was wrong is mended, and nothing is started by hand.
        link.unlink()
        with Mcu(str(link)).running() as mcu:
            os.chmod(forbidden.path, 0o666)
            os.close(lock)
            for running in (missing, denied, locked):
                running.wait_for('INFO', 'open at 115200 baud')
            mcu.since(0, 5)
        assert len(missing.said('is not there')) <= 3           # a change is said, not each try


SMALL = ['unshare', '--mount', 'sh', '-c', 'mount -t tmpfs -o size=64k none /dev/shm && exec "$@"',
         'sh', 'env', '-u', 'FASTRTPS_DEFAULT_PROFILES_FILE']


@pytest.mark.skipif(shutil.which('unshare') is None or subprocess.run(
    [*SMALL, 'true'], capture_output=True).returncode != 0,
    reason='skipped: not allowed to make a mount namespace')
def test_without_room_in_shared_memory_it_stops_the_rover_all_the_same(mcu):
    begin = time.monotonic_ns()
    with bridge(mcu, prefix=SMALL) as running:
        running.wait_for('/dev/shm: is full')
        assert all(frame.velocity == STOP for frame in mcu.since(begin, 6))
        running.signal(signal.SIGTERM)
        assert running.exit_code() == 0, running.text


@pytest.mark.parametrize(('options', 'code', 'line'), yaml.safe_load(
    Path(__file__).with_name('bridge_mistakes.yaml').read_text(encoding='utf-8')))
def test_mistakes_that_end_it(mcu, options, code, line):
    with bridge(mcu, **options) as running:
        assert running.exit_code() == code
    [said] = running.said('vel2d_bridge: ' + line)
    assert '; ' in said
    assert 'Traceback' not in running.text


def test_the_command_line_wins_over_a_file_of_another_type(graph, mcu, tmp_path):
    """For rcl the 1 and the 0.25 are two values, of which rclpy takes the integer."""
    file = tmp_path / 'mine.yaml'
    file.write_text('/**:\n  ros__parameters:\n    cmd_vel_timeout: 1\n    max_rate: 25\n')
    with bridge(mcu, '--params-file', str(file), '-r', '__node:=typed', cmd_vel_timeout=0.25):
        got = graph.get('/typed', ['cmd_vel_timeout', 'max_rate'])
        assert got == [0.25, 25]
    with bridge(mcu, '--params-file', str(file), max_rate='fast') as running:
        assert running.exit_code() == 2
        assert running.said("max_rate: 'fast' is not possible")


def test_mistyped_names_are_said(mcu):
    override = 'qos_overrides.{}.subscription.reliability'
    with bridge(mcu, bauds=9600, **{override.format('/cmdvel'): 'best_effort'}) as running:
        running.wait_for('WARN', 'bauds: no such parameter, ignored; did you mean baud?')
        running.wait_for('WARN', f'{override.format("/cmdvel")}: no such parameter, ignored; did '
                                 f'you mean {override.format("/cmd_vel")}?')
    with bridge(mcu, '-r', '__ns:=/rover', '-r', 'cmd_vel:=Drive',
                **{override.format('/rover/Drive'): 'best_effort'}) as running:
        running.wait_for('WARN', '/rover/Drive: no node publishes it')
        assert not running.said('no such parameter')


def test_a_console_on_the_port_is_said(ros, graph, tmp_path):
    """Preflight runs off the executor, and what it finds is on /diagnostics while driving."""
    script = ('import sys; from servobus.port import preflight; from vel2d_bridge import main\n'
              f'preflight.warnings.__defaults__ = (__import__("pathlib").Path({str(tmp_path)!r}),'
              ' ())\nsys.exit(main.main())')
    with Mcu(str(tmp_path / 'mcu')).running() as mcu:
        console = Path(os.path.realpath(mcu.path)).name
        (tmp_path / 'proc').mkdir()
        (tmp_path / 'proc/consoles').write_text(f'{console}  -W- (EC p a)  4:64\n')
        with bridge(mcu, '-r', '__node:=on_console', script=script) as running:
            running.wait_for('WARN', f'{mcu.path}: the kernel writes its console here; remove')
            graph.wait_status('on_console: link', 'the kernel writes its console here', level=1)


def test_help_and_no_ros():
    with Program('vel2d_bridge.main', '--help') as helping:
        assert helping.exit_code() == 0
    for parameter in PARAMETERS:
        assert helping.said(f'  {parameter.name}  (default {parameter.default!r}; ')
    script = ('import sys; sys.modules["rclpy"] = None; from vel2d_bridge import main\n'
              'sys.exit(main.main())')
    with Program('', script=script) as running:
        assert running.exit_code() == 1
    [line] = running.lines
    assert line.startswith('vel2d_bridge: ROS 2 is not sourced (')
    assert 'source /opt/ros/jazzy/setup.bash' in line
