# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Who gets an answer, and what each answer forbids the browser.

Only GET and HEAD are answered, and only to the names of this machine: a page elsewhere that points
a name of its own at us (DNS rebinding) learns nothing.
"""
from __future__ import annotations

import ipaddress
import socket
from typing import TYPE_CHECKING

from aiohttp import web

if TYPE_CHECKING:
    from aiohttp.typedefs import Handler
    from aiohttp.typedefs import Middleware

_OF_A_PAGE = ('/events', '/signals')    # not for pages elsewhere: each costs work as it goes on
_HEADERS = {
    'Content-Security-Policy':
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
        "object-src 'none'; require-trusted-types-for 'script'",
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Server': 'dxl_dashboard',
}


def is_ours(host: str, names: frozenset[str], any_address: bool) -> bool:
    """Tell whether a Host header names this machine; an address cannot be a borrowed name."""
    name = host.rpartition(':')[0] if not host.endswith(']') and ':' in host else host
    name = name.strip('[]').lower().rstrip('.')
    try:
        return ipaddress.ip_address(name).is_loopback or any_address
    except ValueError:
        return name in names


def guard(address: str, name: str, is_open: bool) -> Middleware:
    """Return what refuses requests; name: one more of this machine; is_open: to the network."""
    own = socket.gethostname().lower()
    host = own.partition('.')[0]
    names = frozenset({'localhost', name.lower().rstrip('.'), *(
        (own, host, f'{host}.local') if is_open else ())} - {''})

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        if request.method not in ('GET', 'HEAD'):
            raise web.HTTPMethodNotAllowed(request.method, ['GET', 'HEAD'])
        if not is_ours(request.headers.get('Host', ''), names, is_open):
            return web.Response(status=421, text=(
                f'The dashboard does not know this name of its machine. Use http://{address}/, or '
                'start the dashboard with --name and the name that you use.\n'))
        if request.path in _OF_A_PAGE and request.headers.get('Sec-Fetch-Site', 'none') not in (
                'same-origin', 'none'):
            return web.Response(status=403, text='Only a page of this dashboard may do that.\n')
        return await handler(request)
    return check


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
