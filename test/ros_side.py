# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The tests' own side of the ROS graph. Imported only where rclpy is (fixture `ros`)."""
from collections import defaultdict
from contextlib import suppress
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from geometry_msgs.msg import TwistStamped
from harness import Background
from harness import DEADLINE_S
from harness import wait
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import DescribeParameters
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import ListParameters
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

__all__ = ['Clock', 'DiagnosticArray', 'Duration', 'Float64', 'Graph', 'ParameterMessage',
           'ParameterValue', 'SetBool', 'SetParameters', 'String', 'Teleop', 'Trigger', 'Twist',
           'TwistStamped', 'overrides', 'qos', 'stamped', 'twist']


def twist(x=0.0, y=0.0, omega=0.0):
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = float(x), float(y), float(omega)
    return message


def stamped(x=0.0, y=0.0, omega=0.0, late_s=0.0):
    """Return a TwistStamped, its stamp so much too old; None: not stamped."""
    message = TwistStamped(twist=twist(x, y, omega))
    stamp = 0 if late_s is None else time.time_ns() - int(late_s * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    return message


def qos(depth=10, reliable=True, durable=False):
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE)


class Graph:
    """
    One participant: a node that a thread spins. Leaving it takes the node out of the graph.

    `statuses` holds the newest DiagnosticStatus of each name, `heard` all messages by topic.
    """

    def __init__(self, name, namespace='/'):
        self._context = Context()
        rclpy.init(args=[], context=self._context,
                   signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, namespace=namespace, context=self._context,
                         use_global_arguments=False, enable_rosout=False,
                         start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.statuses = {}
        self.heard = defaultdict(list)
        self.listen(DiagnosticArray, '/diagnostics')
        self._is_over = False
        self._thread = threading.Thread(target=self._spin, name=f'spin {name}')

    def _spin(self):
        """Not Executor.spin: shutting that down from outside races with its callbacks."""
        while not self._is_over:
            # A publisher may be destroyed while the executor looks at what it waits for.
            with suppress(InvalidHandle):
                self._executor.spin_once(timeout_sec=0.1)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._is_over = True
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self, kind, topic):
        def hear(message):
            self.heard[topic].append(message)
            for status in getattr(message, 'status', ()):
                self.statuses[status.name] = status
        self.node.create_subscription(kind, topic, hear, 100)

    def used_by(self, name):
        """Return what a node publishes, subscribes and serves; None where it is not (any more)."""
        try:
            return tuple({topic for topic, _ in ask(name, '/')} for ask in (
                self.node.get_publisher_names_and_types_by_node,
                self.node.get_subscriber_names_and_types_by_node,
                self.node.get_service_names_and_types_by_node))
        except NodeNameNonExistentError:    # or that of an earlier test has just left
            return None

    def values(self, name):
        """Return the values of a status by key."""
        return {pair.key: pair.value for pair in self.statuses[name].values}

    def level(self, name):
        """Return the level of a status as a number, None before it was heard."""
        return self.statuses[name].level[0] if name in self.statuses else None

    def wait_status(self, name, *parts, level=None):
        """Wait for a status with `parts` in its message or values; return it."""
        def found():
            status = self.statuses.get(name)
            text = status and '\n'.join([status.message, *(f'{one.key}={one.value}'
                                                           for one in status.values)])
            return status if status and all(part in text for part in parts) \
                and level in (None, status.level[0]) else None
        try:
            return wait(found)
        except AssertionError:
            raise AssertionError(f'{name}: {parts}, {level} not in '
                                 f'{self.statuses.get(name)}') from None

    def publisher(self, topic='/cmd_vel', kind=Twist, profile=1, heard=True):
        """Make a publisher; `heard`: wait until somebody subscribes."""
        publisher = self.node.create_publisher(kind, topic, profile)
        if heard:
            wait(publisher.get_subscription_count)
        return publisher

    def publishers(self, topic):
        """Return the names of the nodes that publish a topic."""
        return [one.node_name for one in self.node.get_publishers_info_by_topic(topic)]

    def call(self, kind, name, **fields):
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        try:
            assert client.wait_for_service(DEADLINE_S), f'no service {name}'
            return self._finish(client.call_async(kind.Request(**fields)))
        finally:
            self.node.destroy_client(client)

    def _finish(self, future):
        wait(future.done)
        return future.result()

    def set(self, node, **values):
        """Set parameters; return the reasons of those refused ('' where it was taken)."""
        parameters = [Parameter(name, value=value).to_parameter_msg()
                      for name, value in values.items()]
        response = self.call(SetParameters, f'{node}/set_parameters', parameters=parameters)
        return ['' if one.successful else one.reason or 'refused' for one in response.results]

    def get(self, node, names):
        """Return the values of parameters."""
        response = self.call(GetParameters, f'{node}/get_parameters', names=names)
        return [parameter_value_to_python(one) for one in response.values]

    def describe(self, node, names):
        """Return the descriptors of parameters by name."""
        response = self.call(DescribeParameters, f'{node}/describe_parameters', names=names)
        return {one.name: one for one in response.descriptors}

    def parameters(self, node):
        """Return the names of a node's parameters."""
        return self.call(ListParameters, f'{node}/list_parameters').result.names


def overrides(full_name, *ros_arguments):
    """Return the parameters that rclpy takes for a node from a command line."""
    namespace, _, name = full_name.rpartition('/')
    context = Context()
    rclpy.init(args=['--ros-args', '-r', f'__ns:={namespace or "/"}', *ros_arguments],
               context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(name, context=context, enable_rosout=False, start_parameter_services=False)
    found = {name: one.value for name, one in node._parameter_overrides.items()}
    node.destroy_node()
    context.try_shutdown()
    return found


class Teleop(Background):
    """Publishes what `message()` returns at a rate, from a thread, while it is entered."""

    def __init__(self, publisher, message, rate=200.0):
        self._publisher = publisher
        self._message = message
        self._period_s = 1.0 / rate
        super().__init__()
        self.last = 0           # when it published last, monotonic ns
        self.sent = 0

    def _run(self):
        next_s = time.monotonic()
        while not self._done.is_set():
            self.last = time.monotonic_ns()
            self._publisher.publish(self._message())
            self.sent += 1
            next_s = max(next_s + self._period_s, time.monotonic() - 0.1)
            self._done.wait(next_s - time.monotonic())
