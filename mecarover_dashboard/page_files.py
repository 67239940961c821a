# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The files of the page, read once: no path leads outside of them."""
from __future__ import annotations

from importlib import resources
import json
from typing import TYPE_CHECKING

from aiohttp import web

from msg_defs.status_keys import FIGURES
from servobus.doctor import RULES

if TYPE_CHECKING:
    from aiohttp.typedefs import Handler

_TYPES = {'html': 'text/html', 'css': 'text/css', 'js': 'text/javascript',
          'svg': 'image/svg+xml'}


def page_files() -> dict[str, bytes]:
    folder = resources.files('mecarover_dashboard') / 'static'
    figures = json.dumps([one._asdict() for one in FIGURES])
    rules = json.dumps({rule.name: rule.advice for rule in RULES})
    return {'figures.js': f'export const FIGURES = {figures};\n'.encode(),
            'rules.js': f'export const RULES = {rules};\n'.encode(),
            **{file.name: file.read_bytes()
               for file in sorted(folder.iterdir(), key=lambda file: file.name)
               if file.name.rpartition('.')[2] in _TYPES}}


def serve_file(name: str, data: bytes) -> Handler:
    content_type = _TYPES[name.rpartition('.')[2]]

    async def serve(request: web.Request) -> web.StreamResponse:
        response = web.Response(body=data, content_type=content_type, charset='utf-8')
        response.headers['Cache-Control'] = 'no-cache'
        response.enable_compression()
        return response
    return serve
