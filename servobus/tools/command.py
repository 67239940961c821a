# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Where every command begins: `from servobus.tools.command import dxl_dump`.

From then on Ctrl-C ends it without a traceback: while modules are imported nothing is open yet,
and the process just leaves. `cli` takes the signal over when there is something to close.
"""
from __future__ import annotations

from collections.abc import Mapping
import os
import signal
import sys

COMMANDS = {
    'dxl_dump': 'servobus.tools.dxl_dump',
    'dxl_doctor': 'servobus.tools.dxl_doctor',
    'dxl_replay': 'servobus.tools.replay',
    'dxl_tap': 'servobus.tools.tap',
}


def __getattr__(name: str) -> object:
    return begin(COMMANDS, name)


def begin(commands: Mapping[str, str], name: str) -> object:
    """Return the main function of a command; commands: the module of each."""
    if name not in commands:
        raise AttributeError(name)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:     # nohup: it is ignored
        signal.signal(signal.SIGINT, leave)
    from importlib import import_module
    try:
        return import_module(commands[name]).main
    except ModuleNotFoundError as error:    # e.g. pip uninstall crcmod takes files of crcmod-plus
        sys.exit(f'{name}: {error}; pip install --force-reinstall crcmod-plus pyserial PyYAML, or '
                 'sudo apt install --reinstall python3-crcmod python3-serial python3-yaml')


def leave(number: int, frame: object) -> None:
    """End the process at once; a signal that ends a command is no failure."""
    os._exit(0)


def take_over() -> bool:
    """Let Ctrl-C raise KeyboardInterrupt from now on; return whether it made us leave before."""
    if signal.getsignal(signal.SIGINT) is not leave:
        return False
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return True
