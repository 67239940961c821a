# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The least that a rclpy node can do at its start: a frame to a port, then a topic."""

import os
import sys

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.signals import SignalHandlerOptions

from msg_defs.vel2d import encode
from msg_defs.vel2d import Vel2d

TOPIC = 'bench_diagnostics'
PERIOD_S = 0.02


def main(port):
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)      # SIGTERM just ends it
    node = rclpy.create_node('bench_minimal')
    publisher = node.create_publisher(DiagnosticArray, TOPIC, 10)
    os.write(os.open(port, os.O_WRONLY | os.O_NOCTTY), encode(Vel2d(0.0, 0.0, 0.0)))
    node.create_timer(PERIOD_S, lambda: publisher.publish(DiagnosticArray()))
    rclpy.spin(node)


if __name__ == '__main__':
    main(sys.argv[1])
