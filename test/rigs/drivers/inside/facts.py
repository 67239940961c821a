# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Run in the guest: what a driver does with what serial_port.py assumes of one, as JSON.

usage: facts.py PORT       nothing else may have it open
"""
import json
import os
import sys
import termios
import time

from servobus.port.port_error import PortError
from servobus.port.serial_port import open_port
from servobus.sources.serial_driver import line_errors
from servobus.sources.serial_driver import set_low_latency

BAUD = 115_200
WRITTEN = 2000


def main(path):
    port = open_port(path, BAUD)
    fd = port.fd
    assert fd is not None
    written = port.write(bytes(WRITTEN))
    most = 0
    deadline = time.monotonic() + 1
    while time.monotonic() < deadline:
        most = max(most, port.pending())
    errors = line_errors(fd)
    set_low_latency(fd)
    facts = {
        'hupcl': bool(termios.tcgetattr(fd)[2] & termios.HUPCL),
        'written': written, 'pending at most': most, 'pending after 1 s': port.pending(),
        'line errors': None if errors is None else sum(errors),
        'second': second(path),
        'read only': read_only(path, port.close)}
    print(json.dumps(facts))


def second(path):
    """Open it a second time, past the lock that pyserial users keep: TIOCEXCL alone decides."""
    try:
        os.close(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError as error:
        return error.strerror or ''
    return 'opened'


def read_only(path, close):
    """Open it as the monitor does, and try to write."""
    close()                                                     # type: ignore[operator]
    port = open_port(path, BAUD, read_only=True)
    try:
        port.write(b'x')
    except PortError as error:
        return error.reason
    finally:
        port.close()
    return 'written'


if __name__ == '__main__':
    main(*sys.argv[1:])
