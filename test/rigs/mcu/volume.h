/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Frames that are good, damaged, cut, joined, not allowed, or of the other CRC; noise; pauses. */
#include <string.h>

#include "vel2d_receiver.h"

typedef struct {
    uint8_t bytes[4 * VEL2D_FRAME];
    unsigned size;
    uint32_t pause_ms;                  /* after it */
    int is_idle;                        /* the UART notices the pause, not only the receiver */
} piece;

typedef uint32_t (*crc_function)(const uint8_t *);

static uint32_t chance_state = 1;

static uint32_t chance(uint32_t below)
{
    chance_state ^= chance_state << 13;
    chance_state ^= chance_state >> 17;
    chance_state ^= chance_state << 5;
    return (uint32_t)((uint64_t)chance_state * below >> 32);
}

static vel2d_velocity sent[16];         /* the newest frames that may be taken */

static unsigned put_frame(uint8_t *to, crc_function crc)
{
    static const double odd[] = {1.0000001e6, -2e6, 1e300};
    static const uint64_t not_finite[] = {0x7FF0000000000000, 0xFFF0000000000000,
                                          0x7FF8000000000000, 0xFFF0000000000001};
    static unsigned number;
    double values[3];
    uint32_t sum;
    for (unsigned i = 0; i < 3; i++)
        values[i] = ((int)chance(1600) - 800) / 8.0;
    if (chance(20) == 0)
        values[chance(3)] = odd[chance(3)];
    if (chance(20) == 0)
        memcpy(&values[chance(3)], &not_finite[chance(4)], sizeof values[0]);
    memcpy(to, values, VEL2D_VALUES);
    if (chance(20) == 0)
        crc = crc == vel2d_crc_bytes ? vel2d_crc_words : vel2d_crc_bytes;
    else
        memcpy(&sent[number++ % 16], values, VEL2D_VALUES);
    sum = crc(to);
    for (unsigned i = 0; i < 4; i++)
        to[VEL2D_VALUES + i] = (uint8_t)(sum >> 8 * i);
    return VEL2D_FRAME;
}

static unsigned put_noise(uint8_t *to, unsigned size)
{
    for (unsigned i = 0; i < size; i++)
        to[i] = (uint8_t)chance(256);
    return size;
}

static void next_piece(piece *it, crc_function crc)
{
    static const uint16_t pauses_ms[] = {0, 0, 0, 1, 3, 6, 20, 33, 250, 299, 300, 301, 400};
    unsigned at = 1 + chance(VEL2D_FRAME - 1);
    uint8_t *bytes = it->bytes, frame[VEL2D_FRAME];
    it->size = put_frame(bytes, crc);
    switch (chance(22)) {
    case 0: bytes[at] ^= (uint8_t)(1 << chance(8)); break;
    case 1: memmove(bytes + at - 1, bytes + at, --it->size - at + 1); break;
    case 2: it->size = at; break;
    case 3: memmove(bytes, bytes + at, it->size -= at); break;
    case 4: it->size = at + put_frame(bytes + at, crc); break;
    case 5: it->size += put_frame(bytes + it->size, crc); break;
    case 6: it->size += put_noise(bytes + it->size, chance(40)); break;
    case 7: it->size = put_noise(bytes, 1 + chance(79)); break;
    case 8: memset(bytes, 0, it->size = 40); break;
    case 9: memset(bytes, 0xFF, it->size = 40); break;
    case 10:
        memcpy(frame, bytes, VEL2D_FRAME);
        it->size = put_noise(bytes, 1 + chance(5));
        memcpy(bytes + it->size, frame, VEL2D_FRAME);
        it->size += VEL2D_FRAME;
    }
    it->pause_ms = pauses_ms[chance(13)];
    it->is_idle = it->pause_ms && (it->pause_ms <= 5 || chance(2));
}

/* Whether a frame was sent; a CRC that begins with ones takes FF FF FF FF and 24 zeros, a stop. */
static int was_sent(const vel2d_velocity *taken)
{
    static const uint8_t ones_and_zeros[VEL2D_VALUES] = {0xFF, 0xFF, 0xFF, 0xFF};
    for (unsigned i = 0; i < 16; i++)
        if (memcmp(taken, &sent[i], VEL2D_VALUES) == 0)
            return 1;
    return memcmp(taken, ones_and_zeros, VEL2D_VALUES) == 0;
}
