/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Receiver of the 28-byte frames of vel2d_bridge, with a watchdog of its own (docs/firmware.md).
 *
 * C99. It needs no library, no HAL and no memory but the struct; nothing in it waits. `now_ms` is
 * a counter of milliseconds, HAL_GetTick() for example; it may wrap around.
 *
 * None of the functions may interrupt another one. If an interrupt feeds the receiver, disable
 * that interrupt while another context calls vel2d_now or vel2d_report.
 *
 * A double has 8 bytes, or 4 as on an AVR: there values below 1.2e-38 are 0, others are rounded
 * toward 0.
 *
 * It is no emergency stop: that is a switch in the power line of the motors.
 */
#ifndef VEL2D_RECEIVER_H
#define VEL2D_RECEIVER_H

#include <stddef.h>
#include <stdint.h>

#define VEL2D_VERSION 1
#define VEL2D_VALUES 24                 /* bytes of a frame that its CRC covers */
#define VEL2D_FRAME 28                  /* all bytes of a frame */
#define VEL2D_REPORT 128                /* bytes that a report needs at most */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double x, y, omega;                 /* m/s forward, m/s left, rad/s counter-clockwise */
} vel2d_velocity;

/* CRC-32/MPEG-2 over VEL2D_VALUES bytes: parameter crc_input of the bridge, bytes or words. */
uint32_t vel2d_crc_bytes(const uint8_t *values);
uint32_t vel2d_crc_words(const uint8_t *values);

typedef struct {
    uint32_t (*crc)(const uint8_t *values); /* one of the two above, or yours for a CRC unit */
    vel2d_velocity most;                /* a frame with more, either way, is refused */
    uint32_t watchdog_ms;               /* without a good frame for so long: stop */
    uint32_t ramp_ms;                   /* such a stop takes so long, linear; 0: at once */
    uint32_t gap_ms;                    /* more than this between two calls: no frame goes on */
} vel2d_settings;

#define VEL2D_DEFAULTS {vel2d_crc_bytes, {1e6, 1e6, 1e6}, 300, 0, 5}

typedef enum {
    VEL2D_WAITING,                      /* no good frame since the start */
    VEL2D_RUNNING,                      /* the wheels follow the newest frame */
    VEL2D_STOPPED                       /* by the watchdog, until the next good frame */
} vel2d_state;

typedef struct {
    vel2d_settings settings;            /* these, state and counters: read them as you like */
    vel2d_state state;
    uint32_t good;                      /* frames that the wheels followed */
    uint32_t bad;                       /* damaged: stretches of bytes without a frame */
    uint32_t refused;                   /* right CRC, but not finite or more than `most` */
    uint32_t stops;                     /* by the watchdog */

    vel2d_velocity velocity;            /* the rest is private */
    uint32_t good_at, stopped_at, byte_at, reported_at;
    uint8_t bytes[VEL2D_FRAME];         /* aligned to words, for a CRC unit */
    uint8_t held, is_damaged, has_reported;
    vel2d_state reported;
} vel2d_receiver;

/* Begin, with the wheels stopped. NULL: the defaults. */
void vel2d_begin(vel2d_receiver *receiver, const vel2d_settings *settings);

/* Take what came in, one byte or a block. Call it at once: `now_ms` is when the bytes came. */
void vel2d_feed(vel2d_receiver *receiver, const uint8_t *bytes, size_t count, uint32_t now_ms);

/* The line was idle after these bytes, or the UART reports an error: a new frame begins. */
void vel2d_idle(vel2d_receiver *receiver);

/* What the wheels may do now. Call it in each turn of the control loop, and obey it. */
vel2d_velocity vel2d_now(vel2d_receiver *receiver, uint32_t now_ms);

/*
 * Write a line of text for the host, once a second and when the state changes.
 * text: VEL2D_REPORT bytes. Returns the length of the line, 0: nothing to send now.
 */
size_t vel2d_report(vel2d_receiver *receiver, uint32_t now_ms, char *text);

#ifdef __cplusplus
}
#endif
#endif
