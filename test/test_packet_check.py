# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
dxl_dump --check: packets as people type them, right and wrong.

The right ones are of the e-Manual (Ping, Read of Present Position) and of Feetech's manual.
"""
import random

from forked import run
import pytest

from msg_defs.dxl_packet import encode
from servobus.bus.decoder import Settings
from servobus.model.models import Models
from servobus.tools.dump.packet_check import bytes_of
from servobus.tools.dump.packet_check import check_packet

READ_1 = 'FF FF 01 04 02 38 02 BE'
PING_2 = 'FF FF FD 00 01 03 00 01 19 4E'
READ_2 = 'FF FF FD 00 01 07 00 02 84 00 04 00 1D 15'


def check(text, *options):
    done = run('servobus.tools.dxl_dump', '--check', text, *options)
    return done.returncode, done.stdout.decode().splitlines(), done.stderr.decode().splitlines()


@pytest.mark.parametrize(('text', 'meaning'), [
    (READ_1, '> 001 Read Present Position (2 at 56)'),
    ('fffF0104023802BE', '> 001 Read Present Position (2 at 56)'),
    ('0xFF, 0xFF, 0x1, 0x4, 0x2, 0x38, 0x2, 0xBE', '> 001 Read Present Position (2 at 56)'),
    (r'\xff\xff\x01\x04\x02\x38\x02\xbe', '> 001 Read Present Position (2 at 56)'),
    ('[255, 255, 1, 4, 2, 56, 2, 190]', '> 001 Read Present Position (2 at 56)'),
    (r"b'\xff\xff\x01\x04\x028\x02\xbe'", '> 001 Read Present Position (2 at 56)'),
    (PING_2, '> 001 Ping'), (READ_2, '> 001 Read 4 at 132')])
def test_a_right_packet_is_read(text, meaning):
    code, lines, errors = check(text, '--devices', '1:STS3215')
    assert (code, lines[0].rpartition(': ')[2], lines[1:], errors) == (0, 'right', [meaning], [])


@pytest.mark.parametrize(('text', 'meaning'), [
    ('FF FF FE 07 82 38 02 01 02 03 38', '> all Sync Read 1-3: 2 at 56'),
    ('FF FF 01 02 24 D8', '< 001 Status error: overheating (bit 2), overload (bit 5)  (?)'),
    ('FF FF 01 05 00 24 04 30 A1', '< 001 Status 24 04 30  (?)'),
    (encode(1, 0x55, b'\x24\x04\x30', error=0).hex(' '),
     '< 001 Status XL430-W250, firmware 48  (?)'),
    (encode(1, 0x55, b'\xff\xfe\x30', error=0x80).hex(' '), '< 001 Status alert: see Hardware '
     'Error Status; unknown model 65279, firmware 48  (?)')])
def test_a_packet_without_what_was_before_it_is_read(text, meaning):
    code, lines, errors = check(text)
    assert (code, lines[1:], errors) == (0, [meaning], [])


@pytest.mark.parametrize(('text', 'problem', 'right'), [
    ('FF FF 01 04 02 38 02 BF', 'checksum is BF, must be BE', READ_1),
    ('FF FF 01 04 02 38 02 41', 'checksum is 41, must be BE: it is the sum, not inverted', READ_1),
    ('FF FF 01 05 02 38 02 BD', 'Length is 5, must be 4: the bytes that follow it', READ_1),
    ('FF FF 01 05 02 38 02 BE', 'Length is 5, must be 4: the bytes that follow it', READ_1),
    (READ_1[:-3], 'its end is missing: the checksum is BE', READ_1),
    (READ_2[:-3], 'its end is missing: the CRC is 1D 15', READ_2),
    (READ_2[:-6], 'its end is missing: the CRC is 1D 15', READ_2),
    ('FF FF FD 00 01 09 00 03 74 00 FF FF FD AA 35 04',
     'FF FF FD after Length must be FF FF FD FD (byte stuffing), and counts as 4',
     encode(1, 3, b'\x74\0\xff\xff\xfd\xaa').hex(' ').upper()),
    ('FF FF FD 00 01 03 00 01 4E 19', 'CRC is 4E 19, must be 19 4E: the low byte comes first',
     PING_2),
    ('FF FF FD 00 01 03 00 01 00 00', 'CRC is 00 00, must be 19 4E', PING_2),
    ('FF FF FD 00 01 04 00 01 19 4E', 'Length is 4, must be 3: the bytes that follow it', PING_2)])
def test_a_wrong_field_is_named_with_the_right_packet(text, problem, right):
    code, lines, errors = check(text)
    assert (code, lines[1:3], errors) == (1, [problem, f'right: {right}'], [])


def test_two_packets_in_a_row_are_two():
    code, lines, _ = check(f'{READ_1} FF FF 01 04 00 D0 07 22')
    assert (code, len([line for line in lines if '8 bytes: ' in line])) == (1, 2)
    assert (lines[0].endswith('right'), f'right: {READ_1}' in lines) == (True, False)
    assert check(PING_2 + READ_2)[0] == 0


@pytest.mark.parametrize('text', ['FF FF FE 04 02 38 02 C1',
                                  encode(0xFE, 2, b'\x84\0\4\0').hex(' ')])
def test_a_read_of_all_is_not_answered(text):
    code, lines, _ = check(text)
    assert (code, lines[-1]) == (0, 'no device answers: a Read needs the ID of one servo')


@pytest.mark.parametrize(('text', 'words'), [
    ('FF FF 01', '3 bytes; the shortest packet has 6'), ('55 AA', 'a packet begins with FF FF'),
    ('FF FF FF 01 04 02 38 02 BE', 'one FF too many'), ('FF FF FF 02 01 FD', 'or ID 255'),
    ('FF FF FD 00 FD 03 00 01 31 7E', 'ID 253, which no servo has')])
def test_what_cannot_be_a_packet(text, words):
    code, [line], errors = check(text)
    assert (code, words in line, errors) == (1, True, [])


def test_no_hex_is_a_mistake_in_one_line():
    code, lines, [error] = check('hello')
    assert (code, lines, 'not bytes in hex' in error) == (2, [], True)


@pytest.mark.parametrize(('text', 'byte'), [
    ('FF FF O1 04 02 38 02 BE', 'O1'), ('FF FF 01 04 02 38 02 BG', 'BG')])
def test_a_letter_in_a_byte_is_named(text, byte):
    code, lines, [error] = check(text)
    assert (code, lines, f"'{byte}' is no byte in hex" in error) == (2, [], True)


def test_any_bytes_have_an_answer():
    chance, models = random.Random(1), Models()
    for _ in range(2000):
        front = chance.choice((b'\xff\xff', b'\xff\xff\xfd\x00'))
        is_right, lines = check_packet(front + chance.randbytes(chance.randrange(40)), Settings(),
                                       models)
        assert lines
        right = [line for line in lines if line.startswith('right: ')]
        if not is_right and right:             # what would be right is
            assert check_packet(bytes_of(right[0][7:]), Settings(), models)[0]
