# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
A second servo bus in simulated time, to judge the doctor with traffic that it was not made with.

It shares nothing with `mecarover_fakes` and the encoders of `msg_defs`: the packets follow the
e-Manual (Protocol 2.0), the masters follow what the public programs send and how long they wait.
Time is counted in ns from 0. The parts know each other only like this:

    frames  bytes of one protocol, no time
    wire    what all hear: bytes in time, collisions included
    servo   registers, and answers to what it hears
    master  a program that says something, waits, and says the next thing
    adapter how the bytes come to a listener: chunks, pauses, a wrong rate
    faults  what goes wrong, and when the first byte is different because of it
    uart    one packet on a line that is not good, bit by bit
    scenes  all of it together, with what the doctor must say (broken.yaml)

frames1, servo1 and masters1 hold what differs in the 1.0 family, Dynamixel 1.0 and Feetech.

Only `score` knows the product.
"""
