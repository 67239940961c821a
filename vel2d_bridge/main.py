# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The process of the bridge: its dead man is forked first, while there is one thread and no ROS.

What the child inherits is then small and clean, and it is ready before the port is opened.
In a container a supervisor comes before both.
"""
from __future__ import annotations

from collections.abc import Sequence
import sys

from mecarover_serial.node_command_line import answer
from mecarover_serial.node_command_line import complain_no_process
from mecarover_serial.node_command_line import complain_no_ros
from mecarover_serial.node_command_line import hold_signals
from vel2d_bridge.bridge_settings import PARAMETERS
from vel2d_bridge.deadman import Deadman
from vel2d_bridge.supervisor import supervise

NAME = 'vel2d_bridge'
ABOUT = 'Subscribes cmd_vel and writes checked set-points to the MCU of a rover over a UART.'


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    hold_signals()
    code = answer(NAME, ABOUT, PARAMETERS, args)
    if code is not None:
        return code
    try:
        code = supervise()
        if code is not None:
            return code
        deadman = Deadman()
    except OSError as error:
        return complain_no_process(NAME, error)
    try:
        from mecarover_serial.ros_node import run
        from vel2d_bridge.bridge_node import Bridge
    except ImportError as error:
        return complain_no_ros(NAME, error)
    else:
        return run(NAME, lambda: Bridge(deadman), args)
    finally:
        deadman.leave()


if __name__ == '__main__':
    sys.exit(main())
