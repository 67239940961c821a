# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Build the guest where there is none, then run the checks; what is missing is one line.

usage: scripts/python -m rigs.drivers [PYTEST OPTION ...]
"""
import os
from pathlib import Path
import signal
import sys

import pytest

from rigs.debian import Missing
from rigs.drivers.image import image


def main(options):
    # Ended from outside, it takes along what it started, as after Ctrl-C.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        print(f'test-drivers: the guest is {image().disk.parent}', flush=True)
    except Missing as error:
        print(f'test-drivers: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print('test-drivers: ended; what was half built is removed', file=sys.stderr)
        return 128 + signal.SIGINT
    os.nice(10)
    return pytest.main([str(Path(__file__).parent), '-o', 'python_files=check_*.py',
                        '-p', 'no:xdist', '-p', 'no:cacheprovider', *options])


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
