# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Captures: written by the node and the tools, read by the tools."""
