# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
The tests without ROS on arm64: a Debian of that kind, run by qemu-user on this machine.

`root` builds it once, `enter.sh` goes into it, `left_out` names what the emulator cannot hold.
`scripts/test-arm64` runs them.
"""
