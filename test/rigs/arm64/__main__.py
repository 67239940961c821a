# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Build the root where there is none, then run the tests without ROS in it.

usage: scripts/python -m rigs.arm64 [PYTEST OPTION ...]
"""
import os
from pathlib import Path
import subprocess
import sys
import tempfile

from rigs.arm64.left_out import LEFT_OUT
from rigs.arm64.root import root
from rigs.debian import Missing
from rigs.debian import PIP
from rigs.source import copy_source

ENTER = Path(__file__).with_name('enter.sh')
# As scripts/test does, two workers by file.
PYTEST = ('python3', '-m', 'pytest', '-n', '2', '--dist', 'loadfile', '--no-loadscope-reorder',
          '-p', 'no:cacheprovider', '-m', 'not ros')


def main(options):
    try:
        place = root()
    except Missing as error:
        print(f'test-arm64: {error}', file=sys.stderr)
        return 1
    for reason, tests in LEFT_OUT.items():
        print(f'test-arm64: left out, {reason}:')
        print(*(f'    {test}' for test in tests), sep='\n', flush=True)
    left_out = [f'--deselect={test}' for tests in LEFT_OUT.values() for test in tests]
    os.nice(10)
    with tempfile.TemporaryDirectory(prefix='arm64_') as folder:
        place_source(Path(folder))
        return enter(place, Path(folder), *PYTEST, *left_out, *options)


def place_source(folder):
    """Put this clone there, and what pip makes of it: the names of its tools."""
    copy_source(folder / 'src')
    copy_source(folder / 'package')
    subprocess.run([*PIP, 'install', '--no-deps', '--no-index', '--no-build-isolation',
                    '--no-compile', '--target', str(folder / 'site'), str(folder / 'package')],
                   check=True)


def enter(place, folder, *command):
    """Run a command in the root, where the source is; return its exit code."""
    return subprocess.run(['unshare', '--user', '--map-root-user', '--mount', 'sh', str(ENTER),
                           str(place), str(folder), *command]).returncode


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
