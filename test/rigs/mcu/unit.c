/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Tests of firmware/vel2d_receiver.c: exit code 1 and the line of what does not hold. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vel2d_receiver.h"

#define CHECK(what) \
    do { if (!(what)) { printf("line %d: %s\n", __LINE__, #what); exit(1); } } while (0)

static const vel2d_velocity STOP = {0, 0, 0}, DRIVE = {0.5, -0.25, 1.0};
static vel2d_receiver it;
static uint8_t frame[VEL2D_FRAME];

static void make(double x, double y, double omega, uint32_t (*crc)(const uint8_t *))
{
    vel2d_velocity velocity = {x, y, omega};
    uint32_t sum;
    memcpy(frame, &velocity, VEL2D_VALUES);
    sum = crc(frame);
    for (unsigned i = 0; i < 4; i++)
        frame[VEL2D_VALUES + i] = (uint8_t)(sum >> 8 * i);
}

static void begin(uint32_t watchdog_ms, uint32_t ramp_ms)
{
    vel2d_settings settings = VEL2D_DEFAULTS;
    settings.watchdog_ms = watchdog_ms;
    settings.ramp_ms = ramp_ms;
    vel2d_begin(&it, &settings);
    make(DRIVE.x, DRIVE.y, DRIVE.omega, vel2d_crc_bytes);
}

static int moves(uint32_t now_ms, double share)
{
    vel2d_velocity is = vel2d_now(&it, now_ms);
    return is.x == DRIVE.x * share && is.y == DRIVE.y * share && is.omega == DRIVE.omega * share;
}

/* It stops at its time, by the ramp, for good, also when the clock wraps around. */
static void watchdog_and_ramp(uint32_t start)
{
    begin(200, 100);
    CHECK(moves(start, 0) && it.state == VEL2D_WAITING);
    vel2d_feed(&it, frame, sizeof frame, start);
    CHECK(moves(start - 3, 1));                             /* the clock was read before it came */
    CHECK(moves(start + 199, 1) && it.state == VEL2D_RUNNING);
    CHECK(moves(start + 200, 1) && it.state == VEL2D_STOPPED && it.stops == 1);
    CHECK(moves(start + 250, 0.5) && moves(start + 300, 0) && moves(start + 0x80000000, 0));
    CHECK(moves(start + 10, 0) && moves(start + 250, 0) && it.stops == 1);
    vel2d_feed(&it, frame, sizeof frame, start + 260);
    CHECK(moves(start + 260, 1) && it.state == VEL2D_RUNNING);
    begin(300, 0);
    vel2d_feed(&it, frame, sizeof frame, start);
    CHECK(moves(start + 299, 1) && moves(start + 300, 0) && moves(start + 301, 0));
    vel2d_feed(&it, frame, sizeof frame, start + 400);
    make(STOP.x, STOP.y, STOP.omega, vel2d_crc_bytes);
    vel2d_feed(&it, frame, sizeof frame, start + 401);
    CHECK(moves(start + 401, 0) && it.state == VEL2D_RUNNING);
}

/* A frame that a stopped host ends later would be old: its halves are none, but within gap_ms. */
static void halves(void)
{
    static const uint32_t at[][3] = {{0, 5, 1}, {20, 26, 1}, {0xFFFFFFFE, 3, 2}, {10, 16, 2}};
    begin(300, 0);
    for (unsigned i = 0; i < 4; i++) {
        vel2d_feed(&it, frame, 14, at[i][0]);
        vel2d_feed(&it, frame, 0, at[i][1]);                /* nothing is no sign of life */
        vel2d_feed(&it, frame + 14, 14, at[i][1]);
        CHECK(it.good == at[i][2]);
        vel2d_idle(&it);
    }
    vel2d_feed(&it, frame, 14, 16);
    vel2d_idle(&it);
    vel2d_feed(&it, frame + 14, 14, 16);
    CHECK(it.good == 2 && it.bad == 5);                     /* the last half is not over yet */
}

/* Without pauses damage costs the frame that it hits. */
static void realigns(void)
{
    begin(300, 0);
    vel2d_feed(&it, frame, 28, 0);
    vel2d_feed(&it, frame + 1, 27, 0);
    vel2d_feed(&it, frame, 28, 0);
    CHECK(it.good == 2 && it.bad == 1);
    vel2d_feed(&it, frame + 9, 1, 0);
    vel2d_feed(&it, frame, 28, 0);
    CHECK(it.good == 3 && it.bad == 2);
    frame[9] ^= 1;
    vel2d_feed(&it, frame, 28, 0);
    frame[9] ^= 1;
    vel2d_feed(&it, frame, 28, 0);
    CHECK(it.good == 4 && it.bad == 3 && it.refused == 0);
}

static void values(void)
{
    double odd[] = {NAN, INFINITY, -INFINITY, 3.0001, -3.0001, 1e300};
    vel2d_settings settings = VEL2D_DEFAULTS;
    settings.most.x = 1;
    settings.most.y = 2;
    settings.most.omega = 3;
    vel2d_begin(&it, &settings);
    for (unsigned i = 0; i < 18; i++) {
        make(i % 3 == 0 ? odd[i / 3] : 0, i % 3 == 1 ? odd[i / 3] : 0,
             i % 3 == 2 ? odd[i / 3] : 0, vel2d_crc_bytes);
        vel2d_feed(&it, frame, sizeof frame, 0);
        CHECK(it.good == 0 && it.refused == i + 1 && moves(0, 0));
    }
    make(-1, 2, -3, vel2d_crc_bytes);
    vel2d_feed(&it, frame, sizeof frame, 0);
    CHECK(it.good == 1);
    settings.most.x = INFINITY;                             /* even this is no leave for it */
    vel2d_begin(&it, &settings);
    make(INFINITY, 0, 0, vel2d_crc_bytes);
    vel2d_feed(&it, frame, sizeof frame, 0);
    CHECK(it.refused == 1);
}

static void both_crcs(void)
{
    vel2d_settings settings = VEL2D_DEFAULTS;
    make(DRIVE.x, DRIVE.y, DRIVE.omega, vel2d_crc_bytes);
    CHECK(memcmp(frame + VEL2D_VALUES, "\x5A\x5F\xF4\xCD", 4) == 0);
    make(DRIVE.x, DRIVE.y, DRIVE.omega, vel2d_crc_words);
    CHECK(memcmp(frame + VEL2D_VALUES, "\xFA\x57\x78\xEF", 4) == 0);
    vel2d_begin(&it, NULL);
    vel2d_feed(&it, frame, sizeof frame, 0);
    CHECK(it.good == 0 && it.bad == 1);
    settings.crc = vel2d_crc_words;
    vel2d_begin(&it, &settings);
    vel2d_feed(&it, frame, sizeof frame, 0);
    CHECK(it.good == 1 && moves(0, 1));
}

static int says(uint32_t now_ms, const char *expected)
{
    char text[VEL2D_REPORT] = "";
    return vel2d_report(&it, now_ms, text) == strlen(expected) && strcmp(text, expected) == 0;
}

/* Once a second and at a change; all numbers have their room. */
static void reports(void)
{
    begin(300, 0);
    CHECK(says(0, "vel2d receiver 1: waiting, 0 good, 0 bad, 0 refused, 0 stops\r\n"));
    CHECK(says(999, ""));
    vel2d_feed(&it, frame, sizeof frame, 999);
    CHECK(says(999, "vel2d receiver 1: running, 1 good, 0 bad, 0 refused, 0 stops\r\n"));
    CHECK(says(1998, ""));
    CHECK(says(1999, "vel2d receiver 1: running, 1 good, 0 bad, 0 refused, 0 stops\r\n"));
    vel2d_now(&it, 1999);
    it.good = it.bad = it.refused = it.stops = 0xFFFFFFFF;
    CHECK(says(1999, "vel2d receiver 1: stopped, 4294967295 good, 4294967295 bad, "
                     "4294967295 refused, 4294967295 stops\r\n"));
}

int main(void)
{
    watchdog_and_ramp(0);
    watchdog_and_ramp(0xFFFFFF9C);
    halves();
    realigns();
    values();
    both_crcs();
    reports();
    return 0;
}
