# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Which ROS domains the demo, the tests and the benchmarks take, so that they meet no robot."""
from __future__ import annotations

from collections.abc import Sequence
import socket

# Up to 101 they keep clear of the ports that the kernel gives out; 0 is the usual robot's.
TESTS, BENCHMARKS, DEMOS = range(1, 61), range(61, 91), range(91, 101)


class ReservedDomain:
    """
    One of these ROS domains, that no other process of this machine has; OSError without one.

    It is held until `release` or the end of the process. start: which to try first.
    """

    def __init__(self, numbers: Sequence[int], start: int = 0) -> None:
        # The name of an abstract socket is a lock that the kernel takes back in any case.
        self._lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        for turn in range(len(numbers)):
            self.number = numbers[(start + turn) % len(numbers)]
            try:
                self._lock.bind(f'\0mecarover_ros_domain_{self.number}')
            except OSError:
                continue
            return
        self.release()
        raise OSError(f'ROS domains {numbers[0]} to {numbers[-1]} are in use by other demos or '
                      'tests on this machine; end one of them')

    def release(self) -> None:
        """Let others have it."""
        self._lock.close()
