# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Starts bridge and monitor; `ros2 launch mecarover_serial suite.launch.py -s`."""
from mecarover_serial.launch import describe_nodes
from mecarover_serial.launch_arguments import BRIDGE
from mecarover_serial.launch_arguments import MONITOR


def generate_launch_description():
    return describe_nodes(__file__, BRIDGE, MONITOR)
