# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Text of others, safe to show: a file, a device, a topic, a process may put control codes into it.

Where it comes in, `printable` makes one line of it; the streams of a tool let nothing else out.
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import re
import sys
from typing import Any
from typing import TextIO

_OURS = re.compile(r'(\n|\033\[[\d;]*m)')     # ends of lines and colours


def printable(text: str, limit: int | None = None) -> str:
    """Return a text from outside in a form safe for a terminal: one line, no control codes."""
    if limit is not None and len(text) > limit:
        text = text[:limit] + '..'
    return text if text.isprintable() else ''.join(
        character if character.isprintable() else '\ufffd' for character in text)


def plain(text: str) -> str:
    """Return text to print without any control code but ends of lines and colours."""
    if text.isprintable() or (text[-1] == '\n' and text[:-1].isprintable()):
        return text
    return ''.join(part if at % 2 else printable(part)
                   for at, part in enumerate(_OURS.split(text)))


class _PlainStream:
    """stdout or stderr for `plain` text; `screen` is for what moves the cursor."""

    def __init__(self, screen: TextIO) -> None:
        self.screen = screen

    def write(self, text: str) -> int:
        return self.screen.write(plain(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.screen, name)


@contextmanager
def plain_streams() -> Iterator[None]:
    """Let `plain` text only through stdout and stderr."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        stream and _PlainStream(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def on_screen(stream: TextIO, text: str) -> None:
    """Write what moves the cursor; the words in it are `plain`."""
    screen = getattr(stream, 'screen', stream)
    screen.write(text)
    screen.flush()
