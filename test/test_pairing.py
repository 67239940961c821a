# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Rules of pairing, each a row of pairing.yaml: what is heard, and what is known then."""

from pathlib import Path

import pytest
from tracked_bus import Bus
from tracked_bus import GOAL
from tracked_bus import notes
from tracked_bus import packets
from tracked_bus import POSITION
import yaml

from servobus.bus.expected_devices import parse_all

HEARD = yaml.safe_load(Path(__file__).with_name('pairing.yaml').read_text(encoding='utf-8'))
def known(bus, key):
    what, *numbers = key.split()
    if what == 'count':
        bus.tracker.planner.updated_plans()
        return bus.evidence.counts[' '.join(numbers)]
    if not numbers:
        return {'kinds': bus.kinds(), 'devices': sorted(bus.registry.devices),
                'note': (notes(bus) or [()])[-1][1:]}[what]
    found = [known_of(bus, what, int(number)) for number in numbers]
    return found if len(found) > 1 else found[0]


def known_of(bus, what, number):
    place = {'position': f'{POSITION}:4', 'goal': f'{GOAL}:4'}.get(what, what)
    if ':' in place:
        at, size = map(int, place.split(':'))
        return bus.known(number, at, size)
    device = bus.device(number)
    if what == 'model':
        return device.model.name
    if what == 'heard':
        return 'now' if device.heard == bus.now else ''
    return getattr(device.counts if hasattr(device.counts, what) else device, what)


def plain(value):
    """Return what is known as YAML has it."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return [[*key, count] for key, count in value.items()]
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize('name', HEARD)
def test_what_is_heard_and_known(name):
    bus = Bus()
    for step in HEARD[name]:
        if 'listed' in step:
            bus = Bus(*parse_all(step['listed']))
        elif isinstance(step, dict):
            assert {key: plain(known(bus, key)) for key in step} == step
        else:
            for entry in step:
                if entry == 'idle':
                    bus.idle()
                elif entry == 'silence':
                    bus.tracker.stop_waiting(bus.now + 10**9)
                else:
                    bus.hear(*packets(entry))
