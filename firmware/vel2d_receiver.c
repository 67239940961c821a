/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A frame has no sync word. It is the last 28 bytes without a pause whose CRC is right: so a byte
 * that is lost, damaged or too many costs the frame it is in, and none after it.
 */
#include <float.h>

#include "vel2d_receiver.h"

#define REPORT_MS 1000

/* Where a double has the 4 bytes of a float (AVR), the 8 of the frame become these. */
#ifndef VEL2D_FLOAT
#define VEL2D_FLOAT (DBL_MANT_DIG == FLT_MANT_DIG)
#endif

static const vel2d_settings DEFAULTS = VEL2D_DEFAULTS;
static const vel2d_velocity STOP = {0, 0, 0};

/* CRC-32/MPEG-2: four bits at once; order 3 takes the bytes of each word from the last on. */
static uint32_t crc32_mpeg2(const uint8_t *values, unsigned order)
{
    static const uint32_t table[16] = {
        0x00000000, 0x04C11DB7, 0x09823B6E, 0x0D4326D9, 0x130476DC, 0x17C56B6B, 0x1A864DB2,
        0x1E475005, 0x2608EDB8, 0x22C9F00F, 0x2F8AD6D6, 0x2B4BCB61, 0x350C9B64, 0x31CD86D3,
        0x3C8EA00A, 0x384FBDBD};
    uint32_t crc = 0xFFFFFFFF;
    for (unsigned at = 0; at < VEL2D_VALUES; at++) {
        uint8_t byte = values[at ^ order];
        crc = crc << 4 ^ table[crc >> 28 ^ byte >> 4];
        crc = crc << 4 ^ table[crc >> 28 ^ (byte & 15)];
    }
    return crc;
}

uint32_t vel2d_crc_bytes(const uint8_t *values) { return crc32_mpeg2(values, 0); }
uint32_t vel2d_crc_words(const uint8_t *values) { return crc32_mpeg2(values, 3); }

static uint32_t word(const uint8_t *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16
        | (uint32_t)bytes[3] << 24;
}

/* Read a double; 0: too large or not finite. By its bits: -ffast-math takes NaN for a number. */
static int read_value(const uint8_t *bytes, double most, double *value)
{
    uint32_t high = word(bytes + 4), low = word(bytes), size = high & 0x7FFFFFFF;
#if VEL2D_FLOAT
    const uint32_t largest = 0x47EFFFFF, smallest = 0x38100000;     /* below 2^128, 2^-126 */
    union { uint32_t bits; float value; } it;
    it.bits = high & 0x80000000;
    if (size >= smallest && size <= largest)
        it.bits |= (size - 0x38000000) << 3 | low >> 29;    /* toward zero: no more than was sent */
#else
    const uint32_t largest = 0x7FEFFFFF;
    union { uint64_t bits; double value; } it;
    it.bits = (uint64_t)high << 32 | low;
#endif
    *value = it.value;
    return size <= largest && it.value <= most && it.value >= -most;
}

static void take_frame(vel2d_receiver *r, uint32_t now_ms)
{
    const vel2d_velocity *most = &r->settings.most;
    vel2d_velocity wanted;
    if (!read_value(r->bytes, most->x, &wanted.x) || !read_value(r->bytes + 8, most->y, &wanted.y)
            || !read_value(r->bytes + 16, most->omega, &wanted.omega)) {
        r->refused++;
        return;
    }
    r->good++;
    r->velocity = wanted;
    r->good_at = now_ms;
    r->state = VEL2D_RUNNING;
}

static void note_damage(vel2d_receiver *r)
{
    r->bad += !r->is_damaged;
    r->is_damaged = 1;
}

void vel2d_begin(vel2d_receiver *r, const vel2d_settings *settings)
{
    static const vel2d_receiver nothing;
    *r = nothing;
    r->settings = settings ? *settings : DEFAULTS;
}

void vel2d_feed(vel2d_receiver *r, const uint8_t *bytes, size_t count, uint32_t now_ms)
{
    if (now_ms - r->byte_at > r->settings.gap_ms)
        vel2d_idle(r);
    while (count--) {
        r->byte_at = now_ms;
        r->bytes[r->held++] = *bytes++;
        if (r->held < VEL2D_FRAME)
            continue;
        if (r->settings.crc(r->bytes) == word(r->bytes + VEL2D_VALUES)) {
            r->held = r->is_damaged = 0;
            take_frame(r, now_ms);
        } else {
            note_damage(r);
            r->held--;
            for (unsigned at = 0; at < r->held; at++)
                r->bytes[at] = r->bytes[at + 1];
        }
    }
}

void vel2d_idle(vel2d_receiver *r)
{
    if (r->held)
        note_damage(r);
    r->held = r->is_damaged = 0;
}

vel2d_velocity vel2d_now(vel2d_receiver *r, uint32_t now_ms)
{
    /* Signed: a frame may have come after the caller read the clock. */
    if (r->state == VEL2D_RUNNING
            && (int32_t)(now_ms - r->good_at) >= (int32_t)r->settings.watchdog_ms) {
        r->state = VEL2D_STOPPED;
        r->stopped_at = now_ms;
        r->stops++;
    }
    if (r->state == VEL2D_STOPPED) {
        uint32_t passed = now_ms - r->stopped_at, ramp = r->settings.ramp_ms;
        if (passed < ramp) {
            double share = (double)(ramp - passed) / (double)ramp;
            vel2d_velocity slower = {r->velocity.x * share, r->velocity.y * share,
                                     r->velocity.omega * share};
            return slower;
        }
        r->velocity = STOP;             /* for good, however often the clock wraps around */
    }
    return r->velocity;
}

static char *put_text(char *to, const char *text)
{
    while (*text)
        *to++ = *text++;
    return to;
}

static char *put_number(char *to, uint32_t number)
{
    char digits[10];
    unsigned count = 0;
    do
        digits[count++] = (char)('0' + number % 10);
    while (number /= 10);
    while (count)
        *to++ = digits[--count];
    return to;
}

size_t vel2d_report(vel2d_receiver *r, uint32_t now_ms, char *text)
{
    static const char *const states[] = {": waiting, ", ": running, ", ": stopped, "};
    char *end = text;
    if (r->has_reported && r->reported == r->state && now_ms - r->reported_at < REPORT_MS)
        return 0;
    r->has_reported = 1;
    r->reported = r->state;
    r->reported_at = now_ms;
    end = put_number(put_text(end, "vel2d receiver "), VEL2D_VERSION);
    end = put_number(put_text(end, states[r->state]), r->good);
    end = put_number(put_text(end, " good, "), r->bad);
    end = put_number(put_text(end, " bad, "), r->refused);
    end = put_number(put_text(end, " refused, "), r->stops);
    end = put_text(end, " stops\r\n");
    return (size_t)(end - text);
}
