# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Listen to a bus of Dynamixel or Feetech servos, and name what is wrong with it."""
