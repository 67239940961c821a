# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a Debian of the rigs is built with: packages, wheels for its Python, a cache."""
from __future__ import annotations

from contextlib import suppress
import hashlib
from importlib import metadata
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile

SUITE = 'bookworm'
PYTHON = '3.11'                     # what this suite has: its wheels are fetched from outside
GLIBC = (36, 35, 34, 31, 28, 27, 24, 17, 12, 5)         # wheels for these run there
END_S = 20.0
KEYRING = Path('/usr/share/keyrings/debian-archive-keyring.gpg')
PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '-qq')


class Missing(Exception):
    """What this machine lacks to build or run it: one line with the remedy."""


def check_tools(tools):
    """Raise Missing unless all these programs are here; tools: program to Debian package."""
    missing = [package for tool, package in tools.items()
               if shutil.which(tool, path=f'{os.environ["PATH"]}:/usr/sbin:/sbin') is None]
    if not KEYRING.exists():
        missing.append('debian-archive-keyring')
    if missing:
        raise Missing(f'{", ".join(missing)}: not installed; '
                      f'sudo apt install --no-install-recommends {" ".join(missing)}')


def kept(name, content, build):
    """
    Return the folder of the cache in which `build` made what `content` describes, once.

    build: called with a folder to work in and the folder to fill. An older one of this name goes.
    """
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    home = cache / 'mecarover_serial' / name
    place = home / hashlib.sha256('\n'.join(content).encode()).hexdigest()[:12]
    if not place.exists():
        home.mkdir(parents=True, exist_ok=True)
        print(f'test-{name}: building a Debian {SUITE} in {place}, once (5 to 15 minutes)',
              flush=True)
        with tempfile.TemporaryDirectory(dir=home, prefix='building-') as folder:
            made = Path(folder) / 'made'
            made.mkdir()
            build(Path(folder), made)
            made.rename(place)
        for old in home.iterdir():              # one is enough, they are large
            if old != place and not old.name.startswith('building-'):
                shutil.rmtree(old)
    return place


def requirements(extras):
    """Return what the package requires, with these extras of setup.py."""
    found = []
    for line in metadata.requires('mecarover_serial') or ():
        requirement, _, marker = line.partition(';')
        if not marker or any(f'extra == "{extra}"' in marker for extra in extras):
            found.append(requirement.strip())
    return found


def wheels_for(machine):
    """Return pip's options for wheels of that Debian's Python."""
    platforms = [f'--platform=manylinux_2_{minor}_{machine}' for minor in GLIBC]
    return ['--only-binary=:all:', f'--python-version={PYTHON}', '--implementation=cp',
            *platforms, f'--platform=manylinux2014_{machine}']


def do(*command):
    """Run it in a process group of its own, and end the whole group when this is ended."""
    path = f'{os.environ["PATH"]}:/usr/sbin:/sbin'
    with subprocess.Popen(command, env={**os.environ, 'PATH': path},
                          start_new_session=True) as process:
        try:
            code = process.wait()
        except BaseException:
            _end(process)
            raise
    if code:
        what = command[:1] if command[0] != sys.executable else ('pip',)
        raise Missing(f'{" ".join(what)} ended with {code}; the lines above say why. '
                      'Building it needs a network')


def _end(process):
    """End a group: mmdebstrap unmounts and removes what it made when it is asked to end."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_S)
