# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Fuzz targets: one module per input that comes from outside, each with check(data).

check() takes any bytes, turns them into that input and asserts what must hold; its docstring
names the invariants; hypothesis and the kept corpus call it (test/test_fuzz.py). `whole` has a
loop of its own: it makes its cases from seeds, for the whole program at once.
"""
