# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
firmware/ without an MCU: `host` runs it on this machine, `board` on an emulated STM32F405.

`check_*.py` are the checks of the latter, with the bridge as host. `scripts/test-mcu` runs them.
"""
