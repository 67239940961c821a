# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
python -m fuzz.whole --seconds N: bytes of any source through the whole program, with its time.

A case goes through the node (listener, monitor, doctor, recorder, its timers, all that it
publishes), through the dashboard that hears the node, and, as a file, through two of the tools;
all in this process. An exception is a fault, but for the one line that a user gets, and so are a
byte that is not in exactly one counter and an output that is not what it promises to be. Each
fault is told once, made small, with the command that shows it again; the exit code is 1 then.
"""

import argparse
from contextlib import ExitStack
from contextlib import redirect_stderr
from contextlib import redirect_stdout
from importlib import import_module
import io
import json
import logging
import os
from pathlib import Path
import random
import sys
import tempfile
import time
import traceback
from types import SimpleNamespace
from unittest.mock import MagicMock
from unittest.mock import patch

from dxl_monitor import timers
from dxl_monitor.fake.usb_adapter import FakeAdapter
from dxl_monitor.fake.usb_adapter import FAMILIES
from dxl_monitor.model.models import Models
from dxl_monitor.port.listener import Listener
from dxl_monitor.port.listener import ListenerState
from dxl_monitor.record import live
from dxl_monitor.record.capture import Reader
from dxl_monitor.record.capture import STAMP_END
from dxl_monitor.settings import PARAMETERS
from dxl_monitor.tools import replay
from dxl_monitor.tools.doctor import main as doctor
from dxl_monitor.tools.dump import main as dump
from dxl_monitor.tools.dump import session
from fuzz.dashboard import cdr
from fuzz.whole_traffic import BOOT
from fuzz.whole_traffic import case_of
from fuzz.whole_traffic import damaged
from fuzz.whole_traffic import FAR
from fuzz.whole_traffic import PROTOCOLS
from fuzz.whole_traffic import S
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.lines import Board
from mecarover_dashboard.lines import screen
from mecarover_dashboard.metrics import exposition
from mecarover_dashboard.recorder import HistoryRecorder
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TOPICS
from msg_defs.heard import OUT

os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'      # messages look for it when they are imported
dxl_node = import_module('dxl_monitor.node')
MODELS = Models()
ROOT = Path(__file__).parents[1]
OPEN = []                          # listeners
WALL = 1_790_000_000 * S
TRIES = 60                         # to make a case smaller
DUMP = (['--json'], ['--summary'], ['--changes'], ['--stats'], ['--errors'], ['--full'],
        ['--id', '1,3'], ['--about', '2-5'], ['--instruction', 'read,status,0x83'],
        ['--count', '5'], ['-t', 'clock'], ['-t', 'epoch'], ['--color', 'always'], ['-b', '57600'],
        ['--devices', '1-6:XL430-W250'], ['--seconds', '0.5'])


def print_nothing(text):
    assert str(text) or text == 0


class Ear(Listener):
    """A listener that hears what it is given; its port is open at once."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.after = lambda: None      # what comes once it has begun
        OPEN.append(self)

    def start(self):
        self.state = ListenerState(True, '', f'{self.port}: open')
        self._openings += 1
        self.after()

    def stop(self):
        if self in OPEN:
            OPEN.remove(self)
            os.close(self._wake_read)
            os.close(self._wake_write)

    def hear(self, one, stamp):
        if one.change is not None:
            self._on_change(one.change, stamp)
        elif one.side:
            self._hear_pieces([(one.data, stamp, one.side)])
        else:
            self._hear(one.data, stamp)


class Dashboard:
    """The page, mecarover_status, /metrics and the history, from what the node publishes."""

    def __init__(self, is_on):
        self.is_on = is_on
        self.state, self.board = State(), Board(every_device=True)
        self.recorder, self.version, self.history = HistoryRecorder(), 0, HistoryWriter(':memory:')

    def take(self, topic, message, now_s):
        if self.is_on and topic in TOPICS:
            data = cdr([(one.level[0], one.name, one.message, one.hardware_id,
                         [(pair.key, pair.value) for pair in one.values])
                        for one in message.status])
            self.state.take(topic, data, now_s)
            self.board.take(data, now_s)

    def look(self, now_s):
        if not self.is_on:
            return
        state = self.state
        state.expire(now_s)
        said = [state.changes(self.version), state.topics(now_s)]
        for one in list(state.reports('devices'))[:3]:
            said += [state.table(one.row_name), state.latency(one.row_name, 0.0)]
        json.dumps(said, allow_nan=False)
        self.version = state.version
        exposition(state, 'application/openmetrics-text')
        assert all(line.isprintable() for line in screen(self.board.lines(now_s)))
        self.recorder.look(state, now_s, now_s + 1e9)
        self.history.write(*self.recorder.taken())
        assert not state.malformed


def through_node(case, folder):
    """Let the node hear a case while its time goes by; return the capture that it writes."""
    clock = SimpleNamespace(now=BOOT)
    page = Dashboard(is_on=len(case.heard) % 3 == 0)       # it costs as much as all else
    values = {one.name: one.default for one in PARAMETERS} | {
        'ports': [f'tap:{at}' for at, _ in enumerate(case.names)], 'names': list(case.names),
        'bauds': [case.baud], 'protocols': [case.protocol], 'joint_state_rate': 20.0,
        'devices': [f'{case.names[0]}/{one}' if len(case.names) > 1 else one
                    for one in case.devices],
        'capture': str(folder / 'bus.txt'), 'timing_topics': 'all'}
    log = SimpleNamespace(info=print_nothing, warning=print_nothing, error=print_nothing)
    ros = MagicMock(
        get_fully_qualified_name=lambda: '/rover/dxl_monitor', get_logger=lambda: log,
        get_clock=lambda: SimpleNamespace(
            now=lambda: SimpleNamespace(nanoseconds=WALL + clock.now)),
        create_publisher=lambda kind, topic, *_, **__: SimpleNamespace(
            publish=lambda message: page.take(topic, message, clock.now / 1e9),
            get_subscription_count=lambda: 1))
    stopped = SimpleNamespace(monotonic=lambda: clock.now / 1e9, time_ns=lambda: WALL + clock.now,
                              monotonic_ns=lambda: clock.now)
    with ExitStack() as changed:
        for name, value in (('Node', lambda *_: ros), ('declare', lambda *_: values),
                            ('load_models', lambda _: MODELS), ('listener_on', Ear),
                            ('Clock', lambda **_: None), ('resident_memory_mb', lambda: 50.0),
                            ('time', stopped), ('overridable_publisher',
                                                lambda node, *rest: node.create_publisher(*rest))):
            changed.enter_context(patch.object(dxl_node, name, value))
        changed.enter_context(patch.object(timers, 'time', stopped))
        changed.enter_context(patch.object(timers.Timers, 'start', lambda _: None))
        changed.enter_context(patch('dxl_monitor.record.recorder.Recorder.start', lambda _: None))
        node = dxl_node.MonitorNode()
        fed = [0] * len(case.names)
        written = []
        for one in (*case.heard, None):
            pause = 2 * S if one is None else one.after_ns
            for part in (pause // 3, pause - pause // 3) if pause > 100_000_000 else ():
                clock.now += part
                for bus in node._buses:
                    bus.listener._idle(clock.now)
                node._timers.turn(clock.now / 1e9)
                page.look(clock.now / 1e9)
            if one is not None:
                clock.now += pause if pause <= 100_000_000 else 0
                stamp = clock.now if one.stamp is None else one.stamp
                node._buses[one.bus].listener.hear(one, stamp)
                fed[one.bus] += len(one.data)
                written.append((stamp, one.data, one.side, one.change))
            node._timers.turn(clock.now / 1e9)
        for bus, size in zip(node._buses, fed, strict=True):
            all_counted(bus.report(clock.now).counters, size)
        node._reset_statistics(None, SimpleNamespace())
        node._timers.turn(clock.now / 1e9 + 1)
        page.look(clock.now / 1e9)
        page.look(clock.now / 1e9 + 70)
        node._recorder._is_stopping.set()
        node._recorder._run()
        assert not node._recorder.problem, node._recorder.problem
        node.stop()
    page.history.close()
    data = (folder / 'bus.txt').read_bytes()
    if all(0 <= one[0] < STAMP_END for one in written):
        reader = Reader(io.BytesIO(data))
        assert [(one.stamp, *one[2:]) for one in reader] == [
            one for one in written if one[1] or one[3]]
    return data


def all_counted(counters, fed):
    assert counters['Bytes'] == fed, (counters, fed)
    assert fed == sum(counters[f'{kind} Bytes'] for kind in ('Packet', 'Noise', 'Pending'))
    assert min(counters.values()) >= 0, counters
    assert 6 * counters['Packets'] <= counters['Packet Bytes'] <= 1031 * counters['Packets']


def through_tools(case, capture, folder, chance):
    """Let two of the tools read a case as a file, or hear it as a port."""
    path = folder / 'heard'
    path.write_bytes(chance.choice(FORMS)(case, capture, chance))
    for _ in range(2):
        chance.choice((run_dump, run_dump, run_doctor, run_replay))(case, str(path), chance)


def usb(case, capture, chance):
    """Return it as the events of an adapter."""
    adapter = FakeAdapter(chance.choice(sorted(FAMILIES)))
    now = WALL if chance.random() < 0.9 else abs(chance.choice(FAR))
    whole = adapter.plug(now) + adapter.set_baud(case.baud or 9600, now)
    for one in case.heard:
        now += one.after_ns
        tell = adapter.sent if one.side == OUT else adapter.received
        if one.data:
            whole += tell(one.data, now if one.stamp is None else max(0, one.stamp))
    return whole


def raw(case, capture, chance):
    return b''.join(one.data for one in case.heard)


def spoilt(case, capture, chance):
    """Return a file of any form with something wrong in it."""
    data = chance.choice(FORMS[:3])(case, capture, chance)
    for _ in range(chance.choice((1, 5, 30))):
        at = chance.randrange(len(data) + 1)
        data = data[:at] + damaged(chance, data[at:at + 40]) + data[at + 40:]
    return data


FORMS = (lambda case, capture, chance: capture, usb, raw, spoilt)


def run_dump(case, path, chance):
    options = [part for one in chance.sample(DUMP, chance.choice((0, 1, 1, 2, 4))) for part in one]
    if chance.random() < 0.3:
        options += ['--protocol', chance.choice(PROTOCOLS)]
    if chance.random() < 0.4:
        options += ['-w', f'{path}.again']
    code, out = tool(dump, case, path, options, chance)
    if '--json' in options and not {'--changes', '--stats'} & {*options} and code == 0:
        *_, last = [{}, *map(json.loads, out.splitlines())]
        assert '--summary' not in options or last['bytes'] >= last['noise_bytes'] >= 0


def run_doctor(case, path, chance):
    options = chance.choice(([], ['--json'], ['--report', f'{path}.report']))
    code, out = tool(doctor, case, path, options, chance)
    if '--json' in options and out:
        json.loads(out)
    if '--report' in options and Path(f'{path}.report').exists():
        again, _ = tool(doctor, None, f'{path}.report', [], chance)
        assert again == code, (again, code)
        Path(f'{path}.report').unlink()
    text = ascii(case.names[0]) + chance.choice(('', 'no status packet', 'TxRxResult', 'timeout'))
    tool(doctor, None, '', ['--explain', text], chance)


def run_replay(case, path, chance):
    with open(os.devnull, 'wb') as nowhere, patch.object(
            replay, 'Pty', lambda link: SimpleNamespace(
                is_open=True, link=None, path='/dev/pts/9', master=nowhere.fileno(),
                let_go=lambda: None, close=lambda: None)), patch.object(
            replay, 'time', SimpleNamespace(monotonic=lambda: 0.0, sleep=print_nothing)):
        tool(replay, None, path, chance.choice((['--speed', '0'], ['--side', 'out'], [])), chance)


def tool(module, case, path, options, chance):
    """Run a tool on a file, or on a port where the case is heard; return its code and output."""
    def listener_on(*arguments, **more):
        ear = Ear(*arguments, **more)
        ear.after = lambda: [ear.hear(one, BOOT + at) for at, one in enumerate(case.heard)]
        return ear

    def end(_):
        raise KeyboardInterrupt            # as a user does when nothing comes any more

    if case is not None and chance.random() < 0.2:
        path = 'tap:x'
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding='utf-8') for _ in range(2))
    out.isatty = lambda: path == 'tap:x'
    name = 'dxl_' + module.__name__.replace('.main', '').rpartition('.')[2]
    with redirect_stdout(out), redirect_stderr(err), patch.object(
            sys, 'argv', [name, *options, *filter(None, [path])]), patch.object(
            session, 'load_models', lambda _: MODELS), patch.object(
            doctor, 'load_models', lambda _: MODELS), patch.object(
            live, 'listener_on', listener_on), patch.object(live, 'TICK_S', 0), patch.object(
            live.LivePort, '_tell_state', end):
        code = module.main()
    out.seek(0)
    err.seek(0)
    said = out.read()
    assert code in (0, 1, 2, 3, 4), code
    assert all(line.startswith(f'{name}: ') for line in err) or code == 2
    return code, said


def run(case, seed):
    """Run a case; what it raises is a fault."""
    try:
        with tempfile.TemporaryDirectory(prefix='whole_') as folder:
            capture = through_node(case, Path(folder))
            through_tools(case, capture, Path(folder), random.Random(seed))
    finally:
        for ear in OPEN[:]:
            ear.stop()


class Raise(logging.Handler):
    """Lets no exception be passed over that the program tells of and survives."""

    def emit(self, record):
        if record.exc_info and record.exc_info[1]:
            raise record.exc_info[1]


def fault_of(case, seed):
    """Return where a case fails and the exception, ('', None) if it does not."""
    try:
        run(case, seed)
    except Exception as error:
        ours = [one for one in traceback.extract_tb(error.__traceback__)
                if one.filename.startswith(str(ROOT))]
        inner = [one for one in ours if '/fuzz/' not in one.filename] or ours
        if isinstance(error, AssertionError):
            inner = ours
        return f'{type(error).__name__} {Path(inner[-1].filename).relative_to(ROOT)} ' \
               f'{inner[-1].lineno}', error
    return '', None


def smaller(case, seed, where):
    """Return what is left of a case when chunks without a part in its fault are taken out."""
    heard, size, tries = list(case.heard), max(1, len(case.heard) // 2), TRIES
    while size and tries:
        at = 0
        while at < len(heard) and tries:
            tries -= 1
            less = heard[:at] + heard[at + size:]
            if fault_of(case._replace(heard=tuple(less)), seed)[0] == where:
                heard = less
            else:
                at += size
        size //= 2
    return case._replace(heard=tuple(heard))


def main():
    options = _parser().parse_args()
    logging.getLogger('mecarover_serial').addHandler(Raise())
    found, count, seed = set(), 0, options.seed * 1_000_000
    if options.case is not None:
        where, error = fault_of(case_of(options.case), options.case)
        traceback.print_exception(error)
        return int(bool(where))
    while time.process_time() < options.seconds and count < options.cases:
        count, seed = count + 1, seed + 1
        case = case_of(seed)
        where, error = fault_of(case, seed)
        if where and where not in found:
            found.add(where)
            print(f'{time.process_time():.0f} s, case {count}: {where}: {str(error)[:200]}; '
                  f'again: python -m fuzz.whole --case {seed}', flush=True)
            if options.small:
                print(*smaller(case, seed, where).heard, sep='\n', flush=True)
    spent = time.process_time()
    print(f'{count} cases in {spent:.0f} s, {count / spent:.1f} a second, '
          f'from seed {options.seed}: {len(found)} faults')
    return int(bool(found))


def _parser():
    parser = argparse.ArgumentParser(prog='python -m fuzz.whole', description=(
        'Feed bytes of any source through node, dashboard and tools in one process.'))
    add = parser.add_argument
    add('--seconds', type=float, default=60, help='how long, CPU time (default %(default)g)')
    add('--cases', type=float, default=float('inf'), metavar='N', help='how many at most')
    add('--seed', type=int, default=1, help='where to begin (default %(default)s)')
    add('--case', type=int, metavar='N', help='this case only, and show what breaks')
    add('--small', action='store_true', help='take out of a case what has no part in its fault')
    return parser


if __name__ == '__main__':
    sys.exit(main())
