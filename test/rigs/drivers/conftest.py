# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""One guest for all checks, with the package of this clone in it; and the table at the end."""
from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import tarfile

import pytest

from rigs.debian import PYTHON
from rigs.drivers.guest import Guest
from rigs.drivers.guest import SHARED
from rigs.drivers.image import image
from rigs.drivers.image import VENV
from rigs.source import copy_source

PACKAGE = 'package.tar'             # made of this clone, unpacked in the guest
COMPILED = 'compiled'               # the folders in it, as -i of compileall takes them
GUEST = pytest.StashKey[str]()


def pytest_addoption(parser):
    parser.addoption('--services', action='store_true',
                     help='run the checks of the three services without KVM too (20 minutes)')


@pytest.fixture(scope='session')
def guest(tmp_path_factory, request):
    """Boot the guest, with this clone installed in it."""
    folder = tmp_path_factory.mktemp('guest')
    pack(folder)
    guest = Guest(image(), folder)
    try:
        seconds = guest.wait_boot()
        install(guest)
        kernel = guest.run('uname -r').out.strip()
        request.config.stash[GUEST] = (
            f'guest: Linux {kernel}, {"KVM" if guest.has_kvm else "no KVM (slow)"}, '
            f'booted in {seconds:.0f} s')
        yield guest
    finally:
        guest.close()


def pack(folder):
    """Put what git knows of this clone where the guest sees it, and what pip makes of that."""
    source = folder / 'source'
    copy_source(source)
    # Emulated, pip takes two minutes; what it puts there is the same for each machine, but for
    # the folder of the libraries and the first line of the programs.
    made = folder / 'made'
    subprocess.run([sys.executable, '-m', 'pip', '-qq', 'install', '--no-deps', '--no-index',
                    '--no-build-isolation', '--ignore-installed', '--prefix', str(made),
                    str(source)], check=True)
    [libraries] = made.glob('lib/python3*')
    place = Path('lib', f'python{PYTHON}')
    libraries.rename(made / place)
    for program in made.glob('bin/*'):
        program.write_text(program.read_text().replace(sys.executable, f'{VENV}/bin/python3'))
    with tarfile.open(folder / PACKAGE, 'w') as tar:
        tar.add(made, '.')
    (folder / COMPILED).write_text(''.join(
        f'{VENV}/{path.parent.relative_to(made)}\n'
        for path in (made / place).glob('site-packages/*/__init__.py')))


def install(guest):
    guest.run(f'tar -C {VENV} --no-same-owner -xf {SHARED}/{PACKAGE} && '
              f'python -m compileall -q -i {SHARED}/{COMPILED}', timeout_s=600)


def pytest_terminal_summary(terminalreporter):
    """Name each check as the sentence that it shows."""
    terminalreporter.section('checks on real drivers')
    terminalreporter.line(terminalreporter.config.stash.get(GUEST, 'guest: did not boot'))
    for outcome in ('passed', 'failed', 'error', 'skipped'):
        for report in terminalreporter.stats.get(outcome, ()):
            if report.when == 'call' or outcome != 'passed':
                figure = dict(report.user_properties).get('figure', '')
                terminalreporter.line(f'{outcome:8}{report.duration:6.1f} s  '
                                      f'{_sentence(report.nodeid)}' + (figure and f': {figure}'))


def _sentence(node):
    """Return what the name of a check says, with its parameters."""
    name, _, parameters = node.rpartition('::')[2].removeprefix('test_').partition('[')
    return name.replace('_', ' ') + (f' ({parameters.rstrip("]")})' if parameters else '')
