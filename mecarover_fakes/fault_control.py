# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Faults on command while a simulated bus runs: lines from a Unix socket or from standard input.

A line is a fault as of --fault, its times from now on, or `back` for the end of all faults, `back
NAME` or `back NAME:ID` for that of one. A socket answers each line: `ok`, or what is wrong in it.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
import os
import socketserver
import sys
import threading

from mecarover_fakes.new_socket import new_socket
from servobus.errors import ParameterError
from servobus.printable_text import printable

STANDARD_INPUT = '-'
_LINE_MAX_BYTES = 1000
Command = Callable[[str], None]


@contextmanager
def commands_from(place: str, command: Command) -> Iterator[None]:
    """
    Hand lines over to `command` in threads of their own.

    place: the path of a socket to make, or '-'. UsageError where it cannot be made.
    """
    if place == STANDARD_INPUT:
        threading.Thread(target=_read_standard_input, args=(command,), daemon=True).start()
        yield
        return

    class CommandLines(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            with suppress(ConnectionError):        # it left without reading its answers
                while line := self.rfile.readline(_LINE_MAX_BYTES):
                    self.wfile.write(f'{_answer(line, command)}\n'.encode())

    with new_socket(place, '--control'):
        server = socketserver.ThreadingUnixStreamServer(place, CommandLines)
    with server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield
        finally:
            server.shutdown()
            with suppress(FileNotFoundError):
                os.unlink(place)


def _read_standard_input(command: Command) -> None:
    # Not sys.stdin: the interpreter needs its lock to end, and who waits for a line has it.
    with open(0, 'rb', buffering=0, closefd=False) as lines:
        while line := lines.readline(_LINE_MAX_BYTES):
            answer = _answer(line, command)
            if answer != 'ok':
                print(f'fake_bus: {answer}', file=sys.stderr, flush=True)


def _answer(line: bytes, command: Command) -> str:
    try:
        command(printable(line.decode(errors='replace').strip()))
    except ParameterError as error:
        return str(error)
    return 'ok'
