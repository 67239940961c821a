# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Write the pages of docs/ that are made from the code: `python -m docs.generate`.

--check only compares; a test does that. A key without a meaning below is a KeyError: say what it
means here.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
from functools import partial
from pathlib import Path
import sys

from docs.screens import with_screens
from dxl_monitor.monitor_settings import PARAMETERS as MONITOR
from mecarover_serial.parameters import Parameter
from msg_defs.diagnostics import Metric
from msg_defs.diagnostics import unit_name
from msg_defs.dxl_packet import encode
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.mcu_report import McuReport
from servobus.bus import report as words
from servobus.bus.decoder import Settings
from servobus.doctor.rule import Rule
from servobus.doctor.rules import FAMILIES
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.status import bus_status
from servobus.status import device_status
from servobus.status import PortState
from servobus.status import timing_metrics
from servobus.tools.doctor.explain import Explanation
from servobus.tools.doctor.explain import explanations
from vel2d_bridge.bridge_settings import PARAMETERS as BRIDGE
from vel2d_bridge.bridge_status import Commands
from vel2d_bridge.bridge_status import commands_status
from vel2d_bridge.bridge_status import link_status
from vel2d_bridge.bridge_timing import Timing
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import Gate
from vel2d_bridge.graph import Choice
from vel2d_bridge.link import Link
from vel2d_bridge.mcu_log import McuLog

ROOT = Path(__file__).resolve().parents[1]
LIKELIEST_CAUSES = 2               # --explain names all
NAMED_PROGRAMS = 3                 # as well
NOTE = '<!-- Made from the code by docs/generate.py: edit that, or the code. -->\n'
FINDINGS = '<!-- Made from servobus/doctor/rules/ by docs/generate.py: edit that. -->\n'
FINDINGS_END = '<!-- End of what is made from the rules. -->\n'

TOPICS = (
    ('`cmd_vel` (subscribed)', 'Twist or TwistStamped', 'x, y, omega; `message_type`'),
    ('`/diagnostics`', 'DiagnosticArray, 1 Hz and at a change of level',
     'link, commands, buses, devices'),
    ('`dxl/diagnostics`', 'DiagnosticArray, 2 Hz',
     'buses, then devices, the worst first; every register seen'),
    ('`dxl/joint_states`', 'JointState', 'off by default: `joint_state_rate`'),
    ('`vel2d/timing`, `dxl/timing`', 'DiagnosticArray, 1 Hz', 'latencies, rates, bus load'),
    ('`vel2d/timing/...`, `dxl/timing/...`', 'Float64, 1 Hz', 'the same for rqt_plot'),
)
LINK = {
    'Port': '',
    'State': 'open or closed',
    'In this state for (s)': '',
    'Frames sent': 'with stops and repetitions',
    'Last x (m/s)': '',
    'Last y (m/s)': '',
    'Last omega (rad/s)': '',
    'Openings': '',
    'Reopenings': '',
    'Losses': '',
    'Write time-outs': 'frames discarded after `write_timeout`; a stop followed each',
    'Partial writes': 'the port took part of a frame; a stop followed',
    'Freezes': 'no activity for 0.2 s or more, or the dead man acted',
    'Deadman': 'ready, off (parameter), no use (a URL: WARN), starting, '
               'frozen or lost: both ERROR',
    'Bytes from MCU': '',
    'Lines from MCU': '',
    'Garbage from MCU (B)': 'not text; text is logged',
    'Refused by MCU: crc mismatch': 'reported by the MCU; WARN for 10 s',
    'Refused by MCU: insufficient bytes': 'the same: a wrong length',
    'Last error': 'kept after recovery',
    'MCU version': 'this and the next if the [MCU reports](firmware.md)',
    'MCU state': 'waiting for a first frame, running, or stopped by its watchdog: WARN',
    'MCU good frames': '',
    'MCU bad frames': 'received damaged',
    'MCU refused frames': 'not finite, or above the limits of the MCU',
    'MCU watchdog stops': '',
    'MCU report age (s)': '',
}
COMMANDS = {
    'Topic': '',
    'Message type': 'subscribed now: twist or twist_stamped',
    'Reliability': 'of the subscription: reliable while every publisher is',
    'State': 'driving (by what is sent), stopped, disabled, or unknown: no stop could be sent',
    'Enabled': '',
    'Commands received': '',
    'Commands accepted': '',
    'Commands limited': 'accepted, but scaled into the limits',
    'Commands replaced': 'accepted, but a newer one came before they were sent (`max_rate`)',
    'Zero stamps': '',
    'Refused: not finite': '',
    'Refused: larger than 1e6': '',
    'Refused: disabled': '',
    'Refused: port not open': '',
    'Refused: bridge was frozen': 'in the 0.2 s after a freeze',
    'Refused: waited too long': 'in the middleware, for more than `cmd_vel_timeout`',
    'Refused: stamp too old': '',
    'Refused: stamp in the future': '',
    'Refused: shutting down': '',
    'Time-outs': '',
    'Stops: port opened': '',
    'Stops: time-out': '',
    'Stops: zero command': '',
    'Stops: disabled': '',
    'Stops: message type switched': '',
    'Stops: write timed out': '',
    'Stops: bridge was frozen': '',
    'Stops: suspended': 'SIGTSTP (Ctrl-Z)',
    'Stops: shutdown': '',
}
DEVICE = {
    'Model': 'from a Ping, a read of Model Number, or `devices`',
    'Firmware Version': '',
    'State': '',
    'Answers': '',
    'Missed Answers': 'the next instruction came before the answer',
    'Missed in a Row': '',
    'Loss in 10 s (%)': '',
    'Not Served': 'in a Sync Read that ended at a silent device before it',
    'Damaged Answers': 'wrong CRC or sum',
    'Repaired Answers': 'first header byte damaged, CRC right: accepted',
    'Refused Instructions': 'answers with an error number',
    'Alert Answers': '',
    'Writes': '',
    'Reply latency p50 (ms)': 'if at least 20 % are resolved',
    'Reply latency p95 (ms)': '',
    'Reply latency resolved (%)': 'share of answers whose delay the adapter shows',
}
BUS = {
    'Port': '',
    'State': 'of the port: open or closed',
    'Baud (bit/s)': '',
    'Protocol': '[as heard](dialects.md)',
    'Devices': 'known or expected; then a key for each state',
    'Models': 'IDs, model, number: `001-018 MX-106 (321), 019 unknown`',
    'Bytes': 'packet, noise and pending bytes',
    'Packet Bytes': '',
    'Noise Bytes': '',
    'Pending Bytes': '',
    'Packets': '',
    'Instructions': '',
    'Repaired Packets': 'first header byte damaged, CRC right',
    'CRC Errors': '',
    'Truncated Packets': '',
    'Bad Lengths': '',
    'Unasked Answers': 'without an instruction',
    'Unknown Instructions': '',
    'bytes (1/s)': '',
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
    (words.WAITING, 'WARN', 'in a Sync Read, after a silent device'),
    (words.MOVED, 'WARN', 'its Baud Rate was written'),
)
METRICS = {
    'callback_to_write': 'from callback to end of write',
    'write': '',
    'command_period': '',
    'stamp_age': 'of a TwistStamped at arrival; needs clocks that agree',
    'frame_rate': '',
    'resident_memory': '',
    'time_per_buffer': 'to process one read',
    'time_between_buffers': '',
    'bytes_per_buffer': '',
    'byte_rate': '',
    'packet_rate': '',
    'error_rate': 'damaged packets',
    'bus_load': 'wire time at 10 bits per byte',
    'cycle': 'one turn of the fastest loop of the program; [its parts](dxl_doctor.md#the-screen)',
    'cycle_wire': '',
    'cycle_device': '',
    'cycle_waiting': '',
    'cycle_program': '',
    'reply_latency': 'end of the instruction to start of the answer',
}


def parameters() -> str:
    """Return the page about parameters."""
    parts = ['# Parameters\n', NOTE,
             'Set one with `--ros-args -p NAME:=VALUE`, in a settings file '
             '([bridge.yaml](../config/bridge.yaml), [monitor.yaml](../config/monitor.yaml); copy '
             'it, then `--params-file FILE` or the launch argument `config:=$PWD/FILE`), or with '
             'the launch argument of the same name (`ros2 launch mecarover_serial '
             'bridge.launch.py -s` lists them). A launch argument wins over the file. A wrong '
             'value ends the node with one line and exit code 2 (1 for a `port` that cannot be '
             'one). **Bold**: `ros2 param set` changes it while the node runs.\n']
    for node, some in (('vel2d_bridge', BRIDGE), ('dxl_monitor', MONITOR)):
        parts += [f'## {node}\n', _table(('parameter', 'default', 'values', 'meaning'),
                                         [_parameter_row(one) for one in some])]
    parts.append('And `qos_overrides./cmd_vel.subscription` of the bridge, '
                 '`qos_overrides./dxl/joint_states.publisher` of the monitor: `.reliability`, '
                 '`.history`, `.depth`. The topic is the one that `ros2 topic list` shows.\n')
    return '\n'.join(parts)


def _parameter_row(one: Parameter) -> tuple[str, ...]:
    default = str(one.default).lower() if isinstance(one.default, bool) else \
        "''" if one.default == '' else str(one.default)
    name = f'**`{one.name}`**' if one.run_time else f'`{one.name}`'
    values = f'{one.range_text} {one.unit}'.strip()
    return name, f'`{default}`', values, one.description


def diagnostics() -> str:
    """Return the page about statuses and timing topics."""
    link, commands = _bridge()
    bus, device, bus_metrics, metrics_of_device = _monitor()
    bridge_metrics = Timing().metrics(0)
    topics = {**_topics('vel2d', bridge_metrics),
              **_topics('dxl', [*bus_metrics, Metric('resident_memory', 'MB')])}
    return '\n'.join([
        '# Topics and status keys\n', NOTE,
        _table(('topic', 'type', 'content'), TOPICS),
        'Services: `/vel2d_bridge/enable` (SetBool), `/vel2d_bridge/reset_statistics`, '
        '`/dxl_monitor/reset_statistics`, `/dxl_monitor/save_recording` (Trigger).\n',
        'Levels come from the last 10 s; counters count since start or reset. Keys contain the '
        'unit, values are bare numbers. In a namespace, names and hardware IDs begin with it: '
        '`rover1/dxl_monitor: 011`, `rover1/servo bus ttyUSB0/ID 11`. A report of more than 30 '
        'statuses or 60 kB comes in equal messages, each status with `part` = `1 of 2`.\n',
        '## `vel2d_bridge: link`\n', *_keys(link, LINK),
        '## `vel2d_bridge: commands`\n', *_keys(commands, COMMANDS),
        'At WARN and ERROR the message has reason and remedy; all of them: `Complaint 1`, '
        '`Complaint 2` ...\n',
        '## `dxl_monitor: bus [NAME]`\n', *_keys(bus, BUS),
        'After `State`: `finding.RULE` and `severity.RULE` (`warn` or `error`) for each '
        '[finding](doctor.md) about the bus, `covers.RULE`, the devices that suffer from it, and '
        '`device ID`, what is wrong with the worst five. Last: counters of the driver; `cannot '
        'tell.RULE`, why a rule cannot be judged. On `dxl/diagnostics` only: `Running for (s)`, '
        'and the last 50 errors, `error 00` (the newest) to `error 49`, in seconds since start.\n',
        '## `dxl_monitor: [BUS/]ID [JOINT]`\n', *_keys(device, DEVICE),
        'Then `finding.RULE` and `severity.RULE`. On `/diagnostics` temperature and input '
        'voltage; on `dxl/diagnostics` every register seen, `Present Position (rad)` = `1.5708`; '
        'enums and flags as text, and `NAME (raw)`; `Fields not observed`; `observed`, JSON: age '
        'in seconds and `r` (read) or `w` (written by the master) of each.\n',
        _table(('state', 'level', 'meaning'), STATES),
        '## Timing\n',
        'On `vel2d/timing` and `dxl/timing` a status for each metric (`vel2d_bridge: '
        'timing/write`): mean, deviation, min, max, p50, p95, p99, count, or `value`, over the '
        'last 10 s and since start. The Float64 topics have the p95 or the value. The parameter '
        '`timing_topics` `all` adds statistics_msgs/MetricsMessage on `vel2d/statistics/...` and '
        '`dxl/statistics/...`; `off` removes all. `BUS`, of `names`, is always there.\n',
        *_keys([*topics], topics),
        'Per device, on `dxl/timing` only: ' + ', '.join(
            f'`{one.name}` ({one.unit}), {METRICS[one.name]}' for one in metrics_of_device)
        + '.\n'])


def _keys(keys: Sequence[str], meanings: dict[str, str]) -> list[str]:
    """Return a list of the keys that need a meaning, and the others in a line."""
    plain = ', '.join(f'`{key}`' for key in keys if not meanings[key])
    return [*(f'- `{key}`: {meanings[key]}' for key in keys if meanings[key]),
            f'\nAnd {plain}.\n']


def _topics(prefix: str, metrics: Sequence[Metric]) -> dict[str, str]:
    return {'/'.join(filter(None, (prefix, 'timing', one.bus_name,
                                   f'{one.name}_{unit_name(one.unit)}'))): METRICS[one.name]
            for one in metrics}


def _bridge() -> tuple[list[str], list[str]]:
    """Return the keys of both statuses of the bridge."""
    link, mcu = Link('port', 115200, Gate()), McuLog()
    mcu.feed(f'{McuReport().line()}\n'.encode())
    commands = Commands('/cmd_vel', Choice('twist', True), 0.5, (), None, 0, None)
    statuses = (link_status('vel2d_bridge', 'port', link.state(), (), mcu, 0),
                commands_status('vel2d_bridge', 'port', link.state(), Counters(), commands))
    keys = [[key for key, _ in status.values if not key.startswith('Complaint ')]
            for status in statuses]
    return keys[0], keys[1]


def _monitor() -> tuple[list[str], list[str], Sequence[Metric], Sequence[Metric]]:
    """Return keys of a bus and of a device, and their metrics, after a Ping and its answer."""
    monitor = Monitor('', Models(), Settings())
    for count in range(20):
        monitor.feed(encode(11, 0x01), (2 * count + 1) * 10**8, OUT)
        monitor.feed(encode(11, 0x55, b'\x40\x01\x2d', error=0), (2 * count + 2) * 10**8, IN)
    report = monitor.report(5 * 10**9)
    port = PortState('port', '', (), bus='BUS')
    bus = bus_status('', '', report, port, False)
    device = device_status('', '', report.devices[0], (), False)
    keys = [key for key, _ in bus.values if not key.startswith('Devices ')]
    metrics = timing_metrics('', report, port)
    return (keys, [key for key, _ in device.values],
            *([one for one in metrics if bool(one.device) is of] for of in (False, True)))


def errors() -> str:
    """Return the page about error texts, a section for each: search engines find them."""
    return '\n'.join([
        '# Error texts of servo libraries\n', NOTE,
        'What programs print when a servo bus fails, who prints it, and what it means. Causes are '
        '[findings](doctor.md), the likeliest: `dxl_doctor run -- COMMAND` says which. '
        '`dxl_doctor --explain "TEXT"` prints a section, with all causes.\n',
        *map(_error, explanations())])


def _error(one: Explanation) -> str:
    also = ''.join(f', `{text.replace("{}", "...")}`' for text in one.also
                   if text not in one.text)
    causes = ', '.join(f'`{rule}`' for rule in one.findings[:LIKELIEST_CAUSES])
    who = ', '.join(one.says[:NAMED_PROGRAMS])
    parts = [f'## {one.text.replace("{}", "...")}\n', f'{who}{also}\n',
             ' '.join(filter(None, [one.means, one.do])) + '\n',
             f'Causes: {causes}\n' if causes else '']
    return '\n'.join(filter(None, parts))


def page_with_screens(name: str) -> str:
    """Return a page by hand with its screens up to date."""
    return with_screens((ROOT / name).read_text())


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ['| ' + ' | '.join(cell.replace('|', '\\|') for cell in line) + ' |\n'
             for line in [head, *rows]]
    return ''.join([lines[0], '|---' * len(head) + '|\n', *lines[1:]])


def doctor() -> str:
    """Return the page about findings: made from the rules, the rest of it as it is."""
    page = (ROOT / 'docs/doctor.md').read_text()
    before, after = page[:page.index(FINDINGS)], page[page.index(FINDINGS_END):]
    tables = [f'## {title}\n\n' + _table(('finding', 'seen', 'do'), map(_finding_row, rules))
              for title, rules in FAMILIES.items()]
    return before + '\n'.join((FINDINGS, *tables, after))


def _finding_row(rule: Rule) -> tuple[str, ...]:
    subject = '' if rule.subject == 'device' else f', {rule.subject}'
    return f'`{rule.name}` {rule.level.name}{subject}', *rule.advice


PAGES: dict[str, Callable[[], str]] = {
    'docs/parameters.md': parameters, 'docs/diagnostics.md': diagnostics,
    'docs/errors.md': errors, 'docs/doctor.md': doctor,
    **{name: partial(page_with_screens, name)
       for name in ('README.md', 'docs/so101.md', 'docs/openmanipulator.md')}}


def main(check: bool) -> int:
    """Write the pages, or say which are not current."""
    stale = []
    for name, make in PAGES.items():
        path = ROOT / name
        if not path.exists() or path.read_text() != make():
            stale.append(name)
            if not check:
                path.write_text(make())
    print(f'{"not current" if check else "written"}: {", ".join(stale) or "none"}')
    return int(check and bool(stale))


if __name__ == '__main__':
    sys.exit(main('--check' in sys.argv))
