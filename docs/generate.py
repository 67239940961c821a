# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Write the pages of docs/ that are made from the code: `python -m docs.generate`.

--check only compares; a test does that. A key without a meaning below is a KeyError: say what it
means here.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from pathlib import Path
import sys

from docs.sample import sample
from dxl_monitor.bus import report as words
from dxl_monitor.bus.conversation import Settings
from dxl_monitor.model.models import Models
from dxl_monitor.monitor import Monitor
from dxl_monitor.settings import PARAMETERS as MONITOR
from dxl_monitor.status import bus_status
from dxl_monitor.status import device_metrics
from dxl_monitor.status import device_status
from dxl_monitor.status import PortState
from dxl_monitor.tools.doctor import explain
from mecarover_serial.parameters import Parameter
from msg_defs.dxl_packet import encode
from msg_defs.reports import Metric
from msg_defs.reports import unit_name
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import Gate
from vel2d_bridge.graph import Choice
from vel2d_bridge.link import Link
from vel2d_bridge.mcu_log import McuLog
from vel2d_bridge.settings import PARAMETERS as BRIDGE
from vel2d_bridge.status import Commands
from vel2d_bridge.status import commands_status
from vel2d_bridge.status import link_status
from vel2d_bridge.timing import Timing

ROOT = Path(__file__).resolve().parents[1]
NOTE = '<!-- Made from the code by docs/generate.py: edit that, or the code. -->\n'

LINK = {
    'Port': 'as in the parameter `port`',
    'State': 'open or closed',
    'In this state for (s)': '',
    'Frames sent': 'since start, stops and repetitions included',
    'Last x (m/s)': 'of the last frame written',
    'Last y (m/s)': '',
    'Last omega (rad/s)': '',
    'Openings': 'how often the port was opened',
    'Reopenings': 'openings after the first',
    'Losses': 'how often an open port was lost',
    'Write time-outs': 'frames thrown away because they did not leave within `write_timeout`; '
                       'a stop followed each',
    'Partial writes': 'frames of which the port took a part; never completed, a stop followed',
    'Freezes': 'the bridge stood still for 0.2 s or more, or the dead man acted',
    'Deadman': 'ready, off (parameter), no use (a URL it cannot write to; WARN), or '
               'lost (ERROR)',
    'Bytes from MCU': 'text from the MCU is logged at INFO',
    'Lines from MCU': '',
    'Garbage from MCU (B)': 'bytes that are not text',
    'Refused by MCU: crc mismatch': 'frames that the MCU says it refused; WARN for 10 s',
    'Refused by MCU: insufficient bytes': 'the same, because their length was wrong',
    'Last error': 'stays after recovery',
}
COMMANDS = {
    'Topic': 'with namespace and remapping',
    'Message type': 'twist or twist_stamped, as subscribed now',
    'Reliability': 'of the subscription: reliable while every publisher is',
    'State': 'driving, stopped, disabled, or unknown: no stop could be sent',
    'Enabled': 'see the service `~/enable`',
    'Commands received': 'since start',
    'Commands accepted': '',
    'Commands limited': 'accepted, but scaled into the limits',
    'Commands replaced': 'accepted, but a newer one came before they were sent (`max_rate`)',
    'Zero stamps': 'TwistStamped without a stamp: accepted',
    'Refused: not finite': 'NaN or infinity in x, y or omega',
    'Refused: larger than 1e6': 'm/s or rad/s; the MCU would make infinity of the largest',
    'Refused: disabled': 'while `~/enable` is off',
    'Refused: port not open': '',
    'Refused: bridge was frozen': 'in the 0.2 s after a freeze: it may have waited in a socket',
    'Refused: waited too long': 'older than `cmd_vel_timeout` when the node got to it',
    'Refused: stamp too old': '`max_stamp_age`',
    'Refused: stamp in the future': '`max_stamp_age`',
    'Refused: shutting down': '',
    'Time-outs': 'no accepted command for `cmd_vel_timeout`: stopped',
    'Stops: port opened': 'stop bursts by cause',
    'Stops: time-out': '',
    'Stops: zero command': 'a command of zero while driving',
    'Stops: disabled': '',
    'Stops: message type switched': '',
    'Stops: write timed out': '',
    'Stops: bridge was frozen': '',
    'Stops: suspended': 'SIGTSTP (Ctrl-Z)',
    'Stops: shutdown': '',
}
DEVICE = {
    'Model': 'learned from a Ping, from a read of Model Number, or from the parameter `devices`',
    'Firmware Version': '',
    'State': 'see below',
    'Answers': 'since start or reset',
    'Missed Answers': 'it was asked, and the next instruction came first',
    'Missed in a Row': 'more than `missed_limit`: disconnected',
    'Loss in 10 s (%)': 'answers missed in the last 10 s; above `warn_loss`: WARN',
    'Not Served': 'it waits behind a silent device in a Sync Read: not its fault',
    'Damaged Answers': 'its CRC was wrong',
    'Repaired Answers': 'the first header byte was damaged, the CRC right: accepted',
    'Refused Instructions': 'answers with an error number',
    'Alert Answers': 'answers with the alert bit',
    'Writes': 'by the master',
    'Reply latency p50 (ms)': 'left out below 20 % resolved',
    'Reply latency p95 (ms)': '',
    'Reply latency resolved (%)': 'share of the answers with a delay that the adapter shows',
}
BUS = {
    'Port': '',
    'Baud (bit/s)': '',
    'Protocol': 'what was heard: Dynamixel 2.0, Dynamixel 1.0, Feetech (docs/dialects.md)',
    'Devices': 'all that are known or expected; a line per state follows',
    'Models': 'IDs, model and model number: `001-018 MX-106 (321), 019 unknown`',
    'Bytes': 'received since start or reset: the sum of the next three',
    'Packet Bytes': '',
    'Noise Bytes': 'bytes that belong to no packet',
    'Pending Bytes': 'of a packet that is not complete yet',
    'Packets': '',
    'Instructions': 'from the master',
    'Repaired Packets': 'first header byte damaged, CRC right',
    'CRC Errors': '',
    'Truncated Packets': '',
    'Bad Lengths': '',
    'Unasked Answers': 'no instruction had asked for them: they change no table',
    'Unknown Instructions': '',
    'bytes (1/s)': 'over the last 10 s',
    'packets (1/s)': '',
    'errors (1/s)': 'damaged, truncated and impossible packets',
}
STATES = (
    (words.CONNECTED, 'OK; WARN when degraded', 'it answers'),
    (words.DISCONNECTED, 'ERROR', 'more than `missed_limit` answers missed in a row; cleared by '
     'its first answer'),
    (words.SILENT, 'STALE', 'not asked, and silent, for `silent_after`'),
    (words.EXPECTED, 'ERROR', 'listed in `devices`, never heard'),
    (words.ASKED, 'WARN or STALE', 'the master addresses it; never heard, not listed'),
    (words.WAITING, 'WARN', 'asked, but behind a silent device in the same Sync Read'),
    (words.MOVED, 'WARN', 'its Baud Rate was written: it left this bus'),
)
METRICS = {
    'callback_to_write': 'from the arrival of a command in the node to the end of its write',
    'write': 'the write call of a frame',
    'command_period': 'between two commands',
    'stamp_age': 'age of a TwistStamped when it arrives; needs clocks that agree',
    'frame_rate': 'frames sent',
    'resident_memory': 'of the process',
    'time_per_buffer': 'what the monitor takes for one read',
    'time_between_buffers': 'between two reads',
    'bytes_per_buffer': 'per read',
    'byte_rate': 'on the bus',
    'packet_rate': 'on the bus',
    'error_rate': 'damaged packets',
    'bus_load': 'wire time at 10 bits per byte',
    'reply_latency': 'per device: end of the instruction to start of the answer',
}


def parameters() -> str:
    """Return the page about parameters."""
    parts = ['# Parameters\n', NOTE,
             'Set one with `--ros-args -p NAME:=VALUE`, with a settings file '
             '([bridge.yaml](../config/bridge.yaml), [monitor.yaml](../config/monitor.yaml)), or '
             'with a launch argument of the same name where there is one (`ros2 launch '
             'mecarover_serial bridge.launch.py -s` lists them). An integer is good where a '
             'double is wanted, one value where a list is wanted. A wrong value ends the node '
             'with one line and exit code 2. "Run time" = `ros2 param set` changes it while the '
             'node runs.\n']
    for node, some in (('vel2d_bridge', BRIDGE), ('dxl_monitor', MONITOR)):
        parts += [f'## {node}\n', _table(
            ('parameter', 'type', 'default', 'unit', 'values', 'run time', 'meaning'),
            [_parameter_row(one) for one in some])]
    parts.append('`vel2d_bridge` also takes `qos_overrides./cmd_vel.subscription.reliability`, '
                 '`.history` and `.depth`, as any ROS 2 node with overridable QoS.\n')
    return '\n'.join(parts)


def _parameter_row(one: Parameter) -> tuple[str, ...]:
    default = str(one.default).lower() if isinstance(one.default, bool) else \
        "''" if one.default == '' else str(one.default)
    return (f'`{one.name}`', one.type_name, f'`{default}`', one.unit, one.range_text,
            'yes' if one.run_time else 'no', one.description)


def diagnostics() -> str:
    """Return the page about statuses and timing topics."""
    link, commands = _bridge()
    bus, device, bus_metrics, metrics_of_device = _monitor()
    bridge_metrics = Timing().metrics(0)
    own = [Metric('resident_memory', 'MB')]
    return '\n'.join([
        '# Diagnostics and timing topics\n', NOTE,
        'Levels come from what happens now (the last 10 s), not from counts since start. Units '
        'stand in the key, values are bare numbers: PlotJuggler and Foxglove plot them by name '
        '([plotting.md](plotting.md)).\n',
        'In a namespace the names and hardware IDs begin with it, because all robots of a ROS '
        'domain share `/diagnostics`: `rover1/dxl_monitor: 011`, hardware ID `rover1/11`.\n',
        'A report of more than 30 statuses or 60 kB is cut into equal messages, spread over the '
        'period; each of its statuses says which one it stands in: `part` = `1 of 2`. `ros2 topic '
        'hz` then counts so many messages more.\n',
        '## `/diagnostics`: `vel2d_bridge: link`\n', _table(('key', 'meaning'), _rows(link, LINK)),
        '## `/diagnostics`: `vel2d_bridge: commands`\n',
        _table(('key', 'meaning'), _rows(commands, COMMANDS)),
        'A WARN or ERROR gives its reason and remedy in the message; all of them as '
        '`Complaint 1`, `Complaint 2` ...\n',
        '## `/diagnostics`, `dxl/diagnostics`: `dxl_monitor: bus [NAME]`\n',
        _table(('key', 'meaning'), _rows(bus, BUS)),
        'Then what the driver of the port tells, `finding.RULE` for each finding of the doctor '
        'about the bus with `severity.RULE` (`warn` or `error`) beside it, `cannot tell.RULE` '
        'with the reason for each rule that it cannot judge, and, on `dxl/diagnostics` only, '
        '`Running for (s)` and the last 50 errors as `error 00` (the newest) to `error 49`, dated '
        'in seconds since the start.\n',
        '## `/diagnostics`, `dxl/diagnostics`: `dxl_monitor: [BUS/]ID [JOINT]`\n',
        _table(('key', 'meaning'), _rows(device, DEVICE)),
        'Then `finding.RULE` and `severity.RULE` for each finding about the device '
        '([doctor.md](doctor.md)) and, on `dxl/diagnostics` only, '
        'every register that was seen on the bus, `Present Position (rad)` = `1.5708`; enums and '
        'flags in words, with `NAME (raw)` beside them; `Fields not observed`; and `observed`, '
        'JSON: age in seconds and `r` (read from the device) or `w` (written by the master) of '
        'each.\n',
        _table(('state', 'level', 'meaning'), STATES),
        '## Timing\n',
        'Each metric over the last 10 s and since start (`since start ...`): mean, deviation, '
        'min, max, p50, p95, p99, count, or `value`. On `vel2d/timing` and `dxl/timing` '
        '(DiagnosticArray, a status per metric: `vel2d_bridge: timing/write`); the p95 or the '
        'value alone as std_msgs/Float64. With the parameter `timing_topics` `all` they are also '
        'statistics_msgs/MetricsMessage on `vel2d/statistics/...` and '
        '`dxl/statistics/...`; `off` takes all of them away. With several buses the bus name '
        'stands before the metric.\n',
        _table(('topic (Float64)', 'unit', 'meaning'), [
            *_metric_rows('vel2d', bridge_metrics), *_metric_rows('dxl', [*bus_metrics, *own])]),
        'Per device, on `dxl/timing` only: ' + ', '.join(
            f'`{one.name}` ({one.unit}): {METRICS[one.name]}' for one in metrics_of_device)
        + '.\n'])


def _rows(keys: Iterable[str], meanings: dict[str, str]) -> list[tuple[str, str]]:
    return [(f'`{key}`', meanings[key]) for key in keys]


def _metric_rows(prefix: str, metrics: Sequence[Metric]) -> list[tuple[str, ...]]:
    return [(f'`{prefix}/timing/{one.name}_{unit_name(one.unit)}`', one.unit, METRICS[one.name])
            for one in metrics]


def _bridge() -> tuple[list[str], list[str]]:
    """Return the keys of both statuses of the bridge."""
    link = Link('port', 115200, Gate())
    commands = Commands('/cmd_vel', Choice('twist', True), 0.5, (), None, 0, None)
    statuses = (link_status('vel2d_bridge', 'port', link.state(), (), McuLog(), 0),
                commands_status('vel2d_bridge', 'port', link.state(), Counters(), commands))
    keys = [[key for key, _ in status.values] for status in statuses]
    return keys[0], keys[1]


def _monitor() -> tuple[list[str], list[str], Sequence[Metric], Sequence[Metric]]:
    """Return keys of a bus and of a device, and their metrics, after a Ping and its answer."""
    monitor = Monitor('', Models(), Settings())
    for count in range(20):
        monitor.feed(encode(11, 0x01), (2 * count + 1) * 10**6)
        monitor.feed(encode(11, 0x55, b'\x40\x01\x2d', error=0), (2 * count + 2) * 10**6)
    report = monitor.report(5 * 10**7)
    bus = bus_status('', '', report, PortState('port', '', ()), False)
    device = device_status('', '', report.devices[0], (), False)
    keys = [key for key, _ in bus.values if not key.startswith('Devices ')]
    return keys, [key for key, _ in device.values], report.metrics, device_metrics(report)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ['---'] * len(head), *rows]
    return ''.join('| ' + ' | '.join(cell.replace('|', '\\|') for cell in line) + ' |\n'
                   for line in lines)


def errors() -> str:
    return NOTE + explain.page()


PAGES = {'parameters.md': parameters, 'diagnostics.md': diagnostics, 'sample.md': sample,
         'errors.md': errors}


def main(check: bool) -> int:
    """Write the pages, or say which are not current."""
    stale = []
    for name, make in PAGES.items():
        path = ROOT / 'docs' / name
        if not path.exists() or path.read_text() != make():
            stale.append(name)
            if not check:
                path.write_text(make())
    print(f'docs: {"not current" if check else "written"}: {", ".join(stale) or "none"}')
    return int(check and bool(stale))


if __name__ == '__main__':
    sys.exit(main('--check' in sys.argv))
