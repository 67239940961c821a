# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A recording of sigrok (.sr): levels of lines in a zip file; the bytes of one bus, 8N1.

Source: sigrok, "File format: sigrok/v2". A byte without a stop bit is one with a framing error.
"""
from __future__ import annotations

from collections.abc import Iterator
from configparser import ConfigParser
from configparser import Error
import re
import shlex
from typing import BinaryIO
from zipfile import BadZipFile
from zipfile import ZipFile
import zlib

from msg_defs.event import BREAK
from msg_defs.event import Change
from msg_defs.event import FRAMING
from msg_defs.nanoseconds import NS_PER_S
from servobus.errors import UsageError
from servobus.printable_text import printable
from servobus.sources.byte_sides import ByteText
from servobus.sources.byte_sides import holds_packet
from servobus.sources.byte_sides import NAMED_MAX
from servobus.sources.byte_sides import one_bus
from servobus.sources.byte_sides import TextBytes

SAMPLES_MAX_BYTES = 1 << 26
METADATA_MAX_BYTES = 1 << 16
UNIT_MAX_BYTES = 16                # 128 lines
BIT_MIN_SAMPLES = 3
_RATE = re.compile(r'([\d.]{1,15}) ?([kMG]?)Hz')
_FACTOR = {'': 1, 'k': 1e3, 'M': 1e6, 'G': 1e9}
_LOW, _HIGH = b'\0', b'\1'


def read_sigrok(file: BinaryIO, baud: int | None) -> ByteText | None:
    """Return what a file shows, None where it is no such file; raise UsageError in words."""
    try:
        with ZipFile(file) as zipped:
            if 'metadata' not in zipped.namelist():
                return None
            return _decoded(zipped, baud)
    except (BadZipFile, Error, zlib.error, EOFError, LookupError, ValueError,
            RuntimeError) as error:
        raise UsageError(f'a damaged recording of sigrok ({printable(str(error), 60)}); record it '
                         'again, or decode it with PulseView and give the CSV') from error


def _decoded(zipped: ZipFile, baud: int | None) -> ByteText:
    settings = ConfigParser(interpolation=None)
    text = zipped.open('metadata').read(METADATA_MAX_BYTES).decode()
    settings.read_string(re.sub(r'(?m)^[ \t]+', '', text))     # older files indent triggers
    device = settings['device 1']
    found = _RATE.fullmatch(device['samplerate'])
    unit = int(device.get('unitsize', '1'))
    if found is None or not 1 <= unit <= UNIT_MAX_BYTES:
        raise ValueError(f'sample rate {device["samplerate"]}, {unit} bytes a sample')
    rate = float(found[1]) * _FACTOR[found[2]]
    if baud is None:
        raise UsageError('a recording of sigrok; give the baud rate of the bus, as -b 1000000')
    if rate < BIT_MIN_SAMPLES * baud:
        raise UsageError(f'{rate:.0f} samples a second are too few for {baud} baud; record at '
                         f'{BIT_MIN_SAMPLES * baud} or more')
    samples, is_cut = _samples(zipped, device['capturefile'])
    names = [device.get(f'probe{number + 1}', '') for number in range(8 * unit)]
    lines = {}
    for number, name in enumerate(names):
        levels = samples[number // 8::unit].translate(
            bytes(one >> number % 8 & 1 for one in range(256)))
        if _LOW in levels and _HIGH in levels:
            lines[printable(name) or f'{number}'] = list(_bytes(levels, rate, baud))
    held = {name: line for name, line in lines.items()
            if holds_packet(b''.join(one.data for one in line))}
    if not held:
        raise UsageError(f'no line holds a packet with a right checksum at {baud} baud, 8N1; '
                         'check -b, and that the levels are not inverted')
    bus = one_bus(held if len(held) > 1 else lines)
    if bus.rivals:
        raise UsageError(f'packets on {len(bus.rivals)} lines, {", ".join(bus.rivals[:NAMED_MAX])}'
                         f'; give one: sigrok-cli -i FILE -C {shlex.quote(bus.rivals[0])} -o '
                         'one.sr')
    shape = f'line{"s" * (len(bus.names) > 1)} {" and ".join(bus.names)} of sigrok at {baud} baud'
    return ByteText(shape + ', the first 64 MiB' * is_cut, bus.parts, {},
                    notes=[bus.note] * bool(bus.note))


def _samples(zipped: ZipFile, name: str) -> tuple[bytes, bool]:
    """Return the samples up to a limit, and whether there are more."""
    wanted = re.compile(rf'{re.escape(name)}(-\d{{1,9}})?')
    parts = filter(wanted.fullmatch, zipped.namelist())
    samples = bytearray()
    for part in sorted(parts, key=lambda one: (len(one), one)):
        with zipped.open(part) as file:
            samples += file.read(SAMPLES_MAX_BYTES + 1 - len(samples))
    return bytes(samples[:SAMPLES_MAX_BYTES]), len(samples) > SAMPLES_MAX_BYTES


def _bytes(levels: bytes, rate: float, baud: int) -> Iterator[TextBytes]:
    """Yield each byte of a line, with the time of its end, as a UART takes it."""
    bit = rate / baud
    at = levels.find(_HIGH)
    while (start := levels.find(_LOW, at)) >= 0 and start + 9.5 * bit < len(levels):
        middles = [levels[int(start + (number + 0.5) * bit)] for number in range(10)]
        if middles[0]:                         # a short pulse, no start bit
            at = start + 1
            continue
        value = sum(level << number for number, level in enumerate(middles[1:9]))
        time = int((start + 10 * bit) / rate * NS_PER_S)
        flaw = None if middles[9] else Change(FRAMING if any(middles) else BREAK, 1)
        yield TextBytes(bytes((value,)), time=time, change=flaw)
        if (at := levels.find(_HIGH, int(start + 9.5 * bit))) < 0:
            return
