# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Where a fake makes a Unix socket: in place of one that a killed process left, of no other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
import os
from pathlib import Path
import socket
import struct

from servobus.errors import UsageError
from servobus.port.port_users import process_name

_UCRED = struct.Struct('3i')           # process, user and group at the other end, see unix(7)


@contextmanager
def new_socket(path: str, option: str) -> Iterator[None]:
    """Let a socket be bound to a path that an option gives; UsageError if that is impossible."""
    try:
        _remove_left(path, option)
        yield
    except OSError as error:
        raise UsageError(f'{option} {path}: {error.strerror or error}; '
                         'give the path of a new file') from None


def _remove_left(path: str, option: str) -> None:
    """Remove a socket at which no process accepts connections; UsageError if one does."""
    if not Path(path).is_socket():
        return
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            with suppress(BlockingIOError):         # so many wait to be accepted
                probe.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)
            return
        process, _, _ = _UCRED.unpack(
            probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size))
    # 0: in another container, or not connected.
    user = process_name(Path(f'/proc/{process}')) if process else 'another process'
    raise UsageError(f'{option} {path}: in use by {user}; stop that program, or give another path')
