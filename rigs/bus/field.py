# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Cases of public issue threads as scenes: the program, the fault, and what the thread found.

Each is played in its own protocol. What is expected is what the thread found; it was written
before any rule was changed for it.
"""

from functools import partial

from rigs.bus import faults as f
from rigs.bus import masters as m
from rigs.bus import masters1 as m1
from rigs.bus import servo as reg
from rigs.bus.ear import FINE
from rigs.bus.scene import scene
from rigs.bus.servo1 import AX_12
from rigs.bus.servo1 import MX_28
from rigs.bus.servo1 import STS3215

SDK, DHI, ROBOT, ARM = m.sdk_loop, m.hardware_interface, m.bitbots, m.lerobot
ROUND = partial(m.poller, torque=True)
GOES_ON = partial(m1.lerobot, gives_up=False)
SIX = (1, 2, 3, 4, 5, 6)
NINE = tuple(range(10, 19))


def xs_start(port, ids):
    """Start as xs_sdk does: three rounds of Ping and torque off, also where the Ping failed."""
    for _ in range(3):
        for number in ids:
            yield from port.ping(number)
            yield from port.write(number, reg.TORQUE, b'\0')


def _supply(rig, volts):
    """Feed nine XL330, whose limits are 3.5 and 7.0 V."""
    for number in NINE:
        servo = rig.servos[number]
        servo.put(reg.MAX_VOLTS, 2, 70)
        servo.put(reg.MIN_VOLTS, 2, 35)
        servo.volts = lambda: volts


LIMITS = m.reads(10, reg.MAX_VOLTS, 4)

_OF_2 = (
    scene('T10 wiring, nothing answers', m.poller, 'all_silent', since=0.0, also='weak 1 2',
          ids=(1, 2), absent=(1, 2)),
    scene('T13 overload that is not cleared', partial(ROBOT, rate=46.0), 'hardware_error 17',
          (f.latched(17), partial(_supply, volts=5.0)), 'torque_off 17', ids=NINE,
          model='XL330-M288'),
    scene('T19 over-voltage latch of all', partial(SDK, rate=50.0),
          'hardware_error 10-18, voltage', tuple(f.latched(number, 1) for number in NINE),
          'hardware_error torque_off 10-18', ids=NINE, model='XL330-M288'),
    scene('T20 7.6 V at a limit of 7.0 V', m.beside(partial(ROBOT, rate=50.0), LIMITS),
          'voltage hardware_error 10-18 bus',
          (partial(_supply, volts=7.6), *(f.latched(number, 1, at=6.0) for number in NINE)),
          'voltage hardware_error torque_off 10-18', since=0.0, ids=NINE, model='XL330-M288'),
    scene('T22 empty battery', ROBOT, 'voltage all_silent brown_out, voltage 1 2',
          (f.sagging((1, 2), 8.6), f.dead(1, 2, at=15.0)), 'weak voltage 1 2', ids=(1, 2),
          model='XM430-W350'),
    scene('T23 emergency stop in the supply', SDK, 'brown_out', f.away(*SIX, at=8.0, seconds=2.0),
          'all_silent, weak rebooted torque_off 1-6'),
    scene("T28 'Can't find' a servo that is there", xs_start, 'hardware_error 8',
          f.latched(8, at=0.05), 'master_stopped', ids=(6, 7, 8, 9)),
    scene('T34 latency timer 16 ms', partial(m.poller, rate=1000.0, writes=()), 'latency_timer',
          since=0.0, latency_ms=16.0),
    scene('T35 firmware without Fast Sync Read', DHI, 'fast_read_unsupported 1', since=0.0,
          ids=(1,), firmware=42),
    scene('T38 thread without CPU', partial(SDK, rate=15.0), 'jitter', f.busy_host(40.0)),
    scene('T40 57600 baud at 50 Hz', partial(SDK, rate=50.0), 'bus_too_slow', since=0.0,
          baud=57_600),
    scene('T41 one lost answer ends the program', ARM, 'master_stopped, missed_answers 4',
          f.loose(4, 0.02), 'weak 4'),
    scene('T43 forgotten second program', partial(SDK, rate=50.0), 'two_masters',
          f.second_master(partial(SDK, rate=33.3, torque=False), list(SIX))),
    scene('T44 write of a second thread', partial(SDK, rate=50.0), 'two_masters noise',
          f.second_master(partial(m.poller, rate=13.0, enables=False), [2]), 'noise',
          why='two threads or two programs: partly'),
    scene('T52 25 servos in one chain, the far ones fail', partial(SDK, rate=50.0),
          'missed_answers sync_read_stops 20-25',
          tuple(f.loose(number, 0.03) for number in range(20, 26)), 'weak 20-25',
          ids=tuple(range(1, 26)), model='XM430-W350', baud=3_000_000),
    scene('T56 EEPROM write with torque on', m.beside(ARM, m.writes(1, 20, b'\x66\0\0\0')),
          'eeprom_locked 1', since=8.0),
    scene('T61 pinched cable at the first joint, Fast Sync Read', DHI,
          'missed_answers damaged_answers 11', f.loose(11, 0.3), 'weak 11',
          ids=(11, 12, 13, 14, 15)),
)
_OF_1 = (
    scene('T01 two servos with the factory ID', GOES_ON,
          'factory_id duplicate_id damaged_answers 1', f.twin(1, model=STS3215), 'weak 1 2',
          ids=(1, 2), absent=(2,), model=STS3215,
          why='factory_id is what the thread found; the other two are older'),
    scene('T03 two servos with one ID, read one by one', m1.read_write,
          'duplicate_id damaged_answers 2', f.twin(2, model=AX_12), 'weak 2', ids=(2,),
          model=AX_12),
    scene('T04 first and last never set up', m1.check, 'no_answer 1 6', since=0.0, also='weak 1 6',
          absent=(1, 6), model=STS3215),
    scene('T06 Lock is sent to the old ID', m1.set_id, 'lock 1 5', since=1.0, also='weak 1',
          ids=(1,), model=STS3215,
          why='its EEPROM stays open; the acknowledgement with the new ID is no foreign answer'),
    scene('T07 ID lost in a dip', m1.hexapod, 'no_answer 4, duplicate_id damaged_answers 1',
          (f.changed(4, is_on=False), f.twin(1, 8.0, model=AX_12)), 'weak 1 4', model=AX_12,
          why='either half is half of the cause'),
    scene('T08 loose plug, the arm moves', GOES_ON, 'missed_answers 4', f.loose(4, 0.05), 'weak 4',
          model=STS3215),
    scene('T11 adapter with a bad contact, one servo', m1.read_write, 'all_silent, no_answer 12',
          since=0.0, ids=(12,), absent=(12,), model=AX_12),
    scene('T14 7.4 V servo on 12 V', m1.check, 'hardware_error voltage 2',
          f.changed(2, 0.0, errors=0x01), ids=(2, 3, 4, 5, 6), model=STS3215),
    scene('T25 overload, seen at the end only', m1.lerobot, 'hardware_error 3',
          f.changed(3, errors=0x20), 'torque_off 3', model=STS3215),
    scene('T26 gripper against its stop, then silent', GOES_ON,
          'hardware_error no_answer sync_read_stops 6',
          (f.changed(6, errors=0x20), f.changed(6, 14.0, is_on=False)), 'weak torque_off 6',
          model=STS3215),
    scene('T29 overload in a round of reads', m1.rounds, 'hardware_error 3',
          f.changed(3, errors=0x20), 'torque_off 3', model=MX_28),
    scene('T37 Return Delay Time as from the factory', partial(m1.rounds, rate=50.0, size=2),
          'return_delay 1-6', since=0.0, delay=250, model=AX_12, ear=FINE),
    scene('T49 stray byte in front', m1.read_write, 'stray_bytes', f.spoil(f.stray, 1.0, 'servo'),
          ids=(1,), baud=57_600, model=MX_28),
    scene('T50 single bits, from several servos', m1.duck, 'noise', f.spoil(f.flip, 0.02, 'servo'),
          'torque_off 20-33', ids=tuple(range(20, 34)), model=STS3215,
          why='nothing switches the torque on'),
    scene('T53 firmware 3.9 on one servo', partial(GOES_ON, firmware=True), 'mixed_firmware',
          f.register(3, 1, 1, 9), model=STS3215),
    scene('T58 writes without a wait', m1.sweep, 'impatient_master', since=0.0, model=STS3215),
    scene('T59 odd position of a servo (control)', GOES_ON, model=STS3215),
)

# Where they are from:
#   T01, T04, T08, T14  huggingface/lerobot #526, #1603, #560, #2387
#   T03, T11, T23, T52  ROBOTIS-GIT/DynamixelSDK #11, #106, #282, #518
#   T06                 fanhao375/microduck-replica PR #28
#   T07                 KurtE/Phantom_Phoenix #3
#   T10, T40            ROBOTIS-GIT/dynamixel-workbench #71, #370
#   T13, T19, T20       pollen-robotics/reachy_mini #1163, #1402, #589
#   T22                 ROBOTIS-GIT/turtlebot3 #338
#   T25                 humancomputerlab/lelamp_runtime #9
#   T26                 open-edge-platform/physical-ai-studio #955
#   T28                 Interbotix/interbotix_ros_manipulators #252
#   T29                 start-jsk/jsk_apc #1960
#   T34                 ROBOTIS-GIT/DynamixelSDK PR #116
#   T35                 ROBOTIS-GIT/dynamixel_hardware_interface #79
#   T37, T49            poppy-project/pypot #92, #309
#   T38, T43, T44       hello-robot/stretch_body #44, PR #218, PR #181
#   T41, T53, T56, T59  huggingface/lerobot PR #1349, #532, PR #1889, #1296
#   T50                 apirrone/Open_Duck_Mini #49
#   T58                 strands-labs/robots #3398
#   T61                 notes of users of OpenMANIPULATOR-X
PLAYED = tuple(sorted((*_OF_2, *_OF_1), key=lambda one: one.name))

# What is not played, or cannot be told from the wire: why, and what would tell it.
NOT_PLAYED = (
    ('T16', 'which of two causes made the message is not on the wire; reading the firmware would'),
    ('T17', 'servos in protection are silent, as without supply: measure the supply'),
    ('T31, T32', 'a servo at another rate is silent, as without supply: listen while a Wizard '
     'scans all rates'),
    ('T46', 'no byte of any master: dxl_doctor says so, with the usual reasons'),
    ('T47', 'all is answered, and the program does not use it: there is no rule for that yet'),
    ('T55', 'an instruction that only one adapter knows: it goes unanswered, all else is well; '
     'there is no rule for that yet'),
    ('T62', 'nothing leaves the adapter: dxl_doctor says so, with the usual reasons'),
)
