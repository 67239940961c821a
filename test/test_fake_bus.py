# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated bus: traffic and faults on paper time, then on ptys, and its truth."""

from functools import cache
import itertools
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

import forked
from harness import later
from harness import Program
from harness import wait
import pytest
from whole_truth import LEARNING
from whole_truth import WholeTruth

from mecarover_fakes.bus_ptys import FakeBus
from mecarover_fakes.fake_bus import DEFAULT_DEVICES
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_bus import make_line
from mecarover_fakes.fake_options import Away
from mecarover_fakes.fault import Fault
from mecarover_fakes.faults import KINDS
from mecarover_fakes.faults import parse as parse_fault
from mecarover_fakes.line import Line
from mecarover_fakes.line import wire_ns
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import Ask
from mecarover_fakes.traffic import PATTERNS
from mecarover_fakes.values import VOLTAGE
from mecarover_fakes.virtual_uart import CAPACITY
from mecarover_fakes.virtual_uart import VirtualUart
from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_instruction import KINDS as INSTRUCTIONS
from msg_defs.dxl_packet import Framer
from servobus.bus.decoder import Settings
from servobus.errors import ParameterError
from servobus.model.control_table import STRUCTS
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.port.pty import Pty

MODELS = Models()
BAUD = 2_000_000
S = 1_000_000_000
LATER_NS = 2 * S                 # after the last byte: a listener has judged everything
DEADLINE_S = 30.0
FAST_DEVICES = ('1-10:XL430-W250', '11-15:XM540-W270')     # two different ones


def make_master(pattern='moving', faults=(), *, devices=DEFAULT_DEVICES, baud=BAUD,
                waits_in_line=True, **options):
    line = Line(make_devices(list(devices), MODELS, baud), baud, waits_in_line=waits_in_line)
    master = Master(line, PATTERNS[pattern], faults=[parse_fault(text) for text in faults],
                    **options)
    master.truth = WholeTruth(line)
    return master


def play(master, seconds=3.0):
    return list(master.bursts(round(seconds * S)))


@cache
def played(pattern, devices):
    """Return a master and what was said on its bus in two seconds."""
    master = make_master(pattern, devices=devices)
    return master, play(master, 2.0)


# --- traffic -------------------------------------------------------------------------------

@pytest.mark.parametrize('pattern', [name for name in PATTERNS if name != 'none'])
def test_pattern_is_good_traffic_in_order_of_time(pattern):
    master, bursts = played(pattern, DEFAULT_DEVICES)
    assert all(one.end <= two.start for one, two in itertools.pairwise(bursts))
    framer = Framer()
    for burst in bursts:
        framer.frames(burst.data)
    assert framer.noise_bytes == framer.pending == 0
    truth = master.truth
    assert framer.bytes == truth.bytes == sum(len(burst.data) for burst in bursts)
    assert framer.packets == truth.instructions + truth.statuses > 20


def test_the_truth_has_every_instruction():
    assert set(LEARNING) == set(INSTRUCTIONS)


def test_same_seed_same_bytes():
    def run(seed):
        master = make_master(faults=('noise', 'jitter', 'duplicate:3'), seed=seed)
        return [(burst.start, burst.data) for burst in play(master, 1.0)]
    assert run(1) == run(1) != run(2)


# --- the truth against the monitor ---------------------------------------------------------

EXACT_FAULTS = [
    'silent:5:1:1', 'silent:1:1', 'silent:100:1', 'cable:15:1', 'baud:4:1', 'latched:3:1:1',
    'reboot:4:1', 'brownout::1', 'return_delay', 'overload', 'latency', 'header', 'glitch',
    'wrong_map:2', 'eeprom:3', 'eeprom_wear:3', 'no_ack', 'unstuffed', 'flip', 'drop',
    'watchdog:3', 'protocol1', 'hot:1', 'low_voltage', 'unwritten:1', 'jitter']

# A silent device, a lost one, damage, and what the tables learn otherwise: the rest is for --all.
FIRST_FAULTS = ['silent:5:1:1', 'cable:15:1', 'baud:4:1', 'reboot:4:1', 'header', 'wrong_map:2',
                'no_ack', 'flip', 'drop', 'unstuffed']

# With these, what a listener must count is not certain.


def monitored(master, bursts, write_acks='always'):
    monitor = Monitor('bus', MODELS, Settings(baud=master.line.baud, write_acks=write_acks))
    for burst in bursts:
        monitor.feed(burst.data, burst.end + S)
    return monitor.report(master.now + S + LATER_NS)


def assert_agrees(report, truth):
    """Hold what the monitor reports against the truth, device by device."""
    devices = {device.id: device for device in report.devices}
    for number, known in truth.known.items():
        device = devices[number]
        totals = device.totals
        assert (totals.answers, totals.missed, totals.not_served) == \
            (known.answered, known.missed, known.waiting), number
        learned = truth.tables[number]
        assert (device.model_number, device.firmware) == (learned.model_number, learned.firmware)
        seen = {value.field.name: value for value in device.observed}
        for field in device.model.fields:
            raw = bytes(learned.table.get(at, 0) for at in range(field.at, field.end))
            if all(at in learned.table for at in range(field.at, field.end)):
                assert seen[field.name].value.raw == STRUCTS[field.type].unpack(raw)[0], field


@pytest.mark.parametrize('pattern', [name for name in PATTERNS if name not in ('none', 'ping')])
def test_monitor_knows_the_truth_of_a_pattern(pattern):
    master, bursts = played(pattern, FAST_DEVICES if pattern == 'fast' else DEFAULT_DEVICES)
    assert_agrees(monitored(master, bursts), master.truth)


@pytest.mark.parametrize('fault', later(EXACT_FAULTS, FIRST_FAULTS))
def test_monitor_knows_the_truth_of_a_fault(fault):
    master = make_master(faults=(fault,))
    report = monitored(master, play(master), 'auto' if fault == 'no_ack' else 'always')
    assert_agrees(report, master.truth)


@pytest.mark.parametrize('waits_in_line', [True, False])
@pytest.mark.parametrize('fault', ['silent:5:1:1', 'old_firmware:5:1:1'])
def test_monitor_knows_the_truth_of_cut_combined_replies(fault, waits_in_line):
    master = make_master('fast', (fault,), devices=FAST_DEVICES, waits_in_line=waits_in_line)
    assert_agrees(monitored(master, play(master)), master.truth)


# --- faults --------------------------------------------------------------------------------

# Those of Feetech and Protocol 1.0 are in test_doctor_faults.py.
KINDS_OF_2 = [name for name, kind in KINDS.items() if '2' in kind.protocols]


@pytest.mark.more
@pytest.mark.parametrize('name', KINDS_OF_2)
def test_fault_begins_and_ends(name):
    clean = [(burst.start, burst.data) for burst in play(make_master(), 0.5)
             if burst.start < 0.5 * S]
    master = make_master(faults=(f'{name}:3:0.5:0.7',))
    bursts = play(master, 4.0)
    assert [(burst.start, burst.data) for burst in bursts[:len(clean)]] == clean
    late = [burst for burst in bursts if burst.start > 3.8 * S]
    assert all(burst.intact for burst in late)
    assert (3 in {burst.sender for burst in late}) == (name != 'baud')      # that one is gone


def test_a_supply_rises_again_where_its_fault_ends_in_the_sag():
    master = make_master(faults=('brownout:1:0.1:0.2',), devices=['1:MX-106'])
    play(master, 0.2)
    assert master.line.at(1).voltage < VOLTAGE
    play(master, 1.0)
    assert master.line.at(1).voltage == VOLTAGE


def test_a_fault_of_a_register_leaves_a_servo_without_it():
    for name, kind in KINDS.items():
        if 'feetech' in kind.protocols:
            line = make_line(make_devices(['1-2:SCS15'], MODELS, 10**6, dialect='feetech'), 10**6,
                             'feetech')
            assert play(Master(line, PATTERNS['moving'], faults=[parse_fault(name)]), 0.1)


@pytest.mark.parametrize(('text', 'fault'), [
    ('silent', Fault('silent')),
    ('silent:5', Fault('silent', 5)),
    ('silent:5:2', Fault('silent', 5, 2 * S)),
    ('silent:5:2:3.5', Fault('silent', 5, 2 * S, round(5.5 * S))),
    ('noise::1', Fault('noise', None, S)),
])
def test_fault_as_a_person_writes_it(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(('text', 'words'), [
    ('silnt', 'did you mean silent'),
    ('zzz', 'there are: silent'),
    ('silent:x', 'NAME'),
    ('silent:1:2:3:4', 'NAME'),
])
def test_fault_mistakes(text, words):
    with pytest.raises(ParameterError, match=words):
        parse_fault(text)


def test_fault_of_a_device_that_is_not_there():
    with pytest.raises(ParameterError, match='no device has this ID'):
        make_master(faults=('silent:77',))


# --- on a pty ------------------------------------------------------------------------------

class Reader:
    """Reads a pty from now on."""

    def __init__(self, path):
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.data = bytearray()

    def take(self):
        try:
            chunk = os.read(self.fd, 65536)
        except OSError:              # nothing there, or hung up
            chunk = b''
        self.data += chunk
        return len(chunk)

    def take_until(self, length):
        def enough():
            self.take()
            return len(self.data) >= length
        wait(enough)


@pytest.fixture
def outlet():
    outlet = VirtualUart()
    yield outlet
    outlet.close()


def test_outlet_counts_what_nobody_took_as_unheard_then_as_overrun(outlet):
    for _ in range(100):
        outlet.write(bytes(100))
        wait(lambda: outlet.outstanding() >= min(outlet.taken, CAPACITY - 1))
    assert outlet.taken == CAPACITY - 1
    assert (outlet.unheard, outlet.overrun) == (10_000 - outlet.taken, 0)
    reader = Reader(outlet.path)
    reader.take_until(CAPACITY - 1)
    for _ in range(100):
        outlet.write(bytes(100))
        wait(lambda: outlet.outstanding() >= min(
            outlet.taken - len(reader.data), CAPACITY - 1))
    assert outlet.overrun == 10_000 - (CAPACITY - 1)
    assert outlet.sent == outlet.taken + outlet.overrun + outlet.unheard
    os.close(reader.fd)


def test_bus_in_real_time_is_the_bus_on_paper():
    paper = b''.join(burst.data for burst in play(make_master(), 1.0))
    bus = FakeBus(make_master(), tap=True)
    readers = [Reader(bus.path), Reader(bus.tap.path)]
    bus.start(1.0)
    deadline = time.monotonic() + DEADLINE_S
    while any(len(reader.data) < len(paper) for reader in readers):
        for reader in readers:
            reader.take()
        assert time.monotonic() < deadline
        if bus.outlet.overrun or bus.tap.overrun:
            pytest.skip('skipped: this machine is too busy to read a serial port')
        time.sleep(0.001)
    assert all(bytes(reader.data) == paper for reader in readers)
    bus.stop()
    for reader in readers:
        os.close(reader.fd)


def test_bus_paces_its_bytes():
    # However slow the machine is, bytes never come before their time.
    seconds = 0.5
    bus = FakeBus(make_master(devices=('1-5:MX-64',), baud=57_600, rate=0))
    reader = Reader(bus.path)
    begin = time.monotonic_ns()
    bus.start(seconds)
    while not bus._playing.done():
        if reader.take():
            elapsed = time.monotonic_ns() - begin
            assert wire_ns(len(reader.data), 57_600) <= elapsed
        time.sleep(0.001)
    bus.stop()
    os.close(reader.fd)


def test_a_machine_that_is_always_late_plays_the_bus_more_slowly(tmp_path):
    link = tmp_path / 'bus'
    times = itertools.count(0, S // 100)               # between two looks at the clock pass 10 ms
    bus = FakeBus(make_master(rate=0), link=str(link), away=Away(0.2, 9e9),
                  clock=lambda: next(times))
    reader = Reader(bus.path)
    bus.start()
    reader.take_until(10_000)
    wait(lambda: not link.is_symlink())
    bus.stop()
    assert bus.stood_still_ns > S
    os.close(reader.fd)


def test_bus_vanishes_and_comes_back(tmp_path):
    link = tmp_path / 'bus'
    bus = FakeBus(make_master(), link=str(link), away=Away(0.3, 0.3))
    bus.start()
    wait(lambda: not link.is_symlink())
    wait(lambda: link.is_symlink() and bus._now() > S)     # its time may step back a little
    reader = Reader(str(link))
    reader.take_until(5000)
    bus.stop()
    assert not link.is_symlink()
    totals = bus.outlet
    assert totals.sent == totals.taken + totals.overrun + totals.unheard
    os.close(reader.fd)


def test_simulated_master_counts_what_is_sent_to_it():
    bus = FakeBus(make_master())
    reader = Reader(bus.path)
    os.write(reader.fd, b'never from a monitor')
    bus.start()
    wait(lambda: bus.outlet.received == 20)
    bus.stop()
    os.close(reader.fd)


# --- the command ---------------------------------------------------------------------------

def run_tool(*arguments):
    return subprocess.run(
        [sys.executable, '-m', 'mecarover_fakes.fake_bus', *arguments], check=False, text=True,
        capture_output=True, timeout=60, cwd=Path(__file__).parents[1])


def test_command_plays_tells_totals_and_truth(tmp_path):
    truth_file = tmp_path / 'truth.json'
    link = tmp_path / 'bus'
    result = run_tool('--link', str(link), '--devices', '1-5:MX-106', '--seconds', '0.5',
                      '--fault', 'silent:2:0.1', '--truth', str(truth_file))
    assert result.returncode == 0
    assert result.stderr == ''
    assert 'totals: sent ' in result.stdout
    truth = json.loads(truth_file.read_text())
    assert truth['devices']['2']['state'] == 'disconnected'
    assert truth['totals']['bus']['sent'] == truth['bytes'] > 1000
    assert not link.is_symlink()


def test_command_lists_faults():
    result = run_tool('--list-faults')
    assert [line.split()[0] for line in result.stdout.splitlines()] == list(KINDS)


def test_faults_begin_and_end_on_command():
    master = make_master('none', devices=['1-3:MX-106'])

    def answers(now):
        return {number for number in (1, 2, 3)
                if len(master.respond(Ask(number, Instruction.PING, b''), now * S)) == 2}

    assert answers(10) == {1, 2, 3}
    master.faults.command('silent:2', 11 * S)
    master.faults.command('silent:3::4', 11 * S)
    master.faults.command('silent:1:2', 11 * S)
    assert answers(12) == {1}
    assert answers(14) == set()
    assert answers(16) == {3}
    master.faults.command('back silent:1', 17 * S)
    assert answers(18) == {1, 3}
    master.faults.command('back', 19 * S)
    assert answers(20) == {1, 2, 3}


@pytest.mark.parametrize(('command', 'words'), [
    ('back silent:1', 'fault: silent is not on like that; `back` ends all'),
    ('silent:9', 'no device has this ID'), ('slient', "there is no fault 'slient'; did you mean"),
    ('', 'there is no fault'), ('back again', "there is no fault 'again'")])
def test_commands_that_are_none(command, words):
    with pytest.raises(ParameterError, match=words):
        make_master('none', devices=['1-3:MX-106']).faults.command(command, 0)


def test_commands_come_through_a_socket(tmp_path):
    place = str(tmp_path / 'control')
    child = subprocess.Popen(
        [sys.executable, '-m', 'mecarover_fakes.fake_bus', '--pattern', 'none', '--devices',
         '1:MX-106', '--link', str(tmp_path / 'bus'), '--control', place],
        stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline().startswith('fake_bus: ')
        with socket.socket(socket.AF_UNIX) as end, end.makefile('rw') as lines:
            end.connect(place)
            for command, answer in (('silent:1', 'ok'), ('back silent:1', 'ok'),
                                    ('silent:2', 'fault: silent:2: no device has this ID'),
                                    ('\xff' * 5000, 'fault: there is no fault')):
                lines.write(f'{command}\n')
                lines.flush()
                assert lines.readline().startswith(answer)
    finally:
        child.terminate()
        child.communicate()
    assert child.returncode == 0
    assert not os.path.exists(place)


def test_commands_come_from_standard_input_which_may_stay_open():
    with subprocess.Popen(
            [sys.executable, '-m', 'mecarover_fakes.fake_bus', '--control', '-', '--devices',
             '1:MX-106'], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE) as child:
        child.stdout.readline()
        child.stdin.write('silent:1\nsilent:2\n')
        child.stdin.flush()
        assert child.stderr.readline().startswith('fake_bus: fault: silent:2: no device')
        child.terminate()
        assert (child.wait(), child.stderr.read()) == (0, '')


def fake(tool, *arguments):
    """Run a fake for no time; return its exit code and what it says."""
    done = forked.run(f'mecarover_fakes.{tool}', '--seconds', '0', *map(str, arguments))
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.parametrize('option', ['--control', '--usbmon'])
@pytest.mark.parametrize(('place', 'words'), [
    ('file', 'Address already in use; give the path of a new file'),
    ('device', 'Address already in use; give the path of a new file'),
    ('none/socket', 'No such file'), ('other', 'Protocol wrong type')])
def test_a_socket_that_cannot_be_made_is_named(tmp_path, place, words, option):
    (tmp_path / 'file').write_text('mine')
    os.mkfifo(tmp_path / 'device')
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
        other.bind(str(tmp_path / 'other'))
        code, out, err = fake('fake_bus', '--link', tmp_path / 'bus', option, tmp_path / place)
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert err.startswith(f'fake_bus: {option} {tmp_path / place}: {words}')
    assert sorted(os.listdir(tmp_path)) == ['device', 'file', 'other']
    assert (tmp_path / 'file').read_text() == 'mine'


def name_of(pid):
    return Path(f'/proc/{pid}/comm').read_text().strip()


@pytest.mark.parametrize('tool', ['fake_bus', 'fake_mcu'])
def test_the_link_of_a_living_fake_stays_and_that_of_a_killed_one_goes(tmp_path, tool):
    link = tmp_path / 'link'
    with Program(f'mecarover_fakes.{tool}', '--link', str(link)) as first:
        first.wait_for(str(link))
        pty = link.readlink()
        assert fake(tool, '--link', link) == (
            1, '', f'{tool}: {link}: in use by {name_of(first.pid)} (pid {first.pid}); '
                   'stop that program, or give another path\n')
        assert link.readlink() == pty
        first.signal(signal.SIGKILL)
        first.exit_code()
    assert link.is_symlink()
    code, out, err = fake(tool, '--link', link)
    assert (code, f'{tool}: {link}, ' in out, err) == (0, True, '')


def test_a_link_to_a_pty_whose_number_another_one_has_got_since_is_replaced(tmp_path):
    link = tmp_path / 'link'
    with Pty(str(link)) as pty:
        assert f'{link}: in use by ' in fake('fake_mcu', '--link', link)[2]
        assert link.readlink() == Path(pty.path)
        os.utime(link, (0, 0), follow_symlinks=False)
        assert fake('fake_mcu', '--link', link)[0] == 0


@pytest.mark.parametrize('option', ['--control', '--usbmon'])
def test_the_socket_of_a_living_fake_stays_and_that_of_a_killed_one_goes(tmp_path, option):
    place = tmp_path / 'socket'
    with Program('mecarover_fakes.fake_bus', option, str(place)) as first:
        first.wait_for('fake_bus: ')
        wait(place.is_socket)
        node = place.stat().st_ino
        assert fake('fake_bus', option, place) == (
            2, '', f'fake_bus: {option} {place}: in use by {name_of(first.pid)} '
                   f'(pid {first.pid}); stop that program, or give another path\n')
        assert place.stat().st_ino == node
        first.signal(signal.SIGKILL)
        first.exit_code()
    assert place.is_socket()
    assert fake('fake_bus', option, place)[::2] == (0, '')
    assert not place.exists()


def test_what_was_made_before_a_mistake_goes_again(tmp_path):
    (tmp_path / 'file').touch()
    for option in '--link', '--tap':
        code, out, err = fake('fake_bus', '--link', tmp_path / 'bus', '--usbmon',
                              tmp_path / 'usb', '--truth', tmp_path / 'truth', option,
                              tmp_path / 'file')
        assert (code, out) == (1, '')
        assert f'{tmp_path / "file"}: cannot be made a symlink to the pty' in err
        assert os.listdir(tmp_path) == ['file']


def test_a_fake_that_cannot_come_back_says_so(tmp_path):
    link = tmp_path / 'link'
    with Program('mecarover_fakes.fake_bus', '--link', str(link), '--vanish', '0.5:0.5') as bus:
        bus.wait_for(str(link))
        wait(lambda: not link.is_symlink())
        link.touch()
        assert bus.exit_code() == 1
    assert bus.said('Traceback') == []
    bus.wait_for('cannot be made a symlink to the pty (File exists)')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('tool', ['fake_bus', 'fake_mcu'])
def test_a_launch_file_starts_it_as_a_node_and_ends_it(tmp_path, tool, number):
    link = tmp_path / 'link'
    with Program(f'mecarover_fakes.{tool}', '--link', str(link), '--ros-args', '-r',
                 '__node:=fake', '-r', '__ns:=/rover1', '-p', 'use_sim_time:=true',
                 '--params-file', '/tmp/launch_params') as fake:
        fake.wait_for(str(link))
        assert fake.children() == []
        fake.signal(number)
        fake.signal(signal.SIGTERM)         # an impatient user: the totals come all the same
        assert fake.exit_code() == 0
    assert fake.said('totals: ')
    assert not link.is_symlink()
