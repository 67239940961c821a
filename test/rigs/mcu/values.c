/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Frames on stdin; what firmware/vel2d_receiver.c reads, three doubles in hex, NaN: refused. */
#include <math.h>
#include <stdio.h>

#include "vel2d_receiver.h"

int main(void)
{
    static vel2d_receiver it;
    vel2d_settings settings = VEL2D_DEFAULTS;
    vel2d_velocity nothing = {NAN, NAN, NAN};
    uint8_t frame[VEL2D_FRAME];
    settings.most.x = settings.most.y = settings.most.omega = INFINITY;
    vel2d_begin(&it, &settings);
    while (fread(frame, sizeof frame, 1, stdin)) {
        uint32_t good = it.good;
        const uint8_t *read = (const uint8_t *)&it.velocity;
        vel2d_feed(&it, frame, sizeof frame, 0);
        if (it.good == good)
            read = (const uint8_t *)&nothing;
        for (unsigned at = 0; at < sizeof nothing; at++)
            printf("%02x", read[at]);
        putchar('\n');
    }
    return it.bad > 0;
}
