# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Models: which device has which control table, found in folders of model files.

At the start only the line `model_numbers` of each file is read, so that the built-in models cost
nothing until a device shows up; folders of the user's are checked in full, because a wrong file
of theirs must stop the start. A user's folder wins over the built-in one, number by number;
but a table of ROBOTIS (*.model) has no words for codes, and is for numbers that no YAML file has.
"""

from __future__ import annotations

from collections.abc import Iterable
import difflib
from functools import cache
from pathlib import Path
import re

from servobus.model.checked_yaml import BUILT_IN
from servobus.model.checked_yaml import ModelError
from servobus.model.checked_yaml import read_file
from servobus.model.control_table import Model
from servobus.model.layers import Layers
from servobus.model.layers import model_key
from servobus.model.layers import NUMBER_MASK
from servobus.model.robotis_file import is_newest_table
from servobus.model.robotis_file import listed_numbers
from servobus.model.robotis_file import SUFFIX

_NUMBERS = re.compile(rb'^model_numbers: *\{([^{}#]*)\}', re.MULTILINE)
_IS_FEETECH = re.compile(rb'^[^\w#]*protocol\W+feetech\b', re.MULTILINE)
_NUMBER = re.compile(r'(0x[0-9a-fA-F]{1,4}|0|[1-9][0-9]{0,4}): +([A-Za-z0-9][^:\'"]*)')
# Names that other software gives to a model: the thesis calls this board Core.
_ALSO_CALLED = {'core': 'rhobandxlboard'}
# The P series was sold as PRO+ before: H54P-200-S500-R is PH54-200-S500.
_PRO_PLUS = re.compile(r'([hm]\d\d)p(\d+s\d+)r?')


class Models:
    """
    The models of the built-in folder and of `extra_dirs`; the first folder with a number wins.

    Raises ModelError for a missing folder, an unreadable index, or any mistake in `extra_dirs`.
    """

    def __init__(self, extra_dirs: Iterable[str | Path] = ()) -> None:
        self.problems: list[str] = []
        self._layers: dict[Path, Layers] = {}
        self._index: dict[int, tuple[Path, str]] = {}
        self._models: dict[tuple[int, int | None], Model] = {}
        for folder in map(Path, extra_dirs):
            if problems := _problems_of(folder):
                raise problems[0]
            self._add_folder(folder)
        self._add_folder(BUILT_IN)
        self._by_name = {_plain(name): number
                         for number, (_, name) in reversed(self._index.items())}

    def _add_folder(self, folder: Path) -> None:
        layers = Layers(folder, BUILT_IN)
        for path in model_files(folder):
            self._layers[path] = layers
            for number, name in read_model_numbers(path, layers).items():
                known, _ = self._index.setdefault(number, (path, name))
                if known.suffix == SUFFIX != path.suffix:
                    self._index[number] = path, name

    def get(self, number: int, firmware: int | None = None) -> Model | None:
        """
        Return the model of this model_key() (the u16 at address 0), None if there is none.

        For numbers off the wire: never raises. A file that went wrong since the start counts as
        unknown and is reported once in `problems`. Without a firmware: the newest one's table.
        """
        if number not in self._index:
            return None
        try:
            return self._load(number, firmware)
        except ModelError as error:
            self.problems.append(str(error))
            del self._index[number]
            self._by_name = {name: one for name, one in self._by_name.items() if one != number}
            return None

    def _load(self, number: int, firmware: int | None) -> Model:
        path = self._index[number][0]
        layers = self._layers[path]
        variant = layers.variant(path, firmware)
        model = self._models.get((number, variant))
        if model is None:
            model = self._models[number, variant] = layers.model(path, number, variant)
        return model

    def by_name(self, name: str, firmware: int | None = None) -> Model | None:
        """Return the model of this name; case, hyphens and underscores do not count."""
        number = self._by_name.get(_known_name(name))
        return None if number is None else self._load(number, firmware)

    def closest(self, name: str) -> str | None:
        """Return the known name most like this one, for an error message; of a series all."""
        if name.isdecimal():               # a number resembles no name
            return ' or '.join(known for key, (_, known) in self._index.items()
                               if str(key & NUMBER_MASK) == name) or None
        plain = _known_name(_plain(name).removeprefix('pro').removeprefix('plus'))
        near = difflib.get_close_matches(plain, self._by_name, 5, 0.5)
        near.sort(key=lambda one: sorted(one) != sorted(plain))        # two exchanged: the first
        found = [one for one in self._by_name if len(plain) > 2 and one.startswith(plain)] \
            or near[:1]
        return ' or '.join(self._index[self._by_name[one]][1] for one in found[:4]) or None

    def names(self) -> dict[int, str]:
        """Every known model: model_key() -> name, in order of number."""
        return {number: name for number, (_, name) in sorted(self._index.items())}


def check_models(folder: str | Path) -> list[str]:
    """Every problem in a folder of model files, one line each; [] if a monitor could use it."""
    return [str(problem) for problem in _problems_of(Path(folder))]


def _problems_of(folder: Path) -> list[ModelError]:
    problems: list[ModelError] = []
    layers = Layers(folder, BUILT_IN, problems.append)
    seen: dict[int, Path] = {}
    try:
        files = model_files(folder)
    except ModelError as error:
        return [error]
    for path in files:
        _check_file(path, layers, seen, problems)
    return problems


def _check_file(path: Path, layers: Layers, seen: dict[int, Path],
                problems: list[ModelError]) -> None:
    try:
        numbers = layers.definition(path).numbers
        problems += [
            ModelError(path, 'model_numbers',
                       f'{number & NUMBER_MASK} is in {seen[number].name} too', 'keep one of them')
            for number in numbers if number in seen]
        seen.update(dict.fromkeys(numbers, path))
        layers.check(path)
    except ModelError as error:
        problems.append(error)


def model_files(folder: Path) -> list[Path]:
    """List the model files of a folder; ModelError if there is no such folder or no file."""
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix in ('.yaml', '.yml') or (
            path.suffix == SUFFIX and is_newest_table(path)))
    except OSError as error:
        raise ModelError(folder, '', error.strerror or 'unreadable',
                         'give a folder of model files') from None
    if not paths:
        raise ModelError(folder, '', 'no model files (*.yaml, *.model)',
                         'give a folder of model files')
    listed = listed_numbers(folder)
    return [path for path in paths if path.suffix != SUFFIX or path.name in listed
            or _plain(path.stem) not in _built_in_names()]


@cache
def _built_in_names() -> set[str]:
    layers = Layers(BUILT_IN, BUILT_IN)
    return {_plain(name) for path in model_files(BUILT_IN)
            for name in read_model_numbers(path, layers).values()}


def read_model_numbers(path: Path, layers: Layers) -> dict[int, str]:
    """Read number -> name from its line if that has the plain form, else from the file."""
    text = read_file(path)
    match = _NUMBERS.search(text)
    if match is None:
        return {} if path.name.startswith('_') else layers.definition(path).numbers
    found = {}
    protocol = 'feetech' if _IS_FEETECH.search(text) else '2'
    for item in match[1].decode(errors='replace').split(','):
        number = _NUMBER.fullmatch(item.strip())
        if number is None:
            return layers.definition(path).numbers
        found[model_key(int(number[1], 0), protocol)] = number[2].rstrip()
    return found


def _known_name(name: str) -> str:
    """Return the plain form of the name that the files have for what others call so."""
    plain = _plain(name)
    old = _PRO_PLUS.fullmatch(plain)
    return f'p{old[1]}{old[2]}' if old else _ALSO_CALLED.get(plain, plain)


def _plain(name: str) -> str:
    return re.sub('[-_ ]', '', name).casefold()
