# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The history over HTTP: /history/values and /history/events, as JSON or CSV, of any time span.

Query: `from`, `to` (as in written_time.py; default the last hour), `zone` of these (+HH:MM, then
the name of a zone, which knows summer time; default that of this machine), `of` (names of
statuses, several; none = all), `robot`, `format` = json | csv, `points` (values in JSON: at most
about so many of each source).
"""
from __future__ import annotations

import asyncio
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import closing
from contextlib import suppress
import csv
from datetime import datetime
from datetime import timezone
from datetime import tzinfo
import io
from itertools import islice
import math
from pathlib import Path
import re
import sqlite3
import time
from typing import Any
from zoneinfo import ZoneInfo

from aiohttp import web

from mecarover_dashboard.client import json_text
from mecarover_dashboard.history import HistoryReader
from mecarover_dashboard.history import Question
from mecarover_dashboard.history import VALUES
from mecarover_dashboard.history import widened
from mecarover_dashboard.history import Window
from mecarover_dashboard.history import WINDOW_S
from mecarover_dashboard.rows import natural
from mecarover_dashboard.written_time import EXAMPLES
from mecarover_dashboard.written_time import unix_time
from msg_defs.diagnostics import Level
from msg_defs.diagnostics import worst

MOST_AT_ONCE = 4                # questions; a day of 253 devices takes seconds of a core
_MOST_POINTS = 20_000           # all sources together: six values of each take 20 MB
_POINTS, _POINTS_MAX = 600, 10_000      # each source
_MOST_EVENTS = 1000             # on the page; a CSV has them all
_ALL_EVENTS = 10_000_000
_ROWS = 2000                    # rows of a CSV written at a time
_WRONG_VALUE = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError)
_FORMULA = re.compile(r'(^|;)(?=\s*[=+@-])')    # in many countries a semicolon ends a cell
_CSV_VALUES = tuple(dict.fromkeys(name for names in VALUES.values() for name in names))


class HistoryRequests:
    """Answers questions about a history file."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._free = asyncio.Semaphore(MOST_AT_ONCE)

    async def values(self, request: web.Request) -> web.StreamResponse:
        """Answer /history/values."""
        return await self._answer(request, _values_json, _values_csv)

    async def events(self, request: web.Request) -> web.StreamResponse:
        """Answer /history/events."""
        return await self._answer(request, _events_json, _events_csv)

    async def _answer(self, request: web.Request,
                      as_json: Callable[[HistoryReader, Question], Any],
                      as_csv: Callable[[HistoryReader, Question], Iterator[list[str]]],
                      ) -> web.StreamResponse:
        if self._path is None:
            return web.Response(status=404, text='No history is recorded: the server was started '
                                'with --history none.\n')
        try:
            question = _question(request)
        except ValueError as error:
            return web.Response(status=400, text=f'{error}\n')
        try:
            async with self._free:
                with closing(await asyncio.to_thread(HistoryReader, self._path)) as reader:
                    if request.query.get('format') == 'csv':
                        return await _stream(request, as_csv(reader, question))
                    answer = json_text(await asyncio.to_thread(as_json, reader, question))
        except sqlite3.Error as error:
            problem = str(error)
        except _WRONG_VALUE as error:
            problem = (f'a value is not of its type ({error!r}); move the file away and start the '
                       'dashboard again')
        else:
            response = web.Response(text=answer, content_type='application/json')
            response.enable_compression()
            return response
        return web.Response(status=503, text=f'{self._path.name}: {problem}\n')


async def _stream(request: web.Request, lines: Iterator[list[str]]) -> web.StreamResponse:
    """
    Send a CSV piece by piece; reading happens outside of the loop.

    What cannot be read later than in the first piece breaks the download off: so it fails there.
    """
    def piece() -> list[list[str]]:
        return list(islice(lines, _ROWS))
    some = await asyncio.to_thread(piece)
    # The page names the file: it knows the robot, and which devices it shows.
    response = web.StreamResponse(headers={
        'Content-Type': 'text/csv; charset=utf-8', 'Content-Disposition': 'attachment'})
    await response.prepare(request)
    while some and request.method != 'HEAD':
        text = io.StringIO()
        csv.writer(text).writerows(some)
        await response.write(text.getvalue().encode())
        try:
            some = await asyncio.to_thread(piece)
        except (sqlite3.Error, *_WRONG_VALUE) as error:
            raise ConnectionError(f'{request.path}: {error!r}') from error
    return response


def _question(request: web.Request) -> Question:
    """Read the query; raise ValueError with what is wrong and what is wanted."""
    query = request.query
    now_s, zone = time.time(), _zone(query.get('zone'))
    to_s = _time(query.get('to', 'now'), now_s, zone, 'to')
    from_s = _time(query['from'], now_s, zone, 'from') if 'from' in query else to_s - 3600
    if from_s > to_s:
        raise ValueError('from: is later than to; swap them')
    if query.get('format', 'json') not in ('json', 'csv'):
        raise ValueError('format: not known; give json or csv')
    points = natural(query.get('points', str(_POINTS)))
    if not 1 <= points <= _POINTS_MAX:
        raise ValueError(f'points: not a number from 1 to {_POINTS_MAX}; correct it')
    return Question(from_s, to_s, tuple(query.getall('of', ())), query.get('robot'), points)


def _time(text: str, now_s: float, zone: tzinfo | None, name: str) -> float:
    at_s = unix_time(text, now_s, zone)
    if at_s is None:
        raise ValueError(f'{name}: {text[:40]!r} is not a time; write {EXAMPLES}')
    return at_s


def _zone(text: str | None) -> tzinfo | None:
    if text is None:
        return None
    offset, _, name = text.strip().partition(' ')
    with suppress(LookupError, ValueError, OSError):        # not all machines know each name
        return ZoneInfo(name)
    try:
        return datetime.strptime(f'+{offset}' if offset[:1].isdigit() else offset, '%z').tzinfo
    except ValueError:
        raise ValueError(f'zone: {text[:40]!r} is not an offset; write +01:00') from None


def _values_json(reader: HistoryReader, question: Question) -> dict[str, Any]:
    """Return by source its level and its values: [[s, low, high], ...], thinned out."""
    span_s = question.to_s - question.from_s
    points = max(1, min(question.points, _MOST_POINTS // max(1, reader.count(question))))
    step_s = max(1, math.ceil(span_s / points / WINDOW_S)) * WINDOW_S
    sources: dict[str, Any] = {}
    for window in reader.windows(question):
        source = sources.setdefault(window.source.name, {
            'kind': window.source.kind, 'robot': window.source.robot, 'unit': window.source.unit,
            'position_unit': window.source.position_unit,
            'levels': [], 'values': {name: [] for name in VALUES[window.source.kind]}})
        _merge(source, window, window.at // step_s * step_s)
    return {'from': question.from_s, 'to': question.to_s, 'step': step_s, 'sources': sources}


def _merge(source: dict[str, Any], window: Window, at: int) -> None:
    """Put a window into the points of its source; those of one step become one."""
    levels = source['levels']
    if levels and levels[-1][0] == at:
        levels[-1][1] = worst([levels[-1][1], window.level])
    else:
        levels.append([at, window.level])
    for points, ends in zip(source['values'].values(), window.ranges, strict=True):
        if ends is None:
            continue
        if points and points[-1][0] == at:
            points[-1][1:] = widened(points[-1][1:], ends)
        else:
            points.append([at, *ends])


def _values_csv(reader: HistoryReader, question: Question) -> Iterator[list[str]]:
    yield ['time', 'robot', 'name', 'level', 'load unit',
           *(f'{name} {end}' for name in _CSV_VALUES for end in ('min', 'max')), 'position unit']
    for window in reader.windows(question):
        ranges = dict(zip(VALUES[window.source.kind], window.ranges, strict=True))
        yield [_iso(window.at), _cell(window.source.robot), _cell(window.source.name),
               window.level.name, _cell(window.source.unit),
               *('' if end is None else f'{end:.3f}'      # as it is kept
                 for name in _CSV_VALUES for end in ranges.get(name) or (None, None)),
               _cell(window.source.position_unit)]


def _events_json(reader: HistoryReader, question: Question) -> dict[str, Any]:
    gaps = reader.gaps(question.from_s, min(question.to_s, time.time()))
    return {'from': question.from_s, 'to': question.to_s, 'most': _MOST_EVENTS, 'gaps': gaps,
            'events': [[event.at, event.source.name, event.source.robot, event.kind, event.level,
                        event.text] for event in reader.events(question, _MOST_EVENTS)]}


def _events_csv(reader: HistoryReader, question: Question) -> Iterator[list[str]]:
    yield ['time', 'robot', 'name', 'kind', 'level', 'text']
    for event in reader.events(question, _ALL_EVENTS):
        yield [_iso(event.at), _cell(event.source.robot), _cell(event.source.name),
               _cell(event.kind), Level(event.level).name, _cell(event.text)]


def _iso(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, timezone.utc).isoformat(timespec='seconds')


def _cell(text: str) -> str:
    """Return text of others so that no spreadsheet takes it for a formula, or a part of it."""
    return _FORMULA.sub(r"\1'", text)
