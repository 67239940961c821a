# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The cases of benchmark.confusion: each fault of fake_bus, and what must be told of it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rigs.bus.scene import Key
from rigs.bus.scene import keys
from rigs.tables import rows_of

ROBOT = ('1-5:MX-106', '6-8:MX-64', '100:Rhoban DXL Board')
FAST_ROBOT = ('1-5:XL430-W250', '6-8:XM540-W270')
ARM = ('1-5:STS3215', '6-8:STS3250')
OLD_ROBOT = ('1-5:AX-12A', '6-8:MX-28(1.0)')


class Scene(NamedTuple):
    """What is on the bus beside the faults."""

    pattern: str = 'moving'
    devices: tuple[str, ...] = ROBOT
    waits_in_line: bool = True
    rate: float = 50.0
    gather: int = 0                # ns that an adapter collects bytes for; 0: each burst by itself
    dialect: str = '2'             # as fake_bus calls it
    baud: int = 2_000_000


class Case(NamedTuple):
    """A fault, written as for fake_bus, with {at} for its time, and what must be told."""

    fault: str
    told: tuple[Key, ...]
    scene: Scene = Scene()
    about: str = ''


ANSWERS_BEHIND = Scene(waits_in_line=False)
FAST = Scene(devices=FAST_ROBOT)
FEETECH = Scene(devices=ARM, dialect='feetech', baud=1_000_000)
FEETECH_BEHIND = FEETECH._replace(waits_in_line=False)
DXL1 = Scene(devices=OLD_ROBOT, dialect='dxl1', baud=1_000_000)
DXL1_BULK = Scene('bulk', ('1-8:MX-28(1.0)',), dialect='dxl1', baud=1_000_000)
SCENES = {
    '2': Scene(), '2 behind': ANSWERS_BEHIND, '2 fast': FAST,
    '2 read_write': Scene('read_write', rate=20.0),
    'feetech': FEETECH, 'feetech behind': FEETECH_BEHIND,
    'feetech each': FEETECH._replace(pattern='registered', rate=20.0),
    'dxl1': DXL1, 'dxl1 bulk': DXL1_BULK, 'dxl1 slow': DXL1._replace(rate=20.0),
}


def _cases_of(protocol):
    return tuple(Case(fault, keys(said), SCENES[protocol if scene == 'all' else scene], about)
                 for scene, fault, said, about in rows_of(Path(__file__).with_suffix('.tsv'))
                 if scene.split()[0] in ('all', protocol))


CASES, FEETECH_CASES, DXL1_CASES = map(_cases_of, ('2', 'feetech', 'dxl1'))
