# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Switch: what keeps commands switched off over a restart: a file that is there while they are.

A rover that somebody works on must not drive because its bridge was restarted.
"""
from __future__ import annotations

from contextlib import suppress
import os


def is_kept_off(path: str) -> bool:
    """Tell whether commands were switched off when the last bridge ended; path '' = not kept."""
    return bool(path) and os.path.lexists(path)


def keep(path: str, is_on: bool) -> str:
    """Keep whether commands are taken; return why that cannot be, '' when it is done."""
    if not path:
        return ''
    try:
        if is_on:
            with suppress(FileNotFoundError):
                os.unlink(path)
        else:
            fd = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
            try:
                os.fsync(fd)
            finally:
                os.close(fd)
    except OSError as error:
        what = 'commands may be refused' if is_on else 'commands will be accepted'
        return (f'{path}: {error.strerror}, so {what} after a restart; set disabled_file to a '
                'file in a folder that this user may write to')
    return ''
