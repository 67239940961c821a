# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Options that fake_bus and fake_mcu have in common."""

from __future__ import annotations

from argparse import ArgumentTypeError
from argparse import Namespace
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import contextmanager
from contextlib import suppress
import signal
from types import FrameType
from typing import NamedTuple

from mecarover_serial.parameters import split_ros_args
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

_ENDING = (signal.SIGINT, signal.SIGTERM)


def parse_options(parser: Parser, arguments: Sequence[str]) -> Namespace:
    """Return the options; --ros-args, which a launch file adds to a Node, means nothing here."""
    return parser.parse_args(split_ros_args(arguments)[1])


def hold_signals() -> None:
    """Let signals wait for one_signal(): a link that is being made must go away again."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)


@contextmanager
def one_signal() -> Iterator[None]:
    """Let the first signal end what is done in here; no other interrupts what is done after it."""
    has_come = False

    def end(signal_number: int, frame: FrameType | None) -> None:
        nonlocal has_come
        if not has_come:
            has_come = True
            raise KeyboardInterrupt

    ending = [one for one in _ENDING
              if signal.getsignal(one) != signal.SIG_IGN]           # as nohup has it
    for one in ending:
        signal.signal(one, end)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
        yield
    finally:
        for one in ending:
            signal.signal(one, signal.SIG_IGN)


def add_options(parser: Parser) -> None:
    """Add the options of a program that plays hardware on a pty."""
    add = parser.add_argument
    add('--link', metavar='PATH', help='make this symlink to the pty, for the node to open')
    add('--vanish', type=_away, metavar='AFTER:FOR',
        help='unplug after so many seconds, for so long')
    add('--seed', type=int, default=1, help='seed of the faults (default %(default)s)')
    add('--outlive', action='store_true', help='at Ctrl-C wait until the host closed the port')
    add('--seconds', type=number(float, 0), metavar='S',
        help='end after this time (default: run until Ctrl-C)')


class Away(NamedTuple):
    """When the adapter is unplugged, and for how long (s)."""

    after: float
    duration: float

    def covers(self, now_s: float) -> bool:
        """Tell whether it is unplugged so long after the start."""
        return self.after <= now_s < self.after + self.duration


def _away(text: str) -> Away:
    """Return what `--vanish AFTER:FOR` means."""
    with suppress(ValueError):
        after, duration = map(float, text.split(':'))
        if after >= 0 and duration >= 0:
            return Away(after, duration)
    raise ArgumentTypeError(f'{text}: not AFTER:FOR; give seconds, as in 3:1.5')
