# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The scenes of healthy.yaml, broken.yaml and field.yaml; the second says how to write one."""

from functools import partial
from itertools import chain
from pathlib import Path
import re
import shlex

import yaml

from rigs import damage
from rigs.bus import adapter
from rigs.bus import faults
from rigs.bus import masters
from rigs.bus import masters1
from rigs.bus import servo
from rigs.bus import servo1
from rigs.bus.scene import keys
from rigs.bus.scene import numbers
from rigs.bus.scene import Scene

PROGRAMS = vars(masters) | vars(masters1)
EQUIPMENT = {name: one for module in (adapter, servo, servo1) for name, one in vars(module).items()
             if name.isupper()} | {one.__name__: one for one in (
                 damage.flip_bit, damage.replace_bytes, damage.cut_end, faults.first_byte,
                 faults.lost_first, faults.stray, faults.acknowledgement)}


def value(word):
    """Return what a word of a call is."""
    if word.startswith('0x'):
        return bytes.fromhex(word[2:])
    return EQUIPMENT[word] if word in EQUIPMENT else yaml.safe_load(word)


def call(text):
    """Return the name, the arguments and the options of a call: reads 3 132 4 every_s=0.1."""
    name, *words = shlex.split(text)
    options = [word for word in words if '=' in word]
    return name, [value(word) for word in words if word not in options], {
        key: value(word) for key, word in (option.split('=', 1) for option in options)}


def program_of(text):
    name, _, options = call(text)
    return partial(PROGRAMS[name], **options)


def faults_of(text):
    """Return what goes wrong; `latched 1-6`: with each of them."""
    name, arguments, options = call(text)
    if 'program' in options:
        return [faults.second_master(program_of(options['program']), arguments)]
    ids = re.match(r'\w+ (\d+-\d+)', text)
    return [getattr(faults, name)(*first, *arguments[len(first):], **options)
            for first in ([(number,) for number in numbers(ids[1])] if ids else [()])]


def scene(name, program, first='', beside='', expected='', fault=(), also='', devices='',
          **others):
    master = program_of(program)
    if first:
        master = masters.setup_then(program_of(first), master)
    if beside:
        extra, arguments, options = call(beside)
        master = masters.beside(master, PROGRAMS[extra](*arguments), **options)
    wrong = [fault] if isinstance(fault, str) else fault
    return Scene(name, master, keys(expected), tuple(chain(*map(faults_of, wrong))), keys(also),
                 devices=tuple(devices.split()), **{
                     key: numbers(str(one)) if key in ('ids', 'spares', 'absent')
                     else EQUIPMENT.get(one, one) for key, one in others.items()})


def rows_of(file):
    return yaml.safe_load(Path(__file__).with_name(file).read_text(encoding='utf-8'))


HEALTHY = tuple(scene(name, **row) for name, row in rows_of('healthy.yaml').items())
BROKEN = tuple(scene(name, **row) for name, row in rows_of('broken.yaml').items())
_CASES = rows_of('field.yaml')
PLAYED = tuple(scene(name, **row) for name, row in _CASES.items() if 'program' in row)
NOT_PLAYED = [name for name, row in _CASES.items() if 'not_played' in row]
