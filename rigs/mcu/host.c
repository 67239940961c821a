/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * firmware/vel2d_receiver.c on the host, driven by a script of bytes on stdin (rigs/mcu/host.py).
 *
 * Two receivers get the same: one each call whole, the other byte by byte. They must never differ.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vel2d_receiver.h"

static vel2d_receiver whole, bytewise;

static int get(void *to, size_t size) { return fread(to, 1, size, stdin) == size; }
static void put(const void *from, size_t size) { fwrite(from, 1, size, stdout); }

static uint32_t get_word(void)
{
    uint32_t word = 0;
    if (!get(&word, sizeof word))
        exit(3);
    return word;
}

static void begin(void)
{
    vel2d_settings settings = VEL2D_DEFAULTS;
    if (get_word())
        settings.crc = vel2d_crc_words;
    settings.watchdog_ms = get_word();
    settings.ramp_ms = get_word();
    settings.gap_ms = get_word();
    if (!get(&settings.most, sizeof settings.most))
        exit(3);
    memset(&whole, 0xA5, sizeof whole);                     /* a user's stack holds anything */
    memset(&bytewise, 0xA5, sizeof bytewise);
    vel2d_begin(&whole, &settings);
    vel2d_begin(&bytewise, &settings);
}

/* Answer: how many frames were taken, the place and the velocity of each; bad, refused. */
static void feed(void)
{
    static uint8_t bytes[1 << 16], found[1 << 17];
    uint32_t now = get_word(), size = get_word(), count = 0;
    uint8_t *end = found;
    if (size > sizeof bytes || !get(bytes, size))
        exit(3);
    vel2d_feed(&whole, bytes, size, now);
    for (uint32_t at = 0; at < size; at++) {
        uint32_t good = bytewise.good;
        vel2d_feed(&bytewise, bytes + at, 1, now);
        if (bytewise.good != good) {
            memcpy(end, &at, sizeof at);
            memcpy(end + sizeof at, &bytewise.velocity, VEL2D_VALUES);
            end += sizeof at + VEL2D_VALUES;
            count++;
        }
    }
    put(&count, sizeof count);
    put(found, (size_t)(end - found));
    put(&bytewise.bad, sizeof bytewise.bad);
    put(&bytewise.refused, sizeof bytewise.refused);
}

static void turn(void)
{
    uint32_t now = get_word();
    vel2d_velocity velocity = vel2d_now(&whole, now);
    uint32_t said[2] = {whole.state, whole.stops};
    vel2d_now(&bytewise, now);
    put(&velocity, sizeof velocity);
    put(said, sizeof said);
}

static void report(void)
{
    char *text = malloc(VEL2D_REPORT);                      /* so that the sanitizer sees its end */
    uint32_t now = get_word(), size = (uint32_t)vel2d_report(&whole, now, text);
    vel2d_report(&bytewise, now, text);
    put(&size, sizeof size);
    put(text, size);
    free(text);
}

int main(void)
{
    int what;
    while ((what = getchar()) != EOF) {
        switch (what) {
        case 'S': begin(); break;
        case 'B': feed(); break;
        case 'I': vel2d_idle(&whole); vel2d_idle(&bytewise); break;
        case 'N': turn(); break;
        case 'R': report(); break;
        default: return 3;
        }
        if (whole.good != bytewise.good || whole.bad != bytewise.bad
                || whole.state != bytewise.state || whole.held != bytewise.held
                || memcmp(whole.bytes, bytewise.bytes, whole.held)
                || memcmp(&whole.velocity, &bytewise.velocity, sizeof whole.velocity)) {
            fputs("whole and byte by byte differ\n", stderr);
            return 4;
        }
    }
    return 0;
}
