# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
YAML with named mistakes: reading a file, checking one value after the other.

YAML is read by the rules of version 1.2: on, off, yes and no are words, 010 is not octal, and a
key given twice is a mistake. Knows nothing of control tables but what a ModelError looks like.
"""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

import yaml

NUMBER_LIMIT = 0xFFFF
NUMBER_END = 1e100           # of no register: neither infinite nor too long for a float


class ModelError(Exception):
    """A model file that cannot be used: 'file: field: reason; remedy' in one line."""

    def __init__(self, file: str | Path, field: str, reason: str, remedy: str) -> None:
        super().__init__(': '.join(part for part in (str(file), field, reason) if part)
                         + f'; {remedy}')
        self.file = str(file)
        self.field = field
        self.reason = reason
        self.remedy = remedy


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """YAML 1.2 scalars, no key twice."""

    yaml_implicit_resolvers: dict[str, Any] = {}

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        found = super().construct_mapping(node, deep)
        if len(found) != len(node.value):
            keys = [key.value for key, _ in node.value]
            twice = next((key for key in keys if keys.count(key) > 1), '?')
            raise yaml.constructor.ConstructorError(
                None, None, f'key {twice!r} twice in one mapping', node.start_mark)
        return found  # type: ignore[no-any-return]


for _tag, _pattern, _first in (
        ('bool', 'true|false', 'tf'), ('null', 'null|~|', 'n~\0'),
        ('int', '[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+', '-+0123456789'),
        ('float', r'[-+]?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?', '-+0123456789')):
    _Loader.add_implicit_resolver(f'tag:yaml.org,2002:{_tag}', re.compile(f'^(?:{_pattern})$'),
                                  list(_first))


def read_yaml(path: Path) -> Any:
    """Return what the file holds; ModelError where it cannot be read or is not YAML."""
    try:
        return yaml.load(path.read_bytes(), _Loader)
    except OSError as error:
        raise ModelError(path, '', f'cannot be read: {error.strerror}',
                         'check the file and its permissions') from None
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, 'problem_mark', None) or getattr(error, 'context_mark', None)
        line = f'line {mark.line + 1}' if mark else ''
        what = getattr(error, 'problem', None) or getattr(error, 'reason', None) or str(error)
        raise ModelError(path, line, f'not YAML: {what}', 'correct the line') from None


class Check:
    """Raises ModelError for one place in one file; the methods return what they checked."""

    def __init__(self, path: Path, field: str) -> None:
        self.path = path
        self.field = field

    def error(self, reason: str, remedy: str) -> ModelError:
        return ModelError(self.path, self.field, reason, remedy)

    def mapping(self, raw: Any, keys: set[str]) -> None:
        if not isinstance(raw, dict):
            raise self.error(f'expected a mapping, found {describe(raw)}', 'see docs/models.md')
        for key in raw:
            if key not in keys:
                raise self.error(f'unknown key {key!r}', f'use one of {", ".join(sorted(keys))}')

    def sequence(self, raw: Any, key: str) -> list[Any]:
        if not isinstance(raw, list):
            raise self.error(f'{key} is {describe(raw)}, not a list', f'write {key}: [...]')
        return raw

    def integer(self, raw: Any, key: str, first: int, last: int) -> int:
        if type(raw) is not int or not first <= raw <= last:
            raise self.error(f'{key} is {describe(raw)}',
                             f'give a whole number from {first} to {last}')
        return raw

    def number(self, raw: Any, key: str) -> float:
        if type(raw) not in (int, float) or not abs(raw) < NUMBER_END:
            raise self.error(f'{key} is {describe(raw)}', 'give a number')
        return float(raw)

    def text(self, raw: Any, key: str) -> str:
        if not isinstance(raw, str) or not raw or raw != raw.strip():
            raise self.error(f'{key} is {describe(raw)}', 'give a text')
        return raw

    def choice(self, raw: Any, key: str, choices: tuple[str, ...]) -> str:
        if raw not in choices:
            raise self.error(f'{key} is {describe(raw)}', f'use one of {", ".join(choices)}')
        return str(raw)

    def names(self, raw: Any, key: str) -> dict[int, str]:
        if not isinstance(raw, dict):
            raise self.error(f'{key} is {describe(raw)}', f'write {key}: {{NUMBER: NAME}}')
        return {self.integer(number, f'number in {key}', 0, NUMBER_LIMIT):
                self.text(name, f'name of {number}') for number, name in raw.items()}


def describe(raw: Any) -> str:
    return 'missing' if raw is None else repr(raw)
