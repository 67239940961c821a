# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The device table of the demo: what dxl/diagnostics says, as a person wants it in a terminal."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mecarover_demo.scenes import SceneResult
from msg_defs import status_keys as keys
from msg_defs.reports import Level

_PERIOD_S = 5.0
_COLUMNS = (            # title, width, the keys of which the first one that is there is shown
    ('model', 19, (keys.MODEL,)),
    ('state', 13, (keys.STATE,)),
    ('answers', 8, (keys.ANSWERS,)),
    ('missed', 7, (keys.MISSED_ANSWERS,)),
    ('position (rad)', 15, ('Present Position (rad)',)),
    ('voltage (V)', 12, ('Present Input Voltage (V)', 'Present Voltage (V)')),
)
_EXPECTED = 20


class DeviceTable:
    """Shows the table every few seconds and each change of a device's state at once."""

    def __init__(self, node: str = 'dxl_monitor') -> None:
        self._prefix = f'{node}: '
        self._states: dict[str, list[str]] = {}     # every state a device was seen in, in order
        self._shown_s = 0.0

    def devices(self, statuses: Mapping[str, Any]) -> dict[str, Any]:
        """Return the statuses of devices by name, in the order of their IDs."""
        names = sorted(name.removeprefix(self._prefix) for name in statuses)
        return {name: statuses[self._prefix + name] for name in names if name[:3].isdigit()}

    def show(self, statuses: Mapping[str, Any], now_s: float) -> None:
        """Print what has changed, and now and then everything."""
        devices = self.devices(statuses)
        for name, status in devices.items():
            state = _values(status).get(keys.STATE, '?')
            seen = self._states.setdefault(name, [state])
            if seen[-1] != state:
                print(f'     bus  {name}: {seen[-1]} -> {state} ({status.message})', flush=True)
                seen.append(state)
        if devices and now_s - self._shown_s > _PERIOD_S:
            self._shown_s = now_s
            print(_render(devices), flush=True)

    def missed(self, statuses: Mapping[str, Any]) -> dict[str, int]:
        """Return how many answers each device missed, by its three digits."""
        return {name[:3]: int(_values(status).get(keys.MISSED_ANSWERS, 0))
                for name, status in self.devices(statuses).items()}

    def verdicts(self, silenced: int) -> list[SceneResult]:
        """Judge what was seen: all there, the silenced one lost and found, no other lost."""
        name = f'{silenced:03}'
        lost = [other for other, states in self._states.items() if 'disconnected' in states]
        states = self._states.get(name, [])
        back = 'disconnected' in states and states[-1] == 'connected'
        return [
            SceneResult('all devices seen', len(self._states) == _EXPECTED,
                        f'{len(self._states)} of {_EXPECTED}'),
            SceneResult(f'device {name} lost and found again', back,
                        ' -> '.join(states) or 'never lost'),
            SceneResult('no other device lost', lost in ([name], []), ', '.join(lost)),
        ]


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _render(devices: Mapping[str, Any]) -> str:
    rows = [['level', 'ID', *(title for title, _, _ in _COLUMNS)]]
    for name, status in devices.items():
        values = _values(status)
        rows.append([Level(status.level[0]).name, name[:4], *(
            next((values[key] for key in names if key in values), '-')
            for _, _, names in _COLUMNS)])
    widths = (7, 5, *(width for _, width, _ in _COLUMNS))
    return '\n'.join(['', *(''.join(f'{cell[:width - 1]:{width}}' for cell, width in zip(
        row, widths, strict=True)) for row in rows), ''])
