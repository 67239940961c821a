/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * As much of the STM32 HAL (-Dstm32_hal), of Arduino (-Darduino, C++) and of the SDK of the Pico as
 * the examples of firmware/ need, on the host, on simulated time. The example is included as
 * the_example.c.
 * Input: "MS HEX" is what came until the line was idle, "MS error" an overrun, "MS busy" a
 * reception that HAL could not begin again, "MS end" the end.
 * Output: "MS X Y OMEGA" for each velocity that is set, and the lines for the host.
 */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LOOP_MS 30

static uint32_t now;
static void overrun(void);
static void busy(void);
static void receive(const uint8_t *bytes, size_t count);
void set_velocity(double x, double y, double omega);

void set_velocity(double x, double y, double omega)
{
    printf("%u %.17g %.17g %.17g\n", (unsigned)now, x, y, omega);
}

/* Let time pass and things happen; the program ends with its input. */
static void pass(uint32_t until)
{
    static int waits;
    static unsigned at;
    static char what[4096];
    for (;;) {
        if (!waits && scanf("%u %4095s", &at, what) != 2)
            exit(0);
        waits = at > until;
        if (waits)
            break;
        now = at;
        if (strcmp(what, "error") == 0) {
            overrun();
        } else if (strcmp(what, "busy") == 0) {
            busy();
        } else if (strcmp(what, "end") != 0) {
            uint8_t bytes[sizeof what / 2];
            size_t count = 0;
            for (unsigned byte; sscanf(what + 2 * count, "%2x", &byte) == 1;)
                bytes[count++] = (uint8_t)byte;
            receive(bytes, count);
        }
    }
    now = until;
}

#ifdef stm32_hal
enum { HAL_OK, HAL_BUSY, HAL_UART_STATE_READY = 0x20, HAL_UART_STATE_BUSY_RX = 0x22 };
typedef struct { void *hdmarx; uint32_t gState, RxState; } UART_HandleTypeDef;
typedef struct { int unused; } CRC_HandleTypeDef, IWDG_HandleTypeDef;
#define __HAL_DMA_DISABLE_IT(stream, what) ((void)(stream))

UART_HandleTypeDef huart6 = {NULL, HAL_UART_STATE_READY, HAL_UART_STATE_READY};
CRC_HandleTypeDef hcrc;
IWDG_HandleTypeDef hiwdg;
static uint8_t *buffer;
static uint16_t room;
static int interrupts = 1;

static uint32_t HAL_GetTick(void) { return now; }
static void __disable_irq(void) { interrupts = 0; }
static void __enable_irq(void) { interrupts = 1; }

static int HAL_UARTEx_ReceiveToIdle_DMA(UART_HandleTypeDef *uart, uint8_t *data, uint16_t size)
{
    if (uart->RxState != HAL_UART_STATE_READY)
        return HAL_BUSY;
    uart->RxState = HAL_UART_STATE_BUSY_RX;
    buffer = data;
    room = size;
    return HAL_OK;
}

static int HAL_UART_Transmit_IT(UART_HandleTypeDef *uart, const uint8_t *text, uint16_t size)
{
    (void)uart;
    fwrite(text, 1, size, stdout);
    return HAL_OK;
}

static int HAL_IWDG_Refresh(IWDG_HandleTypeDef *unit) { (void)unit; return HAL_OK; }

/* The unit of an F4: words, the most significant bit first. */
static uint32_t HAL_CRC_Calculate(CRC_HandleTypeDef *unit, uint32_t words[], uint32_t count)
{
    uint32_t crc = 0xFFFFFFFF;
    (void)unit;
    while (count--) {
        crc ^= *words++;
        for (int bit = 0; bit < 32; bit++)
            crc = crc << 1 ^ (crc >> 31 ? 0x04C11DB7 : 0);
    }
    return crc;
}

#include "the_example.c"

static void overrun(void)
{
    huart6.RxState = HAL_UART_STATE_READY;
    HAL_UART_ErrorCallback(&huart6);
}

static void busy(void) { huart6.RxState = HAL_UART_STATE_READY; }

static void receive(const uint8_t *bytes, size_t count)
{
    while (count && huart6.RxState == HAL_UART_STATE_BUSY_RX) {
        uint16_t size = count < room ? (uint16_t)count : room;
        memcpy(buffer, bytes, size);
        bytes += size;
        count -= size;
        huart6.RxState = HAL_UART_STATE_READY;
        HAL_UARTEx_RxEventCallback(&huart6, size);
    }
}

int main(void)
{
    vel2d_start();
    for (uint32_t loop = LOOP_MS;; loop += LOOP_MS) {
        pass(loop);
        vel2d_control();
        if (!interrupts)
            return 1;
    }
}
#elif defined arduino
enum { LED = 13, OUTPUT = 1 };
enum PinStatus { LOW, HIGH };                   /* some cores take no bool for it */
#define LED_BUILTIN LED
#define ROOM 63                                 /* as an AVR: a report does not fit */

static uint32_t millis() { return now; }
static void pinMode(int pin, int mode) { if (pin != LED || mode != OUTPUT) exit(1); }
static void digitalWrite(int pin, PinStatus) { if (pin != LED) exit(1); }

static struct {
    const uint8_t *arrived, *end;
    int room;
    size_t length;
    char line[128];
    int available() { return (int)(end - arrived); }
    int read() { return *arrived++; }
    int availableForWrite() { return room; }
    void begin(unsigned long baud) { if (baud != 115200) exit(1); }

    void write(uint8_t byte)
    {
        if (!room--)
            exit(1);                            /* it would wait */
        line[length++] = (char)byte;
        if (byte != '\n')
            return;
        fwrite(line, 1, length, stdout);
        length = 0;
    }
} Serial;

#include "the_example.c"

static void receive(const uint8_t *bytes, size_t count)
{
    Serial.arrived = bytes;
    Serial.end = bytes + count;
    loop();
}

static void overrun() {}
static void busy() {}

int main()
{
    setup();
    for (uint32_t turn = 1;; turn++) {
        pass(turn);
        if (turn % 6 == 0)
            Serial.room = ROOM;
        loop();
    }
}
#else
enum { false, true, GPIO_FUNC_UART, UART0_IRQ };
typedef uint32_t absolute_time_t;
typedef struct { uint32_t dr; } uart_hw_t;
static uart_hw_t uart_registers;
static uart_hw_t *const uart0 = &uart_registers;
static const uint8_t *arrived, *arrived_end;
static uint32_t flags;                          /* the next byte has them */
static void (*handler)(void);

static absolute_time_t get_absolute_time(void) { return now; }
static uint32_t to_ms_since_boot(absolute_time_t time) { return time; }
static absolute_time_t delayed_by_ms(absolute_time_t time, uint32_t ms) { return time + ms; }
static void sleep_until(absolute_time_t time) { pass(time); }
static uint32_t save_and_disable_interrupts(void) { return 7; }
static void restore_interrupts(uint32_t before) { if (before != 7) exit(1); }
static void uart_init(uart_hw_t *uart, unsigned baud) { if (!uart || baud != 115200) exit(1); }
static void gpio_set_function(unsigned pin, int function) { (void)pin; (void)function; }
static void irq_set_exclusive_handler(int irq, void (*to)(void)) { (void)irq; handler = to; }
static void irq_set_enabled(int irq, int on) { if (irq != UART0_IRQ || !on) exit(1); }
static void uart_set_irq_enables(uart_hw_t *uart, int rx, int tx) { if (!uart || !rx || tx) exit(1); }
static void watchdog_enable(uint32_t ms, int pause) { (void)ms; (void)pause; }
static void watchdog_update(void) {}
static int uart_is_readable(uart_hw_t *uart) { (void)uart; return arrived < arrived_end; }

static uart_hw_t *uart_get_hw(uart_hw_t *uart)
{
    uart->dr = *arrived++ | flags;
    flags = 0;
    return uart;
}

static void uart_write_blocking(uart_hw_t *uart, const uint8_t *text, size_t size)
{
    (void)uart;
    fwrite(text, 1, size, stdout);
}

#define main example_main
#include "the_example.c"
#undef main

static void receive(const uint8_t *bytes, size_t count)
{
    arrived = bytes;
    arrived_end = bytes + count;
    handler();
}

static void overrun(void) { flags = 0x800; }
static void busy(void) {}

int main(void) { return example_main(); }
#endif
