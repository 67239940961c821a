# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Layers: model files laid over the files they include, and over them the firmware variants.

A field replaces an included one of the same name; `without` takes included ones away; `indirect`
replaces the included ranges; words and aliases add up. Each file is parsed once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from collections.abc import Iterable
from functools import cache
from itertools import pairwise
import os
from pathlib import Path
from typing import Any
from typing import NamedTuple

from servobus.model.checked_yaml import Check
from servobus.model.checked_yaml import describe
from servobus.model.checked_yaml import ModelError
from servobus.model.checked_yaml import Raw
from servobus.model.checked_yaml import read_yaml
from servobus.model.control_table import BYTE_ORDERS
from servobus.model.control_table import Field
from servobus.model.control_table import Indirect
from servobus.model.control_table import Model
from servobus.model.control_table import PROTOCOLS
from servobus.model.field_entries import build_fields
from servobus.model.field_entries import build_indirect
from servobus.model.field_entries import Context
from servobus.model.field_entries import FieldBudget
from servobus.model.robotis_file import read_robotis
from servobus.model.robotis_file import SUFFIX

FILE_KEYS = {'model_numbers', 'source', 'include', 'without', 'fields', 'words', 'indirect',
             'aliases', 'blocks', 'each', 'firmware', 'torque_constants', 'protocol', 'byte_order'}
EACH_KEYS = {'without', 'fields', 'indirect', 'aliases'}
VARIANT_KEYS = EACH_KEYS | {'up_to'}
INCLUDE_LIMIT = 20                 # files in files
NUMBER_MASK = 0xFFFF
_FEETECH_KEY_BIT = 0x10000         # Feetech numbers its models apart: 261 is taken twice


def model_key(number: int, protocol: str = '2') -> int:
    """Return the key of a model among those of all makers: its number, and for Feetech more."""
    return number | _FEETECH_KEY_BIT if protocol == 'feetech' else number


class Definition(NamedTuple):
    """One file as it is; numbers: name by model_key(); older: the last firmware of each table."""

    path: Path
    numbers: dict[int, str]
    older: tuple[int, ...]
    torque_constants: dict[int, float]
    protocol: str
    raw: Raw


class Layer(NamedTuple):
    """A file with all it includes."""

    fields: dict[str, Field] = {}
    words: Raw = {}
    indirect: tuple[Indirect, ...] = ()
    indirect_fields: tuple[Field, ...] = ()
    aliases: dict[str, str] = {}

    def laid_over(self, below: Layer) -> Layer:
        """Lay this over `below`; aliases of what is no longer there go too."""
        fields = {**below.fields, **self.fields}
        indirect = self if self.indirect else below
        names = fields.keys() | {field.name for field in indirect.indirect_fields}
        aliases = {alias: name for alias, name in below.aliases.items() if name in names}
        return Layer(fields, {**below.words, **self.words}, indirect.indirect,
                     indirect.indirect_fields, {**aliases, **self.aliases})

    def all_fields(self) -> tuple[Field, ...]:
        """By address, those of the indirect ranges included."""
        return tuple(sorted((*self.fields.values(), *self.indirect_fields),
                            key=lambda field: field.at))


def raise_error(error: ModelError) -> None:
    raise error


class Layers:
    """
    The files of one folder; what it does not have is included from the folder `beneath`.

    `report` gets each mistake inside a file; as long as it does not raise, the rest is checked.
    """

    def __init__(self, folder: Path, beneath: Path,
                 report: Callable[[ModelError], None] = raise_error) -> None:
        self._folders = (folder, beneath)
        self._report = report
        self.definition = cache(_read_definition)      # it reads each file once
        self._budgets: defaultdict[Path, FieldBudget] = defaultdict(FieldBudget)
        self._layers: dict[Path, Layer] = {}
        self._whole: dict[tuple[Path, int | None, int | None], Layer] = {}

    def variant(self, path: Path, firmware: int | None) -> int | None:
        """Return which older table a device with this firmware has, None for the newest one."""
        return min((up_to for up_to in self.definition(path).older
                    if firmware is not None and firmware <= up_to), default=None)

    def check(self, path: Path) -> None:
        """Build all that the file describes; mistakes go to report, or are raised."""
        definition = self.definition(path)
        if not definition.numbers:
            self._layer(path, ())
        for variant in (None, *definition.older):
            for number in definition.numbers:
                self._whole_layer(definition, number, variant)

    def model(self, path: Path, number: int, variant: int | None) -> Model:
        """Return the model `number` out of `path`; raises ModelError."""
        definition = self.definition(path)
        if number not in definition.numbers:
            raise Check(path, 'model_numbers').error(f'{number & NUMBER_MASK} was removed',
                                                     'restart after changing model files')
        layer = self._whole_layer(definition, number, variant)
        return Model(number & NUMBER_MASK, definition.numbers[number], layer.all_fields(),
                     indirect=layer.indirect, aliases=layer.aliases, file=str(path),
                     protocol=definition.protocol,
                     torque_constant=definition.torque_constants.get(number & NUMBER_MASK))

    def _whole_layer(self, definition: Definition, number: int, variant: int | None) -> Layer:
        """Lay what is said for this number and this firmware over the file; check the whole."""
        path, raw = definition.path, definition.raw
        own = raw.get('each', {}).get(number & NUMBER_MASK)
        key = path, None if own is None else number, variant
        if key not in self._whole:
            layer = self._layer(path, ())
            for entry in raw.get('firmware', ()):
                if variant is not None and entry['up_to'] == variant:
                    layer = self._lay_over(entry, layer, path, ())
            if own is not None:
                Check(path, f'each {number & NUMBER_MASK}').mapping(own, EACH_KEYS)
                layer = self._lay_over(own, layer, path, ())
            self._check_whole(path, layer)
            self._whole[key] = layer
        return self._whole[key]

    def _layer(self, path: Path, above: tuple[Path, ...]) -> Layer:
        if path in self._layers:
            return self._layers[path]
        check = Check(path, 'include')
        if path in above:
            raise check.error('includes itself', 'break the circle')
        if len(above) > INCLUDE_LIMIT:
            raise check.error(f'{len(above)} files include one another',
                              'include them all in one file')
        raw = self.definition(path).raw
        layer = Layer()
        include = raw.get('include', [])
        for name in check.sequence([include] if isinstance(include, str) else include, 'include'):
            layer = self._layer(self._find(check, name), (*above, path)).laid_over(layer)
        layer = self._lay_over(raw, layer, path, above)
        self._layers[path] = layer
        return layer

    def _find(self, check: Check, name: Any) -> Path:
        name = check.text(name, 'name')
        for folder in self._folders:
            if os.path.isfile(path := folder / f'{name}.yaml'):      # a name may be too long
                return path
        raise check.error(f'no file {name}.yaml', f'put it into {self._folders[0]}, or correct '
                          'the name (without .yaml)')

    def _lay_over(self, raw: Raw, below: Layer, path: Path,
             above: tuple[Path, ...]) -> Layer:
        """`raw` laid over `below`; mistakes in single fields go to report."""
        words = {**below.words, **raw.get('words', {})}
        own = self._own_fields(raw, words, path, above)
        indirect, indirect_fields = build_indirect(raw.get('indirect', []), path,
                                                   self._budgets[path])
        top = Layer(own, words, indirect, tuple(indirect_fields), _aliases(raw, path))
        return top.laid_over(below._replace(fields=self._without(raw, below, path)))

    def _own_fields(self, raw: Raw, words: Raw, path: Path,
                    above: tuple[Path, ...]) -> dict[str, Field]:
        def included(name: str) -> Iterable[Field]:
            found = self._find(Check(path, 'include'), name)
            return self._layer(found, (*above, path)).all_fields()

        own: dict[str, Field] = {}
        context = Context(path, words, included, self._report, self._budgets[path],
                          self.definition(path).raw.get('byte_order', 'little'))
        for field in build_fields(raw.get('fields', []), context):
            if field.name in own:
                self._report(ModelError(
                    path, field.name, f'name given twice, at {own[field.name].at} and {field.at}',
                    'rename one'))
            own[field.name] = field
        return own

    def _without(self, raw: Raw, below: Layer, path: Path) -> dict[str, Field]:
        check = Check(path, 'without')
        names = dict.fromkeys(check.text(name, 'name')
                              for name in check.sequence(raw.get('without', []), 'without'))
        for name in names:
            if name not in below.fields:
                self._report(ModelError(path, name, 'no included file has this field',
                                        'correct the name'))
        return {name: field for name, field in below.fields.items() if name not in names}

    def _check_whole(self, path: Path, layer: Layer) -> None:
        fields = layer.all_fields()
        for first, second in pairwise(fields):
            if second.at < first.end:
                self._report(ModelError(
                    path, second.name,
                    f'at {second.at} it overlaps {first.name} ({first.at} to {first.end - 1})',
                    'correct at or type, or take the other away with without: [NAME]'))
        names = {field.name for field in fields}
        for field in fields:
            if field.cases and field.cases.by not in names:
                self._report(ModelError(
                    path, field.name, f'by {describe(field.cases.by)}: no such field',
                    'correct by'))
        for alias, name in layer.aliases.items():
            if name not in names or alias in names:
                reason = 'no such field' if name not in names \
                    else f'{alias} is also the name of a field'
                self._report(ModelError(path, alias, f'alias of {describe(name)}: {reason}',
                                        'correct aliases'))


def _read_definition(path: Path) -> Definition:
    """Return what a file says, without its fields; raises ModelError."""
    raw = read_robotis(path) if path.suffix == SUFFIX else read_yaml(path)
    check = Check(path, '')
    check.mapping(raw, FILE_KEYS)
    numbers = check.names(raw.get('model_numbers', {}), 'model_numbers')
    if not numbers and not path.name.startswith('_'):
        raise check.error('no model_numbers', 'add model_numbers: {NUMBER: NAME}, or begin the '
                          'name of a file that is only included with _')
    for key in ('words', 'each', 'torque_constants'):
        if not isinstance(raw.get(key, {}), dict):
            raise Check(path, key).error(f'is {describe(raw[key])}', f'write {key}: {{...}}')
    for key in ('each', 'torque_constants'):
        for number in raw.get(key, {}).keys() - numbers.keys():
            raise Check(path, key).error(f'{number} is not in model_numbers', 'correct the number')
    check.choice(raw.get('byte_order', 'little'), 'byte_order', BYTE_ORDERS)
    protocol = check.choice(raw.get('protocol', '2'), 'protocol', PROTOCOLS)
    keys = {model_key(number, protocol): name for number, name in numbers.items()}
    return Definition(path, keys, _older_tables(raw, path), _torque_constants(raw, path),
                      protocol, raw)


def _older_tables(raw: Raw, path: Path) -> tuple[int, ...]:
    check = Check(path, 'firmware')
    entries = check.sequence(raw.get('firmware', []), 'firmware')
    for entry in entries:
        check.mapping(entry, VARIANT_KEYS)
    return tuple(check.integer(entry.get('up_to'), 'up_to', 0, 255) for entry in entries)


def _aliases(raw: Raw, path: Path) -> dict[str, str]:
    check = Check(path, 'aliases')
    aliases = raw.get('aliases', {})
    if not isinstance(aliases, dict):
        raise check.error(f'is {describe(aliases)}', 'write aliases: {...}')
    return {check.text(alias, 'an alias'): check.text(name, f'alias {alias}')
            for alias, name in aliases.items()}


def _torque_constants(raw: Raw, path: Path) -> dict[int, float]:
    check = Check(path, 'torque_constants')
    return {number: check.number(constant, str(number))
            for number, constant in raw.get('torque_constants', {}).items()}
