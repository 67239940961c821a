# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Listens to a Dynamixel or Feetech bus, without ever sending, and reports what it hears."""
