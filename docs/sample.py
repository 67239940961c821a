# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What dxl/diagnostics says of one device of each family: `python -m docs.sample`.

A simulated bus in simulated time: each device is pinged, and its whole table is read. A line has
the device, the key and the value; counters, ages and rows of indirect addresses are left out.
test/baseline/registers.txt has the same, and a test compares them.
"""
from __future__ import annotations

from collections.abc import Iterator
import struct

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.line import Line
from msg_defs.dxl_instruction import Instruction
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import device_status

FAMILIES = ('1:MX-106', '2:XM430-W350', '3:XL330-M288', '4:XL-320', '5:PH54-200-S500',
            '6:H54-200-S500-R(A)', '7:RH-P12-RN(A)', '8:YM070-210-M001', '9:Rhoban DXL Board',
            '10:BitFoot', '11:Bit-Bots IMU')
BAUD = 2_000_000
LONGEST = 100                   # bytes of a read
PAUSE_NS = 1_000_000


def sample() -> str:
    """Return the lines of all devices."""
    models = Models()
    devices = make_devices(list(FAMILIES), models, BAUD)
    line, monitor = Line(devices, BAUD), Monitor('', models, Settings(baud=BAUD))
    now = PAUSE_NS
    for device in devices:
        for instruction, params in _questions(device.model.fields):
            exchange = line.exchange(device.id, instruction, params, now)
            for burst in exchange.bursts:
                monitor.feed(burst.data, burst.end)
            now = exchange.end + PAUSE_NS
    report = monitor.report(now)
    return ''.join(_lines(device_status(
        'dxl_monitor', '', device, report.findings, True).values, device.name)
        for device in report.devices)


def _questions(fields: object) -> Iterator[tuple[Instruction, bytes]]:
    """Yield a Ping, then reads that cover every field, none of them across a hole."""
    yield Instruction.PING, b''
    begin = end = -1
    for field in [*fields, None]:   # type: ignore[misc]
        if field is not None and field.at <= end and field.end - begin <= LONGEST:
            end = max(end, field.end)
            continue
        if end > begin:
            yield Instruction.READ, struct.pack('<HH', begin, end - begin)
        if field is not None:
            begin, end = field.at, field.end


def _lines(values: list[tuple[str, str]], name: str) -> str:
    keys = [key for key, _ in values]
    first = keys.index('Model Number') if 'Model Number' in keys else 0
    shown = [*values[:1], *values[first:keys.index('Fields not observed')]]
    return ''.join(f'{name} {key}: {value}\n' for key, value in dict(shown).items()
                   if not key.startswith('Indirect'))


if __name__ == '__main__':
    print(sample(), end='')
