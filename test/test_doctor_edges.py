# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The thresholds of the doctor's rules, on both sides of the edge, and the words and figures told.

Each row is a case that is just enough for a rule, and the changes that make it too little. A case
is made by hand: what a bus must say to bring it about is in test_doctor_evidence.py.
"""


from doctor_case import asks
from doctor_case import claims
from doctor_case import device
from doctor_case import MODELS
from doctor_case import note
from doctor_case import NOW
from doctor_case import S
from doctor_case import speaks_from_its_edge_on
import pytest

from dxl_monitor.bus import evidence as ev
from dxl_monitor.bus import report as words
from dxl_monitor.bus.report import Counts
from dxl_monitor.bus.report import Incident
from dxl_monitor.bus.report import Wait
from dxl_monitor.doctor.case import Sample
from dxl_monitor.doctor.health import FACTORY
from msg_defs.dxl1_instruction import FEETECH
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl_instruction import Instruction as I
from msg_defs.dxl_packet import BROADCAST
from msg_defs.reports import Level

# --- what is just enough ---------------------------------------------------------------------

def spoken(number=1, **parts):
    """Return a device that gave 1000 answers in 10 s."""
    return device(number, **{'window': {'answers': 1000}, 'totals': {'answers': 1000}, **parts})


def damage(count, asked=0, every_ms=300.0):
    return note(ev.DAMAGED_INSTRUCTION, ev.Front(I.READ, 7), asked) + note(
        ev.DAMAGED_STATUS, ev.Front(0x55, 8), count - asked, every_ms=every_ms)


TWO_HIT = (spoken(1, window={'answers': 8, 'spoilt': 2}),
           spoken(2, window={'answers': 8, 'spoilt': 2}))
ONE_HIT = (spoken(1, window={'answers': 93, 'missed': 7, 'spoilt': 7}),
           spoken(2, window={'answers': 97, 'missed': 3, 'spoilt': 3}))
SILENT = {'state': words.DISCONNECTED, 'missed_in_a_row': 9, 'last_heard_s': 1.6,
          'window': {'missed': 9}}
LOST = {'window': {'answers': 297, 'missed': 3}}
MISSED = note(ev.MISSED, ev.Unanswered(I.READ, 132), 3)
GLITCHES = {10: {'glitches': 2}, 0: {'glitches': 7}}
FAST_READ = asks(I.FAST_SYNC_READ, 1, 2, asked=3, stamps=(NOW - 2 * S,))


def back(ms, number=1, torque=-1, ago_s=2.5):
    """Return a return after so long an absence."""
    return [Incident(NOW - int(ago_s * S), ev.RETURNED, number, ev.SilentFor(ms, torque))]


def sample(ago_s, goal=None, position=None, tick=None, voltage=None):
    return Sample(NOW - int(ago_s * S), goal, position, tick, voltage)


def ticks(before, after):
    """Return Realtime Tick before an absence and 2 s later, behind it."""
    return [sample(4, tick=before), sample(2, tick=after)]


def volts(before, after):
    return [sample(4, voltage=before), sample(1, voltage=after)]


STANDING = [sample(2.4, 1, 1), sample(2.2, 100, 200), sample(1, 120, 200)]


def watched(at, every=S // 4):
    return asks(I.READ, 1, at=at, size=4, stamps=range(NOW - 3 * every, NOW + 1, every))


def at_5(**parts):
    return device(registers={'Present Position': 5}, **parts)


def places(*positions):
    return [sample(3 - at / 2, 0, place) for at, place in enumerate(positions)]


def both_sides(goal, position=0):
    return [sample(3 - at / 2, goal * (-1) ** at, position * (at > 3)) for at in range(5)]


def moves(seconds, goal, position):
    """Return a goal and a position that move so far in so long; the first sample is not used."""
    return [sample(seconds + 0.05, 1000, 1000), sample(seconds, 100, 200),
            sample(0, 100 + goal, 200 + position)]


ENOUGH = [
    ('wrong_baud',
     {'counters': {'Bytes': 400, 'Packet Bytes': 51},
      'marks': {3: {}, 2: {'bytes': 100, 'packet_bytes': 50, 'framing': 4}, 0: {'framing': 9}}},
     '300 bytes, but no packets at 1000000 Bd: the right rate is unknown: set `bauds` to the '
     'rate of the bus', {'bytes': '300', 'framing errors': '5'},
     [{'counters': {'Bytes': 399, 'Packet Bytes': 51}},
      {'counters': {'Bytes': 400, 'Packet Bytes': 52}}, {'baud': 0},
      {'notes': note(ev.PROTOCOL_1, ev.Code(2), 1)}]),
    ('wrong_baud', {'counters': {'Bytes': 600_001, 'Packet Bytes': 600_001},
                    'started': NOW - 5 * S},
     'more bytes than 1000000 Bd can carry: the bus is faster; set `bauds` to its rate',
     {'load (%)': '120'},
     [{'counters': {'Bytes': 600_000, 'Packet Bytes': 600_000}}, {'has_sides': True},
      {'baud': 0}]),
    ('wrong_baud', {'counters': {'Bytes': 500_000, 'Packet Bytes': 500_000},
                    'started': NOW - 4 * S},
     'more bytes than 1000000 Bd can carry: the bus is faster; set `bauds` to its rate',
     {'load (%)': '125'},
     [{'counters': {'Bytes': 499_999, 'Packet Bytes': 499_999}}]),
    ('protocol_1', {'whom': None, 'protocol': words.PROTOCOL_2,
                    'notes': note(ev.PROTOCOL_1, ev.Code(2), 2, 8)
                    + note(ev.PROTOCOL_1, ev.Code(2), 1, 7)},
     f'{UNDECIDED.name}, ID 007, 008, on a bus of Dynamixel 2.0: set these devices to Protocol '
     '2.0 if they have it, or give them another bus', {'packets': '3'},
     [{'notes': note(ev.PROTOCOL_1, ev.Code(2), 1)}, {'protocol': 'Feetech'}]),
    ('protocol_1', {'whom': None, 'protocol': words.PROTOCOL_2,
                    'devices': [*(spoken(number) for number in range(1, 7)),
                                *(spoken(number, protocol=FEETECH.name)
                                  for number in range(11, 17)), device(20)],
                    'notes': note(ev.PROTOCOL_1, ev.Code(2), 2)},
     f'{FEETECH.name}, ID 011, 012, 013, 014 and 2 more, on a bus of Dynamixel 2.0: give these '
     'devices a bus of their own', {'packets': '2'}, []),
    ('protocol_1', {'whom': None, 'protocol': 'Dynamixel 1.0',
                    'devices': [spoken(1), *(spoken(number, protocol='Dynamixel 1.0')
                                             for number in (2, 3))],
                    'notes': note(ev.PROTOCOL_1, ev.Code(2), 2)},
     'Dynamixel 2.0, ID 001, on a bus of Dynamixel 1.0: set these devices to Protocol 1.0 if they '
     'have it, or give them another bus', {'packets': '2'},
     [{'devices': [spoken(2, protocol='Dynamixel 1.0')]}]),
    ('overrun', {'marks': {10: {'overruns': 2}, 0: {'overruns': 3}}},
     'this computer lost bytes 1 times, so packets seem missing or damaged: give the monitor a '
     'higher priority or a better adapter', {'overruns': '1'},
     [{'marks': {10: {'overruns': 3}, 0: {'overruns': 3}}}]),
    ('baud_moved', {'devices': [device(state=words.MOVED, moved_to='57600 Bd')]},
     'set to 57600 Bd by a write, but the bus is at 1000000 Bd: set it back at its new rate, or '
     'set the others and the master to it too', {}, [{'devices': [device()]}]),
    ('id_moved', {'devices': [device(state=words.MOVED, moved_to='ID 005')]},
     'set to ID 005 by a write, and still asked as 001: use the new ID in the program', {},
     [{'devices': [device()]}, {'devices': [device(state=words.MOVED, moved_to='57600 Bd')]}]),
    ('noise', {'devices': TWO_HIT, 'notes': damage(5, 1, 1000 / 3), 'counters': {'Packets': 5000}},
     'less than 0.2 % of the packets damaged, in both directions, of several devices: check '
     'termination, ground, shielding and motor cables',
     {'share': '0.1 %', 'damaged instructions': '1', 'devices': '001, 002'},
     [{'counters': {'Packets': 5001}}, {'notes': damage(5, 1, 332)}]),
    ('noise', {'devices': TWO_HIT, 'notes': damage(6, 1), 'counters': {'Packets': 94}},
     'about 5 % of the packets damaged, in answers, of several devices: check termination, '
     'ground, shielding and motor cables',
     {'share': '6.0 %', 'damaged instructions': '1', 'devices': '001, 002'},
     [{'devices': ONE_HIT}]),
    ('damaged_answers', {'devices': ONE_HIT, 'notes': damage(10, 1)},
     'about 5 % of its answers damaged, others whole: a bad cable or a second device with its ID; '
     'unplug it and ping its ID', {'share': '7.0 %', 'damaged': '7 of 100'},
     [{'devices': [spoken(1, window={'answers': 93, 'missed': 6, 'spoilt': 6}), ONE_HIT[1]]},
      {'devices': [spoken(1, window={'answers': 93, 'missed': 2, 'spoilt': 2})]},
      {'notes': damage(10, 2)}]),
    ('duplicate_id', {'whom': 3,
      'devices': [spoken(3)], 'notes': note(ev.SECOND_ANSWER, ev.Code(2), 3, 3)
                      + note(ev.UNASKED, ev.Unasked(2, 0), 1, 3)},
     'answered twice: two devices have this ID; unplug one and change the ID of the other',
     {'second answers': '3', 'damaged': '0', 'model changes': '0'},
     [{'notes': note(ev.SECOND_ANSWER, ev.Code(I.READ), 2, 3)},
      {'notes': note(ev.SECOND_ANSWER, ev.Code(I.READ), 5, 3)
       + note(ev.UNASKED, ev.Unasked(2, 0), 2, 3)}]),
    ('duplicate_id', {'devices': [spoken(window={'model_changes': 2, 'spoilt': 3})]},
     'answered twice, by two models: two devices have this ID; unplug one and change the ID of '
     'the other',
     {'second answers': '0', 'damaged': '3', 'model changes': '2'},
     [{'devices': [spoken(window={'model_changes': 1, 'spoilt': 3})]},
      {'devices': [spoken(window={'model_changes': 2, 'spoilt': 2})]}]),
    ('duplicate_id', {'devices': [spoken(), spoken(2, window={'answers': 7}),
                                  spoken(3, window={'answers': 7})],
                      'notes': note(ev.ANSWERED_AGAIN, ev.Code(2), 7) + damage(10)},
     'answered twice: two devices have this ID; unplug one and change the ID of the other',
     {'second answers': '7', 'damaged': '0', 'model changes': '0'},
     [{'devices': [spoken(), spoken(2)]},
      {'devices': [spoken(), spoken(2), spoken(3, window={'answers': 6})]},
      {'devices': [spoken(), spoken(2), spoken(3, window={'answers': 9, 'spoilt': 1})]},
      {'notes': note(ev.ANSWERED_AGAIN, ev.Code(2), 7) + damage(11)},
      {'notes': note(ev.ANSWERED_AGAIN, ev.Code(2), 7) + damage(10)
       + note(ev.ANSWERED_AGAIN, ev.Code(2), 1, 2)},
      {'notes': note(ev.ANSWERED_AGAIN, ev.Code(2), 7) + note(ev.PROTOCOL_1, ev.Code(2), 1)}]),
    ('turnaround', {'devices': [spoken(window={'answers': 399, 'repaired': 4}), spoken(2)]},
     'first byte of 1.0 % of its answers damaged: it answers before the line switches; raise its '
     'Return Delay Time by a step or two', {'answers': '4'},
     [{'devices': [spoken(window={'answers': 400, 'repaired': 4})]},
      {'devices': [spoken(window={'answers': 299, 'repaired': 3})]},
      {'devices': [spoken(window={'answers': 399, 'repaired': 4, 'spoilt': 32})]},
      {'notes': damage(32)}]),
    ('turnaround', {'whom': None,
      'devices': [spoken(1, window={'answers': 90, 'repaired': 6}),
                                spoken(2, window={'answers': 90, 'repaired': 2}),
                                spoken(3, window={'answers': 89, 'beheaded': 1})],
                    'marks': GLITCHES},
     'first byte of 3.3 % of the answers damaged, 3 devices: the line switches too late; raise '
     'Return Delay Time or correct the driver enable',
     {'answers': '9', 'packets with a stray byte': '5', 'devices': '001, 002, 003'}, []),
    ('stray_bytes', {'marks': GLITCHES, 'counters': {'Packets': 4999}},
     'one or two stray bytes before 0.1 % of the packets: driver enable switches late or the line '
     'floats; add bias resistors', {'packets': '5'},
     [{'counters': {'Packets': 5000}}, {'marks': {10: {'glitches': 3}, 0: {'glitches': 7}}}]),
    ('echo', {'has_sides': True, 'marks': {10: {}, 1: {'echoes': 1, 'instructions': 10},
                                           0: {'echoes': 6, 'instructions': 19}}},
     'the master receives what it sends: its adapter echoes; switch the echo off, or let the '
     'program skip it', {'echoes': '5'},
     [{'marks': {10: {}, 1: {'echoes': 1, 'instructions': 10},
                 0: {'echoes': 6, 'instructions': 20}}},
      {'marks': {10: {}, 1: {'echoes': 2, 'instructions': 10},
                 0: {'echoes': 6, 'instructions': 14}}}]),
    ('echo', {'has_sides': True, 'marks': {11: {}, 10: {'echoes': 1, 'instructions': 10},
                                           2: {'echoes': 3, 'instructions': 12},
                                           0: {'echoes': 6, 'instructions': 19}}},
     'the master receives what it sends: its adapter echoes; switch the echo off, or let the '
     'program skip it', {'echoes': '5'}, []),
    ('echo', {'cycles': (asks(I.READ, 1, asked=1),), 'notes': [
        *note(ev.REPEATED, ev.Again(2, 99), 5), *note(ev.REPEATED, ev.Again(2, 100), 4)]},
     'every instruction is heard twice: the adapter echoes what its master sends; switch the echo '
     'off. Losses counted here are not real', {'echoes': '5'},
     [{'notes': note(ev.REPEATED, ev.Again(2, 99), 4)}, {'cycles': (asks(I.READ, 1, asked=0),)},
      {'notes': note(ev.REPEATED, ev.Again(2, 99), 5) + note(ev.REPEATED, ev.Again(2, 100), 5)}]),
    ('foreign_answers', {'whom': 4,
      'devices': [spoken(4)],
                         'notes': note(ev.UNASKED, ev.Unasked(2, 0), 3, 4)},
     '3 answers that this master did not ask for: another master, on a segment that is not '
     'monitored; find and stop it', {'answers': '3'},
     [{'notes': note(ev.UNASKED, ev.Unasked(2, 0), 2, 4)},
      {'notes': note(ev.UNASKED, ev.Unasked(2, 0), 3, 4)
       + note(ev.PROTOCOL_1, ev.Code(2), 1, 4)}]),
    ('not_sent', {'notes': note(ev.NOT_SENT, ev.Code(2), 2, 7) + note(ev.NOT_SENT, ev.Code(2), 1)},
     '3 instructions never left the adapter: in the program, switch flow control off and do not '
     'flush output after a write; else plug the adapter in again',
     {'instructions': '3', 'to': '001, 007'}, [{'notes': note(ev.NOT_SENT, ev.Code(2), 2)}]),
    # presence
    ('all_silent', {'devices': [device(1, **SILENT), device(2, missed_in_a_row=1)],
                    'counters': {'Instructions': 5}, 'marks': {2: {}, 0: {}}},
     'none of 2 devices answers the master: check power and first cable; or 001 is dead and the '
     'others wait for it; or listen to both directions', {'instructions': '5'},
     [{'counters': {'Instructions': 4}}, {'devices': [device(1, **SILENT), device(2)]},
      {'devices': [device(1, **SILENT), device(2, missed_in_a_row=1, totals={'answers': 1})]},
      {'devices': [device(1, **{**SILENT, 'last_heard_s': 1.5}), device(2, missed_in_a_row=1)]},
      {'devices': [device(1, **{**SILENT, 'window': {'missed': 9, 'garbled': 5}}),
                   device(2, missed_in_a_row=1)]}]),
    ('all_silent', {'devices': [device(1, **SILENT), device(2, **SILENT)],
                    'counters': {'Instructions': 9}, 'marks': {1.6: {'instructions': 2}, 0: {}}},
     'none of 2 devices answers the master: check power and first cable; or listen to both '
     'directions', {'instructions': '7'}, []),
    ('no_answer', {'whom': 2,
      'devices': [device(2, **SILENT), spoken(3)], 'waits': (
        Wait(NOW, 93_000, 2, False), Wait(NOW, 9000, 3, False), Wait(NOW, 94_000, 2, True))},
     'no answer, silent for more than 1 s, others answer: check its power, cable and ID',
     {'requests without an answer': '9', 'wait per request (ms)': '93.5'},
     [{'devices': [device(2, **{**SILENT, 'last_heard_s': 1.5})]},
      {'devices': [device(2, **{**SILENT, 'state': words.CONNECTED})]}]),
    ('no_answer', {'whom': 2,
      'devices': [device(2, **{**SILENT, 'state': words.ASKED, 'last_heard_s': None,
                                            'missed_in_a_row': 5})]},
     'no answer, never heard: check its power, cable and ID, and that the program uses the '
     "servos' baud rate and protocol", {'requests without an answer': '5'},
     [{'devices': [device(2, **{**SILENT, 'state': words.ASKED, 'last_heard_s': None,
                                'missed_in_a_row': 4})]}]),
    ('sync_read_stops', {'whom': 2,
      'devices': [device(2, **SILENT), *(device(
        number, state=words.DISCONNECTED, waiting_behind=2) for number in (3, 4, 5))]},
     'silent, and the Sync Read ends there: 003, 004 and 1 more after it are never read; check '
     'its power and cable, or leave it out', {'not served': '003, 004, 005'},
     [{'devices': [device(2, **SILENT), device(3, waiting_behind=2)]}]),
    ('broken_cable', {'whom': 2, 'covers': (2, 3, 4),
      'devices': [device(1), *(device(n, **SILENT) for n in (2, 3, 4))],
                      'chain': (1, 2, 3, 4)},
     'it and everything downstream are silent: the cable between 001 and 002 is broken or '
     'unplugged',
     {'silent': '002, 003, 004'},
     [{'chain': (2, 3, 4)}, {'chain': (2, 3, 1)}, {'chain': (1, 2)},
      {'chain': (5, 2, 3, 1), 'devices': [device(1), device(5), device(2, **SILENT),
                                          device(3, **SILENT)]}]),
    ('rebooted', {'devices': [device(registers={'Torque Enable': 0}, age_s=2.0)],
                  'notes': back(100, torque=1)},
     'restarted by itself, no answers for 100 ms (Torque Enable fell to 0): check its supply and '
     'plug, then set it up again, torque '
     'too', {'away (ms)': '100', 'seen by': 'Torque Enable fell to 0'},
     [{'notes': back(99, torque=1)}, {'notes': back(100, torque=0)},
      {'notes': back(100, torque=-1)},
      {'devices': [device(written={'Torque Enable': 0}, age_s=2.0)]},
      {'devices': [device(registers={'Torque Enable': 0}, age_s=2.6)]},
      {'devices': [device(registers={'Torque Enable': 1}, age_s=2.0)]},
      {'notes': back(100, torque=1) + note(ev.REBOOTED, ev.NOTHING, 1)}]),
    ('rebooted', {'devices': [device()], 'notes': back(500), 'samples': {1: ticks(20.0, 20.9)}},
     'restarted by itself, no answers for 500 ms (Realtime Tick jumped back): check its supply '
     'and plug, then set it up again, torque too',
     {'away (ms)': '500', 'seen by': 'Realtime Tick jumped back'},
     [{'samples': {1: ticks(20.0, now)}} for now in (21.5, 21.9, 22.1, 30.0)]
     + [{'samples': {1: ticks(32.0, now)}} for now in (1.232, 0.9)]
     + [{'samples': {1: ticks(30.5, 0.232)}}]
     + [{'samples': {1: ticks(0.1, 32.0)}}, {'samples': {1: ticks(20.0, 20.9)[1:]}},
        {'samples': {1: [sample(4), sample(2, tick=0.1)]}},
        {'samples': {1: [sample(4, tick=20.0), sample(2.5, tick=1.0)]}},
        {'samples': {1: [sample(3, tick=20.0), sample(2, tick=1.0)]}},
        {'samples': {1: [sample(4, tick=20.0), sample(2)]}}]),
    ('rebooted', {'devices': [device()], 'notes': back(500), 'samples': {1: [
        sample(6, 0, 0), sample(5, 90, 90), *STANDING]}},
     'restarted by itself, no answers for 500 ms (no longer follows its goal): check its supply '
     'and plug, then set it up again, torque too',
     {'away (ms)': '500', 'seen by': 'no longer follows its goal'},
     [{'samples': {1: [sample(8, 0, 0), sample(6, 0, 0), sample(5, 90, 0), *STANDING]}},
      {'samples': {1: STANDING[:-1]}}]),
    ('dropout', {'devices': [spoken(window={'missed': 4, 'spoilt': 2})],
                 'notes': [*back(300), *note(ev.DISCONNECTED, ev.Much(5), 1)]},
     'no answers for 300 ms: a loose plug or a restart; read Torque Enable or Realtime Tick to '
     'find out', {'absences': '1', 'longest (ms)': '300'},
     [{'notes': back(300)}, {'devices': [spoken(window={'missed': 4, 'spoilt': 3})]},
      {'notes': [*back(300, ago_s=2.0), *note(ev.DISCONNECTED, ev.Much(5), 1)]},
      {'devices': [spoken(window={'missed': 4}, registers={'Present Position': 1}, age_s=2.5)]}]),
    ('brown_out', {'covers': (2, 3),
      'devices': [device(1), device(2), device(3)],
                   'notes': back(300, 2) + back(400, 3, ago_s=2.701),
                   'samples': {2: volts(8.9, 10.0)}},
     '002, 003 restarted together (002 measured 8.9 V before, 10.0 V now): the supply failed; '
     'check battery and cables, set up again',
     {'devices': '002, 003', 'seen by': '002 measured 8.9 V before, 10.0 V now'},
     [{'samples': {2: volts(9.0, 10.0)}}, {'notes': back(300, 2)},
      {'notes': back(300, 2) + back(400, 3, ago_s=2.8)}]),
    ('torque_off', {'devices': [device(registers={'Present Position': 5, 'Torque Enable': 0})],
                    'samples': {1: moves(1.0, 20, 6)}},
     'goals are sent to it, but its torque is off: switch it on (Torque Enable 1); after a '
     'restart, write all its settings again', {},
     [{'samples': {1: moves(1.0, 19, 6)}}, {'samples': {1: moves(1.0, 20, 7)}},
      {'samples': {1: moves(0.99, 20, 6)}},
      {'devices': [device(registers={'Present Position': 5, 'Torque Enable': 1})]},
      {'devices': [device(registers={'Torque Enable': 0})]}]),
    ('torque_off', {'devices': [device(registers={'Present Position': 5}, age_s=1.0), device(2)],
                    'samples': {1: moves(2.45, 50, 0), 2: moves(3.9, 0, 20)[1:]}},
     'its goal changes but the joint does not move, others follow: its torque is off or it is '
     'blocked; read Torque Enable, switch it on', {},
     [{'samples': {1: moves(2.44, 50, 0), 2: moves(3.9, 0, 20)[1:]}},
      {'samples': {1: moves(2.45, 50, 0), 2: moves(3.9, 0, 19)[1:]}},
      {'samples': {1: moves(2.45, 50, 0)}}, {'devices': [device(
          registers={'Torque Enable': 0}, written={'Present Position': 5}), device(2)]},
      {'devices': [device(registers={'Present Position': 5}, age_s=1.1), device(2)]}]),
    ('torque_off', {'devices': [at_5(written={'Torque Enable': 1})],
                    'samples': {1: both_sides(66)}, 'cycles': (watched(132),)},
     'its goal goes to both sides of the joint, which does not move: its torque is off, or its '
     'motor has no supply; write 1 to Torque Enable', {},
     [{'samples': {1: both_sides(65)}}, {'samples': {1: both_sides(66, 7)}},
      {'cycles': (watched(132, S // 2),)}, {'cycles': (watched(128),)},
      {'devices': [at_5(alert=True)]}, {'devices': [device(
          registers={'Present Position': 5, 'Torque Enable': 1})]}]),
    ('missed_answers', {'devices': [spoken(window={'answers': 296, 'missed': 3})],
                        'notes': MISSED},
     'about 1 % of its answers missing, with no bytes in their place: check its plugs; a device '
     'that did not get the instruction looks the same', {'loss': '1.0 %', 'missed': '3 of 299'},
     [{'devices': [spoken(**LOST)]}, {'notes': MISSED[1:]},
      {'devices': [spoken(window={'answers': 199, 'missed': 3, 'spoilt': 1})]},
      {'devices': [spoken(missed_in_a_row=4, window={'answers': 199, 'missed': 4})]},
      {'notes': MISSED + note(ev.REBOOTED, ev.NOTHING, 1)}]),
    ('ping_only', {'devices': [device(totals={'answers': 2, 'pongs': 2, 'data_missed': 3},
                                      window={'answers': 2, 'missed': 3})]},
     'answers Pings, but no reads: set Status Return Level to 1 or 2', {'missed': '3 of 5'},
     [{'devices': [device(totals={'answers': 1, 'pongs': 1, 'data_missed': 3})]},
      {'devices': [device(totals={'answers': 3, 'pongs': 2, 'data_missed': 3})]},
      {'devices': [device(totals={'answers': 2, 'pongs': 2, 'data_missed': 2})]},
      {'devices': [device(totals={'answers': 2, 'pongs': 2, 'data_missed': 3, 'spoilt': 1})]}]),
    # health
    ('hardware_error', {'devices': [device(alert=True, window={'alerts': 2}, registers={
        'Hardware Error Status': 32, 'Torque Enable': 0})]},
     'overload error latched, torque is off: remove the cause, then send Reboot; until then it '
     'does not move', {'answers with alert': '2'},
     [{'devices': [device(window={'alerts': 2})]}, {'devices': [device(alert=True)]}]),
    *(('voltage', {'level': level, 'devices': [device(registers={'Present Input Voltage': raw})]},
       f'its supply is near or {side} V from the factory: {remedy}',
       {'voltage (V)': f'{raw / 10:.1f}'}, [])
      for level, raw, side, remedy in (
          *((level, raw, 'below its limit of 6.0', 'charge the battery, check cable gauge and the '
             'load on the chain') for level, raw in (
              (Level.ERROR, 10), (Level.ERROR, 59), (Level.WARN, 60), (Level.WARN, 62))),
          *((level, raw, 'above its limit of 14.0', 'lower the supply, or let it absorb the '
             'braking current') for level, raw in (
              (Level.WARN, 138), (Level.WARN, 140), (Level.ERROR, 141))))),
    ('watchdog', {'devices': [device(registers={'Bus Watchdog': 50})],
                  'notes': note(ev.REFUSED, ev.Refusal(3, 116, 4), 3)
                  + note(ev.REFUSED, ev.Refusal(3, 116, 5), 1)},
     'Bus Watchdog tripped, 3 goals refused: the master was silent too long; write 0 to Bus '
     'Watchdog, then send goals without such gaps', {'goals refused': '3', 'read': 'no'},
     [{'notes': note(ev.REFUSED, ev.Refusal(3, 116, 4), 2)},
      {'notes': note(ev.REFUSED, ev.Refusal(3, 64, 4), 3)},
      {'devices': [device(registers={'Bus Watchdog': 0})]}, {'devices': [device()]}]),
    ('too_hot', {'level': Level.WARN,
      'devices': [device(registers={'Present Temperature': 67})]},
     'near its shutdown limit of 72 °C from the factory: reduce load or holding torque, let it '
     'cool', {'temperature (°C)': '67', 'limit (°C)': '72'},
     [{'devices': [device(registers={'Present Temperature': 66})]},
      {'devices': [device(registers={'Present Temperature': 67}, age_s=10.1)]},
      {'devices': [device(written={'Present Temperature': 67})]}]),
    # setting up
    ('wrong_supply', {'whom': 2, 'level': Level.ERROR, 'covers': (2,),
      'devices': [device(2, 'STS3215', registers={
        'Max Voltage Limit': 80, 'Present Input Voltage': 101})]},
     'at 10 V, far above its limit of 8.0 V: a servo for a lower voltage; switch off, and check '
     'which servos these are',
     {'voltage (V)': '10.1', 'limit (V)': '8.0', 'devices': '002'},
     [{'devices': [device(2, 'STS3215', registers={
         'Max Voltage Limit': 80, 'Present Input Voltage': 100})]},
      {'devices': [device(2, 'STS3215', age_s=10.1, registers={
          'Max Voltage Limit': 80, 'Present Input Voltage': 101})]}]),
    ('wrong_supply', {'whom': 2, 'level': Level.WARN, 'covers': (2,),
      'devices': [device(2, 'STS3215', registers={
        'Max Voltage Limit': 120, 'Min Voltage Limit': 60, 'Present Input Voltage': 85})]},
     'at 8 V, while its limit is 12.0 V: a servo for 12 V on a lower supply, slow and weak; '
     'supply 12 V', {'voltage (V)': '8.5', 'limit (V)': '12.0', 'devices': '002'},
     [{'devices': [device(2, 'STS3215', registers={
         'Max Voltage Limit': 120, 'Present Input Voltage': 86})]},
      {'devices': [device(2, 'STS3215', registers={
          'Max Voltage Limit': 119, 'Present Input Voltage': 85})]},
      {'devices': [device(2, 'STS3215', registers={
          'Max Voltage Limit': 120, 'Min Voltage Limit': 86, 'Present Input Voltage': 85})]}]),
    ('factory_id', {'covers': (2,),
      'devices': [spoken(1, window={'answers': 3, 'missed': 3, 'spoilt': 3}),
                                device(2, missed_in_a_row=3, last_heard_s=None)]},
     'several servos answer as 001, and 002 never did: new ones still have ID 1; connect one at a '
     'time and give each its own ID', {'never heard': '002', 'spoilt': '3 of 6'},
     [{'devices': [spoken(1, window={'answers': 4, 'missed': 3, 'spoilt': 3}),
                   device(2, missed_in_a_row=3, last_heard_s=None)]},
      {'devices': [spoken(1, window={'missed': 2, 'spoilt': 2}),
                   device(2, missed_in_a_row=3, last_heard_s=None)]},
      {'devices': [spoken(1, window={'missed': 3, 'spoilt': 3}),
                   device(2, missed_in_a_row=2, last_heard_s=None)]}]),
    ('layout', {'whom': 2,
      'devices': [device(2, 'STS3215')],
                'cycles': (asks(I.READ, 2, at=57, size=1, asked=3, stamps=(NOW - 10 * S,)),)},
     'Read of 1 at 57, which cuts Present Position (56, 2 bytes): use the table of STS3215',
     {'address': '57', 'times': '3'},
     [{'cycles': (asks(I.READ, 2, at=57, size=1, asked=2),)},
      {'cycles': (asks(I.READ, 2, at=57, size=1, stamps=(NOW - 10 * S - 1,)),)},
      {'cycles': (asks(I.READ, 2, at=56, size=2),)},
      {'cycles': (asks(I.READ, 2, at=73, size=5),)},
      {'cycles': (asks(I.READ, 2, at=256, size=1),)},
      {'cycles': (asks(I.READ, 3, at=57, size=1),)},
      {'devices': [device(2)]}]),
    ('range_wraps', {'devices': [at_5(model='STS3215', written={'Goal Position': 5})],
                     'samples': {1: places(0, 4095, 1023, 3072)}, 'cycles': (watched(56),)},
     'its joint moves across the end of the turn, from 4095 to 0, where goals make it turn the '
     'long way round: calibrate it again, with the joint in the middle of its range', {},
     [{'cycles': (watched(56, S // 2),)}, {'samples': {1: places(0, 4095, 1024, 3072)}},
      {'samples': {1: places(0, 4095, 1023)}}, {'devices': [at_5(model='STS3215')]}]),
    *(('layout', {'devices': [device(model='STS3215')],
                  'cycles': (asks(I.WRITE, 1, at=at, size=size),)},
       f'Write of {size} at {at}, {why}: use the table of STS3215',
       {'address': str(at), 'times': '30'}, [])
      for at, size, why in (
          (73, 4, 'where STS3215 has no register'), (255, 1, 'where STS3215 has no register'),
          (50, 1, 'where STS3215 has no register'),
          (132, 4, 'where STS3215 has no register (Present Position of X)'),
          (116, 4, 'where STS3215 has no register (Goal Position of X)'))),
    # configuration
    ('eeprom_locked', {'devices': [device(registers={'Torque Enable': 1})],
                       'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 9, 7), 3)},
     'write to Return Delay Time (9) refused 3 times: EEPROM cannot be written while the torque '
     'is on; switch it off first', {'refused': '3'},
     [{'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 9, 7), 2)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.READ, 9, 7), 3)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 7), 3)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 0, 7), 3)},
      {'devices': [device(registers={'Torque Enable': 0})]}]),
    ('goal_limits', {'devices': [device()],
                     'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 6), 3)},
     '3 values for Goal Position refused, beyond its limits: keep goals within these, or set '
     'wider ones (as Max Position Limit)', {'refused': '3'},
     [{'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 6), 2)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.READ, 116, 6), 3)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 4), 3)}]),
    ('sync_read_unsupported', {
        'protocol': 'Dynamixel 1.0', 'devices': [device(totals={'answers': 3})],
        'cycles': (asks(I.SYNC_READ, 254, stamps=(NOW,) * 3),)},
     'the master sends Sync Reads, which Dynamixel has in Protocol 2.0 only: none is answered, '
     'other instructions are; read one after the other', {'Sync Reads': '30'},
     [{'devices': [device(totals={'answers': 2})]}, {'protocol': 'Feetech'},
      {'cycles': (asks(I.SYNC_READ, 254, stamps=(NOW,) * 2),)},
      {'notes': note(ev.UNASKED, ev.Unasked(I.SYNC_READ, 0), 1)}]),
    ('wrong_address', {'devices': [device()],
                       'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 4), 3)},
     'address 116 refused 3 times (Data Range): the value is out of the range of Goal '
     'Position; limit it', {'refused': '3'},
     [{'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 4), 2)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 116, 3), 3)}]),
    *(('wrong_address', {'devices': [device()],
                         'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, at, error), 3)},
       f'address {at} refused 3 times ({why}', {'refused': '3'}, [])
      for at, error, why in (
          (132, 7, 'Access): Present Position (r, 4 bytes) does not allow this access'),
          (116, 5, 'Data Length): Goal Position (rw, 4 bytes) does not allow this access'),
          *((at, 7, f'Access): {name} of the PRO series; use the control table of XL430-W250')
            for at, name in ((562, 'Torque Enable'), (596, 'Goal Position'),
                             (600, 'Goal Velocity'), (604, 'Goal Torque'),
                             (611, 'Present Position'), (615, 'Present Velocity'))),
          (15, 4, 'Data Range): XL430-W250 has no register there; check the control table in '
                   'use'))),
    ('wrong_address', {'devices': [device()],
                       'notes': note(ev.REFUSED, ev.Refusal(I.WRITE, 132, 7), 2)
                       + note(ev.REFUSED, ev.Refusal(I.REG_WRITE, 132, 7), 1)},
     'address 132 refused 3 times (Access): Present Position (r, 4 bytes) does not allow this '
     'access', {'refused': '3'}, []),
    ('eeprom_wear', {'devices': [device(window={'eeprom_writes': 30})]},
     'EEPROM written 30 times in 10 s: it lasts about 100 000 writes, 9.3 hours at this rate; '
     'write only what changes', {'writes in 10 s': '30'},
     [{'devices': [device(window={'eeprom_writes': 29})]}]),
    ('no_acks', {'devices': [device(acks_missing=3, missed_in_a_row=3, totals={'answers': 1})]},
     'does not acknowledge writes (Status Return Level below 2): a master that waits for it loses '
     'a time-out each time; use Sync Write or level 2', {},
     [{'devices': [device(acks_missing=3)]},
      {'devices': [device(acks_missing=2, totals={'answers': 1})]},
      {'devices': [device(acks_missing=3, missed_in_a_row=4, totals={'answers': 1})]}]),
    ('no_acks', {'devices': [device(status_return_level=1, totals={'answers': 1})]},
     'does not acknowledge writes (Status Return Level 1): a master that waits for it loses a '
     'time-out each time; use Sync Write or level 2', {},
     [{'devices': [device(status_return_level=2, totals={'answers': 1})]},
      {'devices': [device(status_return_level=1, acks=True, totals={'answers': 1})]}]),
    ('fast_read_unsupported', {'covers': (1, 2),
      'devices': [spoken(1, firmware=44), spoken(2)],
                               'cycles': (FAST_READ,)},
     'answers, but never a fast read (XL430-W250, firmware 44), so devices after it are never '
     'read: update it or use plain Sync Read', {'fast reads': '3'},
     [{'cycles': (FAST_READ._replace(asked=2),)},
      {'cycles': (FAST_READ._replace(stamps=(NOW - 2 * S - 1,)),)},
      {'cycles': (FAST_READ._replace(instruction=I.SYNC_READ),)},
      {'devices': [spoken(number, totals={'answers': 9, 'fast_answers': 1})
                   for number in (1, 2)]}]),
    ('fast_read_unsupported', {'covers': (1,), 'devices': [device(1)],
      'cycles': (asks(I.FAST_SYNC_READ, 1, asked=3),),
      'notes': note(ev.REFUSED, ev.Refusal(I.FAST_SYNC_READ, -1, 2), 3)},
     'answers, but never a fast read (XL430-W250, firmware 50), so devices after it are never '
     'read: update it or use plain Sync Read', {'fast reads': '3'},
     [{'notes': note(ev.REFUSED, ev.Refusal(I.FAST_SYNC_READ, -1, 2), 2)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.FAST_SYNC_READ, -1, 3), 3)},
      {'notes': note(ev.REFUSED, ev.Refusal(I.READ, -1, 2), 3)}]),
    ('fast_read_unsupported', {'covers': (1,), 'devices': [spoken(1, firmware=None)],
      'cycles': (asks(I.FAST_SYNC_READ, 1),)},
     'answers, but never a fast read (XL430-W250), so devices after it are never read: update it '
     'or use plain Sync Read', {'fast reads': '30'}, []),
    ('fast_read_unsupported', {'whom': 2, 'covers': (2, 3),
      'devices': [spoken(1, totals={'fast_answers': 1}), device(2, totals={'answers': 3}),
                  spoken(3)],
      'cycles': (asks(I.FAST_BULK_READ, 1, 2, 3, asked=3), FAST_READ._replace(ids=(2, 3)))},
     'answers, but never a fast read (XL430-W250, firmware 50), so devices after it are never '
     'read: update it or use plain Sync Read', {'fast reads': '3'},
     [{'devices': [spoken(1, totals={'fast_answers': 1}), device(2, totals={'answers': 2}),
                   spoken(3)]},
      {'devices': [spoken(1, totals={'fast_answers': 1}), device(
          2, totals={'answers': 3}, last_heard_s=9.0), spoken(3)],
       'counts': [(NOW - 2 * S, {2: Counts(answers=1)})]}]),
    ('never_written', {'devices': [spoken(totals={'reads': 20}), spoken(2, window={'writes': 1})],
                       'started': NOW - 3 * S},
     'read 20 times but never written, others are (002): check whether the program forgot it',
     {'reads': '20'},
     [{'devices': [spoken(totals={'reads': 19}), spoken(2, window={'writes': 1})]},
      {'devices': [spoken(totals={'reads': 20, 'writes': 1}), spoken(2, window={'writes': 1})]},
      {'devices': [device(totals={'reads': 20}), spoken(2, window={'writes': 1})]},
      {'started': NOW - 3 * S + 1}]),
    ('refused', {'devices': [device(model='')],
                 'notes': note(ev.REFUSED, ev.Refusal(I.READ, 0, 7), 3)},
     'refuses Read at 0 (Access): set its model in `devices` to learn which register that is',
     {'refused': '3'},
     [{'notes': note(ev.REFUSED, ev.Refusal(I.READ, 0, 7), 2)}, {'devices': [device()]},
      {'notes': note(ev.REFUSED, ev.Refusal(I.READ, -1, 7), 3)}]),
    ('master_stopped', {'level': Level.OK, 'quiet_s': 1.2, 'last_byte_s': 1.2,
                        'asked': NOW - 57 * S},
     'the master stopped 3.0 s after listening began: check its program; device states date from '
     'then', {'stopped after (s)': '3.0'},
     [{'quiet_s': 1.19}, {'last_byte_s': 1.19}, {'asked': NOW - 57 * S - 1},
      {'deaf': NOW - 1_199_000_000}]),
    ('impossible_id', {'cycles': (asks(I.PING, 253, stamps=(
        NOW - 10 * S, NOW - 10 * S + 1, NOW - 1, NOW)),)},
     'the master asks ID 253, which no device can have (0 to 252): correct the ID in its program',
     {'asked in 10 s': '3'},
     [{'cycles': (asks(I.PING, 253, stamps=(NOW - 10 * S, NOW - 1, NOW)),)},
      {'cycles': (asks(I.PING, 252, stamps=(NOW,) * 3),)}, {'devices': [device(253)]}]),
    ('impossible_id', {'cycles': (asks(I.READ, BROADCAST, stamps=(NOW,) * 3),)},
     'the master reads from ID 254, all devices at once, which none answers: use Sync Read',
     {'asked in 10 s': '3'},
     [{'cycles': (asks(I.READ, BROADCAST, stamps=(NOW,) * 2),)},
      {'cycles': (asks(I.PING, BROADCAST, stamps=(NOW,) * 3),)}]),
    ('scan', {'level': Level.WARN,
      'cycles': (asks(I.PING, BROADCAST, stamps=(
        NOW - 10 * S, *[NOW - 10 * S + 1] * 15)),), 'notes': damage(3)},
     'the master sends broadcast Pings without a pause, and the answers collide: let it wait 0.8 '
     's after each, the time that all IDs need', {'broadcast Pings in 10 s': '15'},
     [{'cycles': (asks(I.PING, BROADCAST, stamps=(NOW - 10 * S, *[NOW - 10 * S + 1] * 14)),),
       'counters': {'Instructions': 20}}]),
    ('scan', {'level': Level.WARN, 'counters': {'Instructions': 4}, 'notes': damage(3),
              'cycles': (asks(I.PING, BROADCAST, stamps=(NOW - 2,) * 3),)},
     'the master sends broadcast Pings without a pause, and the answers collide: let it wait 0.8 '
     's after each, the time that all IDs need', {'broadcast Pings in 10 s': '3'},
     [{'counters': {'Instructions': 5}}, {'notes': damage(2)}]),
    ('scan', {'scanned': (4, 5), 'devices': [device(1)]},
     'a scan: 2 IDs were pinged and do not answer, 1 devices are known',
     {'without an answer': '004, 005'}, [{'scanned': ()}]),
]


@pytest.mark.parametrize('row', ENOUGH, ids=[row[0] for row in ENOUGH])
def test_a_rule_speaks_from_its_edge_on(row):
    speaks_from_its_edge_on(*row)


@pytest.mark.parametrize(('number', 'firmware', 'is_told'), [
    *((number, 255, True) for number in (30, 311, 321)),
    (29, 0, False), (312, 0, False), (320, 0, False), (999, 0, False), (1400, 0, False),
    (1999, 0, False), (2130, 0, False),
    (1000, 44, True), (1000, 45, False), (1189, 44, True), (1189, 45, False), (1190, 45, True),
    (1190, 46, False), (1249, 45, True), (1250, 44, True), (1250, 45, False), (1399, 44, True),
    (2000, 11, True), (2000, 12, False), (2129, 11, True), (None, 0, False), (1060, None, False),
])
def test_the_firmware_from_which_on_fast_reads_are_known(number, firmware, is_told):
    one = device(model_number=number, firmware=firmware, totals={'answers': 9})
    assert len(claims('fast_read_unsupported', cycles=(asks(I.FAST_SYNC_READ, 1),), devices=[one],
                      counts=[(NOW - 10 * S, {1: Counts(answers=9)})])) == is_told


# Baud codes of Feetech, and what LeRobot takes them for (its tables, commit 7427f31).
LEROBOT_BAUDS = {4: None, 5: 57_600, 6: 38_400, 7: 19_200, 8: None}


@pytest.mark.parametrize('code', LEROBOT_BAUDS)
def test_the_baud_codes_that_lerobot_reads_differently(code):
    def told(model):
        return [one.message for one in claims(
            'baud_code', devices=[device(model=model)],
            notes=note(ev.BAUD_WRITTEN, ev.Written(code), 1))]

    found = told('STS3215')
    assert [f' {LEROBOT_BAUDS[code]} in LeRobot' in one for one in found] \
        == [True] * (LEROBOT_BAUDS[code] is not None)
    assert told('XL430-W250') == []


@pytest.mark.parametrize('volts', [9, 63, 136])
def test_a_voltage_within_its_limits_is_none_to_tell(volts):
    assert claims('voltage', devices=[device(registers={'Present Input Voltage': volts})]) == []


@pytest.mark.parametrize(('volts', 'level'), [((62, 60, 138), Level.WARN),
                                              ((62, 59, 138), Level.ERROR)])
def test_three_that_are_near_a_limit_are_the_supply(volts, level):
    devices = [device(number, registers={'Present Input Voltage': raw})
               for number, raw in enumerate(volts, 1)]
    assert [one.device for one in claims('voltage', devices=devices[:2])] == [1, 2]
    found = claims('voltage', devices=devices)[-1]
    assert (found.device, found.level, found.evidence) == (
        None, level, (('devices', '001, 002, 003'),))
    assert found.message.startswith('3 devices near or beyond a voltage limit')


# Initial values of Temperature Limit (°C), Min and Max Voltage Limit (V), e-Manual.
FROM_THE_FACTORY = {
    **dict.fromkeys(('AX-12A', 'AX-18A', 'AX-12W'), (70, 6, 14)),
    **dict.fromkeys(('MX-64', 'MX-106', 'MX-28', 'XM430-W350', 'XM430-W210'), (80, 9.5, 16)),
    'XL430-W250': (72, 6, 14), 'XM540-W270': (80, 10, 16), 'XM540-W150': (80, 10, 16),
    'XL330-M077': (70, 3.5, 7), 'XL330-M288': (70, 3.5, 7),
}


@pytest.mark.parametrize('name', FROM_THE_FACTORY)
def test_the_limits_from_the_factory(name):
    model = MODELS.by_name(name)
    assert FACTORY[model.number or 0] == FROM_THE_FACTORY[name]


def test_the_limits_of_the_mx_of_protocol_1():
    assert [FACTORY[number] for number in (29, 310, 320, 360)] == [(80, 6, 16)] * 4
