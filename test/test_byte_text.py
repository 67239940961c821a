# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Text that shows bytes, as people paste it: what the tools read of it, and what they say."""
import io
from itertools import zip_longest
import json
import subprocess
import sys
import textwrap
import zipfile

import pytest

from msg_defs.dxl_packet import body_crc
from servobus.tools.dxl_doctor import main as dxl_doctor
from servobus.tools.dxl_dump import main as dxl_dump


def packet_2(number, code, *params):
    body = bytes((number, len(params) + 3, 0, code, *params))
    crc = body_crc(body).to_bytes(2, 'little')
    return b'\xff\xff\xfd\0' + body + crc


PING = packet_2(1, 1)
PONG = packet_2(1, 0x55, 0, 0x24, 0x04, 0x34)
BOTH = PING + PONG


def hexed(data, before='', between=' '):
    return between.join(f'{before}{byte:02X}' for byte in data)


def octal(data):
    return ''.join(f'\\{byte:03o}' for byte in data)


def xxd(data):
    rows = []
    for at in range(0, len(data), 16):
        row = data[at:at + 16]
        words = ' '.join(row[two:two + 2].hex() for two in range(0, len(row), 2))
        shown = ''.join(chr(one) if 32 <= one < 127 else '.' for one in row)
        rows.append(f'{at:08x}: {words:39}  {shown}')
    return '\n'.join(rows)


def hexdump_c(data):
    rows = []
    for at in range(0, len(data), 16):
        row = data[at:at + 16]
        halves = f'{row[:8].hex(" ")}  {row[8:].hex(" ")}'
        rows.append(f'{at:08x}  {halves:48}  |{"." * len(row)}|')
    return '\n'.join([*rows, f'{len(data):08x}', ''])


def words(data):
    rows = []
    for at in range(0, len(data), 16):
        row = data[at:at + 16]
        rows.append(f'{at:07x} ' + ' '.join(row[two:two + 2][::-1].hex()
                                            for two in range(0, len(row), 2)))
    return '\n'.join([*rows, f'{len(data):07x}', ''])


def csv(head, row, data=BOTH):
    return '\n'.join([head, *(row.format(n=n, s=n * 1e-5, ns=n * 10_000, b=byte, shown=shown(byte))
                              for n, byte in enumerate(data))])


def shown(byte):
    return (chr(byte),) * 2 if 32 <= byte < 127 else (f'[{byte:02X}]', f'\\x{byte:02X}')


def lines_of(first, second):
    """Return what Logic 2 exports of two analysers, question and answer 300 us apart."""
    return '\n'.join(['name,type,start_time,duration,data,error', *(
        f'"{name}","data",{at + n * 1e-5:.9f},9e-06,0x{byte:02X},'
        for name, at, data in ((first, 2.0, PING), (second, 2.0003, PONG))
        for n, byte in enumerate(data))])


STRACE = (f'openat(AT_FDCWD, "/dev/ttyUSB0", O_RDWR|O_NOCTTY) = 5\n'
          f'read(3, "\\177ELF\\2\\1\\1", 832) = 7\n'
          f'[pid  812] 12:00:01.000100 write(5, "{octal(PING)}", 10) = 10\n'
          f'[pid  812] 12:00:01.000600 read(5, "{octal(PONG)}", 64) = {len(PONG)}\n')
LIBRARY = (f'openat(AT_FDCWD, "/lib/libc.so.6", O_RDONLY) = 3\n'
           f'read(3, "\\177ELF\\2\\1\\1"..., 832) = 832\nclose(3) = 0\n'
           f'ioctl(1, TCGETS, 0x7ffed879bd30) = -1 ENOTTY (Inappropriate ioctl for device)\n'
           f'openat(AT_FDCWD, "/dev/pts/4", O_RDWR) = 3\n'
           f'ioctl(3, TCSETS, {{c_cflag=B1000000|CS8|CREAD, ...}}) = 0\n'
           f'write(3, "{octal(PING)}", 10) = 10\nread(3, "{octal(PONG)}", 64) = 14\n')
SHAPES = {
    'hex': hexed(BOTH),
    'a question and its answer in a line': f'TX: {hexed(PING)}  RX: {hexed(PONG)}\n',
    'two in a line of Python': f'sent {PING!r} got reply {PONG!r}\n',
    'an arrow between the two': f'{hexed(PING)} -> {hexed(PONG)}\n',
    'a column for each': f'Sent,Received\n{hexed(PING)},{hexed(PONG)}\n',
    'answers alone have a mark': f'{hexed(PING)}\nRX: {hexed(PONG)}\n',
    'names of variables': f'char ping[] = {{{hexed(PING, "0x", ",")}}};\n'
                          f'char reply[] = {{{hexed(PONG, "0x", ",")}}};\n',
    'as the servo sees it': f'RX: {hexed(PING)}\nTX: {hexed(PONG)}\n',
    'a headline of both': f'Data sent on the bus:\n{hexed(PING)}\n{hexed(PONG)}\n',
    'sent and received': f'// sent and received\n{hexed(PING)}\n{hexed(PONG)}\n',
    'hex in quotes': f'TX {[hex(one) for one in PING]}\nRX {[hex(one) for one in PONG]}\n',
    'an H behind each': f'{hexed(PING, between="H ")}H\n{hexed(PONG, between="H ")}H\n',
    '0x without blanks': f'{hexed(PING, "0x", "")}\n{hexed(PONG, "0x", "")}\n',
    'words of two bytes': f'TX: {PING.hex(" ", -2)}\nRX: {PONG.hex(" ", -2)}\n',
    'an older encoding': f'TX {hexed(PING)} 25 \xb0C\nRX {hexed(PONG)}\n'.encode('latin-1'),
    'colours': f'\x1b[32mTX {hexed(PING)}\x1b[0m\nRX {hexed(PONG)}\n',
    'at a prompt': f'>>> ser.write({PING!r})\n10\n>>> ser.read(99)\n{PONG!r}\n',
    'a packet a line': f'{hexed(PING)}\n{hexed(PONG)}\n',
    '0x and commas': hexed(PING, '0x', ', ') + '\n' + hexed(PONG, '0x', ', '),
    '0x and bars': hexed(PING, '0x', ' | ') + '\n' + hexed(PONG, '0x', ' | '),
    'no blanks': PING.hex() + '\n' + PONG.hex(),
    'TX and RX': f'TX: {hexed(PING)}\nRX: {hexed(PONG)}\n',
    'TxPacket': f'[TxPacket] {hexed(PING)} (ping)\n[RxPacket] {hexed(PONG)}\n',
    'headlines': f'Sent:\n{hexed(PING)}\nReceived:\n{hexed(PONG)}\n',
    'arrows': f'-> {PING.hex(" ")}\n<- {PONG.hex(" ")}\n',
    'a fence': f'I see this:\n```\n>> {PING.hex(" ")}\n<< {PONG.hex(" ")}\n```\nHelp!\n',
    'coarse times': f'[12:00:01] TX {hexed(PING)}\n[12:00:02] RX {hexed(PONG)}\n',
    'milliseconds': f'[12:00:01.123] TX {hexed(PING)}\n[12:00:01.125] RX {hexed(PONG)}\n',
    'dates': (f'2026-01-02 12:00:01,123 sent {hexed(PING)}\n'
              f'2026-01-02 12:00:01,125 received {hexed(PONG)}'),
    'colons': f'TX {PING.hex(":")}\nRX {PONG.hex(":")}\n',
    'times and colons': (f'[1710412927.123456] {PING.hex(":")}\n'
                         f'[1710412927.125456] {PONG.hex(":")}'),
    "Arduino's monitor": f'12:01:07.123 -> {hexed(PING)}\n12:01:07.125 -> {hexed(PONG)}\n',
    'who to whom': f'Host -> Servo: {hexed(PING)}\nServo -> Host: {hexed(PONG)}\n',
    'two words a line': f'{PING.hex()}, {PONG.hex()}\n',
    'a count behind': f'TX: {hexed(PING)} (10 bytes)\nRX: {hexed(PONG)} (14 bytes)\n',
    'a count before': f'TX [10]: {hexed(PING)}\nRX len=14 {hexed(PONG)}\n',
    'an ID before': f'TX id 1: {hexed(PING)}\nRX id 1: {hexed(PONG)}\n',
    'each in brackets': ''.join(f'[{byte:02X}] ' for byte in BOTH),
    'decimal': f'{list(PING)}\n{list(PONG)}\n',
    'Python': f'a {PING!r}\nb {PONG!r}\n',
    'bytearray': f'parse {bytearray(BOTH)!r} failed',
    'xxd': xxd(BOTH),
    'xxd in a block of Markdown': textwrap.indent(xxd(BOTH), '    '),
    'hexdump -C': hexdump_c(BOTH),
    'hexdump': words(BOTH),
    'socat': (f'> 2026/01/02 12:00:01.000100  length=10 from=0 to=9\n {PING.hex(" ")}\n--\n'
              f'< 2026/01/02 12:00:01.000600  length=14 from=0 to=13\n {PONG.hex(" ")}\n--\n'),
    'socat at the device': (
        f'< 2026/01/02 12:00:01.000000100  length=10 from=0 to=9\n {PING.hex(" ")}\n'
        f'> 2026/01/02 12:00:01.000000600  length=14 from=0 to=13\n {PONG.hex(" ")}\n'),
    'strace': STRACE,
    'strace of a library': LIBRARY,
    'strace of threads': STRACE.replace(
        f'read(5, "{octal(PONG)}", 64)', 'read(5,  <unfinished ...>\n[pid 813] close(3) = 0\n'
        f'[pid  812] 12:00:01.000700 <... read resumed>"{octal(PONG)}", 64)'),
    'strace -e write=5 -e read=5': STRACE.replace(
        ' = 10\n', f' = 10\n | 00000  {PING.hex(" ")}  ......\n').replace(
        f' = {len(PONG)}\n', f' = {len(PONG)}\n | 00000  {PONG.hex(" ")}  ......\n'),
    'strace -y -xx': (
        f'write(5</dev/ttyACM0>, "{"".join(f"{chr(92)}x{one:02x}" for one in PING)}", 10) = 10\n'
        f'read(5</dev/ttyACM0>, "{octal(PONG)}", 99) = 14\n'),
    'sigrok-cli': '\n'.join(f'uart-1: {byte:02X}' for byte in BOTH),
    'Logic 1': csv('Time [s],Value,Parity Error,Framing Error', '{s:.9f},0x{b:02X},,'),
    'Logic 1 decimal': csv('Time [s],Value,Parity Error,Framing Error', '{s:.9f},{b},,'),
    'Logic 1 ASCII and hex': csv('Time [s],Value,Parity Error,Framing Error',
                                 "{s:.9f},'{b}' (0x{b:02X}),,"),
    'Logic 1 analysers': csv('Time [s],Analyzer Name,Decoded Protocol Result',
                             '{s:.9f},Async Serial,0x{b:02X}'),
    'Logic 2': csv('name,type,start_time,duration,data,error',
                   '"Async Serial","data",{s:.9f},1e-05,0x{b:02X},'),
    'Logic 2 ASCII': csv('name,type,start_time,duration,data,error',
                         '"Async Serial","data",{s:.9f},1e-05,{shown[1]},'),
    'Logic 2 binary': csv('name,type,start_time,duration,data,error',
                          '"Async Serial","data",{s:.9f},1e-05,0b{b:08b},'),
    'DSView': csv('Id,Time[ns],0:UART: RX/TX', '{n},{ns}.00,{b:02X}'),
    'DSView as it exports': csv('Id,Time[ns],0:UART: RX/TX', '{n},{ns}.00,{shown[0]}'),
}
DOUBLED = 'strace -e write=5 -e read=5'
SHAPES['TX and RX of Logic 2'] = lines_of('MCU TX', 'rx')
SHAPES['two of Logic 2 without a side'] = lines_of('A', 'B')
SHAPES['DSView with two columns'] = '\n'.join(
    ['Id,Time[ns],0:UART: RX/TX,0:UART: RX/TX',
     *(f'{n},{n * 10_000}.0,{byte:02X},' for n, byte in enumerate(PING)),
     *(f'{n},{n * 10_000}.0,,{byte:02X}' for n, byte in enumerate(PONG, len(PING)))])
KNOWS_SIDES = ('two of Logic 2 without a side', 'DSView with two columns', 'at a prompt',
               'a question and its answer in a line', 'two in a line of Python',
               'answers alone have a mark', 'names of variables', 'as the servo sees it',
               'hex in quotes', 'words of two bytes', 'an older encoding', 'colours',
               'socat at the device', 'strace of a library', 'strace of threads',
               'TX and RX of Logic 2', 'colons', 'who to whom', 'a count behind',
               'a count before', 'an ID before', DOUBLED, 'dates', 'milliseconds', 'TX and RX',
               'TxPacket', 'headlines', 'arrows', 'a fence', 'coarse times', 'socat', 'strace',
               'strace -y -xx')
KNOWS_TIMES = {'two of Logic 2 without a side', 'socat at the device', 'strace of threads',
               'socat', 'strace', 'times and colons', DOUBLED, 'TX and RX of Logic 2', 'dates',
               'milliseconds', "Arduino's monitor",
               *(one for one in SHAPES if one.startswith(('Logic', 'DSV')))}


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    def run_tool(tool, content, *options, name='pasted.txt'):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        monkeypatch.setattr('sys.argv', [tool.__module__, str(path), *options])
        code = tool()
        return code, *capsys.readouterr()
    return run_tool


@pytest.mark.parametrize('shape', SHAPES)
def test_packets_of_a_pasted_text(run, shape):
    code, out, err = run(dxl_dump, SHAPES[shape], '--json')
    packets = [json.loads(line) for line in out.splitlines()]
    assert (code, [one['instruction'] for one in packets]) == (0, ['Ping', 'Status']), err
    assert [one.get('side', '') for one in packets] == (
        ['out', 'in'] if shape in KNOWS_SIDES else ['', ''])
    assert 'read as' in err and ('times are not known' in err) == (shape not in KNOWS_TIMES)


ASKED, ANSWERED = 'FF FF 01 04 02 38 02 BE', 'FF FF 01 04 00 20 08 D2'
CUT, NOISY = ANSWERED[:-6], '00 7F 31 44 55 66'


@pytest.mark.parametrize('sides', [('TX: ', 'RX: '), ('', '')])
@pytest.mark.parametrize(('came', 'after', 'shown'), [
    (CUT, ANSWERED, 'ends too early; 01 04 00 20'), (NOISY, ANSWERED, '6 bytes of noise'),
    (CUT, None, 'ends too early; 01 04 00 20'), (NOISY, None, '6 bytes of noise')])
def test_what_is_no_packet_has_the_time_of_its_line(run, sides, came, after, shown):
    lines = [(0, ASKED), (2, ANSWERED), (20, ASKED), (22, came), (40, ASKED), (42, after)]
    text = ''.join(f'[12:00:00.{at:03}] {sides[at % 20 > 0]}{data}\n' for at, data in lines
                   if after or at < 40)
    code, out, err = run(dxl_dump, text, '--full', '--protocol', '1')
    [line] = [line for line in out.splitlines() if ' ! ' in line and 'missed' not in line]
    assert (code, float(line.split()[0]), line.endswith(shown)) == (0, 0.022, True), out + err


@pytest.mark.parametrize('encoding', ['utf-16', 'utf-8-sig'])
def test_what_powershell_writes(run, encoding):
    code, out, _ = run(dxl_dump, SHAPES['arrows'].encode(encoding), '--json')
    assert (code, len(out.splitlines())) == (0, 2)


def test_what_was_not_used_is_said(run):
    _, _, err = run(dxl_dump, SHAPES['a fence'])
    assert '2 lines not used, the first is line 1: I see this:' in err


def test_a_byte_with_a_letter_in_it_is_named(run):
    broken = hexed(PONG).replace('00', 'O0', 1)
    _, out, err = run(dxl_dump, f'TX: {hexed(PING)}\nRX: {broken}\n')
    assert f"'O0' is no byte, line 2: RX: {broken}" in err and 'noise' not in out


def test_sides_that_were_changed_are_said(run):
    assert 'TX and RX were swapped' in run(dxl_dump, SHAPES['as the servo sees it'])[2]
    assert 'TX and RX were not used' in run(dxl_dump, SHAPES['a headline of both'])[2]
    assert run(dxl_doctor, SHAPES['a headline of both'])[0] == 0


@pytest.mark.parametrize(('front', 'back', 'packets'), [
    ('{:08x}  {}  |{}|\n', '{:08x}\n', 100), ('{:07o} {}\n', '{:07o}\n', 100),
    ('{:06x} {}\n', '{:06x}\n', 100)])
def test_lines_that_a_star_stands_for_are_read(run, front, back, packets):
    row = bytes.fromhex('FF FF 01 04 02 38 02 BE FF FF 01 04 00 00 08 F2')
    text = front.format(0, row.hex(' '), '.' * 16) + '*\n' + back.format(packets * len(row))
    _, out, err = run(dxl_dump, text)
    assert len(out.splitlines()) == 2 * packets and 'not used' not in err


def test_a_star_of_unknown_length_is_said(run):
    row = bytes.fromhex('FF FF 01 04 02 38 02 BE FF FF 01 04 00 00 08 F2')
    text = words(row * 3).splitlines()
    assert 'print them with -v' in run(
        dxl_dump, '\n'.join([text[0], '*', text[-1]]), '--protocol', 'feetech')[2]


def test_errors_that_an_analyser_saw_are_counted(run):
    content = csv('Time [s],Value,Parity Error,Framing Error', '{s:.9f},0x{b:02X},,')
    assert '; 2 of them have errors' in run(
        dxl_dump, content.replace('0x55,,', '0x55,,Error').replace('0x34,,', '0x34,Error,'))[2]


@pytest.mark.parametrize('end', [5, 7, 8])
def test_damaged_answers_of_a_text_are_no_silence(run, end):
    rows = ''
    for number in (1, 2, 3) * 5:
        body = bytes((number, 4, 0, 0, 8))
        answer = b'\xff\xff' + body + bytes((~sum(body) & 0xFF,))
        question = bytes((number, 4, 2, 56, 2))
        rows += f'TX: FF FF {hexed(question)} {~sum(question) & 0xFF:02X}\n'
        rows += f'RX: {hexed(answer if number != 2 else answer[:end - 1] + bytes(end == 8))}\n'
    _, out, _ = run(dxl_doctor, rows)
    assert 'answers came damaged' in out and 'no power' not in out
    assert ' baud' not in out.splitlines()[0]


def test_the_rate_that_strace_shows_is_taken(run):
    _, out, _ = run(dxl_doctor, SHAPES['strace of a library'])
    assert ' 1000000 baud' in out.splitlines()[0]
    assert 'noise' not in run(dxl_dump, SHAPES['strace of a library'])[1]


def test_times_of_milliseconds_are_times(run):
    _, out, _ = run(dxl_dump, SHAPES['dates'], '--json')
    first, second = (json.loads(line)['stamp'] for line in out.splitlines())
    assert second - first == pytest.approx(0.002, abs=1e-4)


def test_the_first_packets_of_the_1_0_family_have_their_times(run):
    packets = [bytes.fromhex('FF FF 01 04 02 38 02 BE'), bytes.fromhex('FF FF 01 04 00 D0 07 23')]
    starts = [0, 330, 1110, 1440, 2220, 2550]
    rows = [f'{(start + 10 * n) / 1e6:.6f},0x{byte:02X}' for number, start in enumerate(starts)
            for n, byte in enumerate(packets[number % 2])]
    _, out, _ = run(dxl_dump, '\n'.join(['Time [s],Value', *rows]), '--json')
    stamps = [json.loads(line)['stamp'] for line in out.splitlines()]
    assert [round((one - stamps[0]) * 1e6) for one in stamps] == starts


def test_a_packet_of_the_1_0_family_has_a_checksum(run):
    read, wrong = 'FF FF 01 04 02 38 02 BE', 'FF FF 01 04 00 D0 07 24'
    text = f'TX {read}\nRX FF FF 01 04 00 D0 07 23\n' * 3 + f'TX {read}\nRX {wrong}\n'
    _, out, _ = run(dxl_dump, text)
    assert 'Status: wrong checksum; 01' in out and 'CRC' not in out
    assert 'Status: wrong CRC' in run(dxl_dump, hexed(BOTH + BOTH[:-1] + PING))[1]


def test_which_of_two_analysers_is_asked(run):
    rows = [f'{at + n * 1e-5:.6f},{name},0x{byte:02X}' for at, name, data in (
        (0, "Joe's", BOTH), (0.1, 'BUS', BOTH + BOTH)) for n, byte in enumerate(data)]
    code, out, err = run(dxl_dump, '\n'.join(['Time [s],Analyzer Name,Value', *rows]))
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert """(head -n 1 FILE; grep -F 'Joe'"'"'s' FILE) | dxl_dump -""" in err
    assert 'of 2 analysers, ' in err and ', BUS; name two TX and RX' in err


def test_what_strace_cut_is_said_and_no_noise(run):
    cut = f'write(5, "{octal(PING + PING)[:40]}"..., 48) = 48\n'
    for text in (STRACE + cut * 5, cut):
        _, _, err = run(dxl_dump, text)
        assert f'strace left out {38 * text.count(cut)} bytes' in err and '-s 4096' in err
    _, out, _ = run(dxl_doctor, STRACE + cut * 50)
    assert 'USB events' not in out and 'no packet' not in out and '-s 4096' in out


def test_doctor_says_nothing_of_times_and_wires(run):
    _, out, err = run(dxl_doctor, SHAPES['coarse times'])
    assert 'holds no exact times' in out and 'D+' not in out + err


@pytest.mark.parametrize('tool', [dxl_dump, dxl_doctor])
def test_two_packets_of_the_1_0_family_do_not_show_that(run, tool):
    pasted = 'FF FF 01 04 02 38 02 BE\nFF FF 01 04 00 D0 07 23\n'
    _, out, err = run(tool, pasted)
    assert '--protocol feetech' in ' '.join((out + err).split()) and 'D+' not in out + err
    assert run(dxl_dump, pasted, '--protocol', 'feetech')[0] == 0


@pytest.mark.parametrize(('content', 'said'), [
    (hexed(PING[:-1] + b'\0'), 'no packet with a right checksum; dxl_dump --check'),
    ('FF FF zz 01\n' * 5, 'not a recording'),
    ('name,time\n' + 'x,' * 200_000, 'not a recording'),
    ('data,time\nFF\nFF', 'no packet with a right checksum'),
    ('f' * 3_000_000, 'no packet with a right checksum'),
    ('FF ' * 500_000, 'no packet with a right checksum'),
    ('1:' * 500_000, 'not a recording'),
    ('read(3, "' + '\\' * 300_001, 'not a recording'),
    ('Time [s],Value\n' + 'nan,0xFF\ninf,0xFF\n1e999,0xFF\n', 'no packet with a right'),
])
@pytest.mark.parametrize('tool', [dxl_dump, dxl_doctor])
def test_a_text_without_packets_is_refused_in_one_line(run, tool, content, said):
    code, out, err = run(tool, content)
    assert (code, out, err.count('\n')) == (2, '', 1) and said in err


def test_a_text_from_a_pipe_is_read():
    ran = subprocess.run([sys.executable, '-m', 'servobus.tools.dxl_dump', '-', '--json'],
                         input=SHAPES['arrows'], capture_output=True, text=True)
    assert (ran.returncode, len(ran.stdout.splitlines())) == (0, 2), ran.stderr


def sigrok(data, rate='8 MHz', samples=8, metadata='probe2=bus\nunitsize=1', other=b'', stop=1):
    """Return a .sr file: two lines at 1 MBd; what the first has comes before the second."""
    first, second = ([level for byte in part for level in (
        0, *(byte >> bit & 1 for bit in range(8)), *bits)] for part, bits in (
            (other, (1,)), (data, (1,) if stop else (0, 1))))
    idle = [1] * 50
    first, second = [*idle, *first], [*idle, *[1] * len(first), *second, *idle]
    wire = b''.join(bytes([2 * two + one]) * samples
                    for one, two in zip_longest(first, second, fillvalue=1))
    file = io.BytesIO()
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as zipped:
        zipped.writestr('version', '2')
        zipped.writestr('metadata', f'[device 1]\ncapturefile=logic-1\ntotal probes=8\n'
                        f'samplerate={rate}\n{metadata}\n')
        zipped.writestr('logic-1-1', wire[:999])
        zipped.writestr('logic-1-2', wire[999:])
    return file.getvalue()


def test_a_line_of_sigrok_is_decoded(run):
    code, out, err = run(dxl_dump, sigrok(BOTH), '--json', '-b', '1000000', name='bus.sr')
    packets = [json.loads(line) for line in out.splitlines()]
    assert [one['instruction'] for one in packets] == ['Ping', 'Status'], err
    assert packets[1]['stamp'] == pytest.approx(1e-4, abs=2e-6)
    assert 'read as line bus of sigrok at 1000000 baud: 24 bytes' in err and code == 0


@pytest.mark.parametrize(('content', 'sides', 'said'), [
    (sigrok(PONG, other=PING), ['out', 'in'], 'lines 0 and bus of sigrok'),
    (sigrok(PONG, other=PING, metadata='probe1=RX\nprobe2=TX'), ['out', 'in'],
     'TX and RX were swapped'),
    (sigrok(BOTH, other=PING), [None, None], '24 bytes; not used: 0'),
    (sigrok(BOTH, other=b'hello'), [None, None], '24 bytes; not used: 0')])
def test_two_lines_of_sigrok_are_one_bus(run, content, sides, said):
    _, out, err = run(dxl_dump, content, '--json', '-b', '1000000', name='bus.sr')
    packets = [json.loads(line) for line in out.splitlines()]
    assert [one['instruction'] for one in packets] == ['Ping', 'Status'], err
    assert [one.get('side') or None for one in packets] == sides
    assert said in err


def test_bytes_without_a_stop_bit_are_read(run):
    _, out, err = run(dxl_dump, sigrok(BOTH, stop=0), '-b', '1000000', name='bus.sr')
    assert '; 24 of them have errors' in err and len(out.splitlines()) == 2


@pytest.mark.parametrize(('content', 'options', 'said'), [
    (sigrok(BOTH + PING, other=BOTH), ('-b', '1000000'),
     'packets on 2 lines, 0, bus; give one: sigrok-cli -i FILE -C 0 -o one.sr'),
    (sigrok(BOTH), (), 'give the baud rate'),
    (sigrok(BOTH), ('-b', '57600'), 'no line holds a packet'),
    (sigrok(BOTH), ('-b', '4000000'), 'too few for 4000000 baud'),
    (sigrok(BOTH, rate='fast'), ('-b', '1000000'), 'a damaged recording'),
    (sigrok(BOTH, metadata='unitsize=0'), ('-b', '1000000'), 'a damaged recording'),
    (sigrok(BOTH)[:-30], ('-b', '1000000'), 'a damaged recording'),
    (sigrok(b'\0' * 300_000), ('-b', '1000000'), 'no line holds a packet'),
])
def test_a_recording_of_sigrok_without_packets(run, content, options, said):
    code, out, err = run(dxl_dump, content, *options, name='bus.sr')
    assert (code, out, err.count('\n')) == (2, '', 1) and said in err


def test_no_rate_is_claimed_that_the_text_does_not_say(run):
    _, out, _ = run(dxl_doctor, SHAPES['strace'])
    assert ' baud' not in out.splitlines()[0]
