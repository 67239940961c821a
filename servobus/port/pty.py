# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A raw pty with a stable name: the cable between a fake device and the node under test.

The fake holds the master; the program that opens `path` (or `link`) is the host. A pty takes about
17 KiB and then blocks its writer, has no modem lines, and runs at any rate that is set.
"""
from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
from pathlib import Path
import select
import signal
import time
import tty

from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.port.port_users import holders

_OUTLIVE_MAX_S = 4.0            # launch kills what has not ended after 5 s
_CHECK_EVERY_S = 0.05


def outlive(path: str, work: Callable[[float], object] = time.sleep) -> None:
    """
    Go on until no other process has the pty `path` open, for 4 s at most; signals are ignored.

    Ctrl-C in a terminal ends all programs of a demo at once: a fake that ends first is a cable
    that was pulled out, and the node says so. `work(s)` is called again and again.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    deadline = time.monotonic() + _OUTLIVE_MAX_S
    while holders(path) and time.monotonic() < deadline:
        work(_CHECK_EVERY_S)


def _refuse_used_link(link: Path) -> None:
    """Raise PortError when a living process has made the pty to which a link points."""
    with suppress(OSError):
        # What a killed process left is older than the pty that has got the same number since.
        if link.lstat().st_mtime_ns < link.stat().st_ctime_ns:
            return
        for user in holders(str(link)):
            if user.is_maker:
                raise PortError(str(link), Reason('busy', f'in use by {user.name}',
                                                  'stop that program, or give another path'))


class Pty:
    """A pty pair; `master` is a non-blocking descriptor, `path` the name of the other end."""

    def __init__(self, link: str | None = None) -> None:
        self.link = link
        if link is not None:
            _refuse_used_link(Path(link))
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)
        if link is not None:
            self._place_link(Path(link))

    def _place_link(self, link: Path) -> None:
        """Point `link` at the pty; a symlink left over is replaced, a real file never."""
        if link.is_symlink():
            link.unlink()
        try:
            link.symlink_to(self.path)
        except OSError as error:
            self.link = None
            self.close()
            raise OSError(error.errno, f'{link}: cannot be made a symlink to the pty '
                          f'({error.strerror}); give another path') from error

    def let_go(self) -> None:
        """Hold the other end open no longer, so that is_open says whether somebody else does."""
        os.close(self._slave)
        self._slave = -1

    @property
    def is_open(self) -> bool:
        """Whether somebody has the other end open."""
        poll = select.poll()
        poll.register(self.master, 0)
        return not poll.poll(0)

    def close(self) -> None:
        """Hang up, as an adapter that is unplugged: the other end reads EIO, the link goes."""
        if self.link is not None and os.path.islink(self.link) \
                and os.readlink(self.link) == self.path:
            os.unlink(self.link)
        for fd in (self.master, self._slave):
            with suppress(OSError):
                os.close(fd)
        self.master = self._slave = -1

    def __enter__(self) -> Pty:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
