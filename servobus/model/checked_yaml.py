# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
YAML with named mistakes: reading a file, checking one value after the other.

YAML is read by the rules of version 1.2: on, off, yes and no are words, 010 is not octal, and a
key given twice is a mistake. Knows nothing of control tables but what a ModelError looks like.
"""

from __future__ import annotations

from collections import Counter
import errno
import os
from pathlib import Path
import re
import reprlib
import stat
from typing import Any
from typing import NamedTuple

import yaml

from servobus.errors import ServobusError
from servobus.printable_text import printable

BUILT_IN = Path(__file__).with_name('files')
KEY_NUMBER_MAX = 0xFFFF            # in values: {NUMBER: NAME}
INTEGER_BITS = 64                  # the widest register has so many
FILE_MAX_BYTES = 500_000           # bytes; our longest file has 11 000
VALUES_MAX = 60_000                # what aliases stand for is counted each time; ours have 800
LEVELS_MAX = 50                    # libyaml calls itself for each level: too many kill the process
MESSAGE_PART_MAX_CHARS = 1000      # characters of a part of a message, at most
NUMBER_END = 1e100                 # beyond every register, and not infinite as a float
Raw = dict[str, Any]               # what a file says of one thing, by key


class ModelError(ServobusError):
    """A model file that cannot be used: 'file: field: reason; remedy' in one line."""

    def __init__(self, file: str | Path, field: str, reason: str, remedy: str) -> None:
        parts = [printable(part, MESSAGE_PART_MAX_CHARS)
                 for part in (str(file), field, reason) if part]
        super().__init__(f'{": ".join(parts)}; {printable(remedy, MESSAGE_PART_MAX_CHARS)}')


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """YAML 1.2 scalars, no key twice."""

    yaml_implicit_resolvers: dict[str, Any] = {}

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        found = super().construct_mapping(node, deep)
        if len(found) != len(node.value):
            keys = Counter(str(key.value) for key, _ in node.value)
            twice = next((key for key, count in keys.items() if count > 1), '?')
            raise _refusal(f'key {describe(twice)} twice in one mapping', node.start_mark)
        return found  # type: ignore[no-any-return]

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        number: int = self.construct_yaml_int(node)
        if number.bit_length() > INTEGER_BITS:
            raise _refusal(f'a number of {number.bit_length()} bits', node.start_mark)
        return number


def _refusal(problem: str, mark: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, mark)


for _tag, _pattern, _first in (
        ('bool', 'true|false', 'tf'), ('null', 'null|~|', 'n~\0'),
        ('int', '[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+', '-+0123456789'),
        ('float', r'[-+]?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?', '-+0123456789')):
    _Loader.add_implicit_resolver(f'tag:yaml.org,2002:{_tag}', re.compile(f'^(?:{_pattern})$'),
                                  list(_first))
_Loader.add_constructor('tag:yaml.org,2002:int', _Loader.construct_integer)


def read_yaml(path: Path) -> Any:
    """Return what the file holds; ModelError where it cannot be read or is not YAML."""
    text = read_file(path)
    try:
        _check_weight(text)
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError,
            ValueError) as error:
        # All but the first: what PyYAML raises for a value that is not of its tag, as !!int x.
        mark = getattr(error, 'problem_mark', None) or getattr(error, 'context_mark', None)
        line = f'line {mark.line + 1}' if mark else ''
        what = getattr(error, 'problem', None) or getattr(error, 'reason', None) or str(error)
        raise ModelError(path, line, f'not YAML: {what}', 'correct the line') from None


def read_file(path: Path) -> bytes:
    """Return the bytes of a model file; ModelError where it cannot be read."""
    try:
        about = os.stat(path)
        if not stat.S_ISREG(about.st_mode):        # a pipe would keep us waiting
            raise OSError(errno.EINVAL, 'not a file')
        if about.st_size > FILE_MAX_BYTES:
            raise OSError(errno.EFBIG, f'longer than {FILE_MAX_BYTES} bytes')
        with open(path, 'rb') as file:
            return file.read()
    except OSError as error:
        raise ModelError(path, '', f'cannot be read: {error.strerror}',
                         'check the file and its permissions') from None


def _check_weight(text: bytes) -> None:
    """Refuse what takes libyaml's stack or all memory; goes through the events, builds nothing."""
    weights: dict[str, int] = {}               # values, by anchor
    within: list[tuple[str | None, int]] = []  # anchor, and how many values were before it
    values = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in weights:
                raise _refusal(f'*{event.anchor} refers to nothing, or to itself',
                               event.start_mark)
            values += weights[event.anchor]
        elif isinstance(event, yaml.CollectionStartEvent):
            within.append((event.anchor, values))
            values += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = within.pop()
            weights[anchor or ''] = values - before
        elif isinstance(event, yaml.ScalarEvent):
            values += 1
            weights[event.anchor or ''] = 1
        if len(within) > LEVELS_MAX:
            raise _refusal(f'more than {LEVELS_MAX} levels', event.start_mark)
        if values > VALUES_MAX:
            raise _refusal(f'more than {VALUES_MAX} values', event.start_mark)


class Check(NamedTuple):
    """Raises ModelError for one place in one file; all but mapping() return what they checked."""

    path: Path
    field: str

    def error(self, reason: str, remedy: str) -> ModelError:
        return ModelError(self.path, self.field, reason, remedy)

    def _refused(self, key: str, raw: Any, remedy: str) -> ModelError:
        return self.error(f'{key} is {describe(raw)}', remedy)

    def mapping(self, raw: Any, keys: set[str]) -> None:
        if not isinstance(raw, dict):
            raise self.error(f'expected a mapping, found {describe(raw)}',
                             f'write it as the files in {BUILT_IN} do')
        for key in raw:
            if key not in keys:
                raise self.error(f'unknown key {describe(key)}',
                                 f'use one of {", ".join(sorted(keys))}')

    def sequence(self, raw: Any, key: str) -> list[Any]:
        if not isinstance(raw, list):
            raise self.error(f'{key} is {describe(raw)}, not a list', f'write {key}: [...]')
        return raw

    def integer(self, raw: Any, key: str, first: int, last: int) -> int:
        if type(raw) is not int or not first <= raw <= last:       # a bool is an int, too
            raise self._refused(key, raw, f'give a whole number from {first} to {last}')
        return raw

    def number(self, raw: Any, key: str) -> float:
        if type(raw) not in (int, float) or not abs(raw) < NUMBER_END:
            raise self._refused(key, raw, 'give a number')
        return float(raw)

    def text(self, raw: Any, key: str) -> str:
        if not isinstance(raw, str) or not raw or raw != raw.strip() or not raw.isprintable():
            raise self._refused(key, raw, 'give a text')
        return raw

    def choice(self, raw: Any, key: str, choices: tuple[str, ...]) -> str:
        if raw not in choices:
            raise self._refused(key, raw, f'use one of {", ".join(choices)}')
        return str(raw)

    def names(self, raw: Any, key: str) -> dict[int, str]:
        if not isinstance(raw, dict):
            raise self._refused(key, raw, f'write {key}: {{NUMBER: NAME}}')
        return {self.integer(number, f'number in {key}', 0, KEY_NUMBER_MAX):
                self.text(name, f'name of {number}') for number, name in raw.items()}


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 100


def describe(raw: Any) -> str:
    return 'missing' if raw is None else _SHORT.repr(raw)
