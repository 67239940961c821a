# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of fake_bus: devices, a master, a line on simulated time, faults, the truth."""
