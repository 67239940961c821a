# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A file of USB events as a source: the bytes of one serial adapter in it, with their sides."""

from __future__ import annotations

from collections.abc import Iterator
from io import BufferedReader
import shutil
from tempfile import TemporaryFile
from typing import cast

from msg_defs.event import BAUD
from msg_defs.event import Chunk
from servobus.errors import UsageError
from servobus.sources.capture import Moment
from servobus.sources.capture import STAMP_END
from servobus.sources.capture import Wire
from servobus.sources.source import File
from servobus.sources.usb_events import UsbEvents
from servobus.sources.usb_port import UsbPort
from servobus.sources.usb_survey import Found
from servobus.sources.usb_survey import Survey


class UsbFile(File):
    """
    The chunks of a file of USB events; baud overrides what the file says, None learns it.

    adapter: as `Place.words` spells it; needed where several adapters carried bytes. Raises
    UsageError, which lists them. The file is read twice: a pipe goes through a temporary file.
    """

    def __init__(self, name: str, file: BufferedReader, baud: int | None,
                 adapter: str | None) -> None:
        super().__init__(name, _seekable(file), baud)
        self._events = self._from_the_start()
        survey = Survey()
        for event in self._events:
            survey.add_event(event)
        found = _chosen(name, survey.ports(), adapter, self._events.problems)
        self._port = UsbPort(found.place, found.adapter, self._bus)
        self.wires[self._bus] = Wire(self._bus, baud or 0, port=name)

    def _from_the_start(self) -> UsbEvents:
        self._file.seek(0)
        return UsbEvents(self._file)

    def chunks(self) -> Iterator[Chunk | None]:
        """Yield what was heard, in the order of its stamps: those of the file, ns since 1970."""
        self._events = self._from_the_start()
        newest = 0
        for event in self._events:
            for chunk in self._port.decode_event(event):
                if chunk.stamp < STAMP_END:        # else the file is damaged
                    newest = max(newest, chunk.stamp)
                if not self.began.stamp:
                    self.began = Moment(newest, newest)
                if not (self._baud and chunk.change and chunk.change.what == BAUD):
                    yield chunk._replace(stamp=newest)

    def problems(self) -> list[str]:
        return [f'{self._name}: {problem}' for problem in self._events.problems]


def _seekable(file: BufferedReader) -> BufferedReader:
    if file.seekable():
        return file
    copy = TemporaryFile()                             # noqa: SIM115 - closed with the source
    shutil.copyfileobj(file, copy)
    copy.flush()
    return cast(BufferedReader, copy)


def _chosen(name: str, ports: list[Found], adapter: str | None, problems: list[str]) -> Found:
    """Return the port that was asked for, or the only one, or the only one with bytes."""
    named = [one for one in ports if one.place.words == adapter]
    used = named or [one for one in ports if one.size] or ports
    if len(used) == 1 and (named or adapter is None):
        return used[0]
    if not ports:
        reason = ''.join(f' ({problem})' for problem in problems[:1])
        raise UsageError(f'{name}: no serial adapter found in it{reason}; record the right USB '
                         'bus, and start before the port is used')
    known = '; '.join(one.words for one in used)
    problem = f'no adapter {adapter} in it' if adapter else 'several adapters in it'
    raise UsageError(f'{name}: {problem}: {known}; choose with --adapter '
                     f'{used[0].place.words}')
