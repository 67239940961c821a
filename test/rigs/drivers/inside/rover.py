# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Run in the guest: the bridge without ROS (dead man, gate, link), with commands of its own at 25 Hz.

usage: rover.py PORT       SIGUSR1: no more commands, SIGUSR2: commands again, SIGTERM: the end
"""
import signal
import sys
import time

from msg_defs.vel2d import Vel2d
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.gate import Gate
from vel2d_bridge.gate import GateSettings
from vel2d_bridge.link import Link

BAUD = 115_200
PERIOD_S = 0.04
FORWARD = Vel2d(0.2, 0.0, 0.0)


def main(port):
    deadman = Deadman()
    wanted = {'drive', 'live'}
    for number, change in ((signal.SIGUSR1, lambda: wanted.discard('drive')),
                           (signal.SIGUSR2, lambda: wanted.add('drive')),
                           (signal.SIGTERM, wanted.clear)):
        signal.signal(number, lambda *_, change=change: change())
    link = Link(port, BAUD, Gate(GateSettings(), baud=BAUD), deadman=deadman,
                on_change=lambda problem: print(problem or f'{port}: open', flush=True))
    link.start()
    while 'live' in wanted:
        if 'drive' in wanted:
            link.offer_command(FORWARD)
        time.sleep(PERIOD_S)
    return 0 if link.close() else 1


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
