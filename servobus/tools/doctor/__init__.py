# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""dxl_doctor: what is on a servo bus, what is wrong with it, and what to do, on one screen."""
