# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What a UART makes of bytes that were sent at another rate than its own."""


def heard_at(data: bytes, ratio: float) -> bytes:
    """
    Return what a UART makes of bytes when it samples `ratio` times as fast as they were sent.

    8N1: it waits for a falling edge, then samples the middle of each of its own bits.
    """
    line = ''.join('0' + f'{byte:08b}'[::-1] + '1' for byte in data)
    heard = bytearray()
    at = line.find('0')
    while at >= 0:
        samples = [int(at + (bit + 1.5) / ratio) for bit in range(8)]
        heard.append(sum(1 << bit for bit, where in enumerate(samples)
                         if where >= len(line) or line[where] == '1'))
        stop = int(at + 9.5 / ratio)
        rise = line.find('1', stop)      # a framing error: wait for the line to go up
        at = line.find('0', rise) if rise >= 0 else -1
    return bytes(heard)
