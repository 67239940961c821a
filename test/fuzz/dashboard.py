# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What comes to the dashboard: serialised messages of anybody, and names in a request."""

import json
import re
import struct

from fuzz.script import Script
from mecarover_dashboard import rows
from mecarover_dashboard.cdr import CdrError
from mecarover_dashboard.cdr import statuses
from mecarover_dashboard.request_guard import is_ours
from mecarover_dashboard.state import State
from mecarover_dashboard.state import TOPICS
from servobus.printable_text import printable

TEXT_LIMIT = 500
NAMES = ('dxl_monitor: 001', 'dxl_monitor: 001 knee', 'dxl_monitor: left/011', 'n: bus', ': 002',
         'dxl_monitor: bus left', 'vel2d_bridge: link', 'vel2d_bridge: commands', 'x', '',
         'n: timing/write', 'dxl_monitor: timing/001/reply_latency', 'n: timing/', 'n: bus left')
KEYS = ('Model', 'State', 'Port', 'Topic', 'Present Position (rad)', 'Present Position (raw)',
        'observed', 'finding.cable', 'error 00', 'p50 (ms)', 'p95 (ms)', 'max (ms)', 'value', '',
        'Loss in 10 s (%)', 'Firmware Version', 'Reply latency p50 (ms)')
VALUES = ('1.5', 'nan', 'inf', '-inf', '1e400', '', 'connected', '[]',
          '{"Present Position": [1, "r"]}', '{"Present Position": [NaN, "w"]}',
          '{"Present Position": [-1, null]}', '{"Model": [1e308, "\\ud800"]}', '[' * 5000,
          '<script>', 'x' * 1200, '\u0000', '1' * 5000, '\u00e9' * 499, b'\xff\xfe', b'\xc3')
MESSAGES = ('connected', 'disconnected: 5 answers missed', '', '\u00e9' * 600)
BEGINNINGS = ((), (), ('Model', 'Firmware Version', 'State'), ('Model', 'State', 'observed'),
              ('Port', 'State', 'error 00'), ('Topic', 'Message type'), ('p50 (ms)', 'p95 (ms)'))
LOOPBACK = re.compile(r'[\[\]]*(127(\.\d{1,3}){3}|[0:]*:0{0,3}1(%[^:]*)?)[\[\]]*\.*(:.*)?', re.S)


def check(data):
    """
    Check what a few messages do to the page.

    Never raises; all that a page gets is JSON that can be sent; what was serialised is read again,
    in either order of bytes, no text longer than the limit, and what is cut anywhere is refused;
    the last word about a device counts; a page that gets changes has what one has that gets all;
    an address is ours only by itself.
    """
    script = Script(data[1:])           # kept inputs have a byte more
    state = State()
    page = Page(state)
    now_s = 1.0
    while script:
        message, wanted = make_message(script)
        assert [as_sent(one) for one in statuses(message)] == wanted
        cut_short(message, script.word())
        if script.byte() > 180:
            message = damaged(script, message)
        never_raises(message)
        state.store_message(script.pick(TOPICS), message, now_s)
        last_word_counts(state, message)
        now_s += script.pick((0.0, 0.1, 1.0, 5.0, 100.0))
        state.expire(now_s)
        check_replies(state, script.byte(), now_s)
        if script.byte() > 80:
            page.poll()
    page.poll()
    page.has_all()
    is_local(data)


def make_message(script):
    """Serialise a DiagnosticArray of a few statuses; return it and what it holds."""
    wanted = []
    for _ in range(script.byte() % 4):
        keys = [*script.pick(BEGINNINGS), *(script.pick(KEYS) for _ in range(script.byte() % 10))]
        wanted.append((script.byte() % 8, script.pick(NAMES), script.pick(MESSAGES), 'left/11',
                       [(key, script.pick(VALUES)) for key in keys]))
    return cdr(wanted, script.pick('<>')), [
        (level, as_text(name), as_text(text)[:TEXT_LIMIT]
         + f'\u2026 ({len(text.encode())} bytes)' * (len(text) > 500),
         who, [(as_text(key), as_text(value)) for key, value in pairs])
        for level, name, text, who, pairs in wanted]


def as_text(value):
    return printable(value.decode(errors='replace') if isinstance(value, bytes) else value)


def as_sent(status):
    for (key, text), (same, whole) in zip(status.pairs(), status.pairs(limit=6000), strict=True):
        assert key == same
        size = len(whole.encode())
        assert text == whole if len(whole) <= TEXT_LIMIT else (
            text == f'{whole[:TEXT_LIMIT]}\u2026 ({size} bytes)')
    assert status.pairs(2) == status.pairs()[:2]
    return (*status[:4], status.pairs(limit=6000))


def cdr(found, order='<'):
    """Serialise statuses (level, name, message, hardware_id, pairs) as XCDR1."""
    out = bytearray((b'\0\1' if order == '<' else b'\0\0') + bytes(10))

    def number(value):
        out.extend(bytes(-len(out) % 4) + struct.pack(order + 'I', value))

    def text(value):
        raw = (value if isinstance(value, bytes) else value.encode()) + b'\0'
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


def cut_short(message, where):
    try:
        statuses(message[:where % len(message)])
    except CdrError:
        return
    raise AssertionError('a message that was cut is taken')


def damaged(script, message):
    at = script.word() % (len(message) + 1)
    return message[:at] + script.take_bytes(script.byte() % 8) + message[at + script.byte() % 8:]


def never_raises(message):
    try:
        for one in statuses(message):
            one.pairs()
    except CdrError:
        pass


def last_word_counts(state, message):
    try:
        last = {(rows.section(one), one.name): one for one in statuses(message)}
    except CdrError:
        return
    for (section, name), status in last.items():
        entry = state._entries.get(section, {}).get(name)
        if entry is not None and entry.arrived:
            assert entry.row['message'] == status.message
            assert entry.row['level'] == (status.level if status.level < 4 else 3)


def check_replies(state, since, now_s):
    """Hold that all a page may ask for can be sent."""
    said = [state.changes(0), state.changes(since), state.topics(now_s)]
    for name in list(state._entries['devices']):
        said += [state.table(name), state.latency(name, 0.0)]
    for one in said:
        json.dumps(one, ensure_ascii=False, allow_nan=False).encode()


class Page:
    """A client: it is told what changed, whenever it asks, and keeps it."""

    def __init__(self, state):
        self.state = state
        self.version = 0
        self.rows = {}

    def poll(self):
        for section, changed in self.state.changes(self.version).items():
            for name, row in changed.items():
                if row is None:
                    self.rows.pop((section, name), None)
                else:
                    before = self.rows.get((section, name), {}).get('points', [])
                    points = before + row['points'] if 'points' in row else None
                    self.rows[section, name] = {**row, 'points': points}
        self.version = self.state.version

    def has_all(self):
        """Hold that it has all; of a metric that was gone for a while it may have more."""
        whole = {(section, name): {'points': None, **row}
                 for section, found in self.state.changes(0).items()
                 for name, row in found.items()}
        for key, row in whole.items():
            points = self.rows[key]['points']
            if points is not None:
                self.rows[key]['points'] = points[len(points) - len(row['points']):]
        assert self.rows == whole


def is_local(data):
    """Hold that without names no host is taken but an address of this machine."""
    host = data.decode('latin-1')
    assert not is_ours(host, frozenset(), False) or LOOPBACK.fullmatch(host)
