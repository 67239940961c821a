# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts vel2d_bridge with a settings file; `ros2 launch mecarover_serial bridge.launch.py -s`.

An argument that is given wins over the file; one that is not leaves the file as it is.
"""
from mecarover_serial.launch import node_with_settings

PARAMETERS = (              # arguments that are parameters of the node; '' = as in the file
    ('port', 'the UART to the MCU'),
    ('baud', 'its rate in bit/s'),
)


def generate_launch_description():
    return node_with_settings('vel2d_bridge', 'bridge.yaml', PARAMETERS, respawn=True)
