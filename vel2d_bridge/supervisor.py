# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Supervisor: the first process of a container outlives the bridge, so that the dead man can stop.

When the first process of a PID namespace ends, the kernel kills all others in it at once, the
dead man too. So a bridge that would be that process (`docker run`), or that has a parent that ends
with it (`docker run --init`), runs as a child; the process here forwards signals and waits.
"""
from __future__ import annotations

from contextlib import suppress
import os
import signal
import time

from vel2d_bridge.deadman_server import NAME
from vel2d_bridge.process_attributes import rename_process

OUTLIVE_S = 1.0                    # for the dead man: its six zeros take 0.4 s
_MACHINE_NAMESPACE = 0xEFFFFFFC    # the inode of the first PID namespace: PROC_PID_INIT_INO
_CHECK_S = 0.1
_FORWARDED = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP,
              signal.SIGCONT, signal.SIGUSR1, signal.SIGUSR2}


def supervise() -> int | None:
    """Return None in the bridge itself; in its supervisor, at the end, its exit code."""
    if not _is_needed():
        return None
    bridge = os.fork()
    if bridge == 0:
        return None
    rename_process(NAME)           # `pkill -f vel2d_bridge` is meant for the bridge
    signal.pthread_sigmask(signal.SIG_BLOCK, {*_FORWARDED, signal.SIGCHLD})
    status = _await_bridge_end(bridge)
    if status != 0:
        time.sleep(OUTLIVE_S)
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


def _is_needed() -> bool:
    if os.getpid() == 1:
        return True
    return os.getppid() == 1 and os.stat('/proc/self/ns/pid').st_ino != _MACHINE_NAMESPACE


def _await_bridge_end(bridge: int) -> int:
    """Forward signals and reap orphans until the bridge ends; return its wait status."""
    while True:
        found = signal.sigtimedwait({*_FORWARDED, signal.SIGCHLD}, _CHECK_S)
        if found is not None and found.si_signo != signal.SIGCHLD:
            with suppress(ProcessLookupError):
                os.kill(bridge, found.si_signo)
        while ended := _reap():
            if ended[0] == bridge:
                return ended[1]


def _reap() -> tuple[int, int] | None:
    """Return pid and wait status of a child that has ended, if one has."""
    try:
        pid, status = os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return None
    return (pid, status) if pid else None
