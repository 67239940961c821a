# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The bus of the soak, a process of its own: it strikes devices dumb on request and tells the truth.

For each line of JSON, the IDs that shall not answer from now on, it says how often each device
has answered. See Child in harness.py.
"""

import json
import sys

from dxl_monitor.model.models import Models
from mecarover_fakes.fake_bus import make_devices
from mecarover_fakes.fake_port import FakeBus
from mecarover_fakes.line import Line
from mecarover_fakes.master import Master
from mecarover_fakes.traffic import PATTERNS
from rigs.harness import say

BAUD = 2_000_000
RATE = 100.0


def main(link: str, entry: str) -> None:
    devices = make_devices([entry], Models(), BAUD)
    # Else all behind a silent device in a Sync Read are not served, and nothing can be said of it.
    line = Line(devices, BAUD, waits_in_line=False)
    bus = FakeBus(Master(line, PATTERNS['moving'], rate=RATE), link=link)
    bus.start()
    known = bus.master.truth.known
    try:
        for order in sys.stdin:
            dumb = json.loads(order)
            for device in devices:
                device.silent = device.id in dumb
            say({device.id: known[device.id].statuses if device.id in known else 0
                 for device in devices})
    finally:
        bus.stop()


if __name__ == '__main__':
    main(*sys.argv[1:])
