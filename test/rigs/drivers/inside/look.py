# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Run in the guest: open a port as the nodes do and print what a user is told, a line each.

usage: look.py PORT [BAUD] [--closed]      --closed: only what preflight warns of
"""
import sys

from servobus.port.port_error import PortError
from servobus.port.preflight import warnings
from servobus.port.serial_port import open_port


def main(port, baud='115200', mode=''):
    opened = None
    try:
        if not mode:
            opened = open_port(port, int(baud))
            print('open')
        for found in warnings(port):
            print(f'{port}: {found.reason}; {found.remedy}')
    except PortError as error:
        print(error)
        return 1
    if opened is not None:
        opened.close()
    return 0


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
