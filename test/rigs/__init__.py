# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""A cable with faults, a simulated bus, soak; and what they and benchmarks share."""
