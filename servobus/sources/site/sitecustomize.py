# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Python runs this at its start, because dxl_tap put this folder into PYTHONPATH.

It begins the tap, then runs the sitecustomize that would have been run without it. Nothing here
may keep the program from starting.
"""

from contextlib import suppress
import importlib.machinery
import importlib.util
import os
import sys
from typing import Any

_HERE = os.path.dirname(os.path.abspath(__file__))


def _load(name: str) -> Any:
    """Return a module of the folder above, which is not on the path."""
    file = os.path.join(os.path.dirname(_HERE), name + '.py')
    spec = importlib.util.spec_from_file_location('mecarover_' + name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _begin() -> None:
    name = os.environ.get('MECAROVER_TAP')
    if name:
        _load('tap_pyserial').install(_load('tap_sender').Sender(name))


def _run_the_other() -> None:
    """Run the next sitecustomize on the path; an error in it is shown as Python shows it."""
    others = [path for path in sys.path if os.path.abspath(path or '.') != _HERE]
    spec = importlib.machinery.PathFinder.find_spec('sitecustomize', others)
    if spec is not None and spec.loader is not None:
        module = importlib.util.module_from_spec(spec)
        sys.modules['sitecustomize'] = module
        spec.loader.exec_module(module)


with suppress(Exception):
    _begin()
_run_the_other()
