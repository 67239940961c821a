# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter values: what is converted, and the one line for what cannot be."""
from array import array
from pathlib import Path
import re

import pytest
import yaml

from mecarover_serial.parameters import convert
from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import typed_parameters
from mecarover_serial.parameters import unknown_names
from servobus.bus.expected_devices import refuse_twice
from servobus.errors import ParameterError

TIMEOUT = Parameter('cmd_vel_timeout', 0.5, 'time-out', 's', 0.05, 10.0, or_zero=True)
BAUD = Parameter('baud', 115200, 'rate', 'bit/s', 1200)
PORT = Parameter('port', '/dev/ttyAMA0', 'port')
DEADMAN = Parameter('deadman', True, 'child process')
FEED = Parameter('crc_input', 'bytes', 'feed', choices=('bytes', 'words'))
PORTS = Parameter('ports', ['/dev/ttyUSB0'], 'ports', element=str)
BAUDS = Parameter('bauds', [2_000_000], 'rates', 'bit/s', 9600, 4_500_000, element=int)
BY_NAME = {one.name: one for one in (TIMEOUT, BAUD, PORT, DEADMAN, FEED, PORTS, BAUDS)}
ROWS = yaml.safe_load(Path(__file__).with_name('parameter_values.yaml').read_text())


@pytest.mark.parametrize(('name', 'raw', 'value'), [
    *ROWS['converted'], ('bauds', array('q', [9600, 57600]), [9600, 57600])])
def test_converted(name, raw, value):
    converted = convert(BY_NAME[name], raw)
    assert converted == value
    assert type(converted) is type(value)


@pytest.mark.parametrize(('name', 'raw'), ROWS['refused'])
def test_refused_in_one_line(name, raw):
    with pytest.raises(ParameterError) as caught:
        convert(BY_NAME[name], raw)
    assert re.fullmatch(rf'{name}: .+ is not possible; set an? .+, e\.g\. .+',
                        str(caught.value))
    assert len(str(caught.value)) < 200


def test_unknown_names():
    names = [PORT.name, BAUD.name]
    assert unknown_names(names, ['port', 'use_sim_time', 'start_type_description_service']) == []
    assert unknown_names(names, ['prot']) == [
        'prot: no such parameter, ignored; did you mean port?']
    assert unknown_names(names, ['zzz']) == [
        'zzz: no such parameter, ignored; there are: port, baud']


def test_what_is_given_twice_is_named():
    refuse_twice('ports:', ['a', 'b'])
    with pytest.raises(ParameterError) as caught:
        refuse_twice('devices: ID', [3, 4, 3, 4])
    assert str(caught.value) == 'devices: ID 3 is given twice; give it once'


def test_a_number_that_no_float_holds_is_refused():
    with pytest.raises(ParameterError, match=r'cmd_vel_timeout: 1000.*[.]{3} is not possible'):
        convert(TIMEOUT, 10 ** 400)


def test_words_for_people():
    assert TIMEOUT.range_text == '>= 0.05, <= 10 or 0'
    assert [p.type_name for p in (TIMEOUT, BAUD, PORT, DEADMAN, PORTS, BAUDS)] == [
        'double', 'integer', 'string', 'bool', 'string list', 'integer list']


@pytest.mark.parametrize(('words', 'values'), yaml.safe_load(
    Path(__file__).with_name('typed_parameters.yaml').read_text(encoding='utf-8')))
def test_what_the_command_line_says(words, values):
    assert typed_parameters(words.split(), 'bridge') == values
