# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The page and mecarover_status without ROS: fed by the monitor in the same process."""
