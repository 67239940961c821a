# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Starts dxl_monitor with a settings file; `ros2 launch mecarover_serial monitor.launch.py -s`.

An argument that is given wins over the file; one that is not leaves the file as it is.
"""
from mecarover_serial.launch import node_with_settings

PARAMETERS = (              # arguments that are parameters of the node; '' = as in the file
    ('ports', "the bus, or a list: \"['/dev/ttyUSB0','/dev/ttyUSB1']\""),
    ('bauds', 'its rate in bit/s, or a list'),
    ('devices', "what is on it, as a list: \"['1:MX-106:left_knee','2-20:MX-64']\""),
)


def generate_launch_description():
    return node_with_settings('dxl_monitor', 'monitor.yaml', PARAMETERS, respawn=False)
