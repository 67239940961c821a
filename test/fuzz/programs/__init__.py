# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Programs made by a grammar, on simulated servos and in simulated time, and what is wrong with them.

What is expected is made with the mistake; nothing here knows a rule of the doctor but its name.
"""
