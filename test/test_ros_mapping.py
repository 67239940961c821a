# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Reports as ROS messages: the types that ROS wants, nothing lost, nothing aliased."""

import importlib
from math import inf
from math import isnan
from math import nan
from types import SimpleNamespace

import pytest

from msg_defs.diagnostics import Joint
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import Status
from msg_defs.running_statistics import Series

pytestmark = pytest.mark.ros
S = 1_000_000_000


@pytest.fixture
def ros(monkeypatch):
    pytest.importorskip('rclpy', reason='skipped: no ROS here')
    ros = importlib.import_module('msg_defs.ros')
    monkeypatch.setattr(ros, 'statistics_msgs', STAND_IN)
    return ros


def checked(message):
    """Build a message again with rclpy's own type checks on, in any environment."""
    fields = message.get_fields_and_field_types()
    values = {name: getattr(message, name) for name in fields}
    for name, value in values.items():
        if hasattr(value, 'get_fields_and_field_types'):
            values[name] = checked(value)
        elif isinstance(value, list):
            values[name] = [checked(item) if hasattr(item, 'get_fields_and_field_types') else item
                            for item in value]
    return type(message)(check_fields=True, **values)


def over_the_wire(message):
    from rclpy.serialization import deserialize_message
    from rclpy.serialization import serialize_message
    return deserialize_message(serialize_message(checked(message)), type(message))


def status(i=0, level=Level.OK, values=(('Present Position (rad)', '1.5'),), message='connected'):
    return Status(f'dxl_monitor: {i:03d}', level, message, f'{i}', list(values))


def build(ros, statuses, arrays=None):
    arrays = arrays or ros.DiagnosticArrays()
    return [over_the_wire(array) for array in arrays.build(statuses, ros.to_time(5 * S + 7))]


@pytest.mark.parametrize('level', Level)
def test_status_arrives_as_it_was(ros, level):
    [array] = build(ros, [status(11, level)])
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (5, 7)
    [got] = array.status
    assert got.level == bytes([level])
    assert (got.name, got.hardware_id, got.message) == ('dxl_monitor: 011', '11', 'connected')
    assert [(pair.key, pair.value) for pair in got.values] == [('Present Position (rad)', '1.5')]


@pytest.mark.parametrize(('text', 'arrives'), [
    ('22 °C', '22 °C'), ('a\0b', 'a\ufffdb'), ('\udcff', '\ufffd'), ('\0', '\ufffd'), ('', ''),
    ('\U0001f916', '\U0001f916'), ('a\nb\x1b[31m', 'a\nb\x1b[31m')])
def test_any_text_is_made_safe(ros, text, arrives):
    [array] = build(ros, [Status(text, Level.OK, text, text, [(text, text)])])
    [got] = array.status
    pair = got.values[0]
    assert {got.name, got.message, got.hardware_id, pair.key, pair.value} == {arrives}


def test_equal_slices_of_at_most_thirty_statuses_and_64_kilobytes(ros):
    from rclpy.serialization import serialize_message
    values = [(f'Register {i} (rad)', 'ü' * 20) for i in range(70)]
    statuses = [status(i, values=values) for i in range(253)]
    arrays = build(ros, statuses)
    assert [item.hardware_id for array in arrays for item in array.status] == [
        str(i) for i in range(253)]
    assert {len(array.status) for array in arrays} == {11}
    assert all(len(serialize_message(array)) < 64_000 for array in arrays)
    small = build(ros, [status(i) for i in range(41)])
    assert [len(array.status) for array in small] == [20, 21]
    assert [len(array.status) for array in build(ros, [status(i) for i in range(30)])] == [30]


def test_a_status_says_in_which_slice_it_stands(ros):
    [one] = build(ros, [status(i) for i in range(21)])
    assert 'part' not in {pair.key for each in one.status for pair in each.values}
    for count, parts in ((31, 2), (61, 3), (253, 9)):
        arrays = build(ros, [status(i) for i in range(count)])
        assert [[(each.values[-1].key, each.values[-1].value) for each in array.status]
                for array in arrays] == [[('part', f'{number} of {parts}')] * len(array.status)
                                         for number, array in enumerate(arrays, start=1)]
        assert len(arrays) == parts


def test_a_status_that_is_too_large_takes_nothing_from_the_others(ros):
    large = status(1, values=[('key', 'x' * 70_000)])
    assert [len(array.status) for array in build(ros, [status(0), large, status(2)])] == [1, 1, 1]
    assert [len(array.status) for array in build(ros, [large])] == [1]


def test_kept_messages_follow_every_change(ros):
    arrays = ros.DiagnosticArrays()
    histories = [
        [('a', '1'), ('b', '2')],
        [('a', '1'), ('b', '3')],
        [('a', '1')],
        [('c', '9'), ('a', '1'), ('b', '3')],
        [],
        [('b', '4')],
    ]
    for level, values in zip((0, 1, 2, 3, 0, 1), histories, strict=True):
        [array] = build(ros, [status(3, Level(level), values, f'said {values}')], arrays)
        [got] = array.status
        assert got.level == bytes([level])
        assert got.message == f'said {values}'
        assert [(pair.key, pair.value) for pair in got.values] == values


def test_kept_messages_follow_a_list_that_its_owner_changes(ros):
    arrays = ros.DiagnosticArrays()
    report = status(3)
    build(ros, [report], arrays)
    report.values[0] = ('Present Position (rad)', '2.5')
    [array] = build(ros, [report], arrays)
    assert array.status[0].values[0].value == '2.5'


def test_ros_time_of_a_monotonic_stamp(ros):
    stamp = ros.to_ros_time(stamp=40 * S, now=42 * S, now_ros=1_700_000_000 * S + 5)
    assert (stamp.sec, stamp.nanosec) == (1_699_999_998, 5)
    early = ros.to_ros_time(stamp=0, now=42 * S, now_ros=S)     # simulated time, just started
    assert (early.sec, early.nanosec) == (0, 0)
    far = ros.to_ros_time(stamp=1 << 70, now=0, now_ros=0)
    assert (far.sec, far.nanosec) == ((1 << 31) - 1, 0)


def test_joint_state(ros):
    joints = [Joint('left_knee', 1.5, 0.0), Joint('right_knee', None, -2)]
    message = over_the_wire(ros.joint_state(joints, ros.to_time(3 * S)))
    assert message.header.stamp.sec == 3
    assert message.name == ['left_knee', 'right_knee']
    assert message.position[0] == 1.5
    assert isnan(message.position[1])
    assert list(message.velocity) == [0.0, -2.0]
    assert list(message.effort) == []


class RecordingNode:
    """Stands in for a node: keeps what is published by topic."""

    def __init__(self, name):
        self.name = name
        self.types = {}
        self.without_events = set()
        self.published = {}

    def get_fully_qualified_name(self):
        return f'/{self.name}'

    def create_publisher(self, kind, topic, depth, event_callbacks=None):
        assert topic not in self.types, 'a publisher is made once'
        assert depth == 10
        self.types[topic] = kind
        if event_callbacks is not None and not event_callbacks.use_default_callbacks:
            self.without_events.add(topic)
        messages = self.published.setdefault(topic, [])
        return SimpleNamespace(publish=messages.append)


class Record:
    """A message class of the stand-in: takes its declared fields only, as rclpy's do."""

    fields = ()

    def __init__(self, **values):
        assert set(values) == set(self.fields)
        self.__dict__.update(values)


class StatisticDataPoint(Record):
    fields = ('data_type', 'data')


class MetricsMessage(Record):
    fields = ('measurement_source_name', 'metrics_source', 'unit', 'window_start', 'window_stop',
              'statistics')


class StatisticDataType:
    STATISTICS_DATA_TYPE_UNINITIALIZED = 0
    STATISTICS_DATA_TYPE_AVERAGE = 1
    STATISTICS_DATA_TYPE_MINIMUM = 2
    STATISTICS_DATA_TYPE_MAXIMUM = 3
    STATISTICS_DATA_TYPE_STDDEV = 4
    STATISTICS_DATA_TYPE_SAMPLE_COUNT = 5


STAND_IN = SimpleNamespace(MetricsMessage=MetricsMessage, StatisticDataPoint=StatisticDataPoint,
                           StatisticDataType=StatisticDataType)


def metric(name='write', unit='ms', values=(1.0, 2.0, 3.0), **more):
    series = Series()
    for value in values:
        series.add(value, 0)
    return Metric(name, unit, series.summary(0), series.total(), **more)


def publish(ros, metrics, prefix='dxl', buses=(), topics='all'):
    node = RecordingNode(f'{prefix}_node')
    publisher = ros.TimingPublisher(node, prefix, topics, buses)
    publisher.publish(metrics, 100 * S)
    publisher.publish(metrics, 101 * S)
    return node


def test_timing_topics_of_several_buses_with_devices(ros):
    load = [Metric('bus_load', '%', value=50.0, bus=bus, bus_name=bus)
            for bus in ('left arm', 'left-arm')]
    node = publish(ros, [*load, metric('reply_latency', bus='left arm', device='011')],
                   buses=['left arm', 'left-arm'])
    assert node.without_events == set(node.types) - {'dxl/timing'}      # the executor's work
    assert set(node.types) == {
        'dxl/timing',
        'dxl/timing/left_arm/bus_load_percent', 'dxl/timing/left_arm_2/bus_load_percent',
        'dxl/statistics/left_arm/bus_load', 'dxl/statistics/left_arm_2/bus_load',
    }
    names = [item.name for item in node.published['dxl/timing'][0].status]
    assert names[2] == 'dxl_node: timing/left arm/011/reply_latency'


def test_timing_topics_of_a_single_bus_are_named_as_those_of_several(ros):
    node = publish(ros, [Metric('resident_memory', 'MB', value=50.0),
                         Metric('bus_load', '%', value=50.0, bus_name='left arm')],
                   buses=['left arm'], topics='headline')
    assert set(node.types) == {'dxl/timing', 'dxl/timing/resident_memory_mb',
                               'dxl/timing/left_arm/bus_load_percent'}
    assert [item.name for item in node.published['dxl/timing'][0].status] == [
        'dxl_node: timing/resident_memory', 'dxl_node: timing/bus_load']


def test_no_timing_topics(ros):
    assert publish(ros, [metric()], topics='off').types == {}


def test_metrics_message_follows_rclcpp(ros):
    node = publish(ros, [metric(values=(1.0, 2.0, 6.0))], prefix='vel2d')
    message = node.published['vel2d/statistics/write'][0]
    assert message.measurement_source_name == 'vel2d_node/write'
    assert message.metrics_source == 'write'
    assert message.unit == 'ms'
    assert (message.window_start.sec, message.window_stop.sec) == (90, 100)
    figures = [(point.data_type, point.data) for point in message.statistics]
    assert figures == [(1, 3.0), (3, 6.0), (2, 1.0), (5, 3.0),
                       (4, pytest.approx((14 / 3) ** 0.5))]
    assert all(type(point.data) is float for point in message.statistics)


def test_metrics_message_says_nan_where_there_is_no_data(ros):
    node = publish(ros, [Metric('write', 'ms'), Metric('frame_rate', 'Hz', value=20.0)])
    empty = [point.data for point in node.published['dxl/statistics/write'][0].statistics]
    value = [point.data for point in node.published['dxl/statistics/frame_rate'][0].statistics]
    assert empty[3] == 0.0
    assert all(isnan(figure) for figure in empty[:3] + empty[4:])
    assert value[0] == 20.0
    assert value[3] == 1.0
    assert all(isnan(value[i]) for i in (1, 2, 4))


@pytest.mark.parametrize('value', [nan, inf, -inf])
def test_no_figure_is_published_that_is_no_number(ros, value):
    node = publish(ros, [Metric('frame_rate', 'Hz', value=value)])
    assert node.published['dxl/timing/frame_rate_hz'] == []
    [message, _] = node.published['dxl/statistics/frame_rate']
    assert all(isnan(point.data) or point.data == 0 for point in message.statistics)
