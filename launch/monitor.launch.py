# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts dxl_monitor with a settings file; `ros2 launch mecarover_serial monitor.launch.py -s`.

An argument that is given wins over the file; one that is not leaves the file as it is.
"""
from mecarover_serial.launch import describe_nodes
from mecarover_serial.launch_arguments import MONITOR


def generate_launch_description():
    return describe_nodes(__file__, MONITOR)
