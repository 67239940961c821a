# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The in-process tap: masters that know nothing of it, heard to the byte, and never held up.

The oracle is the other end of the cable: the far side of a pty notes what came and what it sent.
"""

from collections import deque
from contextlib import contextmanager
from importlib.util import find_spec
import os
from pathlib import Path
import re
import select
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import threading
import time

from packets import packets_in
import pytest

from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import Framer
from msg_defs.dxl_packet import STATUS
from msg_defs.event import AWAY
from msg_defs.event import BAUD
from msg_defs.event import BUSY
from msg_defs.event import CLOSED
from msg_defs.event import GAVE_UP
from msg_defs.event import GONE
from msg_defs.event import IN
from msg_defs.event import LOST
from msg_defs.event import NOT_SENT
from msg_defs.event import OUT
from msg_defs.event import PURGED
from msg_defs.event import UNREAD
from servobus.port.pty import Pty
from servobus.sources.tap_listener import TapListener
from servobus.sources.tap_reader import PORTS_MAX
from servobus.sources.tap_reader import TapReader
from servobus.sources.tap_reader import TapRecord
from servobus.sources.tap_sender import folder
from servobus.sources.tap_sender import OPENED
from servobus.sources.tap_sender import record
from servobus.sources.tap_sender import Sender
from servobus.tools.start_program import environment

pytestmark = pytest.mark.realtime(bears=0.02)
ROOT = Path(__file__).parents[1]
DEADLINE_S = 20.0
SCRIPT_S = 60.0
DXL = """
    import dynamixel_sdk as sdk
    port = sdk.PortHandler({path!r})
    assert port.setBaudRate(1000000)
    port.setPacketTimeout = lambda *_: port.setPacketTimeoutMillis(5000)
    packet = sdk.PacketHandler(2.0)
    for _ in range({times}):
        for servo in (1, 2, 3):
            assert packet.ping(port, servo)[1] == 0
    port.closePort()
    print('done')
"""
FEETECH = """
    import scservo_sdk as sdk
    port = sdk.PortHandler({path!r})
    assert port.setBaudRate(1000000)
    port.setPacketTimeout = lambda *_: port.setPacketTimeoutMillis(5000)
    packet = sdk.PacketHandler(0)
    for _ in range({times}):
        assert packet.read2ByteTxRx(port, 1, 56)[1] == 0
    port.closePort()
    print('done')
"""
PLAIN = """
    import serial
    port = serial.Serial({path!r}, 1000000, timeout=10)
    for number in range({times}):
        port.write(b'ping%04d' % number)
        assert port.read(8) == b'ping%04d' % number
    port.close()
    print('done')
"""


# A program that ends descriptors which it does not know, then has as many of its own.
CLOSING = """
    import os, resource, serial, socket, subprocess, sys, time
    how, limit, path = {how!r}, {limit}, {path!r}
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

    def exchange():
        port = serial.Serial(path, 1000000, timeout=10)
        for number in range(20):
            port.write(b'p%03d' % number)
            assert port.read(4) == b'p%03d' % number
            time.sleep(0.01)
        return port

    def sockets():
        names = ['/proc/self/fd/' + one for one in os.listdir('/proc/self/fd')]
        return [int(os.path.basename(one)) for one in names
                if os.path.islink(one) and os.readlink(one).startswith('socket:')]

    def work():
        own = [one for _ in range(8) for one in socket.socketpair()]
        file = open({file!r}, 'wb')
        numbers = [*(one.fileno() for one in own), file.fileno()]
        for number in theirs:
            if number not in numbers:          # it may still be open
                os.dup2(own[number % 2].fileno(), number)
                numbers.append(number)
        before = [os.fstat(one).st_ino for one in numbers]
        port = exchange()
        assert [os.fstat(one).st_ino for one in numbers] == before
        for one in own:
            one.setblocking(False)
            try: raise SystemExit(f'{{one}} got {{one.recv(10000)}}')
            except BlockingIOError: pass
        for one in own: one.send(b'mine')      # the other end is there
        assert os.path.getsize({file!r}) == 0
        port.close()
        print('intact', flush=True)

    first = exchange()
    while not sockets(): time.sleep(0.01)
    theirs = sockets()
    if how == 'daemon':
        if os.fork(): os._exit(0)
        os.setsid()
        if os.fork(): os._exit(0)
        while not sockets(): time.sleep(0.01)
        theirs = sockets()
    if how == 'subprocess':
        subprocess.run([sys.executable, '-c', ''], check=True, close_fds=True,
                       preexec_fn=lambda: os.closerange(3, 4096))
    elif how == 'fork':
        child = os.fork()
        if not child:
            os.closerange(3, 4096)
            work()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
    elif how != 'dup2':
        os.closerange(3, 4096)
    work()
"""


@pytest.fixture(autouse=True)
def _environment(monkeypatch, meeting_place):
    """Give each test a folder of its own to meet in."""
    monkeypatch.delenv('PYTHONPATH', raising=False)
    monkeypatch.setenv('XDG_RUNTIME_DIR', meeting_place)


class Peer(threading.Thread):
    """The far end of a cable; `answer(data)` returns what it says to what it heard."""

    def __init__(self, answer):
        super().__init__(daemon=True)
        self.pty = Pty()
        self.got = self.sent = b''
        self.is_over = False
        self._answer = answer
        self.start()

    def run(self):
        while not self.is_over:
            if select.select([self.pty.master], [], [], 0.05)[0]:
                data = os.read(self.pty.master, 65536)
                self.got += data
                answer = self._answer(data)
                self.sent += answer
                os.write(self.pty.master, answer)

    def end(self):
        self.is_over = True
        self.join()
        self.pty.close()


def dynamixel():
    framer = Framer()
    return lambda data: b''.join(
        encode(one.id, STATUS, bytes([0x41, 1, one.id]), error=0)
        for one in packets_in(framer, data))


def feetech():
    heard = bytearray()

    def answer(data):
        heard.extend(data)
        found = b''
        while len(heard) >= 8:                 # FF FF ID 4 2 address size sum
            number = heard[2]
            del heard[:8]
            body = bytes([number, 4, 0, 0x18, 5])
            found += b'\xff\xff' + body + bytes([~sum(body) & 0xFF])
        return found
    return answer


@contextmanager
def peers(*answers):
    some = [Peer(answer) for answer in answers]
    try:
        yield some
    finally:
        for one in some:
            one.end()


@contextmanager
def program(text, name='robot', **more):
    """Run a tapped program."""
    child = subprocess.Popen([sys.executable, '-c', textwrap.dedent(text)],
                             env={**environment(name), **more}, stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def listen(reader, is_enough):
    """Return what was told until it is enough."""
    told = []
    deadline = time.monotonic() + DEADLINE_S
    while not is_enough(told):
        assert time.monotonic() < deadline, told[-5:]
        told += reader.wait(0.1)
    return told


def closed(count):
    return lambda told: sum(one.kind == CLOSED for one in told) >= count


def heard(told, kind, port):
    return b''.join(one.data for one in told if one.kind == kind and one.port == port)


def done(child):
    out, err = child.communicate(timeout=SCRIPT_S)
    assert (child.returncode, err) == (0, '')
    return out


def of_sdk(module, *case):
    return pytest.param(*case, id=module, marks=pytest.mark.skipif(
        find_spec(module) is None, reason=f'{module} is not installed'))


@pytest.mark.parametrize(('script', 'peer'), [of_sdk('dynamixel_sdk', DXL, dynamixel),
                                              of_sdk('scservo_sdk', FEETECH, feetech)])
def test_every_byte_of_an_unchanged_master(script, peer):
    with peers(peer()) as (far,), TapReader('robot') as reader, \
            program(script.format(path=far.pty.path, times=40)) as child:
        told = listen(reader, closed(1))
        assert done(child) == 'done\n'
        assert heard(told, OUT, far.pty.path) == far.got
        assert heard(told, IN, far.pty.path) == far.sent
        assert [one.stamp for one in told] == sorted(one.stamp for one in told)
        assert [one.value for one in told if one.kind == BAUD][-1] == 1_000_000
        turns = [one.kind for one in told if one.kind in (OUT, IN)]
        assert turns[:2] == [OUT, IN]


def test_a_child_waits_for_no_lock_that_another_thread_had_at_the_fork(monkeypatch):
    """The thread of the tap asked tempfile for its folder as the program forked."""
    monkeypatch.delenv('XDG_RUNTIME_DIR', raising=False)
    monkeypatch.setattr(tempfile, 'tempdir', None)
    sender = Sender('robot')
    sender._ports[1] = b'/dev/ttyUSB9', 1_000_000
    with tempfile._once_lock:
        child = threading.Thread(target=sender.after_fork, daemon=True)
        child.start()
        child.join(DEADLINE_S)
        has_gone_on = not child.is_alive()
    sender.end()
    assert has_gone_on


@pytest.mark.parametrize('limit', [1024, 64])      # a low one leaves no high number for us
@pytest.mark.parametrize('how', ['closerange', 'daemon', 'dup2', 'fork', 'subprocess'])
def test_a_program_that_closes_descriptors_gets_no_byte_of_ours(how, limit, tmp_path, again):
    with peers(lambda data: data) as (far,), TapReader('robot') as reader, \
            program(CLOSING.format(path=far.pty.path, how=how, limit=limit,
                                   file=str(tmp_path / 'own'))) as child:
        told = listen(reader, closed(1))
        out, err = child.communicate(timeout=SCRIPT_S)
        assert (out, err) == ('intact\n' * (1 + (how == 'fork')), '')
        told += reader.wait(0.1)               # who has connected meanwhile
        while reader.programs:
            told += reader.wait(0.1)
        told += reader.rest()
        assert heard(told, OUT, far.pty.path) == far.got != b''
        assert [one for one in told if one.kind == LOST] == []


def test_records_that_are_taken_while_the_program_closes_descriptors_are_heard():
    class Queue(deque):
        def popleft(self):
            if self[0][3] == b'closes' and not gone:
                gone.append(max(sockets() - before))
                os.close(gone[0])
            return super().popleft()

    def sockets():
        return {int(one.name) for one in Path('/proc/self/fd').iterdir()
                if os.path.islink(one) and os.readlink(one).startswith('socket:')}

    gone = []
    with TapReader('robot') as reader:
        before = sockets()
        sender = Sender('robot')
        port = sender.opened('/dev/robot', 1_000_000)
        told = listen(reader, lambda told: BAUD in [one.kind for one in told])
        sender.queue = Queue([(OUT, port, time.monotonic_ns(), data)
                              for data in (b'first', b'closes', b'last')])
        told = listen(reader, lambda told: b'last' in [one.data for one in told])
        sender.end()
    assert heard(told, OUT, '/dev/robot') == b'firstcloseslast'
    assert LOST not in [one.kind for one in told]


@pytest.mark.parametrize(('script', 'words'), [
    ("""
        os.environ['XDG_RUNTIME_DIR'] = '/nowhere'     # as after chroot
        os.closerange(3, 4096)
        own = socket.socketpair()
        port = exchange(1.0)
    """, r'the program closed the connection of the tap after \d\.\d s; what it sent and received '
         'since then was not heard: write --by strace in front of --'),
    ("""
        if os.fork(): os._exit(0)
        exchange(4.0)
    """, 'the program goes on in the background and is no longer heard: let it run in the '
         'foreground, or write --by strace in front of --')], ids=['closed', 'background'])
def test_doctor_says_what_it_no_longer_hears(script, words):
    begin = """
        import os, serial, socket, sys, time
        def exchange(seconds):
            port = serial.Serial({path!r}, 1000000, timeout=10)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                port.write(b'ping')
                assert port.read(4) == b'ping'
                time.sleep(0.01)
            return port
        port = exchange(0.5)
    """
    with peers(lambda data: data) as (far,):
        whole = textwrap.dedent(begin.format(path=far.pty.path)) + textwrap.dedent(script)
        done = subprocess.run(
            [sys.executable, '-m', 'servobus.tools.dxl_doctor', 'run', '--',
             sys.executable, '-c', whole], cwd=ROOT, capture_output=True, text=True,
            timeout=SCRIPT_S, env={**os.environ, 'COLUMNS': '300'})
    assert re.search(words, ' '.join(done.stdout.split())), done


def test_child_of_a_program_is_heard_too():
    with peers(lambda data: data) as (far,), TapReader('robot') as reader:
        inner = textwrap.dedent(PLAIN.format(path=far.pty.path, times=5))
        with program(f'import subprocess, sys\n'
                     f'subprocess.run([sys.executable, "-c", {inner!r}], check=True)') as child:
            told = listen(reader, closed(1))
            assert done(child) == 'done\n'
            assert heard(told, OUT, far.pty.path) == far.got != b''


def test_reader_that_comes_later_hears_the_rest_and_knows_the_port():
    with peers(lambda data: data) as (far,), \
            program(PLAIN.format(path=far.pty.path, times=100_000_000)) as child:
        deadline = time.monotonic() + DEADLINE_S
        while not far.got:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        with TapReader('robot') as reader, TapReader('robot') as second:
            told = listen(reader, lambda told: sum(one.kind == IN for one in told) > 20)
            assert (told[0].kind, told[0].port, told[1].value) == (
                OPENED, far.pty.path, 1_000_000)
            assert heard(told, OUT, far.pty.path)[:4] == b'ping'
            listen(second, lambda told: sum(one.kind == IN for one in told) > 20)
        assert child.poll() is None


def test_master_does_not_notice_that_its_reader_is_killed_or_stopped():
    listening = """
        from servobus.sources.tap_reader import TapReader
        reader = TapReader('robot')
        print('ready', flush=True)
        while True:
            if reader.wait(1.0): print('heard', flush=True)
    """
    for how in (signal.SIGKILL, signal.SIGSTOP):
        with peers(lambda data: data) as (far,), subprocess.Popen(
                [sys.executable, '-c', textwrap.dedent(listening)], cwd=ROOT, text=True,
                stdout=subprocess.PIPE) as reader:
            try:
                assert reader.stdout.readline() == 'ready\n'
                with program(PLAIN.format(path=far.pty.path, times=2000)) as child:
                    assert reader.stdout.readline() == 'heard\n'
                    reader.send_signal(how)
                    assert done(child) == 'done\n'
                assert len(far.got) == 2000 * 8
            finally:
                reader.kill()


def test_records_from_the_future_come_at_once():
    """They are not held until their time: that would take memory without bound."""
    future = time.monotonic_ns() + 3600 * 10**9
    with TapReader('robot') as reader, socket.socket(socket.AF_UNIX) as program:
        program.connect(reader._path)
        program.sendall(record(OPENED, 1, future, b'/dev/ttyX') + b''.join(
            record(OUT, 1, future + at, b'%d,' % at) for at in range(500)))
        told = listen(reader, lambda told: len(told) == 501)
        assert max(one.stamp for one in told) <= time.monotonic_ns()
    assert heard(told, OUT, '/dev/ttyX') == b''.join(b'%d,' % at for at in range(500))


def test_a_program_that_opens_ports_without_end_is_left():
    with TapReader('robot') as reader, socket.socket(socket.AF_UNIX) as program:
        program.connect(reader._path)
        program.sendall(b''.join(record(OPENED, at, 1, b'/dev/%d' % at) for at in range(300)))
        listen(reader, closed(PORTS_MAX))
        assert program.recv(1) == b''


def test_thousands_of_ports_are_not_named():
    listener = TapListener('tap:robot', 0, lambda *_: None)
    listener._wanted = listener._heard_port = ''
    for at in range(5000):
        listener._accept_tap_record(TapRecord(at, f'/dev/{at}', OPENED, b'', 0))
    assert listener.problems() == [
        'the program also opened /dev/1, /dev/2, /dev/3 and others, which was not heard; name the '
        'port to listen to it: tap:NAME/1']


def test_what_a_dead_reader_left_is_removed():
    with TapReader('robot') as reader:
        os.link(reader._path, reader._path.replace('robot.', 'robot.0'))
    assert len(os.listdir(folder())) == 1
    with TapReader('robot') as reader:
        assert os.listdir(folder()) == [os.path.basename(reader._path)]
    assert os.listdir(folder()) == []


def test_a_reader_that_begins_removes_no_other_that_begins(monkeypatch):
    """A second one looks around between bind() and listen() of the first."""
    listen, others = socket.socket.listen, []
    with monkeypatch.context() as patch:
        def late(one):
            patch.setattr(socket.socket, 'listen', listen)
            others.append(TapReader('robot'))
            listen(one)

        patch.setattr(socket.socket, 'listen', late)
        with TapReader('robot') as reader, others.pop() as other:
            assert {*os.listdir(folder())} == {
                os.path.basename(one._path) for one in (reader, other)}


def test_folder_that_others_can_write_to_is_refused():
    os.mkdir(folder(), 0o777)
    os.chmod(folder(), 0o777)
    with pytest.raises(PermissionError, match='other users may write'):
        TapReader('robot')


@pytest.mark.parametrize(('place', 'words'), [
    ('x' * 100, 'the path of the socket is too long; set XDG_RUNTIME_DIR to a shorter folder'),
    ('file', 'Not a directory; set XDG_RUNTIME_DIR to a folder of yours')])
def test_a_place_for_no_socket_is_told_with_its_remedy(tmp_path, place, words):
    (tmp_path / 'file').touch()
    done = subprocess.run(
        [sys.executable, '-m', 'servobus.tools.dxl_dump', 'tap:robot'], cwd=ROOT,
        env={**os.environ, 'XDG_RUNTIME_DIR': str(tmp_path / place)},
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, '')
    [line] = done.stderr.splitlines()
    assert line.startswith(f'dxl_dump: tap:robot: {tmp_path}/')
    assert words in line


def test_what_the_program_sees_stays_as_it_is():
    script = """
        import serial
        port = serial.Serial({path!r}, 9600, timeout=0.01, write_timeout=0.5)
        assert port.write(iter([1, 2])) == 2 and port.write([3, 4]) == 2
        assert port.write(bytearray(b'xy')) == 2 and port.write(memoryview(b'z')) == 1
        for wrong in ('text', object(), [300]):
            try: port.write(wrong)
            except (TypeError, ValueError) as error: print(type(error).__name__)
        port.baudrate = 57600
        port.reset_input_buffer()
        try: port.write(bytes(100_000))
        except serial.SerialTimeoutException: print('timeout')
        port.close()
        try: port.read()
        except serial.PortNotOpenError: print('closed')
        try: serial.Serial('/dev/nothing_here')
        except serial.SerialException: print('absent')
        print(serial.Serial.read.__name__, serial.serial_for_url('loop://').write(b'q'))
    """
    with Pty() as pty, Pty() as other:         # what is written stays in there: one for each
        with TapReader('robot') as reader, program(script.format(path=pty.path)) as child:
            told = listen(reader, closed(1))
            out = done(child).split()
            told += reader.rest()
        with program(script.format(path=other.path), MECAROVER_TAP='') as plain:
            assert done(plain).split() == out
        mine = [one for one in told if one.port == pty.path]
        assert heard(told, OUT, pty.path)[:7] == b'\1\2\3\4xyz'
        assert [one.value for one in mine if one.kind == BAUD] == [9600, 57600]
        assert [one.value for one in mine if one.kind == PURGED] == [1]
        assert [one.value for one in mine if one.kind == NOT_SENT] == [100_000]


def heard_of_an_echoing_port(script):
    """Return what a script that says 'done' did with a port at which all comes back."""
    with peers(lambda data: data) as [peer], TapReader('robot') as reader, \
            program(script.format(path=peer.pty.path)) as child:
        mine = listen(reader, closed(1))
        assert done(child) == 'done\n'
    return mine


def test_what_is_thrown_away_and_what_is_looked_for_in_vain():
    script = """
        import serial
        port = serial.Serial({path!r}, 9600, timeout=0.01)
        port.write(b'abc')
        while port.in_waiting < 3: pass
        port.reset_input_buffer()
        port.read()
        port.reset_input_buffer()
        port.close()
        print('done')
    """
    mine = heard_of_an_echoing_port(script)
    assert [(one.kind, one.value * (one.kind != GAVE_UP)) for one in mine
            if one.kind in (UNREAD, PURGED, GAVE_UP)] == [
        (UNREAD, 0), (UNREAD, 3), (PURGED, 1), (UNREAD, 0), (GAVE_UP, 0), (PURGED, 1), (UNREAD, 0),
        (GAVE_UP, 0)]


def test_a_sleep_between_a_question_and_its_answer_is_reported():
    script = """
        import serial, time
        port = serial.Serial({path!r}, 9600, timeout=1)
        for turn in range(4):
            port.write(b'abc')
            if turn != 1: time.sleep(0.2)
            assert port.read(3 if turn else port.in_waiting) == b'abc'
            if turn == 2: port.fileno()        # from now on it may wait for bytes by itself
        port.close()
        print('done')
    """
    mine = heard_of_an_echoing_port(script)
    said = [one.kind for one in mine if one.kind in (OUT, IN)
            or (one.kind == AWAY and one.value > 150_000)]
    assert said == [OUT, AWAY, IN, OUT, IN, OUT, AWAY, IN, OUT, IN]


@pytest.mark.parametrize('size', ['32', 'size=32'])
def test_a_read_of_more_bytes_than_come_is_reported(size):
    script = f"""
        import serial
        port = serial.Serial({{path!r}}, 9600, timeout=0.3)
        for _ in range(2):
            port.write(b'abc')
            assert port.read({size}) == b'abc'
            assert not port.in_waiting
        port.close()
        print('done')
    """
    mine = heard_of_an_echoing_port(script)
    said = [one.kind for one in mine if one.kind in (OUT, IN, GAVE_UP)
            or (one.kind == AWAY and one.value > 250_000)]
    assert said == [OUT, AWAY, IN, GAVE_UP, OUT, AWAY, IN, GAVE_UP]


def test_a_port_that_is_gone_is_reported_once():
    script = """
        import contextlib, os, pty, serial, tty
        far, near = pty.openpty()
        tty.setraw(near)
        path = os.ttyname(near)
        port = serial.Serial(path, 9600, timeout=0.01)
        port.write(b'abc')
        port.read()
        os.close(far)
        for _ in range(3):
            for call in (port.reset_input_buffer, port.read, lambda: port.write(b'def'),
                         lambda: port.in_waiting):
                with contextlib.suppress(OSError, __import__('termios').error): call()
        port.close()
        print('done')
    """
    with TapReader('robot') as reader, program(script) as child:
        mine = listen(reader, closed(1))
        done(child)
    assert [(one.kind, one.data or one.value) for one in mine
            if one.kind in (OUT, IN, GONE, NOT_SENT)] == [(OUT, b'abc'), (GONE, 5)]


def test_whether_a_program_works_in_a_pause_is_reported():
    script = """
        import serial, time
        port = serial.Serial({path!r}, 9600, timeout=5)
        for turn in range(2):
            port.write(b'abc')
            assert port.read(3) == b'abc'
            end = time.thread_time() + 0.1
            if turn: time.sleep(0.2)
            else:
                while time.thread_time() < end: pass
        port.write(b'abc')
        port.close()
        print('done')
    """
    mine = heard_of_an_echoing_port(script)
    works, sleeps = (one.value for one in mine if one.kind == BUSY and one.stamp > mine[2].stamp)
    assert works >= 100_000 > 50_000 > sleeps


def test_queue_is_bounded_and_what_is_lost_is_told():
    script = """
        import sys, serial
        sender = next(one for one in sys.meta_path if hasattr(one, '_sender'))._sender
        port = serial.serial_for_url('loop://')
        sender._send = lambda: None
        for _ in range(30_000): sender.put('in', 1, b'x')
        assert len(sender.queue) <= 20_000
        del sender._send
        import time
        time.sleep(0.1)
        while sender.queue or any(one.pending for one in sender._readers.values()):
            time.sleep(0.1)
    """
    with TapReader('robot') as reader, program(script) as child:
        told = listen(reader, lambda told: any(one.kind == LOST for one in told))
        done(child)
        lost = sum(one.value for one in told if one.kind == LOST)
        assert sum(one.kind == IN for one in told) + lost == 30_000


def test_the_other_sitecustomize_is_run(tmp_path):
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'sitecustomize.py').write_text('print("the other one")\n')
    with program('import sitecustomize; print(sitecustomize.__file__)') as child:
        path = environment('robot')['PYTHONPATH']
        done(child)
    with program('import sitecustomize; print(sitecustomize.__file__)',
                 PYTHONPATH=os.pathsep.join((path, str(other)))) as child:
        assert done(child) == f'the other one\n{other / "sitecustomize.py"}\n'


def tap(*arguments, **more):
    return subprocess.run([sys.executable, '-m', 'servobus.tools.tap', *arguments],
                          capture_output=True, text=True, cwd=ROOT, check=False,
                          timeout=SCRIPT_S, env={**os.environ, **more})


def test_command_line():
    with peers(lambda data: data) as (far,), TapReader('arm') as reader:
        script = textwrap.dedent(PLAIN.format(path=far.pty.path, times=3))
        done = tap('arm', '--', sys.executable, '-c', script)
        assert (done.returncode, done.stdout, done.stderr) == (
            0, 'done\n', f'dxl_tap: {sys.executable} is heard through pyserial\n')
        assert heard(listen(reader, closed(1)), OUT, far.pty.path) == far.got
    silent = tap('arm', '--', sys.executable, '-c', 'raise SystemExit(7)')
    assert silent.returncode == 7
    assert 'opened no port through pyserial' in silent.stderr
    assert 'write --by strace' in silent.stderr
    assert 'did not load the tap' in tap('arm', '--by', 'tap', '--', 'true').stderr
    for arguments, words in ((('arm',), 'COMMAND: not given'),
                             (('a/b', '--', 'true'), "'a/b' cannot be the name of a tap")):
        wrong = tap(*arguments)
        assert wrong.returncode == 2
        assert words in wrong.stderr
    absent = tap('arm', '--', 'no_such_program')
    assert (absent.returncode, absent.stderr) == (
        1, 'dxl_tap: no_such_program: No such file or directory; check the name of the program\n')


def test_signal_reaches_the_program():
    script = "import signal, time; signal.signal(signal.SIGTERM, lambda *_: exit(5)); " \
             "print('ready', flush=True)\nwhile True: time.sleep(0.1)"
    with subprocess.Popen([sys.executable, '-m', 'servobus.tools.tap', 'arm', '--',
                           sys.executable, '-c', script], cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True) as child:
        assert child.stdout.readline() == 'ready\n'
        child.send_signal(signal.SIGTERM)
        assert child.wait(SCRIPT_S) == 5


def test_runs_where_only_the_standard_library_of_windows_is(tmp_path):
    """A program, the tap and its reader without fcntl, termios, pty and Unix sockets."""
    package = tmp_path / 'elsewhere' / 'serial'
    package.mkdir(parents=True)
    (package / '__init__.py').write_text('from serial.serialwin32 import Serial\n')
    (package / 'serialutil.py').write_text('class SerialBase: pass\n')
    (package / 'serialwin32.py').write_text(textwrap.dedent("""
        from serial.serialutil import SerialBase
        class Serial(SerialBase):
            def __init__(self, port, baudrate):
                self.port, self._baudrate, self.kept = port, baudrate, b''
                self.open()
            def open(self): pass
            def close(self): pass
            def write(self, data): self.kept += data; return len(data)
            def read(self, size): data, self.kept = self.kept[:size], self.kept[size:]; return data
    """))
    lacking = tmp_path / 'elsewhere' / 'sitecustomize.py'
    lacking.write_text('')
    without = textwrap.dedent("""
        import os, socket, sys
        for name in ('fcntl', 'termios', 'pty', 'tty', 'pwd', 'grp', 'resource'):
            sys.modules[name] = None
        del socket.AF_UNIX, os.getuid, os.geteuid
    """)
    site = environment('robot')['PYTHONPATH']
    begin = without + 'import runpy; runpy.run_path(sys.argv[1]); exec(sys.argv[2])'
    work = "import serial; port = serial.Serial('COM7', 1000000); port.write(b'hello'); " \
           'port.read(3); port.close()'
    reading = without + textwrap.dedent("""
        from servobus.sources.tap_reader import TapReader
        import servobus.tools.tap
        with TapReader('robot') as reader:
            print('ready', flush=True)
            told = []
            while not any(one.kind == 'closed' for one in told): told += reader.wait(0.1)
            print([(one.port, one.kind, one.data, one.value) for one in told])
    """)
    with subprocess.Popen([sys.executable, '-c', reading], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE) as reader:
        try:
            assert reader.stdout.readline() == 'ready\n'
            subprocess.run([sys.executable, '-c', begin, os.path.join(site, 'sitecustomize.py'),
                            work], check=True, timeout=SCRIPT_S, env={
                                **os.environ, 'MECAROVER_TAP': 'robot',
                                'PYTHONPATH': str(tmp_path / 'elsewhere')})
            assert reader.stdout.readline() == (
                "[('COM7', 'opened', b'', 0), ('COM7', 'baud', b'', 1000000), "
                "('COM7', 'out', b'hello', 0), ('COM7', 'in', b'hel', 0), "
                "('COM7', 'closed', b'', 0)]\n")
        finally:
            reader.kill()
