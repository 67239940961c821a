# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The guest while it runs: boot, programs inside, adapters that come and go, the end.

One virtual CPU, no network, the disk is never written (QEMU keeps what changes). The guest's agent
starts programs; systemd keeps those that go on, as units with a log.
"""
from __future__ import annotations

import base64
from contextlib import suppress
import os
from pathlib import Path
import re
import shlex
import subprocess
import time
from typing import NamedTuple

from rigs.drivers.image import VENV
from rigs.drivers.json_socket import JsonSocket
from rigs.drivers.json_socket import Refused

KVM = Path('/dev/kvm')
BOOT_S = 600.0                  # without KVM it takes minutes
POLL_S = 0.1
MOST_POLL_S = 1.0               # each look costs an emulated processor something
HELD_UP = 8                     # a program in the guest may take so many times its time-out
SHARED = '/run/shared'          # where the guest sees the folder of this run
SOURCE = f'{SHARED}/source'     # and this clone in it
INSIDE = f'{SOURCE}/test/rigs/drivers/inside'
PATH = f'{VENV}/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin'
KERNEL_LINE = 'root=/dev/vda rw console=ttyS0 quiet net.ifnames=0'
# Emulated, a processor without what makes the kernel load modules and walk tables of five levels;
# there is nothing to protect from its speculation.
EMULATED = ['-accel', 'tcg,tb-size=256', '-cpu', 'Nehalem']
UNPROTECTED = ' mitigations=off'
# The wheels of ROS start each Python of the venv a second time, for the libraries of ROS.
WITHOUT_ROS = '_ROS_WHEELS_BOOTSTRAP_COMPLETE'


def can_use_kvm():
    """Tell whether the processor may run the guest; /dev/kvm can be there without that."""
    return os.access(KVM, os.R_OK | os.W_OK) \
        and bool({'svm', 'vmx'} & set(Path('/proc/cpuinfo').read_text().split()))


class Done(NamedTuple):
    """What a program in the guest said, and its exit code."""

    code: int
    out: str
    err: str


class Failed(AssertionError):
    """A program in the guest that had to succeed did not."""


class Guest:
    """A machine that was booted from `image`; `shared` is a folder that it sees at SHARED."""

    def __init__(self, image, shared):
        self.has_kvm = can_use_kvm()
        self._folder = shared
        shared.chmod(0o755)                 # its users in the guest are not ours
        self._begin = time.monotonic()
        self._started = 0
        self._process = subprocess.Popen(
            ['qemu-system-x86_64', *self._options(image)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=(shared / 'qemu.log').open('w'))
        self._qmp = self._connect('qmp')
        self._qmp.ask('qmp_capabilities')
        self._agent = self._connect('agent')

    def _options(self, image):
        folder = self._folder
        accelerator = ['-accel', 'kvm', '-cpu', 'host'] if self.has_kvm else EMULATED
        kernel_line = KERNEL_LINE if self.has_kvm else KERNEL_LINE + UNPROTECTED
        return [
            *accelerator, '-machine', 'pc', '-smp', '1', '-m', '1024', '-nodefaults',
            '-display', 'none', '-no-user-config', '-nic', 'none',
            '-kernel', str(image.kernel), '-initrd', str(image.initrd), '-append', kernel_line,
            '-drive', f'file={image.disk},format=raw,if=virtio,snapshot=on',
            '-qmp', f'unix:{folder}/qmp,server=on,wait=off',
            '-chardev', f'socket,id=agent,path={folder}/agent,server=on,wait=off',
            '-device', 'virtio-serial', '-device', 'virtserialport,chardev=agent,'
            'name=org.qemu.guest_agent.0',
            '-chardev', f'socket,id=gadget,path={folder}/gadget,server=on,wait=off',
            '-device', 'virtserialport,chardev=gadget,name=gadget',
            '-virtfs', f'local,path={folder},mount_tag=shared,security_model=none,readonly=on',
            '-device', 'qemu-xhci',
            '-chardev', f'file,id=console,path={folder}/console.log',
            '-device', 'isa-serial,chardev=console,index=0',
            '-chardev', f'socket,id=uart,path={folder}/uart,server=on,wait=off',
            '-device', 'isa-serial,chardev=uart,index=1']

    def _connect(self, name):
        deadline = time.monotonic() + 30
        while True:
            with suppress(OSError):             # not there yet, or not listening yet
                return JsonSocket(self._folder / name)
            if self._process.poll() is not None or time.monotonic() > deadline:
                self._process.kill()
                raise Failed('qemu: ' + (self._folder / 'qemu.log').read_text())
            time.sleep(POLL_S)

    # Booting

    def wait_boot(self):
        """Wait until all units of the boot were started; return the seconds since QEMU began."""
        deadline = time.monotonic() + BOOT_S
        while not self._agent.synchronise():
            if time.monotonic() > deadline:
                raise Failed('no boot: ' + (self._folder / 'console.log').read_text()[-2000:])
        self.run('systemctl is-system-running --wait', check=False, timeout_s=BOOT_S)
        self.run('modprobe dummy_hcd')          # a USB socket inside, for gadgets
        self.run(f'mkdir -p {SHARED} && mount -t 9p -o trans=virtio,ro shared {SHARED}')
        return time.monotonic() - self._begin

    def reboot(self):
        """Boot again, as after `reboot`; what was written stays."""
        with suppress(TimeoutError, Refused):
            self._agent.ask('guest-shutdown', {'mode': 'reboot'}, timeout_s=2.0)
        self._qmp.wait_event('RESET', timeout_s=BOOT_S)
        self._agent.close()
        self._agent = self._connect('agent')
        self.wait_boot()

    def close(self):
        """Switch it off."""
        with suppress(Refused, OSError):
            self._qmp.ask('quit')
        self._process.wait(30)

    # Waiting

    def clock(self):
        """Return seconds of a clock that stands while this machine lets the guest not run."""
        return time.monotonic() - self._held_up_s()

    def _held_up_s(self):
        """Return how long the virtual CPU was ready to run and another program ran."""
        for task in Path(f'/proc/{self._process.pid}/task').iterdir():
            with suppress(OSError):
                if (task / 'comm').read_text().startswith('CPU '):
                    return int((task / 'schedstat').read_text().split()[1]) / 1e9
        return 0.0

    def until(self, condition, timeout_s=60.0):
        """Wait for something on this machine."""
        deadline = self.clock() + timeout_s
        while not condition():
            if self.clock() > deadline:
                raise Failed(f'not within {timeout_s} s')
            time.sleep(POLL_S / 10)

    # Programs inside

    def run(self, command, user='root', *, check=True, timeout_s=60.0, stdin=''):
        """Run a line of shell and wait for its end; `check`: raise Failed if that is not 0."""
        inner = ['timeout', '-k', '2', str(HELD_UP * timeout_s), 'env', f'PATH={PATH}',
                 f'{WITHOUT_ROS}=1', 'LANG=C.UTF-8', f'HOME={self._home(user)}',
                 'PYTHONUNBUFFERED=1', 'bash', '-c', command]
        as_user = [] if user == 'root' else ['runuser', '-u', user, '--']
        program, *arguments = [*as_user, *inner]
        pid = self._agent.ask('guest-exec', {
            'path': program, 'arg': arguments, 'capture-output': True,
            'input-data': base64.b64encode(stdin.encode()).decode()})['pid']
        deadline = self.clock() + timeout_s
        pause_s = POLL_S / 10
        while not (status := self._agent.ask('guest-exec-status', {'pid': pid}))['exited']:
            if self.clock() > deadline:
                raise Failed(f'{command}: did not end in {timeout_s} s')
            time.sleep(pause_s)
            pause_s = min(1.2 * pause_s, MOST_POLL_S)
        done = Done(status.get('exitcode', 128 + status.get('signal', 0)),
                    *(base64.b64decode(status.get(name, '')).decode(errors='replace')
                      for name in ('out-data', 'err-data')))
        if check and done.code:
            raise Failed(f'{command}: ended with {done.code}\n{done.out}{done.err}')
        return done

    def start(self, name, command, user='root'):
        """Start a line of shell as a unit of systemd that goes on, NAME and a number."""
        self._started += 1
        name = f'{name}-{self._started}'
        self.run(f'systemd-run -q --unit={name} --uid={user} --collect -p KillMode=control-group '
                 f'-E PATH={PATH} -E LANG=C.UTF-8 -E HOME={self._home(user)} '
                 f'-E PYTHONUNBUFFERED=1 -E {WITHOUT_ROS}=1 -E RCUTILS_COLORIZED_OUTPUT=0 '
                 f'bash -c {shlex.quote("exec " + command)}')
        return Unit(self, name)

    @staticmethod
    def _home(user):
        return '/root' if user == 'root' else f'/home/{user}'

    def wait(self, command, user='root', timeout_s=60.0):
        """Run a line of shell again and again until it succeeds."""
        deadline = self.clock() + timeout_s
        while (done := self.run(command, user, check=False)).code:
            if self.clock() > deadline:
                raise Failed(f'{command}: not within {timeout_s} s\n{done.out}{done.err}')
            time.sleep(POLL_S)
        return done

    # Adapters

    def plug(self, name, driver='usb-serial', **properties):
        """Plug an adapter in; return the socket on which its far end is, open for one client."""
        path = self._folder / f'{name}.line'
        if driver == 'usb-serial':          # else it is plugged in when a client comes
            properties['always-plugged'] = True
        backend = {'addr': {'type': 'unix', 'data': {'path': str(path)}},
                   'server': True, 'wait': False}
        self._qmp.ask('chardev-add', {'id': name, 'backend': {'type': 'socket', 'data': backend}})
        self._qmp.ask('device_add', {'id': f'plug-{name}', 'driver': driver, 'chardev': name,
                                     **properties})
        return path

    def unplug(self, name):
        """Pull it out; returns when it is gone for the guest."""
        self._qmp.ask('device_del', {'id': f'plug-{name}'})
        self._qmp.wait_event('DEVICE_DELETED', f'plug-{name}')
        self._qmp.ask('chardev-remove', {'id': name})

    @property
    def uart(self):
        """The socket behind the 16550 at ttyS1."""
        return self._folder / 'uart'

    @property
    def gadget(self):
        """The socket behind /dev/virtio-ports/gadget, for what a gadget sends and takes."""
        return self._folder / 'gadget'


class Unit:
    """A unit of systemd in the guest."""

    def __init__(self, guest, name):
        self.name = name
        self._guest = guest

    def log(self):
        return self._guest.run(f'journalctl -q -b -u {self.name} -o cat --no-pager').out

    def wait_for(self, *parts, times=1, timeout_s=60.0):
        """Wait for so many lines of this boot's log with `parts` in order; return the last."""
        pattern = '.*'.join(re.sub(r'([][.*^$\\])', r'\\\1', part) for part in parts)
        # One program that follows the log: asking again and again is dear where it is emulated.
        look = (f'grep -m {times} -e {shlex.quote(pattern)} '
                f'< <(exec journalctl -q -b -f --no-tail -u {self.name} -o cat 2>/dev/null)')
        try:
            return self._guest.run(look, timeout_s=timeout_s).out.splitlines()[-1]
        except Failed as error:
            raise Failed(f'{self.name}: {error}\n{self.log()}') from None

    def signal(self, name, whom='main'):
        self._guest.run(f'systemctl kill -s {name} --kill-whom={whom} {self.name}')

    def pid(self):
        """Return the ID of its main process, '0' while there is none."""
        return self._guest.run(f'systemctl show -P MainPID {self.name}').out.strip()

    def is_active(self):
        return self._guest.run(f'systemctl is-active -q {self.name}', check=False).code == 0

    def stop(self):
        self._guest.run(f'systemctl stop {self.name}', check=False)
