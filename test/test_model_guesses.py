# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The registers of a device of unknown model: over all models, and on a bus."""

from collections import Counter
from pathlib import Path

from heard_bus import Bus
from heard_bus import PONG
import pytest

from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from rigs.tables import rows_of
from servobus.model import model_guesses as guesses
from servobus.model.models import Models

ALL = guesses.ModelGuesses(Models())
SERVOS = ALL.servos()
PROGRAMS = {
    'moves': ('Torque Enable', 'Goal Position', 'Present Position'),
    'looks': ('Torque Enable', 'Goal Position', 'Present Position', 'Present Velocity',
              'Present Load', 'Present Input Voltage', 'Present Temperature'),
    'sets up': ('ID', 'Baud Rate', 'Return Delay Time', 'Operating Mode', 'Torque Enable', 'Lock',
                'Max Position Limit', 'Min Position Limit', 'Goal Position')}
LEFT_OUT = {
    'nothing': lambda one, model: False,
    'model': lambda one, model: one is model,
    'table': lambda one, model: one.file == model.file,
}


def kind(field):
    return (field.name, field.size if field.name in guesses.POSITIONS else field.type,
            field.size == 1 or field.byte_order)


def named(model, program, left_out):
    """Return how many registers got a name; which are named wrongly, in a table of the others."""
    tables = [one for one in SERVOS if one.protocol == model.protocol
              and not LEFT_OUT[left_out](one, model)]
    used = [(field.at, field.size) for name in PROGRAMS[program]
            if (field := model.by_name.get(name))]
    found = guesses.agreed_model(tables, used)
    result = Counter()
    for at, _ in used:
        truth, said = model.by_address[at], found.by_address.get(at)
        if said is None or said.name == f'Address {at}':
            result['no name'] += 1
        elif truth.name in said.name.split(' or ') and said.size == truth.size:
            result['right'] += 1       # one of two goals
        elif kind(said) != kind(truth):
            result[f'{said} of {model.name}'] += 1
        elif said.unit and said.scale and (said.unit, said.scale, said.offset) != (
                truth.unit, truth.scale, truth.offset):
            result[f'{said.key} of {model.name}'] += 1
        else:
            result['right'] += 1
    return result


@pytest.mark.parametrize(('left_out', 'least'), [('nothing', 0.5), ('model', 0.5), ('table', 0.2)])
def test_no_register_is_named_wrongly(left_out, least):
    total = Counter()
    for model in SERVOS:
        for program in PROGRAMS:
            total += named(model, program, left_out)
    assert set(total) == {'right', 'no name'}
    assert total['right'] > least * total.total()




@pytest.mark.parametrize(('protocol', 'used', 'name', 'position'), rows_of(
    Path(__file__).with_name('model_guesses.tsv')))
def test_a_use_says_which_registers_those_are(protocol, used, name, position):
    orders = {'little': guesses.LITTLE, 'big': guesses.BIG, 'sent_little': guesses.SENT_LITTLE,
              'sent_big': guesses.SENT_BIG}
    found = ALL.find_model(protocol, frozenset(
        orders.get(one) or tuple(map(int, one.split('+'))) for one in used.split()))
    said = found.by_name.get('Present Position')
    assert (found.name, said.key if said else '') == (name, position)


def test_a_position_says_its_order_of_bytes():
    found = [guesses.order_of(bytes(place), None) for place in (
        (0xf3, 9), (2, 0x84), (3, 3), (1, 15), (1, 0x80), (0, 0x10))]   # -1, a whole turn
    assert found == [{guesses.LITTLE}, {guesses.BIG}, set(), set(), set(), set()]
    found = [guesses.order_of(place, b'\xf3\x09') for place in (b'\x03\x03', b'\x02\x84', None)]
    assert found == [{guesses.SENT_LITTLE}, {guesses.BIG}, set()]


def asked(*used):
    """Return what is said where these are written, or so many bytes of zeros are read."""
    said = []
    for at, what in used:
        where = at.to_bytes(2, 'little')
        said += [encode(1, I.READ, where + what.to_bytes(2, 'little')),
                 encode(1, STATUS, bytes(what), error=0)] if isinstance(what, int) else [
                encode(1, I.WRITE, where + what), encode(1, STATUS, b'', error=0)]
    return said


MOVES = asked((64, b'\1'), (116, bytes(4)), (132, 4))


def names(bus):
    device = bus.device()
    return device.model_name, [one.field.key for one in device.observed]


def test_a_program_is_understood_after_three_instructions_and_taken_at_its_word():
    bus = Bus()
    for said, registers in ((MOVES[:2], []), (MOVES[2:4], []), (MOVES[4:], [
            'Torque Enable', 'Goal Position (rad)', 'Present Position (rad)'])):
        bus.hear(*said)
        assert names(bus)[1] == registers
    bus.wait(4)
    bus.hear(*MOVES)
    report = bus.report()
    assert [one.message for one in report.doubts if one.rule == 'models'] == [
        '001: model not known, registers as in the X series, by what the program uses; add '
        'ID:MODEL to `devices`, or let your program ping the servos']
    bus.hear(encode(1, I.PING), PONG)
    assert names(bus)[0] == 'MX-64'


REFUSED = [encode(1, I.READ, b'\x84\0\4\0'), encode(1, STATUS, b'', error=7)]


@pytest.mark.parametrize('against', [
    asked((64, b'\7')), asked((116, b'\0\0\0\x70')), asked((117, 2)), asked((562, b'\1')),
    3 * REFUSED,
    [encode(1, I.READ, b'\x92\0\1\0'), encode(1, STATUS, b'\xc8', error=0)],
], ids=['torque 7', 'a goal of 286 000 turns', 'half a register', 'a register of another series',
        'refused', '200 degrees'])
def test_what_speaks_against_a_layout_ends_it(against):
    bus = Bus()
    bus.hear(*MOVES)
    assert names(bus)[0] == 'unknown (as the X series)'
    bus.hear(*against)
    assert names(bus) == ('unknown', [])
    bus.hear(*MOVES)
    assert names(bus) == ('unknown', [])


def test_what_is_refused_for_another_reason_speaks_against_nothing():
    bus = Bus()
    bus.hear(*MOVES, *asked((66, 60)))             # a table is read, gaps too
    for at, error in ((20, 7), (116, 6), (98, 4)):
        bus.hear(*3 * [encode(1, I.WRITE, bytes((at, 0, 1, 0, 0, 0)[:6 if at != 98 else 3])),
                       encode(1, STATUS, b'', error=error)])
    assert names(bus)[0] == 'unknown (as the X series)'
    found = {one.rule for one in bus.report().findings}
    assert 'eeprom_locked' in found and 'refused' not in found
