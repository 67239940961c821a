# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Reports to ROS messages: the only place that knows both.

Message objects are kept and only what changed is set again: a message is good until the next call.
Text from a wire may hold anything; what ROS cannot carry (NUL, lone surrogates) becomes U+FFFD.
"""

from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Sequence
from itertools import chain
from itertools import pairwise
from math import nan
import re
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from rclpy.event_handler import PublisherEventCallbacks
from std_msgs.msg import Float64

from msg_defs.diagnostics import ALL
from msg_defs.diagnostics import HEADLINE
from msg_defs.diagnostics import headline_figure
from msg_defs.diagnostics import Joint
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import metric_status
from msg_defs.diagnostics import OFF
from msg_defs.diagnostics import Pairs
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import topic_names
from msg_defs.diagnostics import unit_name
from msg_defs.running_statistics import WINDOW_S
from msg_defs.status_keys import PART

try:
    import statistics_msgs.msg as statistics_msgs
except ImportError:             # part of every Jazzy install, but there is no wheel of it
    statistics_msgs = None

STATUSES_PER_MESSAGE = 30
BYTES_PER_MESSAGE = 60_000      # one UDP datagram takes less than 64 KiB
QUEUE_DEPTH = 10                # publishers: reliable, keep last

# A publisher that warns of subscribers with another QoS is two things more that the executor looks
# at each time it wakes. Of those with plain figures there are many.
_NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
_LEVELS = {level: bytes([level]) for level in Level}    # DiagnosticStatus.level is a byte string
_LAST_TIME = ((1 << 31) - 1) * 1_000_000_000          # the sec of a Time is an int32
_UNSAFE = re.compile('[\0\ud800-\udfff]')


def safe_text(text: str) -> str:
    if text.isascii() and '\0' not in text:
        return text
    return _UNSAFE.sub('\ufffd', text)


def to_time(nanoseconds: int) -> Time:
    sec, nanosec = divmod(min(max(0, nanoseconds), _LAST_TIME), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def to_ros_time(stamp: int, now: int, now_ros: int) -> Time:
    """Convert a monotonic stamp, given one moment on both clocks (all ns)."""
    return to_time(now_ros - (now - stamp))


def full_name(node: Any) -> str:
    """Return the name of a node as statuses carry it: with its namespace, no slash in front."""
    return str(node.get_fully_qualified_name()).lstrip('/')


def slice_statuses(statuses: Sequence[Status]) -> list[list[Status]]:
    """
    Cut a report into equal slices of at most 30 statuses and 60 kB, one for each message.

    Equal, so that a single message shows as much as any other; where there are several, each
    status says which slice it is in, `part` = `1 of 2`. A status of more than 60 kB cannot be
    cut: its slice may be larger.
    """
    sizes = [_size(status) for status in statuses]
    count = -(-len(statuses) // STATUSES_PER_MESSAGE)
    cuts = _cuts(len(statuses), count)
    while any(_is_too_large(sizes[begin:end]) for begin, end in pairwise(cuts)):
        count += 1
        cuts = _cuts(len(statuses), count)
    parts = [list(statuses[begin:end]) for begin, end in pairwise(cuts)]
    if len(parts) == 1:
        return parts
    return [[one._replace(values=[*one.values, (PART, f'{number} of {len(parts)}')])
             for one in part] for number, part in enumerate(parts, start=1)]


def _cuts(length: int, count: int) -> list[int]:
    """Return where a list of a length is cut into so many parts, none or one longer by one."""
    return [length * number // count for number in range(count + 1)] if count else [0]


def _is_too_large(sizes: Sequence[int]) -> bool:
    """Tell whether statuses of these sizes are cut once more; a single one cannot be."""
    return len(sizes) > 1 and sum(sizes) > BYTES_PER_MESSAGE


class DiagnosticArrays:
    """
    Builds DiagnosticArrays for one topic from lists of statuses.

    A status keeps its message as long as this object lives, so its name and hardware_id must not
    occur twice in a list.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], tuple[DiagnosticStatus, Pairs]] = {}

    def build(self, statuses: Sequence[Status], stamp: Time) -> Iterator[DiagnosticArray]:
        """Yield the messages of a report, a slice in each."""
        for some in slice_statuses(statuses):
            yield self.array(some, stamp)

    def array(self, statuses: Iterable[Status], stamp: Time) -> DiagnosticArray:
        """Return one message."""
        array = DiagnosticArray(status=[self._message(status) for status in statuses])
        array.header.stamp = stamp
        return array

    def _message(self, status: Status) -> DiagnosticStatus:
        key = (status.name, status.hardware_id)
        message, before = self._kept.get(key, (None, []))
        if message is None:
            message = DiagnosticStatus(
                name=safe_text(status.name), hardware_id=safe_text(status.hardware_id), values=[])
        message.level = _LEVELS[status.level]
        message.message = safe_text(status.message)
        _set_values(message.values, before, status.values)
        self._kept[key] = (message, list(status.values))
        return message


def _size(status: Status) -> int:
    """Return an upper bound of the bytes a status takes in a message."""
    text = ''.join(chain(status[:1], status[2:4], *status.values))
    return len(text.encode(errors='surrogatepass')) + 16 * (2 + len(status.values))


def _set_values(
        messages: list[KeyValue], before: Pairs,
        after: Sequence[tuple[str, str]]) -> None:
    del messages[len(after):]
    for message, old, new in zip(messages, before, after, strict=False):
        if new != old:
            message.key = safe_text(new[0])
            message.value = safe_text(new[1])
    messages += [KeyValue(key=safe_text(key), value=safe_text(value))
                 for key, value in after[len(messages):]]


def joint_state(joints: Sequence[Joint], stamp: Time) -> Any:
    """Build a JointState: NaN where one joint has no value, an empty list where none has."""
    from sensor_msgs.msg import JointState  # here: 30 modules that most nodes do without
    message = JointState(name=[safe_text(joint.name) for joint in joints])
    message.header.stamp = stamp
    for name in ('position', 'velocity', 'effort'):
        setattr(message, name, _column([getattr(joint, name) for joint in joints]))
    return message


def _column(values: list[float | None]) -> list[float]:
    if all(value is None for value in values):
        return []
    return [nan if value is None else float(value) for value in values]


def metrics_message(metric: Metric, source: str, start: Time, stop: Time) -> Any:
    """
    Build a statistics_msgs/MetricsMessage; its figures follow rclcpp's order, NaN = no data.

    Its source is '<node>/<metric>', because rclcpp's own habit, the node alone, leaves several
    metrics of one node indistinguishable.
    """
    types = statistics_msgs.StatisticDataType
    kinds = (types.STATISTICS_DATA_TYPE_AVERAGE, types.STATISTICS_DATA_TYPE_MAXIMUM,
             types.STATISTICS_DATA_TYPE_MINIMUM, types.STATISTICS_DATA_TYPE_SAMPLE_COUNT,
             types.STATISTICS_DATA_TYPE_STDDEV)
    points = [statistics_msgs.StatisticDataPoint(data_type=kind, data=float(figure))
              for kind, figure in zip(kinds, _statistics(metric), strict=True)]
    return statistics_msgs.MetricsMessage(
        measurement_source_name=source, metrics_source=metric.name, unit=metric.unit,
        window_start=start, window_stop=stop, statistics=points)


def _statistics(metric: Metric) -> tuple[float, ...]:
    """Return average, maximum, minimum, count, deviation."""
    window = metric.window
    if window is not None:
        return window.mean, window.maximum, window.minimum, window.count, window.deviation
    value = headline_figure(metric)
    return (nan, nan, nan, 0, nan) if value is None else (value, nan, nan, 1, nan)


class TimingPublisher:
    """
    The timing topics of a node below `prefix`, all made with the first report.

    With `topics` HEADLINE `<prefix>/timing` (DiagnosticArray, every metric) and
    `<prefix>/timing/[<bus>/]<metric>_<unit>` (Float64, the headline); with ALL also
    `<prefix>/statistics/[<bus>/]<metric>`, where statistics_msgs is installed. Metrics of single
    devices are on the first one only.
    """

    def __init__(self, node: Any, prefix: str, topics: str = HEADLINE,
                 buses: Sequence[str] = ()) -> None:
        self._topics = topics
        if topics == ALL and statistics_msgs is None:
            node.get_logger().warning('timing_topics: all needs statistics_msgs, which is not '
                                      'installed; sudo apt install ros-jazzy-statistics-msgs')
        self._node = node
        self._prefix = prefix
        self._buses = topic_names(buses)
        self._arrays = DiagnosticArrays()
        self._publishers: dict[str, Any] = {}

    def publish(self, metrics: Sequence[Metric], now_ros: int) -> None:
        if self._topics == OFF:
            return
        name = full_name(self._node)
        stamp = to_time(now_ros)
        statuses = [metric_status(name, metric) for metric in metrics]
        for array in self._arrays.build(statuses, stamp):
            self._publisher(DiagnosticArray, 'timing').publish(array)
        start = to_time(now_ros - int(1e9) * WINDOW_S)
        for metric in metrics:
            if not metric.device:
                self._publish_headline(metric)
                self._publish_metrics_message(metric, start, stamp)

    def _publish_headline(self, metric: Metric) -> None:
        topic = self._topic('timing', metric, f'{metric.name}_{unit_name(metric.unit)}')
        publisher = self._publisher(Float64, topic)     # a tool lists it, with data or without
        figure = headline_figure(metric)
        if figure is not None:
            publisher.publish(Float64(data=float(figure)))

    def _publish_metrics_message(self, metric: Metric, start: Time, stop: Time) -> None:
        if self._topics == ALL and statistics_msgs is not None:
            source = '/'.join(filter(None, (full_name(self._node), metric.bus, metric.name)))
            publisher = self._publisher(
                statistics_msgs.MetricsMessage, self._topic('statistics', metric, metric.name))
            publisher.publish(metrics_message(metric, source, start, stop))

    def _topic(self, kind: str, metric: Metric, name: str) -> str:
        bus = self._buses[metric.bus_name] if metric.bus_name else ''
        return '/'.join(filter(None, (kind, bus, name)))

    def _publisher(self, kind: type, topic: str) -> Any:
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._node.create_publisher(
                kind, f'{self._prefix}/{topic}', QUEUE_DEPTH,
                event_callbacks=None if kind is DiagnosticArray else _NO_EVENTS)
            self._publishers[topic] = publisher
        return publisher
