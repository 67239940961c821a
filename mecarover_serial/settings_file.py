# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Settings files as text: take parameters out and leave all other values as they are written."""
from __future__ import annotations

from collections.abc import Container
from collections.abc import Iterable

import yaml

_PARAMETERS = 'ros__parameters'


class SettingsError(Exception):
    """A settings file that cannot be read: 'thing: reason; remedy'."""


def without(text: str, names: Iterable[str]) -> str:
    """
    Return a parameter file without some parameters of all its nodes; as it is if it has none.

    Works on the nodes of YAML, not on values: `3e1` stays what rcl reads as a number. Raises
    SettingsError for text that is not YAML.
    """
    try:
        root = yaml.compose(text)
    except yaml.YAMLError as error:
        raise SettingsError(' '.join(str(error).split())) from error
    except RecursionError:
        raise SettingsError('too many brackets in brackets') from None
    if root is not None and not isinstance(root, yaml.MappingNode):
        raise SettingsError('this is not a file with parameters')
    removed = _remove(root, frozenset(names), False) if root is not None else 0
    return str(yaml.serialize(root)) if removed else text


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
