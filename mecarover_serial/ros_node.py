# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Start, signals and end of a node: the one place that knows how rclpy has to be handled.

rclpy's own signal handlers invalidate the context at once, die on SIGHUP and SIGQUIT and freeze
on SIGTSTP; without them the main thread sits in rcl_wait. So signals arrive on a wake-up pipe,
a thread reads it, stops the machine first, and only then ends the spinning.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Container
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
import gc
import math
import os
import re
import signal
import sys
import threading
import time
import traceback
from typing import Any
from typing import Protocol

from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions

from mecarover_serial.fast_dds import avoid_full_shared_memory
from mecarover_serial.fast_dds import domain_problem
from mecarover_serial.namesakes import DISCOVERED_NS
from mecarover_serial.namesakes import Namesakes
from mecarover_serial.node_command_line import ENDING_SIGNALS
from mecarover_serial.parameters import convert
from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import settings_files
from mecarover_serial.parameters import typed_parameters
from mecarover_serial.parameters import unknown_names
from mecarover_serial.settings_text import check_sections
from mecarover_serial.settings_text import SettingsError
from mecarover_serial.standard_streams import StandardStreams
from mecarover_serial.systemd import Systemd
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.port.port_error import PortError
from servobus.printable_text import printable
from servobus.tools.cli import complain
from servobus.tools.cli import DONE
from servobus.worker import MORE_TASKS

_OVERRIDES = 'qos_overrides.'
_NO_THREAD = re.compile('start new thread|pthread_create')     # in Python's words; in those of ROS
SAME_ERROR_AGAIN_S = 60.0       # between lines about what rclpy raises at one place
ONLY_ERRORS_MAX_S = 10.0        # an executor that only raises for so long does nothing any more
CLOCK_STEP_S = 1.0              # the system clock was set when it jumps by more


class Stoppable(Protocol):
    """What `run` starts and ends; called from any thread, `stop` more than once."""

    node: Node

    def stop(self) -> None:
        """Bring the machine to a safe state and release the ports; the context is still valid."""

    def suspend(self) -> None:
        """Bring the machine to a safe state, if it moves: the process is about to be suspended."""
        return

    def resume(self) -> None:
        """Go on after a suspension, as if everything heard before it were forgotten."""
        return

    def is_working(self) -> bool:
        """Tell whether the threads that do the work are well; else systemd's watchdog starves."""
        return True


def run(name: str, start: Callable[[], Stoppable], args: Sequence[str] | None = None) -> int:
    """Run a node until a signal ends it; return the exit code (0 signal, 1 failed, 2 usage)."""
    ahead_s = time.time() - time.monotonic()
    with _Signals() as signals:
        try:
            with StandardStreams(name):
                code = _run(name, start, args, signals, ahead_s)
        except RuntimeError as error:
            if not _NO_THREAD.search(str(error)):
                raise
            code = complain(name, OSError(f'{first_line(error)}; {MORE_TASKS}'))
        if _is_set_back(ahead_s):
            os._exit(code)
        return code


def _is_set_back(ahead_s: float) -> bool:
    """
    Tell whether the system clock was set back since it was so far ahead of the monotonic one.

    Fast DDS then crashes, every other time, when it takes down what was there before. By that
    time everything of ours is stopped and closed: the process is left without taking it down.
    """
    return time.time() - time.monotonic() < ahead_s - CLOCK_STEP_S


def _run(name: str, start: Callable[[], Stoppable], args: Sequence[str] | None,
         signals: _Signals, ahead_s: float) -> int:
    avoid_full_shared_memory(name)
    if problem := domain_problem(os.environ.get('ROS_DOMAIN_ID', '')):
        return complain(name, UsageError(problem))
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:      # RCLError is private; its cause is what the user typed
        return complain(name, UsageError(f'{first_line(error)}; {_remedy()}'))
    try:
        _spin(_created(start), signals, ahead_s)
        return DONE
    except (ParameterError, PortError) as error:
        return complain(name, error)
    except ParameterException as error:         # rclpy's own parameters: use_sim_time, QoS
        return complain(name, UsageError(f'{first_line(error)}; see ros2 param --help'))
    except OSError as error:
        return complain(name, OSError(f'{error}; correct that and restart it'))
    finally:
        if not _is_set_back(ahead_s):
            rclpy.try_shutdown()


def _created(start: Callable[[], Stoppable]) -> Stoppable:
    """Return what `start` makes. What rcl refuses then is what the user typed or set."""
    try:
        return start()
    except RuntimeError as error:
        if type(error).__name__ != 'RCLError':      # it is private
            raise
        raise ParameterError(f'{first_line(error)}; {_remedy()}') from error


def _remedy() -> str:
    """Return where a user reads on when rcl refuses to start."""
    if os.environ.get('ROS_SECURITY_ENABLE', '').lower() != 'true':
        return 'see ros2 run --help'
    return ('ROS_SECURITY_ENABLE is true: give --enclave, set ROS_SECURITY_KEYSTORE, use ROS 2 '
            'from apt (the wheels of PyPI have no security)')


def _spin(app: Stoppable, signals: _Signals, ahead_s: float) -> None:
    """Spin until a signal has come; then the machine is stopped before anything else ends."""
    executor = SingleThreadedExecutor()
    ended = threading.Event()
    systemd = Systemd()
    errors = _SpinErrors(app)
    try:
        signals.watch(app, partial(_end, executor, ended))
        executor.add_node(app.node)
        if systemd.watchdog_s is not None:
            app.node.create_timer(systemd.watchdog_s / 3, partial(_feed_watchdog, systemd, app),
                                  clock=Clock(clock_type=ClockType.STEADY_TIME))
        systemd.notify('READY=1')
        gc.freeze()             # imports and set-up stay: no garbage is to be looked for there
        # Not spin_until_future_complete: it keeps a callback for each message that ever came.
        while not ended.is_set() and rclpy.ok():
            errors.spin_once(executor)
    finally:
        systemd.notify('STOPPING=1')
        app.stop()
        executor.shutdown(timeout_sec=1.0)
        if not _is_set_back(ahead_s):
            app.node.destroy_node()


def _feed_watchdog(systemd: Systemd, app: Stoppable) -> None:
    """Feed the watchdog: this thread runs, as it does this, and so do those of the app."""
    if app.is_working():
        systemd.notify('WATCHDOG=1')


class _SpinErrors:
    """
    What rclpy raises while it spins: at what others send, or because no memory is left.

    That ends one call and not the node. A mistake of ours, in a callback of the app, ends it.
    """

    def __init__(self, app: Stoppable) -> None:
        self._node = app.node
        self._package = type(app).__module__.partition('.')[0]
        self._since = math.inf          # it has only raised
        self._last_logged: dict[str, float] = {}

    def spin_once(self, executor: SingleThreadedExecutor) -> None:
        """Make one call; raise what ends the node."""
        try:
            executor.spin_once()
            self._since = math.inf
        except Exception as error:
            if not (rclpy.ok() and self._survives(error, time.monotonic())):
                raise

    def _survives(self, error: Exception, now_s: float) -> bool:
        """Say it, if it is time, and have rclpy go on; return False for what ends the node."""
        frames = [(frame.f_globals.get('__name__', ''), frame.f_code.co_name)
                  for frame, _ in traceback.walk_tb(error.__traceback__)]
        if isinstance(error, MemoryError):
            line = place = 'no memory is left, so a call was left out; raise the limit ' \
                '(ulimit -v, MemoryMax=) or end other programs'
        elif any(module.partition('.')[0] == self._package for module, _ in frames):
            return False
        else:
            place = next((name for module, name in frames if module.startswith('rclpy.')
                          and module not in ('rclpy.executors', 'rclpy.task')), 'executor')
            line = (f'rclpy, {place.strip("_")}: {type(error).__name__}: {first_line(error)}; '
                    'what another node sent was thrown away: correct that node')
        self._since = min(self._since, now_s)
        self._unlock()
        if now_s - self._last_logged.get(place, -math.inf) >= SAME_ERROR_AGAIN_S:
            self._last_logged[place] = now_s
            with suppress(MemoryError):
                self._node.get_logger().warning(printable(line))
        return now_s - self._since < ONLY_ERRORS_MAX_S

    def _unlock(self) -> None:
        """Have rclpy call again what it was to call when it raised: it would wait for its end."""
        node = self._node
        for one in (*node.timers, *node.subscriptions, *node.guards, *node.clients,
                    *node.services, *node.waitables):
            one._executor_event = False
            one.callback_group._active_entity = None


def _end(executor: SingleThreadedExecutor, ended: threading.Event) -> None:
    """Have the spinning left; from any thread. A task is what spin_once returns after."""
    ended.set()
    executor.create_task(lambda: None)


def overridable_publisher(node: Node, kind: type, topic: str, profile: QoSProfile) -> Any:
    """Return a publisher; qos_overrides.TOPIC.publisher.* are parameters of its QoS."""
    try:
        return node.create_publisher(
            kind, topic, profile,
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
    except (RuntimeError, ValueError) as error:     # rclpy's, and its private RCLError
        raise ParameterError(
            f'qos_overrides.{node.resolve_topic_name(topic)}.publisher: {first_line(error)}; '
            'set e.g. reliability to reliable, depth to 10') from error


def warn_of_overrides(node: Node, endpoints: Sequence[str]) -> None:
    """Warn of qos_overrides.* that none of these took (as '/cmd_vel.subscription')."""
    policies = [f'{_OVERRIDES}{of}.{one}' for of in endpoints
                for one in ('reliability', 'depth', 'history')]
    for line in unknown_names(policies, [
            one for one in given_parameters(node)
            if one.startswith(_OVERRIDES) and not node.has_parameter(one)]):
        node.get_logger().warning(line)


class GraphCheck:
    """What is wrong around a node, by the graph: another one of its name, a clock that stopped."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._began = time.monotonic_ns()
        self._namesakes = Namesakes(node.get_fully_qualified_name(), self._began)

    def lacks_clock(self) -> bool:
        """Whether the time of the node is 0 because no node publishes /clock."""
        return bool(self._node.get_clock().now().nanoseconds == 0)

    def complaints(self) -> list[str]:
        """Return a line for each."""
        now = time.monotonic_ns()
        lines = self._namesakes.complaints(self._node.get_node_names_and_namespaces(), now)
        if self.lacks_clock() and now - self._began > DISCOVERED_NS:
            lines.append('use_sim_time: it is true and no node publishes /clock, so all stamps '
                         'are 0; start the simulation or ros2 bag play --clock, or set it false')
        return lines


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the raw values that the user gave, on the command line or in a file."""
    return {name: one.value for name, one in node._parameter_overrides.items()}


def _prefer_typed(node: Node, known: Container[str]) -> None:
    """
    Let the command line win over a file that gives another type.

    rcl keeps one value per type, and rclpy takes the integer: with `cmd_vel_timeout: 1` in a
    file, `-p cmd_vel_timeout:=0.25` would be lost without a word.
    """
    overrides = node._parameter_overrides
    for name, value in typed_parameters(sys.argv[1:], node.get_name()).items():
        if name in known and name in overrides:
            one = rclpy.Parameter(name, value=value)
            if one.type_ != overrides[name].type_:
                overrides[name] = one


def declare(node: Node, parameters: Sequence[Parameter],
            apply: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """
    Declare parameters and return their checked values; raise ParameterError for a bad one.

    `apply(changes)` is called with converted values when run-time parameters change; it raises
    ParameterError to refuse what only makes sense together with others.
    """
    known = {parameter.name: parameter for parameter in parameters}
    values = {}
    try:
        check_sections(settings_files(sys.argv[1:]), node.get_fully_qualified_name())
    except SettingsError as error:
        raise ParameterError(str(error)) from error
    _prefer_typed(node, known)
    wanted = given_parameters(node)
    for parameter in parameters:
        if parameter.name in wanted:    # before rclpy does: its words name no remedy
            node._parameter_overrides[parameter.name] = _stored(
                parameter, wanted[parameter.name])
        declared = node.declare_parameter(
            parameter.name, _default(parameter), _descriptor(parameter))
        values[parameter.name] = convert(parameter, declared.value)
    for line in unknown_names([*known], [one for one in wanted if not one.startswith(_OVERRIDES)]):
        node.get_logger().warning(line)

    def before_set(changed: list[Any]) -> list[Any]:
        """Store what on_set will take as the type it has: a client may read double_value."""
        stored = []
        for one in changed:
            with suppress(KeyError, ParameterError):
                one = _stored(known[one.name], one.value)
            stored.append(one)
        return stored

    def on_set(changed: list[Any]) -> SetParametersResult:
        try:
            changes = {one.name: convert(known[one.name], one.value)
                       for one in changed if one.name in known}
            if changes:
                apply(changes)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    _explain_read_only(node)
    node.add_pre_set_parameters_callback(before_set)
    node.add_on_set_parameters_callback(on_set)
    return values


def _explain_read_only(node: Node) -> None:
    """Let rclpy, which refuses a read-only parameter before it asks us, name the remedy."""
    refuse = node.set_parameters_atomically

    def set_atomically(changed: list[Any]) -> SetParametersResult:
        result = refuse(changed)
        if not result.successful and 'read-only' in result.reason:
            result.reason += (' It cannot change while the node runs; write it to the settings '
                              'file, or give it with -p, and start the node again')
        return result
    node.set_parameters_atomically = set_atomically


def _stored(parameter: Parameter, raw: Any) -> Any:
    """Return what rclpy stores of a value: 1 as 1.0 where a double is wanted, 'x' as ['x']."""
    value = convert(parameter, raw)
    return rclpy.Parameter(parameter.name, value=raw if value == [] else value)


class _Signals:
    """
    Ending signals stop the app, SIGTSTP suspends it, each from a thread of its own.

    They are caught from entering on; what comes before `watch` waits in the pipe.
    """

    def __enter__(self) -> _Signals:
        self._read_fd, self._write_fd = os.pipe()
        os.set_blocking(self._write_fd, False)
        self._thread: threading.Thread | None = None
        signal.set_wakeup_fd(self._write_fd, warn_on_full_buffer=False)
        for number in (*ENDING_SIGNALS, signal.SIGTSTP):
            signal.signal(number, lambda *_: None)      # the pipe has the news
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)      # see hold_signals
        return self

    def __exit__(self, *_: object) -> None:
        for number in (*ENDING_SIGNALS, signal.SIGTSTP):
            signal.signal(number, signal.SIG_IGN)       # the end is not interrupted
        signal.set_wakeup_fd(-1)
        os.close(self._write_fd)
        if self._thread is not None:
            self._thread.join()
        os.close(self._read_fd)

    def watch(self, app: Stoppable, end: Callable[[], None]) -> None:
        """Act on signals from now on; `end` is called when the app has been stopped."""
        thread = threading.Thread(target=self._act, args=(app, end), name='signals')
        thread.start()
        self._thread = thread

    def _act(self, app: Stoppable, end: Callable[[], None]) -> None:
        ending = False
        while numbers := os.read(self._read_fd, 64):
            if not ending and any(number in ENDING_SIGNALS for number in numbers):
                ending = True
                app.stop()              # before the executor: it may be busy for seconds
                end()
            elif not ending and signal.SIGTSTP in numbers:
                app.suspend()
                signal.raise_signal(signal.SIGSTOP)     # this thread: it goes no step further
                app.resume()


def _default(parameter: Parameter) -> Any:
    """Return a default that rclpy can type: it takes an empty list for bytes."""
    return parameter.default if parameter.default != [] else ['']


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    limits = ', '.join(text for text in (parameter.unit, parameter.range_text) if text)
    descriptor = ParameterDescriptor(
        name=parameter.name, dynamic_typing=True, read_only=not parameter.run_time,
        description=parameter.description + (f' [{limits}]' if limits else ''),
        additional_constraints=parameter.range_text)
    low, high = 0.0 if parameter.or_zero else parameter.minimum, parameter.maximum
    if math.inf in (-low, high):            # a range has two ends
        return descriptor
    if isinstance(parameter.default, float):
        descriptor.type = ParameterType.PARAMETER_DOUBLE
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif isinstance(parameter.default, int):
        descriptor.type = ParameterType.PARAMETER_INTEGER
        descriptor.integer_range = [
            IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor


def first_line(error: Exception) -> str:
    """Return what an error of rclpy says to a user: its text without the place in rcl."""
    return str(error).partition('\n')[0].partition(', at ')[0] or type(error).__name__
