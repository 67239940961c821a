# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark suite behind scripts/bench; docs/benchmarks.md explains each figure."""
