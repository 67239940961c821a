# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A process that reads what strace prints of a program, and sends it to the listeners of tap:NAME.

strace, and with it the program, waits while its pipe is full. So this reads all the time; what a
listener does not take is counted and left out (tap_sender.py). It needs the standard library only.
"""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import sys
import time

from msg_defs import event
from servobus.sources.strace_parser import PortEvent
from servobus.sources.strace_parser import StraceParser
from servobus.sources.tap_sender import OPENED
from servobus.sources.tap_sender import Sender

_READ_SIZE = 1 << 16


class _Relay:
    def __init__(self, name: str) -> None:
        self._sender = Sender(name)
        self._numbers: dict[str, dict[int, int]] = {}      # by port and the process that has it
        self._rates: dict[str, int] = {}       # by port, also while it is closed

    def run(self, output: int) -> None:
        parser = StraceParser(process_of)
        while data := os.read(output, _READ_SIZE):
            for one in parser.feed(data, time.monotonic_ns() - time.time_ns()):
                self._send_event(one)
        self._sender.end()

    def _send_event(self, one: PortEvent) -> None:
        stamp, port, what, data, process, value = one
        numbers = self._numbers.setdefault(port, {})
        if process and process not in numbers:
            numbers[process] = self._sender.opened(
                port, 0 if numbers else self._rates.get(port, 0), stamp)
        number = numbers.get(process) or min(numbers.values())
        if what == event.CLOSED:
            for each in self._numbers.pop(port).values():
                self._sender.closed(each, stamp)
        elif what == event.BAUD:
            self._rates[port] = value
            self._sender.rate(number, value, stamp)
        elif data:
            self._sender.put(what, number, data, stamp)
        elif what != OPENED:
            self._sender.number(what, number, value, stamp)


def process_of(thread: int) -> int:
    """Return the process of a thread; where that is over, the thread itself."""
    with suppress(OSError, ValueError, IndexError):
        status = Path(f'/proc/{thread}/status').read_text()
        return int(status.partition('\nTgid:')[2].split(maxsplit=1)[0])
    return thread


def main() -> None:
    """Run with the name of the tap; stdin is what strace prints."""
    _Relay(sys.argv[1]).run(sys.stdin.fileno())
