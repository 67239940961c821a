# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The command `fake_bus`: a Dynamixel bus on a pty, with simulated master, devices and faults.

With the pattern `none` a real master may drive the devices through the pty, while a listener has
a copy of everything on the tap.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
import json
import sys

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.dxl1_servo import Servo1
from mecarover_fakes.fake_options import add_options
from mecarover_fakes.fake_options import hold_signals
from mecarover_fakes.fake_options import one_signal
from mecarover_fakes.fake_options import parse_options
from mecarover_fakes.fake_servo import FakeDevice
from mecarover_fakes.fault_control import commands_from
from mecarover_fakes.faults import KINDS
from mecarover_fakes.faults import parse as parse_fault
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import FAMILY_1
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.usb_adapter import FAMILIES
from mecarover_fakes.values import Sine
from mecarover_fakes.virtual_usb import VirtualUsb
from msg_defs.dxl1_instruction import DYNAMIXEL_1
from msg_defs.dxl1_instruction import FEETECH
from servobus.bus.expected_devices import parse_all
from servobus.errors import ParameterError
from servobus.errors import UsageError
from servobus.model.models import Models
from servobus.port.pty import outlive
from servobus.settings import check_models
from servobus.settings import load_models
from servobus.tools.cli import run_tool
from servobus.tools.command_line import baud_rate
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

DEFAULT_DEVICES = ('1-10:MX-106', '11-18:MX-64', '100:Rhoban DXL Board', '101:BitFoot',
                   '102:BitFoot', '103:Bit-Bots IMU')
FAST_DEVICES = ('1-20:XL430-W250',)
PROTOCOLS = {'2': '2', 'dxl1': '1', 'feetech': 'feetech'}      # as model files say it
USUAL_MODEL = {'2': 'MX-64', 'dxl1': 'AX-12A', 'feetech': 'STS3215'}
DIALECTS_BY_NAME = {'dxl1': DYNAMIXEL_1, 'feetech': FEETECH}


def make_line(devices: list[FakeDevice], baud: int, dialect: str = '2', *,
              waits_in_line: bool = True) -> Line:
    """Return the line of a bus that speaks a dialect."""
    return Line(devices, baud, DIALECTS_BY_NAME.get(dialect), waits_in_line=waits_in_line)


def default_devices(pattern: str, dialect: str = '2') -> list[str]:
    """Return what is on the bus by default."""
    if dialect != '2':
        return [f'1-6:{USUAL_MODEL[dialect]}']
    return list(FAST_DEVICES if pattern == 'fast' else DEFAULT_DEVICES)


def make_devices(entries: list[str], models: Models, baud: int, *,
                 moving: bool = True, dialect: str = '2') -> list[FakeDevice]:
    """Return simulated devices for entries like '1-20:MX-106'; all speak one protocol."""
    devices: list[FakeDevice] = []
    expected = parse_all(entries)
    check_models(expected, models)
    for entry in expected:
        model = models.by_name(entry.model or USUAL_MODEL[dialect])
        assert model is not None
        motion = Sine(phase=0.35 * entry.id) if moving else None
        if model.protocol != PROTOCOLS[dialect]:
            raise ParameterError(f'devices: {model.name} does not speak the protocol of --dialect '
                                 f'{dialect}; give devices of one protocol')
        servo = FakeDevice if dialect == '2' else Servo1
        devices.append(servo(entry.id, model, baud=baud, motion=motion))
    return devices


def _run(arguments: list[str]) -> int:
    options = parse_options(_parser(), arguments)
    if options.list_faults:
        for name, kind in KINDS.items():
            print(f'{name:13} {kind.__doc__}')
        return 0
    _check(options)
    pattern = options.pattern or ('none' if options.tap else 'moving')
    devices = make_devices(options.devices or default_devices(pattern, options.dialect),
                           load_models(options.model_dirs), options.baud, moving=pattern != 'none',
                           dialect=options.dialect)
    line = make_line(devices, options.baud, options.dialect,
                     waits_in_line=options.behind_silent == 'wait')
    master = Master(line, PATTERNS[pattern], rate=options.rate, seed=options.seed,
                    faults=[parse_fault(text) for text in options.fault],
                    started=options.mid_traffic, patience=round(options.patience * 1e6))
    hold_signals()
    usb = VirtualUsb(options.usbmon, options.adapter, options.baud) if options.usbmon else None
    bus = FakeBus(master, link=options.link, tap=options.tap or False,
                  away=options.vanish, usb=usb)
    tapped = f', tap {options.tap}' if options.tap else ''
    with ExitStack() as stack:
        stack.callback(bus.stop)
        if options.control:
            stack.enter_context(commands_from(options.control, bus.command))
        stack.callback(_write_totals, bus, options.truth)
        print(f'fake_bus: {options.link or bus.path}, {options.baud} baud, {len(devices)} '
              f'devices, pattern {pattern}{tapped}', flush=True)
        bus.start(options.seconds)
        try:
            with one_signal():
                bus.wait()
        except KeyboardInterrupt:
            if options.outlive:
                outlive(bus.path)
            raise
    return 0


def _write_totals(bus: FakeBus, truth_file: str | None) -> None:
    bus.stop()
    totals = bus.totals()
    print('totals: ' + ', '.join(f'{name} {count}' for name, count in totals['bus'].items()))
    if truth_file is not None:
        with open(truth_file, 'w', encoding='utf-8') as file:
            json.dump(bus.master.truth.as_json() | {'totals': totals}, file, indent=1)


def _check(options: argparse.Namespace) -> None:
    spoken = FAMILY_1.get(PROTOCOLS[options.dialect], PATTERNS)
    if options.pattern is not None and options.pattern not in spoken:
        raise UsageError(f'--pattern {options.pattern}: not possible with --dialect '
                         f"{options.dialect}; use one of: {', '.join(spoken)}")
    if options.baud is None:
        options.baud = 2_000_000 if options.dialect == '2' else 1_000_000


_EXAMPLES = """examples:
  fake_bus --link /tmp/bus                       the robot of the thesis, walking
  fake_bus --link /tmp/bus --devices 1-20:MX-106 --fault silent:5:3:2
  fake_bus --link /tmp/bus --tap /tmp/tap        your own master drives it, a monitor hears it

patterns:
"""


def _parser() -> Parser:
    patterns = ''.join(f'  {name:11} {(pattern.__doc__ or "").strip().splitlines()[0]}\n'
                       for name, pattern in PATTERNS.items())
    parser = Parser(
        'fake_bus', 'Simulates a Dynamixel bus on a pty: devices, and a master unless --pattern '
                    'none.',
        epilog=_EXAMPLES + patterns)
    add_options(parser)
    add = parser.add_argument
    add('--tap', metavar='PATH', help='symlink to a second pty with a copy of everything')
    add('--usbmon', metavar='PATH', help='Unix socket that shows the bus as usbmon shows an '
        'adapter; listen with usb:PATH')
    add('--adapter', choices=FAMILIES, default='ftdi', metavar='KIND',
        help=f"kind of adapter that --usbmon shows: {', '.join(FAMILIES)} (default %(default)s)")
    add('-b', '--baud', type=number(baud_rate, 1),
        help='baud rate (default 2000000, with the other dialects 1000000)')
    add('--dialect', '--protocol', choices=PROTOCOLS, default='2',
        type=lambda text: 'dxl1' if text == '1' else text, help='2: Dynamixel Protocol 2.0, dxl1 '
        'or 1: Protocol 1.0, feetech: FT-SCS (default %(default)s)')
    add('--devices', nargs='+', metavar='ID:MODEL', help="e.g. '1-20:MX-106' '101:BitFoot' "
        '(default: the robot of the thesis; with --pattern fast: servos with fast reads)')
    add('--model-dirs', nargs='+', metavar='DIR', default=[], help='one more folder of model '
        'files')
    add('--pattern', choices=PATTERNS, metavar='NAME',
        help='traffic of the master, see below (default moving; none with --tap)')
    add('--rate', type=number(float, 0), default=100.0,
        help='cycles per second, 0: without a pause (default %(default)g)')
    add('--fault', action='append', default=[], metavar='NAME[:id[:at_s[:for_s]]]',
        help='simulate a fault; repeat it for more')
    add('--control', metavar='SOCKET', help="lines there begin a fault ('silent:5') or end faults "
        "('back'); -: standard input")
    add('--list-faults', action='store_true', help='list the faults and exit')
    add('--mid-traffic', action='store_true', help='begin without Pings and without switching the '
        'torque on')
    add('--behind-silent', choices=('wait', 'answer'), default='wait',
        help='what devices after a silent one do in a Sync Read (default %(default)s)')
    add('--patience', type=number(float, 0), default=34.0, metavar='MS',
        help='the master waits for answers for their wire time plus this (default %(default)g)')
    add('--truth', metavar='FILE', help='at the end write what really happened to this file, as '
        'JSON')
    return parser


def main() -> int:
    """Run the command `fake_bus`."""
    return run_tool('fake_bus', _run)


if __name__ == '__main__':
    sys.exit(main())
