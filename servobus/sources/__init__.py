# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""How bytes get in: a listener per bus and the process that reads its port."""
