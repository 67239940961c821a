# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The cases of benchmark.confusion: each fault of fake_bus, and what must be told of it."""

from __future__ import annotations

from typing import NamedTuple

ROBOT = ('1-5:MX-106', '6-8:MX-64', '100:Rhoban DXL Board')
FAST_ROBOT = ('1-5:XL430-W250', '6-8:XM540-W270')
ARM = ('1-5:STS3215', '6-8:STS3250')
OLD_ROBOT = ('1-5:AX-12A', '6-8:MX-28(1.0)')

Key = tuple[str, int | None]       # rule, device


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
# In all three protocols, each on the usual scene of its protocol.
IN_ALL = (
    Case('cable:1:{at}', (('all_silent', None),)),
    Case('duplicate:3:{at}', (('duplicate_id', 3),)),
    Case('baud:3:{at}', (('baud_moved', 3),)),
    Case('wrong_baud::{at}', (('wrong_baud', None),)),
    Case('impatient::{at}', (('impatient_master', None),)),
    Case('latency::{at}', (('latency_timer', None),)),
    Case('overload::{at}', (('bus_too_slow', None),)),
    Case('latched:3:{at}', (('hardware_error', 3),)),
    Case('brownout::{at}', (('brown_out', None),)),
    Case('header:3:{at}', (('turnaround', 3),)),
    Case('header::{at}', (('turnaround', None),), about='all devices'),
    Case('turnaround:3:{at}', (('turnaround', 3),)),
    Case('turnaround::{at}', (('turnaround', None),), about='all devices'),
    Case('glitch::{at}', (('stray_bytes', None),)),
    Case('echo::{at}', (('echo', None),)),
    Case('foreign:3:{at}', (('foreign_answers', 3),)),
    Case('eeprom_wear:3:{at}', (('eeprom_wear', 3),)),
    Case('no_ack:3:{at}', (('no_acks', 3),)),
    Case('noise::{at}', (('noise', None),)),
    Case('noise:3:{at}', (('damaged_answers', 3),), about='of one device'),
    Case('flip::{at}', (('noise', None),)),
    Case('drop::{at}', (('noise', None),)),
    Case('hot:3:{at}', (('too_hot', 3),)),
    Case('low_voltage:3:{at}', (('voltage', 3),)),
    Case('unwritten:3:0', (('never_written', 3),)),
    Case('jitter::{at}', (('jitter', None),)),
)
CASES = (
    *IN_ALL,
    Case('silent:3:{at}', (('sync_read_stops', 3),)),
    Case('silent:3:{at}', (('no_answer', 3),), ANSWERS_BEHIND, 'others answer behind it'),
    Case('silent:3:{at}:0.6', (('dropout', 3),), ANSWERS_BEHIND, 'for 0.6 s'),
    Case('cable:3:{at}', (('broken_cable', 3),)),
    Case('late:3:{at}', (('late_answers', 3),)),
    Case('return_delay:3:{at}', (('return_delay', 3),), Scene('read_write', rate=20.0)),
    Case('reboot:3:{at}', (('rebooted', 3),)),
    Case('two_masters::{at}', (('two_masters', None),)),
    Case('wrong_map:3:{at}', (('wrong_address', 3),)),
    Case('eeprom:3:{at}', (('eeprom_locked', 3),)),
    Case('ping_only:3:{at}', (('ping_only', 3),)),
    Case('old_firmware:3:{at}', (('fast_read_unsupported', 3),), FAST),
    Case('unstuffed::{at}', (('unstuffed', None),)),
    Case('watchdog:3:{at}', (('watchdog', 3),), FAST),
    Case('protocol1::{at}', (('protocol_1', None),)),
    Case('factory_id:3:0', (('factory_id', 1),)),
    Case('last_id::{at}', (('impossible_id', None),)),
)

FEETECH = Scene(devices=ARM, dialect='feetech', baud=1_000_000)
FEETECH_BEHIND = FEETECH._replace(waits_in_line=False)
FEETECH_EACH = FEETECH._replace(pattern='registered', rate=20.0)
FEETECH_CASES = (
    *(case._replace(scene=FEETECH) for case in IN_ALL),
    Case('silent:3:{at}', (('sync_read_stops', 3),), FEETECH),
    Case('silent:3:{at}', (('no_answer', 3),), FEETECH_BEHIND, 'others answer behind it'),
    Case('silent:3:{at}:0.6', (('dropout', 3),), FEETECH_BEHIND, 'for 0.6 s'),
    Case('cable:3:{at}', (('sync_read_stops', 3),), FEETECH, 'all in one Sync Read'),
    Case('cable:3:{at}', (('broken_cable', 3),), FEETECH_EACH, 'each written alone'),
    Case('factory_id:3:0', (('factory_id', 1),), FEETECH_BEHIND),
    Case('factory_id::0', (('factory_id', 1),), FEETECH_BEHIND, 'all devices'),
    Case('baud_code:3:{at}', (('baud_code', 3),), FEETECH),
    Case('late:3:{at}', (('late_answers', 3),), FEETECH),
    Case('return_delay:3:{at}', (('return_delay', 3),), FEETECH_EACH),
    Case('reboot:3:{at}', (('dropout', 3),), FEETECH_BEHIND),
    Case('two_masters::{at}', (('two_masters', None),), FEETECH),
    Case('layout:3:{at}', (('layout', 3),), FEETECH),
    Case('last_id::{at}', (('no_answer', 253),), FEETECH),
    Case('locked:3:{at}', (('lock', 3),), FEETECH),
    Case('mixed_firmware:3:{at}', (('mixed_firmware', None),), FEETECH),
    Case('calibrated:3:{at}', (('calibrated_twice', 3),), FEETECH),
    Case('middle:3:{at}', (('calibrated_twice', 3),), FEETECH),
    Case('offset:3:{at}', (('calibrated_twice', 3),), FEETECH),
    Case('protocol2::{at}', (('protocol_1', None),), FEETECH),
    Case('high_supply:3:{at}', (('wrong_supply', 3),), FEETECH),
    Case('high_supply::{at}', (('wrong_supply', 1),), FEETECH, 'all devices'),
    Case('low_supply:3:0', (('wrong_supply', 3),), FEETECH),
)

DXL1 = Scene(devices=OLD_ROBOT, dialect='dxl1', baud=1_000_000)
DXL1_BULK = Scene('bulk', ('1-8:MX-28(1.0)',), dialect='dxl1', baud=1_000_000)
DXL1_CASES = (
    *(case._replace(scene=DXL1) for case in IN_ALL),
    Case('silent:3:{at}', (('no_answer', 3),), DXL1),
    Case('silent:3:{at}', (('sync_read_stops', 3),), DXL1_BULK, 'in a Bulk Read'),
    Case('silent:3:{at}:0.6', (('dropout', 3),), DXL1, 'for 0.6 s'),
    Case('cable:3:{at}', (('broken_cable', 3),), DXL1),
    Case('factory_id:3:0', (('factory_id', 1),), DXL1),
    Case('late:8:{at}', (('late_answers', 8),), DXL1._replace(rate=20.0)),
    Case('return_delay:3:{at}', (('return_delay', 3),), DXL1),
    Case('reboot:3:{at}', (('dropout', 3),), DXL1),
    Case('two_masters::{at}', (('two_masters', None),), DXL1_BULK),
    Case('wrong_map:3:{at}', (('layout', 3),), DXL1),
    Case('last_id::{at}', (('no_answer', 253),), DXL1),
    Case('locked:3:{at}', (('lock', 3),), DXL1),
    Case('ping_only:3:{at}', (('ping_only', 3),), DXL1),
    Case('protocol2::{at}', (('protocol_1', None),), DXL1),
    Case('high_supply:3:{at}', (('wrong_supply', 3),), DXL1),
    Case('low_supply:3:0', (('wrong_supply', 3),), DXL1),
)
