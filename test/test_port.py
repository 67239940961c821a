# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Ports: how they are opened, how they are lost, and one line for each mistake of a user."""
from contextlib import contextmanager
import errno
import grp
import os
import pathlib
import pwd
import re
import socket
import struct
import subprocess
import sys
import termios

from harness import Program
from harness import wait
import pytest
import serial
from terminal_server import TerminalServer

from servobus.port import port_watch
from servobus.port import preflight
from servobus.port import serial_port as port_module
from servobus.port.inspection import Inspection
from servobus.port.port_error import PortError
from servobus.port.port_users import holders
from servobus.port.pty import Pty
from servobus.port.serial_port import Backoff
from servobus.port.serial_port import open_port
from servobus.sources import strace
from servobus.sources.source_name import ways_to_hear

LINE = re.compile(r'[^\n]+: [^\n]+; [^\n]+')


def refusal(path, baud=115200):
    with pytest.raises(PortError) as caught:
        open_port(str(path), baud)
    assert LINE.fullmatch(str(caught.value))
    return caught.value


def test_bytes_both_ways(tmp_path):
    with Pty(str(tmp_path / 'mcu')) as pty:
        port = open_port(str(tmp_path / 'mcu'), 115200)
        assert port.write(b'to the mcu') == 10
        assert os.read(pty.master, 99) == b'to the mcu'
        assert port.read() == b''
        os.write(pty.master, b'back')
        assert port.wait(10)
        assert port.read() == b'back'
        port.close()
        port.close()
    assert not os.path.lexists(tmp_path / 'mcu')


def test_hupcl_is_cleared():
    with Pty() as pty:
        port = open_port(pty.path, 2_000_000)
        assert not termios.tcgetattr(port.fd)[2] & termios.HUPCL
        port.close()


def test_read_only_descriptor_cannot_write():
    with Pty() as pty:
        port = open_port(pty.path, 2_000_000, read_only=True)
        flags = re.search(r'flags:\s+(\d+)', pathlib.Path(
            f'/proc/self/fdinfo/{port.fd}').read_text())[1]
        assert int(flags, 8) & os.O_ACCMODE == os.O_RDONLY
        with pytest.raises(OSError, match='Bad file descriptor'):
            os.write(port.fd, b'x')
        os.write(pty.master, b'heard')
        assert port.wait(10)
        assert port.read() == b'heard'
        port.close()


@pytest.mark.parametrize('use', [lambda port: port.read(), lambda port: port.write(b'x')])
def test_unplugged(use):
    pty = Pty()
    port = open_port(pty.path, 115200)
    pty.close()
    assert port.wait(10)
    with pytest.raises(PortError, match='lost'):
        use(port)
    port.close()


def test_busy_names_the_holder():
    with Pty() as pty:
        code = (f'import fcntl, sys; f = open({pty.path!r}); fcntl.flock(f, 2); print(flush=True);'
                ' sys.stdin.read()')
        with subprocess.Popen([sys.executable, '-c', code], stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE) as holder:
            holder.stdout.readline()
            error = refusal(pty.path)
            holder.stdin.close()
        assert error.kind == 'busy'
        assert f'(pid {holder.pid})' in error.reason


@pytest.mark.parametrize(('path', 'kind'), [
    ('nothing', 'absent'), ('file', 'not_a_port'), ('.', 'not_a_port'), ('dangling', 'absent')])
def test_not_a_port(tmp_path, path, kind):
    (tmp_path / 'file').touch()
    (tmp_path / 'dangling').symlink_to(tmp_path / 'gone')
    assert refusal(tmp_path / path).kind == kind


@pytest.mark.parametrize(('url', 'kind'), [
    ('nonsense://x', 'url'), ('socket://127.0.0.1:1', 'absent')])
def test_urls(url, kind):
    assert refusal(url).kind == kind


@pytest.mark.parametrize('url', [
    'socket://[::1', 'rfc2217://127.0.0.1:x', 'socket://:', 'socket://127.0.0.1:99999',
    'hwgrep://(', 'hwgrep://nothing like it', 'spy://', 'alt://', 'loop://?a=b', 'cp2110://x:y'])
def test_urls_that_pyserial_fails_to_take_apart(url):
    refusal(url)


def test_a_port_that_vanishes_while_all_are_listed_is_no_mistake_of_ours(tmp_path, monkeypatch):
    def trip():
        raise TypeError('expected str, bytes or os.PathLike object, not NoneType')

    monkeypatch.setattr(preflight.list_ports, 'comports', trip)
    assert refusal(tmp_path / 'gone').kind == 'absent'


@pytest.mark.parametrize('baud', [0, -9600, 10**10])
def test_unusable_baud(baud):
    with Pty() as pty:
        error = refusal(pty.path, baud)
    assert error.kind == 'baud'
    assert str(baud) in error.reason


def test_a_rate_that_the_driver_falls_back_to_is_no_ceiling(monkeypatch):
    """As ftdi_sio does at 4 MBd: it gives 9600, and takes 3 MBd."""
    def tcgets2(fd, request, raw):
        struct.pack_into('I', raw, 40, 9600)

    monkeypatch.setattr(port_module.fcntl, 'ioctl', tcgets2)
    with Pty() as pty, pytest.raises(PortError) as caught:
        port_module._check_rate(pty.path, 0, 4_000_000)
    assert caught.value.reason == 'the driver sets 9600 baud, not the 4000000 that was asked for'
    assert '9600' not in caught.value.remedy


@pytest.mark.parametrize(('path', 'words'), [
    ('/etc/passwd', 'a file'), ('/etc', 'a directory'), ('/dev/null', 'not a serial port'),
    ('/dev/tty', 'a text console')])
def test_what_it_is_comes_before_who_may_open_it(path, words):
    """`sudo chmod g+rw /etc/passwd` was the remedy once."""
    reason = preflight.why_not(path, PermissionError(errno.EACCES, 'denied'))
    assert reason.kind == 'not_a_port'
    assert words in reason.reason
    assert 'sudo' not in reason.remedy


def test_a_name_without_a_uart_behind_it(tmp_path):
    with Pty() as pty:
        kind = tmp_path / 'sys/class/tty' / os.path.basename(pty.path) / 'type'
        kind.parent.mkdir(parents=True)
        for number, words in (('0', 'this name has no UART'), ('4', 'was removed')):
            kind.write_text(number + '\n')
            reason = preflight.why_not(pty.path, OSError(errno.EIO, 'error'), tmp_path)
            assert words in reason.reason


def port_of_group(monkeypatch, path, group):
    """Make a file look like a port of this group: making a device takes root."""
    path.touch()
    monkeypatch.setattr(preflight, '_wrong_kind', lambda *_: None)
    monkeypatch.setattr(grp, 'getgrgid', lambda number: grp.struct_group(
        (group, 'x', number, [])))
    return str(path)


def test_a_port_as_a_login_leaves_it(tmp_path, monkeypatch):
    """A getty leaves root:tty behind: joining that group would help nothing."""
    port = port_of_group(monkeypatch, tmp_path / 'ttyS1', 'tty')
    error = PermissionError(errno.EACCES, 'denied')
    reason = preflight.why_not(port, error, tmp_path)
    assert reason.kind == 'permission'
    assert 'usermod' not in reason.remedy
    assert f'sudo udevadm trigger --action=add {port}' in reason.remedy
    a_process(tmp_path, 812, 'agetty', cmdline='/sbin/agetty\0-o\0-\0vt220\0',
              cgroup='0::/system.slice/system-serial\\x2dgetty.slice/serial-getty@ttyS1.service\n')
    reason = preflight.why_not(port, error, tmp_path)
    assert (reason.kind, reason.reason) == ('console', 'agetty (pid 812) offers a login here')


def test_a_pty_of_somebody_else(monkeypatch):
    with Pty() as pty:
        reason = preflight.why_not(pty.path, PermissionError(errno.EACCES, 'denied'))
    assert 'a pty of user' in reason.reason
    assert 'sudo' not in reason.remedy


def test_permission_names_user_groups_and_command(tmp_path, monkeypatch):
    monkeypatch.setattr(preflight, '_wrong_kind', lambda *_: None)
    port = tmp_path / 'ttyUSB0'
    port.touch()
    os.chown(port, -1, 20) if os.geteuid() == 0 else None
    reason = preflight.why_not(str(port), PermissionError(errno.EACCES, 'denied'))
    assert reason.kind == 'permission'
    assert 'groups' in reason.reason
    assert 'sudo ' in reason.remedy


def fake_system(root, model, consoles='', cmdline=''):
    for path, text in {'proc/device-tree/model': model, 'proc/consoles': consoles,
                       'proc/cmdline': cmdline}.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    (root / 'dev').mkdir()
    (root / 'dev/ttyAMA10').touch()
    (root / 'dev/serial0').symlink_to('ttyAMA10')
    return root


def test_pi5_debug_header(tmp_path):
    root = fake_system(tmp_path, 'Raspberry Pi 5 Model B Rev 1.0\0')
    [reason] = preflight.warnings(str(root / 'dev/serial0'), root)
    assert 'debug connector' in reason.reason
    assert '/dev/ttyAMA0' in reason.remedy


def test_console_on_the_port(tmp_path):
    root = fake_system(tmp_path, 'Raspberry Pi 4', cmdline='root=/dev/sda console=serial0,115200')
    [reason] = preflight.warnings(str(root / 'dev/ttyAMA10'), root)
    assert reason.kind == 'console'
    assert preflight.warnings(str(root / 'dev/ttyUSB0'), root) == []


def a_process(root, pid, name, **files):
    """Put what /proc tells every user of a process below `root`."""
    process = root / 'proc' / str(pid)
    process.mkdir(parents=True)
    for file, content in {'comm': name + '\n', **files}.items():
        (process / file).write_text(content)
    return process


def test_login_on_the_port(tmp_path):
    with Pty() as pty:
        root = fake_system(tmp_path, 'laptop')
        process = a_process(root, 77777, 'agetty')
        (process / 'fd').mkdir()
        (process / 'fd/0').symlink_to(pty.path)
        [reason] = preflight.warnings(pty.path, root)
    assert 'agetty (pid 77777)' in reason.reason
    assert 'serial-getty' in reason.remedy


@pytest.mark.parametrize('shown', [
    {'cmdline': '/sbin/agetty\0--keep-baud\0ttyAMA0\0vt220\0'},
    {'cmdline': '/sbin/agetty\0-o\0-p -- \\u\0--keep-baud\0-\0vt220\0',      # systemd 252
     'cgroup': '0::/system.slice/system-serial\\x2dgetty.slice/serial-getty@ttyAMA0.service\n'}])
def test_login_of_root_as_a_user_sees_it(tmp_path, shown):
    """Its descriptors are secret then, its command line and control group are not."""
    root = fake_system(tmp_path, 'Raspberry Pi 4')
    a_process(root, 812, 'agetty', **shown)
    [reason] = preflight.warnings('/dev/ttyAMA0', root)
    assert 'agetty (pid 812) offers a login here' in reason.reason
    assert preflight.warnings('/dev/ttyAMA1', root) == []


def test_a_login_is_seen_by_its_controlling_terminal(tmp_path):
    """As every process sees it, under any parent: field 7 of /proc/PID/stat."""
    with Pty() as pty, Pty() as other:
        device = os.stat(pty.path).st_rdev
        number = os.major(device) << 8 | os.minor(device) & 0xFF | os.minor(device) >> 8 << 20
        root = fake_system(tmp_path, 'laptop')
        agetty = a_process(root, 90, 'agetty',
                           stat=f'90 (a) getty) S 1 90 90 {number} 90 4194560 0\n')
        assert preflight.warnings(pty.path, root) == [], 'it may be a pty of a container'
        (agetty / 'root').symlink_to('/')
        [reason] = preflight.warnings(pty.path, root)
        assert 'agetty (pid 90) offers a login here' in reason.reason
        assert preflight.warnings(other.path, root) == []


def test_a_real_process_is_seen_by_its_controlling_terminal(tmp_path):
    """The kernel's own encoding of the number, with every descriptor of the pty closed."""
    code = ('import os, sys; os.setsid(); f = os.open(sys.argv[1], os.O_RDWR); os.close(f); '
            'print(flush=True); sys.stdin.read()')
    with Pty() as pty, subprocess.Popen([sys.executable, '-c', code, pty.path],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert [one.name for one in holders(pty.path)
                if f'(pid {process.pid})' in one.name] != []
        process.stdin.close()


@pytest.mark.parametrize('how', ['open', 'controlling'])
def test_a_pty_of_another_dev_pts_has_other_users(tmp_path, how):
    """Containers number their ptys as this machine does; who uses theirs is innocent here."""
    code = """
import fcntl, os, subprocess, sys, termios
subprocess.run(['mount', '-t', 'devpts', '-o', 'newinstance,ptmxmode=0666', 'none', sys.argv[1]],
               check=True)
wanted, how = sys.argv[2:]
kept = []
while len(kept) // 2 <= int(wanted):
    kept.append(os.open(sys.argv[1] + '/ptmx', os.O_RDWR | os.O_NOCTTY))
    fcntl.ioctl(kept[-1], 0x40045431, bytes(4))        # TIOCSPTLCK
    kept.append(os.open('%s/%d' % (sys.argv[1], len(kept) // 2), os.O_RDWR | os.O_NOCTTY))
if how == 'controlling':
    os.setsid()
    fcntl.ioctl(kept[-1], termios.TIOCSCTTY, 0)
print(os.fstat(kept[-1]).st_rdev, flush=True)
sys.stdin.read()
"""
    command = ['unshare', '-m', '--propagation', 'private', sys.executable, '-c', code,
               str(tmp_path)]
    with Pty() as pty, subprocess.Popen(
            [*command, os.path.basename(pty.path), how], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sandbox:
        said = sandbox.stdout.readline()
        if not said:
            pytest.skip(f'no second devpts: {sandbox.stderr.read().strip()[-200:]}')
        assert int(said) == os.stat(pty.path).st_rdev, 'the same number'
        assert [one.name for one in holders(pty.path) if f'pid {sandbox.pid})' in one.name] == []
        assert preflight.warnings(pty.path) == []
        assert pty.path in strace.ports()
        sandbox.stdin.close()


MAKES = '_, near = os.openpty(); print(os.ttyname(near), flush=True)'
OPENS = 'os.open(sys.argv[1], os.O_NOCTTY); print(flush=True)'


@contextmanager
def opened(path):
    """Let another program have a port open."""
    with pipes(OPENS, path) as other:
        other.stdout.readline()
        yield other


def test_who_made_a_pty_is_in_the_way_only_where_there_is_no_other():
    """A simulated bus holds both ends of its own; 'in use by' names who else is there."""
    def user():
        reason = preflight.why_not(path, OSError(errno.EBUSY, 'busy')).reason
        return int(re.fullmatch(r'in use by \S+ \(pid (\d+)\)', reason)[1])

    with pipes(MAKES) as bus:
        path = bus.stdout.readline().strip()
        assert user() == bus.pid
        assert preflight.warnings(path) == []
        with opened(path) as other:
            assert user() == other.pid
            [reason] = preflight.warnings(path)
    assert reason.kind == 'busy'
    assert re.fullmatch(rf'\S+ \(pid {other.pid}\) has it open too', reason.reason)


def looked(inspection, opening, now_s):
    """Let an inspection look, and return what it complains of."""
    inspection.inspect_if_due(opening, now_s)
    inspection._looked.wait()
    return inspection.complaints


def test_who_opens_a_port_beside_us_is_seen_at_once_and_gone_at_once():
    with Pty() as pty:
        port = open_port(pty.path, 115200)
        inspection = Inspection(pty.path, [])
        assert looked(inspection, 1, 100.0) == []
        with opened(pty.path) as other:
            [line] = looked(inspection, 1, 101.0)
            assert f'(pid {other.pid}) has it open too; stop that program' in line
        assert looked(inspection, 1, 102.0) == []
        port.close()
        port = open_port(pty.path, 115200)                  # ours is left out
        assert looked(inspection, 2, 103.0) == []
        assert looked(inspection, 2, 104.0) == []
        with opened(pty.path):
            assert looked(inspection, 2, 105.0) != []       # the watch is set again
        port.close()


def test_who_opens_a_port_and_cannot_be_named_is_said_all_the_same(monkeypatch):
    """The descriptors of other users' processes are for root alone; some are closed at once."""
    monkeypatch.setattr(preflight, 'holders', lambda path, root: [])
    with Pty() as pty:
        port = open_port(pty.path, 115200)
        inspection = Inspection(pty.path, [])
        assert looked(inspection, 1, 100.0) == []
        with opened(pty.path):
            assert looked(inspection, 1, 101.0) == [
                f'{pty.path}: another program has it open too; sudo fuser -v {pty.path} names '
                'it; stop that program']
        assert looked(inspection, 1, 102.0) == []
        subprocess.run(['sh', '-c', 'echo AT > "$0"', pty.path], check=True)
        [line] = looked(inspection, 1, 103.0)
        assert 'another program opened it for a moment; it may have sent bytes' in line
        assert looked(inspection, 1, 104.9) == [line]
        assert looked(inspection, 1, 105.0) == []
        port.close()


def test_without_a_watch_it_looks_every_30_s(monkeypatch):
    monkeypatch.setattr(port_watch.ctypes, 'CDLL', lambda name: None)
    with Pty() as pty:
        inspection = Inspection(pty.path, [])
        assert looked(inspection, 1, 100.0) == []
        with opened(pty.path):
            assert looked(inspection, 1, 129.9) == []
            [line] = looked(inspection, 1, 130.0)
        assert looked(inspection, 1, 159.9) == [line]
        assert looked(inspection, 1, 160.0) == []


def test_who_listens_with_a_reader_is_named_not_its_reader(tmp_path):
    """A command started the reader, and that is what to stop."""
    with Pty(str(tmp_path / 'bus')) as pty, \
            Program('servobus.tools.dxl_dump', pty.link) as tool:
        wait(lambda: [child for child in tool.children() if 'dxl_reader' in name_of(child)])
        [user] = [one for one in holders(pty.path) if not one.is_maker]
        assert user.name == f'{name_of(tool.pid)} (pid {tool.pid})'
        assert f'in use by {user.name}; stop that program' in str(refusal(pty.path))
        with Program('servobus.tools.dxl_dump', pty.link) as second:
            second.wait_for(f'{pty.link}: in use by {user.name}; stop that program, or hear what '
                            'it does with tap:NAME (dxl_tap NAME -- COMMAND starts it)')
    assert ways_to_hear('/dev/ttyUSB0').startswith('usb:/dev/ttyUSB0 or tap:NAME (')


def name_of(pid):
    return pathlib.Path(f'/proc/{pid}/comm').read_text().strip()


def test_a_port_that_another_program_stopped_takes_bytes():
    """XOFF by tcflow(3), as Ctrl-S on a terminal: the driver keeps it from opening to opening."""
    with Pty() as pty:
        other = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
        termios.tcflow(other, termios.TCOOFF)
        os.close(other)
        listening = open_port(pty.path, 115200, read_only=True)
        again = os.open(pty.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        with pytest.raises(BlockingIOError):        # a listener lets nothing go out
            os.write(again, b'x')
        os.close(again)
        listening.close()
        port = open_port(pty.path, 115200)
        assert port.write(b'stop') == 4
        assert os.read(pty.master, 99) == b'stop'
        port.close()


def pipes(script, *arguments):
    """Start a program that ends with its standard input."""
    return subprocess.Popen([sys.executable, '-c', f'import os, sys; {script}; sys.stdin.read()',
                             *arguments], text=True, stdin=subprocess.PIPE,
                            stdout=subprocess.PIPE)


def test_joined_the_group_after_the_session_began(tmp_path, monkeypatch):
    port = tmp_path / 'ttyUSB0'
    port.touch()
    monkeypatch.setattr(preflight, '_wrong_kind', lambda *_: None)
    monkeypatch.setattr(pwd, 'getpwuid', lambda _: ('robot',))
    monkeypatch.setattr(grp, 'getgrgid', lambda number: grp.struct_group(
        ('dialout', 'x', 20, ['robot']) if number == port.stat().st_gid else
        ('users', 'x', number, [])))
    monkeypatch.setattr(preflight.os, 'getgroups', lambda: [100])
    reason = preflight.why_not(str(port), PermissionError(errno.EACCES, 'denied'))
    assert 'user robot (groups users) may not open it: it belongs to group dialout' \
        in reason.reason
    assert reason.remedy == 'robot joined dialout after this session began: log in again'


def test_dtr_and_rts_are_low_from_the_first_moment(monkeypatch):
    """The kernel raises them in open(2) itself; what pyserial adds is that they stay so."""
    states = []
    for line in ('dtr', 'rts'):
        monkeypatch.setattr(serial.Serial, f'_update_{line}_state', lambda self: states.extend(
            [self._dtr_state, self._rts_state]))
    with Pty() as pty:
        open_port(pty.path, 115200).close()
    assert set(states) == {False}


def test_link_never_replaces_a_file(tmp_path):
    (tmp_path / 'precious').write_text('data')
    with pytest.raises(OSError, match='another path'):
        Pty(str(tmp_path / 'precious'))
    assert (tmp_path / 'precious').read_text() == 'data'


def test_backoff():
    backoff = Backoff()
    assert [backoff.next() for _ in range(6)] == [0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    backoff.reset()
    assert backoff.next() == 0.2


@pytest.mark.parametrize(('size', 'pending'), [(56, 0), (84, 84)])
def test_what_a_peer_does_not_confirm_is_pending_and_dropped_with_the_connection(size, pending):
    """Two frames may wait: many confirm each second one only."""
    with socket.create_server(('127.0.0.1', 0)) as server:
        port = open_port(f'socket://127.0.0.1:{server.getsockname()[1]}', 115200)
        peer, _ = server.accept()
        with peer, mute(port.fd):
            assert port.write(bytes(size)) == size
            assert port.pending() == pending
            with pytest.raises(PortError, match='the peer does not confirm any byte'):
                port.drop_output()
        port.close()


def test_a_terminal_server_carries_all_bytes_the_rate_and_its_end():
    with Pty() as pty, TerminalServer(pty.path) as server:
        os.set_blocking(pty.master, True)
        port = open_port(server.url, 1_000_000)
        assert port.fd is None
        assert server.tty.baudrate == 1_000_000
        every = bytes(range(256))           # 0xFF is Telnet's escape
        assert port.write(every) == 256
        got = b''
        while len(got) < 256:
            got += os.read(pty.master, 256)
        assert got == every
        os.write(pty.master, every)
        got = b''
        while len(got) < 256:
            assert port.wait(20)
            got += port.read()
        assert got == every
        assert port.read() == b''
        server.hang_up()
        with pytest.raises(PortError) as caught:
            port.wait(20)
        assert caught.value.kind == 'lost'
        port.close()


def test_what_a_terminal_server_does_not_confirm_is_dropped_with_the_connection():
    with Pty() as pty, TerminalServer(pty.path) as server:
        port = open_port(server.url, 115200)
        assert port.pending() == 0
        with mute(port._socket):
            port.write(bytes(84))
            assert port.pending() == 84
            with pytest.raises(PortError, match='the peer does not confirm any byte'):
                port.drop_output()
        port.close()


def test_what_is_no_terminal_server_says_so():
    with socket.create_server(('127.0.0.1', 0)) as server:
        error = refusal(f'rfc2217://127.0.0.1:{server.getsockname()[1]}?timeout=0.1')
    assert 'does not seem to support RFC2217' in error.reason
    assert 'a plain TCP port is socket://' in error.remedy


@contextmanager
def mute(fd):
    """Let nothing out of a socket: what is written to it waits there."""
    with socket.socket(fileno=os.dup(fd)) as own:
        own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 0)
        own.setsockopt(socket.IPPROTO_TCP, socket.TCP_CORK, 1)
        yield
