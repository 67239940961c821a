# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the command lines of all tools have in common: --version, layout, one line per mistake."""
from __future__ import annotations

import argparse
from collections.abc import Callable
import math
from typing import Any
from typing import NoReturn

from servobus.errors import nearest
from servobus.errors import UsageError
from servobus.printable_text import printable
from servobus.tools.cli import wrapped
from servobus.tools.version import version_of


class Parser(argparse.ArgumentParser):
    """The command line of a tool. Description and examples keep their lines, long ones wrap."""

    def __init__(self, name: str, description: str, epilog: str = '', usage: str | None = None):
        super().__init__(
            prog=name, usage=usage, description=description, epilog=epilog, allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter)
        self.add_argument('--version', action=_Version, help='print the version and exit')

    def format_help(self) -> str:
        return wrapped(super().format_help())

    def error(self, message: str) -> NoReturn:
        """Let the tool end with one line, as after every other mistake."""
        word = message.removeprefix('unrecognized arguments: ').split()[0].partition('=')[0]
        near = word.startswith('--') and nearest(word, self._option_string_actions)
        remedy = f'did you mean {near}?' if near else f'see {self.prog} --help'
        raise UsageError(f"{message.removeprefix('argument ')}; {remedy}")


class _Version(argparse.Action):
    def __init__(self, option_strings: list[str], dest: str, **more: Any):
        super().__init__(option_strings, dest, nargs=0, **more)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(version_of(parser.prog))
        parser.exit()


def baud_rate(text: str) -> int:
    """Return the rate (Bd) of '1M', '57.6k' or '115200'; ValueError where it is none."""
    factor = {'k': 1e3, 'm': 1e6}.get(text[-1:].lower())
    if factor is None:
        return int(text)
    rate = round(float(text[:-1]) * factor, 3)         # 57.6 has no exact float
    if not rate.is_integer():
        raise ValueError(text)
    return int(rate)


def number(kind: Callable[[str], float], least: float, most: float = math.inf, unit: str = ''
           ) -> Callable[[str], float]:
    """Return the type of an option: a number of this kind (int, float) within limits."""
    what = 'a number' if kind is float else 'a whole number'
    limits = f'from {least:.10g} to {most:.10g}'
    if most == math.inf:
        limits = f'of {least:.10g} or more'
    wanted = ' '.join(filter(None, (what, limits, unit)))

    def convert(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most or value == math.inf:
            raise argparse.ArgumentTypeError(f'{printable(text)}: not possible; give {wanted}')
        return value
    return convert
