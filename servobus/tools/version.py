# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which package holds what runs, and its version, for --version."""
from __future__ import annotations

from importlib import metadata
from pathlib import Path
import subprocess
import sys

PACKAGES = ('mecarover_serial', 'dxl-doctor')      # each holds servobus: setup.py, packaging/
ROOT = Path(__file__).resolve().parents[2]


def version_of(tool: str) -> str:
    """Return `tool (PACKAGE) VERSION`, with the commit where it runs from a clone."""
    package, version = _holder()
    if (ROOT / '.git').exists():
        try:
            done = subprocess.run(['git', '-C', ROOT, 'rev-parse', '--short', 'HEAD'],
                                  capture_output=True, text=True, check=True)
            version += f', commit {done.stdout.strip()}'
        except (OSError, subprocess.CalledProcessError):     # no git, or not our clone
            pass
    return f'{tool} ({package}) {version}'


def _holder() -> tuple[str, str]:
    """Return the package that holds this file, and its version."""
    for path in ([str(ROOT)], sys.path):    # in the same folder; of a clone it is anywhere
        for package in PACKAGES:
            for found in metadata.distributions(name=package, path=path):
                return package, found.version
    return PACKAGES[0], 'not installed'
