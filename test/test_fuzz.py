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
import pytest
from tracked_bus import words

from fuzz.framer import feed
from fuzz.reference import Stream
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import HEADER

EXAMPLES = {'dashboard': 70, 'dxl1_classifier': 40, 'fast_reply': 120,
            'framer': 250, 'instruction': 250, 'model_file': 80, 'tracker': 50,
            'vel2d': 200}                                       # a second at most
CORPUS = Path(__file__).parent / 'corpus'
# hypothesis alone draws short ones: a script needs some length to get anywhere
INPUTS = st.one_of(st.binary(max_size=300), st.builds(
    lambda seed, size: random.Random(seed).randbytes(size),
    st.integers(0, 2**32 - 1), st.integers(50, 600)))


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
