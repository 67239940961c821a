# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Rules of pairing, each in one row: what is heard, and what is known of the devices then.

The keys of what is known: `kinds` of the incidents, the newest `note`, the numbers of all
`devices`; and of devices by their numbers: a count, an attribute, the `model`, the `position`, the
`goal`, other bytes as ADDRESS:SIZE.
"""


import pytest
from tracked_bus import Bus
from tracked_bus import damaged
from tracked_bus import fast_read
from tracked_bus import fast_reply
from tracked_bus import FILLED
from tracked_bus import GOAL
from tracked_bus import MX_106
from tracked_bus import notes
from tracked_bus import ping
from tracked_bus import pong
from tracked_bus import POSITION
from tracked_bus import read
from tracked_bus import reply
from tracked_bus import SENSELESS
from tracked_bus import sync_read
from tracked_bus import words
from tracked_bus import write

from dxl_monitor.bus import evidence as ev
from dxl_monitor.bus.expected import Expected
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS

IDLE, SILENCE = b'idle', b'silence'      # the line is idle for a moment, for a second

HEARD = {
    'the answer to a read goes into the table': [
        (read(1), reply(1, b'\x01\x02\x03\x04')),
        {'position 1': b'\x01\x02\x03\x04', 'answers 1': 1}],
    'every packet of one chunk counts in its order': [
        (read(1) + reply(1, b'aaaa') + write(1, POSITION, b'bbbb') + reply(1) + ping(2),),
        {'position 1': b'bbbb'}],
    'a stuffed answer is unstuffed': [
        (read(1), reply(1, b'\xff\xff\xfd\x00')),
        {'position 1': b'\xff\xff\xfd\x00'}],
    'an answer that should be stuffed and is not': [
        (read(1), encode(1, STATUS, b'\xff\xff\xfd\x00', error=0, stuffed=False)),
        {'position 1': b'\xff\xff\xfd\x00'}],
    'an alert is noted and its data are taken': [
        (read(1), reply(1, b'\x01\x02\x03\x04', error=0x80)),
        {'position 1': b'\x01\x02\x03\x04', 'alert 1': True},
        (read(1), reply(1, b'\x05\x02\x03\x04')),
        {'alert 1': False, 'position 1': b'\x05\x02\x03\x04'}],
    'an error number is counted by address and its data are not taken': [
        (read(1), reply(1, b'aaaa', error=0x87)),
        {'position 1': None, 'errors 1': {(I.READ, POSITION, 7): 1}}],
    'an answer that was given up long before is late and not unasked': [
        (read(1), *[read(2), reply(2, bytes(4))] * 3, reply(1, bytes(4))),
        {'kinds': ['missed', 'late answer']},
        (reply(1, bytes(4)),),
        {'kinds': ['missed', 'late answer', 'unasked answer']}],
    'an answer that came damaged is not owed': [
        (read(1), damaged(reply(1, bytes(4))), read(1), reply(1, bytes(4)), reply(1, bytes(4))),
        {'kinds': ['damaged status', 'missed', 'repeated', 'second answer']}],
    'the next instruction ends the doubt': [
        (read(1), damaged(read(1)), read(1), reply(1, b'aaaa')),
        {'position 1': b'aaaa'}],
    'a repaired answer is an answer': [
        (read(1), b'\x00' + reply(1, b'aaaa')[1:]),
        {'position 1': b'aaaa', 'repaired 1': 1}],
    'who does not answer before the next instruction is missed': [
        (read(1), read(2), reply(2, b'aaaa'), read(1), reply(1, b'aaaa')),
        {'missed 1': 1, 'missed_in_a_row 1': 0, 'missed 2': 0}],
    'a broadcast read disconnects no device': [
        (ping(1), pong(1), *[read(BROADCAST)] * 10),
        {'missed 1': 0, 'devices': [1]}],
    'a silent first device of a sync read keeps the others waiting': [
        (*[sync_read(1, 2, 3)] * 6, ping(9), pong(9)),
        {'missed 1 2 3': [6, 0, 0], 'not_served 1 2 3': [0, 6, 6], 'waiting_behind 1 2 3': [None,
         1, 1]}],
    'a silent device in the middle is missed alone': [
        (sync_read(1, 2, 3), reply(1, b'aaaa'), reply(3, b'cccc'), ping(9)),
        {'missed 1 2 3': [0, 1, 0], 'not_served 1 2 3': [0, 0, 0]}],
    'the order of the list counts not that of the ids': [
        (sync_read(3, 1, 2), reply(3, b'aaaa'), ping(9)),
        {'missed 1 2 3': [1, 0, 0], 'waiting_behind 2': 1}],
    'who spoke but was damaged is missed and not waiting': [
        (sync_read(1, 2), reply(1, b'aaaa'), damaged(reply(2, b'bbbb')), ping(9)),
        {'missed 2': 1, 'not_served 2': 0, 'damaged 2': 1}],
    'a missing acknowledgement is no loss before one was seen': [
        (write(1, GOAL, b'aaaa'), write(1, GOAL, b'bbbb'), ping(2)),
        {'missed 1': 0, 'goal 1': b'bbbb'}],
    'a missing acknowledgement is a loss once one was seen': [
        (write(1, GOAL, b'aaaa'), reply(1), write(1, GOAL, b'bbbb'), ping(2)),
        {'missed 1': 1, 'goal 1': b'aaaa'}],
    'the return level is learned from the register': [
        (ping(1), pong(1), read(1, 68, 1), reply(1, b'\x02'), write(1, GOAL, b'aaaa'), ping(2)),
        {'missed 1': 1},
        (write(1, 68, b'\x01'), reply(1), write(1, GOAL, b'aaaa'), ping(2)),
        {'return_level 1': 1, 'missed 1': 1}],
    'at return level 0 reads are not answered': [
        (ping(1), pong(1), write(1, 68, b'\x00'), read(1), ping(2)),
        {'missed 1': 0}],
    'a refused write never was': [
        (write(1, GOAL, b'aaaa'), reply(1), write(1, GOAL, b'bbbb'), reply(1, error=4)),
        {'goal 1': b'aaaa', 'errors 1': {(I.WRITE, GOAL, 4): 1}},
        (ping(2),),
        {'goal 1': b'aaaa'}],
    'a write with an alert is accepted': [
        (write(1, GOAL, b'aaaa'), reply(1, error=0x80)),
        {'goal 1': b'aaaa'}],
    'sync and bulk writes take effect at once': [
        (encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01aaaa\x02bbbb'),),
        {'goal 1': b'aaaa', 'goal 2': b'bbbb'},
        (encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01cccc\x02\xff\xff\xfd\x00'),),
        {'goal 1': b'cccc', 'goal 2': b'\xff\xff\xfd\x00'},
        (encode(BROADCAST, I.BULK_WRITE, b'\x01' + words(GOAL, 4) + b'dddd'),),
        {'goal 1': b'dddd'}],
    'a write that makes no sense behind one that does is noted': [
        (encode(BROADCAST, I.SYNC_WRITE, words(GOAL, 4) + b'\x01cccc\x02bbbb'), SENSELESS),
        {'note': (ev.MALFORMED, BROADCAST, (I.SYNC_WRITE, 13)), 'goal 1': b'cccc'}],
    'a broadcast write is for everybody known': [
        (ping(1), pong(1), ping(2), pong(2), write(BROADCAST, 64, b'\x01')),
        {'64:1 1': b'\x01', '64:1 2': b'\x01'}],
    'a reg write counts at the action': [
        (encode(1, I.REG_WRITE, words(GOAL) + b'aaaa'), reply(1)),
        {'goal 1': None},
        (encode(BROADCAST, I.ACTION),),
        {'goal 1': b'aaaa'}],
    'a refused reg write is not carried out': [
        (encode(1, I.REG_WRITE, words(GOAL) + b'aaaa'), reply(1, error=7), encode(1, I.ACTION),
         reply(1)),
        {'goal 1': None}],
    'a reboot forgets ram': [
        (*FILLED, encode(1, I.REBOOT), reply(1)),
        {'goal 1': None, '7:4 1': b'\x01\x03\xfa\x00', 'model 1': 'MX-64'}],
    'a refused reboot forgets nothing': [
        (*FILLED, encode(1, I.REBOOT), reply(1, error=1), ping(2)),
        {'goal 1': b'gggg'}],
    'a factory reset keeps what it says': [
        (*FILLED, encode(1, I.FACTORY_RESET, b'\x02'), reply(1)),
        {'goal 1': None, '7:2 1': b'\x01\x03', '9:1 1': None, 'moved_to 1': ''}],
    'a factory reset of all makes it device 1 at 57600': [
        (ping(5), pong(5), encode(5, I.FACTORY_RESET, b'\xff'), reply(5)),
        {'devices': [1], 'moved_to 1': '57600 Bd'}],
    'clear forgets the position alone': [
        (*FILLED, encode(1, I.CLEAR, b'\x01DXL"'), reply(1)),
        {'position 1': None, 'goal 1': b'gggg'}],
    'a restored backup forgets everything a stored one nothing': [
        (*FILLED, encode(1, I.CONTROL_TABLE_BACKUP, b'\x01CTRL'), reply(1)),
        {'goal 1': b'gggg'},
        (encode(1, I.CONTROL_TABLE_BACKUP, b'\x02CTRL'), reply(1)),
        {'goal 1': None, '9:1 1': None}],
    'a refused id is not followed': [
        (*FILLED, write(1, 7, b'\x09'), reply(1, error=7), ping(1), pong(1)),
        {'devices': [1]}],
    'an id whose acknowledgement makes no sense is not followed': [
        (*FILLED, write(1, 7, b'\x09'), reply(1, b'x'), reply(9)),
        {'devices': [1, 9], 'kinds': ['wrong size', 'unasked answer']}],
    'an id written to everybody is that of the only one': [
        (Expected(2, 'MX-106', 'right_knee'),),
        (ping(1), pong(1), write(BROADCAST, 7, b'\x09'), ping(9), pong(9)),
        {'devices': [2, 9], 'answers 9': 2}],
    'who replaces a dead device is a new one under its id': [
        (ping(5), pong(5, MX_106), read(5), ping(1), pong(1), write(1, 7, b'\x05'), reply(1),
         ping(5), pong(5)),
        {'devices': [5], 'model 5': 'MX-64'}],
    'a written baud rate is followed': [
        (*FILLED, write(1, 8, b'\x01'), reply(1)),
        {'moved_to 1': '57600 Bd'},
        (read(1), reply(1, b'aaaa')),
        {'moved_to 1': ''}],
    'the baud rate of this bus is no move': [
        (*FILLED, write(1, 8, b'\x04'), reply(1)),
        {'moved_to 1': ''}],
    'an unknown device is upgraded by ping and keeps what was seen': [
        (read(1), reply(1, b'pppp')),
        {'model 1': 'unknown'},
        (ping(1), pong(1, MX_106)),
        {'model 1': 'MX-106', 'position 1': b'pppp', '6:1 1': b'\x29'}],
    'a broadcast ping names everybody': [
        (ping(BROADCAST), pong(1), pong(2, MX_106)),
        {'model 1 2': ['MX-64', 'MX-106']}],
    'the devices parameter names the model': [
        (Expected(1, 'MX-64', 'left_knee'),),
        (read(1), reply(1, b'pppp'), ping(1), pong(1)),
        {'model 1': 'MX-64', 'position 1': b'pppp', 'model_changes 1': 0}],
    'a model without a file stays raw': [
        (ping(1), pong(1, 4242), read(1), reply(1, b'pppp')),
        {'model 1': 'unknown', 'model_number 1': 4242, 'position 1': b'pppp'}],
    'a fast read fills every table': [
        (fast_read(1, 2), fast_reply({1: b'aaaa', 2: HEADER}, {2: 0x80}), ping(9)),
        {'position 1': b'aaaa', 'position 2': HEADER, 'alert 2': True, 'missed 1 2': [0, 0]}],
    'a device may refuse a fast read on its own': [
        (fast_read(1), reply(1, error=2), ping(9)),
        {'errors 1': {(I.FAST_SYNC_READ, POSITION, 2): 1}, 'missed 1': 0}],
    'a group asks up to the highest id and none above': [
        (sync_read(252, 253), reply(252, b'aaaa')),
        {'devices': [252], 'position 252': b'aaaa'}],
    'damage is noted exactly': [
        (read(1), damaged(reply(1, b'1234'))),
        {'note': (ev.DAMAGED_STATUS, 1, (STATUS, 8))},
        (damaged(encode(1, I.WRITE, bytes(300))),),
        {'note': (ev.DAMAGED_INSTRUCTION, 1, (I.WRITE, 303))},
        (HEADER + b'\x01\x34\x12\x03' + bytes(8),),
        {'note': (ev.BAD_LENGTH, ev.NO_DEVICE, (0x1234,))},
        (read(1)[:-3], IDLE),
        {'note': (ev.CUT, ev.NO_DEVICE, (I.READ, 7))}],
    'the last id is a device and the next is none': [
        (reply(252), reply(253)),
        {'devices': [252], 'note': (ev.BAD_ID, ev.NO_DEVICE, (253,))}],
    'only what has the size of a pong answers a broadcast ping': [
        (ping(BROADCAST), pong(3), reply(4, b'1234'), read(3), reply(3, b'1234'), pong(5)),
        {'answers 3 4 5': [2, 0, 0], 'model 3': 'MX-64', 'model 5': 'unknown'}],
    'glitches and the first to answer are counted': [
        (sync_read(1, 2), b'\x00' + reply(1, b'1234'), reply(2, b'1234')),
        {'glitches 1': 1, 'glitches 2': 0, 'asked_first 1': 1, 'asked_first 2': 0}],
    'what no answer contradicts is carried out at the next instruction': [
        (ping(1), pong(1), write(1, GOAL, b'1234'), reply(1, b'too long')),
        {'goal 1': None},
        (ping(1),),
        {'goal 1': b'1234'}],
    'before the first instruction nothing is wrong about an answer': [
        (reply(1, b'1234'),),
        {'kinds': []}],
    'a second answer behind damage is noted as asked again': [
        (read(1), reply(1, b'1234'), damaged(read(1)), reply(1, b'1234')),
        {'note': (ev.ANSWERED_AGAIN, 1, (I.READ,))}],
    'who spoke damaged is forgotten at the next instruction': [
        (read(2), damaged(reply(2, b'1234')), sync_read(1, 2), ping(9)),
        {'missed 1': 1, 'missed 2': 1, 'not_served 2': 1}],
    'a refusal acknowledges too': [
        (write(1, GOAL, b'1234'), reply(1, error=4)),
        {'acks 1': True, 'acks_missing 1': 0}],
    'whose turn was later tells no latency': [
        (sync_read(1, 2), reply(2, b'1234'), read(2), damaged(ping(1)), reply(2, b'1234')),
        {'latency_resolved 2': 0},
        (read(2), reply(2, b'1234')),
        {'latency_resolved 2': 1}],
    'what no answer contradicts is carried out in silence too': [
        (ping(1), pong(1), write(1, GOAL, b'1234'), reply(1, b'too long'), SILENCE),
        {'goal 1': b'1234'}],
    'who waited behind a silent device waits no longer once it answers': [
        (ping(1), pong(1), ping(2), pong(2), sync_read(1, 2), ping(9)),
        {'waiting_behind 2': 1},
        (read(2), reply(2, b'1234')),
        {'waiting_behind 2': None}],
}


def known(bus, key):
    what, *numbers = key.split()
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
    return getattr(device.counts if hasattr(device.counts, what) else device, what)


@pytest.mark.parametrize('name', HEARD)
def test_what_is_heard_and_known(name):
    first, *others = HEARD[name]
    is_expected = isinstance(first[0], Expected)
    bus = Bus(*first) if is_expected else Bus()
    for step in others if is_expected else HEARD[name]:
        if isinstance(step, dict):
            assert {key: known(bus, key) for key in step} == step
            continue
        for packet in step:
            if packet == IDLE:
                bus.idle()
            elif packet == SILENCE:
                bus.tracker.settle(bus.now + 10**9)
            else:
                bus.hear(packet)
