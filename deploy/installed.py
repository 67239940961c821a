# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Where the package is installed, and the command line with which systemd starts a node of it."""
from __future__ import annotations

import os
from pathlib import Path
import re
import sys

from device_names import InstallError

NAME = 'mecarover_serial'
ROOT = Path(__file__).resolve().parents[1]


def command(node: str, prefix: Path | None = None, setup: Path | None = None) -> str:
    """Return the value of ExecStart= without arguments; finds prefix and setup if not given."""
    prefix = _prefix(node, prefix)
    executable = next(path for path in _executables(prefix, node) if path.exists())
    setup = setup or _setup(prefix)
    if re.search(r'[\s%"\'\\$]', f'{executable}{setup}'):
        raise InstallError(f'{executable}: systemd would misread this path; install the package '
                           'below a path of plain letters')
    if setup is None:
        return str(executable)
    return f"/bin/bash -c 'source \"$$0\" && exec \"$$@\"' {setup} {executable}"


def _prefix(node: str, given: Path | None) -> Path:
    places = [*os.environ.get('AMENT_PREFIX_PATH', '').split(':'),
              os.environ.get('VIRTUAL_ENV', ''), sys.prefix, str(ROOT / '.venv')]
    candidates = [given] if given else [Path(text) for text in places if text]
    for prefix in candidates:
        if any(path.exists() for path in _executables(prefix, node)):
            return prefix
    raise InstallError(
        f'{node}: not found below {", ".join(map(str, candidates))}; source '
        'install/setup.bash of your workspace, or give --prefix')


def _executables(prefix: Path, node: str) -> tuple[Path, ...]:
    found = prefix / 'lib' / NAME / node, prefix / 'bin' / node
    # What lies in lib/ takes the python3 of its PATH, and a service has not that of a venv.
    return found[::-1] if (prefix / 'pyvenv.cfg').exists() else found


def _setup(prefix: Path) -> Path | None:
    """Find what has to be sourced; None where the wheels of a venv need nothing."""
    if (prefix / 'pyvenv.cfg').exists():
        ros = Path(f'/opt/ros/{os.environ.get("ROS_DISTRO", "none")}/setup.bash')
        return ros if ros.exists() else None
    return next((path for path in (prefix.parent / 'setup.bash', prefix / 'setup.bash')
                 if path.exists()), None)
