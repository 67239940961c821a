# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The web server: the files of static/ and one stream of changes (server-sent events).

Runs with aiohttp 3.9 and newer; all state belongs to its one thread.
"""
from __future__ import annotations

import asyncio
from contextlib import suppress
import hashlib
import ipaddress
import logging
import secrets
import socket
import threading
import time
from typing import Any
from typing import Protocol
from typing import TYPE_CHECKING

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from mecarover_dashboard.cdr import Message
from mecarover_dashboard.client import Client
from mecarover_dashboard.client import json_text
from mecarover_dashboard.connection_limit import ConnectionLimit
from mecarover_dashboard.connection_limit import HEAD_S
from mecarover_dashboard.history_recorder import History
from mecarover_dashboard.history_requests import HistoryRequests
from mecarover_dashboard.inbox import Inbox
from mecarover_dashboard.page_files import page_files
from mecarover_dashboard.page_files import serve_file
from mecarover_dashboard.request_guard import add_headers
from mecarover_dashboard.request_guard import guard
from mecarover_dashboard.rows import finite
from mecarover_dashboard.signal_requests import ReportedSignals
from mecarover_dashboard.signal_requests import SignalRequests
from mecarover_dashboard.signal_requests import SignalSource
from mecarover_dashboard.state import OVERVIEW
from mecarover_dashboard.state import State

if TYPE_CHECKING:
    from aiohttp.typedefs import Handler

PUSH_S = 0.2                    # changes are collected for so long
HASTE_S = 0.05                  # ... once a change of level may be among them
BEAT_S = 1.0                    # at least one event in this time: the page can tell that we live
SEND_S = 15.0                   # a client that takes nothing for so long is given up
MOST_CLIENTS = 50


class _ClientErrors(logging.Filter):
    """Keeps out of the log what clients do wrong, or leave half done: anybody could fill it."""

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        return not isinstance(
            error, ConnectionError | HttpProcessingError | web.RequestPayloadError)


class RecordingPlayer(Protocol):
    """A recording that plays; all of it may be called from any thread."""

    events: list[tuple[float, int, str]]        # what was found in it: s, level, text

    def control(self, at_s: float | None, is_on: bool | None) -> None: ...

    def state(self) -> dict[str, Any]: ...


class Server:
    """
    Serves a State on a listening socket, in a thread of its own.

    | attributes | who writes them |
    |---|---|
    | _publishers, _recording | store_publishers(), stop(): from any thread |
    | _loop, _ended, _haste | the server's thread, when it begins |
    | _pushed, _texts, _watched, _scraped | the server's thread |
    | all others | set once |
    """

    def __init__(self, listener: socket.socket, facts: dict[str, Any], is_open: bool,
                 recording: History | None = None, name: str = '',
                 player: RecordingPlayer | None = None,
                 signals: SignalSource | None = None) -> None:
        self._listener = listener
        self._guard = guard(facts['address'], name, is_open)
        # boot: versions of the state count from then.
        self._facts = facts | {'boot': secrets.token_hex(4), 'open': is_open}
        self._inbox = Inbox()
        self._state = State()
        self._recording = recording
        self._player = player
        self._reported = ReportedSignals()
        self._is_sampled = signals is None
        self._signals = SignalRequests(signals or self._reported)
        self._started_s = time.monotonic()
        self._publishers: dict[str, int] = {}
        self._texts: dict[int, str] = {}        # changes since a version, of the version now
        self._scraped: tuple[str, float, bytes, str] | None = None  # what /metrics said last
        self._watched: dict[int, str] = {}      # by client
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name='dashboard', daemon=True)
        self._ready = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event
        self._haste: asyncio.Event

    @property
    def address(self) -> str:
        """The page, for a browser of this machine."""
        address = str(self._facts['address'])
        return 'http://' + address.replace('0.0.0.0', '127.0.0.1').replace('[::]', '[::1]')

    # From any thread.

    def start(self, namespace: str = '') -> None:
        """Begin to serve the robots below a namespace, '' for all."""
        self._state.namespace = namespace
        self._thread.start()
        self._ready.wait(10.0)

    def stop(self) -> None:
        """Stop serving; may be called again."""
        if self._loop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end)
            self._thread.join(2.0)
        if self._recording is not None:
            self._recording.close()
            self._recording = None

    def queue_message(self, topic: str, message: Message) -> None:
        """Take a DiagnosticArray, serialised or not; it is looked at with the next push."""
        self._inbox.put(topic, message, time.monotonic())
        # The nodes publish changes of level there; what is handed over has them in it.
        if (topic == OVERVIEW or not isinstance(message, bytes)) and self._loop is not None:
            with suppress(RuntimeError):                    # it has just ended
                self._loop.call_soon_threadsafe(self._haste.set)

    def restart(self) -> None:
        """Forget all that was taken: what comes next is of another time."""
        self._inbox.restart()

    def store_publishers(self, counts: dict[str, int]) -> None:
        """Take how many publishers each topic has."""
        self._publishers = counts

    # In the thread.

    async def _serve(self) -> None:
        self._ended, self._haste, self._pushed = (asyncio.Event() for _ in range(3))
        self._loop = asyncio.get_running_loop()
        logger = logging.getLogger('dxl_dashboard')
        logger.addFilter(_ClientErrors())
        runner = web.AppRunner(self._app(), access_log=None, handle_signals=False,
                               shutdown_timeout=0.5, logger=logger,
                               keepalive_timeout=HEAD_S)       # for each later request too
        await runner.setup()
        handlers = runner.server
        assert handlers is not None
        waiting: set[ConnectionLimit] = set()
        listening = await self._loop.create_server(
            lambda: ConnectionLimit(handlers, waiting), sock=self._listener)
        self._ready.set()
        try:
            while not self._ended.is_set():
                self._push()
                await _wait(self._haste, PUSH_S)
                if self._haste.is_set():
                    self._haste.clear()
                    await _wait(self._ended, HASTE_S)
        finally:
            listening.close()
            self._pushed.set()
            await asyncio.wait_for(runner.cleanup(), 1.5)

    def _end(self) -> None:
        self._ended.set()
        self._haste.set()

    def _app(self) -> web.Application:
        files = page_files()
        page = hashlib.sha256(b''.join(files.values())).hexdigest()[:12]
        self._facts['page'] = page              # a kiosk reloads itself after an update
        app = web.Application(middlewares=[self._guard])
        app.on_response_prepare.append(add_headers)
        history = HistoryRequests(None if self._recording is None else self._recording.path)
        handlers: dict[str, Handler] = {
            '/events': self._events, '/metrics': self._metrics, '/player': self._play,
            '/signals': self._signals.answer, '/history/values': history.values,
            '/history/events': history.events,
            **{f'/{name}': serve_file(name, data) for name, data in files.items()}}
        for path, handler in (('/', handlers['/index.html']), *handlers.items()):
            app.router.add_get(path, handler)
        return app

    def _push(self) -> None:
        """Take in what has come, and let the clients' tasks send what changed."""
        state, now_s = self._state, time.monotonic()
        before = state.version
        is_restarted, messages = self._inbox.take()
        if is_restarted:
            before, state = -1, State(state.namespace)
            self._state, self._facts['boot'] = state, secrets.token_hex(4)
        for message in messages:
            state.store_message(*message)
        state.expire(now_s)
        self._signals.forget(now_s)
        if self._is_sampled:
            self._reported.sample_state(state)
        if self._recording is not None:
            self._recording.sample_state(state, now_s, time.time())
        if state.version != before:
            self._texts.clear()
            state.keep_tables(set(self._watched.values()))
            self._pushed.set()
            self._pushed = asyncio.Event()

    async def _events(self, request: web.Request) -> web.StreamResponse:
        if len(self._watched) >= MOST_CLIENTS:
            reason = f'{MOST_CLIENTS} pages are open already. Close one of them.'
            return web.Response(status=503, text=f'{reason}\n', headers={'X-Reason': reason})
        if request.method == 'HEAD':
            return web.Response(content_type='text/event-stream')
        client = Client(request)
        self._watched[id(client)] = client.watch
        try:
            # When the page has gone, it comes back by itself.
            with suppress(ConnectionError, asyncio.TimeoutError):
                await self._stream(client)
        finally:
            del self._watched[id(client)]
        return client.response

    async def _play(self, request: web.Request) -> web.StreamResponse:
        """Answer what was found in a recording; a page of this machine may move it, too."""
        if self._player is None:
            return web.Response(status=404, text='No recording is played.\n')
        query = request.query
        if query:
            if request.headers.get('Sec-Fetch-Site') != 'same-origin' \
                    or not ipaddress.ip_address(request.remote or '::').is_loopback:
                return web.Response(status=403, text='Only a page of this machine may do that.\n')
            at_s = finite(query.get('at', ''))
            self._player.control(None if at_s is None else max(0.0, at_s),
                                 query['on'] == '1' if 'on' in query else None)
        return web.json_response(self._player.events)

    async def _metrics(self, request: web.Request) -> web.StreamResponse:
        """Answer a scrape; many scrapers get the same text for a second."""
        try:
            from mecarover_dashboard.metrics import exposition
        except ImportError:
            return web.Response(status=501, text='prometheus_client is not installed; sudo apt '
                                'install python3-prometheus-client\n')
        accept, now_s = request.headers.get('Accept', ''), time.monotonic()
        if self._scraped is None or self._scraped[0] != accept or now_s - self._scraped[1] > 1.0:
            self._scraped = accept, now_s, *exposition(self._state, accept)
        response = web.Response(body=self._scraped[2])
        response.headers['Content-Type'] = self._scraped[3]
        response.enable_compression()
        return response

    async def _stream(self, client: Client) -> None:
        await client.begin()
        boot, since = '', 0
        while not self._ended.is_set():
            if boot != self._facts['boot']:
                boot = self._facts['boot']
                since = client.since(boot)
            pushed = self._pushed
            text = self._text(since) + client.own_text(self._state)
            since = self._state.version
            await asyncio.wait_for(client.send(f'{boot}.{since}', text), SEND_S)
            await _wait(pushed, BEAT_S)

    def _text(self, since: int) -> str:
        """Return the beginning of an event: what all clients at this version need to know."""
        text = self._texts.get(since)
        if text is None:
            changes = self._state.changes(since)
            if changes or not since:
                changes['parts'] = [part.shown() for part in self._state.parts()]
            if not since:
                changes['facts'] = self._facts
            if len(self._texts) >= MOST_CLIENTS:        # a client may claim any version
                self._texts.clear()
            self._texts[since] = text = json_text(changes)[1:-1]
        now_s = time.monotonic()
        beat = {'now': round(now_s, 2), 'wall': round(time.time(), 2),
                'up': round(now_s - self._started_s, 1), 'topics': self._state.topics(now_s),
                'publishers': self._publishers, 'malformed': self._state.malformed,
                'refused': self._state.refused,
                'history': self._recording.problem if self._recording else None,
                'player': self._player.state() if self._player else None}
        return f'{json_text(beat)[:-1]}{"," if text else ""}{text}'


async def _wait(event: asyncio.Event, timeout_s: float) -> None:
    with suppress(asyncio.TimeoutError):
        await asyncio.wait_for(event.wait(), timeout_s)
