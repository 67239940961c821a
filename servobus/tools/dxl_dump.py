# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_dump: what happens on a Dynamixel bus, in the terminal; from a port, a capture or bytes."""
from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
import os
from pathlib import Path
import sys

from msg_defs.dxl_instruction import NAMES
from servobus.errors import did_you_mean
from servobus.errors import UsageError
from servobus.model.models import check_models
from servobus.model.models import model_files
from servobus.model.models import Models
from servobus.printable_text import printable
from servobus.settings import settings_of
from servobus.sources.capture import Wire
from servobus.tools.bus_options import add_bus_options
from servobus.tools.bus_options import models_of
from servobus.tools.bus_options import refuse_run_word
from servobus.tools.cli import COULD_NOT_RUN
from servobus.tools.cli import DONE
from servobus.tools.cli import print_problems
from servobus.tools.cli import run_tool
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser
from servobus.tools.dump.packet_check import bytes_of
from servobus.tools.dump.packet_check import check_packets
from servobus.tools.dump.packet_lines import TIMES
from servobus.tools.dump.recording_writers import CAPTURE
from servobus.tools.dump.recording_writers import FORMATS
from servobus.tools.dump.recording_writers import MCAP
from servobus.tools.dump.recording_writers import PCAPNG
from servobus.tools.dump.screen import has_colours
from servobus.tools.dump.session import Session
from servobus.tools.dump.wireshark_tables import write_tables

HIGHEST_ID = 255                   # damage may make any byte of an ID
EXAMPLES = """examples:
  dxl_dump /dev/ttyUSB0                         every packet at 2 MBd, registers by name
  dxl_dump /dev/ttyUSB0 -b 1000000 --errors     only what went wrong
  dxl_dump /dev/ttyUSB0 --stats                 load, rates, errors, latency
  dxl_dump /dev/ttyUSB0 -w bus.txt              record; Ctrl-C ends it
  dxl_dump /dev/ttyUSB0 -w - --format pcapng | wireshark -k -i -
  dxl_dump bus.txt --id 7,11 --instruction write,status
  dxl_dump bus.txt --json | jq .registers       for programs
  ssh robot dxl_dump /dev/ttyUSB0 -w - | dxl_dump -
  dxl_dump --check 'FF FF 01 04 02 38 02 BE'    is this packet right, and what does it say?
  dxl_dump --check-models my_models             is a folder of model files all right?
  dxl_dump --wireshark my_folder                the dissector's tables of all models"""


def main() -> int:
    """Run the command `dxl_dump`."""
    return run_tool('dxl_dump', _run)


def _run(arguments: list[str]) -> int:
    parser = _parser()
    refuse_run_word(parser, 'source', arguments)
    options = parser.parse_args(arguments)
    if options.check_models is not None:
        return _check_models(options.check_models)
    if options.check is not None:
        return _check_packet(options.check, options)
    if options.wireshark is not None:
        return _write_tables(Path(options.wireshark), models_of(options))
    if options.source is None:
        raise UsageError('SOURCE: none given; name a port, a capture or a file, or - for stdin')
    options.ids = _listed(options.id, _ids)
    options.about = _listed(options.about, _ids)
    options.instructions = _listed(options.instruction, _code)
    options.colours = has_colours(options.color)
    options.format = options.format or _format(options.write)
    with Session(options) as session:
        session.run()
    return DONE


def _check_models(folder: str) -> int:
    """Say every problem of a folder of model files."""
    problems = check_models(folder)
    print_problems('dxl_dump', problems)
    if problems:
        return COULD_NOT_RUN
    print(f'{printable(folder)}: {len(model_files(Path(folder)))} model files, no problem')
    return DONE


def _check_packet(text: str, options: Namespace) -> int:
    """Say whether a packet is right, what it says, and what would be right."""
    models = models_of(options)
    settings = settings_of('', Wire('', 1_000_000), options.devices, options.protocol)
    is_right, lines = check_packets(bytes_of(text), settings, models)
    print(*lines, sep='\n')
    return DONE if is_right else COULD_NOT_RUN


def _write_tables(folder: Path, models: Models) -> int:
    """Write the tables of the Wireshark dissector; say how to install both files."""
    path = write_tables(folder, models)
    print(f'{printable(str(path))}: {len(models.names())} models written; put it and '
          'wireshark/servobus.lua of the repository into ~/.local/lib/wireshark/plugins '
          '(Wireshark: Help, About, Folders, Personal Lua Plugins)')
    return DONE


def _listed(entries: Sequence[str] | None,
            read: Callable[[str], Iterable[int]]) -> frozenset[int] | None:
    """Return the numbers of '7,11-13' given once or more; None for all."""
    return None if entries is None else frozenset(
        number for text in ','.join(entries).split(',') for number in read(text))


def _ids(text: str) -> range:
    """Return the IDs of '7' or '11-13'."""
    first, dash, last = text.strip().partition('-')
    try:
        ids = range(int(first), int(last if dash else first) + 1)
    except ValueError:
        ids = range(0)
    if not ids or not 0 <= ids[0] <= ids[-1] <= HIGHEST_ID:
        raise UsageError(f'{text!r}: not an ID; write e.g. 7 or 7,11-13, or 254 for broadcasts')
    return ids


def _code(text: str) -> tuple[int]:
    """Return the code of 'write', 'sync_read' or '0x83'."""
    codes = {name.casefold().replace(' ', '_'): code for code, name in NAMES.items()}
    name = text.strip().casefold().replace(' ', '_').replace('-', '_')
    try:
        code = codes[name] if name in codes else int(name, 0)
    except ValueError:
        code = -1
    if not 0 <= code <= 0xFF:
        raise UsageError(f'{text!r}: not an instruction; {did_you_mean(name, codes)}; or give a '
                         'code like 0x83')
    return (code,)


def _format(name: str | None) -> str:
    """Return the format of a recording of this name."""
    ending = os.path.splitext(name or '')[1].lower()
    if ending == '.pcap':
        raise UsageError(f'-w {name}: cannot write {ending}; give a name that ends in .pcapng, or '
                         '--format capture')
    return {'.pcapng': PCAPNG, '.mcap': MCAP}.get(ending, CAPTURE)


def _parser() -> Parser:
    parser = Parser(
        'dxl_dump', epilog=EXAMPLES,
        description='Shows the packets on a Dynamixel or Feetech bus. It never sends.')
    add = parser.add_argument
    add('source', metavar='SOURCE', nargs='?',
        help='a port, a pyserial URL, usb:PORT (the traffic of another program that uses PORT), '
             'tap:NAME (a program started with dxl_tap), a capture, a pcap file, a file of raw '
             'bytes, or - for stdin')
    add_bus_options(parser, runs=False)
    show = parser.add_argument_group('what to show (default: a line for each packet)')
    add = show.add_argument
    add('--json', action='store_true', help='a JSON object for each packet')
    add('--summary', action='store_true', help='the counters, as one JSON object at the end')
    add('--stats', action='store_true', help='load, rates, errors, latency of each device')
    add('-w', '--write', metavar='FILE', help='record to a file (- for stdout): a capture; '
        'packets for Wireshark if its name ends in .pcapng; messages for Foxglove: .mcap')
    add('--format', choices=FORMATS, help='format of the recording (default: by the name of FILE)')
    only = parser.add_argument_group('which packets')
    add = only.add_argument
    add('--id', action='append', metavar='IDS', help='packets with these IDs, e.g. 7,11-13')
    add('--about', action='append', metavar='IDS',
        help='also packets that list these IDs: Sync Read, Bulk Write and so on')
    add('--instruction', action='append', metavar='NAMES', help='e.g. write,status or 0x83')
    add('--errors', action='store_true', help='only errors')
    add('--count', type=number(int, 1), metavar='N', help='end after N packets')
    add('--seconds', type=number(float, 0), metavar='S', help='end after this time')
    layout = parser.add_argument_group('format')
    add = layout.add_argument
    add('-t', '--time', choices=TIMES, default='start',
        help='time since the first line, local time, or since 1970')
    add('--full', action='store_true', help='do not cut lines to the width of the terminal')
    add('--color', choices=('auto', 'always', 'never'), default='auto',
        help='default: on a terminal, unless NO_COLOR is set')
    add('--check', metavar='HEX', help="check a packet, e.g. 'FF FF 01 04 02 38 02 BE', say what "
        'it says and what would be right, and exit')
    add('--check-models', metavar='DIR', help='check a folder of model files and exit')
    add('--wireshark', metavar='DIR', help='write the tables of the Wireshark dissector to a '
        'folder and exit; with --model-dirs also of your models')
    return parser


if __name__ == '__main__':
    sys.exit(main())
