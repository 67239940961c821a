# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Fake MCU: the receiver of receiver.py on a pty, to try the bridge without a rover.

A pty has no character times: what was written at once arrives in one read, and is put on the
simulated line with a gap before it. Two frames in one read mean that this process was late, not
that the gap was missing; they are counted (`merged`) and spread over the time since the last read.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
import json
import sys
import time

from mecarover_fakes.fake_options import add_options
from mecarover_fakes.fake_options import Away
from mecarover_fakes.fake_options import hold_signals
from mecarover_fakes.fake_options import one_signal
from mecarover_fakes.fake_options import parse_options
from mecarover_fakes.guarded_receiver import GuardedReceiver
from mecarover_fakes.receiver import BadCable
from mecarover_fakes.receiver import Receiver
from mecarover_fakes.receiver import SetPoint
from mecarover_fakes.virtual_uart import VirtualUart
from msg_defs.crc import Checksum
from msg_defs.crc import crc32_mpeg2
from msg_defs.crc import CRC_BY_INPUT
from msg_defs.vel2d import FRAME_SIZE
from servobus.port.pty import outlive
from servobus.tools.cli import run_tool
from servobus.tools.command_line import baud_rate
from servobus.tools.command_line import number
from servobus.tools.command_line import Parser

_READ_SIZE = 146 * FRAME_SIZE      # whole frames; a pty gives at most 4095 bytes
_GAP_CHARACTERS = 2
_STEP_S = 0.01


class FakeMcu:
    """A receiver on a pty, driven by `pump`."""

    def __init__(self, link: str | None = None, *, baud: int = 115200,
                 crc: Checksum = crc32_mpeg2, cable: BadCable | None = None,
                 talks: bool = False, watchdog: bool = False,
                 clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.link = link
        self.merged = 0                              # reads that held more than one frame
        self._clock = clock
        self._cable = cable or BadCable()
        self._talks = talks                          # says what it refuses, or how it is
        self._uart = VirtualUart(link)
        self._read = clock()                         # up to when the line has been read
        self.receiver = (GuardedReceiver if watchdog else Receiver)(
            self._read, baud=baud, crc=crc)

    @property
    def path(self) -> str:
        """What the host opens: the link if there is one."""
        return self.link or self._uart.path

    def pump(self, timeout_s: float) -> list[SetPoint]:
        """Wait for bytes, at most so long, and return the set-points taken until now."""
        self._uart.wait(timeout_s)
        self._receive(self._uart.read(_READ_SIZE))
        self._read = self._clock()
        taken = self.receiver.advance(self._read)
        text = self.receiver.text_to_host(self._read)
        if self._talks and text:
            self.send_text(text.encode())
        return taken

    def send_text(self, text: bytes) -> None:
        """Send something to the host, as firmware does that logs to the same UART."""
        self._uart.write(text)

    def vanish(self) -> None:
        """Be unplugged."""
        self._uart.plug(plugged_in=False)

    def come_back(self) -> None:
        """Be plugged in again, under the same link."""
        self._uart.plug(plugged_in=True)

    def close(self) -> None:
        self.vanish()

    def totals(self) -> dict[str, int]:
        return asdict(self.receiver.totals) | {'merged': self.merged,
                                               'damaged': self._cable.damaged}

    def _receive(self, chunk: bytes) -> None:
        now = self._clock()
        frames = [chunk[at:at + FRAME_SIZE] for at in range(0, len(chunk), FRAME_SIZE)]
        self.merged += len(frames) > 1
        for index, frame in enumerate(frames, start=1):
            self._put(frame, self._read + (now - self._read) * index // len(frames))

    def _put(self, frame: bytes, stamp: int) -> None:
        receiver = self.receiver
        gap = _GAP_CHARACTERS * receiver.character
        receiver.feed(self._cable.carry(frame), max(stamp, receiver.line_free + gap))
        if self._cable.overruns():
            receiver.overrun()


def main() -> int:
    return run_tool('fake_mcu', _main)


def _main(arguments: list[str]) -> int:
    options = parse_options(_parser(), arguments)
    cable = BadCable(drop=options.drop, flip=options.flip, deaf_after=options.deaf_after,
                     seed=options.seed)
    hold_signals()
    mcu = FakeMcu(options.link, baud=options.baud, crc=CRC_BY_INPUT[options.crc_input],
                  cable=cable, talks=not options.silent, watchdog=options.watchdog)
    printer = _Printer(mcu, as_json=options.json, frames=options.frames)
    try:
        with one_signal():
            printer.begin(options.baud, options.crc_input)
            _serve(mcu, printer, options.seconds, options.vanish)
    except KeyboardInterrupt:
        if options.outlive:
            outlive(mcu.path, lambda seconds: printer.show(mcu.pump(seconds)))
        raise
    finally:
        printer.end()
        mcu.close()
    return 0


def _serve(mcu: FakeMcu, printer: _Printer, seconds: float | None,
           away: Away | None) -> None:
    """Pump until the time is over, gone in between if that was asked for."""
    begin = time.monotonic()
    while seconds is None or time.monotonic() - begin < seconds:
        printer.show(mcu.pump(_STEP_S))
        if away is not None:
            is_away = away.covers(time.monotonic() - begin)
            (mcu.vanish if is_away else mcu.come_back)()


class _Printer:
    """Lines for people, or JSON for programs: changes of the set-point, totals at the end."""

    def __init__(self, mcu: FakeMcu, *, as_json: bool, frames: bool) -> None:
        self._mcu = mcu
        self._as_json = as_json
        self._frames = frames
        self._begin = mcu.receiver.wheels.stamp
        self._last: tuple[float, ...] | None = None

    def begin(self, baud: int, crc_input: str) -> None:
        self._print(f'fake_mcu: {self._mcu.path}, {baud} baud, CRC over {crc_input}',
                    path=self._mcu.path, baud=baud, crc_input=crc_input)

    def show(self, set_points: list[SetPoint]) -> None:
        for set_point in set_points:
            if set_point[1:] != self._last:
                self._last = set_point[1:]
                what = 'stop' if set_point.is_stop else 'drive'
                stamp, x, y, omega = set_point
                self._print(f'  x {x:8.1f} mm/s  y {y:8.1f} mm/s  omega {omega:7.3f} rad/s'
                            f'  {what}', stamp, x=x, y=y, omega=omega, what=what)
        arrivals = self._mcu.receiver.arrivals
        while self._frames and arrivals:
            stamp, size, velocity = arrivals.popleft()
            self._print(f'  {size} bytes  {tuple(velocity) if velocity else "damaged"}', stamp,
                        bytes=size, frame=velocity)

    def end(self) -> None:
        totals = self._mcu.totals()
        text = ', '.join(f'{name} {count}' for name, count in totals.items())
        self._print(f'totals: {text}', totals=totals)

    def _print(self, text: str, stamp: int | None = None, **record: object) -> None:
        if stamp is not None:
            record = {'stamp': stamp / 1e9} | record
            text = f'{(stamp - self._begin) / 1e9:9.3f} s{text}'
        print(json.dumps(record) if self._as_json else text, flush=True)


def _parser() -> Parser:
    parser = Parser(
        'fake_mcu', 'Simulates the MCU of the rover on a pty and shows the '
        'set-points that it takes.')
    add_options(parser)
    add, count = parser.add_argument, number(int, 0)
    add('-b', '--baud', type=number(baud_rate, 1), default=115200,
        help='baud rate of the simulated line (default %(default)s)')
    add('--crc-input', choices=sorted(CRC_BY_INPUT), default='bytes',
        help='how the CRC unit is fed (default %(default)s)')
    add('--json', action='store_true', help='JSON lines; stamps are monotonic seconds')
    add('--frames', action='store_true', help='print a line for every frame too')
    add('--drop', type=count, default=0, metavar='N', help='drop a byte in each Nth frame')
    add('--flip', type=count, default=0, metavar='N', help='flip a bit in each Nth frame')
    add('--deaf-after', type=count, default=0, metavar='N', help='lose bytes (overrun) after N '
        'frames')
    add('--watchdog', action='store_true', help='an MCU with the receiver of firmware/: it stops '
        'after 0.3 s without a good frame, and reports once a second')
    add('--silent', action='store_true', help='send no text to the host')
    return parser


if __name__ == '__main__':
    sys.exit(main())
