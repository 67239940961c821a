# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The bare reader: takes what is there and throws it away. No node can lose less than it does."""

import os
import select
import sys
import time

from rigs.harness import print_json


def main(port):
    """Read until told to report (any line); the first line starts the count again."""
    fd = os.open(port, os.O_RDONLY | os.O_NOCTTY)
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    poll.register(sys.stdin, select.POLLIN)
    print_json({'port': port})
    for _ in range(2):
        last = time.monotonic_ns()
        longest = 0
        while sys.stdin.fileno() not in dict(poll.poll()):
            os.read(fd, 4096)
            now = time.monotonic_ns()
            longest = max(longest, now - last)
            last = now
        sys.stdin.readline()
    print_json({'longest_gap_ms': longest / 1e6})


if __name__ == '__main__':
    main(sys.argv[1])
