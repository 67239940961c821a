# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What Fast DDS does not survive, looked at before it starts: no shared memory, a wrong domain."""
from __future__ import annotations

from contextlib import suppress
import os
import sys

_SHARED_MEMORY = '/dev/shm'
_ROOM_MIN_BYTES = 4_000_000     # a participant takes 0.5 MB and something for each port
_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
DOMAIN_ID_MAX = 232             # its UDP ports end at 65535 (DDSI-RTPS, default port numbers)


def avoid_full_shared_memory(name: str) -> None:
    """Have Fast DDS do without shared memory where there is no room: it would die of SIGBUS."""
    with suppress(OSError):
        room = os.statvfs(_SHARED_MEMORY)
        if room.f_bavail * room.f_frsize < _ROOM_MIN_BYTES and _TRANSPORTS not in os.environ:
            os.environ[_TRANSPORTS] = 'UDPv4'
            print(f'{name}: {_SHARED_MEMORY}: is full, so messages go over the network only; make '
                  'room there and start again', file=sys.stderr, flush=True)


def domain_problem(text: str) -> str:
    """Return what is wrong with a ROS_DOMAIN_ID, '' where it is possible: else it just ends."""
    if not text or (text.isdecimal() and int(text) <= DOMAIN_ID_MAX):
        return ''
    return f'ROS_DOMAIN_ID={text}: not possible; set a number from 0 to {DOMAIN_ID_MAX}'
