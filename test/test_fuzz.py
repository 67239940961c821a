# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What must hold for any input: the checks of fuzz/, on the kept corpus and on what hypothesis finds.

The invariants are in the docstrings of fuzz/*.py. Here they get inputs that are always the same.
An input that broke one is kept in test/corpus/; its name says what it is or what it broke.
"""
from importlib import import_module
from pathlib import Path
import random
import re

from harness import output_of
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize
from hypothesis.stateful import invariant
from hypothesis.stateful import rule
from hypothesis.stateful import RuleBasedStateMachine
import pytest
from tracked_bus import words

from fuzz.framer import feed
from fuzz.reference import Stream
from fuzz.script import fast_reply
from msg_defs.dxl_packet import BROADCAST
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER
from msg_defs.dxl_packet import STATUS
from servobus.model.models import Models
from servobus.monitor import Monitor

EXAMPLES = {'dashboard': 70, 'dxl1_classifier': 40, 'fast_reply': 120,
            'framer': 250, 'instruction': 250, 'model_file': 80, 'tracker': 50,
            'vel2d': 200}                                       # a second at most
CORPUS = Path(__file__).parent / 'corpus'
MACHINE = settings(max_examples=50, stateful_step_count=40)
MODELS = Models()
# hypothesis alone draws short ones: a script needs some length to get anywhere
INPUTS = st.one_of(st.binary(max_size=300), st.builds(
    lambda seed, size: random.Random(seed).randbytes(size),
    st.integers(0, 2**32 - 1), st.integers(50, 600)))
IDS = st.integers(0, 4)
ADDRESSES = st.one_of(st.integers(200, 220), st.integers(600, 603))
SPAN = st.one_of(st.binary(min_size=1, max_size=6),
                 st.sampled_from([b'\xff\xff\xfd', b'\xff\xff\xfd\xfd', b'\xff\xff\xfd\0']))
SYNC = st.integers(2, 4).flatmap(lambda size: st.binary(min_size=5 * size, max_size=5 * size))


@pytest.mark.parametrize('target', EXAMPLES)
def test_kept_inputs(target):
    files = sorted((CORPUS / target).iterdir())
    assert files, f'no corpus for {target}'
    check = import_module(f'fuzz.{target}').check
    for file in files:
        print(file.name)                # which one it was, when one fails
        check(file.read_bytes())


@pytest.mark.parametrize('target', EXAMPLES)
def test_any_input(target):
    check = import_module(f'fuzz.{target}').check
    steady = settings(max_examples=EXAMPLES[target])
    steady(given(INPUTS)(check))()


def test_the_corpus_stays_small():
    files = [file for file in CORPUS.rglob('*') if file.is_file()]
    assert {file.parent.name for file in files} == set(EXAMPLES)
    assert not [file for file in files if re.fullmatch('[0-9a-f]{10,}', file.name)], 'say what'
    assert max(file.stat().st_size for file in files) <= 2048
    assert len(files) <= 60 * len(EXAMPLES)


@pytest.mark.more
@pytest.mark.ros
def test_the_whole_program():
    """A little of what the nightly job does."""
    assert output_of('fuzz.whole', '--cases', '60').startswith('60 cases in ')


def test_every_length_of_a_packet():
    frames = [encode(number % 253, 0x93, bytes([number % 251]) * (number - 3))
              for number in range(3, 1025)]
    headers = [HEADER + b'\1' + words(length) for length in (0, 1, 2, *range(1025, 65536, 61))]
    stream = b''.join([*frames, *headers, frames[0]])
    found, damaged = feed([stream], Stream(stream))
    assert (len(found), len(damaged)) == (len(frames) + 1, len(headers))


class MonitorMachine(RuleBasedStateMachine):
    """A bus with devices that answer, stay away or mumble; the tables hold what was said."""

    @initialize()
    def begin(self):
        self.monitor = Monitor('bus', MODELS)
        self.now = 1_000_000_000
        self.known = {}             # (device, address): byte that it surely said or took

    def hear(self, data, pause_ns=500_000):
        self.now += pause_ns
        self.monitor.feed(data, self.now)

    def table(self, number):
        return self.monitor.decoder.registry.devices[number].table

    @rule(number=IDS, address=ADDRESSES, data=SPAN)
    def read(self, number, address, data):
        self.hear(encode(number, 2, words(address, len(data))))
        self.hear(encode(number, STATUS, data, 0))
        self.learn(number, address, data)

    @rule(number=IDS, address=ADDRESSES, data=SPAN, registered=st.booleans())
    def write(self, number, address, data, registered):
        self.hear(encode(number, 4 if registered else 3, words(address) + data))
        self.hear(encode(number, STATUS, b'', 0))
        if registered:
            self.tables_hold_what_was_said()       # nothing is done before the Action
            self.hear(encode(number, 5))
            self.hear(encode(number, STATUS, b'', 0))
        self.learn(number, address, data)

    @rule(address=ADDRESSES, data=SPAN)
    def write_to_all(self, address, data):
        self.hear(encode(BROADCAST, 3, words(address) + data))
        for number in self.monitor.decoder.registry.devices:
            self.learn(number, address, data)

    @rule(number=IDS, address=ADDRESSES, error=st.integers(1, 127))
    def refused_write(self, number, address, error):
        self.hear(encode(number, 3, words(address) + b'\xee'))
        self.hear(encode(number, STATUS, b'', error))

    @rule(spans=st.dictionaries(IDS, st.tuples(ADDRESSES, SPAN), min_size=1, max_size=5),
          silent=st.integers(0, 5), how=st.sampled_from(['bulk', 'fast', 'write']))
    def bulk(self, spans, silent, how):
        """Hold that each device has its own, be it listed before or behind the others."""
        listed = b''.join(
            bytes([number]) + words(address, len(data)) + data * (how == 'write')
            for number, (address, data) in spans.items())
        code = {'bulk': 0x92, 'fast': 0x9A, 'write': 0x93}[how]
        self.hear(encode(BROADCAST, code, listed))
        if how == 'fast':
            self.hear(fast_reply([(0, number, data) for number, (_, data) in spans.items()]))
        for at, (number, (address, data)) in enumerate(spans.items()):
            if how == 'bulk':
                if at >= silent:
                    break
                self.hear(encode(number, STATUS, data, 0))
            self.learn(number, address, data)

    @rule(ids=st.lists(IDS, min_size=1, max_size=5, unique=True), data=SYNC,
          silent=st.integers(0, 5), how=st.sampled_from(['sync', 'fast', 'write']))
    def sync(self, ids, data, silent, how):
        size = len(data) // 5
        parts = {number: data[at * size:(at + 1) * size] for at, number in enumerate(ids)}
        listed = b''.join(bytes([number]) + part * (how == 'write')
                          for number, part in parts.items())
        code = {'sync': 0x82, 'fast': 0x8A, 'write': 0x83}[how]
        self.hear(encode(BROADCAST, code, words(210, size) + listed))
        if how == 'fast':
            self.hear(fast_reply([(0, number, part) for number, part in parts.items()]))
        for at, (number, part) in enumerate(parts.items()):
            if how == 'sync':
                if at >= silent:
                    break
                self.hear(encode(number, STATUS, part, 0))
            self.learn(number, 210, part)

    @rule()
    def sync_write_that_makes_no_sense(self):
        where = words(210, 2)
        self.hear(encode(BROADCAST, 0x83, where + b'\1ab\2cd'))
        self.learn(1, 210, b'ab')
        self.learn(2, 210, b'cd')
        self.hear(encode(BROADCAST, 0x83, where + b'\1\xff\xff\xfd\xfdx', stuffed=False))

    @rule(number=IDS, data=st.binary(min_size=1, max_size=6), bit=st.integers(0, 80))
    def damaged_answer(self, number, data, bit):
        """Hold that what did not come through whole changes nothing."""
        self.hear(encode(number, 2, bytes([205, 0, len(data), 0])))
        answer = bytearray(encode(number, STATUS, data, 0))
        bit %= 8 * len(answer)
        answer[max(8, bit) // 8] ^= 1 << bit % 8            # the first byte would be repaired
        self.hear(bytes(answer))
        self.hear(b'', 30_000_000)

    @rule(noise=st.binary(min_size=4, max_size=30))
    def noise_then_an_answer(self, noise):
        """Answer what the noise may have hidden: life, and nothing for the table."""
        self.hear(encode(1, 2, words(210, 2)))
        before = self.table(1).bytes(210, 2)
        self.hear(noise, 1_000_000)
        self.monitor.flush_if_idle(self.now + 30_000_000)
        self.now += 30_000_000
        self.hear(encode(1, STATUS, b'\x99\x98', 0))
        assert self.table(1).bytes(210, 2) == before

    @rule(number=IDS, wide=st.binary(min_size=8, max_size=8), narrow=st.binary(min_size=2,
          max_size=2))
    def spans_that_overlap(self, number, wide, narrow):
        """Hold that the last word counts, also between two looks at the table."""
        self.read(number, 204, wide[:4])
        self.read(number, 205, narrow)
        self.read(number, 204, wide[4:])

    @rule(pause_ns=st.sampled_from([1, 30_000_000, 1_500_000_000, 20_000_000_000]))
    def pause(self, pause_ns):
        self.now += pause_ns
        report = self.monitor.report(self.now)
        assert len(report.devices) <= 5

    def learn(self, number, address, data):
        for at, byte in enumerate(data, start=address):
            self.known[number, at] = byte

    @invariant()
    def tables_hold_what_was_said(self):
        for (number, address), byte in getattr(self, 'known', {}).items():
            assert self.table(number).byte(address) == byte, (number, address)


MonitorMachine.TestCase.settings = MACHINE
TestMonitor = MonitorMachine.TestCase
