# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Parameters as data: what each is, what it takes, and what to say when it is given something else.

rclpy's own typing kills a node for `-p cmd_vel_timeout:=1` (an int for a double) and accepts
anything once checks are off; so values are converted and checked here, without ROS.
"""
from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
import math
from typing import Any
from typing import NamedTuple

from msg_defs.diagnostics import HEADLINE
from msg_defs.diagnostics import number
from msg_defs.diagnostics import TIMING_TOPICS
from servobus.errors import did_you_mean
from servobus.errors import ParameterError

_TYPE_NAMES = {bool: 'bool', int: 'integer', float: 'double', str: 'string'}
_RCLPY_PARAMETERS = ('use_sim_time', 'start_type_description_service')


class Parameter(NamedTuple):
    """
    One parameter. Its type is that of `default`: bool, int, float, str, or a list by `element`.

    `minimum` and `maximum` are inclusive; `or_zero` lets 0 through below the minimum.
    """

    name: str
    default: Any
    description: str
    unit: str = ''
    minimum: float = -math.inf
    maximum: float = math.inf
    or_zero: bool = False
    choices: tuple[str, ...] = ()
    element: type | None = None         # a list of these
    run_time: bool = False              # may change while the node runs

    @property
    def type_name(self) -> str:
        """The type as a user of ROS parameters knows it."""
        if self.element is not None:
            return f'{_TYPE_NAMES[self.element]} list'
        return _TYPE_NAMES[type(self.default)]

    @property
    def range_text(self) -> str:
        """The values it takes, in words; '' when any."""
        if self.choices:
            return ', '.join(self.choices)
        limits = ', '.join(f'{sign} {number(limit)}' for sign, limit in (
            ('>=', self.minimum), ('<=', self.maximum)) if math.isfinite(limit))
        return limits + (' or 0' if self.or_zero and limits else '')


TIMING_PARAMETER = Parameter(
    'timing_topics', HEADLINE, 'headline: DiagnosticArray and a Float64 per metric; all: '
    'statistics_msgs/MetricsMessage too; off: none', choices=TIMING_TOPICS)


def convert(parameter: Parameter, raw: Any) -> Any:
    """Return `raw` as the parameter's type; raise ParameterError when it cannot be that."""
    if parameter.element is None:
        return _scalar(parameter, type(parameter.default), raw)
    if isinstance(raw, str | bytes) or not hasattr(raw, '__iter__'):
        raw = [] if raw is None else [raw]      # a scalar is a list of one
    # An empty string in a list is how ROS spells an empty list.
    return [_scalar(parameter, parameter.element, item) for item in raw if item != '']


def unknown_names(names: Sequence[str], given: Sequence[str]) -> list[str]:
    """Return a line for each given name that is not a parameter, with the one probably meant."""
    return [f'{name}: no such parameter, ignored; {did_you_mean(name, names)}'
            for name in given if name not in (*names, *_RCLPY_PARAMETERS)]


def split_ros_args(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments for ROS, which stand between --ros-args and --, and the others."""
    ros: list[str] = []
    others: list[str] = []
    into = others
    for argument in arguments:
        if argument == '--ros-args':
            into = ros
        elif argument == '--' and into is ros:
            into = others
        else:
            into.append(argument)
    return ros, others


def settings_files(arguments: Sequence[str]) -> list[str]:
    """Return the files of `--params-file FILE` after --ros-args."""
    return [file for word, file in pairwise(split_ros_args(arguments)[0])
            if word == '--params-file']


def typed_parameters(arguments: Sequence[str], node: str) -> dict[str, Any]:
    """Return the values of `-p [NODE:]NAME:=VALUE` after --ros-args; the last one counts."""
    found = {}
    for word, value in pairwise([*split_ros_args(arguments)[0], '']):
        if word in ('-p', '--param') and ':=' in value:
            name, _, text = value.partition(':=')
            where, _, name = name.rpartition(':')
            if where.lstrip('/') in ('', '**', '*', node):
                found[name] = parse_value(text)
    return found


def parse_value(text: str) -> Any:
    """Return a value as rcl reads it: for PyYAML alone 1e-3 is a text and 2026-11-28 a date."""
    import yaml  # dxl_tap starts without it
    with suppress(Exception):           # no YAML, a mapping: PyYAML raises more than YAMLError
        node: Any = yaml.compose(text)
        return [_plain(one) for one in node.value] if node.id == 'sequence' else _plain(node)
    return text


def _plain(node: Any) -> Any:
    """Return a scalar of YAML: in quotes it is text."""
    text = node.value
    if node.style:
        return text
    if node.tag.endswith(':bool'):
        return text.lower() in ('true', 'yes', 'on')
    with suppress(ValueError):
        return int(text, 0)
    with suppress(ValueError):
        return float(text)
    return text


def _scalar(parameter: Parameter, wanted: type, raw: Any) -> Any:
    value = _of_type(parameter, wanted, raw)
    if value is None or (parameter.choices and value not in parameter.choices) \
            or not _is_in_range(parameter, value):
        raise ParameterError(_error_line(parameter, raw if value is None else value))
    return value


def _of_type(parameter: Parameter, wanted: type, raw: Any) -> Any:
    """Return a value as a type, None where it cannot be that."""
    if wanted in (bool, str) and isinstance(raw, wanted):
        return raw
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        return None
    if wanted is str and parameter.element is not None:
        return f'{raw:g}' if isinstance(raw, float) else str(raw)   # devices:=[30] means '30'
    with suppress(OverflowError, ValueError):       # no float holds it; inf and NaN are no int
        if wanted is float and math.isfinite(raw):
            return float(raw)
        if wanted is int and raw == int(raw):
            return int(raw)
    return None


def _is_in_range(parameter: Parameter, value: Any) -> bool:
    return isinstance(value, str | bool) or (parameter.or_zero and value == 0) \
        or parameter.minimum <= value <= parameter.maximum


def _error_line(parameter: Parameter, raw: Any) -> str:
    shown = repr(raw)
    if len(shown) >= 60:
        shown = shown[:57] + '...'
    article = 'an' if parameter.type_name[0] == 'i' else 'a'
    limits = f' ({parameter.range_text})' if parameter.range_text else ''
    unit = f' in {parameter.unit}' if parameter.unit else ''
    return (f'{parameter.name}: {shown} is not possible; '
            f'set {article} {parameter.type_name}{unit}{limits}, e.g. {_example(parameter)}')


def _example(parameter: Parameter) -> str:
    default = parameter.default
    if isinstance(default, bool):
        return str(default).lower()
    return repr(default or 0.5) if isinstance(default, float) else repr(default)      # 0: off
