# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts vel2d_bridge with a settings file; `ros2 launch mecarover_serial bridge.launch.py -s`.

An argument that is given wins over the file; one that is not leaves the file as it is.
"""
from mecarover_serial.launch import describe_nodes
from mecarover_serial.launch_arguments import BRIDGE


def generate_launch_description():
    return describe_nodes(__file__, BRIDGE)
