# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The keys that somebody presses at the terminal of this process, without waiting for one."""
from __future__ import annotations

from contextlib import suppress
import os
import re
import sys
import termios

from servobus.port.readable import readable

_NAMES = {'\033[A': 'UP', '\033[B': 'DOWN', '\033OA': 'UP', '\033OB': 'DOWN',
          '\033[5~': 'PAGE_UP', '\033[6~': 'PAGE_DOWN'}
_KEY = re.compile(r'\033[\[O][\d;]*[A-Za-z~]|.', re.DOTALL)


class Keyboard:
    """Keys of stdin, one by one, if that is a terminal which is ours now, and it is wanted."""

    def __init__(self, is_wanted: bool) -> None:
        self._before: list[int | list[bytes | int]] | None = None
        with suppress(OSError, ValueError, termios.error):
            self._fd = sys.stdin.fileno()
            if is_wanted and os.tcgetpgrp(self._fd) == os.getpgrp():
                settings = termios.tcgetattr(self._fd)
                self._before = list(settings)
                settings[3] &= ~(termios.ICANON | termios.ECHO)
                termios.tcsetattr(self._fd, termios.TCSADRAIN, settings)

    @property
    def is_on(self) -> bool:
        return self._before is not None

    def pressed(self) -> list[str]:
        """Return the keys pressed since the last call: characters, or the names above."""
        if self._before is None or not readable([self._fd], 0.0):
            return []
        text = os.read(self._fd, 200).decode(errors='replace')
        return [_NAMES.get(key, key) for key in _KEY.findall(text)]

    def close(self) -> None:
        """Give the terminal back as it was."""
        if self._before is not None:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
            self._before = None
