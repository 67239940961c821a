# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A bridge, its server and its dead man as real processes, and an MCU that judges them.

The bridge is link and dead man without ROS; it commands at 100 Hz. The MCU shares no code with
the product: a pty, and frames decoded by what docs/frame.md says.
"""
from contextlib import contextmanager
from contextlib import suppress
import fcntl
import json
import os
from pathlib import Path
import select
import struct
import subprocess
import sys
import termios
import threading
import time
import tty

from harness import ROOT
from harness import wait

from fuzz.reference import crc32

SPEED = 0.5
OUTLIVE_S = 70.0                # for all processes of a bridge, however it ended
# A program that starts another one with descriptors of which it knows nothing.
FULL = """
import os, resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (4096, 4096))
for _ in range(1100):
    os.set_inheritable(os.dup(0), True)
os.execv(sys.argv[1], sys.argv[1:])
"""
BRIDGE = """
import json, sys, threading, time
from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.gate import Gate
from vel2d_bridge.link import Link

{patch}
deadman = Deadman()
link = Link(sys.argv[1], 115200, Gate(), deadman=deadman)
link.start()
while len(deadman.pids) < 2:
    time.sleep(0.01)
print(*deadman.pids, flush=True)
ending = threading.Thread(target=sys.stdin.readline, daemon=True)
ending.start()
states = []
while ending.is_alive():
    link.offer_command(Vel2d({speed}, 0.0, 0.0))
    states += [link.state().deadman] * (states[-1:] != [link.state().deadman])
    time.sleep(0.01)
link.close()
print(json.dumps({{'freezes': link.state().freezes, 'deadman': states}}), flush=True)
"""


class Family:
    """A bridge process; dead man and server are in the session of the first server."""

    def __init__(self, path, *, speed=SPEED, patch='', prefix=()):
        self._process = subprocess.Popen(
            [*prefix, sys.executable, '-c', BRIDGE.format(speed=speed, patch=patch), path],
            cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.bridge = self._process.pid
        self._session = int(self._process.stdout.readline().split()[1])

    def living(self):
        return living(self._session)

    def guards(self):
        """Return dead man and server as soon as there are two, the former with the port."""
        def both():
            with suppress(OSError, ValueError):
                dead_man, server = self.living()
                return holds_port(dead_man) and [dead_man, server]
            return False
        return wait(both)

    def kill(self):
        self._process.kill()
        self._process.wait()

    def end(self):
        """End the bridge properly; return what it says at its end."""
        return json.loads(self._process.communicate('\n', timeout=20)[0])

    def is_gone(self):
        return self._process.poll() is not None and not self.living()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.communicate()


def living(session):
    """Return dead man and server as they are now, those of them that live."""
    found = []
    for entry in Path('/proc').glob('[0-9]*'):
        with suppress(OSError, ValueError, IndexError):
            fields = (entry / 'stat').read_text().rpartition(')')[2].split()
            if int(fields[3]) == session and fields[0] not in 'ZX':
                found.append((int(entry.name), int(fields[1])))
    parents = {parent for _, parent in found}
    return sorted((pid for pid, _ in found), key=lambda pid: pid in parents)


def holds_port(pid):
    with suppress(OSError):             # it ends while we look
        return any('/dev/pts/' in os.readlink(one) for one in Path(f'/proc/{pid}/fd').iterdir())
    return False


class BareMcu:
    """The other end of a line, at the path `link`; it notes each good frame with its time."""

    def __init__(self, link):
        self.path = str(link)
        self.frames = []                # (s, x, y, omega)
        self.bytes = 0
        self._master = -1
        self._ends = {}
        self.plug()

    def plug(self, prepare=lambda path: None):
        """Be plugged in, perhaps as another device; `prepare` has it before anybody sees it."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        name = os.ttyname(slave)
        prepare(name)
        self._ends[self._master] = slave
        threading.Thread(target=self._read, args=(self._master,), daemon=True).start()
        with suppress(FileNotFoundError):
            os.unlink(self.path)
        os.symlink(name, self.path)

    def unplug(self):
        master, self._master = self._master, -1
        if master >= 0:
            with suppress(FileNotFoundError):
                os.unlink(self.path)
            os.close(self._ends.pop(master))
            os.close(master)

    def _read(self, master):
        waiting = b''
        while master in self._ends:
            try:
                if not select.select([master], [], [], 0.02)[0]:
                    continue
                chunk = os.read(master, 4096)
            except (OSError, ValueError):
                return
            stamp = time.monotonic()
            self.bytes += len(chunk)
            waiting += chunk
            while len(waiting) >= 28:
                *values, crc = struct.unpack('<dddI', waiting[:28])
                good = crc == crc32(waiting[:24])
                if good:
                    self.frames.append((stamp, *values))
                waiting = waiting[28 if good else 1:]

    @property
    def drives(self):
        return bool(self.frames) and any(self.frames[-1][1:])

    def stopped_after(self, since):
        """Wait for a stop; return the time (s) from `since` to the first after all that drive."""
        wait(lambda: not self.drives)
        driving = [index for index, frame in enumerate(self.frames) if any(frame[1:])]
        return self.frames[driving[-1] + 1][0] - since

    def stops_since(self, since):
        return [frame for frame in list(self.frames) if frame[0] >= since and not any(frame[1:])]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.unplug()


@contextmanager
def driving(mcu, **options):
    """Run a bridge until the MCU drives and both guards are there; all must be gone at the end."""
    with Family(mcu.path, **options) as family:
        wait(lambda: mcu.drives)
        family.guards()
        yield family
    wait(family.is_gone, OUTLIVE_S)


def occupy(path):
    """Open a port and lock it, as another program does; return its descriptor."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.ioctl(fd, termios.TIOCEXCL)
    return fd


def give_back(fd):
    fcntl.ioctl(fd, termios.TIOCNXCL)
    os.close(fd)
