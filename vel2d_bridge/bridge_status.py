# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The two statuses of the bridge on /diagnostics: what its link does and what its commands are.

Pure: snapshots in, statuses out. A message is what a person acts on; all complaints, the one in
the message too, are values `Complaint N`. The other keys never change, but those of an MCU that
reports itself come with its first report.
"""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from msg_defs import status_keys as keys
from msg_defs.diagnostics import DRIVING
from msg_defs.diagnostics import hardware_id
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import number
from msg_defs.diagnostics import pairs
from msg_defs.diagnostics import PORT_CLOSED
from msg_defs.diagnostics import PORT_OPEN
from msg_defs.diagnostics import Status
from msg_defs.diagnostics import status_name
from msg_defs.running_statistics import Summary
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman import FROZEN
from vel2d_bridge.deadman import GONE
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import Outcome
from vel2d_bridge.graph import Choice
from vel2d_bridge.link import LinkState
from vel2d_bridge.link import NO_STOP
from vel2d_bridge.link import NO_USE
from vel2d_bridge.mcu_log import McuLog

# What is `starting` for longer than a second is FROZEN.
_UNGUARDED = {GONE: 'its process has ended', FROZEN: 'its process is not responding'}
_STUTTER_SAMPLES = 3            # periods of commands that tell a rate
_STREAM_S = 5.0                 # what is slower is a person who taps a key
_REMEDIES = {
    Outcome.NOT_FINITE: 'correct its publisher',
    Outcome.TOO_LARGE: 'correct its publisher',
    Outcome.DISABLED: 'ros2 service call /NODE/enable std_srvs/srv/SetBool "{data: true}"',
    Outcome.NO_PORT: 'see the status of the link',
    Outcome.FROZEN: 'newer commands are accepted again',
    Outcome.WAITED: 'the network or this computer is too slow for cmd_vel_timeout',
    Outcome.STAMP_OLD: 'set the clocks of both computers, or raise max_stamp_age',
    Outcome.STAMP_AHEAD: 'set the clocks of both computers, or raise max_stamp_age',
    Outcome.SHUTDOWN: 'restart the bridge',
}


class Commands(NamedTuple):
    """What the node knows about commands, besides the gate's counters."""

    topic: str
    choice: Choice
    timeout_s: float
    complaints: Sequence[str]   # from graph.py
    period: Summary | None      # ms between commands, over the window
    zero_stamps: int
    refused: Outcome | None     # why the newest command was refused, if that is not long ago
    lacks_clock: bool = False  # use_sim_time without /clock
    absence: str = ''           # no node publishes: not a fault while the rover is stopped


def refusal(node: str, topic: str, velocity: Vel2d, verdict: Outcome, lacks_clock: bool) -> str:
    """Say why a command was not taken, and what helps."""
    x, y, omega = velocity
    return (f'{topic}: command ({x:g}, {y:g}, {omega:g}) refused: {verdict.value}; '
            f'{_remedy(verdict, node, lacks_clock)}')


def _remedy(verdict: Outcome, node: str, lacks_clock: bool) -> str:
    if lacks_clock and verdict in (Outcome.STAMP_OLD, Outcome.STAMP_AHEAD):
        return 'start what publishes /clock, or set use_sim_time false'
    return _REMEDIES[verdict].replace('NODE', node)


def link_status(node: str, port: str, state: LinkState, warnings: Sequence[str], mcu: McuLog,
                now: int) -> Status:
    """Is the port open, does it take frames, what disturbs it."""
    complaints = list(warnings) if state.is_open else []
    if state.deadman == NO_USE:
        complaints.insert(0, 'deadman: it cannot write to this kind of URL, so nothing stops the '
                          'rover if this process dies; use a device or socket://')
    level, message = Level.OK, 'open'
    if state.problem is not None:
        level, message = Level.ERROR, str(state.problem)
    elif not state.is_open:
        level, message = Level.WARN, 'opening the port'
    elif state.deadman in _UNGUARDED:
        level, message = Level.ERROR, (f'deadman: {_UNGUARDED[state.deadman]}, so nothing stops '
                                       'the rover if the bridge dies; restart the bridge')
    elif complaints:
        level, message = Level.WARN, _first(complaints)
    velocity = state.last.velocity if state.last else STOP
    return Status(status_name(node, 'link'), level, message, hardware_id(node, port), pairs({
        keys.PORT: port,
        keys.STATE: PORT_OPEN if state.is_open else PORT_CLOSED,
        'In this state for (s)': round((now - state.since) / 1e9, 1),
        'Frames sent': state.frames,
        'Last x (m/s)': velocity.x,
        'Last y (m/s)': velocity.y,
        'Last omega (rad/s)': velocity.omega,
        'Openings': state.openings,
        'Reopenings': max(0, state.openings - 1),
        'Losses': state.losses,
        'Write time-outs': state.time_outs,
        'Partial writes': state.partial_writes,
        'Freezes': state.freezes,
        'Deadman': state.deadman,
        'Bytes from MCU': mcu.bytes,
        'Lines from MCU': mcu.lines,
        'Garbage from MCU (B)': mcu.garbage_bytes,
        **{f'Refused by MCU: {words}': count for words, count in mcu.refused.items()},
        'Last error': state.last_error or 'none',
        **mcu.report_values(now),
        **_numbered(complaints),
    }))


def commands_status(node: str, port: str, state: LinkState, counters: Counters,
                    commands: Commands) -> Status:
    """Are commands heard, taken, and frequent enough."""
    level, message = Level.OK, '; '.join(filter(None, (_state_word(state), commands.absence)))
    if complaints := _complaints(node, state, commands):
        level = Level.ERROR if state.owes_stop else Level.WARN
        message = _first(complaints)
    return Status(status_name(node, 'commands'), level, message, hardware_id(node, port), pairs({
        keys.TOPIC: commands.topic,
        keys.MESSAGE_TYPE: commands.choice.message_type,
        'Reliability': 'reliable' if commands.choice.reliable else 'best effort',
        keys.STATE: _state_word(state),
        'Enabled': state.enabled,
        keys.COMMANDS_RECEIVED: counters.received,
        'Commands accepted': counters.accepted,
        'Commands limited': counters.limited,
        'Commands replaced': counters.replaced,
        'Zero stamps': commands.zero_stamps,
        **{f'Refused: {verdict.value}': counters.refused[verdict]
           for verdict in Outcome if verdict is not Outcome.ACCEPTED},
        'Time-outs': counters.time_outs,
        **{f'Stops: {why.value}': count for why, count in counters.stops.items()},
        **_numbered(complaints),
    }))


def _complaints(node: str, state: LinkState, commands: Commands) -> list[str]:
    """Return what keeps the rover from following its commands, the main reason first."""
    lines = []
    if state.owes_stop:
        lines.append(f'{NO_STOP}; switch it off, or see the status of the link')
    elif _is_unknown(state):
        lines.append('no stop has been sent since the start, the rover may be driving; plug its '
                     'port in, or switch it off')
    if not state.enabled:
        lines.append(f'{commands.topic}: disabled; {_remedy(Outcome.DISABLED, node, False)}')
    elif commands.refused is not None:
        lines.append(f'{commands.topic}: commands are refused: {commands.refused.value}; '
                     f'{_remedy(commands.refused, node, commands.lacks_clock)}')
    if commands.timeout_s == 0:
        lines.append('cmd_vel_timeout: 0 holds the last command for ever'
                     + (', and the rover is driving' if state.driving else '')
                     + ('' if commands.choice.reliable else
                        ', and best effort may lose the command to stop')
                     + '; set 0.5')
    lines += commands.complaints
    if state.driving and commands.absence:
        lines.append(commands.absence)
    period = commands.period
    if period is not None and _stutters(period, commands.timeout_s):
        lines.append(
            f'{commands.topic}: a command every {number(round(period.p50 / 1000, 2))} s, slower '
            f'than cmd_vel_timeout ({number(commands.timeout_s)} s), so the rover stops in '
            'between; publish faster or raise cmd_vel_timeout')
    return lines


def _stutters(period: Summary, timeout_s: float) -> bool:
    """Tell whether commands are a stream that is too slow; single taps are no stream."""
    return period.count >= _STUTTER_SAMPLES and 0 < timeout_s < period.p50 / 1000 < _STREAM_S


def _is_unknown(state: LinkState) -> bool:
    """Tell whether the rover may be driving: by what we sent, or the bridge before us."""
    return state.owes_stop or not (state.frames or state.is_open)


def _state_word(state: LinkState) -> str:
    if _is_unknown(state):
        return 'unknown'
    if not state.enabled:
        return 'disabled'
    return DRIVING if state.driving else 'stopped'


def _first(complaints: Sequence[str]) -> str:
    first, *more = complaints
    return f'{first} (and {len(more)} more)' if more else first


def _numbered(complaints: Sequence[str]) -> dict[str, str]:
    return {f'Complaint {number}': line for number, line in enumerate(complaints, start=1)}
