# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings files as text: which nodes they are for, and the same file without some parameters.

All other values stay as they are written: `3e1` is a number for rcl and a text for PyYAML.
"""
from __future__ import annotations

from collections.abc import Container
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Sequence
import re

import yaml

_PARAMETERS = 'ros__parameters'


class SettingsError(Exception):
    """A settings file that cannot be used: 'thing: reason; remedy'."""


def check_sections(files: Sequence[str], node: str) -> None:
    """
    Raise SettingsError when there are files and none has a section for a node, by its full name.

    Such a file changes nothing, in silence: limits that a user set would not be in force.
    """
    headers = [header for file in files for header in _headers(_read_yaml(file))]
    if files and not any(_fits(header, node) for header in headers):
        what = f'it is for {", ".join(headers)}' if headers else 'it has no ros__parameters'
        raise SettingsError(f"{', '.join(files)}: has no parameters for the node {node}, {what}; "
                            f'put them below {node}: or /**:')


def _fits(header: str, node: str) -> bool:
    """Tell whether rclpy takes the parameters below a header for a node."""
    pattern = re.escape(header).replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'(/\w+)')
    return re.fullmatch(pattern, node) is not None


def _headers(node: yaml.Node | None, above: str = '') -> Iterator[str]:
    """Return the full names of all sections; a namespace may be a level of its own."""
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        if key.value == _PARAMETERS:
            yield above
        else:
            yield from _headers(value, f'{above}/{str(key.value).lstrip("/")}')


def without_parameters(file: str, names: Iterable[str]) -> str:
    """Return the text of a settings file without some parameters; '' if it has none of them."""
    root = _read_yaml(file)
    removed = _remove(root, frozenset(names), False) if root is not None else 0
    return str(yaml.serialize(root)) if removed else ''


def _read_yaml(file: str) -> yaml.Node | None:
    """Return the YAML of a settings file."""
    try:
        with open(file, encoding='utf-8') as settings:
            root = yaml.compose(settings)
        if root is None or isinstance(root, yaml.MappingNode):
            return root
        reason = 'not a file with parameters'
    except (OSError, ValueError, OverflowError, yaml.YAMLError) as error:
        reason = getattr(error, 'strerror', None) or ' '.join(str(error).split())
    except RecursionError:
        reason = 'brackets are nested too deeply'
    raise SettingsError(f'{file}: {reason}; give a file with parameters')


def _remove(node: yaml.Node, names: Container[str], inside: bool) -> int:
    """Remove what is below `ros__parameters`; return how many."""
    if not isinstance(node, yaml.MappingNode):
        return 0
    kept = [(key, value) for key, value in node.value
            if not (inside and isinstance(key, yaml.ScalarNode) and key.value in names)]
    removed = len(node.value) - len(kept)
    node.value = kept
    return removed + sum(_remove(value, names, key.value == _PARAMETERS)
                         for key, value in kept if not inside)
