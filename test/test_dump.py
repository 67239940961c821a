# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_dump: what it lists, counts, shows, filters and records; and how it ends."""
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import fcntl
import json
import os
from pathlib import Path
import random
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
import time

import forked
from harness import DEADLINE_S
from harness import Program
from harness import shown_on
from harness import wait
from packets import packets_in
from packets import packets_left
import pytest

from benchmark import traffic
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.faults import parse
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from msg_defs import dxl1_packet
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Chunk
from servobus.model.models import Models
from servobus.port.pty import Pty
from servobus.sources.capture import ClockReading
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.capture import Writer

DUMP, FAKE_BUS = 'servobus.tools.dxl_dump', 'mecarover_fakes.fake_bus'
ROOT = Path(__file__).parents[1]
MODELS = Models()
BAUD = 2_000_000
SECOND = 1_000_000_000
DEVICES = ('1-3:MX-106', '4:XL430-W250')
COUNTERS = ('bytes', 'packets', 'repaired', 'noise_bytes')
DAMAGED = ('crc_errors', 'truncated', 'bad_length')
CHUNKS = (1, 37, 4096)


def bursts(*faults, pattern='mixed', seconds=1.0):
    """Return a generated run as (bytes, stamp)."""
    line = Line(make_devices(DEVICES, MODELS, BAUD), BAUD)
    master = Master(line, PATTERNS[pattern], rate=50, faults=[parse(text) for text in faults])
    return [(burst.data, SECOND + burst.end) for burst in master.bursts(int(seconds * SECOND))]


def trickle(file, data, size):
    """Write in chunks, until the reader is gone."""
    with suppress(BrokenPipeError), file:
        for at in range(0, len(data), size):
            file.write(data[at:at + size])
            file.flush()


def dump(*arguments, feed=b'', chunk=None, code=0, binary=False):
    """Run dxl_dump on what is fed to its stdin, return stdout."""
    its_end, ours = os.pipe()
    feeder = threading.Thread(
        target=trickle, args=(open(ours, 'wb'), feed, chunk or len(feed) + 1))      # noqa: SIM115
    feeder.start()
    with open(its_end, 'rb') as stdin:
        done = forked.run(DUMP, *arguments, stdin=stdin)
    feeder.join()
    assert done.returncode == code, done.stderr.decode()
    assert b'Traceback' not in done.stderr
    return done.stdout if binary else done.stderr.decode() if code else done.stdout.decode()


def objects(*arguments, **options):
    return [json.loads(line) for line in dump(*arguments, '--json', **options).splitlines()]


def capture(path, chunks, bus='bus'):
    with open(path, 'wb') as file:
        writer = Writer(file, ClockReading(1_790_000_000 * SECOND, SECOND))
        for data, stamp in chunks:
            writer.write_chunk(Wire(bus, BAUD), Chunk(stamp, bus, data))
    return path


@pytest.fixture(scope='module')
def run():
    return bursts('silent:2:0.4:0.3', 'flip:3:0.6:0.2', 'wrong_map:1:0.2:0.2')


@pytest.fixture
def recorded(tmp_path, run):
    return capture(tmp_path / 'bus.txt', run)


@pytest.fixture
def raw(tmp_path, run):
    path = tmp_path / 'bus.bin'
    path.write_bytes(b''.join(data for data, _ in run))
    return path


# --- the list of packets --------------------------------------------------------------------

def packets(data):
    """Return what the framer finds, in the terms of --json."""
    framer = Framer()
    found = packets_in(framer, data, 0) + packets_left(framer)
    return framer, [(one.offset, one.id, one.instruction, one.error, one.params.hex(),
                     one.repaired) for one in found]


def first_ids(found):
    return [(one['offset'], one['id'], one['code'], one['error'], one['params'],
             one['repaired']) for one in found]


@pytest.mark.parametrize('seed', [1, 2])
def test_json_lists_the_same_packets_whatever_the_chunks(raw, seed):
    data = bytearray(raw.read_bytes())
    rng = random.Random(seed)
    for _ in range(20):                # damage of every kind
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        del data[(at := rng.randrange(len(data))):at + rng.randrange(5)]
    texts = {dump('-', '--json', '--summary', feed=bytes(data), chunk=size) for size in CHUNKS}
    assert len(texts) == 1
    *found, counts = map(json.loads, texts.pop().splitlines())
    framer, expected = packets(bytes(data))
    assert first_ids(found) == expected
    assert {name: counts[name] for name in COUNTERS} \
        == {name: getattr(framer, name) for name in COUNTERS}
    assert [counts[name] for name in DAMAGED] == [*framer.damaged.values()]
    assert [one['stamp'] for one in found] == sorted(one['stamp'] for one in found)


def test_a_capture_and_its_bytes_list_the_same_packets(recorded, raw):
    timed, bare = objects(recorded), objects(raw)
    assert first_ids(timed) == first_ids(bare)
    assert timed[0]['stamp'] == pytest.approx(1_790_000_000, abs=1)
    assert {one['bus'] for one in timed} == {'bus'}


def test_what_is_decoded():
    goal = struct.pack('<i', 3072)
    data = b''.join([
        encode(BROADCAST, I.PING), encode(1, STATUS, b'\x41\x01\x2a', error=0),
        encode(1, I.WRITE, b'\x74\x00' + goal), encode(1, STATUS, error=0),
        encode(1, I.READ, b'\x74\x00\x04\x00'), encode(1, STATUS, goal, error=0x80),
        encode(1, I.WRITE, b'\x07\x00\x05'), encode(1, STATUS, error=7),
        encode(9, I.READ, b'\x00\x00\x02\x00'), encode(1, 0x8B, b'\x01'),
    ])
    (ping, pong, write, ack, read, answer, _, refusal, _, foreign) = objects('-', feed=data)
    assert (ping['instruction'], ping['error'], ping['model']) == ('Ping', None, None)
    assert pong['identity'] == {'model_number': 321, 'model_name': 'MX-106', 'firmware': 42}
    assert (write['model'], write['registers']) == ('MX-106', [
        {'id': 1, 'address': 116, 'length': 4, 'data': '000c0000',
         'values': {'Goal Position (rad)': 1.570796327}}])
    assert (ack['answer_to'], ack['error'], ack['params']) == ('Write', 0, '')
    assert read['registers'] == [
        {'id': 1, 'address': 116, 'length': 4, 'names': ['Goal Position']}]
    assert answer['registers'] == write['registers']
    assert (answer['error'], answer['error_text']) \
        == (0x80, 'alert: see Hardware Error Status')
    assert refusal['error_text'].startswith('Access error: ')
    assert (foreign['code'], foreign['instruction']) == (0x8B, 'instruction 0x8B')


def mapped(number, *targets):
    """Return a write of indirect addresses, acknowledged."""
    where = struct.pack(f'<{1 + len(targets)}H', 168, *targets)
    return encode(number, I.WRITE, where) + encode(number, STATUS, error=0)


POSITION, TORQUE_AND_LED = (132, 133, 134, 135), (64, 65, 300, 301)
BOTH = struct.pack('<HH', 224, 4)          # indirect data of these


@pytest.mark.parametrize(('instruction', 'params'), [
    (I.SYNC_READ, BOTH + bytes((1, 2, 3))),
    (I.BULK_READ, b''.join(bytes((number,)) + BOTH for number in (1, 2, 3))),
    (I.SYNC_WRITE, BOTH + b''.join(bytes((number, 1, 1, 0, 0)) for number in (1, 2, 3))),
    (I.BULK_WRITE, b''.join(bytes((number,)) + BOTH + bytes((1, 1, 0, 0))
                            for number in (1, 2, 3))),
])
def test_devices_with_other_indirect_addresses_have_other_names(instruction, params):
    """The third one points nowhere: not one register is whole in its range."""
    line = dump('-', '--devices', '1-3:XM430-W350', '--instruction', 'sync_read,bulk_read,'
                'sync_write,bulk_write', feed=b''.join([
                    mapped(1, *POSITION), mapped(2, *TORQUE_AND_LED),
                    mapped(3, 300, 301, 302, 303), encode(BROADCAST, instruction, params)]))
    if instruction in (I.SYNC_READ, I.BULK_READ):
        assert ('1: Present Position (4 at 224); 2: Torque Enable .. LED (4 at 224); '
                '3: 4 at 224\n') in line
    else:
        assert '1: Present Position' in line
        assert 'rad; 2: Torque Enable on, LED on; 3: 4 at 224: 01 01 00 00' in line


def test_a_register_that_means_another_thing_on_another_device_is_told_apart():
    modes = [encode(number, I.WRITE, struct.pack('<HB', 10, mode))
             + encode(number, STATUS, error=0) for number, mode in ((1, 0), (2, 4))]
    sync = struct.pack('<HH', 112, 4) + b''.join(struct.pack('<Bi', number, 10)
                                                 for number in (1, 2))
    line = dump('-', '--devices', '1-2:XM430-W350', '--instruction', 'sync_write',
                feed=b''.join([*modes, encode(BROADCAST, I.SYNC_WRITE, sync)]))
    assert '1: Profile Velocity 0.2398 rad/s; 2: Profile Velocity 0.01 s\n' in line


def test_addresses_and_their_data_written_at_once_go_together():
    """As a robot does that sets up all at its start: 28 addresses, then the data behind them."""
    now = struct.pack('<28H', *POSITION, *range(300, 324)) + struct.pack('<i', 2048)
    found = objects('-', '--devices', '1:XM430-W350', feed=b''.join([
        mapped(1, *TORQUE_AND_LED), encode(1, I.WRITE, struct.pack('<H', 168) + now)]))
    values = found[-1]['registers'][0]['values']
    assert values['Present Position (rad)'] == pytest.approx(0, abs=1e-8)
    assert 'LED' not in values


def test_a_fast_reply_is_split():
    found = objects('-', '--devices', '1-3:XM430-W350',
                    feed=b''.join(data for data, _ in fast_run()))
    reply = next(one for one in found if one['code'] == STATUS and one['id'] == BROADCAST)
    assert [one['id'] for one in reply['registers']] == [1, 2, 3]
    assert all('Present Position (rad)' in one['values'] for one in reply['registers'])


def fast_run():
    line = Line(make_devices(['1-3:XM430-W350'], MODELS, BAUD), BAUD)
    return [(burst.data, burst.end)
            for burst in Master(line, PATTERNS['fast'], rate=50).bursts(SECOND // 2)]


# --- lines ----------------------------------------------------------------------------------

def test_lines_are_for_people(recorded):
    lines = dump(recorded, '--devices', '1-3:MX-106,4:XL430-W250:knee').splitlines()
    text = '\n'.join(lines)
    assert re.match(r' +\d+\.\d{6} +\+[\d.]+(us|ms|s) bus ', lines[5])
    for part in ('> all', 'Goal Position', 'Present Position', ' rad', 'XL430-W250 knee',
                 'no answer to', 'Access error: '):
        assert part in text, part
    assert '\033' not in text


def test_errors_only(recorded):
    lines = dump(recorded, '--errors').splitlines()
    assert lines
    assert all(re.search(r' ! | error|alert|[*]', line) for line in lines)
    assert all(one['error'] or one.get('notes') or one['repaired']
               for one in objects(recorded, '--errors'))


@pytest.mark.parametrize(('arguments', 'test'), [
    (['--id', '2'], lambda one: one['id'] == 2),
    (['--id', '1,3-4'], lambda one: one['id'] in (1, 3, 4)),
    (['--instruction', 'sync write,0x02'], lambda one: one['code'] in (0x83, 0x02)),
    (['--instruction', 'status', '--id', '1'], lambda one: (one['code'], one['id']) == (85, 1)),
    (['--about', '4'], lambda one: one['id'] == 4 or 4 in [
        part['id'] for part in one.get('registers', [])]),
])
def test_filters(recorded, arguments, test):
    every = objects(recorded)
    found = objects(recorded, *arguments)
    assert found == [one for one in every if test(one)]
    assert 0 < len(found) < len(every)


def test_count_and_seconds(recorded):
    every = objects(recorded)
    assert objects(recorded, '--count', '7') == every[:7]
    counted = json.loads(dump(recorded, '--summary', '--count', '7'))
    assert 7 <= counted['packets'] < len(every)
    some = objects(recorded, '--seconds', '0.5')
    assert some == every[:len(some)]
    assert some[-1]['stamp'] - some[0]['stamp'] == pytest.approx(0.5, abs=0.05)


def on_a_terminal(columns, *arguments, **env):
    """Run dxl_dump on a terminal so wide, return what it shows."""
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack('4H', 24, columns, 0, 0))
    plain = {name: value for name, value in os.environ.items()
             if name not in ('COLUMNS', 'LINES', 'NO_COLOR')}
    with ThreadPoolExecutor() as pool:
        shown = pool.submit(shown_on, master)
        with open(slave, 'wb') as screen:
            done = forked.run(DUMP, *arguments, stdout=screen,
                              env={**plain, 'TERM': 'xterm', **env})
        assert done.returncode == 0
        return shown.result()


@pytest.mark.parametrize('columns', [60, 80, 132])
def test_lines_fit_the_terminal(recorded, columns):
    text = on_a_terminal(columns, recorded, '--devices', '1-3:MX-106', NO_COLOR='1')
    assert '\033' not in text
    lines = text.splitlines()
    assert max(map(len, lines)) == columns
    assert len(lines) > 200
    assert max(map(len, on_a_terminal(columns, recorded, '--full', '--count', '40', NO_COLOR='1')
                   .splitlines())) > columns or columns > 80


def test_colours_on_a_terminal(recorded):
    assert '\033[' in on_a_terminal(80, recorded, '--count', '5')
    assert '\033[' not in on_a_terminal(80, recorded, '--count', '5', TERM='dumb')


def test_a_wrong_baud_rate_shows():
    noise = random.Random(5).randbytes(20_000).replace(b'\xff', b'')
    assert 'bytes and no packet: wrong --baud?' in dump('-', feed=noise)


# --- figures --------------------------------------------------------------------------------

def test_summary_counts_missed_answers_but_not_what_is_pending_at_the_end():
    data = encode(3, I.PING) + encode(1, I.PING) + encode(1, STATUS, b'\x41\x01\x2a', error=0)
    assert json.loads(dump('-', '--summary', feed=b'\x00\x01' + data + encode(3, I.PING))) == {
        'bytes': 2 + len(data) + 10, 'packets': 4, 'repaired': 0, 'crc_errors': 0, 'truncated': 0,
        'bad_length': 0, 'noise_bytes': 2, 'missed': {'1': 0, '3': 1}}


def test_two_buses_in_one_capture(tmp_path):
    path = tmp_path / 'two.txt'
    with open(path, 'wb') as file:
        writer = Writer(file, ClockReading(SECOND, SECOND))
        for number in range(4):
            for bus, device in (('left', 1), ('right', 2)):
                writer.write_chunk(Wire(bus, BAUD),
                            Chunk(SECOND * (number + 1), bus, encode(device, I.PING)))
    assert json.loads(dump(path, '--summary'))['missed'] == {'left/1': 3, 'right/2': 3}
    assert {(one['bus'], one['id']) for one in objects(path)} == {('left', 1), ('right', 2)}
    [first, *_] = objects(path, '--devices', 'right/2:MX-106')
    assert (first['bus'], first['model']) == ('left', None)
    assert ' right ' in dump(path)


def test_stats_of_a_file_say_how_much_of_it_is_damaged(tmp_path):
    data = b''.join(traffic.packets('moving robot', 15_000))
    file = tmp_path / 'bus.bin'
    for damaged, said in ((6, None), (700, 'about 5 % of the packets damaged')):
        wrong = bytearray(data)
        for at in range(500, len(data), len(data) // damaged):
            wrong[at] ^= 0x10
        file.write_bytes(wrong)
        found = re.search('about [0-9.]+ % of the packets damaged', dump(file, '--stats'))
        assert (found and found[0]) == said


# --- a live bus -----------------------------------------------------------------------------

@pytest.fixture
def bus(tmp_path):
    link = tmp_path / 'live'
    with Program(FAKE_BUS, '--link', str(link), '--devices', '1-3:MX-106') as fake:
        fake.wait_for('2000000 baud')
        yield link


def live(*arguments):
    return Program(DUMP, *map(str, arguments))


def test_a_live_bus_is_recorded_and_read_again(bus, tmp_path):
    path = tmp_path / 'bus.txt'
    with live(bus, '-w', path, '--seconds', '1') as tool:
        assert tool.exit_code() == 0
    chunks = list(Reader(path.open('rb')))
    counts = json.loads(dump(path, '--summary'))
    assert counts['bytes'] == sum(len(chunk.data) for chunk in chunks) > 500
    assert counts['packets'] > 20
    assert abs(objects(path, '--count', '1')[0]['stamp'] - time.time()) < 60


def test_ctrl_c_ends_it_and_the_summary_still_comes(bus):
    for number in (signal.SIGINT, signal.SIGTERM):
        with live(bus, '--json', '--summary') as tool:
            wait(lambda tool=tool: len(tool.lines) > 50)
            tool.signal(number)
            assert tool.exit_code() == 0
            assert json.loads(tool.lines[-1])['packets'] >= len(tool.lines) - 1


def test_a_closed_pipe_ends_it(bus):
    for source in (bus, '-'):
        code, _, err = shell(f'yes | dxl_dump {source} --baud 2000000 | head -n 2; '
                             'exit ${PIPESTATUS[1]}')
        assert (code, err) == (0, '')


def test_a_silent_port_is_no_blank_screen(tmp_path):
    link = tmp_path / 'live'
    with Pty(str(link)), live(link) as tool:
        tool.wait_for(f'dxl_dump: {link}: no byte in 5 s, still listening.')
        tool.wait_for('No program sends to the servos now: start yours')
        tool.signal(signal.SIGINT)
        assert tool.exit_code() == 0


def test_it_says_when_the_port_is_lost_and_goes_on(tmp_path):
    link = tmp_path / 'live'
    with Pty(str(link)) as pty:
        pty.let_go()
        tool = live(link)
        wait(lambda: pty.is_open)
        wait(lambda: os.write(pty.master, encode(1, I.PING)) and tool.said('Ping'))
    with tool:
        tool.wait_for(f'{link}: ')          # lost, or already why it does not open again
        with Pty(str(link)) as pty:
            tool.wait_for('the port is open again')
            wait(lambda: os.write(pty.master, encode(2, I.PING)) and tool.said('002'))
            tool.signal(signal.SIGINT)
            assert tool.exit_code() == 0


def test_a_full_disk_is_one_line(bus):
    with live(bus, '-w', '/dev/full') as tool:
        assert tool.exit_code() == 1
        [said] = tool.lines
        assert said == ('dxl_dump: /dev/full: No space left on device; '
                        'make room, or give another file')


def test_a_port_without_a_single_packet_is_asked_about(tmp_path):
    link = tmp_path / 'live'
    with Pty(str(link)) as pty:
        pty.let_go()
        with live(link, '--seconds', '2', '--json') as tool:
            wait(lambda: pty.is_open)
            # What comes before the port is set up is not for it.
            wait(lambda: tool.has_ended or not os.write(pty.master, b'Protocol 1.0'))
            assert tool.exit_code() == 0
    [line] = tool.lines
    assert re.fullmatch(rf'dxl_dump: {link}: \d+ bytes, but no packet; check that it is a servo '
                        'bus at 2000000 baud; --baud sets another rate', line)


@pytest.mark.parametrize('size', [1, 15])
def test_a_capture_is_told_from_bytes_however_it_trickles_in(recorded, size):
    """A pipe gives what is there: the first letter of a capture may come alone."""
    data = recorded.read_bytes()[:6000].rpartition(b'\n')[0] + b'\n'
    assert dump('-', feed=data, chunk=size) == dump('-', feed=data)


# --- where the output goes ------------------------------------------------------------------

def shell(command, **env):
    """Run dxl_dump as a shell does, return exit code, stdout and stderr."""
    usual = {name: value for name, value in os.environ.items() if name != 'PYTHONUNBUFFERED'}
    done = subprocess.run(
        ['bash', '-c', command.replace('dxl_dump', f'{sys.executable} -m {DUMP}')],
        cwd=ROOT, env={**usual, **env}, capture_output=True, timeout=DEADLINE_S)
    assert b'Traceback' not in done.stderr
    assert b'Exception ignored' not in done.stderr
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.parametrize(('where', 'code', 'words'), [
    ('>&-', 0, ''), ('--summary <&- >&- 2>&-', 0, ''),
    ('>/dev/full', 1, 'dxl_dump: No space left on device\n'),
    ('--summary >/dev/full 2>&1', 1, '')])
def test_an_output_that_takes_nothing_is_one_line(recorded, where, code, words):
    returned, _, err = shell(f'dxl_dump {recorded} {where}')
    assert (returned, err) == (code, words)


@pytest.mark.parametrize(('command', 'code'), [
    ('dxl_dump - --summary <&-', 0), ('dxl_dump nothing 2>/dev/full', 1),
    ('dxl_dump {} | head -1; exit ${{PIPESTATUS[0]}}', 0),
    ('dxl_dump {} -w - | true; exit ${{PIPESTATUS[0]}}', 0),
    ('dxl_dump <(cat {}) --summary', 0)])
def test_streams_that_are_closed_are_no_traceback(recorded, command, code):
    returned, _, err = shell(command.format(recorded))
    assert returned == code
    assert err == ''


def test_a_terminal_without_umlauts_gets_question_marks(recorded, tmp_path):
    folder = tmp_path / 'm\xe4'
    folder.mkdir()
    (folder / '_a.yaml').write_text('fields: []\n')
    ascii_only = {'LC_ALL': 'C', 'PYTHONIOENCODING': 'ascii'}
    _, out, _ = shell(f'dxl_dump {recorded} --devices 1:MX-106:kn\xf6chel', **ascii_only)
    assert 'MX-106 kn?chel' in out
    _, out, _ = shell(f'dxl_dump --check-models {folder}', **ascii_only)
    assert 'm?: 1 model files, no problem' in out


# --- mistakes -------------------------------------------------------------------------------


def test_check_models(tmp_path):
    good = tmp_path / 'my.yaml'
    good.write_text('model_numbers: {9999: Mine}\nfields:\n'
                    '  - {at: 0, name: Model Number, type: u16}\n')
    assert dump('--check-models', tmp_path) == f'{tmp_path}: 1 model files, no problem\n'
    good.write_text('model_numbers: {9999: Mine}\nfields:\n  - {at: 0, type: u16}\n')
    assert 'my.yaml' in dump('--check-models', tmp_path, code=1)
    good.unlink()
    (tmp_path / 'dynamixel.model').write_text('Number\tName\n9999\tmine.model\n')
    (tmp_path / 'mine.model').write_text('[control table]\n0\t2\tModel Number\n')
    assert dump('--check-models', tmp_path) == f'{tmp_path}: 1 model files, no problem\n'
    (tmp_path / 'mine.model').write_text('[control table]\n0\t3\tModel Number\n')
    assert 'mine.model: Model Number: size is 3' in dump('--check-models', tmp_path, code=1)


def test_the_tables_for_wireshark(tmp_path):
    folder = tmp_path / 'new' / 'plugins'
    for _ in range(2):                          # the second time over the first
        said = dump('--wireshark', folder)
        assert said.count('\n') == 1
        assert said.startswith(f'{folder}/servobus_tables.lua: {len(MODELS.names())} models')
        assert 'put it and wireshark/servobus.lua of the repository into ~/.local/lib/' in said
    text = (folder / 'servobus_tables.lua').read_text()
    assert '"Goal Position"' in text
    assert text.count('"XL430-W250"') == 1


@pytest.mark.parametrize('view', ['--summary', '--json', '--stats', ''])
def test_a_file_without_a_single_packet_is_asked_about(tmp_path, view):
    """It is no mistake that could be told from a bus at another rate: nothing else is changed."""
    noise = tmp_path / 'noise'
    noise.write_bytes(100 * b'\xf8\x80root:x:0:0:root:/root:/bin/ba')
    empty = tmp_path / 'empty'
    empty.write_bytes(b'')
    for path, lines in (noise, [f'dxl_dump: {noise}: 3100 bytes, but no packet; check that it is '
                                'a recording of a servo bus, made at its baud rate']), (empty, []):
        done = forked.run(DUMP, path, *view.split())
        assert (done.returncode, done.stderr.decode().splitlines()) == (0, lines)


def test_it_never_writes_over_what_it_reads(recorded, tmp_path):
    link = tmp_path / 'another_name'
    link.symlink_to(recorded)
    before = Path(recorded).read_bytes()
    assert 'is also the source' in dump(recorded, '-w', link, code=2)
    assert Path(recorded).read_bytes() == before


def test_feetech_packets_are_shown_with_their_registers(tmp_path):
    said = [dxl1_packet.encode(1, 1), dxl1_packet.encode(1, 0),
            dxl1_packet.encode(1, 2, b'\3\2'), dxl1_packet.encode(1, 0, b'\x09\3'),
            dxl1_packet.encode(1, 2, b'\x38\2'), dxl1_packet.encode(1, 0x20, b'\0\x08')]
    file = tmp_path / 'arm.bin'
    file.write_bytes(b''.join(said))
    lines = dump(file, '--baud', '1000000').splitlines()
    assert len(lines) == 6
    assert '2 at 3: 09 03' in lines[3]             # what it is, this says
    assert 'Present Position (2 at 56)' in lines[4]
    assert 'Present Position 0 rad' in lines[5]
    assert dump(file, '--protocol', '2', '--summary').startswith('{"bytes": 44, "packets": 0')
    begins = [sum(map(len, said[:at])) for at in range(6)]
    assert [one['offset'] for one in objects(file)] == begins
    assert 'Feetech' in dump(file, '--stats', '--baud', '1000000')


@pytest.mark.parametrize('protocol', ['1', 'feetech'])
def test_a_question_that_is_not_answered_may_be_a_status(protocol):
    """A master asks its one servo, which is silent: its Pings might answer its Pings."""
    data = 6 * dxl1_packet.encode(1, 1) + 6 * dxl1_packet.encode(1, 2, b'\x38\2')
    lines = dump('-', '--protocol', protocol, feed=data).splitlines()
    assert any('undecided' in line and 'Ping, or a status; 01 02 01' in line for line in lines)
    assert not objects('-', '--protocol', protocol, '--errors', feed=data)


def test_an_instruction_of_1_0_with_the_code_of_a_status_of_2_0_is_unknown():
    data = dxl1_packet.encode(BROADCAST, STATUS) + dxl1_packet.encode(1, 1)
    unknown, ping = objects('-', '--protocol', '1', feed=data)
    assert (unknown['id'], unknown['instruction'], ping['instruction']) \
        == (BROADCAST, 'instruction 0x55', 'Ping')


@pytest.mark.parametrize(('code', 'front', 'dialect'), [
    (I.WRITE, '7400', '2'), (I.REG_WRITE, '7400', '2'), (I.SYNC_WRITE, '7400020001', '2'),
    (I.BULK_WRITE, '0174000200', '2'), (I.WRITE, '1e', '1'), (I.SYNC_WRITE, '1e0201', '1')])
def test_each_write_shows_its_own_data(code, front, dialect):
    """A plan is kept for all writes of the same registers."""
    make = encode if dialect == '2' else dxl1_packet.encode
    number = BROADCAST if code in (I.SYNC_WRITE, I.BULK_WRITE) else 1
    data = [bytes([value, 0]) for value in (7, 8, 9)]
    feed = b''.join(make(number, code, bytes.fromhex(front) + one) for one in data)
    shown = objects('-', '--protocol', dialect, feed=feed)
    assert [one['registers'][0]['data'] for one in shown] == [one.hex() for one in data]


def test_what_an_adapter_read_is_shown_for_each_servo():
    said = [dxl1_packet.encode(254, 0x84, b'\x24\2\1\2\3'),
            dxl1_packet.encode(254, 0, b'\1\2\xff\xff\3\4')]
    lines = dump('-', '--devices', '1-3:MX-28(1.0)', feed=b''.join(said * 3)).splitlines()
    assert lines[0].endswith('Sync Read by the adapter 1-3: Present Position (2 at 36)')
    assert lines[1].endswith('Present Position (rad)  1: -2.35466, 3: -1.56619')
