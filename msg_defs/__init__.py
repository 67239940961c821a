# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What crosses a boundary: bytes on a wire, values on a topic. No IO, no clock, no node."""
