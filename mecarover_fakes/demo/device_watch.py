# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The devices of the demo, as mecarover_status shows them, and what must be seen of them."""
from __future__ import annotations

from shutil import get_terminal_size
from textwrap import fill

from mecarover_dashboard.robot_parts import level_of
from mecarover_dashboard.rows import Row
from mecarover_dashboard.state import State
from mecarover_dashboard.status_lines import INDENT
from mecarover_dashboard.status_lines import table
from mecarover_fakes.demo.scenes import SceneResult
from msg_defs.diagnostics import Level
from msg_defs.status_keys import MISSED_ANSWERS
from servobus.joints import POSITION
from servobus.model.models import Models

_PERIOD_S = 5.0
_EXPECTED = 20


class DeviceWatch:
    """
    Shows the table every few seconds and each change of a device's state at once.

    All of it fits a terminal of 80 x 24. page: its address, shown with each table.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self.page = ''
        self._models = Models()
        self._seen: dict[int, list[str]] = {}       # every state a device was seen in, in order
        self._shown_s = 0.0

    def devices(self) -> dict[int, Row]:
        """Return what is known of the devices, by ID."""
        return {report.row['id']: report.row for report in self._state.reports('devices')}

    def show(self, now_s: float) -> None:
        """Print what has changed, and now and then everything."""
        width = get_terminal_size((200, 24)).columns - 1
        devices = self.devices()
        changes: dict[str, list[str]] = {}
        for number, row in devices.items():
            seen = self._seen.setdefault(number, [row['state']])
            if seen[-1] != row['state']:
                why = f' ({row["message"]})' * (row['message'] != row['state'])
                if why or seen[-1] != 'expected':
                    changes.setdefault(f'{seen[-1]} -> {row["state"]}{why}', []).append(
                        f'{number:03}')
                seen.append(row['state'])
        for change, numbers in changes.items():
            print(fill(f'bus  {", ".join(numbers)}: {change}', width, initial_indent=' ' * 5,
                       subsequent_indent=' ' * 10), flush=True)
        is_heard = any(row['state'] != 'expected' for row in devices.values())
        if is_heard and now_s - self._shown_s > _PERIOD_S:
            self._shown_s = now_s
            print('\n'.join(['', *self.table(now_s, width), '']), flush=True)

    def table(self, now_s: float, width: int) -> list[str]:
        """Return a line for each servo, one for the boards that are well, and the page."""
        boards = {report.row_name: report.row['model'] for report in self._state.reports('devices')
                  if level_of(report.row) is Level.OK and self._is_board(report.row['model'])}
        lines = table(self._state, now_s, 'i', left_out=boards)
        if boards:
            names = ', '.join(dict.fromkeys(boards.values()))
            lines.append(f'ok      {len(boards)} boards without position: {names}')
        lines.append(f'{INDENT}page: {self.page}')
        return [line if len(line) <= width else f'{line[:width - 1]}\u2026' for line in lines]

    def _is_board(self, name: str) -> bool:
        model = self._models.by_name(name)
        return model is not None and POSITION not in model.by_name

    def missed(self) -> dict[int, int]:
        """Return how many answers each device missed."""
        return {report.row['id']: int(self._state.fact(report.row_name, MISSED_ANSWERS) or 0)
                for report in self._state.reports('devices')}

    def verdicts(self, silenced: int) -> list[SceneResult]:
        """Judge what was seen: all there, the silenced one lost and found, no other lost."""
        lost = [number for number, states in self._seen.items() if 'disconnected' in states]
        states = self._seen.get(silenced, [])
        back = 'disconnected' in states and states[-1] == 'connected'
        return [
            SceneResult('all devices seen', len(self._seen) == _EXPECTED,
                        f'{len(self._seen)} of {_EXPECTED}'),
            SceneResult(f'device {silenced:03}, silenced on purpose: lost and found again',
                        back, ' -> '.join(states) or 'never lost'),
            SceneResult('no other device lost', lost in ([silenced], []), str(lost)),
        ]
