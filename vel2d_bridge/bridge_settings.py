# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of vel2d_bridge: names, defaults, limits and what a person reads about them."""
from __future__ import annotations

import math
import os
from typing import Any

from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import TIMING_PARAMETER
from msg_defs.crc import CRC_BY_INPUT
from servobus.errors import ParameterError
from vel2d_bridge.gate import GateSettings

SLOWEST_BAUD = 19200            # slower, a frame takes so long that the stated bounds do not hold
AUTO, TWIST, TWIST_STAMPED = 'auto', 'twist', 'twist_stamped'

PARAMETERS = (
    Parameter('port', '/dev/ttyAMA0', 'UART to the MCU: a path, best a stable one from '
              '/dev/serial/by-id, or a pyserial URL'),
    Parameter('baud', 115200, 'rate of the UART, 8N1', 'bit/s', 1200, 4_500_000),
    Parameter('message_type', AUTO, 'message type of cmd_vel; auto follows its publishers',
              choices=(AUTO, TWIST, TWIST_STAMPED)),
    Parameter('cmd_vel_timeout', 0.5, 'the rover stops when no command was accepted for so long; '
              '0 holds the last command for ever, which is dangerous, and is refused at run '
              'time', 's', 0.05, 10.0,
              or_zero=True, run_time=True),
    Parameter('resend_rate', 20.0, 'the set-point, a stop too, is sent again at this rate, so '
              'that one lost frame does no harm; 0 = never', 'Hz', 2.0, 33.0, or_zero=True,
              run_time=True),
    Parameter('max_rate', 30.0, 'most frames per second; more than 33 fill the queue of the MCU, '
              'and the rover reacts late', 'Hz', 2.0, 400.0, run_time=True),
    Parameter('max_linear_x', 0.0, 'largest |linear.x|; 0 = no limit. A velocity above a limit is '
              'scaled down as a whole: its direction stays', 'm/s', 0.0, 100.0, run_time=True),
    Parameter('max_linear_y', 0.0, 'largest |linear.y|; 0 = no limit', 'm/s', 0.0, 100.0,
              run_time=True),
    Parameter('max_angular_z', 0.0, 'largest |angular.z|; 0 = no limit', 'rad/s', 0.0, 100.0,
              run_time=True),
    Parameter('max_stamp_age', 0.0, 'refuse a TwistStamped that is older, or further in the '
              'future; 0 = no check', 's', 0.0, 3600.0, run_time=True),
    Parameter('write_timeout', 0.05, 'a frame that is not sent within this time is discarded, and '
              'a stop follows; never less than the time of two frames on the wire', 's', 0.005,
              1.0, run_time=True),
    Parameter('crc_input', 'bytes', 'how the MCU feeds its CRC unit; with the wrong one it '
              'accepts stops only and never moves', choices=tuple(CRC_BY_INPUT)),
    Parameter('enabled', True, 'whether commands are accepted; if not, the rover does not move '
              'and stops are still sent. The service ~/enable sets it too', run_time=True),
    Parameter('disabled_file', '', 'a file that exists while commands are switched off; a bridge '
              'that finds it starts switched off. Empty: a restart switches commands on'),
    Parameter('deadman', True, 'a child process stops the rover when this one is killed or '
              'frozen'),
    TIMING_PARAMETER,
)


def gate_settings(values: dict[str, Any]) -> GateSettings:
    """Pick what the gate needs; its names are the parameters'."""
    return GateSettings(**{name: values[name] for name in GateSettings._fields})


def refuse_at_start(values: dict[str, Any]) -> None:
    """Raise ParameterError for a value of the right type that cannot be meant."""
    if not values['port']:
        raise ParameterError('port: none given; set a path, as /dev/ttyAMA0')
    if os.path.isdir(values['disabled_file']):
        raise ParameterError(f'disabled_file: {values["disabled_file"]} is a folder; set a file '
                             'in it')


def refuse_at_run_time(changes: dict[str, Any]) -> None:
    """Raise ParameterError for a value that is good at a start only."""
    if changes.get('cmd_vel_timeout') == 0:
        raise ParameterError('cmd_vel_timeout: 0 holds the last command for ever and is accepted '
                             'only at the start; set 0.5, or write 0 to the settings file and '
                             'restart')


def removed_limits(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Say which limits a change at run time takes away, a line each."""
    return [f'{name}: now 0, so there is no limit any more; it was {before[name]:g}'
            for name in ('max_linear_x', 'max_linear_y', 'max_angular_z', 'max_stamp_age')
            if before[name] and not after[name]]


def warnings(values: dict[str, Any]) -> list[str]:
    """Say what is possible and probably not meant, a line each."""
    timeout, rate = values['cmd_vel_timeout'], values['max_rate']
    lines = {
        'cmd_vel_timeout: 0 holds the last command for ever when its publisher dies; set 0.5':
            timeout == 0,
        f'cmd_vel_timeout: {timeout:g} s is less than two frames at max_rate {rate:g} Hz, so '
        'commands expire before they are sent; set cmd_vel_timeout to '
        f'{math.ceil(200 / rate) / 100:g} s or more':
            0 < timeout * rate < 2,
        'resend_rate: 0 sends each set-point once, so a lost frame is not sent again; set 20':
            values['resend_rate'] == 0,
        f'max_rate: {rate:g} Hz is more than the MCU takes (one set-point per 30 ms), so the '
        'rover reacts late; set 30':
            rate > 33,
        f'baud: {values["baud"]} bit/s is too slow for the rover to stop in the time that is '
        f'promised; set {SLOWEST_BAUD} or more':
            values['baud'] < SLOWEST_BAUD,
        'max_stamp_age: a Twist has no time stamp and is accepted at any age; set message_type '
        'to twist_stamped':
            values['max_stamp_age'] and values['message_type'] != TWIST_STAMPED,
        'deadman: false, so the rover drives on when this process is killed; set true':
            not values['deadman'],
    }
    return [line for line, is_so in lines.items() if is_so]
