# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Test equipment other than benchmarks: a cable with faults, soak, load, mutation."""
