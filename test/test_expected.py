# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What is on a bus, as people write it: every form, and every mistake in one line."""

from pathlib import Path

import pytest
import yaml

from servobus.bus.expected_devices import Expected
from servobus.bus.expected_devices import parse
from servobus.bus.expected_devices import parse_all
from servobus.bus.expected_devices import split_bus
from servobus.errors import ParameterError


@pytest.mark.parametrize(('text', 'devices'), yaml.safe_load(
    Path(__file__).with_name('device_forms.yaml').read_text()))
def test_forms(text, devices):
    assert parse(text) == [Expected(*one) for one in devices]


@pytest.mark.parametrize(('text', 'words'), [
    ('', 'is not a device'),
    ('knee', 'is not a device'),
    ('1:2:3:4', 'is not a device'),
    ('-3', 'is not a device'),
    ('254', 'at most 253'),
    ('9' * 5000, 'is not a device'),
    ('1-300:MX-64', 'at most 253'),
    ('9-3:MX-64', 'write 3-9'),
    ('1-3:MX-64:knee', 'one joint name for 3 devices'),
])
def test_mistakes(text, words):
    with pytest.raises(ParameterError, match=words) as caught:
        parse(text)
    assert str(caught.value).startswith('devices: ')
    assert '; ' in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('entry', 'bus', 'device'), [
    ('1:MX-64', '', '1:MX-64'),
    ('arm/1:MX-64', 'arm', '1:MX-64'),
    ('arm/left/1-3', 'arm/left', '1-3'),
    ('arm/1::left/knee', 'arm', '1::left/knee'),
    ('1::left/knee', '', '1::left/knee'),
    ('arm/1,2:MX-64', 'arm', '1,2:MX-64'),
    ('left/knee', '', 'left/knee'),
    ('\n/1:XL-320:jaw', '\n', '1:XL-320:jaw'),
])
def test_a_bus_and_a_joint_may_have_a_slash(entry, bus, device):
    assert split_bus(entry) == (bus, device)


def test_order_is_that_of_the_cable():
    assert [device.id for device in parse_all(['5', '1-2', '9'])] == [5, 1, 2, 9]


@pytest.mark.parametrize(('entries', 'words'), [
    (['1-5', '3:MX-64'], 'ID 3 is given twice'),
    (['1:MX-64:knee', '2:MX-64:knee'], 'joint knee is given twice'),
])
def test_nothing_is_listed_twice(entries, words):
    with pytest.raises(ParameterError, match=words):
        parse_all(entries)
