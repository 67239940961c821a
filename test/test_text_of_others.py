# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Text of others: no control code of a file, a device or a topic leaves a tool or the page."""
from contextlib import suppress
import csv
import io
import json
import os
from pathlib import Path
from random import Random
import re
import sqlite3
from urllib.request import urlopen

from dashboard_page import Dashboard
import forked
from harness import Program
import pytest
from synthetic_robot import serialise

from mecarover_dashboard.history import Event
from mecarover_dashboard.history import HistoryWriter
from mecarover_dashboard.history import Subject
from mecarover_dashboard.history import Window
from mecarover_dashboard.state import OVERVIEW
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import Status
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Chunk
from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.printable_text import plain
from servobus.printable_text import printable
from servobus.sources import tap_sender
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.sources.tap_reader import _Connection
from servobus.tools.doctor import issue_report

DUMP, DOCTOR, REPLAY = (f'servobus.tools.{name}' for name in ('dxl_dump', 'dxl_doctor', 'replay'))
# Colour, title, clear screen, C1, bidi override, line separators, a bell: and a line of our own.
EVIL = '=evil\x1b[31m\x1b]0;t\x07\x1b[2J\x9b31m\u202e\u2028\r\nall is well\x00\x7f'
LONE = '\udc9b'                 # a byte that is no UTF-8, as Python has it in a name of a file
SECOND = 1_000_000_000


def is_safe(text):
    """Whether text holds ends of lines and no other control code, nor a line of others."""
    return all(map(str.isprintable, text.split('\n'))) and '\nall is well' not in text


def run(tool, *arguments):
    """Return the exit code and what a tool prints, colours left out."""
    done = forked.run(tool, *arguments)
    text = (done.stdout + done.stderr).decode()
    assert 'Traceback' not in text
    return done.returncode, re.sub('\033\\[[0-9;]*m', '', text)


def captured(bus):
    """Return the bytes of a capture: a bus that answers twice, then no more, and one of noise."""
    file = io.BytesIO()
    writer = Writer(file, ClockReading(1_790_000_000 * SECOND, SECOND))
    for number in range(40):
        data = encode(1, Instruction.READ, b'\x84\x00\x04\x00')
        if number < 2:
            data += encode(1, STATUS, bytes(5))
        noise = Random(number).randbytes(40)
        for name, part in ((f'{bus} answers', data), (f'{bus} noise', noise)):
            writer.write_chunk(Wire(name, 1_000_000, port=bus),
                        Chunk(SECOND + number * SECOND // 10, name, part))
    writer.remark('\x1b[5m a remark')
    return file.getvalue() + b'\x1b[5m no line\n'


@pytest.fixture
def capture(tmp_path):
    path = tmp_path / 'bus.txt'
    path.write_bytes(captured(EVIL))
    return str(path)


@pytest.mark.parametrize(('tool', 'arguments'), [
    (DUMP, []), (DUMP, ['--json']), (DUMP, ['--color', 'always', '--summary']),
    (DUMP, ['--stats', '--changes']), (DUMP, ['--devices', f'{EVIL}/1:MX-64']),
    (DOCTOR, []), (DOCTOR, ['--json']),
    (REPLAY, ['--bus', EVIL]), (REPLAY, ['--link', f'/nowhere/{EVIL[:-2]}'])])
def test_a_capture(capture, tool, arguments):
    arguments = [text.replace('\0', '') for text in arguments]
    assert is_safe(run(tool, capture, *arguments)[1])


def test_what_is_recorded_of_a_capture_is_safe(capture, tmp_path):
    run(DUMP, capture, '-w', str(tmp_path / 'again.txt'))
    assert is_safe((tmp_path / 'again.txt').read_text())
    assert '%1B' not in (tmp_path / 'again.txt').read_text()


def test_a_capture_that_is_played(capture, tmp_path):
    with Program(REPLAY, capture, '--speed', '0', '--link',
                 str(tmp_path / 'bus'), '--bus', printable(f'{EVIL} answers')) as player:
        player.wait_for('waiting for a reader')
        with suppress(OSError), open(tmp_path / 'bus', 'rb', buffering=0) as reader:
            while reader.read(4096):            # until it ends
                pass
        assert player.exit_code() == 0
        assert is_safe(player.text)
        assert '=evil' in player.text


@pytest.mark.parametrize('arguments', [[], ['--json']])
def test_a_report(tmp_path, arguments):
    """All that a person can read in it, and the names in its capture."""
    clean = tmp_path / 'bus.txt'
    clean.write_bytes(captured('bus'))
    made = tmp_path / 'report.txt'
    run(DOCTOR, str(clean), '--report', str(made))
    head, stored, _ = re.split('^# (?:verdict|capture)$', made.read_text(), flags=re.MULTILINE)

    def evil(value):
        if isinstance(value, dict):
            return {name: evil(part) for name, part in value.items()}
        if isinstance(value, list):
            return [evil(part) for part in value]
        return f'{value}{EVIL}{LONE}' if isinstance(value, str) else value

    stored = json.loads(stored)
    stored = {**evil(stored), 'protocol': 'auto', 'devices': [f'{EVIL}/1:MX-64']}
    made.write_text('\n'.join([head, issue_report.VERDICT, json.dumps(stored),
                               issue_report.CAPTURE,
                               *issue_report.packed(captured(EVIL)), issue_report.END]))
    code, text = run(DOCTOR, str(made), *arguments)
    assert code == 4
    assert is_safe(text)
    assert 'also shows wrong baud of bus =evil' in text


@pytest.mark.parametrize(('tool', 'arguments'), [
    (DUMP, ['{}']), (DUMP, ['--check-models', '{}']),
    (DUMP, ['-', '--model-dirs', '{}']), (DUMP, ['-', '-w', '{}/no/x']),
    (DOCTOR, ['{}']), (DOCTOR, ['--report', '{}/x', 'setup.py']),
    (DOCTOR, ['--explain', '{}']), (REPLAY, ['{}']),
    ('mecarover_dashboard.ros_server', ['--history', '{}/no/x', '--port', '0'])])
@pytest.mark.parametrize('exists', [True, False])
def test_a_name_of_a_file(tmp_path, tool, arguments, exists):
    name = str(tmp_path / EVIL.replace('\0', '')) + LONE
    if exists:
        os.mkdir(name)
        Path(name, f'{LONE}\x1b[5m.yaml').write_text('- "\\e[5m"')
        Path(name, 'no').touch()
    code, text = run(tool, *(text.format(name) for text in arguments))
    assert code in (1, 2)
    assert is_safe(text)


@pytest.fixture
def history(tmp_path):
    """Return the path of a history of others: each text in it is evil."""
    path = tmp_path / 'history.sqlite'
    writer = HistoryWriter(path)
    source = Subject('dxl_monitor: 001', 'devices', '', 'A')
    writer.write([Window(1000, source, 2, ((-1.0, 1.0),) * 6)],
                 [Event(1000.0, source, 'state', 2, 'text')])
    writer.close()
    database = sqlite3.connect(path)
    database.execute('UPDATE sources SET name = ?1, robot = ?1, unit = ?1', (EVIL,))
    database.execute('UPDATE events SET kind = ?1, text = ?1 || "; " || ?1', (EVIL,))
    database.commit()
    database.close()
    return path


@pytest.mark.parametrize('what', ['values', 'events'])
def test_a_history(history, what):
    with Dashboard(history=history) as dashboard:
        query = f'{dashboard.address}history/{what}?from=0&to=2000'
        with urlopen(f'{query}&format=csv', timeout=20) as answer:
            text = answer.read().decode().replace('\r\n', '\n')
        with urlopen(query, timeout=20) as answer:
            assert is_safe(answer.read().decode())
    assert is_safe(text)
    [_, row] = csv.reader(io.StringIO(text))
    assert sum("'=evil" in cell for cell in row) >= 3
    for cell in row:                # a formula begins a cell, or follows a semicolon in one
        for part in cell.split(';'):
            assert re.fullmatch(r'-?[\d.]*|[^=+@-].*', part.strip())


def test_a_topic():
    evil = EVIL.replace('\0', '')
    statuses = [Status(f'{evil}/dxl_monitor: 001 {evil}', Level.ERROR, evil, evil, [
        ('Model', evil), ('Firmware Version', '1'), ('State', 'connected'), (evil, evil),
        ('finding.no_answer', evil)])]
    with Dashboard() as dashboard:
        dashboard.take([(OVERVIEW, serialise(statuses))])
        with urlopen(f'{dashboard.address}events', timeout=20) as answer:
            seen = iter(lambda: answer.readline().decode(), '')
            line = next(line for line, _ in zip(seen, range(100), strict=False) if 'evil' in line)
        assert is_safe(line)
        with urlopen(f'{dashboard.address}metrics', timeout=20) as answer:
            text = answer.read().decode()
    assert '=evil' in text
    assert is_safe(text)


def test_the_name_of_a_port_of_a_tapped_program():
    name = EVIL.encode()
    records = b''.join(tap_sender.record(kind, 1, 0, data) for kind, data in (
        ('opened', name), ('out', b'x')))
    assert all(is_safe(one.port) for one in _Connection(None, '').records(records))


def test_a_process_or_an_adapter_at_a_port():
    error = PortError(EVIL, Reason('busy', f'in use by {EVIL}', f'ports here: {EVIL}'))
    assert is_safe(str(error))
    assert is_safe(error.reason + error.remedy)


@pytest.mark.parametrize(('text', 'shown'), [
    ('', ''), ('a\n', 'a\n'), ('a\nb', 'a\nb'), ('\033[1ma\033[m', '\033[1ma\033[m'),
    ('\033[Ha', '\ufffd[Ha'), ('a\rb\n', 'a\ufffdb\n'), ('\u202e\x9b\udc9b', 3 * '\ufffd')])
def test_what_a_tool_may_print(text, shown):
    assert plain(text) == shown
