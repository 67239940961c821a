# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The rover's frame: thesis part A, both CRC feeds, and everything that is no frame."""
import random
from runpy import run_path

import crcmod
import pytest

from fuzz.reference import crc32
from msg_defs.crc import bare_crc
from msg_defs.crc import bare_crc16
from msg_defs.crc import crc16
from msg_defs.crc import CRC16_TABLE
from msg_defs.crc import crc32_mpeg2
from msg_defs.crc import crc32_mpeg2_words
from msg_defs.crc import CRC_BY_INPUT
from msg_defs.crc import CRC_IS_FAST
from msg_defs.vel2d import decode
from msg_defs.vel2d import encode
from msg_defs.vel2d import FRAME_SIZE
from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

THESIS = Vel2d(0.5, -0.25, 1.0)


def test_check_values():
    assert crc32_mpeg2(b'123456789') == 0x0376E6E7
    assert crc16(bytes.fromhex('ff ff fd 00 01 03 00 01')) == 0x4E19
    assert crc16(b'56789', crc16(b'1234')) == crc16(b'123456789') == 0xFEE8


@pytest.mark.parametrize('wrapped', [
    crc16, lambda data, crc=0: crc16(data, crc)], ids=['of crcmod', 'of something else'])
def test_a_crc_without_its_wrapper_is_the_same(wrapped):
    bare, table = bare_crc(wrapped)
    assert bare(b'56789', crc16(b'1234'), table) == bare_crc16(b'123456789', 0, CRC16_TABLE) \
        == 0xFEE8


def test_c_part_is_installed():
    assert CRC_IS_FAST, 'the test environment must have crcmod with its C part'


def test_it_works_with_the_crcmod_of_debian_and_ubuntu(monkeypatch):
    """In crcmod 1.7 the name crcmod.crcmod is the package; crcmod-plus has its module there."""
    monkeypatch.setattr(crcmod, 'crcmod', crcmod)
    assert run_path(bare_crc.__code__.co_filename)['CRC_IS_FAST'] is True


@pytest.mark.parametrize(('feed', 'crc'), [('bytes', 0xCDF45F5A), ('words', 0xEF7857FA)])
def test_thesis_vector(feed, crc):
    frame = encode(THESIS, CRC_BY_INPUT[feed])
    assert frame.hex() == ('000000000000e03f000000000000d0bf000000000000f03f'
                           + crc.to_bytes(4, 'little').hex())
    assert decode(frame, CRC_BY_INPUT[feed]) == THESIS


def test_ten_thousand_random_vectors():
    rng = random.Random(28)
    for _ in range(10_000):
        sent = Vel2d(*(rng.uniform(-1, 1) * 10 ** rng.randint(-300, 300) for _ in range(3)))
        for crc in CRC_BY_INPUT.values():
            assert decode(encode(sent, crc), crc) == sent
        values = encode(sent)[:24]
        assert crc32_mpeg2(values) == crc32(values)


def test_every_flipped_bit_is_noticed():
    frame = encode(THESIS)
    for bit in range(FRAME_SIZE * 8):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        assert decode(bytes(damaged)) is None


def test_the_feeds_are_told_apart():
    assert decode(encode(THESIS, crc32_mpeg2_words)) is None
    with pytest.raises(ValueError, match='multiple of item size'):
        crc32_mpeg2_words(b'12345')


@pytest.mark.parametrize('size', [*range(28), 29, 56])
def test_other_sizes_are_no_frames(size):
    assert decode((encode(STOP) * 2)[:size]) is None
