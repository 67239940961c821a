/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * As much of the STM32 HAL as the watchdog of docs/frame.md needs, on the host, on simulated time.
 * Input: "MS HEX" is what came until the line was idle, "MS error" an overrun, "MS end" the end.
 * Output: "MS X Y OMEGA" for each velocity that is set.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define LOOP_MS 30                              /* between two poses */

typedef struct { int unused; } UART_HandleTypeDef;
typedef struct { int unused; } CRC_HandleTypeDef;

static UART_HandleTypeDef huart;
static CRC_HandleTypeDef hcrc;
static uint32_t now;
static uint8_t *buffer;                         /* where a reception goes, NULL: none is armed */
static uint16_t room;

static uint32_t HAL_GetTick(void) { return now; }

static int HAL_UARTEx_ReceiveToIdle_IT(UART_HandleTypeDef *uart, uint8_t *data, uint16_t size) {
    (void)uart;
    buffer = data;
    room = size;
    return 0;
}

static uint32_t HAL_CRC_Calculate(CRC_HandleTypeDef *unit, uint32_t *words, uint32_t length) {
    const uint8_t *data = (const uint8_t *)words;
    uint32_t crc = 0xFFFFFFFF;
    (void)unit;
    while (length--) {
        crc ^= (uint32_t)*data++ << 24;
        for (int bit = 0; bit < 8; bit++)
            crc = crc << 1 ^ (crc >> 31 ? 0x04C11DB7 : 0);
    }
    return crc;
}

static void set_velocity(double x, double y, double omega) {
    printf("%u %.17g %.17g %.17g\n", (unsigned)now, x, y, omega);
}

#include "watchdog.c"

static void receive(const char *text) {
    uint16_t size = 0;
    unsigned byte;
    if (buffer == NULL)                         /* deaf */
        return;
    while (size < room && sscanf(text + 2 * size, "%2x", &byte) == 1)
        buffer[size++] = (uint8_t)byte;
    buffer = NULL;
    HAL_UARTEx_RxEventCallback(&huart, size);
}

int main(void) {
    unsigned at;
    char what[256];
    uint32_t loop = LOOP_MS;
    listen();
    while (scanf("%u %255s", &at, what) == 2) {
        for (; loop <= at; loop += LOOP_MS) {
            now = loop;
            watchdog();
        }
        now = at;
        if (strcmp(what, "error") == 0) {
            buffer = NULL;
            HAL_UART_ErrorCallback(&huart);
        } else if (strcmp(what, "end") != 0) {
            receive(what);
        }
    }
    return 0;
}
