# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""How long bytes take on a UART, when its line is idle, and what it hears at a wrong rate."""

BITS_PER_BYTE = 10                 # 8N1
IDLE_S = 0.02
IDLE_BYTES = 20
SLOWEST_BAUD = 9600                # bit/s, of a servo bus


def byte_ns(baud: int) -> float:
    """Return how long a byte takes (ns) at a rate (bit/s); 0 for 0, a rate not known yet."""
    return BITS_PER_BYTE * 1e9 / baud if baud else 0.0


def idle_s(baud: int, latency_timer_ms: float = 0) -> float:
    """
    Return for how long a line must be silent before what came is judged complete.

    latency_timer_ms: for how long a USB adapter keeps bytes back; twice that may pass between two.
    """
    return max(IDLE_S, 2e-3 * latency_timer_ms,
               IDLE_BYTES * BITS_PER_BYTE / (baud or SLOWEST_BAUD))


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
