# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The guest's disk: a Debian of its own with systemd, udev, a stock kernel and ROS 2 from wheels.

Built once from packages, then kept in the user's cache; what decides its content is its key. The
package under test is not in it.
"""
from __future__ import annotations

import os
from pathlib import Path
import shlex
import shutil
from typing import NamedTuple

from rigs.debian import check_tools
from rigs.debian import do
from rigs.debian import kept
from rigs.debian import PIP
from rigs.debian import PYTHON
from rigs.debian import requirements
from rigs.debian import SUITE
from rigs.debian import wheels_for

PACKAGES = ('systemd-sysv', 'udev', 'dbus', 'linux-image-amd64', 'initramfs-tools', 'python3',
            'python3-venv', 'sudo', 'procps', 'kmod', 'psmisc', 'login', 'qemu-guest-agent',
            'usbutils', 'strace')
EXTRAS = ('ros', 'dashboard')       # extras of setup.py
ALSO = ('setuptools', 'wheel', 'dynamixel-sdk')
SOURCES_ONLY = ('empy<4',)          # ROS 2 wants it, and it has no wheel
SIZE = '4G'
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


class Image(NamedTuple):
    """A disk that can be booted, and the kernel and first file system that boot it."""

    disk: Path
    kernel: Path
    initrd: Path


def image():
    """Return the image of today's key; build it where there is none."""
    check_tools(TOOLS)
    content = (SUITE, PYTHON, SIZE, *PACKAGES, SETTLE, *_libraries(), *SOURCES_ONLY)
    place = kept('drivers', content, _build)
    return Image(place / 'disk', place / 'vmlinuz', place / 'initrd.img')


def _libraries():
    """Return what pip shall install there: the package's requirements, without the package."""
    return [*requirements(EXTRAS), *ALSO]


def _build(work, made):
    wheels = work / 'wheels'
    _fetch(wheels)
    tar = work / 'root.tar'
    settle = work / 'settle'
    settle.write_text(SETTLE)
    do('mmdebstrap', '--quiet', '--variant=minbase', f'--include={",".join(PACKAGES)}',
       f'--customize-hook=copy-in {shlex.quote(str(wheels))} /opt',
       f'--customize-hook=chroot "$1" sh < {shlex.quote(str(settle))}', SUITE, str(tar))
    # mke2fs takes a folder; only root or fakeroot can set the owners in it.
    root = work / 'root'
    root.mkdir()
    disk = made / 'disk'
    script = (f'tar -C {shlex.quote(str(root))} -xf {shlex.quote(str(tar))} && '
              f'truncate -s {SIZE} {shlex.quote(str(disk))} && '
              f'mke2fs -q -t ext4 -d {shlex.quote(str(root))} {shlex.quote(str(disk))}')
    do(*(() if os.geteuid() == 0 else ('fakeroot',)), 'sh', '-c', script)
    for pattern, name in (('vmlinuz-*', 'vmlinuz'), ('initrd.img-*', 'initrd.img')):
        [source] = (root / 'boot').glob(pattern)
        shutil.copy(source, made / name)


def _fetch(wheels):
    """Put the libraries there, as wheels for the Python of the guest."""
    do(*PIP, 'wheel', '--no-deps', '-w', str(wheels), *SOURCES_ONLY)
    do(*PIP, 'download', *wheels_for('x86_64'), f'--find-links={wheels}', '-d', str(wheels),
       *_libraries(), *SOURCES_ONLY)
