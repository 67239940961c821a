# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The guest's disk: a Debian of its own with systemd, udev, a stock kernel and ROS 2 from wheels.

Built once from packages, then kept in the user's cache; what decides its content is its key. The
package under test is not in it.
"""
from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import hashlib
from importlib import metadata
import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from typing import NamedTuple

SUITE = 'bookworm'
PYTHON = '3.11'                     # what this suite has: its wheels are fetched from outside
PACKAGES = ('systemd-sysv', 'udev', 'dbus', 'linux-image-amd64', 'initramfs-tools', 'python3',
            'python3-venv', 'sudo', 'procps', 'kmod', 'psmisc', 'login', 'qemu-guest-agent',
            'usbutils')
EXTRAS = ('ros', 'dashboard')       # extras of setup.py
ALSO = ('setuptools', 'wheel', 'dynamixel-sdk')
SOURCES_ONLY = ('empy<4',)          # ROS 2 wants it, and it has no wheel
GLIBC = (36, 35, 34, 31, 28, 27, 24, 17, 12, 5)         # wheels for these run there
SIZE = '4G'
END_S = 20.0
KEYRING = Path('/usr/share/keyrings/debian-archive-keyring.gpg')
TOOLS = {'qemu-system-x86_64': 'qemu-system-x86', 'mmdebstrap': 'mmdebstrap',
         'mke2fs': 'e2fsprogs', 'fakeroot': 'fakeroot'}
VENV = '/opt/venv'
# Run in the new root. robot may open serial ports, stranger may not.
SETTLE = rf"""
set -e
useradd --create-home --shell /bin/bash --groups dialout robot
useradd --create-home --shell /bin/bash stranger
echo 'robot ALL=(ALL) NOPASSWD: ALL' > /etc/sudoers.d/robot
echo robot > /etc/hostname
echo '127.0.0.1 localhost robot' > /etc/hosts
mkdir -p /var/log/journal
systemctl -q mask apt-daily.timer apt-daily-upgrade.timer e2scrub_all.timer e2scrub_reap.service \
    dpkg-db-backup.timer
# Only what finds the disk: where the processor is emulated, unpacking the rest takes a while.
printf '%s\n' virtio_pci virtio_blk ext4 >> /etc/initramfs-tools/modules
sed -i s/MODULES=most/MODULES=list/ /etc/initramfs-tools/initramfs.conf
update-initramfs -u -k all
python3 -m venv {VENV}
{VENV}/bin/pip install -q --no-index --find-links /opt/wheels /opt/wheels/*.whl
rm -r /opt/wheels
"""


class Missing(Exception):
    """What this machine lacks to build or run the guest: one line with the remedy."""


class Image(NamedTuple):
    """A disk that can be booted, and the kernel and first file system that boot it."""

    disk: Path
    kernel: Path
    initrd: Path


def image() -> Image:
    """Return the image of today's key; build it where there is none."""
    _check_tools()
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    home = cache / 'mecarover_serial' / 'drivers'
    place = home / _key()
    if not place.exists():
        home.mkdir(parents=True, exist_ok=True)
        print(f'test-drivers: building a Debian {SUITE} in {place}, once (5 to 15 minutes)')
        with tempfile.TemporaryDirectory(dir=home, prefix='building-') as folder:
            made = Path(folder) / 'image'
            made.mkdir()
            _build(Path(folder), made)
            made.rename(place)
        for old in home.iterdir():              # one image is enough, they are large
            if old != place and not old.name.startswith('building-'):
                shutil.rmtree(old)
    return Image(place / 'disk', place / 'vmlinuz', place / 'initrd.img')


def _check_tools() -> None:
    missing = [package for tool, package in TOOLS.items()
               if shutil.which(tool, path=f'{os.environ["PATH"]}:/usr/sbin:/sbin') is None]
    if not KEYRING.exists():
        missing.append('debian-archive-keyring')
    if missing:
        raise Missing(f'{", ".join(missing)}: not installed; '
                      f'sudo apt install --no-install-recommends {" ".join(missing)}')


def _key() -> str:
    """Name what the content depends on."""
    content = (SUITE, PYTHON, SIZE, *PACKAGES, SETTLE, *_libraries(), *SOURCES_ONLY)
    return hashlib.sha256('\n'.join(content).encode()).hexdigest()[:12]


def _libraries() -> list[str]:
    """Return what pip shall install there: the package's requirements, without the package."""
    found = []
    for line in metadata.requires('mecarover_serial') or ():
        requirement, _, marker = line.partition(';')
        if not marker or any(f'extra == "{extra}"' in marker for extra in EXTRAS):
            found.append(requirement.strip())
    return [*found, *ALSO]


def _build(work: Path, made: Path) -> None:
    wheels = work / 'wheels'
    _fetch(wheels)
    tar = work / 'root.tar'
    settle = work / 'settle'
    settle.write_text(SETTLE)
    _do('mmdebstrap', '--quiet', '--variant=minbase', f'--include={",".join(PACKAGES)}',
        f'--customize-hook=copy-in {shlex.quote(str(wheels))} /opt',
        f'--customize-hook=chroot "$1" sh < {shlex.quote(str(settle))}', SUITE, str(tar))
    # mke2fs takes a folder; only root or fakeroot can set the owners in it.
    root = work / 'root'
    root.mkdir()
    disk = made / 'disk'
    script = (f'tar -C {shlex.quote(str(root))} -xf {shlex.quote(str(tar))} && '
              f'truncate -s {SIZE} {shlex.quote(str(disk))} && '
              f'mke2fs -q -t ext4 -d {shlex.quote(str(root))} {shlex.quote(str(disk))}')
    _do(*(() if os.geteuid() == 0 else ('fakeroot',)), 'sh', '-c', script)
    for pattern, name in (('vmlinuz-*', 'vmlinuz'), ('initrd.img-*', 'initrd.img')):
        [source] = (root / 'boot').glob(pattern)
        shutil.copy(source, made / name)


def _fetch(wheels: Path) -> None:
    """Put the libraries there, as wheels for the Python of the guest."""
    pip = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '-qq')
    _do(*pip, 'wheel', '--no-deps', '-w', str(wheels), *SOURCES_ONLY)
    platforms = [f'--platform=manylinux_2_{minor}_x86_64' for minor in GLIBC]
    _do(*pip, 'download', '--only-binary=:all:', f'--python-version={PYTHON}',
        '--implementation=cp', *platforms, '--platform=manylinux2014_x86_64',
        f'--find-links={wheels}', '-d', str(wheels), *_libraries(), *SOURCES_ONLY)


def _do(*command: str) -> None:
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
        what: Sequence[str] = command[:1] if command[0] != sys.executable else ('pip',)
        raise Missing(f'{" ".join(what)} ended with {code}; the lines above say why. '
                      'Building the guest needs a network')


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a group: mmdebstrap unmounts and removes what it made when it is asked to end."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_S)
