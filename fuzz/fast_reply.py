# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Fast replies: one status of many devices, whole, cut, damaged, or not one at all."""

from fuzz.script import fast_reply
from fuzz.script import Script
from msg_defs.dxl_instruction import Access
from msg_defs.dxl_instruction import split_combined


def check(data):
    """
    Check one combined status.

    Never raises; a reply cut anywhere gives the blocks that are whole; after a flipped bit only
    blocks in front of it; whatever it is, no block that was not asked for.
    """
    script = Script(data)
    sizes = [script.byte() % 24 for _ in range(script.byte() % 8)]
    accesses = tuple(Access(number, 0, size, None) for number, size in enumerate(sizes))
    blocks = [(script.byte(), number, script.take(size).ljust(size, b'\0'))
              for number, size in enumerate(sizes)]
    cut, bit, garbage = script.word(), script.word(), script.rest()
    reply = fast_reply(blocks)[4:]
    expected = [(number, error, block) for error, number, block in blocks]
    ends = [4 + sum(sizes[:n + 1]) + 4 * (n + 1) for n in range(len(sizes))]
    assert split_combined(reply, accesses) == expected
    cut %= len(reply) + 1
    assert split_combined(reply[:cut], accesses) == expected[:sum(end <= cut for end in ends)]
    damaged = bytearray(reply)
    damaged[bit // 8 % len(reply)] ^= 1 << bit % 8
    found = split_combined(bytes(damaged), accesses)
    assert found == expected[:sum(end <= bit // 8 % len(reply) for end in ends)]
    found = split_combined(garbage.ljust(4, b'\0'), accesses)
    assert [(one.id, len(one.data)) for one in found] == [
        (one.id, one.length) for one in accesses[:len(found)]]
