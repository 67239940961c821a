# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What is heard in one case: traffic of all families, mutated; frames of any form; any stamps."""

from functools import cache
from functools import partial
import random
import re
from typing import NamedTuple

from fuzz.dxl1_classifier import dialogue
from fuzz.instruction import make_params
from fuzz.script import INSTRUCTIONS
from fuzz.script import NOISE
from fuzz.script import PIECES_1
from fuzz.script import Script
from fuzz.script import traffic
from fuzz.script import TRICKY
from msg_defs.dxl_instruction import parse
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from msg_defs.event import Change
from msg_defs.event import CHANGES
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from rigs.bus import frames
from rigs.bus import frames1
from rigs.bus.scenes import BROKEN
from rigs.bus.scenes import HEALTHY
from rigs.bus.scenes import PLAYED
from rigs.damage import flip_bit
from servobus.model.models import Models

S = 1_000_000_000
BOOT = 1000 * S
SCENES = (*BROKEN, *HEALTHY, *PLAYED)
SCENE_S = 14
SCENES_AT_ONCE, CASES_OF_THEM = 16, 2000      # they take a while to make
PAUSES_NS = (0, 1_000, 50_000, 1_000_000, 30_000_000, 600_000_000, 1_500_000_000, 13 * S, 700 * S)
FAR = (-1, 0, 1, (1 << 62) - 1, (1 << 63) - 1, 1 << 63, 1 << 70, 1 << 90)
BAUDS = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_500_000, 0)
PROTOCOLS = ('auto', 'auto', 'auto', '2', '1', 'feetech')
NAMES = ('bus', 'left', 'a b', '\x1b[31mred', '#', '(', '-', 'tty\u00e9', '\u202e', 'x' * 300,
         "'; --", '%41', 'COM3', '\n', '=1+1')
DEVICES = ((), (), (), ('1-6:XL430-W250',), ('1:MX-106:knee', '2-4'), ('1-6:STS3215',),
           ('1-4:AX-12A', '200'), ('1:XL-320:jaw',))
KNOWN = tuple(map(Models().by_name, ('XL430-W250', 'AX-12A', 'STS3215')))
# Most findings need one of these from a servo whose model is known.
JUDGED = ('Acceleration', 'Baud Rate', 'Bus Watchdog', 'Goal Position', 'Hardware Error Status',
          'Homing Offset', 'ID', 'Lock', 'Max Voltage Limit', 'Present Input Voltage',
          'Present Position', 'Present Temperature', 'Return Delay Time', 'Status Return Level',
          'Torque Enable')
ERRORS = (0, 0, 0, 0, 1, 4, 7, 0x20, 0x80, 0x87)


class Heard(NamedTuple):
    """One chunk; after_ns: since the one before. Where there is a change there are no bytes."""

    after_ns: int
    bus: int
    data: bytes = b''
    side: str = UNKNOWN
    change: Change | None = None
    stamp: int | None = None       # where it is not the time at which it came


class Case(NamedTuple):
    """A run of a bus or two."""

    names: tuple[str, ...]
    baud: int
    protocol: str
    devices: tuple[str, ...]
    heard: tuple[Heard, ...]
    is_noise: bool                 # nothing is on these buses


@cache
def recorded(number):
    """Return what is said in a scene: (silence in front of it, bytes, side)."""
    said = []
    rig = SCENES[number].rig(1)
    rig.wire.listeners.append(said.append)
    rig.clock.run(SCENE_S * S)
    found, last = [], 0
    for one in said:
        start = one.talks[0].start
        found.append((max(0, start - last), one.data,
                      OUT if one.talks[0].who.startswith('master') else IN))
        last = one.end
    return found, SCENES[number].baud


def case_of(seed):
    """Return the case of a seed."""
    chance = random.Random(seed)
    names = tuple(chance.sample(NAMES, chance.choice((1, 1, 1, 2))))
    found, baud, is_noise = [], chance.choice(BAUDS), chance.random() < 0.1
    for _ in range(chance.choice((1, 1, 2, 3))):
        if is_noise:
            found += [(chance.choice(PAUSES_NS[:5]), piece, IN)
                      for piece in traffic(Script(chance.randbytes(3000)), NOISE)]
        elif chance.random() < 0.5:
            more, rate = recorded((seed // CASES_OF_THEM * SCENES_AT_ONCE
                                   + chance.randrange(SCENES_AT_ONCE)) % len(SCENES))
            baud = rate if chance.random() < 0.9 else baud
            at, size = chance.randrange(len(more)), chance.choice((*(3, 20, 60) * 8, 500))
            found += more[:chance.choice((0, 0, 8, 24))] + more[at * (at % 3 > 0):][:size]
        else:
            found += exchanges(chance)
    has_sides = chance.random() < 0.5
    rough = chance.choice((0.0, 0.0, 0.02, 0.2, 0.9)) if len(found) < 400 else 0.0
    far = chance.choice((0.0, 0.0, 0.0, 0.02, 0.3))
    heard = []
    for after_ns, data, side in found:
        if chance.random() < rough:
            data = damaged(chance, data)
        if chance.random() < rough / 2:
            after_ns = chance.choice(PAUSES_NS)
        if chance.random() < rough / 8:
            heard.append(Heard(0, chance.randrange(len(names)), change=Change(
                chance.choice(CHANGES), chance.choice((0, 1, 16, *BAUDS, 10 ** 17)))))
        heard.append(Heard(
            after_ns, chance.randrange(len(names)) if chance.random() < rough else 0, data,
            side if has_sides else UNKNOWN,
            stamp=chance.choice(FAR) if chance.random() < far else None))
    protocol, devices = chance.choice(PROTOCOLS), chance.choice(DEVICES)
    if is_noise:
        protocol, devices = 'auto', ()
    return Case(names, baud, protocol, devices, tuple(_gathered(chance, heard)), is_noise)


def _gathered(chance, heard):
    """Put chunks together, or tear them apart, as adapters do."""
    kind = chance.randrange(4)
    for one in heard:
        if kind == 1 and len(one.data) > 1:
            at = chance.randrange(1, len(one.data))
            yield one._replace(data=one.data[:at])
            one = one._replace(data=one.data[at:], after_ns=chance.choice(PAUSES_NS[:4]))
        yield one if kind != 2 else one._replace(after_ns=one.after_ns // 100)


def exchanges(chance):
    """Return questions and answers of any form, some again and again, with noise among them."""
    model = chance.choice((None, *KNOWN))
    make = chance.choice((_exchange_2, _exchange_1))
    ids = chance.choice(((1,), (1, 2, 3), (1, 2, 3), chance.sample(range(253), 3)))
    found = []
    if model:
        make = partial(_setting, model)
        number = model.number.to_bytes(2, 'little')
        found = [(1000, data, side) for one in ids for data, side in _read_write(
            model, one, model.by_name['Model Number'], number, is_read=True)]
    for _ in range(chance.randrange(1, 12 if model else 6)):
        said = make(chance, ids)[:chance.choice((1, 9, 9, 9))]
        for _ in range(chance.choice((1, 1, 1, 2, 20))):
            found += [(chance.choice(PAUSES_NS[:5]), data, side) for data, side in said]
            if chance.random() < 0.2:
                found.append((1000, chance.choice((*TRICKY, chance.randbytes(9))), IN))
    return found


def _setting(model, chance, ids):
    """Return a read or a write of a register that says how a servo of this model is."""
    field = chance.choice([field for field in model.fields
                           if field.name in JUDGED and field.at < 256])    # one that is sent
    number, small = chance.choice((ids[0], *ids)), chance.choice((0, 1, 1, 1, 2, 10))
    data = chance.choice((small.to_bytes(field.size, 'little'), chance.randbytes(field.size)))
    return _read_write(model, number, field, data, chance.random() < 0.5)


def _read_write(model, number, field, data, is_read):
    """Return a read or a write of a register, and its answer, which tells of no error."""
    kind, answer = (frames, frames.status) if model.protocol == '2' else (
        frames1, frames1.packet)
    question = kind.read(number, field.at, field.size) if is_read else kind.write(
        number, field.at, data)
    return [(question, OUT), (answer(number, 0, data * is_read), IN)]


def _exchange_2(chance, ids):
    """Return an instruction of about the right form, and answers of those it names."""
    script = Script(chance.randbytes(400))
    code, number = chance.choice(INSTRUCTIONS), chance.choice((*ids, BROADCAST))
    params = make_params(script, code)[:1000]
    asked = [(one.id, one.length) for one in parse(code, number, params).accesses]
    answers = [(encode(one, STATUS, script.take_bytes(size), chance.choice(ERRORS)), IN)
               for one, size in asked or [(one, 0) for one in ids] if chance.random() < 0.85]
    return [(encode(number, code, params), OUT), *answers]


def _exchange_1(chance, ids):
    """Return a dialogue of the 1.0 family, or packets that make no sense."""
    script = Script(chance.randbytes(100))
    if chance.random() < 0.3:
        return [(piece, chance.choice((IN, OUT))) for piece in traffic(script, PIECES_1)]
    return [(one.wire, OUT if one.is_master else IN)
            for one in dialogue(script, chance.choice(('1', 'feetech')))[chance.choice((0, 8)):]]


def damaged(chance, data):
    """Return bytes with something wrong; in a text it may be another figure."""
    at = chance.randrange(len(data) + 1)
    figure = re.search(rb'\d', data[at:])
    if figure and chance.random() < 0.5:
        at += figure.start()
        return data[:at] + b'%d' % chance.randrange(10) + data[at + 1:]
    return chance.choice((
        lambda: flip_bit(chance, data) if data else b'\0',
        lambda: data[:at], lambda: data[at:], lambda: data + data,
        lambda: data[:at] + chance.choice(TRICKY) + data[at:],
        lambda: data[:at] + chance.randbytes(chance.randrange(20)) + data[at:],
        lambda: chance.randbytes(len(data)), lambda: b'\xff' + data))()
