# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Buses with a fault, and what is really wrong: written before the doctor was changed for them."""

from __future__ import annotations

from functools import partial

from rigs.bus import ear
from rigs.bus import faults as f
from rigs.bus import frames
from rigs.bus import frames1
from rigs.bus import masters as m
from rigs.bus import masters1 as m1
from rigs.bus import servo as reg
from rigs.bus.healthy import CHAIN
from rigs.bus.scene import Key
from rigs.bus.scene import Scene
from rigs.bus.servo1 import AX_12
from rigs.bus.servo1 import STS3215

SDK, DHI, ROBOT, ARM = m.sdk_loop, m.hardware_interface, m.bitbots, m.lerobot
MID = partial(m.hardware_interface, pings=False, volts=False)
ROUND = partial(m.poller, torque=True)
MOVE = m.setup_then(m.asks(frames.write(3, reg.TORQUE, b'\0'), 3),
                    m.asks(frames.write(3, reg.BAUD, b'\1'), 3))
RENAME = m.setup_then(m.asks(frames.write(3, reg.TORQUE, b'\0'), 3),
                      m.asks(frames.write(3, reg.ID, b'\x09'), 3))
FINE, BUSY, HUB, COARSE = ear.FINE, ear.BUSY, ear.HUB, ear.COARSE


def _of(number: int | None, *rules: str) -> tuple[Key, ...]:
    return tuple((rule, number) for rule in rules)


def _all(*rules: str) -> tuple[Key, ...]:
    return tuple((rule, number) for rule in rules for number in range(1, 7))


def _weak(number: int) -> tuple[Key, ...]:
    """Return what is said of a device before it is clear what it has: true, if vague."""
    return _of(number, 'missed_answers', 'dropout', 'no_answer', 'sync_read_stops')


THERE: tuple[Scene, ...] = (
    Scene('dead, sdk', SDK, _of(3, 'sync_read_stops'), (f.dead(3),), _weak(3)),
    Scene('dead, sdk, others answer behind', SDK, _of(3, 'no_answer'), (f.dead(3),), _weak(3),
          in_line=False),
    Scene('dead, fast reads', DHI, _of(3, 'sync_read_stops', 'no_answer'), (f.dead(3),), _weak(3)),
    Scene('dead, fast reads, USB hub', DHI, _of(5, 'sync_read_stops', 'no_answer'), (f.dead(5),),
          _weak(5), ear=HUB),
    Scene('last one dead, fast reads from the middle', MID, _of(6, 'no_answer', 'sync_read_stops'),
          (f.dead(6),), _weak(6)),
    Scene('first one dead, board answers', partial(ROBOT, board=30), _of(1, 'sync_read_stops'),
          (f.dead(1),), _weak(1), model='MX-106', baud=2_000_000, spares=(30,)),
    Scene('dead, item by item', ROUND, _of(4, 'no_answer'), (f.dead(4),), _weak(4)),
    Scene('dead, lerobot gives up', ARM, _of(4, 'no_answer', 'sync_read_stops'), (f.dead(4),),
          (*_weak(4), ('master_stopped', None))),
    Scene('dead from the start, sdk', partial(SDK, torque=False),
          _of(2, 'sync_read_stops', 'no_answer'), (f.dead(2, at=0.0),), _weak(2)),
    Scene('all dead, item by item', ROUND, _of(None, 'all_silent'), (f.dead(1, 2, 3, 4, 5, 6),),
          tuple(key for n in range(1, 7) for key in _weak(n))),
    Scene('all dead, sdk', SDK, _of(None, 'all_silent'), (f.dead(1, 2, 3, 4, 5, 6),), _weak(1),
          why='the first of the list alone, or all of them: one sentence must name both'),
    Scene('cable behind 3, item by item', ROUND, _of(4, 'broken_cable'), (f.dead(4, 5, 6),),
          tuple(key for n in (4, 5, 6) for key in _weak(n)), devices=CHAIN),
    Scene('cable behind 3, board beside', partial(m.poller, ping=True), _of(4, 'broken_cable'),
          (f.deaf(4, 5, 6),), tuple(key for n in (4, 5, 6) for key in _weak(n)), devices=CHAIN,
          ear=BUSY),
    Scene('cable behind 3, sdk gives up at the gap', SDK, _of(4, 'sync_read_stops'),
          (f.dead(4, 5, 6),), (*_weak(4), ('broken_cable', 4)), devices=CHAIN,
          why='none of those behind it is asked, so a cable cannot be told from a dead servo'),
    Scene('loose plug, sdk', SDK, _of(3, 'missed_answers'), (f.loose(3, 0.1),), _weak(3)),
    Scene('loose plug, fast reads', DHI, _of(3, 'missed_answers'), (f.loose(3, 0.1),), _weak(3)),
    Scene('loose plug, fast reads from the middle', MID, _of(3, 'missed_answers'),
          (f.loose(3, 0.1),), _weak(3)),
    Scene('loose plug, bitbots, busy computer', ROBOT, _of(5, 'missed_answers'),
          (f.loose(5, 0.08),), _weak(5), model='MX-64', ear=BUSY),
    Scene('loose plug, print loop', m.beginner, _of(2, 'missed_answers'), (f.loose(2, 0.15),),
          _weak(2), ids=(1, 2)),
    Scene('away without a restart', ROUND, _of(3, 'dropout'), (f.away(3, restart=False),),
          _weak(3), why='no proof of a restart'),
    Scene('restart, torque read', ROUND, _of(3, 'rebooted'), (f.away(3),),
          (*_weak(3), ('torque_off', 3)), devices=CHAIN),
    Scene('restart, follows no more, sdk', SDK, _of(3, 'rebooted'), (f.away(3),),
          (*_weak(3), ('torque_off', 3)), devices=CHAIN),
    Scene('restart, fast reads', DHI, _of(3, 'rebooted'), (f.away(3),),
          (*_weak(3), ('torque_off', 3)),
          why='its indirect addresses are at their defaults: nothing is read but zeros'),
    Scene('restart long ago, torque never on again', ROUND, _of(3, 'torque_off'),
          (f.away(3, at=2.0),), (*_weak(3), ('rebooted', 3)), devices=CHAIN),
    Scene('torque lost, sdk', SDK, _of(3, 'torque_off'),
          (f.register(3, reg.TORQUE, 1, 0, at=6.0),), devices=CHAIN,
          why='the goal moves, the position stands, the others follow'),
    Scene('brown-out of all', ROUND, _of(None, 'brown_out'), (f.away(1, 2, 3, 4, 5, 6),),
          (('all_silent', None), *(key for n in range(1, 7)
                                   for key in (*_weak(n), ('torque_off', n), ('rebooted', n)))),
          devices=CHAIN),
    Scene('brown-out of the tail', partial(ROUND, rate=10.0), _of(None, 'brown_out'),
          (f.away(4, 5, 6),),
          tuple(key for n in (4, 5, 6) for key in (*_weak(n), ('torque_off', n), ('rebooted', n))),
          devices=CHAIN),
    Scene('brown-out, sdk', SDK, _of(None, 'brown_out'), (f.away(1, 2, 3, 4, 5, 6),),
          (('all_silent', None), *(key for n in range(1, 7)
                                   for key in (*_weak(n), ('torque_off', n), ('rebooted', n)))),
          devices=CHAIN),
    Scene('answers only Pings', partial(m.poller, ping=True), _of(3, 'ping_only'),
          (f.register(3, reg.LEVEL, 1, 0, at=8.0),), _weak(3)),
    Scene('master stops', SDK, _of(None, 'master_stopped'), (f.master_stops(),)),
    Scene('master stops, fast reads', DHI, _of(None, 'master_stopped'), (f.master_stops(),)),
    Scene('master stops, print loop', m.beginner, _of(None, 'master_stopped'),
          (f.master_stops(),), ids=(1,), baud=57_600, ear=BUSY),
    Scene('asks ID 253', m.beside(ROUND, m.asks(frames.read(253, 132, 4), 253, 4), every_s=0.1),
          _of(None, 'impossible_id'), (f.since(8.0),)),
    Scene('asks only ID 253', ROUND, _of(None, 'impossible_id'), (f.since(0.0),), ids=(253,),
          absent=(253,), why='nothing else is on this bus'),
    Scene('flood of broadcast Pings', m.ping_flood, _of(None, 'scan'), (f.since(0.0),)),
)

BYTES: tuple[Scene, ...] = (
    Scene('noise on all', SDK, _of(None, 'noise'), (f.spoil(f.flip, 0.05),)),
    Scene('noise on all, fast reads', DHI, _of(None, 'noise'), (f.spoil(f.flip, 0.04),)),
    Scene('noise on all, bitbots', ROBOT, _of(None, 'noise'), (f.spoil(f.garble, 0.04),),
          model='MX-64', baud=2_000_000),
    Scene('answers of one damaged, sdk', SDK, _of(3, 'damaged_answers'),
          (f.spoil(f.flip, 0.1, 'servo 3 '),), _weak(3)),
    Scene('answers of one damaged, fast reads', DHI, _of(3, 'damaged_answers'),
          (f.spoil(f.flip, 0.1, 'servo 3 '),), _weak(3)),
    Scene('answers of one cut, item by item', ROUND, _of(3, 'damaged_answers'),
          (f.spoil(f.cut, 0.1, 'servo 3 '),), _weak(3)),
    Scene('answers of one damaged, print loop', m.beginner, _of(1, 'damaged_answers'),
          (f.spoil(f.garble, 0.15, 'servo 1 '),), _weak(1), ids=(1, 2), baud=57_600),
    Scene('noise, and one dead', ROUND, _of(3, 'no_answer'), (f.spoil(f.flip, 0.05), f.dead(3)),
          (*_weak(3), ('noise', None))),
    Scene('noise, and one with an error', ROBOT, _of(3, 'hardware_error'),
          (f.spoil(f.flip, 0.03), f.latched(3)), (('noise', None), ('torque_off', 3)),
          model='MX-64'),
    Scene('first byte, one', SDK, _of(3, 'turnaround'), (f.spoil(f.first_byte, 0.3, 'servo 3 '),)),
    Scene('first byte lost, all', ROUND, _of(None, 'turnaround'),
          (f.spoil(f.lost_first, 0.2, 'servo'),)),
    Scene('stray byte ahead', SDK, _of(None, 'stray_bytes'), (f.spoil(f.stray, 0.2),)),
    Scene('echo', SDK, _of(None, 'echo'), (f.echo(),)),
    Scene('echo, item by item', ROUND, _of(None, 'echo'), (f.echo(),)),
    Scene('same ID, other delay', ROUND, _of(3, 'duplicate_id'), (f.twin(3, own_us=900),),
          (('damaged_answers', 3), ('torque_off', 5)), why='5 never gets its Torque Enable'),
    Scene('same ID, same delay', ROUND, _of(3, 'duplicate_id', 'damaged_answers'), (f.twin(3),),
          why='their answers always collide: a bad cable looks the same'),
    Scene('same ID, other model', partial(m.poller, ping=True), _of(3, 'duplicate_id'),
          (f.twin(3, model='XM430-W350', own_us=700),), (('damaged_answers', 3),)),
    Scene('same ID, sdk', SDK, _of(3, 'duplicate_id', 'damaged_answers'),
          (f.twin(3, own_us=55),)),
    Scene('monitor at the wrong rate', SDK, _of(None, 'wrong_baud'),
          (f.since(0.0),), ear=ear.Kind(gather_ms=1.0, baud=57_600)),
    Scene('Baud Rate written', m.beside(ROUND, MOVE, at=8.0, every_s=30.0),
          _of(3, 'baud_moved'), (f.since(8.0),), _weak(3), devices=CHAIN),
    Scene('answers from another line', SDK, _of(3, 'foreign_answers'), (f.elsewhere(3),)),
    Scene('Protocol 1.0 beside', partial(m.poller, rate=5.0), _of(None, 'protocol_1'),
          (f.protocol_1(),), (('noise', None),)),
)

TIME: tuple[Scene, ...] = (
    Scene('latency timer 16 ms, sdk', m.unpaced, _of(None, 'latency_timer'),
          (f.since(0.0),), latency_ms=16.0),
    Scene('latency timer 16 ms, 100 Hz wanted', SDK, _of(None, 'latency_timer'),
          (f.since(0.0),), latency_ms=16.0),
    Scene('latency timer 16 ms, print loop', partial(m.beginner, print_ms=0.3),
          _of(None, 'latency_timer'), (f.since(0.0),), ids=(1,), latency_ms=16.0),
    Scene('answers too late', partial(m.poller, rate=100.0), _of(3, 'late_answers'),
          (f.attribute(3, 8.0, own_us=6000), f.since(8.0)), _weak(3),
          wait_ms=2.0),
    Scene('answers too late, sdk', partial(SDK, rate=60.0), _of(3, 'late_answers'),
          (f.attribute(3, 8.0, own_us=3500), f.since(8.0)), _weak(3),
          wait_ms=2.0),
    Scene('answers of the wrong length', ROUND, _of(3, 'wrong_length'),
          (f.attribute(3, 8.0, wrong_size=2),)),
    Scene('answers of the wrong length, sdk', SDK, _of(3, 'wrong_length'),
          (f.attribute(3, 8.0, wrong_size=-1),)),
    Scene('Return Delay Time as from the factory', SDK, _of(1, 'return_delay'),
          (f.register(1, reg.DELAY, 1, 250),), delay=250, ear=FINE),
    Scene('impatient', partial(SDK, retries=2), _of(None, 'impatient_master'),
          (f.wait_less(0.2),), latency_ms=0.6),
    Scene('impatient, item by item', partial(m.poller, ping=True), _of(None, 'impatient_master'),
          (f.wait_less(0.01),), delay=100, latency_ms=0.1),
    Scene('too much for 57600', partial(SDK, rate=50.0), _of(None, 'bus_too_slow'),
          (f.since(0.0),), baud=57_600),
    Scene('too much for 115200, fast reads', DHI, _of(None, 'bus_too_slow'),
          (f.since(0.0),), baud=115_200),
    Scene('two programs', partial(SDK, rate=50.0), _of(None, 'two_masters'),
          (f.second_master(partial(m.poller, rate=31.0), [2, 3]),), ear=FINE),
    Scene('two programs, fast reads', partial(DHI, rate=50.0), _of(None, 'two_masters'),
          (f.second_master(partial(SDK, rate=33.3, torque=False), [1, 2, 3]),)),
    Scene('loop held up', partial(SDK, rate=50.0), _of(None, 'jitter'), (f.busy_host(12.0),)),
)

STATE: tuple[Scene, ...] = (
    Scene('overload, error read', ROBOT, _of(3, 'hardware_error'), (f.latched(3),),
          (('torque_off', 3),), model='MX-64'),
    Scene('overload, sdk', SDK, _of(3, 'hardware_error'), (f.latched(3),), (('torque_off', 3),)),
    Scene('overload, fast reads', DHI, _of(3, 'hardware_error'), (f.latched(3),),
          (('torque_off', 3),)),
    Scene('voltage error of all, from the middle', MID, _of(1, 'hardware_error'),
          tuple(f.latched(n, 1, torque_off=False) for n in range(1, 7)),
          tuple(('hardware_error', n) for n in range(1, 7))),
    Scene('hot, limit never read', ROBOT, _of(4, 'too_hot'), (f.heating(4, 86.0),),
          model='MX-106', baud=2_000_000),
    Scene('hot, fast reads', DHI, _of(2, 'too_hot'), (f.heating(2, 75.0),)),
    Scene('hot, tables read', partial(m.scan, last=10), _of(2, 'too_hot'), (f.heating(2, 74.0),)),
    Scene('supply sags, limits never read', ROBOT, _of(None, 'voltage'),
          (f.sagging(range(1, 7), 9.2),), tuple(('voltage', n) for n in range(1, 7)),
          model='MX-106', baud=2_000_000,
          why='all of them at once: it is the supply, not one servo'),
    Scene('supply of one sags', DHI, _of(5, 'voltage'), (f.sagging((5,), 5.6),)),
    Scene('write to EEPROM, torque on', m.beside(DHI, m.asks(frames.write(3, 20, bytes(4)), 3)),
          _of(3, 'eeprom_locked'), (f.since(8.0),)),
    Scene('write to EEPROM, lerobot', m.beside(ARM, m.asks(frames.write(3, 11, b'\3'), 3)),
          _of(3, 'eeprom_locked'), (f.since(8.0),)),
    Scene('write to EEPROM, model unknown', m.beside(
        MID, m.asks(frames.write(3, 20, bytes(4)), 3)), _of(3, 'refused', 'eeprom_locked'),
        (f.register(3, reg.TORQUE, 1, 1), f.since(8.0)),
        why='the model says what stands at 20; without it only the refusal can be told'),
    Scene('addresses of another series', m.beside(
        DHI, m.asks(frames.read(3, 611, 55), 3, 55)), _of(3, 'wrong_address'),
        (f.since(8.0),)),
    Scene('goal too short', m.beside(DHI, m.asks(frames.write(3, 116, b'\0\1'), 3)),
          _of(3, 'wrong_address'), (f.since(8.0),)),
    Scene('bus watchdog', m.beside(partial(m.poller, ping=True, rate=50.0), m.asks(
        frames.write(3, reg.WATCHDOG, b'\1'), 3), at=6.0, every_s=30.0), _of(3, 'watchdog'),
        (f.register(3, reg.WATCHDOG, 1, 255, at=8.0),)),
    Scene('EEPROM written all the time', m.beside(
        partial(m.poller, ping=True, writes=()), m.asks(frames.write(3, 20, bytes(4)), 3),
        every_s=0.1), _of(3, 'eeprom_wear'), (f.since(8.0),)),
    Scene('acknowledges no writes', partial(m.poller, ping=True), _of(3, 'no_acks'),
          (f.register(3, reg.LEVEL, 1, 1, at=0.0),)),
    Scene('old firmware, fast reads', DHI, _of(1, 'fast_read_unsupported'),
          (f.since(0.0),), tuple(('fast_read_unsupported', n) for n in range(1, 7)),
          firmware=42),
    Scene('master does not stuff', m.beside(partial(m.poller, ping=True), m.says(
        frames.UNSTUFFED.sync_write(116, 4, [(1, b'\xff\xff\xfd\x00')]))),
        _of(None, 'unstuffed'), (f.since(8.0),)),
    Scene('one is never written', partial(m.poller, ping=True, writes=(1, 2, 4, 5, 6)),
          _of(3, 'never_written'), (f.since(0.0),)),
)

PROGRAM: tuple[Scene, ...] = (
    Scene('torque never enabled', partial(SDK, torque=False), _all('torque_off'), (f.since(0.0),),
          devices=CHAIN),
    Scene('torque never enabled, AX, model unknown', partial(m1.rounds, torque=False),
          _all('torque_off'), (f.since(0.0),), family=AX_12),
    Scene('goals beyond its limits', ROUND, _of(3, 'goal_limits'), (f.register(3, 48, 4, 1000),)),
    Scene('goals beyond its limits, AX', m1.read_write, _of(1, 'goal_limits'),
          (f.attribute(1, 8.0, errors=2), f.since(8.0)), ids=(1, 2), family=AX_12),
    Scene('a joint across the end of its turn', partial(
        m.beginner, address=42, wanted=56, torque=40, size=2), _of(1, 'range_wraps'),
          (f.attribute(1, mounted=2048), f.since(0.0)), ids=(1,), family=STS3215,
          devices=('1:STS3215',)),
    Scene('a Read of all', m.beside(ROUND, m.asks(frames.read(254, reg.PLACE, 4), 254, 4)),
          _of(None, 'impossible_id'), (f.since(8.0),)),
    Scene('Sync Reads to AX', m.beside(m1.read_write, m.asks(
        frames1.sync_read((1, 2), 36, 2), 1, 2)), _of(None, 'sync_read_unsupported'),
          (f.since(8.0),), ids=(1, 2), family=AX_12),
    Scene('ID written, and the old one asked', m.beside(ROUND, RENAME, every_s=30.0),
          _of(3, 'id_moved'), (f.since(8.0),), _weak(3), devices=CHAIN),
    Scene('lost acknowledgements', ROUND, _of(3, 'missed_answers'),
          (f.spoil(lambda rig, data: data if len(data) > 11 else b'', 0.2, 'servo 3 '),)),
    Scene('first one dead from the start', SDK, _of(1, 'sync_read_stops'), (f.dead(1, at=0.0),),
          _weak(1)),
    Scene('AX that sag', m1.rounds, _of(None, 'voltage'), (f.sagging((1, 2, 3), 5.6),),
          _all('voltage'), ids=(1, 2, 3), family=AX_12, devices=('1-3:AX-12A',)),
)

SCENES: tuple[Scene, ...] = (*PROGRAM, *THERE, *BYTES, *TIME, *STATE)
