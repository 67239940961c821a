# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Try everything without hardware: fakes, nodes, a scripted drive, and a verdict."""
