# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The robot of the page's tests has no bridge; what it publishes is what a bridge does."""
import pytest
from synthetic_robot import NO_COMMANDS
from synthetic_robot import SyntheticRobot
from test_bridge_status import commands
from test_bridge_status import HEARD
from test_bridge_status import link
from test_bridge_status import OPEN

from msg_defs.vel2d import Vel2d
from vel2d_bridge.gate import Counters
from vel2d_bridge.gate import FrameKind
from vel2d_bridge.graph import Absence
from vel2d_bridge.pacer import Sent


@pytest.mark.parametrize(('velocity', 'problem', 'absence'), [
    ((0.32, -0.25, 0.0), '', ''),
    ((0.0, 0.0, 0.0), '/dev/ttyAMA0: gone; plug it in', Absence.words('/cmd_vel'))])
def test_it_publishes_what_the_bridge_does(velocity, problem, absence):
    robot = SyntheticRobot({})
    robot.velocity, robot.bridge_problem, robot.absence = velocity, problem, absence
    state = OPEN._replace(
        is_open=not problem, problem=problem or None, frames=2000, driving=any(velocity),
        last=Sent(0, Vel2d(*velocity), FrameKind.COMMAND, 90_000, None))
    counters = Counters()
    counters.received = counters.accepted = 1000
    counters.time_outs = 2
    assert robot.bridge(100.0) == [
        link(state, now=241_500_000_000),
        commands(state, HEARD._replace(absence=absence), counters)]
    assert absence in ('', NO_COMMANDS)
