# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The listener on `tap:NAME` or `tap:NAME/PORT`: a program that dxl_tap started."""

from __future__ import annotations

import os
import time

from servobus.port.port_error import PortError
from servobus.port.port_error import Reason
from servobus.sources import tap_sender as sent
from servobus.sources.listener import Listener
from servobus.sources.reader import SILENT_WAIT_S
from servobus.sources.source_name import TAP
from servobus.sources.tap_reader import HOLD_S
from servobus.sources.tap_reader import TapReader
from servobus.sources.tap_reader import TapRecord
from servobus.sources.tap_reader import why_no_name

OTHERS_NAMED_MAX = 3        # ports that are not heard, at most


class TapListener(Listener):
    """
    A listener on a tapped program; its stamps are the program's own.

    One port is heard: the one that is named, or the first that the program opens. `others` are
    the ports that the program opened as well.
    """

    others: frozenset[str] = frozenset()

    def problems(self) -> list[str]:
        if not self.others:
            return []
        named = sorted(self.others)[:OTHERS_NAMED_MAX]
        others = ', '.join(named) + (' and others' if len(self.others) > OTHERS_NAMED_MAX else '')
        return [f'the program also opened {others}, which was not heard; name the port to listen '
                f'to it: tap:NAME/{os.path.basename(named[0])}']

    def _listen_once(self) -> None:
        name, _, self._wanted = self.port.removeprefix(TAP).partition('/')
        problem = why_no_name(name)
        if problem:
            raise PortError(self.port, Reason('other', problem, 'write tap:NAME or tap:NAME/PORT'))
        self._heard_port = ''
        with self._reader(name) as reader:
            self._opened(f'listening; start the program with dxl_tap {name} -- COMMAND')
            last = time.monotonic_ns()
            while not self._stopping:
                records = reader.wait(SILENT_WAIT_S)
                for record in records:
                    self._accept_tap_record(record)
                now = time.monotonic_ns()
                if records:
                    last = records[-1].stamp
                elif now - last > self.idle_s * 1e9 + HOLD_S * 1e9:
                    self._report_idle(now - int(HOLD_S * 1e9))

    def _reader(self, name: str) -> TapReader:
        try:
            return TapReader(name, self._pipe.fd)
        except OSError as error:
            reason, _, remedy = (error.strerror or str(error)).partition('; ')
            raise PortError(self.port, Reason(
                'other', f'{error.filename}: {reason}',
                remedy or 'set XDG_RUNTIME_DIR to a folder of yours')) from error

    def _accept_tap_record(self, record: TapRecord) -> None:
        if record.kind == sent.OPENED:
            if self._is_wanted(record.port):
                self._heard_port = record.port
                self._set_open(f'listening to {record.port}')
            elif len(self.others) <= OTHERS_NAMED_MAX:
                self.others |= {record.port}
        if record.port in ('', self._heard_port) and (record.side or record.change):
            self._deliver(record.chunk(self._bus))

    def _is_wanted(self, port: str) -> bool:
        if self._wanted:
            return self._wanted in (port, os.path.basename(port))
        return not self._heard_port or port == self._heard_port
