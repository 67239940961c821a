# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of dxl_monitor, and what they say about each bus."""
from __future__ import annotations

from typing import Any

from mecarover_serial.parameters import Parameter
from mecarover_serial.parameters import TIMING_PARAMETER
from servobus.bus.decoder import PROTOCOL_CHOICES
from servobus.sources.capture_recorder import Recorder
from servobus.sources.flight_recorder import FlightRecorder
from servobus.sources.recorders import Recorders

PARAMETERS = (
    Parameter('ports', ['/dev/ttyUSB0'], 'one source per bus: a path (a stable one is in '
              '/dev/serial/by-id), a pyserial URL, usb:PORT (the traffic of another program that '
              'uses PORT) or tap:NAME (a program started with dxl_tap)', element=str),
    Parameter('bauds', [2_000_000], 'baud rate of each bus, or one for all; usb: and tap: follow '
              'the rate that the program sets, with 0 from the start', 'bit/s', 9600, 4_500_000,
              or_zero=True, element=int),
    Parameter('names', [], 'names of the buses; default: the base name of the port', element=str),
    Parameter('devices', [], "devices on the bus, in the order along the cable: "
              "'11:MX-106:left_knee', '1-20:MX-64', '30'; with several buses 'NAME/11:MX-106'",
              element=str),
    Parameter('publish_rate', 2.0, 'rate of dxl/diagnostics', 'Hz', 0.1, 50.0),
    Parameter('missed_limit', 4, 'a device that misses more answers in a row than this is '
              'disconnected', '', 0, 1000),
    Parameter('warn_loss', 1.0, 'a device that missed more of its answers in the last 10 s is at '
              'WARN', '%', 0.0, 100.0),
    Parameter('silent_after', 5.0, 'a device that is not asked and sends nothing for so long is '
              'STALE', 's', 0.1, 3600.0),
    Parameter('model_dirs', [], 'folders with more model files; they replace built-in models of '
              'the same number', element=str),
    Parameter('joint_state_rate', 0.0, 'rate of dxl/joint_states; 0 = off', 'Hz', 0.1, 200.0,
              or_zero=True),
    Parameter('capture', '', 'text file that all buses are recorded to'),
    Parameter('capture_size', 100.0, 'largest size of the capture file; then FILE is renamed to '
              'FILE.1, FILE.1 to FILE.2 and so on', 'MB', 0.001, 1e6),
    Parameter('capture_files', 9, 'how many older capture files to keep', '', 0, 1000),
    Parameter('flight_recorder', '', 'folder for recordings of faults: 60 s before each new '
              'finding and 30 s after it'),
    Parameter('flight_recorder_size', 1000.0, 'size of that folder; the oldest recordings go',
              'MB', 1.0, 1e6),
    Parameter('protocols', ['auto'], 'protocol of each bus, or one for all: 2 (Dynamixel Protocol '
              '2.0), 1 (Protocol 1.0), feetech, or auto, which learns it from the traffic',
              choices=PROTOCOL_CHOICES, element=str),
    Parameter('write_acks', 'auto', 'whether devices acknowledge writes; auto learns it from the '
              'traffic', choices=('auto', 'always', 'never')),
    TIMING_PARAMETER,
)


def make_recorders(values: dict[str, Any]) -> Recorders:
    """Return the recorders that the parameters ask for; ParameterError as buses."""
    capture = flight = None
    if values['capture']:
        capture = Recorder(values['capture'], int(1e6 * values['capture_size']),
                           values['capture_files'])
    if values['flight_recorder']:
        flight = FlightRecorder(values['flight_recorder'],
                                int(1e6 * values['flight_recorder_size']), len(values['ports']))
    return Recorders(capture, flight)
