# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The classifier of the 1.0 family: instruction or status, where both look alike."""

from fuzz.framer import pieces
from fuzz.reference import Said
from fuzz.script import Script
from msg_defs.event import IN
from msg_defs.event import OUT
from msg_defs.event import UNKNOWN
from msg_defs.servo_frame import IS_STATUS
from servobus.bus.decoder import BusDecoder
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.monitor import Monitor

MODELS = Models()
BAUD, BYTE_NS = 1_000_000, 10_000
IDS = (1, 2, 3, 4)
ANSWER_NS, PATIENCE_NS = 300_000, (12_000_000, 40_000_000)
PAUSES_NS = (200_000, 1_000_000, 15_000_000)
# Two of these are instructions too, and with data of two bytes 2 and 4 are.
ERRORS = (0, 0, 0, 1, 2, 4, 5, 0x20, 0x24)
OPEN, INSTRUCTION, ANSWER = 'open', 'instruction', 'answer'


class Watched(BusDecoder):
    """A decoder that keeps what its packets were taken for, by side and where they end."""

    def __init__(self, protocol):
        super().__init__(MODELS, Settings(baud=BAUD, protocol=protocol))
        self.meant = {}

    def process_frames(self, frames, stamp, received, side=UNKNOWN):
        for _, end, kind, _, _, _, flaw in frames:
            assert flaw is None or flaw.reason in ('', OPEN), 'nothing was damaged'
            self.meant[side, end] = OPEN if flaw is not None and flaw.reason else (
                ANSWER if kind == IS_STATUS else INSTRUCTION)
        super().process_frames(frames, stamp, received, side)


def check(data):
    """
    Check one dialogue of a master with four servos, on a wire without damage.

    With sides and without them each packet is taken for what it was; any split of a packet gives
    the same. The devices are these four, and none else. Left out is what the bytes do not tell: a
    servo that has never answered, and one that says the same error all the time and then falls
    silent; its answer to a Ping and the next Ping are the same.
    """
    script = Script(data)
    protocol = script.pick(('auto', '1', 'feetech'))
    seed = script.word()
    said = dialogue(script, protocol)
    truth = [INSTRUCTION if one.is_master else ANSWER for one in said]
    assert hear(said, protocol, has_sides=True) == truth
    assert hear(said, protocol) == truth
    assert hear(said, protocol, seed=seed) == truth


def dialogue(script, protocol):
    """Return what is said: a Ping of each servo, then what the script tells."""
    said = []
    errors = dict.fromkeys(IDS, 0)
    for number in IDS:
        said += [Said(True, number, 1, b'', PAUSES_NS[-1]), Said(False, number, 0, b'', ANSWER_NS)]
    after_ns = PAUSES_NS[1]
    while script and len(said) < 120:
        number, code, params, asked, size = exchange(script, protocol)
        said.append(Said(True, number, code, params, after_ns))
        after_ns = script.pick(PAUSES_NS)
        for one in asked:
            may_be_silent = code in (1, 2, 0x82) and not errors[one]
            if may_be_silent and script.byte() > 200:
                after_ns = script.pick(PATIENCE_NS)
                continue
            errors[one] = script.pick(ERRORS)
            said.append(Said(False, one, errors[one], script.take_bytes(size).ljust(size, b'\0'),
                             ANSWER_NS))
    return said


def exchange(script, protocol):
    """Return ID, code and parameters of an instruction, who answers, with how many bytes."""
    number, at = script.pick(IDS), 8 + script.byte() % 60        # below that a write moves IDs
    size = 1 + script.byte() % 4
    kind = script.byte() % 7
    if kind == 0:
        return number, 1, b'', [number], 0
    if kind < 3:
        return number, 2, bytes((at, size)), [number], size
    if kind == 3:
        code = 3 + script.byte() % 2
        return number, code, bytes([at]) + script.take_bytes(size).ljust(size, b'\0'), [number], 0
    if kind == 4:
        return number, 5, b'', [number], 0
    if kind == 5 and protocol == 'feetech':
        return 0xFE, 0x82, bytes((at, size, *IDS)), list(IDS), size
    parts = b''.join(bytes([one]) + script.take_bytes(size).ljust(size, b'\0') for one in IDS)
    return 0xFE, 0x83, bytes((at, size)) + parts, [], 0


def hear(said, protocol, has_sides=False, seed=None):
    """Return what each packet was taken for; seed: in pieces that follow from it."""
    decoder = Watched(protocol)
    monitor = Monitor('bus', MODELS, decoder=decoder)
    now = 1_000_000_000
    ends = dict.fromkeys((IN, OUT, UNKNOWN), 0)
    places = []
    for one in said:
        side = (OUT if one.is_master else IN) if has_sides else UNKNOWN
        now += one.after_ns + BYTE_NS * len(one.wire)
        stamp = now - BYTE_NS * len(one.wire) if side == OUT else now
        for piece in pieces(one.wire, seed) if seed is not None else [one.wire]:
            monitor.feed(piece, stamp, side)
        ends[side] += len(one.wire)
        places.append((side, ends[side]))
    report = monitor.report(now + 4_000_000_000)
    assert {device.id for device in report.devices} == set(IDS)
    assert decoder.meant.keys() == set(places)
    return [decoder.meant[place] for place in places]
