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
from contextlib import suppress
import json
import os
import sys
import time
from typing import Any

_PORT = '_mecarover_tap_port'                  # attribute of an open Serial: its number
_OTHERS = ('rustypot', 'reachy_mini_motor_controller')       # they open ports by themselves
_PLAIN = (bytes, bytearray, memoryview, list, tuple)
_MODULES = ('serial.serialposix', 'serial.serialwin32', 'serial.serialcli')
_HANDLERS = 'serial.urlhandler.protocol_'
_TEXT_LIMIT = 2000                             # characters of an error
_LEFT = '_mecarover_tap_left'                  # and how much it had not read, last time
_VAIN = '_mecarover_tap_vain'                  # when it last looked for bytes in vain, ns
_LOOKED = '_mecarover_tap_looked'              # when it last wrote, read or looked in vain, ns
_PAUSE = '_mecarover_tap_pause'                # when it last read, and CPU time then, ns
_WAITS = '_mecarover_tap_waits'                # it waits for the descriptor, which is not seen
AWAY_NS = 500_000                              # who looks as often does not sleep
_Method = Callable[..., Any]


def _wrap_read(sender: Any, original: _Method) -> _Method:
    put, now = sender.put, time.monotonic_ns

    def read(self: Any, *args: Any, **kwargs: Any) -> Any:
        known, began, away = self.__dict__, now(), 0
        try:
            away = began - known.get(_LOOKED, began)
            if away < AWAY_NS or _WAITS in known or not self.in_waiting:
                away = 0
        except Exception:
            pass
        data = original(self, *args, **kwargs)
        try:
            size = args[0] if args else kwargs.get('size', 1)
            is_short = not data or (getattr(self, '_timeout', None) and len(data) < size)
            if data:
                if is_short:                   # it waited for more until its time-out
                    away += now() - began
                if away:
                    sender.number('away_us', known[_PORT], away // 1000)
                put('in', known[_PORT], bytes(data))
            known[_LOOKED] = now()
            known[_VAIN] = known[_LOOKED] if is_short else 0
            known[_PAUSE] = known[_LOOKED], time.thread_time_ns()
        except Exception:
            pass
        return data
    return read


def _wrap_write(sender: Any, original: _Method) -> _Method:
    put = sender.put

    def write(self: Any, data: Any, *args: Any, **kwargs: Any) -> Any:
        size = port = 0
        try:
            _say_before(sender, self)          # answers to earlier questions
            _say_busy(sender, self)
            self.__dict__[_VAIN] = 0
        except Exception:
            pass
        try:
            if not isinstance(data, _PLAIN):   # it may be one that can be gone through once
                data = bytearray(data)
            whole = bytes(data)
            port = getattr(self, _PORT)
            size = len(whole)
            put('out', port, whole)
        except Exception:
            pass
        try:
            written = original(self, data, *args, **kwargs)
        except BaseException:
            _not_sent(sender, port, size)
            raise
        self.__dict__[_LOOKED] = time.monotonic_ns()
        if size and isinstance(written, int) and written < size:
            _not_sent(sender, port, size - written)
        return written
    return write


def _not_sent(sender: Any, port: int, size: int) -> None:
    with suppress(Exception):
        if size:
            sender.number('not_sent', port, size)


def _wrap_open(sender: Any, original: _Method) -> _Method:
    def open(self: Any, *args: Any, **kwargs: Any) -> Any:
        result = original(self, *args, **kwargs)
        with suppress(Exception):
            setattr(self, _PORT, sender.opened(str(self.port), int(self._baudrate)))
            setattr(self, _LEFT, 0)
            sender.serials.add(self)
            _say_unread(sender, self)
        return result
    return open


def _wrap_after(report: Callable[[Any, Any, int], object],
                before: Callable[[Any, Any], None] = lambda sender, serial: None
                ) -> Callable[[Any, _Method], _Method]:
    """Return a wrapper that reports a call after it, if the port is open, and before it."""
    def wrap(sender: Any, original: _Method) -> _Method:
        def call(self: Any, *args: Any, **kwargs: Any) -> Any:
            with suppress(Exception):
                before(sender, self)
            result = original(self, *args, **kwargs)
            with suppress(Exception):
                port = getattr(self, _PORT, None)
                if port is not None:
                    report(sender, self, port)
            return result
        return call
    return wrap


def _wrap_close(sender: Any, original: _Method) -> _Method:
    def close(self: Any, *args: Any, **kwargs: Any) -> Any:
        _say_unread(sender, self)
        result = original(self, *args, **kwargs)
        with suppress(Exception):
            port = getattr(self, _PORT)
            delattr(self, _PORT)
            sender.closed(port)
        return result
    return close


def _wrap_in_waiting(sender: Any, original: Any) -> Any:
    ask = getattr(original, 'fget', None)
    if ask is None:                            # it is no property there
        return original

    def in_waiting(self: Any) -> Any:
        waiting = ask(self)
        if not waiting:
            self.__dict__[_LOOKED] = time.monotonic_ns()
        return waiting
    return property(in_waiting)


def _wrap_fileno(sender: Any, original: _Method) -> _Method:
    def fileno(self: Any) -> Any:
        self.__dict__[_WAITS] = True           # its caller waits for bytes by itself
        return original(self)
    return fileno


def _say_waiting(sender: Any, serial: Any) -> None:
    """Say how much of what a port received is not read yet, if it is not nothing as before."""
    waiting = serial.in_waiting
    if waiting or getattr(serial, _LEFT):
        setattr(serial, _LEFT, waiting)
        sender.number('unread', getattr(serial, _PORT), waiting)


def _say_vain(sender: Any, serial: Any) -> None:
    """Say for how long a port was not read since it was looked at in vain."""
    vain = serial.__dict__.get(_VAIN, 0)
    if vain:
        sender.number('gave_up_us', getattr(serial, _PORT), (time.monotonic_ns() - vain) // 1000)


def _say_busy(sender: Any, serial: Any) -> None:
    """Say for how much of a pause since it read the program worked."""
    known = serial.__dict__
    began, spent = known.pop(_PAUSE, (0, 0))
    if began and (took := time.monotonic_ns() - began) > AWAY_NS:
        worked = time.thread_time_ns() - spent         # another thread's, if that read
        sender.number('busy_us', known[_PORT], max(0, min(worked, took)) // 1000)


def _say_before(sender: Any, serial: Any) -> None:
    """Say how a port stands before a write, or before what it received is thrown away."""
    _say_waiting(sender, serial)
    _say_vain(sender, serial)


def _say_unread(sender: Any, serial: Any) -> None:
    """Say how much of what a port received was never read, also where that is nothing."""
    with suppress(Exception):
        sender.number('unread', getattr(serial, _PORT), serial.in_waiting)
        _say_vain(sender, serial)


_WRAPPERS: dict[str, Callable[[Any, _Method], _Method]] = {
    'read': _wrap_read,
    'write': _wrap_write,
    'in_waiting': _wrap_in_waiting,
    'fileno': _wrap_fileno,
    'open': _wrap_open,
    'close': _wrap_close,
    '_reconfigure_port': _wrap_after(
        lambda sender, serial, port: sender.rate(port, int(serial._baudrate))),
    'reset_input_buffer': _wrap_after(
        lambda sender, serial, port: sender.number('purged', port, 1), _say_before),
    'reset_output_buffer': _wrap_after(
        lambda sender, serial, port: sender.number('purged', port, 2)),
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
    """Report what passes one open port; meanwhile its class is one that does so."""
    kind = type(port)
    found = {name: one for base in reversed(kind.__mro__) for name, one in vars(base).items()}
    own = {name: wrap(sender, found[name]) for name, wrap in _WRAPPERS.items() if name in found}
    port.__dict__.update({_PORT: sender.opened(str(port.port), int(port.baudrate)), _LEFT: 0})
    port.__class__ = type(kind.__name__, (kind,), own)
    try:
        yield
    finally:
        port.__class__ = kind
        for name in (_PORT, _LEFT, _VAIN, _LOOKED, _PAUSE, _WAITS):
            port.__dict__.pop(name, None)


class _PatchingLoader:
    """Loads a module as its own loader does, and wraps what is in it."""

    def __init__(self, loader: Any, sender: Any) -> None:
        self._loader = loader
        self._sender = sender

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: Any) -> Any:
        return self._loader.create_module(spec)

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
    """Say what was left unread, and the error that ended the program; then let readers have it."""
    for serial in list(sender.serials):
        _say_unread(sender, serial)
    with suppress(Exception):
        error = getattr(sys, 'last_value', None)       # what sys.excepthook got, any of them
        if isinstance(error, Exception):
            sender.put('ended', 0, json.dumps(_described(error)).encode())
    sender.end()


def _described(error: Exception) -> dict[str, Any]:
    """Return an error in words, and the packages that it came through."""
    packages = set()
    trace = error.__traceback__
    while trace is not None:
        packages.add(str(trace.tb_frame.f_globals.get('__name__')).partition('.')[0])
        trace = trace.tb_next
    return {'error': f'{type(error).__name__}: {error}'[:_TEXT_LIMIT],
            'packages': sorted(packages), 'python': sys.executable}


def install(sender: Any) -> None:
    """Report everything that this process does through pyserial."""
    sys.meta_path.insert(0, _Finder(sender))
    atexit.register(_end, sender)
    leave = os._exit                           # how children of multiprocessing end

    def _exit(status: int) -> Any:
        with suppress(Exception):
            _end(sender)
        leave(status)

    os._exit = _exit
    if hasattr(os, 'register_at_fork'):
        os.register_at_fork(after_in_child=sender.after_fork)
