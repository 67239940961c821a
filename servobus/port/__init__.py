# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Open a serial port the way a robot needs it, and say who else uses it or why it fails."""
