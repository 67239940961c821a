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


def why_not_kept(path: str) -> str:
    """Return why the file could not be made, before there is a need for it; '' where it can."""
    folder = os.path.dirname(os.path.abspath(path))
    if not path or os.access(folder, os.W_OK | os.X_OK):
        return ''
    return _problem(path, f'the folder {folder} is not there, or this user may not write to it',
                    'commands that are switched off will be accepted')


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
        return _problem(path, error.strerror, what)
    return ''


def _problem(path: str, reason: str | None, what: str) -> str:
    return (f'{path}: {reason}, so {what} after a restart; set disabled_file to a file in a '
            'folder that this user may write to')
