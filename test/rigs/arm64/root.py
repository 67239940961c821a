# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The root folder of a Debian for arm64, with what the tests need beside ROS.

Its packages are unpacked, not set up, so that nothing of it has to run while it is built: no
rights are needed. The package under test is not in it.
"""
from __future__ import annotations

from pathlib import Path

from rigs.debian import check_tools
from rigs.debian import do
from rigs.debian import kept
from rigs.debian import PIP
from rigs.debian import PYTHON
from rigs.debian import requirements
from rigs.debian import SUITE
from rigs.debian import wheels_for

PACKAGES = ('base-files', 'python3', 'bash', 'dash', 'coreutils', 'util-linux', 'grep', 'sed',
            'findutils', 'procps', 'psmisc', 'login', 'git')
# From the extra `test` of setup.py: what the tests without ROS, lint, types and browser import.
TESTED_WITH = ('pytest', 'pytest-xdist', 'hypothesis', 'dynamixel-sdk', 'aiohttp',
               'prometheus-client', 'setuptools', 'wheel')
SOURCES_ONLY = ('feetech-servo-sdk==1.0.0',)            # it has no wheel
HERE = '/here'                      # where enter.sh shows the source, and what pip makes of it
SITE = Path('usr/local/lib', f'python{PYTHON}', 'dist-packages')
TOOLS = {'mmdebstrap': 'mmdebstrap', 'qemu-aarch64-static': 'qemu-user-static',
         'unshare': 'util-linux'}
USERS = 'root:x:0:0:root:/root:/bin/bash\n'
GROUPS = 'root:x:0:\ntty:x:5:\ndialout:x:20:\n'


def root():
    """Return the root folder; build it where there is none."""
    check_tools(TOOLS)
    content = (SUITE, PYTHON, *PACKAGES, *_libraries(), *SOURCES_ONLY, USERS, GROUPS)
    return kept('arm64', content, _build) / 'root'


def _libraries():
    wanted = requirements(['test'])
    return [*requirements([]), *(one for one in wanted if one.startswith(TESTED_WITH)), 'wheel']


def _build(work, made):
    tar = work / 'root.tar'
    do('mmdebstrap', '--quiet', '--arch=arm64', '--variant=extract',
       f'--include={",".join(PACKAGES)}', SUITE, str(tar))
    root = made / 'root'
    root.mkdir()
    do('tar', '-C', str(root), '--no-same-owner', '--exclude=./dev/*', '-xf', str(tar))
    for name, text in (('passwd', USERS), ('group', GROUPS), ('hostname', 'robot\n'),
                       ('hosts', '127.0.0.1 localhost robot\n')):
        (root / 'etc' / name).write_text(text)
    wheels = work / 'wheels'
    do(*PIP, 'wheel', '--no-deps', '-w', str(wheels), *SOURCES_ONLY)
    options = wheels_for('aarch64')
    do(*PIP, 'install', *options, f'--find-links={wheels}', '--no-compile', '--target',
       str(root / SITE), *_libraries(), *SOURCES_ONLY)
    (root / SITE / 'package.pth').write_text(f'{HERE}/site\n')
