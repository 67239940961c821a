# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter values: what is converted, and the one line for what cannot be."""
from array import array
import math
import re

import pytest

from mecarover_serial.parameters import convert
from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import typed
from mecarover_serial.parameters import unknown
from servobus.bus.expected import refuse_twice
from servobus.errors import ParameterError

TIMEOUT = Parameter('cmd_vel_timeout', 0.5, 'time-out', 's', 0.05, 10.0, or_zero=True)
BAUD = Parameter('baud', 115200, 'rate', 'bit/s', 1200)
PORT = Parameter('port', '/dev/ttyAMA0', 'port')
DEADMAN = Parameter('deadman', True, 'child process')
FEED = Parameter('crc_input', 'bytes', 'feed', choices=('bytes', 'words'))
PORTS = Parameter('ports', ['/dev/ttyUSB0'], 'ports', element=str)
BAUDS = Parameter('bauds', [2_000_000], 'rates', 'bit/s', 9600, 4_500_000, element=int)


@pytest.mark.parametrize(('parameter', 'raw', 'value'), [
    (TIMEOUT, 1, 1.0), (TIMEOUT, 0, 0.0), (TIMEOUT, 0.05, 0.05), (BAUD, 9600.0, 9600),
    (PORT, '', ''), (DEADMAN, False, False), (FEED, 'words', 'words'),
    (PORTS, 'one', ['one']), (PORTS, [], []), (PORTS, [''], []), (PORTS, None, []),
    (PORTS, [30, 31.0], ['30', '31']), (PORTS, 30, ['30']),
    (BAUDS, 9600, [9600]), (BAUDS, array('q', [9600, 57600]), [9600, 57600]),
])
def test_converted(parameter, raw, value):
    converted = convert(parameter, raw)
    assert converted == value
    assert type(converted) is type(value)


@pytest.mark.parametrize(('parameter', 'raw'), [
    (TIMEOUT, '1'), (TIMEOUT, True), (TIMEOUT, math.nan), (TIMEOUT, math.inf), (TIMEOUT, [1.0]),
    (TIMEOUT, 0.04), (TIMEOUT, 10.1), (TIMEOUT, -1), (TIMEOUT, None),
    (BAUD, 9600.5), (BAUD, 0), (BAUD, True), (BAUD, '9600'), (PORT, 5), (PORT, ['x']),
    (DEADMAN, 1), (DEADMAN, 'true'), (FEED, 'byte'), (PORTS, [True]),
    (BAUDS, [9600, 5_000_000]), (BAUDS, 'fast'), (BAUDS, ['x' * 1000]),
])
def test_refused_in_one_line(parameter, raw):
    with pytest.raises(ParameterError) as caught:
        convert(parameter, raw)
    assert re.fullmatch(rf'{parameter.name}: .+ is not possible; set an? .+, e\.g\. .+',
                        str(caught.value))
    assert len(str(caught.value)) < 200


def test_unknown_names():
    names = [PORT.name, BAUD.name]
    assert unknown(names, ['port', 'use_sim_time', 'start_type_description_service']) == []
    assert unknown(names, ['prot']) == [
        'prot: no such parameter, ignored; did you mean port?']
    assert unknown(names, ['zzz']) == [
        'zzz: no such parameter, ignored; there are: port, baud']


def test_what_is_given_twice_is_named():
    refuse_twice('ports:', ['a', 'b'])
    with pytest.raises(ParameterError) as caught:
        refuse_twice('devices: ID', [3, 4, 3, 4])
    assert str(caught.value) == 'devices: ID 3 is given twice; give it once'


def test_words_for_people():
    assert TIMEOUT.range_text == '>= 0.05, <= 10 or 0'
    assert [p.type_name for p in (TIMEOUT, BAUD, PORT, DEADMAN, PORTS, BAUDS)] == [
        'double', 'integer', 'string', 'bool', 'string list', 'integer list']


@pytest.mark.parametrize(('words', 'values'), [
    ('--ros-args -p cmd_vel_timeout:=0.25', {'cmd_vel_timeout': 0.25}),
    ('--ros-args -p a:=1 -p a:=2 --param b:=1e-3 --params-file x -p c:=[1]',
     {'a': 2, 'b': 0.001, 'c': [1]}),
    ('--ros-args -p bridge:a:=true -p /bridge:b:=-2 -p /**:c:=x:=y -p other:d:=4',
     {'a': True, 'b': -2, 'c': 'x:=y'}),
    ('-p a:=1 --ros-args -p b:=2 -- -p c:=3 --ros-args -r d:=4 -p e', {'b': 2}),
    ('--ros-args -p port:=/dev/tty:1 -p a:=[', {'port': '/dev/tty:1', 'a': '['}), ('', {}),
])
def test_what_the_command_line_says(words, values):
    assert typed(words.split(), 'bridge') == values
