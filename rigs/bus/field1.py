# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Cases of public issue threads that were on Protocol 1.0 or on Feetech servos, in that protocol.

What is expected is what the thread found; it was written down before any rule was changed for it.
"""

from __future__ import annotations

from functools import partial

from rigs.bus import faults as f
from rigs.bus import masters1 as m
from rigs.bus.ear import FINE
from rigs.bus.faults import Fault
from rigs.bus.rig import Rig
from rigs.bus.scene import Key
from rigs.bus.scene import Scene
from rigs.bus.servo1 import AX_12
from rigs.bus.servo1 import Kind
from rigs.bus.servo1 import MX_28
from rigs.bus.servo1 import Servo1
from rigs.bus.servo1 import STS3215

SIX = (1, 2, 3, 4, 5, 6)
WEAK = ('missed_answers', 'dropout', 'no_answer', 'sync_read_stops')
GOES_ON = partial(m.lerobot, gives_up=False)


def _of(*rules: str, ids: tuple[int | None, ...] = (None,)) -> tuple[Key, ...]:
    return tuple((rule, number) for rule in rules for number in ids)


def twin(number: int, at: float = 0.0, *, kind: Kind = STS3215, own_us: int = 40) -> Fault:
    """Add a second servo with the same ID, at another place."""
    def fault(rig: Rig) -> None:
        def join() -> None:
            other = Servo1(rig.wire, number, kind, own_us=own_us, place=1000.0)
            other.tremor = number + 1.6    # two joints never stand in the same place to the step
            rig.alter()
        rig.at(at, join)
    return fault


def bits(number: int, errors: int, at: float = 8.0) -> Fault:
    """Let a servo carry these error bits in each of its statuses."""
    def fault(rig: Rig) -> None:
        rig.altering(at, lambda: setattr(rig.servos[number], 'errors', errors))
    return fault


def silent(number: int, at: float = 8.0) -> Fault:
    """End the supply of a servo."""
    def fault(rig: Rig) -> None:
        rig.altering(at, lambda: setattr(rig.servos[number], 'is_on', False))
    return fault


def firmware(number: int, minor: int) -> Fault:
    """Give a Feetech servo another firmware than the rest."""
    def fault(rig: Rig) -> None:
        rig.altering(0.0, lambda: rig.servos[number].put(1, 1, minor))
    return fault


PLAYED: tuple[Scene, ...] = (
    Scene('T01 two servos with the factory ID', partial(m.lerobot, gives_up=False),
          _of('factory_id', 'duplicate_id', 'damaged_answers', ids=(1,)), (twin(1),),
          _of(*WEAK, ids=(1, 2)),
          ids=(1, 2), absent=(2,), family=STS3215, why='factory_id is what the thread found; the '
          'other two were written before there was that rule'),
    Scene('T03 two servos with one ID, read one by one', m.read_write,
          _of('duplicate_id', 'damaged_answers', ids=(2,)), (twin(2, kind=AX_12),),
          _of(*WEAK, ids=(2,)), ids=(2,), family=AX_12),
    Scene('T04 first and last never set up', m.check, _of('no_answer', ids=(1, 6)),
          (f.since(0.0),), _of(*WEAK, ids=(1, 6)), absent=(1, 6), family=STS3215),
    Scene('T06 Lock is sent to the old ID', m.set_id, _of('lock', ids=(1, 5)), (f.since(1.0),),
          _of(*WEAK, ids=(1,)), ids=(1,), family=STS3215,
          why='its EEPROM stays open; the acknowledgement with the new ID is no foreign answer'),
    Scene('T07 ID lost in a dip', m.hexapod, _of('no_answer', ids=(4,))
          + _of('duplicate_id', 'damaged_answers', ids=(1,)),
          (silent(4), twin(1, 8.0, kind=AX_12)), _of(*WEAK, ids=(1, 4)), family=AX_12,
          why='either half is half of the cause'),
    Scene('T08 loose plug, the arm moves', GOES_ON, _of('missed_answers', ids=(4,)),
          (f.loose(4, 0.05),), _of(*WEAK, ids=(4,)), family=STS3215),
    Scene('T11 adapter with a bad contact, one servo', m.read_write,
          _of('all_silent') + _of('no_answer', ids=(12,)), (f.since(0.0),), ids=(12,),
          absent=(12,), family=AX_12),
    Scene('T14 7.4 V servo on 12 V', m.check, _of('hardware_error', 'voltage', ids=(2,)),
          (bits(2, 0x01, 0.0),), ids=(2, 3, 4, 5, 6), family=STS3215),
    Scene('T25 overload, seen at the end only', m.lerobot, _of('hardware_error', ids=(3,)),
          (bits(3, 0x20),), _of('torque_off', ids=(3,)), family=STS3215),
    Scene('T26 gripper against its stop, then silent', GOES_ON,
          _of('hardware_error', 'no_answer', 'sync_read_stops', ids=(6,)),
          (bits(6, 0x20), silent(6, 14.0)), _of(*WEAK, 'torque_off', ids=(6,)), family=STS3215),
    Scene('T29 overload in a round of reads', m.rounds, _of('hardware_error', ids=(3,)),
          (bits(3, 0x20),), _of('torque_off', ids=(3,)), family=MX_28),
    Scene('T37 Return Delay Time as from the factory', partial(m.rounds, rate=50.0, size=2),
          _of('return_delay', ids=SIX), (f.since(0.0),), delay=250, family=AX_12, ear=FINE),
    Scene('T49 stray byte in front', m.read_write, _of('stray_bytes'),
          (f.spoil(f.stray, 1.0, 'servo'),), ids=(1,), baud=57_600, family=MX_28),
    Scene('T50 single bits, from several servos', m.duck, _of('noise'),
          (f.spoil(f.flip, 0.02, 'servo'),), ids=tuple(range(20, 34)), family=STS3215),
    Scene('T53 firmware 3.9 on one servo', partial(GOES_ON, firmware=True), _of('mixed_firmware'),
          (firmware(3, 9),), family=STS3215),
    Scene('T58 writes without a wait', m.sweep, _of('impatient_master'), (f.since(0.0),),
          family=STS3215),
    Scene('T59 odd position of a servo (control)', GOES_ON, family=STS3215),
)
