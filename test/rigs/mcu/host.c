/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * receiver BYTES SEED: what firmware/vel2d_receiver.c says of damaged traffic, for test/fuzz/firmware.py.
 *
 * Two receivers get the same: one each piece whole, the other byte by byte; they must not differ.
 * Records on stdout: a letter, a number, the size of what follows, and that.
 *     S WORDS              a life begins: crc_input
 *     B MS BYTES           what came; then F PLACE VELOCITY for each frame, C 0 BAD REFUSED
 *     N MS                 a turn of the control loop; then W MS VELOCITY STATE STOPS
 *     R MS                 is there a report? then T MS TEXT
 *     E WRONG TEXT         the end: frames that were not sent, and a summary
 */
#include <stdio.h>
#include <stdlib.h>

#include "volume.h"

#define LIFE 65536                      /* bytes */
#define LOOP_MS 30

static vel2d_receiver whole, bytewise;
static uint32_t frames, wrong;

static void record(int what, uint32_t number, uint32_t size, const void *data)
{
    putchar(what);
    fwrite(&number, sizeof number, 1, stdout);
    fwrite(&size, sizeof size, 1, stdout);
    fwrite(data, size, 1, stdout);
}

static void compare(void)
{
    if (whole.good != bytewise.good || whole.bad != bytewise.bad || whole.state != bytewise.state
            || whole.held != bytewise.held || memcmp(whole.bytes, bytewise.bytes, whole.held)
            || memcmp(&whole.velocity, &bytewise.velocity, sizeof whole.velocity)) {
        fputs("whole and byte by byte differ\n", stderr);
        exit(1);
    }
}

static void feed(const piece *it, uint32_t ms, uint32_t start)
{
    uint32_t counts[2];
    record('B', ms, it->size, it->bytes);
    vel2d_feed(&whole, it->bytes, it->size, start + ms);
    for (uint32_t at = 0; at < it->size; at++) {
        uint32_t good = bytewise.good;
        vel2d_feed(&bytewise, it->bytes + at, 1, start + ms);
        if (bytewise.good == good)
            continue;
        record('F', at, VEL2D_VALUES, &bytewise.velocity);
        frames++;
        wrong += !was_sent(&bytewise.velocity);
    }
    counts[0] = whole.bad;
    counts[1] = whole.refused;
    record('C', 0, sizeof counts, counts);
    compare();
}

static void turn(uint32_t ms, uint32_t start)
{
    struct { vel2d_velocity velocity; uint32_t state, stops; } wheels;
    wheels.velocity = vel2d_now(&whole, start + ms);
    wheels.state = whole.state;
    wheels.stops = whole.stops;
    vel2d_now(&bytewise, start + ms);
    record('N', ms, 0, "");
    record('W', ms, sizeof wheels, &wheels);
    compare();
}

static void report(uint32_t ms, uint32_t start)
{
    char *text = malloc(VEL2D_REPORT);                      /* so that a sanitizer sees its end */
    record('R', ms, 0, "");
    record('T', ms, (uint32_t)vel2d_report(&whole, start + ms, text), text);
    free(text);
}

int main(int count, char **options)
{
    static const uint32_t starts[] = {0, 0x7FFFF000, 0xFFFFF000};   /* the clock wraps around */
    uint64_t bytes = 0, until = count == 3 ? strtoull(options[1], NULL, 10) : 0;
    uint32_t bad = 0, stops = 0, refused = 0;
    char text[200];
    chance_state = count == 3 ? (uint32_t)strtoul(options[2], NULL, 10) * 2654435761u + 1 : 1;
    while (bytes < until) {
        vel2d_settings settings = VEL2D_DEFAULTS;
        uint32_t ms = 0, start = starts[chance(3)], words = chance(2);
        if (words)
            settings.crc = vel2d_crc_words;
        memset(&whole, 0xA5, sizeof whole);                 /* memory may hold anything */
        memset(&bytewise, 0x5A, sizeof bytewise);
        vel2d_begin(&whole, &settings);
        vel2d_begin(&bytewise, &settings);
        record('S', words, 0, "");
        for (uint32_t lived = 0; lived < LIFE;) {
            piece it;
            next_piece(&it, settings.crc);
            feed(&it, ms, start);
            lived += it.size;
            bytes += it.size;
            if (chance(10) == 0)
                report(ms, start);
            if (it.is_idle) {
                vel2d_idle(&whole);
                vel2d_idle(&bytewise);
            }
            for (uint32_t end = ms + it.pause_ms; ms < end;)
                if (++ms % LOOP_MS == 0)
                    turn(ms, start);
        }
        bad += whole.bad;
        refused += whole.refused;
        stops += whole.stops;
    }
    snprintf(text, sizeof text, "%llu bytes: %u frames, %u wrong, %u damaged, %u refused, %u stops",
             (unsigned long long)bytes, (unsigned)frames, (unsigned)wrong, (unsigned)bad,
             (unsigned)refused, (unsigned)stops);
    record('E', wrong, (uint32_t)strlen(text), text);
    return 0;
}
