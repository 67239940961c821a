# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What the launch files take, as data, and what to say of an argument that none of them has."""
from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
import os
from typing import NamedTuple

from servobus.errors import did_you_mean

PACKAGE = 'mecarover_serial'
_ASSIGN = ':='
YES = ('true', 'True', '1')
NO = ('false', 'False', '0')
LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')


class Argument(NamedTuple):
    """An argument of a launch file; `choices` are all that it takes, none: any text."""

    name: str
    default: str
    text: str
    choices: tuple[str, ...] = ()


class LaunchedNode(NamedTuple):
    """
    A node that launch files start; `label` is its short name, where there are several nodes.

    `parameters`, name and text, are arguments that are parameters of the node; `settings` is a
    file of our folder config. `remapped` are topics with a name that is an argument.
    """

    node: str
    label: str
    settings: str
    parameters: tuple[tuple[str, str], ...]
    respawn: bool
    remapped: tuple[tuple[str, str], ...] = ()

    def argument_names(self, is_one_of_several: bool) -> dict[str, str]:
        """Return the names of its arguments: one that all nodes have carries the node's name."""
        names = {one.name: one.name for one in self.arguments()}
        if is_one_of_several:
            names |= {one: f'{self.label}_{one}' for one in ('config', 'name', 'enclave')}
            names['respawn'] = f'respawn_{self.label}'
        return names

    def arguments(self) -> list[Argument]:
        """Return its own arguments."""
        return [
            *(Argument(name, '', f'{text}; default: from the file')
              for name, text in self.parameters),
            *(Argument(name, name, text) for name, text in self.remapped),
            Argument('config', self.settings,
                     f'file with parameters of {self.node}; it overrides SetParameter of a launch '
                     'file and our own file, and arguments override it'),
            Argument('name', self.node, f'name of the node {self.node}'),
            Argument('enclave', '', f'SROS2 enclave, e.g. /{self.node}'),
            Argument('respawn', str(self.respawn).lower(),
                     f'restart {self.node} when it ends', YES + NO),
        ]


BRIDGE = LaunchedNode(
    'vel2d_bridge', 'bridge', 'bridge.yaml',
    (('port', 'the UART to the MCU'), ('baud', 'its baud rate')),
    respawn=True, remapped=(('cmd_vel', 'topic of the commands'),))
MONITOR = LaunchedNode(
    'dxl_monitor', 'monitor', 'monitor.yaml',
    (('ports', "port of the bus, or a list: \"['/dev/ttyUSB0','/dev/ttyUSB1']\""),
     ('bauds', 'its baud rate, or a list'),
     ('devices', "the devices on it, as a list: \"['1:MX-106:left_knee','2-20:MX-64']\"")),
    respawn=False)
SHARED = (
    Argument('namespace', '', 'namespace of the nodes and their topics'),
    Argument('log_level', 'info', 'debug, info, warn, error, fatal',
             LOG_LEVELS + tuple(level.upper() for level in LOG_LEVELS)),
)


def arguments_of(*nodes: LaunchedNode) -> list[Argument]:
    """Return the arguments of a launch file that starts these nodes."""
    own = []
    for node in nodes:
        names = node.argument_names(len(nodes) > 1)
        own += [one._replace(name=names[one.name]) for one in node.arguments()]
    return [*SHARED, *own]


class UnknownArgument(Exception):
    """A launch argument that does not exist: 'file: reason; remedy'."""


def typed_names(words: Sequence[str]) -> set[str]:
    """Return the arguments that a command line of `ros2 launch` gives."""
    return {name for name, mark, _ in (word.partition(_ASSIGN) for word in words)
            if mark and name.isidentifier()}


def refuse_unknown(file: str, names: Sequence[str], words: Sequence[str]) -> None:
    """
    Raise UnknownArgument for the first argument that `words`, a command line, give in vain.

    Only where they start this `file`, by its path or by `mecarover_serial NAME`: a launch file
    of the user that includes it has arguments of its own, and may have the same name.
    """
    base = os.path.basename(file)
    if (PACKAGE, base) not in pairwise(words) and not any(
            os.path.isfile(word) and os.path.samefile(word, file) for word in words):
        return
    for name in sorted(typed_names(words) - {*names}):
        raise UnknownArgument(f'{base}: there is no argument {name}; {did_you_mean(name, names)}')
