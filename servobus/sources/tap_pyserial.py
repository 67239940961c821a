# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The wrappers around pyserial in a tapped program; loaded by file, as tap_sender.py.

Nothing here raises into the program, and what a call of pyserial returns or raises stays as it is.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import nullcontext
from contextlib import suppress
import json
import os
import sys
import threading
import time
from types import FrameType
from typing import Any
from weakref import WeakSet

_STATE = '_mecarover_tap'                      # attribute of an open Serial
_OTHERS = ('rustypot', 'reachy_mini_motor_controller')       # they open ports by themselves
_PLAIN = (bytes, bytearray, memoryview, list, tuple)
_MODULES = ('serial.serialposix', 'serial.serialwin32', 'serial.serialcli')
_HANDLERS = 'serial.urlhandler.protocol_'
ERROR_TEXT_LIMIT = 2000                        # characters
AWAY_NS = 500_000                              # who looks as often does not sleep
_NO_READERS: set[int] = set()      # for a Serial that we did not open; nothing is added
_Method = Callable[..., Any]
_Report = Callable[[Any, Any], object]          # called with a sender and a Serial
# Classes of ports with their own open(), and who is called after it.
_WATCHED: dict[Any, tuple[_Method, list[Callable[[Any], object]]]] = {}


class _OpenSerial:
    """What is known of a Serial; it has no reference to that, which would keep it open."""

    def __init__(self, number: int) -> None:
        self.number = number                   # for the sender
        self.unread = 0                        # bytes, as last reported
        self.vain_ns = 0                       # when it last looked for bytes in vain, 0: it read
        self.looked_ns = 0                     # when it last wrote, read or looked in vain
        self.read_ns = self.read_cpu_ns = 0    # when it last read, and CPU time then
        self.waits_unseen = False              # it has the descriptor, and waits by itself
        self.reading: set[int] = set()         # threads that read it now
        self.is_lost = False                   # the driver has hung up


def _wrap_read(sender: Any, original: _Method) -> _Method:
    put, now, get_ident = sender.put, time.monotonic_ns, threading.get_ident

    def read(self: Any, *args: Any, **kwargs: Any) -> Any:
        began, away, me, reading = now(), 0, get_ident(), _NO_READERS
        try:
            state = self.__dict__[_STATE]
            reading = state.reading
            reading.add(me)
            if len(reading) > 1:
                sender.rivals.update(dict.fromkeys([*reading], state.number))
                sender.number('two_readers', state.number, 1)
            away = began - (state.looked_ns or began)
            if away < AWAY_NS or state.waits_unseen or not self.in_waiting:
                away = 0
        except Exception:
            pass
        try:
            data = original(self, *args, **kwargs)
        except Exception:
            _report_lost(sender, self)
            raise
        finally:
            reading.discard(me)
        try:
            state = self.__dict__[_STATE]      # another thread may have closed it
            size = args[0] if args else kwargs.get('size', 1)
            is_short = not data or (getattr(self, '_timeout', None) and len(data) < size)
            if data:
                if is_short:                   # it waited for more until its time-out
                    away += now() - began
                if away:
                    sender.number('away_us', state.number, away // 1000)
                put('in', state.number, bytes(data))
            state.looked_ns = state.read_ns = now()
            state.vain_ns = state.looked_ns if is_short else 0
            state.read_cpu_ns = time.thread_time_ns()
        except Exception:
            pass
        return data
    return read


def _wrap_write(sender: Any, original: _Method) -> _Method:
    put = sender.put

    def write(self: Any, data: Any, *args: Any, **kwargs: Any) -> Any:
        size = port = 0
        try:
            _report_before(sender, self)       # answers to earlier questions
            _report_busy(sender, self)
            self.__dict__[_STATE].vain_ns = 0
        except Exception:
            pass
        try:
            if not isinstance(data, _PLAIN):   # it may be one that can be gone through once
                data = bytearray(data)
            whole = bytes(data)
            port = self.__dict__[_STATE].number
            size = 0 if self.__dict__[_STATE].is_lost else len(whole)
            if size:
                put('out', port, whole)
        except Exception:
            pass
        try:
            written = original(self, data, *args, **kwargs)
        except BaseException:
            if not _report_lost(sender, self):
                _report_not_sent(sender, port, size)
            raise
        with suppress(KeyError):
            self.__dict__[_STATE].looked_ns = time.monotonic_ns()
        if size and isinstance(written, int) and written < size:
            _report_not_sent(sender, port, size - written)
        return written
    return write


def _report_not_sent(sender: Any, port: int, size: int) -> None:
    with suppress(Exception):
        if size:
            sender.number('not_sent', port, size)


def _report_lost(sender: Any, serial: Any) -> bool:
    """Report once that the driver has hung up a port; return whether it has."""
    with suppress(Exception):
        state = serial.__dict__[_STATE]
        if not state.is_lost:
            import termios  # not on Windows

            try:
                termios.tcgetattr(serial.fd)
            except termios.error as error:
                state.is_lost = True
                sender.number('unplugged', state.number, error.args[0])
        return bool(state.is_lost)
    return False


def _wrap_around(after: _Report, before: _Report = lambda sender, serial: None
                 ) -> Callable[[Any, _Method], _Method]:
    """Return a wrapper that reports a call before and after it."""
    def wrap(sender: Any, original: _Method) -> _Method:
        def call(self: Any, *args: Any, **kwargs: Any) -> Any:
            with suppress(Exception):
                before(sender, self)
            try:
                result = original(self, *args, **kwargs)
            except Exception:
                _report_lost(sender, self)
                raise
            with suppress(Exception):
                after(sender, self)
            return result
        return call
    return wrap


def _wrap_in_waiting(sender: Any, original: Any) -> Any:
    ask = getattr(original, 'fget', None)
    if ask is None:                            # it is no property there
        return original

    def in_waiting(self: Any) -> Any:
        try:
            waiting = ask(self)
        except Exception:
            _report_lost(sender, self)
            raise
        if not waiting:
            with suppress(KeyError):
                self.__dict__[_STATE].looked_ns = time.monotonic_ns()
        return waiting
    return property(in_waiting)


def _wrap_fileno(sender: Any, original: _Method) -> _Method:
    def fileno(self: Any) -> Any:
        with suppress(KeyError):
            self.__dict__[_STATE].waits_unseen = True
        return original(self)
    return fileno


def _report_vain(sender: Any, state: _OpenSerial) -> None:
    """Report for how long a port was not read since it was looked at in vain."""
    if state.vain_ns:
        sender.number('gave_up_us', state.number, (time.monotonic_ns() - state.vain_ns) // 1000)


def _report_busy(sender: Any, serial: Any) -> None:
    """Report for how much of a pause since it read the program worked."""
    state = serial.__dict__[_STATE]
    took = time.monotonic_ns() - state.read_ns
    if state.read_ns and took > AWAY_NS:
        worked = time.thread_time_ns() - state.read_cpu_ns     # another thread's, if that read
        sender.number('busy_us', state.number, max(0, min(worked, took)) // 1000)
    state.read_ns = 0


def _report_before(sender: Any, serial: Any) -> None:
    """Report what is not read yet before a write, or before that is thrown away."""
    state, waiting = serial.__dict__[_STATE], serial.in_waiting
    if waiting or state.unread:                # else it is nothing as before
        state.unread = waiting
        sender.number('unread', state.number, waiting)
    _report_vain(sender, state)


def _report_unread(sender: Any, serial: Any) -> None:
    """Report how much of what a port received was never read, also where that is nothing."""
    with suppress(Exception):
        state = serial.__dict__[_STATE]
        sender.number('unread', state.number, serial.in_waiting)
        _report_vain(sender, state)


def _number(serial: Any) -> int:
    return int(serial.__dict__[_STATE].number)


def _begin(sender: Any, serial: Any, baud: Any) -> None:
    serial.__dict__[_STATE] = _OpenSerial(sender.opened(str(serial.port), int(baud)))


def _report_opened(sender: Any, serial: Any) -> None:
    _begin(sender, serial, serial._baudrate)
    sender.serials.add(serial)
    _report_unread(sender, serial)


_WRAPPERS: dict[str, Callable[[Any, _Method], _Method]] = {
    'read': _wrap_read,
    'write': _wrap_write,
    'in_waiting': _wrap_in_waiting,
    'fileno': _wrap_fileno,
    'open': _wrap_around(_report_opened),
    'close': _wrap_around(
        lambda sender, serial: sender.closed(serial.__dict__.pop(_STATE).number), _report_unread),
    '_reconfigure_port': _wrap_around(
        lambda sender, serial: sender.rate(_number(serial), int(serial._baudrate))),
    'reset_input_buffer': _wrap_around(
        lambda sender, serial: sender.number('purged', _number(serial), 1), _report_before),
    'reset_output_buffer': _wrap_around(
        lambda sender, serial: sender.number('purged', _number(serial), 2)),
}


def wrap_classes(sender: Any, module: Any) -> None:
    """Wrap the ports that a module of pyserial defines; those that hand on to another stay."""
    base = sys.modules['serial.serialutil'].SerialBase
    for one in list(vars(module).values()):
        if not (isinstance(one, type) and issubclass(one, base)
                and one.__module__ == module.__name__):
            continue
        if module.__name__.startswith(_HANDLERS) and base not in one.__bases__:
            continue
        for name, wrap in _WRAPPERS.items():
            if name in vars(one):
                setattr(one, name, wrap(sender, vars(one)[name]))


@contextmanager
def tapped(port: Any, sender: Any) -> Iterator[None]:
    """
    Report what passes one open port; meanwhile its class is one that does so.

    A program that connects again makes a new Serial: that is heard in place of a closed one.
    """
    kind = type(port)
    found = {name: one for base in reversed(kind.__mro__) for name, one in vars(base).items()}
    own = {name: wrap(sender, found[name]) for name, wrap in _WRAPPERS.items() if name in found}
    reporting = type(kind.__name__, (kind,), own)
    ports = WeakSet[Any]()

    def begin(serial: Any) -> None:
        ports.add(serial)
        _begin(sender, serial, serial.baudrate)
        serial.__class__ = reporting

    def take_place(serial: Any) -> None:
        if type(serial) is kind and serial.port == port.port and not any(
                one.is_open for one in ports):
            begin(serial)

    begin(port)
    try:
        with _opens_watched(kind, take_place) if 'open' in found else nullcontext():
            yield
    finally:
        for one in [*ports]:
            _report_unread(sender, one)
            one.__class__ = kind
            one.__dict__.pop(_STATE, None)


@contextmanager
def _opens_watched(kind: Any, watch: Callable[[Any], object]) -> Iterator[None]:
    """Call `watch` with each port of a class that was opened; others may watch it as well."""
    kind = next(one for one in kind.__mro__ if 'open' in vars(one))
    if kind not in _WATCHED:
        watches: list[Callable[[Any], object]] = []
        _WATCHED[kind] = kind.open, watches
        kind.open = _wrap_around(lambda _, serial: [one(serial) for one in [*watches]])(
            None, kind.open)
    original, watches = _WATCHED[kind]
    watches.append(watch)
    try:
        yield
    finally:
        watches.remove(watch)
        if not watches:
            kind.open = original
            del _WATCHED[kind]


class _PatchingLoader:
    """Loads a module as its own loader does, and wraps what is in it."""

    def __init__(self, loader: Any, sender: Any) -> None:
        self._loader = loader
        self._sender = sender

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def exec_module(self, module: Any) -> None:
        self._loader.exec_module(module)
        with suppress(Exception):
            wrap_classes(self._sender, module)


class _Finder:
    """Finds the modules of pyserial as the others do, and has them wrapped."""

    def __init__(self, sender: Any) -> None:
        self._sender = sender

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name in _OTHERS:
            with suppress(Exception):
                self._sender.give_way()
        if name not in _MODULES and not name.startswith(_HANDLERS):
            return None
        for finder in sys.meta_path:
            spec: Any = None
            if finder is not self and hasattr(finder, 'find_spec'):
                spec = finder.find_spec(name, path, target)
            if spec is not None:
                if hasattr(spec.loader, 'exec_module'):
                    spec.loader = _PatchingLoader(spec.loader, self._sender)
                return spec
        return None


def _end(sender: Any) -> None:
    """Report what was left unread, and the error that ended the program; then send the rest."""
    for serial in list(sender.serials):
        _report_unread(sender, serial)
    with suppress(Exception):
        error = getattr(sys, 'last_value', None)       # what sys.excepthook got, any of them
        if isinstance(error, Exception):
            _report_error(sender, error)
    sender.end()


def _report_error(sender: Any, error: Exception, is_of_thread: bool = False) -> None:
    sender.put('ended', 0, json.dumps(_described(error) | {'thread': is_of_thread}).encode())


def _watch_threads(sender: Any) -> None:
    """Report the error that ends a thread, while a port is open."""
    original = threading.excepthook

    def report(arguments: Any) -> None:
        with suppress(Exception):
            if isinstance(arguments.exc_value, Exception) and any(
                    one.is_open for one in sender.serials):
                _report_error(sender, arguments.exc_value, True)
                port = sender.rivals.get(threading.get_ident())
                if port:
                    sender.number('two_readers', port, 3)
        original(arguments)

    threading.excepthook = report


def packages_of(error: BaseException) -> set[str]:
    """Return the packages that an exception came through."""
    return {str(frame.f_globals.get('__name__')).partition('.')[0] for frame in _frames(error)}


def _frames(error: BaseException) -> list[FrameType]:
    """Return the frames that an exception came through; the last raised it."""
    frames, trace = [], error.__traceback__
    while trace is not None:
        frames.append(trace.tb_frame)
        trace = trace.tb_next
    return frames


def _is_by_stop(error: BaseException | None) -> bool:
    """Tell whether an error came while Ctrl-C was dealt with."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _described(error: Exception) -> dict[str, Any]:
    """Return an error in words, and where it came from."""
    return {'error': f'{type(error).__name__}: {error}'[:ERROR_TEXT_LIMIT],
            'packages': sorted(packages_of(error)),
            'stopped': _is_by_stop(error),
            'function': next((frame.f_code.co_name for frame in reversed(_frames(error))), ''),
            'python': sys.executable}


def _watch_opens(sender: Any) -> None:
    """Let strace hear the ports that are opened without pyserial."""
    def look(event: str, arguments: Any) -> None:
        if event == 'open':
            with suppress(Exception):
                if not sys._getframe(1).f_globals['__name__'].startswith('serial.'):
                    sender.note_open(arguments[0], arguments[2])
        elif event == 'os.exec':               # another program takes the place of this one
            with suppress(Exception):
                if not os.path.basename(os.fsdecode(arguments[0])).startswith('python'):
                    sender.give_way()

    if sys.platform == 'linux':
        sys.addaudithook(look)


def install(sender: Any) -> None:
    """Report everything that this process does through pyserial."""
    sys.meta_path.insert(0, _Finder(sender))
    _watch_opens(sender)
    _watch_threads(sender)
    atexit.register(_end, sender)
    leave = os._exit                           # how children of multiprocessing end

    def _exit(status: int) -> Any:
        with suppress(Exception):
            _end(sender)
        leave(status)

    os._exit = _exit
    if hasattr(os, 'register_at_fork'):
        os.register_at_fork(after_in_child=sender.after_fork)
