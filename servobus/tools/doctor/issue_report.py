# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The report of a run, to attach to an issue: text for people, a verdict and a capture for us.

It is made of parts, each after a line that begins with a mark. One of somebody else is read again:
what was said then, and what its capture says now. Nothing in it is trusted, and nothing is
refused: what is damaged or cut off is left out and reported. Packed files are unpacked, up to a
limit.
"""
from __future__ import annotations

from base64 import b64decode
from base64 import b64encode
from binascii import Error as Base64Error
import bz2
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from contextlib import suppress
import gzip
import io
import json
import lzma
import os
import textwrap
from typing import Any
from typing import NamedTuple
import zipfile
import zlib

from msg_defs.diagnostics import Level
from msg_defs.event import Chunk
from servobus.bus.expected_devices import split_bus
from servobus.doctor.finding_log import BusSummary
from servobus.errors import UsageError
from servobus.printable_text import printable
from servobus.sources.capture import check_new
from servobus.sources.capture import lines
from servobus.sources.capture import Reader
from servobus.sources.capture import Wire
from servobus.sources.opening import REPORT
from servobus.tools.doctor.answer_screen import screen
from servobus.tools.doctor.verdict import as_json
from servobus.tools.doctor.verdict import DeviceGroup
from servobus.tools.doctor.verdict import OpenPoint
from servobus.tools.doctor.verdict import Trouble
from servobus.tools.doctor.verdict import Verdict

VERSION = 1
VERDICT, CAPTURE, END = '# verdict', '# capture', '# end'
_ABOUT = ('# Attach this file to an issue. `dxl_doctor FILE` shows it again.',
          '# It holds what is on the servo bus, and no host or user name, path, serial number or',
          '# command line, unless it was made with --with-host.')
NOTHING = ('no byte of a bus; the reasons that were shown name ports and programs, so they are '
           'not in a report')
BLOCK_SIZE = 200_000               # text that is packed at once: damage costs one block
_COLUMNS = 100
FILE_MAX_BYTES = 16_000_000        # bytes that are read of a file, and of what is packed in it
_BLOCK_MAX_BYTES = 4_000_000       # bytes of one block of the capture, unpacked
_HEAD_SIZE = 4096                  # a report begins within so much
_TEXT_MAX_LENGTH, _LIST_MAX_LENGTH = 500, 300
_PACKED: tuple[tuple[bytes, Callable[[io.BytesIO], Any]], ...] = (
    (b'\x1f\x8b\x08', lambda file: gzip.GzipFile(fileobj=file)), (b'BZh', bz2.BZ2File),
    (b'\xfd7zXZ', lzma.LZMAFile), (b'PK\x03\x04', lambda file: _first_of_zip(file)))


def check_report(path: str | None) -> None:
    """Raise UsageError or ParameterError for what must not be written over."""
    if path is None:
        return
    folder = os.path.dirname(path) or '.'
    if not os.access(folder, os.W_OK):
        raise UsageError(f'--report {path}: cannot write to {folder}; give another name')
    check_new(path, lambda begin: begin.startswith(REPORT.encode()), 'report', '--report')


def anonymous(buses: Sequence[BusSummary]) -> list[BusSummary]:
    """Return buses with names that say nothing: a name may hold a path or a serial number."""
    names = new_names(buses)
    return [bus._replace(name=bus.name and names[bus.report.name],
                         report=bus.report._replace(name=names[bus.report.name]))
            for bus in buses]


def new_names(buses: Sequence[BusSummary]) -> dict[str, str]:
    """Return what each bus is called in a report."""
    return {bus.report.name: f'bus{number}' for number, bus in enumerate(buses, 1)}


def new_devices(entries: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """Return the entries of --devices with what their buses are called in a report."""
    parted = map(split_bus, entries)
    return [f'{names[bus]}/{rest}' if bus else rest for bus, rest in parted
            if not bus or bus in names]


def make_report(verdict: Verdict, buses: Sequence[BusSummary], seconds: float,
                about: Sequence[str], devices: Sequence[str], protocol: str,
                capture: bytes) -> str:
    """Return the text of a report; about: lines about the machine; the names are new ones."""
    stored = {'verdict': verdict._asdict(), 'json': as_json(verdict, buses, seconds),
              'devices': devices, 'protocol': protocol}
    text = [f'{REPORT} {VERSION}', *_ABOUT, '', *screen(verdict, height=None), '', 'System:']
    text += [f'  {printable(line)}' for line in about]
    for bus in buses:
        text += ['', *_figures(bus)]
    text += ['', VERDICT, json.dumps(stored), '', CAPTURE, *packed(capture), END]
    return '\n'.join(text) + '\n'


def _figures(bus: BusSummary) -> list[str]:
    counted: dict[str, Any] = bus.report.counters
    text = [f'{bus.report.name}: {bus.report.baud} baud; '
             + ', '.join(f'{name} {count}' for name, count in counted.items() if count)]
    for device in bus.report.devices:
        totals = ', '.join(f'{name} {count}' for name, count in device.totals.published().items()
                           if count)
        firmware = '' if device.firmware is None else f', firmware {device.firmware}'
        text.append(f'  {printable(device.name)} {device.model_name}{firmware}, {device.state}: '
                     f'{totals}')
    return text


def packed(capture: bytes) -> Iterator[str]:
    """Yield a capture as lines of text, a blank line after each block of it."""
    for at in range(0, len(capture), BLOCK_SIZE):
        text = b64encode(zlib.compress(capture[at:at + BLOCK_SIZE], 9)).decode()
        yield from textwrap.wrap(text, _COLUMNS)
        yield ''


# --- read again ----------------------------------------------------------------------------------

class SavedReport(NamedTuple):
    """
    What was left of a report. None: that part is damaged; problems: a line each.

    logged: each finding as (bus, rule, device): one by one, however the screen put them together.
    """

    verdict: Verdict | None
    as_json: dict[str, Any] | None
    logged: frozenset[tuple[str, str, str]] | None
    devices: list[str]
    protocol: str
    chunks: list[Chunk]
    wires: dict[str, Wire]
    problems: list[str]


def load_report(path: str) -> SavedReport | None:
    """Return the report in a file, None where it is something else; OSError as of open."""
    with open(path, 'rb') as file:
        data = _unpacked(file.read(FILE_MAX_BYTES))
    begin = data.find(REPORT.encode(), 0, _HEAD_SIZE)
    if begin < 0:
        return None
    parts = _parts(data[begin:].decode('utf-8', 'replace'))
    problems = [] if END in parts else ['the report is cut off: its end is missing']
    stored = _stored(parts.get(VERDICT, []))
    if stored is None:
        problems.append('its verdict cannot be read; this one is from the capture')
    capture, lost = _capture(parts.get(CAPTURE, []))
    if lost:
        problems.append(f'{lost} blocks of the capture are damaged and were left out')
    reader = Reader(lines(io.BytesIO(capture)))
    chunks = list(reader)
    stored = stored or {}
    as_json = stored.get('json')
    return SavedReport(_verdict(stored), as_json if isinstance(as_json, dict) else None,
                       _logged_findings(as_json), _texts(stored.get('devices')),
                       str(stored.get('protocol', '')), chunks, reader.wires, problems)


def _unpacked(data: bytes) -> bytes:
    for front, opener in _PACKED:
        if data.startswith(front):
            unpacked = bytearray()
            # Where it is damaged, each kind raises what it likes; what came until then counts.
            with suppress(Exception), opener(io.BytesIO(data)) as file:
                while len(unpacked) < FILE_MAX_BYTES and (part := file.read1(1 << 16)):
                    unpacked += part
            return bytes(unpacked)
    return data


def _first_of_zip(file: io.BytesIO) -> Any:
    archive = zipfile.ZipFile(file)
    names = [one for one in archive.namelist() if not one.endswith('/')]
    return archive.open(names[0]) if names else io.BytesIO()


def _parts(text: str) -> dict[str, list[str]]:
    """Return the lines after each mark."""
    parts: dict[str, list[str]] = {}
    part: list[str] = []
    for line in map(str.strip, text.splitlines()):
        if line in (VERDICT, CAPTURE, END):
            part = parts.setdefault(line, [])
        else:
            part.append(line)
    return parts


def _stored(part: list[str]) -> dict[str, Any] | None:
    try:
        found = json.loads(''.join(part))
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get('verdict'), dict) else None


def _capture(part: list[str]) -> tuple[bytes, int]:
    """Return the blocks of a capture that are sound, and how many are not."""
    found = bytearray()
    lost = 0
    for block in '\n'.join(part).split('\n\n'):
        if not block.strip():
            continue
        unpacker = zlib.decompressobj()
        try:
            found += unpacker.decompress(b64decode(''.join(block.split())), _BLOCK_MAX_BYTES)
            lost += not unpacker.eof
        except (Base64Error, ValueError, zlib.error):
            lost += 1
        if len(found) > FILE_MAX_BYTES:
            break
    return bytes(found), lost


# --- what was said then ------------------------------------------------------------------------

def _verdict(stored: dict[str, Any]) -> Verdict | None:
    verdict = stored.get('verdict')
    if verdict is None:
        return None
    try:
        return Verdict(
            _text(verdict['source']), _texts(verdict['head']),
            _read_rows(DeviceGroup, verdict['heard']), _read_rows(Trouble, verdict['wrong']),
            _texts(verdict['unknown']), _texts(verdict['quiet']),
            _text(verdict.get('protocol', '')), _texts(verdict.get('cycles')),
            _read_rows(OpenPoint, verdict.get('not_sure', [])))
    except (KeyError, TypeError, ValueError):
        return None


def _read_rows(kind: type[Any], rows: list[Any]) -> list[Any]:
    """Return rows of values as what they were; each has a text but `level`."""
    return [kind(*[Level(value) if name == 'level' else _text(value)
                   for name, value in zip(kind._fields, row, strict=True)])
            for row in rows[:_LIST_MAX_LENGTH]]


def _logged_findings(as_json: Any) -> frozenset[tuple[str, str, str]] | None:
    try:
        return frozenset((str(bus['name']), str(finding['rule']), str(finding['device']))
                         for bus in as_json['buses'] for finding in bus['findings'])
    except (KeyError, TypeError, IndexError):
        return None


def _text(value: object) -> str:
    return printable(str(value), _TEXT_MAX_LENGTH)


def _texts(values: object) -> list[str]:
    return [_text(one) for one in values[:_LIST_MAX_LENGTH]] if isinstance(values, list) else []
