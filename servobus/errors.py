# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with what a user gives. str() of each is one line: 'thing: reason; remedy'."""
from __future__ import annotations

from collections.abc import Collection


class ServobusError(Exception):
    """Any error of this library; errors of files and sockets stay OSError."""


class ParameterError(ServobusError):
    """A value that a parameter or setting cannot have."""


class UsageError(ServobusError):
    """A command line, or a source of bytes, that makes no sense."""


class NothingHeardError(ServobusError):
    """A source that was listened to, and that gave no byte."""


class ClosedError(ServobusError):
    """A source that is used after the end of its block."""


def did_you_mean(name: str, names: Collection[str]) -> str:
    """Return the remedy for a name that is none of `names`: the nearest of them, or all."""
    near = nearest(name, names)
    return f'did you mean {near}?' if near else f'there are: {", ".join(names)}'


def nearest(name: str, names: Collection[str]) -> str:
    """Return the one of `names` that is most like `name`, '' if none is."""
    import difflib  # few runs need it
    return next(iter(difflib.get_close_matches(name, names, 1)), '')
