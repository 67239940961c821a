# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A case through the node, with its time, and through the dashboard that hears what it says."""

from contextlib import ExitStack
from contextlib import redirect_stdout
from functools import lru_cache
from importlib import import_module
import io
import json
import os
import time
from types import SimpleNamespace
from unittest.mock import MagicMock
from unittest.mock import patch

from dxl_monitor import timers
from dxl_monitor.monitor_settings import PARAMETERS
from fuzz.dashboard import cdr
from fuzz.whole.traffic import BOOT
from fuzz.whole.traffic import S
from mecarover_dashboard import history_requests
from mecarover_dashboard import terminal
from mecarover_dashboard.history import HistoryReader
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import Question
from mecarover_dashboard.history_recorder import HistorySampler
from mecarover_dashboard.metrics import exposition
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TOPICS
from msg_defs.diagnostics import Metric
from msg_defs.event import Chunk
from servobus import monitor
from servobus import monitored_bus
from servobus.model.models import Models
from servobus.sources.capture import Reader
from servobus.sources.capture import STAMP_END
from servobus.sources.listener import Listener
from servobus.sources.listener import ListenerState

os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'      # messages look for it when they are imported
dxl_node = import_module('dxl_monitor.monitor_node')
MODELS = Models()
OPEN = []                          # listeners
WALL = 1_790_000_000 * S
MEMORY = Metric('resident_memory', 'MB', value=50.0)
ROS = MagicMock()                  # one for all cases: it takes long to make
# The same ones for all cases: they take a tenth of the time.
monitor.ModelGuesses = lru_cache(monitor.ModelGuesses)


def print_nothing(text):
    assert str(text) or text == 0


class FedListener(Listener):
    """A listener that hears what it is given; its port is open at once."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.after = lambda: None      # what comes once it has begun
        OPEN.append(self)

    def start(self):
        self.state = ListenerState(True, '', f'{self.port}: open')
        self.openings += 1
        self.after()

    def stop(self):
        if self in OPEN:
            OPEN.remove(self)
            self._pipe.close()

    def hear_chunk(self, one, stamp):
        self._deliver(Chunk(stamp, self._bus, one.data, one.side, one.change))


class Dashboard:
    """The page, mecarover_status, /metrics and the history, from what the node publishes."""

    def __init__(self, is_on, folder):
        self.is_on = is_on
        self.state = State()
        self.file = folder / 'history'
        self.recorder, self.version = HistorySampler(), 0
        self.history = HistoryWriter(self.file) if is_on else None
        self.terminal = terminal.Display(
            self.state, terminal.make_parser().parse_args(['--all']))

    def accept_message(self, topic, message, now_s):
        if self.is_on and topic in TOPICS:
            data = cdr([(one.level[0], one.name, one.message, one.hardware_id,
                         [(pair.key, pair.value) for pair in one.values])
                        for one in message.status])
            self.state.store_message(topic, data, now_s)

    def show_page(self, now_s):
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
        with redirect_stdout(io.StringIO()) as shown:
            self.terminal.show_state(now_s)
        assert all(line.isprintable() for line in shown.getvalue().splitlines())
        self.recorder.sample_state(state, now_s, now_s + 1e9)
        self.history.write(*self.recorder.take_batch())
        assert not state.malformed

    def ask_history(self):
        """Ask the history for all that it has, as the page and a spreadsheet do."""
        if self.is_on:
            self.history.close()
            reader = HistoryReader(self.file)
            asked = Question(0, 1e11 - 1)
            for points in (1, 600):
                json.dumps([answer(reader, asked._replace(points=points)) for answer in (
                    history_requests._values_json, history_requests._events_json)],
                    allow_nan=False)
            assert all(isinstance(cell, str) for answer in (
                history_requests._values_csv, history_requests._events_csv)
                       for row in answer(reader, asked) for cell in row)
            reader.close()


def through_node(case, folder):
    """Let the node hear a case while its time goes by; return the capture that it writes."""
    clock = SimpleNamespace(now=BOOT)
    page = Dashboard(len(case.heard) % 3 == 0, folder)       # it costs as much as all else
    values = {one.name: one.default for one in PARAMETERS} | {
        'ports': [f'tap:{at}' for at, _ in enumerate(case.names)], 'names': list(case.names),
        'bauds': [case.baud], 'protocols': [case.protocol], 'joint_state_rate': 20.0,
        'publish_rate': 1.0,
        'devices': [f'{case.names[0]}/{one}' if len(case.names) > 1 else one
                    for one in case.devices],
        'flight_recorder': str(folder / 'faults') if len(case.heard) % 4 == 0 else '',
        'capture': str(folder / 'bus.txt'), 'timing_topics': 'all',
        'capture_size': 0.002 if len(case.heard) % 5 == 0 else 100.0}
    log = SimpleNamespace(info=print_nothing, warning=print_nothing, error=print_nothing)
    ROS.reset_mock()
    ROS.configure_mock(
        get_fully_qualified_name=lambda: '/rover/dxl_monitor', get_logger=lambda: log,
        get_clock=lambda: SimpleNamespace(
            now=lambda: SimpleNamespace(nanoseconds=WALL + clock.now)),
        create_publisher=lambda kind, topic, *_, **__: SimpleNamespace(
            publish=lambda message: page.accept_message(topic, message, clock.now / 1e9),
            get_subscription_count=lambda: 1))
    stopped = SimpleNamespace(monotonic=lambda: clock.now / 1e9, time_ns=lambda: WALL + clock.now,
                              monotonic_ns=lambda: clock.now,
                              time=lambda: (WALL + clock.now) / 1e9,
                              strftime=time.strftime, localtime=time.localtime)
    with ExitStack() as changed:
        for name, value in (('Node', lambda *_: ROS), ('declare', lambda *_: values),
                            ('load_models', lambda _: MODELS),
                            ('Clock', lambda **_: None), ('resident_memory', lambda: MEMORY),
                            ('time', stopped), ('overridable_publisher',
                                                lambda node, *rest: node.create_publisher(*rest))):
            changed.enter_context(patch.object(dxl_node, name, value))
        changed.enter_context(patch.object(monitored_bus, 'listener_on', FedListener))
        changed.enter_context(patch.object(monitored_bus, 'time', stopped))
        changed.enter_context(patch.object(timers, 'time', stopped))
        changed.enter_context(patch.object(timers.Timers, 'start', lambda _: None))
        changed.enter_context(patch(
            'servobus.sources.capture_recorder.Recorder.start', lambda *_: None))
        node = dxl_node.MonitorNode()
        fed = [0] * len(case.names)
        written = []
        for one in (*case.heard, None):
            pause = 2 * S if one is None else one.after_ns
            for part in (pause // 3, pause - pause // 3) if pause > 100_000_000 else ():
                clock.now += part
                for bus in node._buses:
                    bus.listener._report_idle(clock.now)
                node._timers.call_due(clock.now / 1e9)
                page.show_page(clock.now / 1e9)
            if one is not None:
                clock.now += pause if pause <= 100_000_000 else 0
                stamp = clock.now if one.stamp is None else one.stamp
                node._buses[one.bus].listener.hear_chunk(one, stamp)
                fed[one.bus] += len(one.data)
                written.append((stamp, one.data, one.side, one.change))
            node._timers.call_due(clock.now / 1e9)
        for bus, size in zip(node._buses, fed, strict=True):
            report = bus.report(clock.now)
            all_counted(report.counters, size)
            assert not (case.is_noise and report.devices), 'a device is made up'
        node._reset_statistics(None, SimpleNamespace())
        node._timers.call_due(clock.now / 1e9 + 1)
        page.show_page(clock.now / 1e9)
        page.show_page(clock.now / 1e9 + 70)
        capture = node._recorders._all['Capture']
        capture._is_stopping.set()
        capture._run()
        assert not node._recorders.problem, node._recorders.problem
        node.stop()
    page.ask_history()
    data = (folder / 'bus.txt').read_bytes()
    if values['capture_size'] > 1 and all(0 <= one[0] < STAMP_END for one in written):
        reader = Reader(io.BytesIO(data))
        assert [(one.stamp, *one[2:]) for one in reader] == [
            one for one in written if one[1] or one[3]]
    return data


def all_counted(counters, fed):
    assert counters['Bytes'] == fed, (counters, fed)
    assert fed == sum(counters[f'{kind} Bytes'] for kind in ('Packet', 'Noise', 'Pending'))
    assert min(counters.values()) >= 0, counters
    assert 6 * counters['Packets'] <= counters['Packet Bytes'] <= 1031 * counters['Packets']
