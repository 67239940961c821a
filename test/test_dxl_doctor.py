# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_doctor: one screen, right exit codes, and a reason where nothing is heard."""

import bz2
from functools import cache
import gzip
import importlib.util
import io
from itertools import pairwise
import json
import lzma
import os
from pathlib import Path
import random
import re
import select
import signal
import socket
import subprocess
import sys
import textwrap
import zipfile

import forked
from harness import Program
from harness import wait
import pytest
import yaml

from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from msg_defs.uart import byte_ns
from msg_defs.uart import heard_at
import servobus
from servobus.bus.report import FAILED
from servobus.bus.report import RAISED
from servobus.bus.report import RATE_REFUSED
from servobus.doctor import RULES
from servobus.examination import Examination
from servobus.model.models import Models
from servobus.port.pty import Pty
from servobus.sources import silence_reasons
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer
from servobus.tools.doctor import computer_facts
from servobus.tools.doctor import explain
from servobus.tools.doctor import issue_report
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.error_window import ErrorWindow
from servobus.tools.doctor.program_source import Ending
from servobus.tools.doctor.verdict import DeviceGroup
from servobus.tools.doctor.verdict import ERROR
from servobus.tools.doctor.verdict import make_verdict
from servobus.tools.doctor.verdict import NOTHING_HEARD
from servobus.tools.doctor.verdict import OpenPoint
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import Verdict
from servobus.tools.doctor.verdict import WARNING
from servobus.tools.doctor.verdict import WELL

ROOT = Path(__file__).parents[1]
DOCTOR = 'servobus.tools.dxl_doctor'
MODELS = Models()
BAUD = 2_000_000
SECOND = 1_000_000_000
DEVICES = ('1-3:MX-106', '4:XL430-W250:left_knee', '5-9:XL430-W250')
WIRE = Wire('bus', BAUD)


@cache
def heard(*faults, seconds=6.0, devices=DEVICES, pattern='sync'):
    """Return a run on the simulated bus as chunks."""
    line = Line(make_devices(list(devices), MODELS, BAUD), BAUD, waits_in_line=False)
    master = Master(line, PATTERNS[pattern], rate=50, faults=[parse(text) for text in faults])
    return tuple(Chunk(SECOND + burst.end, 'bus', burst.data)
                 for burst in master.bursts(int(seconds * SECOND)) if burst.data)


def said(chunks, devices=DEVICES, is_timed=True, wire=WIRE):
    """Return what dxl_doctor says of chunks."""
    examination = Examination(MODELS, devices)
    for chunk in chunks:
        examination.feed_chunk(chunk, wire)
    examination.finish(examination.last, is_over=True)
    why = [] if examination.bytes else silence_reasons.of_file('bus.txt')
    return make_verdict('bus.txt', examination.buses(is_timed), examination.seconds, is_timed, why)


def capture(path, *faults, seconds=6.0):
    with path.open('wb') as file:
        writer = Writer(file, ClockReading(1_790_000_000 * SECOND, SECOND))
        for chunk in heard(*faults, seconds=seconds):
            writer.write_chunk(WIRE, Chunk(chunk.stamp, WIRE.name, chunk.data))
    return path


def doctor(*arguments, env=None, cwd=ROOT):
    """Run dxl_doctor where there is no terminal."""
    if 'run' not in arguments and env is None:
        return forked.run_text(DOCTOR, *arguments, cwd=cwd)
    return subprocess.run([sys.executable, '-m', DOCTOR, *map(str, arguments)], cwd=cwd,
                          timeout=60, capture_output=True, text=True, stdin=subprocess.DEVNULL,
                          env={**os.environ, 'PYTHONPATH': str(ROOT), **(env or {})})


def test_the_cause_its_device_by_name_and_what_to_do():
    found = said(heard('silent:4:2'))
    first = found.wrong[0]
    assert (found.code, first.rule, first.who) == (ERROR, 'no_answer', '004 left_knee, XL430-W250')
    assert 'check its power' in first.message
    assert re.match(r'seen from [34]\.\d s on; .*wait per request', first.evidence)


def test_a_recording_that_is_cut_accuses_none():
    chunks = heard(seconds=3.0)
    for end in range(len(chunks) - 30, len(chunks), 3):
        for left_of_the_last in (None, 5):
            cut = [*chunks[:end], chunks[end]._replace(data=chunks[end].data[:left_of_the_last])]
            assert said(cut).wrong == []


def test_what_is_over_is_told_as_over():
    found = said(heard('silent:4:1:2.5', seconds=9.0))
    told = {entry.rule: entry for entry in found.wrong}
    assert 'dropout' in told or 'rebooted' in told
    assert all('not since' in told[rule].evidence for rule in told if rule == 'no_answer')


def test_a_device_that_is_lost_for_a_moment_is_a_warning():
    found = said(heard('silent:4:2:0.5'))
    assert (found.code, [entry.rule for entry in found.wrong]) == (WARNING, ['dropout'])


def test_devices_with_the_same_trouble_are_told_together():
    found = said(heard('latched:7:1', 'latched:8:1', 'latched:9:1'))
    assert [(entry.rule, entry.who) for entry in found.wrong] == [('hardware_error', '007-009')]


def test_noise_between_packets_is_no_wrong_rate():
    noise = random.Random(1)
    chunks = []
    for one, other in pairwise(heard()):
        size = (other.stamp - one.stamp) * 160_000 // SECOND         # a bus is not faster
        chunks += one, Chunk((one.stamp + other.stamp) // 2, 'bus', noise.randbytes(size))
    assert 'wrong_baud' not in {entry.rule for entry in said(chunks, ()).wrong}


def test_a_remedy_names_what_a_person_types_here():
    slow = [Chunk(chunk.stamp, 'bus', heard_at(chunk.data, 2.0)) for chunk in heard()]
    found = said(slow, (), wire=Wire('bus', BAUD // 2))
    assert [entry.rule for entry in found.wrong] == ['wrong_baud']
    assert 'set -b to' in found.wrong[0].message
    unknown = said(heard(devices=('1-2',)), ())
    assert not any('`' in text for text in unknown.unknown)


def test_without_times_nothing_is_said_of_times():
    slow = Wire('bus', 57_600)
    at, at_once = SECOND, []
    for chunk in heard(seconds=3.0):
        at += int(len(chunk.data) * byte_ns(slow.baud))
        at_once.append(chunk._replace(stamp=at))
    assert 'bus_too_slow' in [entry.rule for entry in said(at_once, wire=slow).wrong]
    found = said(at_once, is_timed=False, wire=slow)
    assert found.wrong == []
    assert any('no exact times' in text for text in found.unknown)


def test_more_bytes_than_the_rate_can_carry_are_a_wrong_rate():
    """With -b too low; a burst behind a pause in delivery is none."""
    chunks = heard(seconds=5.0)
    size = sum(len(chunk.data) for chunk in chunks)
    for share, rules in ((1.1, set()), (1.3, {'wrong_baud'})):
        named = Wire('bus', int(size * 10 / share / 5.0))
        assert {entry.rule for entry in said(chunks, wire=named).wrong} & {'wrong_baud'} == rules
    [trouble] = said(chunks, wire=named).wrong
    assert trouble.message == f'more bytes than {named.baud} Bd can carry: the bus is faster; ' \
        'set -b to its rate'
    late = [chunk._replace(stamp=max(chunk.stamp, SECOND * 4)) for chunk in chunks]
    first = [chunks[0], *late[1:]]
    named = Wire('bus', int(size * 10 / 0.9 / 5.0))
    assert 'wrong_baud' not in {entry.rule for entry in said(first, wire=named).wrong}


FAULTS = ((), ('silent:4:2',), ('silent:4:2', 'latched:7:1'),
          ('noise::1', 'silent:4:1', 'latched:7:1', 'latched:8:1', 'latched:9:1'))


@pytest.mark.parametrize('faults', FAULTS, ids=lambda faults: str(len(faults)))
def test_it_is_one_screen(faults):
    found = said(heard(*faults))
    lines = screen(found)
    assert len(lines) < 24
    assert max(map(len, lines)) <= 80
    assert 'Heard, Dynamixel 2.0:' in lines
    assert len(found.wrong) >= (0, 1, 2, 3)[FAULTS.index(faults)]


def test_a_larger_terminal_has_room_for_the_evidence():
    found = said(heard('silent:4:2'))
    [small], [large] = ([line for line in lines if 'Evidence: ' in line]
                        for lines in (screen(found), screen(found, width=200, height=50)))
    assert len(small) < len(large) <= 99
    whole = textwrap.wrap(f'Evidence: {found.wrong[0].evidence}', 95)
    assert [line.strip() for line in screen(found, width=200, height=50)
            if line.strip() in whole] == whole


def test_a_hundred_devices_are_one_screen_too():
    devices = tuple(f'{number}:{"MX-106" if number % 2 else "MX-64"}' for number in range(1, 101))
    lines = screen(said(heard('silent:40:1', devices=devices, seconds=4.0), devices))
    assert len(lines) < 24
    assert any('040' in line for line in lines)
    shown = ' '.join(lines)
    assert all(f'{number:03}' in shown for number in range(1, 101))


def test_without_a_height_nothing_is_cut():
    """However many devices, findings and open points there are, and however long their texts."""
    text = 'a cause, and what to do about it; ' * 12
    found = Verdict(
        'bus.txt', (), tuple(DeviceGroup(f'{number:03}', f'model {number}', Level.OK)
                             for number in range(40)),
        tuple(Trouble(Level.ERROR, f'{number:03} arm ' * 20, 'no_answer', f'{text}{number}', text)
              for number in range(20)),
        (text,) * 5, (), cycles=(text,) * 5,
        not_sure=tuple(OpenPoint(f'{number:03} leg ' * 20, '', text, text)
                       for number in range(9)))
    lines = screen(found, height=None)
    assert max(map(len, lines)) <= 80
    assert not any('...' in line or '--full' in line for line in lines)
    shown = ' '.join(' '.join(lines).split())
    assert shown.count(text.strip()) == 20 * 2 + 5 + 5 + 9 * 2
    assert all(shown.count(f'{number:03} arm') == 20 for number in range(20))
    assert all(f'model {number} ' in shown for number in range(40))
    assert all(f'model {number} ' in ' '.join(screen(found)) + ' ' for number in range(40))


def test_it_is_whole_where_there_is_no_screen_and_on_one_with_full(tmp_path):
    path = capture(tmp_path / 'bus.txt', *FAULTS[-1])
    near, far = os.openpty()
    shown = []
    for more in ((), ('--full',)):
        forked.run(DOCTOR, path, *more, stdout=far,
                   env={**os.environ, 'LINES': '24', 'COLUMNS': '80', 'NO_COLOR': '1'})
        text = b''
        while select.select([near], [], [], 0)[0]:
            text += os.read(near, 4096)
        shown.append(text.decode().splitlines())
    os.close(near)
    os.close(far)
    cut, whole = shown
    assert len(cut) < 24 <= len(whole)
    assert whole == doctor(path).stdout.splitlines()

def test_a_file_to_the_screen_and_to_programs(tmp_path):
    path = capture(tmp_path / 'bus.txt', 'silent:4:2')
    done = doctor(path, '--devices', '4:XL430-W250:left_knee')
    assert (done.returncode, done.stderr) == (ERROR, '')
    assert '1 error, 004 left_knee, XL430-W250: no answer' in done.stdout
    assert '\033' not in done.stdout
    done = doctor(path, '--json')
    found = json.loads(done.stdout)
    assert (done.returncode, found['exit']) == (ERROR, ERROR)
    assert [(one['rule'], one['device']) for one in found['buses'][0]['findings']] \
        == [('no_answer', 4)]


def test_each_bus_has_its_own_ids(tmp_path):
    path = capture(tmp_path / 'bus.txt')
    entries = ['bus/4:XL430-W250:wrist', 'other/4:XL430-W250:elbow']
    done = doctor(path, *(word for entry in entries for word in ('--devices', entry)))
    assert done.returncode == WELL, done.stderr
    with servobus.listen(str(path), devices=entries) as bus:
        bus.run()
    assert {one.id: one.joint for one in bus.reports()[0].devices}[4] == 'wrist'
    refused = doctor(path, *('--devices', 'bus/4:XL430') * 2)
    assert (refused.returncode, 'ID 4 is given twice' in refused.stderr) == (2, True)


def test_the_begin_of_a_file_is_no_master_that_stopped(tmp_path):
    done = doctor(capture(tmp_path / 'bus.txt'), '--seconds', '2', '--json')
    found = json.loads(done.stdout)
    assert (done.returncode, found['wrong']) == (WELL, [])
    assert {device['state'] for device in found['buses'][0]['devices']} == {'connected'}


def parts(schema):
    """Yield all objects of a schema."""
    if isinstance(schema, dict):
        yield schema
    for one in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(one, dict | list):
            yield from parts(one)


@cache
def validator():
    """Return what checks an output of --json; a key that the schema does not name is an error."""
    jsonschema = pytest.importorskip('jsonschema', reason='skipped: no jsonschema here')
    schema = json.loads((ROOT / 'docs/dxl_doctor.schema.json').read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    for part in parts(schema):
        if 'properties' in part:
            part['additionalProperties'] = False
        kinds = part.get('type', ())
        assert bool(kinds) <= bool(part.get('description'))
        is_number = {'number', 'integer'} & {*([kinds] if isinstance(kinds, str) else kinds)}
        assert bool(is_number) == ('unit' in part), part
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize(('faults', 'code', 'key'), [
    ((), WELL, 'buses'), (FAULTS[-1], ERROR, 'buses'), (None, NOTHING_HEARD, 'nothing_heard')])
def test_the_schema_describes_an_answer(tmp_path, faults, code, key):
    path = tmp_path / 'bus.txt'
    if faults is None:
        path.write_bytes(b'')
    else:
        capture(path, *faults)
    done = doctor(path, '--json')
    found = json.loads(done.stdout)
    validator().validate(found)
    assert (done.returncode, found['exit'], bool(found[key])) == (code, code, True)


@pytest.mark.parametrize(('arguments', 'code'), [
    (['no_such_file.txt'], 1), (['/dev/ttyNone'], 1), (['serial://'], 1),
    (['README.md', '--flight-recorder', 'faults'], 2)])
def test_a_failure_is_json_too(arguments, code):
    done = doctor('--json', *arguments)
    failure = json.loads(done.stdout)
    validator().validate(failure)
    assert (done.returncode, failure['exit']) == (code, code)
    assert done.stderr == f"dxl_doctor: {failure['error']}\n"


def test_a_file_without_a_byte(tmp_path):
    path = tmp_path / 'empty.txt'
    path.write_bytes(b'')
    done = doctor(path)
    assert done.returncode == NOTHING_HEARD
    assert 'no byte of a bus' in ' '.join(done.stdout.split())


def test_a_port_that_is_lost_is_told_by_the_doctor(tmp_path):
    link = tmp_path / 'bus'
    with Pty(str(link)) as pty:
        pty.let_go()
        tool = Program(DOCTOR, str(link), '--baud', '1000000', '--seconds', '60')
        wait(tool.children)                     # its reader: the port is set up
    with tool:
        tool.wait_for(f'dxl_doctor: {link}: lost')
        tool.signal(signal.SIGTERM)


DIALOGUE = """
import os, sys, threading, time, tty
sys.path.insert(0, 'test')
import serial
from msg_defs.dxl_packet import encode, STATUS
from msg_defs.dxl_instruction import Instruction
far, near = os.openpty()
tty.setraw(near)
port = serial.Serial(os.ttyname(near), 1000000, timeout=0.02)
for turn in range(60):
    for servo in (1, 2):
        port.write(encode(servo, Instruction.READ, bytes([132, 0, 4, 0])))
        os.read(far, 100)
        if servo == 1:
            os.write(far, encode(1, STATUS, bytes(4), error=0))
        port.read(15)
print('done')
"""


@pytest.mark.smoke
@pytest.mark.realtime(bears=0.02)
def test_a_program_is_run_and_its_dead_servo_named(meeting_place, tmp_path):
    flights = tmp_path / 'faults'
    done = doctor('--flight-recorder', flights, 'run', '--', sys.executable, '-c', DIALOGUE,
                  env={'XDG_RUNTIME_DIR': meeting_place, 'PYTHONPATH': str(ROOT)})
    assert done.stdout.startswith('done\n')            # what it prints is left alone
    assert '1000000 baud' in done.stdout
    assert 'error, 002: no answer' in done.stdout
    assert done.returncode == ERROR
    [flight] = flights.glob('*.txt')
    assert f'flight recorder: wrote {flight}' in done.stderr
    assert 'error, 002: no answer' in doctor(flight).stdout
    refused = doctor('--flight-recorder', flights, flight)
    assert refused.returncode == 2 and 'is a recording already; leave it out' in refused.stderr


RAISES = """
import os, tty
import serial
from msg_defs.dxl1_packet import encode
far, near = os.openpty()
tty.setraw(near)
port = serial.Serial(os.ttyname(near), 1000000, timeout=0.06)
print('begins')
for servo in (1, 2):
    port.write(encode(servo, 1, b''))
    os.read(far, 100)
    if servo == 1:
        os.write(far, encode(1, 0, b''))
    port.read(6)
try:
    raise {error}
finally:
    port.close()
"""


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize(('error', 'code', 'rules'), [
    ("ConnectionError('motor check failed on port x: Missing motor IDs:')", ERROR, ['no_answer']),
    ('SystemExit(1)', ERROR, ['no_answer']),
    ('KeyboardInterrupt', WELL, []),
])
def test_a_program_that_ends_on_a_question(error, code, rules, meeting_place):
    """It is judged where the program ended by itself; its exception is shown and explained."""
    done = doctor('--json', 'run', '--', sys.executable, '-c', RAISES.format(error=error),
                  env={'XDG_RUNTIME_DIR': meeting_place, 'PYTHONPATH': str(ROOT)})
    found = json.loads(done.stdout)                    # what the program prints is not there
    validator().validate(found)
    assert 'begins' in done.stderr
    assert [one['rule'] for one in found['buses'][0]['findings']] == rules
    assert (done.returncode, found['program']['exit'] != 0) == (code, True)
    assert found['program']['error'].startswith('ConnectionError: motor') == ('motor' in error)
    assert bool(rules) != any('is unknown' in text for text in found['cannot_tell'])


LASTS = """
import serial
port = serial.Serial({!r}, 1000000, timeout=0.01)
for _ in range(20):
    port.write(bytes((255, 255, 1, 2, 1, 251)))
    port.read(6)
input()
"""


ASKS_ON = """
import select
import sys
import serial
port = serial.Serial({!r}, 1000000, timeout=0.01)
while not select.select([sys.stdin], [], [], 0)[0]:
    port.write(bytes((255, 255, 1, 2, 1, 251)))
    port.read(6)
"""


@pytest.mark.parametrize(('fault', 'shown', 'denied'), [
    ('silent:4:2', 'XL430-W250, firmware 48: no valid answer', 'disconnected'),
    ('factory_id:4', 'several servos answer as 001', 'packets overlap'),
    ('no_ack:4', 'Advice, no error:', 'Wrong:')])
def test_no_part_of_a_screen_denies_another(fault, shown, denied):
    chunks = heard(fault, devices=('1-6:XL430-W250',), pattern='moving')
    text = '\n'.join(screen(said(chunks, devices=()), height=None))
    assert (shown in text, denied in text) == (True, False)


def test_what_is_said_meanwhile_has_been_so_for_a_while():
    """After the first packets a cause looks like another one, and a program runs for hours."""
    examination = Examination(MODELS, DEVICES)
    told = []
    for chunk in heard('silent:4:2'):
        examination.feed_chunk(chunk, WIRE)
        told.append((examination.seconds, examination.worst()))
    first_s, text = next((at, text) for at, text in told if text)
    [lost] = examination.buses(True)[0].logged
    assert lost.first_s + 2.0 <= first_s < lost.first_s + 2.6
    assert text.startswith('004: no answer')


@pytest.mark.realtime(bears=0.02)
def test_the_first_finding_comes_while_the_program_runs(meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty, subprocess.Popen(
            [sys.executable, '-m', DOCTOR, 'run', '--', sys.executable, '-c',
             ASKS_ON.format(pty.path)],
            env={**os.environ, 'XDG_RUNTIME_DIR': meeting_place}, cwd=ROOT, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as tool:
        first = next(line for line in tool.stderr if 'no answer' in line)
        assert first.startswith('dxl_doctor: 001: no answer: ')
        assert tool.poll() is None
        answer, more = tool.communicate('\n', timeout=60)
    assert 'no answer' not in more and '\033' not in first + more
    assert 'error, 001: no answer' in answer


def test_a_port_that_another_program_reads_is_left_to_it(tmp_path):
    """Each byte comes to one of two readers: the arm would lose its answers, and fall."""
    with Pty(str(tmp_path / 'bus')) as pty, subprocess.Popen(
            [sys.executable, '-c', f"port = open({pty.path!r}, 'rb'); print(); input()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        program.stdout.readline()
        refused = doctor(pty.path, '--seconds', '1')
        program.communicate('\n')
    assert (refused.returncode, refused.stderr.count('\n')) == (1, 1)
    assert f'(pid {program.pid}); stop that program, or hear what it does with' in refused.stderr


@pytest.mark.realtime(bears=0.02)
def test_a_stop_hides_no_error_that_was_there_before(meeting_place, tmp_path):
    """People press Ctrl-C where a program has crashed and takes its time to end."""
    with Pty(str(tmp_path / 'bus')) as pty:
        script = LASTS.format(pty.path).replace('input()', """
import atexit, time
def leave():
    print('leaves', flush=True)
    time.sleep(60)
atexit.register(leave)
raise ConnectionError('[TxRxResult] There is no status packet!')""")
        with subprocess.Popen(
                [sys.executable, '-m', DOCTOR, 'run', '--', sys.executable, '-c', script],
                env={**os.environ, 'XDG_RUNTIME_DIR': meeting_place}, cwd=ROOT, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as tool:
            next(line for line in tool.stdout if 'leaves' in line)
            os.killpg(tool.pid, signal.SIGINT)
            answer, _ = tool.communicate(timeout=60)
    assert 'it ended with ConnectionError' in ' '.join(answer.split())


@pytest.mark.realtime(bears=0.02)
def test_it_answers_in_time_while_the_program_goes_on(meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty, subprocess.Popen(
            [sys.executable, '-m', 'servobus.tools.dxl_doctor', '--json', '--seconds', '3',
             'run', '--', sys.executable, '-c', LASTS.format(pty.path)],
            env={**os.environ, 'XDG_RUNTIME_DIR': meeting_place}, cwd=ROOT, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as tool:
        answer = json.loads(tool.stdout.readline())
        assert [one['rule'] for one in answer['buses'][0]['findings']] == ['no_answer']
        assert tool.poll() is None
        _, said = tool.communicate('\n', timeout=60)
    assert 'the program goes on and is no longer heard; Ctrl-C ends it' in said
    assert tool.returncode == ERROR
    assert 'uses its port too' not in str(answer)


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize('name', ['SEGV', 'KILL'])
def test_a_program_that_a_signal_ended_is_not_called_well(meeting_place, tmp_path, name):
    with Pty(str(tmp_path / 'bus')) as pty:
        script = LASTS.format(pty.path).replace(
            'input()', f'import os, signal; os.kill(os.getpid(), signal.SIG{name})')
        done = doctor('--json', 'run', '--', sys.executable, '-c', script,
                      env={'XDG_RUNTIME_DIR': meeting_place})
    said = json.loads(done.stdout)
    words = signal.strsignal(getattr(signal, f'SIG{name}'))
    assert f'the program was ended by a signal: {words}' in said['cannot_tell']
    assert said['program']['exit'] == 128 + getattr(signal, f'SIG{name}')


TWO_THREADS = """
import contextlib, serial, threading
port = serial.Serial({path!r}, 1000000, timeout=0.5)
start = threading.Barrier(2)
lock = {lock}
def ask():
    start.wait()
    with lock:
        port.write(bytes((255, 255, 1, 2, 1, 251)))
        if len(port.read(6)) < 6:
            raise serial.SerialException('no answer')
threads = [threading.Thread(target=ask) for _ in range(2)]
for one in threads: one.start()
for one in threads: one.join()
{close}"""


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize(('lock', 'are_rivals'), [
    ('contextlib.nullcontext()', True), ('threading.Lock()', False)])
def test_two_threads_that_read_at_once_are_named(lock, are_rivals, meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty:
        done = doctor('--json', 'run', '--', sys.executable, '-c', TWO_THREADS.format(
            path=pty.path, lock=lock, close=''), env={'XDG_RUNTIME_DIR': meeting_place})
    found = json.loads(done.stdout)
    assert ('two_masters' in [one['rule'] for one in found['buses'][0]['findings']]) == are_rivals
    assert found['program'] == {'exit': 0, 'error': 'SerialException: no answer'}


READS_ON = """import serial, threading
port = serial.Serial({path!r}, timeout=0)
go = threading.Event()
def read():
    go.wait()
    {act}
thread = threading.Thread(target=read)
thread.start()
{close}
go.set()
thread.join()"""


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize(('act', 'close', 'is_named'), [
    ('raise serial.SerialException("read failed: gone")', '', True),
    ('port.read()', 'port.close()', False), ('raise ValueError("no picture")', '', False)],
    ids=['its port fails', 'closed at the end', 'another cause'])
def test_a_thread_that_its_port_ends_is_named(act, close, is_named, meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty:
        script = READS_ON.format(path=pty.path, act=act, close=close).replace(
            'go = ', 'port.write(bytes((255, 255, 1, 2, 1, 251)))\ngo = ')
        done = doctor('run', '--', sys.executable, '-c', script,
                      env={'XDG_RUNTIME_DIR': meeting_place})
    assert ('a thread of it ended with' in ' '.join(done.stdout.split())) == is_named


SHARES = """import serial; serial.Serial({!r}).write(bytes((255, 255, 1, 2, 1, 251)))
raise serial.SerialException('returned no data (disconnected or multiple access on port?)')"""


@pytest.mark.realtime(bears=0.02)
def test_another_program_on_its_port_is_named(meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty, open(pty.path) as near, \
            subprocess.Popen(('sleep', '60'), stdin=near) as other:
        done = doctor('run', '--', sys.executable, '-c', SHARES.format(pty.path),
                      env={'XDG_RUNTIME_DIR': meeting_place, 'PYTHONPATH': str(ROOT)})
        other.kill()
    assert f'sleep (pid {other.pid}) uses its port too' in ' '.join(done.stdout.split())


WAITS_IN_VAIN = """import os, serial, subprocess, time
port = serial.Serial({path!r}, timeout=0.05)
other = {other} or subprocess.Popen(('sleep', '60'), stdin=port.fileno()).pid
for _ in range(4):
    port.write(bytes((255, 255, 1, 2, 1, 251)))
    port.read(6)
time.sleep(1.5)
os.kill(other, 9)
time.sleep(0.3)"""


@pytest.mark.realtime(bears=0.1)
@pytest.mark.parametrize('is_own', [False, True])
def test_another_program_that_is_gone_at_the_end_is_named(is_own, meeting_place, tmp_path):
    with Pty(str(tmp_path / 'bus')) as pty, open(pty.path) as near, \
            subprocess.Popen(('sleep', '60'), stdin=None if is_own else near) as other:
        near.close()
        done = doctor('run', '--', sys.executable, '-c', WAITS_IN_VAIN.format(
            path=pty.path, other=0 if is_own else other.pid),
            env={'XDG_RUNTIME_DIR': meeting_place, 'PYTHONPATH': str(ROOT)})
        other.kill()
    assert ('uses its port too' in ' '.join(done.stdout.split())) != is_own


@pytest.mark.realtime(bears=0.02)
@pytest.mark.parametrize(('options', 'script', 'words'), [
    (('no_such.py',), '', 'ended with exit code 2: there is no file no_such.py in this folder'),
    ((), 'raise SystemExit(7)', 'ended with exit code 7. - The output of the program says why'),
    ((), 'raise SystemExit(-1)', 'ended with exit code 255. - The output of the program says why'),
    ((), 'import os; os.abort()', 'ended by a signal (Aborted). - The output of the program'),
    ((), 'raise OSError("[Errno 2] could not open port /dev/ttyNONE0: it")',
     '/dev/ttyNONE0: is not there; plug it in or set another port'),
    ((), 'raise OSError("\\nCould not connect on port \'/dev/ttyNONE0\'. Make sure you")',
     '/dev/ttyNONE0: is not there; plug it in or set another port'),
    ((), 'raise PermissionError(13, "Permission denied", "/dev/ttyNONE0")',
     'may not open it; check its owner and mode'),
    ((), 'import no_such_package', 'lacks that package. Name the Python of your program'),
    (('-I',), 'pass', 'did not load the tap: it is not Python, or PYTHONPATH did not reach it'),
])
def test_a_program_that_opens_no_port(options, script, words, meeting_place):
    done = doctor('run', '--', sys.executable, *options, '-c', script,
                  env={'XDG_RUNTIME_DIR': meeting_place})
    assert done.returncode == NOTHING_HEARD
    assert words in ' '.join(done.stdout.split())


def test_every_finding_of_an_error_text_is_a_rule():
    named = {name for one in explain.explanations() for name in one.findings}
    assert named - {rule.name for rule in RULES} == set()


def sdk_texts():
    """Return what the two official packages print of a result and of an error byte."""
    for package in ('dynamixel_sdk', 'scservo_sdk'):
        folder = Path(importlib.util.find_spec(package).origin).parent
        for file in folder.glob('*packet_handler.py'):
            yield from re.findall(r'"(\[(?:TxRxResult|RxPacketError)\] [^"]*)"', file.read_text())


def test_what_the_official_packages_print_is_known():
    known = {text for one in explain.explanations() for text in (one.text, *one.also)}
    texts = set(sdk_texts())
    assert len(texts) > 20
    assert {text for text in texts - known if not re.search(
        'success|Now receiving|Failed get status|Unknown error', text)} == set()


@pytest.mark.parametrize(('pasted', 'first'), yaml.safe_load(
    Path(__file__).with_name('pasted_lines.yaml').read_text(encoding='utf-8')))
def test_a_pasted_line_is_explained(pasted, first):
    assert explain.find(pasted)[0].text == first


@pytest.mark.parametrize('pasted', [
    'goal -1000', 'Goal Position: -2000', '-1000 steps', 'encode -1001', 'result: -30011',
    'commanded position -1000', 'command: -1000', 'position error: -3001', 'arc -1000',
    'err code: 30', 'dxl_error: 128', '[ERROR] [1736189997.648767720]: no such file'])
def test_a_number_is_no_return_code_because_a_code_has_its_digits(pasted):
    assert explain.find(pasted) == []


def test_an_error_that_any_program_may_raise_is_not_one_of_the_bus():
    error = 'IndexError: list index out of range'
    assert Ending(code=1, error=error).failed == FAILED
    of_sdk = Ending(code=1, error=error, packages=frozenset({'dynamixel_sdk'}))
    assert of_sdk._replace(function='read4ByteTxRx').failed == RAISED
    assert of_sdk._replace(function='makeParam').failed == FAILED    # its own parameters


@pytest.mark.parametrize(('error', 'failed'), [
    ("error: (22, 'Invalid argument')", RATE_REFUSED),
    ('ValueError: Failed to set custom baud rate (250000): [Errno 22]', RATE_REFUSED),
    ('ValueError: Invalid baud rate: 250000', RATE_REFUSED),
    ("error: (5, 'Input/output error')", RAISED),
    ("OSError: [Errno 22] Invalid argument: 'log.txt'", FAILED),
    ('ValueError: invalid literal', FAILED)])
def test_a_rate_that_the_driver_refuses_is_told_from_other_errors(error, failed):
    packages = frozenset({'serial'} if failed is RAISED else ())
    assert Ending(code=1, error=error, packages=packages).failed == failed


def test_where_another_may_have_read_the_answers_the_end_says_nothing_of_the_bus():
    ending = Ending(code=1, error='[TxRxResult] There is no status packet!')
    assert (ending.failed, ending.failed_alone) == (RAISED, RAISED)
    ending = ending._replace(users=('minicom (pid 7)',))
    assert (ending.failed, ending.failed_alone) == (RAISED, '')


def test_a_text_that_is_not_known_is_one_line():
    assert explain.find('assertion failed') == []
    done = doctor('--explain', 'assertion failed')
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (1, '', 1)
    done = doctor('--explain', 'Ther is not status paket')
    assert 'did you mean "[TxRxResult] There is no status packet!"' in done.stderr


def test_what_explain_prints():
    text = explain.in_words(explain.find('[RxPacketError] Overload error!'))
    assert 'hardware error' in text
    whole = explain.in_words(explain.explanations())
    assert '{}' not in whole
    assert '  Possible causes, the likeliest first: .' not in whole
    assert max(map(len, text.splitlines())) <= 80


@pytest.fixture
def reported(tmp_path):
    """Return the path of a report of a sick bus, and what was shown when it was made."""
    secret = tmp_path / 'secret-user'
    secret.mkdir()
    path = tmp_path / 'report.txt'
    done = doctor(capture(secret / 'secret-bus.txt', 'silent:4:2'), '--report', path,
                  '--devices', '4:XL430-W250:left_knee')
    assert done.returncode == ERROR
    return path, done.stdout


def findings(text):
    return [line for line in text.splitlines() if re.match(r'  \d (error|warning|advice), ', line)]


def test_a_report_says_the_same_again(reported):
    path, shown = reported
    again = doctor(path)
    assert (again.returncode, again.stderr) == (ERROR, '')
    assert findings(again.stdout) == findings(shown) != []
    assert json.loads(doctor(path, '--json').stdout)['exit'] == ERROR


def test_the_capture_of_a_report_says_it_too(reported):
    path, shown = reported
    text = re.sub(r'(?m)^\{"verdict".*$', '{"verdict', path.read_text())
    path.write_text(text)
    again = doctor(path)
    assert again.returncode == ERROR
    assert findings(again.stdout) == [line.replace(' left_knee', '') for line in findings(shown)]
    assert 'this one is from the capture' in again.stderr


@pytest.mark.parametrize('left_out, said', [(False, ''), (True, (
    'dxl_doctor: read by this version, its capture also shows no answer of 005, XL430-W250\n'))])
def test_only_what_the_report_lacks_is_told_of_its_capture(tmp_path, left_out, said):
    path = tmp_path / 'report.txt'
    doctor('--report', path, capture(tmp_path / 'bus.txt', 'silent:4:2', 'silent:5:2'))
    head, line = re.match(r'(?s)(.*\n)(\{"verdict".*)', path.read_text()).groups()
    line, rest = line.split('\n', 1)
    stored = json.loads(line)
    stored['verdict']['wrong'] = []    # rounded otherwise, the screen may put others together
    if left_out:
        told = stored['json']['buses'][0]['findings']
        told[:] = [finding for finding in told if finding['device'] != 5]
    path.write_text(head + json.dumps(stored) + '\n' + rest)
    assert doctor(path).stderr == said


def test_a_report_says_nothing_of_its_maker(reported):
    path, _ = reported
    readable, packed_part = path.read_text().split(issue_report.CAPTURE)
    assert len(packed_part) > 1000
    stored = issue_report.load_report(str(path))
    text = readable + repr(stored.chunks) + repr(stored.wires)
    assert 'left_knee' in text
    for secret in ('secret', str(path.parent), socket.gethostname(), os.path.expanduser('~')):
        assert secret not in text, secret


BY_ID = '/dev/serial/by-id/usb-FTDI_USB__-__Serial_Converter_FT4THVAB-if00-port0'


@pytest.mark.parametrize('port, name', [
    ('/dev/ttyUSB0', 'ttyUSB0'), ('/dev/ttyAMA10', 'ttyAMA10'), ('/dev/ttymxc2', 'ttymxc2'),
    ('/dev/pts/3', 'pts/3'), ('COM3', 'COM3'), (BY_ID, 'a port'), ('/dev/FT4THVAB', 'a port'),
    ('/dev/cu.usbserial-FT4THVAB', 'a port'), ('/dev/ttyFT4THVAB', 'a port')])
def test_the_name_of_a_port_in_a_report_has_no_serial_number(port, name):
    assert computer_facts.plain_name(port, False) == name
    assert computer_facts.plain_name(f'usb:{port}', False) == f'usb:{name}'
    assert computer_facts.adapters([port], False)[0].startswith(f'{name}: ')


def test_a_report_names_the_port_that_a_link_leads_to(tmp_path, monkeypatch):
    link = tmp_path / 'usb-FTDI_FT4THVAB'
    link.symlink_to('/dev/pts/3')
    monkeypatch.setattr(computer_facts, 'port_of', lambda source: source)      # as if below /dev
    assert computer_facts.plain_name(str(link), False) == 'pts/3'
    link.unlink()
    assert computer_facts.plain_name(str(link), False) == 'a port'


def test_the_devices_of_a_report_are_of_its_buses(tmp_path):
    path = tmp_path / 'report.txt'
    entries = ['bus/4:XL430-W250:wrist', 'usb-A1B2C3/4:XL430-W250', '5:XL430-W250']
    doctor('--report', path, capture(tmp_path / 'bus.txt'),
           *(word for entry in entries for word in ('--devices', entry)))
    assert issue_report.load_report(str(path)).devices == [
        'bus1/4:XL430-W250:wrist', '5:XL430-W250']


@pytest.mark.parametrize(('text', 'plain'), [
    (f"Could not connect on port '{BY_ID}'.", "Could not connect on port 'a port'."),
    ('[Errno 2] could not open port /dev/ttyUSB0: [Errno 2]',
     '[Errno 2] could not open port ttyUSB0: [Errno 2]'),
    ("No such file: '/home/me/my arm/follower.json'", "No such file: 'a path'"),
    (r'C:\Users\me\arm.py: no', 'a path: no'), ('see ~/arm/a.log.', 'see a path.'),
    ("pos/speed/load, 1/fps: b'\\xff\\xfd'", "pos/speed/load, 1/fps: b'\\xff\\xfd'"),
    (f'on {socket.gethostname()}', 'on ...')])
def test_the_error_of_a_program_in_a_report_names_nobody(text, plain):
    assert computer_facts.plain_text(text) == plain


@pytest.mark.realtime(bears=0.02)
def test_a_report_has_the_error_of_the_program(meeting_place, tmp_path):
    path = tmp_path / 'report.txt'
    error = "ConnectionError('motor check failed on port /home/me/bus: Missing motor IDs:')"
    doctor('--report', path, 'run', '--', sys.executable, '-c', RAISES.format(error=error),
           env={'XDG_RUNTIME_DIR': meeting_place, 'PYTHONPATH': str(ROOT)})
    assert 'error of the program: ConnectionError: motor check failed on port a path: Missing ' \
        'motor IDs:\n' in path.read_text()


def test_with_host_it_does(tmp_path):
    path = tmp_path / 'report.txt'
    doctor('--report', path, '--with-host', capture(tmp_path / 'my-bus.txt'))
    assert 'my-bus.txt' in path.read_text()
    assert socket.gethostname() in path.read_text()


PACKERS = {'gz': gzip.compress, 'bz2': bz2.compress, 'xz': lzma.compress}


@pytest.mark.parametrize('packer', PACKERS)
def test_a_packed_report_is_read(reported, packer):
    path, shown = reported
    path.write_bytes(PACKERS[packer](path.read_bytes()))
    again = screen(issue_report.load_report(str(path)).verdict)
    assert findings('\n'.join(again)) == findings(shown)


def test_a_report_in_a_zip_is_read(reported, tmp_path):
    path, _ = reported
    with zipfile.ZipFile(tmp_path / 'report.zip', 'w') as file:
        file.write(path, 'report.txt')
    assert issue_report.load_report(str(tmp_path / 'report.zip')).verdict.code == ERROR


def test_no_damage_to_a_report_raises(reported, tmp_path):
    path, _ = reported
    data = path.read_bytes()
    chance = random.Random(23)
    broken = tmp_path / 'broken'
    for turn in range(60):
        wrong = bytearray(data[:chance.randrange(len(data))] if turn % 3 == 0 else data)
        for _ in range(turn % 5):
            at = chance.randrange(len(wrong) + 1)
            wrong[at:at + chance.randrange(40)] = chance.randbytes(chance.randrange(40))
        broken.write_bytes(gzip.compress(wrong)[:-turn] if turn % 4 == 1 else wrong)
        stored = issue_report.load_report(str(broken))
        if stored is not None and stored.verdict is not None:
            screen(stored.verdict)


def test_a_cut_report_is_told_as_cut(reported):
    path, shown = reported
    path.write_bytes(path.read_bytes()[:-200])
    again = doctor(path)
    assert findings(again.stdout) == findings(shown)
    assert 'cut off' in again.stderr


def test_a_report_overwrites_no_other_file(tmp_path):
    mine = tmp_path / 'thesis.txt'
    mine.write_text('years of work')
    done = doctor('--report', mine, capture(tmp_path / 'bus.txt'))
    assert (done.returncode, mine.read_text()) == (2, 'years of work')
    assert 'is not a report' in done.stderr


def test_a_report_gives_back_all_that_was_said(tmp_path):
    whole = said(heard('silent:4:2'))._replace(cycles=['50 Hz', 'a wait'], quiet=['no power'])
    (tmp_path / 'report').write_text(issue_report.make_report(whole, [], 1.0, [], [], 'auto', b''))
    assert issue_report.load_report(str(tmp_path / 'report')).verdict == whole


def test_a_chunk_larger_than_a_report_is_left_out():
    window = ErrorWindow()
    window.record_chunk(WIRE, Chunk(1, 'bus', bytes(2_000_000)))
    window.record_chunk(WIRE, Chunk(2, 'bus', b'\1'))
    assert [one.data for one in Reader(io.BytesIO(window.capture({})))] == [b'\1']


def test_a_file_called_run_is_no_source(tmp_path):
    (tmp_path / 'run').write_text('# dxl_doctor report 1\n')
    done = doctor('--flight-recorder', tmp_path / 'faults', 'run', '--', sys.executable, '-c', '',
                  cwd=tmp_path)
    assert done.returncode == NOTHING_HEARD
    assert 'flight recorder: ready' in done.stderr


def test_a_report_is_bounded():
    window = ErrorWindow()
    for number in range(3000):
        window.record_chunk(WIRE, Chunk(1 + number * SECOND // 100, 'bus', bytes(1000)))
    kept = list(Reader(io.BytesIO(window.capture({}))))
    assert sum(len(chunk.data) for chunk in kept) <= 1_500_000
    assert kept[-1].stamp == 1 + 2999 * SECOND // 100
    window = ErrorWindow()
    for number in range(900):
        window.record_chunk(WIRE, Chunk(1 + number * SECOND // 10, 'bus', bytes(1)))
        if number == 400:
            window.first_error = 40 * SECOND
    kept = list(Reader(io.BytesIO(window.capture({}))))
    assert 24 * SECOND < kept[0].stamp < kept[-1].stamp < 56 * SECOND
