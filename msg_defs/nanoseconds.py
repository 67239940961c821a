# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Units of time in nanoseconds, which all stamps have."""

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
