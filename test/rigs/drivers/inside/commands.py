# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Run in the guest: be the planner that publishes a velocity on /cmd_vel, 10 times a second."""
from contextlib import suppress

from geometry_msgs.msg import Twist
import rclpy
from rclpy.executors import ExternalShutdownException

PERIOD_S = 0.1


def main():
    rclpy.init()
    node = rclpy.create_node('planner')
    publisher = node.create_publisher(Twist, 'cmd_vel', 1)
    forward = Twist()
    forward.linear.x = 0.2
    node.create_timer(PERIOD_S, lambda: publisher.publish(forward))
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
