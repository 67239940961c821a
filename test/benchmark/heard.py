# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A listener and a monitor as a process, without ROS; usage: heard.py SOURCE BAUD."""

import sys
import time

from rigs.harness import print_json
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor
from servobus.sources.listeners import listener_on

QUIET_S = 0.5


def main(source, baud):
    monitor = Monitor('bus', Models(), Settings(baud=int(baud)), idle_is_told=True)
    listener = listener_on(source, int(baud), monitor.feed_chunks, monitor.flush_if_idle)
    listener.start()
    while not listener.state.is_open:
        time.sleep(0.01)
    print_json({'open': True})
    sys.stdin.readline()
    heard = -1
    while heard != listener.bytes:          # what is on its way is not lost
        heard = listener.bytes
        time.sleep(QUIET_S)
    report = monitor.report(time.monotonic_ns())
    print_json({'bytes': report.counters['Bytes'], 'crc errors': report.counters['CRC Errors']})
    listener.stop()


if __name__ == '__main__':
    main(*sys.argv[1:])
