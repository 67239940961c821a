# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""One page that listens: its stream of server-sent events, and what it knows already."""
from __future__ import annotations

import json
from typing import Any
import zlib

from aiohttp import web

from mecarover_dashboard.rows import natural
from mecarover_dashboard.rows import RegisterTable
from mecarover_dashboard.state import State

_Shown = tuple[str, ...]        # temperature, voltage, load, unit, position, its unit, limits


class Client:
    """One stream of events, compressed where the browser takes that."""

    def __init__(self, request: web.Request) -> None:
        self._request = request
        self.watch = request.query.get('watch', '')
        self.response = web.StreamResponse(headers={
            'Content-Type': 'text/event-stream', 'Cache-Control': 'no-store',
            'X-Accel-Buffering': 'no'})
        self._zip = None
        if 'gzip' in request.headers.get('Accept-Encoding', ''):
            self.response.headers['Content-Encoding'] = 'gzip'
            self._zip = zlib.compressobj(1, zlib.DEFLATED, 31)
        self._sent = RegisterTable([], [])              # the watched device's, as last sent
        self._wants_values = 'values' in request.query
        self._values: dict[str, _Shown] = {}       # as sent last
        self._latency_until = 0.0

    async def begin(self) -> None:
        await self.response.prepare(self._request)

    def since(self, boot: str) -> int:
        """Return the version that this page knows; 0 if that was before we were started."""
        of, _, version = self._request.query.get('since', '').partition('.')
        return natural(version) if of == boot else 0

    def own_text(self, state: State) -> str:
        """Return the end of an event: what changed of what only this page looks at."""
        parts = {'table': self._table(state), 'values': self._changed_values(state)}
        texts = (f',"{name}":{json_text(part)}' for name, part in parts.items() if part)
        return ''.join(texts) + '}'

    def _changed_values(self, state: State) -> dict[str, _Shown]:
        """Return what is shown of the devices where that changed."""
        if not self._wants_values:
            return {}
        now = {name: (one.temperature, one.voltage, one.load, one.unit, one.position,
                      one.position_unit, *one.limits)
               for name, one in state.values().items()}
        changed = {name: one for name, one in now.items() if self._values.get(name) != one}
        self._values = now
        return changed

    def _table(self, state: State) -> dict[str, Any]:
        """Return what changed of the device that this page shows."""
        table = state.table(self.watch) if self.watch else None
        if table is None:
            return {}
        changed: dict[str, Any] = {}
        if table.facts != self._sent.facts:
            changed['facts'] = table.facts
        old = self._sent.fields
        if [one.key for one in old] != [one.key for one in table.fields]:
            changed['fields'] = table.fields
        elif some := {at: new for at, new in enumerate(table.fields) if new != old[at]}:
            changed['some'] = some
        if points := state.latency(self.watch, self._latency_until):
            self._latency_until = points[-1][0] or 0.0
            changed['latency'] = points
        self._sent = table
        return changed | {'name': self.watch} if changed else {}

    async def send(self, version: str, text: str) -> None:
        event = f'id: {version}\ndata: {text}\n\n'
        data = event.encode(errors='replace')  # half a character pair may be in it
        if self._zip is not None:
            data = self._zip.compress(data) + self._zip.flush(zlib.Z_SYNC_FLUSH)
        await self.response.write(data)


def json_text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(',', ':'), allow_nan=False)
