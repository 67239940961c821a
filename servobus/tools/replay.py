# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
dxl_replay: plays a capture into a pty, chunk by chunk with the original timing.

It waits for a reader before it begins, and for a slow one on the way: it is late rather than
losing a byte. A listener that has left hears nothing, as on a bus.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from contextlib import closing
from contextlib import ExitStack
from contextlib import suppress
import math
import os
import stat
import sys
import threading
import time
from urllib.parse import quote

from msg_defs.event import Chunk
from msg_defs.event import IN
from msg_defs.event import OUT
from servobus.errors import UsageError
from servobus.port.pty import Pty
from servobus.port.readable import is_writable
from servobus.printable_text import printable
from servobus.sources.capture import Wire
from servobus.sources.opening import open_file
from servobus.sources.source import File
from servobus.sources.source import RawFile
from servobus.tools.bus_options import BAUD
from servobus.tools.bus_options import refuse_run_word
from servobus.tools.cli import DONE
from servobus.tools.cli import print_problems
from servobus.tools.cli import run_tool
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

SETTLE_S = 0.5                     # a reader has opened the port, and sets it up
LAST_QUESTION_S = 1.5              # at the end: until the last instruction is given up
LOOP_PAUSE_S = 0.1
POLL_S = 0.05
RAW_CHUNK_BYTES = 200              # bytes of a raw file that are sent at once


def _wait_for_readers(outlets: Iterable[Pty]) -> None:
    """Wait until somebody listens to every bus."""
    for outlet in outlets:
        while not outlet.is_open:
            time.sleep(POLL_S)
    time.sleep(SETTLE_S)


def _play(chunks: Iterable[Chunk], outlets: Mapping[str, Pty], speed: float
          ) -> tuple[int, int, float]:
    """
    Play to the ptys of the buses; speed 0: as fast as the readers take it.

    Return how many chunks and bytes that were, and how late at most (s).
    """
    count = size = 0
    late_s = 0.0
    begin: int | None = None
    for chunk in chunks:
        if begin is None:
            begin, start_s = chunk.stamp, time.monotonic()
        outlet = outlets.get(chunk.bus)
        if outlet is None:
            continue
        due_s = start_s + (chunk.stamp - begin) / 1e9 / speed if speed else math.inf
        if speed:
            time.sleep(min(max(0.0, due_s - time.monotonic()), threading.TIMEOUT_MAX))
        _write(outlet, chunk.data)
        count += 1
        size += len(chunk.data)
        late_s = max(late_s, time.monotonic() - due_s)
    return count, size, late_s


def _write(outlet: Pty, data: bytes) -> None:
    """Write all of it, unless the last listener has left."""
    while data and outlet.is_open:
        if is_writable(outlet.master, POLL_S):
            with suppress(BlockingIOError):
                data = data[os.write(outlet.master, data):]


def main() -> int:
    """Run the command `dxl_replay`."""
    return run_tool('dxl_replay', _run)


def _run(arguments: list[str]) -> int:
    parser = _parser()
    refuse_run_word(parser, 'capture', arguments)
    options = parser.parse_args(arguments)
    wires = _wires(options)
    with ExitStack() as stack:
        outlets = {name: stack.enter_context(Pty(_link(options.link, name, len(wires))))
                   for name in wires}
        for outlet in outlets.values():
            outlet.let_go()
        _play_file(options, wires, outlets)
    return DONE


def _play_file(options: argparse.Namespace, wires: dict[str, Wire],
               outlets: dict[str, Pty]) -> None:
    for name, outlet in outlets.items():
        rate = f'{wires[name].baud} baud' if wires[name].baud else 'at the recorded rate'
        print(f'{outlet.link or outlet.path} is {printable(name)}, {rate}')
    print('waiting for a reader', flush=True)
    _wait_for_readers(outlets.values())
    print('playing', flush=True)
    while True:
        with _open(options) as file:
            count, size, late_s = _play(_chunks(file, options.side), outlets, options.speed)
        print(f'played {count} chunks, {size} bytes, at most {1e3 * late_s:.1f} ms late',
              flush=True)
        print_problems('dxl_replay', file.problems())
        if not options.loop:
            break
        time.sleep(LOOP_PAUSE_S)
    time.sleep(LAST_QUESTION_S)
    while options.stay:
        time.sleep(POLL_S)


def _open(options: argparse.Namespace) -> closing[File]:
    return closing(open_file(options.capture, options.baud, options.adapter, tool='dxl_replay'))


def _chunks(file: File, side: str | None) -> Iterator[Chunk]:
    """Return what is to be played: both sides as they were on the wire, or one of them."""
    if isinstance(file, RawFile):
        file.read_size = RAW_CHUNK_BYTES
    return (chunk for chunk in file.chunks()
            if chunk is not None and chunk.data and side in (None, chunk.side))


def _wires(options: argparse.Namespace) -> dict[str, Wire]:
    """Return the buses to play, by name; looks through the whole capture for them."""
    if not stat.S_ISREG(os.stat(options.capture).st_mode):
        raise UsageError(f'{options.capture}: not a file, and a capture is read more than once; '
                         'give a file')
    with _open(options) as source:
        chunks = _chunks(source, options.side)
        is_empty = next(chunks, None) is None
        source.learn_buses(chunks)
        wires = {name: source.wire(name) for name in source.wires}
    if is_empty:
        what = 'no bytes' if options.side is None else f'no bytes of --side {options.side}'
        raise UsageError(f'{options.capture}: it holds {what}; give another capture')
    if options.bus is not None:
        if options.bus not in wires:
            raise UsageError(f'--bus {options.bus}: not in this capture; there are: '
                             f'{", ".join(wires)}')
        return {options.bus: wires[options.bus]}
    return wires


def _link(link: str | None, bus: str, count: int) -> str | None:
    """Return the link of a bus: the given one, plus the name of the bus if there are several."""
    return link if link is None or count == 1 else f'{link}_{quote(bus, "")}'


def _parser() -> Parser:
    parser = Parser(
        'dxl_replay',
        description='Plays a capture (or a file of raw bytes) into a pty, with the timing that it '
                    'had on the bus.',
        epilog="""examples:
  dxl_replay bus.txt --link /tmp/bus
  dxl_dump /tmp/bus                                in another terminal, or
  ros2 run mecarover_serial dxl_monitor --ros-args -p ports:=/tmp/bus

  dxl_replay bus.txt --link /tmp/bus --loop        again and again, until Ctrl-C
  dxl_replay bus.txt --speed 0 --link /tmp/bus     as fast as the reader takes it""")
    add = parser.add_argument
    add('capture', metavar='CAPTURE', help='a file written by dxl_dump -w or by dxl_monitor')
    add('--link', metavar='PATH', help='make this symlink to the pty; with several buses '
        'PATH_BUS for each')
    add('--speed', type=number(float, 0), default=1.0, metavar='X',
        help='times the original speed, 0: as fast as the reader takes it (default 1)')
    add('--loop', action='store_true', help='start again at the end')
    add('--stay', action='store_true', help='keep the pty open after the end, until Ctrl-C')
    add('--bus', metavar='NAME', help='play this bus only')
    add('--side', choices=(OUT, IN), help='play only what the master sent (out) or received (in), '
        'if the capture knows the direction')
    add('--adapter', metavar='BUS.DEVICE', help='which adapter, if a pcap file holds several')
    add('-b', '--baud', type=BAUD, help='baud rate of raw bytes (default 2000000)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
