# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with what a user gives. str() of each is one line: 'thing: reason; remedy'."""


class ServobusError(Exception):
    """Any error of this library; errors of files and sockets stay OSError."""


class ParameterError(ServobusError):
    """A value that a parameter or setting cannot have."""


class UsageError(ServobusError):
    """A command line, or a source of bytes, that makes no sense."""
