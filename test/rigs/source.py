# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A copy of this clone, as it would be committed now."""
from pathlib import Path
import shutil
import subprocess

ROOT = Path(__file__).parents[2]


def copy_source(target):
    """Copy what git knows of this clone, and what it would add, to a folder."""
    names = subprocess.run(
        ['git', '-C', str(ROOT), 'ls-files', '-z', '--cached', '--others', '--exclude-standard'],
        capture_output=True, check=True).stdout.decode().split('\0')
    for name in names:
        if name and ((ROOT / name).is_file() or (ROOT / name).is_symlink()):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target / name, follow_symlinks=False)
