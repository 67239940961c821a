# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Open a serial port the way a robot needs it, by path or pyserial URL, and say why when it fails.

Exclusive (flock against other pyserial users, TIOCEXCL against everybody but root), DTR and RTS
low, HUPCL cleared so that closing resets no board, descriptor non-blocking. pyserial sets rate
and options; reading and writing then goes to the descriptor. What a socket could only deliver
late, it never delivers: the connection is dropped with it.
"""
from __future__ import annotations

import array
from contextlib import suppress
import errno
import fcntl
import os
import socket
import stat
import struct
import termios
import time
from typing import Any
from urllib.parse import urlsplit

import serial

from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.preflight import why_not
from servobus.port.readable import readable
from servobus.worker import MORE_TASKS

_READ_SIZE = 65536
RETRY_FIRST_S = 0.2             # after a port could not be opened
_POLL_S = 0.005                 # ports without a descriptor (rfc2217://, loop://) are polled
_URL_WRITE_TIMEOUT_S = 0.05     # they may block; a descriptor never does
_BAUD_TOLERANCE = 0.03          # a UART still understands its peer 3 % off
_UNCONFIRMED_MAX = 64           # bytes: many a peer confirms only each second frame, or 40 ms late
_NETWORK_AWAY_MS = 1000         # the kernel drops the connection then, also of a dead process
_DROP_AT_CLOSE = struct.pack('ii', 1, 0)    # struct linger
_TCGETS2 = 0x802C542A
_TERMIOS2_OSPEED = 10           # index of c_ospeed in struct termios2, in 32-bit words


def as_port_error(name: str, error: Exception) -> PortError:
    """Return the message for any error of the port `name`, a bug in a program too."""
    if isinstance(error, PortError):
        return error
    return PortError(name, Reason('other', f'{type(error).__name__}: {error}',
                                  'an error in this program; please report it'))


class Port:
    """An open port. Every method raises PortError (kind 'lost') when the port has gone."""

    def __init__(self, name: str, device: Any) -> None:
        self.name = name
        self._device = device
        try:
            self.fd: int | None = device.fileno()
        except OSError:         # io.UnsupportedOperation: a URL without a descriptor
            self.fd = None
        self.is_tty = self.fd is not None and os.isatty(self.fd)
        self._ahead = b''       # read by `wait`, where there is no descriptor to ask
        self._socket = self._own_socket()
        if self._socket is not None:
            _settle_socket(self._socket)

    def _own_socket(self) -> int | None:
        """Return the descriptor of the network connection; rfc2217:// has one that it hides."""
        if self.fd is None:
            connection = getattr(self._device, '_socket', None)
            return connection.fileno() if isinstance(connection, socket.socket) else None
        return self.fd if stat.S_ISSOCK(os.fstat(self.fd).st_mode) else None

    def wait(self, timeout_s: float, wake_fd: int | None = None) -> bool:
        """Wait until there is something to read (True), `wake_fd` is readable, or the time-out."""
        wake = [] if wake_fd is None else [wake_fd]
        if self.fd is not None:
            return self.fd in readable([self.fd, *wake], timeout_s)
        deadline = time.monotonic() + timeout_s
        while not self._ahead:
            self._ahead = self.read()
            left = deadline - time.monotonic()
            if not self._ahead and (left <= 0 or readable(wake, min(left, _POLL_S))):
                return False
        return True

    def read(self) -> bytes:
        """Return what is there, b'' when nothing is."""
        if chunk := self._ahead:
            self._ahead = b''
            return chunk
        try:
            if self.fd is None:         # only a read says that the port has gone
                return bytes(self._device.read(max(1, self._device.in_waiting)))
            chunk = os.read(self.fd, _READ_SIZE)
        except BlockingIOError:
            return b''
        except (OSError, serial.SerialException) as error:
            raise self.lost(error) from error
        if not chunk:
            raise self.lost(OSError(errno.ENODEV, 'end of file'))
        return chunk

    def write(self, data: bytes) -> int:
        """Write what the port takes at once and return how many bytes that were."""
        try:
            if self.fd is None:
                return int(self._device.write(data) or 0)
            return os.write(self.fd, data)
        except (BlockingIOError, serial.SerialTimeoutException):
            return 0
        except (OSError, serial.SerialException) as error:
            raise self.lost(error) from error

    def pending(self) -> int:
        """
        Return how many written bytes have not left yet; 0 where the port cannot tell.

        Of a socket: that its peer has not confirmed, if these are more than it may be late with.
        """
        fd = self.fd if self.is_tty else self._socket
        if fd is None:
            return 0
        count = array.array('i', [0])
        try:
            fcntl.ioctl(fd, termios.TIOCOUTQ, count)
        except OSError as error:
            raise self.lost(error) from error
        return 0 if not self.is_tty and count[0] <= _UNCONFIRMED_MAX else count[0]

    def drop_output(self) -> None:
        """Throw away what was written and has not left yet; a socket is lost with it."""
        if self._socket is not None:
            with socket.socket(fileno=os.dup(self._socket)) as own:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _DROP_AT_CLOSE)
            raise PortError(self.name, Reason(
                'lost', 'lost (the peer does not confirm any byte)',
                'check the network; raise write_timeout where it is slow'))
        if self.is_tty:
            try:
                termios.tcflush(self.fd or 0, termios.TCOFLUSH)
            except termios.error as error:
                raise self.lost(OSError(*error.args)) from error

    def close(self) -> None:
        """Close the port; never raises, also when the device has gone."""
        if self.is_tty:         # else it stays exclusive while a fake holds the other end
            with suppress(OSError):
                fcntl.ioctl(self.fd or 0, termios.TIOCNXCL)
        self.is_tty, self._socket = False, None
        with suppress(OSError, serial.SerialException, termios.error):
            self._device.close()

    def lost(self, error: Exception) -> PortError:
        """Return what to raise when reading or writing has failed with `error`."""
        number = getattr(error, 'errno', None)
        text = os.strerror(number) if number else str(error)
        return PortError(self.name, Reason(
            'lost', f'lost ({text})', 'check plug and power; the port is opened again when it is '
            'back'))


def open_port(path_or_url: str, baud: int, *, read_only: bool = False) -> Port:
    """
    Open a port exclusively at `baud` (bit/s), non-blocking; raise PortError when that fails.

    `read_only`: the descriptor itself is O_RDONLY, so that the kernel refuses every write.
    """
    device = _configured(path_or_url, baud)
    try:
        port = Port(path_or_url, device)
        if port.is_tty and port.fd is not None:
            _check_rate(path_or_url, port.fd, baud)
            _settle(port.fd, read_only)
            if not read_only:           # a program before us may have stopped it, as by Ctrl-S
                termios.tcflow(port.fd, termios.TCOON)
    except (OSError, termios.error) as error:
        device.close()
        raise PortError(path_or_url, why_not(path_or_url, OSError(*error.args[:2]))) from error
    except PortError:
        device.close()
        raise
    return port


def _configured(path_or_url: str, baud: int) -> Any:
    """Return the open pyserial object of a path or URL."""
    try:
        if baud <= 0:           # 0 would hang up
            raise ValueError('a baud rate must be positive')
        url = urlsplit(path_or_url)
        if url.scheme in ('socket', 'rfc2217') and url.port is None:
            raise ValueError('it has no port number')
        device = serial.serial_for_url(path_or_url, do_not_open=True)
        device.baudrate = baud
        device.timeout = 0
        if not path_or_url.lower().startswith('rfc2217://'):    # it refuses to have one
            device.write_timeout = _URL_WRITE_TIMEOUT_S
        device.dtr = False
        device.rts = False
        if type(device) is serial.Serial:
            device.exclusive = True
        device.open()
    except (OSError, serial.SerialException, termios.error) as error:
        raise PortError(path_or_url, why_not(path_or_url, error)) from error
    except RuntimeError as error:   # rfc2217:// has a thread
        raise PortError(path_or_url, Reason('other', str(error), MORE_TASKS)) from error
    except Exception as error:      # pyserial: the rate, or a URL that it fails to take apart
        raise PortError(path_or_url, _bad_setting(path_or_url, baud, error)) from error
    return device


def _bad_setting(path_or_url: str, baud: int, error: Exception) -> Reason:
    if '://' in path_or_url and 'baud' not in str(error).lower():
        return Reason('url', f'not a URL that pyserial knows ({error})',
                      'use a path such as /dev/ttyUSB0 or socket://HOST:PORT')
    return Reason('baud', f'does not support {baud} baud '
                          f'({error})', 'set a rate that the adapter supports')


def _check_rate(name: str, fd: int, baud: int) -> None:
    """Raise PortError when the driver silently chose another rate, as some adapters do."""
    raw = bytearray(44)
    try:
        fcntl.ioctl(fd, _TCGETS2, raw)
    except OSError:
        return
    actual = struct.unpack_from('11I', raw)[_TERMIOS2_OSPEED]
    if actual and abs(actual - baud) > _BAUD_TOLERANCE * baud:
        # What a driver falls back to (9600, or the old rate) says nothing of the highest one.
        raise PortError(name, Reason(
            'baud', f'the driver sets {actual} baud, not the {baud} that was asked for',
            'set a rate that the adapter supports'))


def _settle(fd: int, read_only: bool) -> None:
    """Keep others out, keep the board from resetting at close, and drop the right to write."""
    attributes = termios.tcgetattr(fd)
    attributes[2] &= ~termios.HUPCL
    # pyserial's VMIN = 0 makes "nothing there" and "gone" look the same: both read as b''.
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    if read_only:
        # The same device again through its descriptor: no path is looked up a second time.
        reader = os.open(f'/proc/self/fd/{fd}', os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        os.dup2(reader, fd, inheritable=False)
        os.close(reader)
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.ioctl(fd, termios.TIOCEXCL)


def _settle_socket(fd: int) -> None:
    """Send at once, and let nothing that is old be delivered when the network is back."""
    with suppress(OSError), socket.socket(fileno=os.dup(fd)) as own:    # not all are TCP
        own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        own.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _NETWORK_AWAY_MS)


class Backoff:
    """Waiting times between attempts: doubling from RETRY_FIRST_S to `last_s`."""

    def __init__(self, last_s: float = 2.0) -> None:
        self._last_s = last_s
        self._next_s = RETRY_FIRST_S

    def next(self) -> float:
        """Return how long to wait (s) before the next attempt."""
        wait_s = self._next_s
        self._next_s = min(2 * wait_s, self._last_s)
        return wait_s

    def reset(self) -> None:
        """Begin again with the shortest time, after a success."""
        self._next_s = RETRY_FIRST_S
