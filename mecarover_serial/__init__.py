# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What both nodes stand on: ports, ptys, parameters, the start and the end of a process."""
