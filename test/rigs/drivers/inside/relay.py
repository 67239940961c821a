# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Run in the guest: be the board behind a CDC-ACM gadget, by carrying its bytes to this machine.

usage: relay.py TTY PORT       such as /dev/ttyGS0 and /dev/virtio-ports/gadget
"""
import os
import select
import sys
import tty


def main(board, far):
    ends = [os.open(path, os.O_RDWR | os.O_NOCTTY) for path in (board, far)]
    tty.setraw(ends[0])
    print('carrying', flush=True)
    while True:
        for source in select.select(ends, [], [])[0]:
            target = ends[1 - ends.index(source)]
            chunk = os.read(source, 4096)
            while chunk:
                chunk = chunk[os.write(target, chunk):]


if __name__ == '__main__':
    main(*sys.argv[1:])
