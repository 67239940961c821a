# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Wait for descriptors of any number: select() fails at those above 1023."""
from __future__ import annotations

from collections.abc import Iterable
import math
import select


def readable(fds: Iterable[int], timeout_s: float) -> list[int]:
    """Wait until one can be read or has hung up; return all that can."""
    return _ready(fds, select.POLLIN, timeout_s)


def is_writable(fd: int, timeout_s: float) -> bool:
    """Wait until it can be written to or has hung up."""
    return bool(_ready([fd], select.POLLOUT, timeout_s))


def _ready(fds: Iterable[int], events: int, timeout_s: float) -> list[int]:
    poll = select.poll()
    for fd in fds:
        poll.register(fd, events)
    return [fd for fd, _ in poll.poll(max(0, math.ceil(timeout_s * 1000)))]
