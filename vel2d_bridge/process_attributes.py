# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What this process is called, and what the kernel is to do for it."""
from contextlib import suppress
import ctypes
from pathlib import Path

_ARG_START, _ARG_END = 45, 46      # fields of /proc/PID/stat after the name; see proc(5)

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36     # linux/prctl.h


def prctl(option: int, value: int) -> None:
    """Set an attribute of this process, as in the manual page of that name."""
    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def rename_process(name: str) -> None:
    """
    Set the name of this process in ps, pgrep and pkill, also where these read its command line.

    It overwrites the command line of this process alone. Never raises.
    """
    with suppress(OSError, ValueError, IndexError):
        Path('/proc/self/comm').write_text(name)
        fields = Path('/proc/self/stat').read_text().rpartition(')')[2].split()
        start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
        with open('/proc/self/mem', 'r+b', buffering=0) as memory:
            memory.seek(start)
            memory.write(name.encode()[:end - start - 1].ljust(end - start, b'\0'))
