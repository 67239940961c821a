# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The version of what runs, for --version."""
from __future__ import annotations

from importlib import metadata
from pathlib import Path
import subprocess

PACKAGE = 'mecarover_serial'


def version_of(tool: str) -> str:
    """Return `tool (mecarover_serial) VERSION`, with the commit where it runs from a clone."""
    try:
        version = metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:
        version = 'not installed'
    root = Path(__file__).resolve().parents[1]
    if (root / '.git').exists():
        try:
            done = subprocess.run(['git', '-C', root, 'rev-parse', '--short', 'HEAD'],
                                  capture_output=True, text=True, check=True)
            version += f', commit {done.stdout.strip()}'
        except (OSError, subprocess.CalledProcessError):     # no git, or not our clone
            pass
    return f'{tool} ({PACKAGE}) {version}'
