# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A link over a network that goes away: what was commanded before never arrives late.

In a network namespace; its loopback is switched off and on. A command carries in omega when it
was given, so that each frame at the other end tells its age.
"""
import json
from pathlib import Path
import shutil
import subprocess
import sys

from harness import LATE_S
import pytest

ROOT = Path(__file__).parents[1]
INSIDE = ['unshare', '--net', '--map-root-user']
CAN_UNSHARE = shutil.which('unshare') is not None and subprocess.run(
    [*INSIDE, 'true'], capture_output=True).returncode == 0
pytestmark = [pytest.mark.realtime(bears=0.1), pytest.mark.skipif(
    not CAN_UNSHARE, reason='skipped: not allowed to make a network namespace')]
BOUND_S = 0.5 + 2 / 20 + 0.05           # cmd_vel_timeout, resends, write_timeout
SCRIPT = """
import fcntl, json, socket, struct, sys, threading, time, types
from serial import serial_for_url
from serial.rfc2217 import PortManager
from msg_defs.vel2d import decode, FRAME_SIZE, STOP, Vel2d
from vel2d_bridge.gate import Gate
from vel2d_bridge.link import Link

control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

def network(is_up):
    fcntl.ioctl(control, 0x8914, struct.pack('16sh14x', b'lo', is_up))     # SIOCSIFFLAGS, IFF_UP

def wait(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)

network(True)
server = socket.create_server(('127.0.0.1', 0))
arrivals = []                           # (connection, when, velocity)

def serve(number, connection):
    data, take = b'', bytes
    if sys.argv[2] == 'rfc2217':
        manager = PortManager(serial_for_url('loop://'),
                              types.SimpleNamespace(write=connection.sendall))
        take = lambda chunk: b''.join(manager.filter(chunk))
    try:
        while chunk := connection.recv(4096):
            data += take(chunk)
            while len(data) >= FRAME_SIZE:
                arrivals.append((number, time.monotonic(), decode(data[:FRAME_SIZE])))
                data = data[FRAME_SIZE:]
    except ConnectionError:
        pass

def listen():
    number = 0
    while True:
        threading.Thread(target=serve, args=(number, server.accept()[0]), daemon=True).start()
        number += 1

threading.Thread(target=listen, daemon=True).start()
problems = []
link = Link(f'{sys.argv[2]}://127.0.0.1:{server.getsockname()[1]}', 115200, Gate(),
            on_change=lambda problem: problems.append(str(problem)))
link.start()

def drive(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        link.offer_command(Vel2d(0.5, 0.0, time.monotonic()))
        time.sleep(0.02)

wait(lambda: link.state().is_open)
drive(1)
reached = sum(velocity != STOP for _, _, velocity in arrivals)
losses = link.state().losses
network(False)
drive(float(sys.argv[1]))               # and no commands any more when it is back
was_open = link.state().is_open
last = time.monotonic()
network(True)
wait(lambda: len([one for one in arrivals if one[1] > last]) > 5)
link.close()
ages = [when - velocity.omega for _, when, velocity in arrivals if velocity != STOP]
print(json.dumps({
    'reached': reached, 'losses': losses, 'oldest': max(ages), 'problems': problems,
    'was_open': was_open,
    'late': [velocity for number, when, velocity in arrivals if when > last and velocity != STOP],
    'firsts': [next(v for n, _, v in arrivals if n == number)
               for number in {n for n, _, _ in arrivals}]}))
"""


@pytest.mark.parametrize('scheme', ['socket', 'rfc2217'])
@pytest.mark.parametrize('away_s', [1, 4, pytest.param(20, marks=pytest.mark.slow)])
def test_what_was_commanded_before_the_network_went_away_never_arrives(away_s, scheme):
    done = subprocess.run([*INSIDE, sys.executable, '-c', SCRIPT, str(away_s), scheme], cwd=ROOT,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen['reached'] > 15                      # 30 Hz, and no spurious time-out
    assert seen['losses'] == 0
    assert seen['late'] == []
    assert seen['oldest'] < BOUND_S + LATE_S
    assert not seen['was_open']
    assert any('the peer does not confirm any byte' in line for line in seen['problems'])
    assert all(first == [0.0, 0.0, 0.0] for first in seen['firsts'])
