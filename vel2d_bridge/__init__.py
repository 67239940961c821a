# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Drives a rover's MCU over a UART: cmd_vel in, checked frames out, a stop when anything fails."""
