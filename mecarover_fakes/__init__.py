# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated devices: fake_mcu and fake_bus, for tests, the demo and users without hardware."""
