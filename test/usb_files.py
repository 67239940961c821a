# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Files of USB events for the tests: real captures, and what is in a file."""

from pathlib import Path
import subprocess

from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_survey import Survey
from servobus.sources.usbmon import Records

REAL = Path(__file__).parent / 'usbmon'                # real ones; README.md there


def events(records):
    return list(Records().events(records))


def ports_in(found):
    """Return the serial ports in these events."""
    survey = Survey()
    for event in found:
        survey.add_event(event)
    return survey.ports()


def hear(found):
    """Return what the only port in these events said."""
    one, = ports_in(found)
    port = UsbPort(one.place, one.adapter, 'bus')
    return [chunk for event in found for chunk in port.decode_event(event)]


def tshark(file, fields, *options):
    """Return what tshark says of each packet of a file, field by field."""
    said = subprocess.run(['tshark', '-r', file, *options, '-T', 'fields', *(
        word for name in fields for word in ('-e', name))],
        capture_output=True, text=True, check=True).stdout
    return [line.split('\t') for line in said.splitlines()]


def side(heard, which):
    return b''.join(one.data for one in heard if one.side == which)


def changes(heard):
    return [tuple(one.change) for one in heard if one.change]


def log(name):
    """Return what the master of a real capture wrote and read."""
    told = {'>': b'', '<': b''}
    for line in (REAL / f'{name}.master.log').read_text().splitlines():
        _, kind, text = line.split(' ', 2)
        if kind in told:
            told[kind] += bytes.fromhex(text)
    return told['>'], told['<']
