# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS graph of its own for each test process, and the fixtures that the ROS tests share."""
import ast
from collections import Counter
from collections import defaultdict
from contextlib import contextmanager
from functools import cache
import importlib
import logging
import os
from pathlib import Path
import re
import shutil
import signal
from statistics import median
import struct
import subprocess
import tempfile

import forked
from hypothesis import HealthCheck
from hypothesis import settings
import pytest
from realtime import Rerun

from mecarover_fakes.domain_lock import ReservedDomain
from mecarover_fakes.domain_lock import TESTS

# What scripts/test leaves to scripts/test --all, by mark; but the mark smoke is for both.
NOT_FIRST = {'realtime': 'judges what real processes do in time',
             'slow': 'takes more than ten seconds',
             'more': 'tries other dialects, sizes and seeds'}
IN_REST, IN_FIRST = 'scripts/test --all runs it', 'scripts/test runs it'


# The same examples in each run, and none judged by its time: chance is for fuzz/.
settings.register_profile('steady', derandomize=True, deadline=None, database=None,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('steady')


class Raise(logging.Handler):
    """Lets a test fail of an exception that the program survives."""

    def emit(self, record):
        raise record.exc_info[1]


def pytest_addoption(parser):
    parser.addoption('--part', choices=['first', 'rest'],
                     help='what scripts/test runs, or what it leaves out (default: all)')
    parser.addoption('--times', type=int, default=1, metavar='N',
                     help='how often signals, kills and the like are repeated (default 1)')
    parser.addoption('--fault-times', type=int, default=1, metavar='N',
                     help='how often each fault is tried (default 1; figures are from 10)')
    parser.addoption('--histories', type=int, default=1500, metavar='N',
                     help='how many random histories the bridge is driven through (default 1500; '
                          '10 000 take a minute)')


def pytest_configure(config):
    """Isolate this process and its children: before anything imports rclpy."""
    config.domain = ReservedDomain(TESTS, os.getpid())
    config.log_dir = tempfile.TemporaryDirectory(prefix='ros_log_', ignore_cleanup_errors=True)
    os.environ.update({
        'ROS_DOMAIN_ID': str(config.domain.number),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',      # for the loopback: see the profile
        'ROS_LOG_DIR': config.log_dir.name,
        'ROS_PYTHON_CHECK_FIELDS': '1',
        'RCUTILS_COLORIZED_OUTPUT': '0',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(Path(__file__).with_name('fast_discovery.xml')),
        # Processes that tests start find rigs, fuzz and benchmark, too.
        'PYTHONPATH': os.pathsep.join(filter(None, (str(Path(__file__).parent),
                                                    os.environ.get('PYTHONPATH')))),
    })
    os.environ.pop('ROS_LOCALHOST_ONLY', None)
    # The logger of servobus.internal_fault: tests of msg_defs go without.
    logging.getLogger('mecarover_serial').addHandler(Raise())
    config.left_out = Counter()
    config.pluginmanager.register(Rerun(), 'rerun')
    if os.environ.get('PYTEST_XDIST_WORKER') == 'gw2':
        os.nice(10)                     # at 19 another program's compiler stops it for minutes
    if config.pluginmanager.hasplugin('launch_testing'):
        os.environ['LAUNCH_TESTING_PLUGIN'] = 'yes'     # for test_launch.py
    # A script's background job ignores Ctrl-C, and so would every process that a test starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_unconfigure(config):
    forked.end()
    config.log_dir.cleanup()
    config.domain.release()


@cache
def marks(path):
    """Return the marks of a file with ros or realtime, by the name of a test; '': of all in it."""
    found, text = defaultdict(set), path.read_text()
    if not re.search(r'mark\.(ros|realtime)\b', text):
        return found                        # most files: parsing all takes a second
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            said = ' '.join(map(ast.unparse, node.decorator_list))
        else:
            said = ast.unparse(node) if isinstance(node, ast.Assign) else ''
        found[getattr(node, 'name', '')].update(re.findall(r'pytest\.mark\.(\w+)', said))
    return found


def group(root, nodeid):
    """Return 'ros' or 'realtime' for a test that needs the machine to itself, else ''."""
    file, _, test = nodeid.partition('::')
    found = marks(root / file)
    has = found[''] | found[test.partition('[')[0].rpartition('::')[2]]
    return 'ros' if 'ros' in has else 'realtime' if 'realtime' in has else ''


def left_out(item, part):
    """Return why a part leaves a test out, '' where it runs it."""
    why = '' if item.get_closest_marker('smoke') else next(
        (reason for mark, reason in NOT_FIRST.items() if item.get_closest_marker(mark)), '')
    if part == 'rest':
        return '' if why else IN_FIRST
    return why and f'{why}; {IN_REST}'


def pytest_collection_modifyitems(config, items):
    """Begin with the tests that go one by one: they take longest."""
    if part := config.getoption('--part'):
        reasons = [left_out(item, part) for item in items]
        config.left_out.update(filter(None, reasons))
        config.hook.pytest_deselected(
            items=[item for item, why in zip(items, reasons, strict=True) if why])
        items[:] = [item for item, why in zip(items, reasons, strict=True) if not why]
    items.sort(key=lambda item: [bool(item.get_closest_marker(mark))
                                 for mark in ('ros', 'realtime')], reverse=True)


def pytest_sessionfinish(session):
    if hasattr(session.config, 'workeroutput'):
        session.config.workeroutput['left_out'] = dict(session.config.left_out)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error):
    """Take over what a worker left out: each collects all tests, so all say the same."""
    node.config.left_out |= Counter(getattr(node, 'workeroutput', {}).get('left_out'))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """
    Let one worker take all tests with nodes, another all those with other processes.

    Two nodes on two cores are a robot; four are a machine that is too busy for its robot. These
    mostly wait. A third worker takes what they leave of the processor, for all other tests.
    """
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return group(config.rootpath, nodeid) or super()._split_scope(nodeid)

    return Scheduling(config, log)


def pytest_generate_tests(metafunc):
    """Repeat what must never fail once: every test that asks for `again`."""
    if 'again' in metafunc.fixturenames:
        metafunc.parametrize('again', range(metafunc.config.getoption('--times')))
    if 'recovery' in metafunc.fixturenames:
        metafunc.parametrize('recovery', range(metafunc.config.getoption('--fault-times')),
                             indirect=True)


RECOVERIES = defaultdict(list)


@pytest.fixture
def recovery(request):
    """Return what notes, for a fault, how many s it took until all was well again."""
    node = request.path.stem.removeprefix('test_faults_')
    return lambda fault, seconds: RECOVERIES[f'{node}: {fault}'].append(seconds)


def pytest_terminal_summary(terminalreporter, config):
    if RECOVERIES:
        terminalreporter.section('recovery times: median (min to max) of n, in s')
    for fault, seconds in RECOVERIES.items():
        terminalreporter.write_line(f'{fault:58} {median(seconds):6.3f}  ({min(seconds):.3f} to '
                                    f'{max(seconds):.3f}) of {len(seconds)}')
    show_left_out(terminalreporter, config.left_out)


def show_left_out(terminalreporter, deselected):
    """Print a line for each reason why tests did not run, with their number."""
    reasons = deselected + Counter(
        re.sub(r'^([Ss]kipped: ?)+', '', report.longrepr[2])
        for report in terminalreporter.stats.get('skipped', ()) if len(report.longrepr) == 3)
    if reasons:
        terminalreporter.section(f'{sum(reasons.values())} tests left out')
        for why, count in reasons.most_common():
            terminalreporter.write_line(f'{count:6}  {why}')


class SteppedClock:
    """A system clock that only the processes see that are started while it is faked."""

    def __init__(self, folder):
        self._library = folder / 'clock_step.so'
        self._file = folder / 'clock_step'
        source = Path(__file__).with_name('clock_step.c')
        subprocess.run(['cc', '-shared', '-fPIC', '-O2', '-o', self._library, source, '-ldl'],
                       check=True)

    def step(self, seconds):
        """Set it so many seconds off."""
        with open(self._file, 'r+b') as file:
            file.write(struct.pack('=q', seconds))

    @contextmanager
    def faked(self):
        self._file.write_bytes(bytes(8))
        environment = {'LD_PRELOAD': str(self._library), 'CLOCK_STEP': str(self._file)}
        os.environ.update(environment)
        try:
            yield
        finally:
            for name in environment:
                del os.environ[name]


@pytest.fixture
def clock(tmp_path):
    if shutil.which('cc') is None:
        pytest.skip('skipped: no C compiler for clock_step.c')
    return SteppedClock(tmp_path)


@pytest.fixture
def meeting_place():
    """Return a folder with a path that is short enough for a Unix socket."""
    with tempfile.TemporaryDirectory(prefix='tap_') as place:
        yield place


@pytest.fixture(scope='session')
def ros():
    """Return the module ros_side; without ROS the test is skipped."""
    pytest.importorskip('rclpy', reason='skipped: no ROS 2 here')
    return importlib.import_module('ros_side')


@pytest.fixture(scope='session')
def graph(ros):
    """Return an operator in the ROS graph, for the whole session."""
    with ros.Graph('operator') as graph:
        yield graph


@pytest.fixture(scope='module')
def mcu(tmp_path_factory):
    """Return a running fake MCU that remembers; its port is `path`."""
    from running_bridge import Mcu  # tests of most packages go without
    with Mcu(str(tmp_path_factory.mktemp('dev') / 'mcu')).running() as mcu:
        yield mcu


@pytest.fixture(scope='module')
def cmd_vel(graph):
    """Return a publisher of commands; the next module's bridge does not meet it."""
    publisher = graph.publisher(heard=False)
    yield publisher
    graph.node.destroy_publisher(publisher)
