# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Figures of a bus for dxl_dump: --stats as tables, --summary as one JSON object. Pure.

Bus load is wire time at 10 bits per byte over time; the answers of a device count as asked when
they came or were missed.
"""

from collections.abc import Sequence
import textwrap
from typing import Any

from msg_defs.diagnostics import Level
from msg_defs.dxl_instruction import name_of
from msg_defs.uart import byte_ns
from servobus.bus.report import BusReport
from servobus.bus.report import DeviceReport
from servobus.tools.dump.packet_lines import fit
from servobus.tools.dump.packet_lines import paint
from servobus.tools.dump.screen import COLOURS
from servobus.tools.dump.screen import headline
from servobus.tools.dump.text_format import error_words

WINDOW_S = 10.0
UNTIMED = 'these bytes have no times: rates assume that they were sent without a pause'
REFUSALS_MAX = 8
_COUNTERS = {
    'bytes': 'Bytes', 'packets': 'Packets', 'repaired': 'Repaired Packets',
    'crc_errors': 'CRC Errors', 'truncated': 'Truncated Packets', 'bad_length': 'Bad Lengths',
    'noise_bytes': 'Noise Bytes',
}
_HEAD = 'ID  Model       State         answers   1/s missed loss % dmgd alert p50/p95 ms'


def summary(reports: Sequence[BusReport]) -> dict[str, Any]:
    """Return the counters of all buses together, and the missed answers of each device."""
    found: dict[str, Any] = {
        key: sum(report.counters[name] for report in reports)
        for key, name in _COUNTERS.items()}
    found['missed'] = {
        (f'{report.name}/{device.id}' if len(reports) > 1 else str(device.id)):
        device.totals.missed for report in reports for device in report.devices}
    return found


def stats(reports: Sequence[BusReport], width: int, colours: bool, is_timed: bool) -> list[str]:
    """Return the figures of each bus, a blank line in front of the next."""
    lines = [] if is_timed else [fit(UNTIMED, width)]
    for report in reports:
        lines += [''] * bool(lines)
        lines += _bus(report, width)
        lines += ['', fit(_HEAD, width)] if report.devices else []
        for device in report.devices:
            line = _device(report, device)
            more = f'{line:76} {device.joint}'.rstrip()
            line = fit(more if len(more) <= width else line, width)
            lines.append(paint(line, COLOURS.get(device.level) if colours else None))
        lines += _wrapped(_remarks(report), width)
    return lines


def _bus(report: BusReport, width: int) -> list[str]:
    counters = report.counters
    seconds = _seconds(report)
    mean_load = counters['Bytes'] * byte_ns(report.baud) / 1e7 / seconds if seconds else 0.0
    counts = ', '.join(f'{counters[name]} {key.replace("_", " ")}'
                       for key, name in _COUNTERS.items())
    return _wrapped([headline(report), report.message,
                     f'in all {seconds:.1f} s, mean load {mean_load:.1f} %, '
                     f'{counters["Instructions"]} instructions, {counts}'], width)


def _wrapped(texts: Sequence[str], width: int) -> list[str]:
    return [line for text in texts
            for line in textwrap.wrap(text, width, subsequent_indent='    ') or ['']]


def _device(report: BusReport, device: DeviceReport) -> str:
    totals = device.totals
    over_s = min(WINDOW_S, _seconds(report))
    rate = device.window.answers / over_s if over_s else 0.0
    latency = device.latency.window or device.latency.total
    words = '' if latency is None else f'{latency.p50:.2f}/{latency.p95:.2f}'
    return (f'{device.id:03} {fit(device.model_name, 11):11} {fit(device.state, 12):12} '
            f'{totals.answers:8} {rate:5.0f} {totals.missed:6} {100 * totals.loss:6.2f} '
            f'{totals.damaged:4} {totals.alerts:5} {words}').rstrip()


def _seconds(report: BusReport) -> float:
    """Return for how long the bus was heard."""
    last_byte = report.stamp - int(1e9 * (report.last_byte_s or 0.0))
    return max(0.0, (last_byte - report.started) / 1e9) if report.started else 0.0


def _remarks(report: BusReport) -> list[str]:
    """Return what devices refused to do, the most frequent first; errors; what the cause is."""
    found = sorted(((count, device, key) for device in report.devices
                    for key, count in device.errors.items()),
                   key=lambda one: -one[0])[:REFUSALS_MAX]
    lines = [f'{device.id:03} refused {count} x {name_of(instruction)}'
             f'{f" at {address}" if address >= 0 else ""}: {error_words(error)}'
             for count, device, (instruction, address, error) in found]
    explained = {one.device for one in report.findings}
    lines += [f'{device.id:03} {device.message}' for device in report.devices
              if device.level is Level.ERROR and device.id not in explained]
    lines += [f'{"bus" if one.device is None else f"{one.device:03}"} {one.level.name}: '
              f'{one.message}' for one in report.findings]
    return ['', *lines] if lines else []
