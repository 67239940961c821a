# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The process of the monitor."""
from __future__ import annotations

from collections.abc import Sequence
import sys

from dxl_monitor.monitor_settings import PARAMETERS
from mecarover_serial.node_command_line import answer
from mecarover_serial.node_command_line import complain_no_ros
from mecarover_serial.node_command_line import hold_signals

NAME = 'dxl_monitor'
ABOUT = ('Listens to Dynamixel and Feetech buses, without ever sending, and publishes devices, '
         'control tables and timing.')


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    hold_signals()
    code = answer(NAME, ABOUT, PARAMETERS, args)
    if code is not None:
        return code
    try:
        from dxl_monitor.monitor_node import MonitorNode
        from mecarover_serial.ros_node import run
    except ImportError as error:
        return complain_no_ros(NAME, error)
    return run(NAME, MonitorNode, args)


if __name__ == '__main__':
    sys.exit(main())
