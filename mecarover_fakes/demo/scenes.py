# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The script of the demo as data, and what must be seen at the MCU for it to have worked.

Pure: scenes and set-points in, verdicts out. Bounds are those of docs/reliability.md; set-points
are what the fake MCU prints, in mm/s and rad/s, stamps on the monotonic clock in s.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
import math
from typing import Any
from typing import NamedTuple

from msg_defs.vel2d import STOP
from msg_defs.vel2d import Vel2d

TIME_OUT_BOUND_S = 0.5 + 2 / 20 + 0.05 + 0.3    # cmd_vel_timeout, resends, write_timeout, queue
KILL_BOUND_S = 0.3 + 0.1        # the deadman's promise; a tenth for a busy demo machine
_NAN = Vel2d(math.nan, 0.0, 0.0)


class Scene(NamedTuple):
    """Publish `command` for `seconds` (None: nothing); `kill` the bridge at its end."""

    name: str
    seconds: float
    command: Vel2d | None
    kill: bool = False


MISSED = 'missed answers'
SCENES = (
    Scene('forward', 1.5, Vel2d(0.3, 0.0, 0.0)),
    Scene('strafe left', 1.5, Vel2d(0.0, 0.2, 0.0)),
    Scene('turn', 1.5, Vel2d(0.0, 0.0, 0.8)),
    Scene('silence', 1.5, None),
    Scene('NaN', 1.0, _NAN),
    Scene('forward, then kill -9', 1.5, Vel2d(0.3, 0.0, 0.0), kill=True),
    Scene('restarted', 2.5, None),
    Scene('diagonal', 1.0, Vel2d(0.2, -0.2, 0.0)),
    Scene('silence', 1.5, None),
)


class TakenSetPoint(NamedTuple):
    """A set-point that the MCU took: from `stamp` (s) on it holds x, y (m/s), omega (rad/s)."""

    stamp: float
    velocity: Vel2d


class SceneResult(NamedTuple):
    """Whether a scene went as it should, and the figure that shows it."""

    scene: str
    passed: bool
    text: str


def judge(scene: Scene, begin: float, end: float,
          set_points: Sequence[TakenSetPoint]) -> SceneResult:
    """Judge a scene that ran from `begin` to `end` (s) by the changes of set-points at the MCU."""
    if scene.command is None or scene.command is _NAN:
        return _judge_stillness(scene, begin, end, set_points)
    followed = [one for one in set_points
                if begin <= one.stamp <= end and _close(one.velocity, scene.command)]
    if not followed:
        return SceneResult(scene.name, False, 'its set-point never reached the MCU')
    text = f'at the MCU after {followed[0].stamp - begin:.2f} s'
    if not scene.kill:
        return SceneResult(scene.name, True, text)
    stops = [one for one in set_points if one.stamp > end and one.velocity == STOP]
    if not stops:
        return SceneResult(scene.name, False, 'the MCU still drives')
    after = stops[0].stamp - end
    return SceneResult(scene.name, after <= KILL_BOUND_S,
                       f'{text}, stopped in {after:.2f} s')


def _judge_stillness(scene: Scene, begin: float, end: float,
                     set_points: Sequence[TakenSetPoint]) -> SceneResult:
    """Nothing may move later than the bound, and it must be standing at the end."""
    before = [one for one in set_points if one.stamp <= end]
    if before and before[-1].velocity != STOP:
        return SceneResult(scene.name, False, 'the MCU still drives')
    stopped = before[-1].stamp if before else begin
    after = max(0.0, stopped - begin)
    text = f'stopped after {after:.2f} s' if after else 'no movement'
    return SceneResult(scene.name, after <= TIME_OUT_BOUND_S, text)


def judge_missed(missed: Mapping[int, int], truth: Mapping[str, Any]) -> SceneResult:
    """
    Judge the answers that the monitor calls missed, per device, by the fake bus' truth.

    The monitor began later, so it may have seen fewer. Bytes that it did not fetch in time are
    lost as in a UART: then it is right to miss answers that were given.
    """
    given = {int(number): known['missed'] for number, known in truth['devices'].items()}
    wrong = [f'{number:03}: {count} counted, {given.get(number, 0)} simulated'
             for number, count in missed.items() if count > given.get(number, 0)]
    lost = truth['totals']['bus']['overrun']
    if wrong and lost:
        return SceneResult(MISSED, True, f'unknown: the busy computer lost {lost} bytes')
    text = '; '.join(wrong) or f'{sum(missed.values())} counted, {sum(given.values())} simulated'
    return SceneResult(MISSED, not wrong, text)


def _close(one: Vel2d, other: Vel2d) -> bool:
    return all(math.isclose(a, b, abs_tol=1e-6) for a, b in zip(one, other, strict=True))
