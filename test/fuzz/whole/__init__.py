# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The whole program in one process: node, dashboard and tools, on bytes of any source."""
