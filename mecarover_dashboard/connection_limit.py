# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Limits connections: how many there are, in all and from one address, and how fast they ask.

aiohttp has no time-out for the head of the first request: 450 connections that said nothing, or
one byte now and then, kept everybody else out.
"""
from __future__ import annotations

import asyncio

from aiohttp import web

MOST_CONNECTIONS = 400          # pages, files and silent ones; a process may open 1024 files
MOST_OF_ADDRESS = 150           # for one machine: three browsers full of pages
HEAD_S = 10.0                   # for the head of a request
MOST_OF_HEAD = 16_384           # bytes; more is for aiohttp to refuse


class ConnectionLimit(asyncio.Protocol):
    """A connection until the head of its first request is there; then it gets its handler."""

    def __init__(self, handlers: web.Server, waiting: set[ConnectionLimit]) -> None:
        self._handlers = handlers
        self._waiting = waiting         # all doors that are open now
        self._head = b''
        self._transport: asyncio.Transport
        self._late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Let it in, unless it is one too many."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        taken = [_address(one) for one in (
            *(door._transport for door in self._waiting),
            *(one.transport for one in self._handlers.connections))]
        if len(taken) >= MOST_CONNECTIONS or taken.count(_address(transport)) >= MOST_OF_ADDRESS:
            transport.abort()
            return
        self._waiting.add(self)
        self._late = asyncio.get_running_loop().call_later(HEAD_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        """Hand over to aiohttp as soon as a head is whole."""
        self._head += data
        if b'\r\n\r\n' not in self._head and len(self._head) < MOST_OF_HEAD:
            return
        self._leave()
        handler = self._handlers()
        self._transport.set_protocol(handler)
        handler.connection_made(self._transport)
        try:
            handler.data_received(self._head)
        except ValueError:                      # aiohttp 3.9 (Ubuntu 24.04): a URL that is none
            self._transport.write(b'HTTP/1.1 400 Bad Request\r\n\r\n')
            self._transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        """Forget it."""
        self._leave()

    def _leave(self) -> None:
        self._waiting.discard(self)
        if self._late is not None:
            self._late.cancel()


def _address(transport: asyncio.BaseTransport | None) -> str:
    peer = transport.get_extra_info('peername') if transport is not None else None
    return str(peer[0]) if peer else ''
