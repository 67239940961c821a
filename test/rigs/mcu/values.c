/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Frames on stdin; what firmware/vel2d_receiver.c reads, as three doubles, NaN: refused. */
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
        vel2d_feed(&it, frame, sizeof frame, 0);
        fwrite(it.good > good ? &it.velocity : &nothing, sizeof nothing, 1, stdout);
    }
    return it.bad > 0;
}
