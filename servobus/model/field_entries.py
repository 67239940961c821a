# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The entries of a model file -> fields, indirect ranges, each mistake named.

The form is described in docs/models.md. Laying included files under each other is not done here
(layers.py), reading YAML neither (checked_yaml.py).
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from operator import methodcaller
from pathlib import Path
import re
from typing import Any
from typing import Literal
from typing import NamedTuple

from servobus.model.checked_yaml import Check
from servobus.model.checked_yaml import describe
from servobus.model.checked_yaml import ModelError
from servobus.model.checked_yaml import Raw
from servobus.model.control_table import ACCESS
from servobus.model.control_table import Bits
from servobus.model.control_table import Cases
from servobus.model.control_table import Field
from servobus.model.control_table import Indirect
from servobus.model.control_table import MEMORY
from servobus.model.control_table import Span
from servobus.model.control_table import STRUCTS
from servobus.model.control_table import TYPES
from servobus.model.control_table import Word

FIELD_KEYS = {'at', 'name', 'type', 'access', 'memory', 'unit', 'scale', 'offset', 'sign_bit',
              'enum', 'flags', 'show', 'by', 'mask', 'cases', 'repeat', 'step', 'source'}
CASE_KEYS = {'unit', 'scale', 'offset', 'sign_bit', 'enum', 'flags'}
GROUP_KEYS = {'repeat', 'step', 'prefix', 'shift', 'fields', 'include'}
ADDRESS_END = 0x10000
REPEAT_LIMIT = 4096
FIELDS_LIMIT = ADDRESS_END         # made for one file, those in between counted too


class TooManyError(ModelError):
    """A file with repeats that would take all time and memory; the rest of it is not built."""


class FieldBudget:
    """How many fields the entries of a file may still make; repeats in repeats multiply."""

    def __init__(self) -> None:
        self._left = FIELDS_LIMIT

    def spend(self, fields: int, check: Check) -> None:
        self._left -= fields
        if self._left < 0:
            raise TooManyError(check.path, check.field, f'with this one more than {FIELDS_LIMIT} '
                               'fields', 'no control table has so many: correct repeat')


class Context(NamedTuple):
    """What entries refer to: shared words, the fields of other files; `report` gets mistakes."""

    path: Path
    words: Mapping[str, Any]
    included: Callable[[str], Iterable[Field]]
    report: Callable[[ModelError], None]
    budget: FieldBudget
    byte_order: Literal['little', 'big'] = 'little'


def build_fields(raw: Any, context: Context) -> list[Field]:
    """Build a list of entries, repeats expanded; a wrong entry is reported and left out."""
    return [field for entry in Check(context.path, '').sequence(raw, 'fields')
            for field in _try_entry(entry, context)]


def _try_entry(entry: Any, context: Context) -> list[Field]:
    check = Check(context.path, _label(entry))
    try:
        group = isinstance(entry, dict) and ('fields' in entry or 'include' in entry)
        check.mapping(entry, GROUP_KEYS if group else FIELD_KEYS)
        return list(_build_group(entry, check, context) if group
                    else _repeat(entry, [_build_field(entry, check, context)], check,
                                 context.budget))
    except TooManyError:
        raise
    except ModelError as error:
        context.report(error)
        return []


def _build_group(entry: Raw, check: Check, context: Context) -> Iterator[Field]:
    shift = check.integer(entry.get('shift', 0), 'shift', 0, ADDRESS_END - 1)
    prefix = check.text(entry['prefix'], 'prefix') + ' ' if 'prefix' in entry else ''
    fields = [*context.included(check.text(entry['include'], 'include'))] \
        if 'include' in entry else []
    fields += build_fields(entry.get('fields', []), context)
    return _repeat(entry, [_moved(field, shift, lambda name: prefix + name, check)
                           for field in fields], check, context.budget)


def _repeat(entry: Raw, fields: list[Field], check: Check,
            budget: FieldBudget) -> Iterator[Field]:
    count = check.integer(entry.get('repeat', 1), 'repeat', 1, REPEAT_LIMIT)
    budget.spend(count * sum(1 + len(field.cases.fields if field.cases else ())
                             for field in fields), check)
    if count == 1:
        yield from fields
        return
    if any('{n}' not in field.name for field in fields):
        raise check.error('repeat without {n} in the name', "name it as 'Error Code History {n}'")
    size = fields[0].size if len(fields) == 1 else None
    step = check.integer(entry.get('step', size), 'step', 1, ADDRESS_END - 1)
    for n in range(count):
        for field in fields:
            yield _moved(field, n * step, methodcaller('replace', '{n}', str(n + 1)), check)


def _moved(field: Field, by: int, rename: Callable[[str], str], check: Check) -> Field:
    if field.end + by > ADDRESS_END:
        raise check.error(f'{rename(field.name)} ends at {field.end + by}',
                          'addresses go up to 65535')
    return field.moved(by, rename)


def _build_field(raw: Raw, check: Check, context: Context) -> Field:
    words = context.words
    type_ = check.choice(raw.get('type'), 'type', TYPES)
    fixed: Raw = {
        'at': check.integer(raw.get('at'), 'at', 0, ADDRESS_END - STRUCTS[type_].size),
        'name': check.text(raw.get('name'), 'name'), 'type': type_,
        'access': check.choice(raw.get('access', ''), 'access', ('', *ACCESS)),
        'memory': check.choice(raw.get('memory', ''), 'memory', ('', *MEMORY)),
        'byte_order': context.byte_order}
    check.choice(raw.get('source', 'single'), 'source', ('single',))
    return Field(**fixed, **_meaning(raw, check, words, type_),
                 cases=_cases(raw, fixed, check, words))


def _cases(raw: Raw, fixed: Raw, check: Check,
           words: Mapping[str, Any]) -> Cases | None:
    given = {'by', 'cases'} & raw.keys()
    if not given:
        return None
    if len(given) < 2 or not isinstance(raw['cases'], dict):
        raise check.error('by and cases need each other',
                          'write by: FIELD, cases: {CODE: {unit: ..., scale: ...}}')
    fields = {}
    for code, case in raw['cases'].items():
        check.mapping(case, CASE_KEYS)
        fields[check.integer(code, 'case', 0, 0xFFFFFFFF)] = Field(
            **fixed, **_meaning(case, check, words, fixed['type']))
    mask = check.integer(raw.get('mask', 0xFFFFFFFF), 'mask', 1, 0xFFFFFFFF)
    return Cases(check.text(raw['by'], 'by'), mask, fields)


def _meaning(raw: Raw, check: Check, words: Mapping[str, Any],
             type_: str) -> Raw:
    bits = 8 * STRUCTS[type_].size
    more: Raw = {}
    if 'unit' in raw:
        more['unit'] = check.text(raw['unit'], 'unit')
    if 'enum' in raw:
        more['enum'], more['spans'] = _enum(_words_of(raw['enum'], words, check), check)
    if 'flags' in raw:
        more['flags'] = _flags(_words_of(raw['flags'], words, check), check, bits)
    if 'scale' in raw or 'offset' in raw:
        more['scale'] = check.number(raw.get('scale', 1.0), 'scale')
        more['offset'] = check.number(raw.get('offset', 0.0), 'offset')
        if not more['scale']:
            raise check.error('scale is 0', 'leave it out for a raw number')
    if 'sign_bit' in raw:
        more['sign_bit'] = check.integer(raw['sign_bit'], 'sign_bit', 1, bits - 1)
    if 'show' in raw:
        more['hexadecimal'] = check.choice(raw['show'], 'show', ('hex',)) == 'hex'
    _check_meaning(more, check, type_)
    return more


def _check_meaning(more: Raw, check: Check, type_: str) -> None:
    given = more.keys() - {'unit', 'spans', 'offset'}
    if type_[0] == 'f' and given - {'scale'}:
        raise check.error(f'{", ".join(sorted(given))} with type {type_}', 'use an integer type')
    if given & {'flags', 'hexadecimal'} and len(given) > 1:
        raise check.error(f'{" and ".join(sorted(given))} together', 'keep one')


def _words_of(raw: Any, words: Mapping[str, Any], check: Check) -> dict[Any, Any]:
    """`enum: NAME` and `flags: NAME` take their words from the file's `words`."""
    if isinstance(raw, str):
        if raw not in words:
            known = ', '.join(sorted(map(str, words)))
            raise check.error(f'there are no words named {describe(raw)}',
                              f'use one of: {known or "(none given)"}')
        raw = words[raw]
    if not isinstance(raw, dict) or not raw:
        raise check.error(f'words are {describe(raw)}', 'give {CODE: WORD, ...}')
    return raw


def _enum(raw: dict[Any, Any], check: Check) -> tuple[dict[int, Word], tuple[Span, ...]]:
    words: dict[int, Word] = {}
    spans = []
    for code, word in raw.items():
        what = f'word of {describe(code)}'
        if type(word) not in (str, int, float):
            raise check.error(f'{what} is {describe(word)}', 'put it in quotes')
        if isinstance(word, str):
            check.text(word, what)
        else:
            check.number(word, what)
        if isinstance(code, str):
            spans.append(Span(*_range(code, check), word))
        else:
            words[check.integer(code, 'code', -2**31, 2**32 - 1)] = word
    return words, tuple(spans)


def _flags(raw: dict[Any, Any], check: Check, bits: int) -> tuple[Bits, ...]:
    found = []
    taken: set[int] = set()
    for key, word in raw.items():
        first, last = _range(key, check) if isinstance(key, str) else (key, key)
        check.integer(first, 'bit', 0, bits - 1)
        check.integer(last, 'bit', first, bits - 1)
        own = set(range(first, last + 1))
        if taken & own:
            raise check.error(f'bit {key} twice', 'name each bit once')
        taken |= own
        words = word if isinstance(word, list) else ['', word]
        values = 1 << len(own)
        if len(words) > values:
            raise check.error(f'{len(words)} words for bit {key}', 'give one for each value')
        found.append(Bits(first, values - 1,
                          tuple(w and check.text(w, f'word of bit {key}') for w in words)))
    return tuple(found)


def _range(text: str, check: Check) -> tuple[int, int]:
    match = re.fullmatch(r'(\d{1,10})-(\d{1,10})', text)
    if not match or int(match[1]) > int(match[2]):
        raise check.error(f'code {describe(text)}', "give a number, or a range as '4-5'")
    return int(match[1]), int(match[2])


def build_indirect(raw: Any, path: Path,
                   budget: FieldBudget) -> tuple[tuple[Indirect, ...], list[Field]]:
    """Return the ranges and the fields they bring: Indirect Address N and Indirect Data N."""
    ranges = []
    fields = []
    check = Check(path, 'indirect')
    n = 0
    for entry in check.sequence(raw, 'indirect'):
        check.mapping(entry, {'address', 'data', 'count', 'memory'})
        count = check.integer(entry.get('count'), 'count', 1, REPEAT_LIMIT)
        address, data = (check.integer(entry.get(key), key, 0, ADDRESS_END - size * count)
                         for key, size in (('address', 2), ('data', 1)))
        memory = check.choice(entry.get('memory', 'ram'), 'memory', MEMORY)
        budget.spend(2 * count, check)
        ranges.append(Indirect(address, data, count))
        for i in range(count):
            n += 1
            fields += [Field(address + 2 * i, f'Indirect Address {n}', 'u16', access='rw',
                             memory=memory),
                       Field(data + i, f'Indirect Data {n}', 'u8', access='rw', memory='ram')]
    return tuple(ranges), fields


def _label(entry: Any) -> str:
    if not isinstance(entry, dict):
        return 'fields'
    name = next((entry[key] for key in ('name', 'prefix', 'include') if key in entry), None)
    return str(name or f"field at {entry.get('at', '?')}")
