# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What comes to the dashboard: serialised messages of anybody, and names in a request."""

import json
import struct

from dxl_monitor.dashboard.cdr import CdrError
from dxl_monitor.dashboard.cdr import statuses
from dxl_monitor.dashboard.server import is_ours
from dxl_monitor.dashboard.state import HISTORY
from dxl_monitor.dashboard.state import MOST_ROWS
from dxl_monitor.dashboard.state import State
from dxl_monitor.dashboard.state import TOPICS
from fuzz.script import Script

NAMES = ('dxl_monitor: 001', 'dxl_monitor: 001 knee', 'dxl_monitor: left/011', 'n: bus', ': 002',
         'dxl_monitor: bus left', 'vel2d_bridge: link', 'vel2d_bridge: commands', 'x', '',
         'n: timing/write', 'dxl_monitor: timing/001/reply_latency', 'n: timing/', 'n: bus left')
KEYS = ('Model', 'State', 'Port', 'Topic', 'Present Position (rad)', 'Present Position (raw)',
        'observed', 'finding.cable', 'error 00', 'p50 (ms)', 'p95 (ms)', 'max (ms)', 'value', '',
        'Loss in 10 s (%)', 'Firmware Version', 'Reply latency p50 (ms)')
VALUES = ('1.5', 'nan', 'inf', '-inf', '1e400', '', 'connected', '[]',
          '{"Present Position": [1, "r"]}', '{"Present Position": [NaN, "w"]}',
          '{"Present Position": [-1, null]}', '{"Model": [1e308, "\\ud800"]}', '[' * 200,
          '<script>', 'x' * 1200, '\u0000', '1' * 5000)


def check(data):
    """
    Check what a few messages do to the page.

    Never raises; the number of rows and points is bounded; all that a page is told is JSON that
    can be sent; what was serialised is read again; an address is ours only by itself.
    """
    script = Script(data)
    state = State()
    now_s = 1.0
    while script:
        message, wanted = made(script)
        assert [(one.level, one.name, one.pairs(limit=6000))
                for one in statuses(message)] == wanted
        if script.byte() > 180:
            message = damaged(script, message)
        never_raises(message)
        state.take(script.pick(TOPICS), message, now_s)
        now_s += script.pick((0.0, 0.1, 1.0, 5.0, 100.0))
        state.expire(now_s)
        told(state, script.byte(), now_s)
    assert sum(map(len, state._entries.values())) <= MOST_ROWS
    assert all(len(points) <= HISTORY for points in state._latencies.values())
    assert not is_ours(data.decode('latin-1'), frozenset(), False) or b'127' in data \
        or b'1' in data


def made(script):
    """Serialise a DiagnosticArray of a few statuses; return it and what it holds."""
    wanted = [(script.byte() % 8, script.pick(NAMES), [
        (script.pick(KEYS), script.pick(VALUES)) for _ in range(script.byte() % 12)])
        for _ in range(script.byte() % 4)]
    return cdr([(level, name, 'words', 'left/11', pairs) for level, name, pairs in wanted]), wanted


def cdr(found):
    """Serialise statuses (level, name, message, hardware_id, pairs) as XCDR1, little-endian."""
    out = bytearray(b'\0\1\0\0' + bytes(8))

    def number(value):
        out.extend(bytes(-len(out) % 4) + struct.pack('<I', value))

    def text(value):
        raw = value.encode() + b'\0'
        number(len(raw))
        out.extend(raw)

    text('')
    number(len(found))
    for level, *texts, pairs in found:
        out.append(level)
        for one in texts:
            text(one)
        number(len(pairs))
        for key, value in pairs:
            text(key)
            text(value)
    return bytes(out)


def damaged(script, message):
    at = script.word() % (len(message) + 1)
    return message[:at] + script.take(script.byte() % 8) + message[at + script.byte() % 8:]


def never_raises(message):
    try:
        for one in statuses(message):
            one.pairs()
    except CdrError:
        pass


def told(state, since, now_s):
    """Hold that all a page may ask for can be sent."""
    said = [state.changes(0), state.changes(since), state.topics(now_s)]
    for name in list(state._entries['devices']):
        said += [state.table(name), state.latency(name, 0.0)]
    for one in said:
        json.dumps(one, ensure_ascii=False, allow_nan=False).encode()
