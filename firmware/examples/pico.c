/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The receiver on a Raspberry Pi Pico: UART0 (TX GP0, RX GP1) by interrupt, hardware watchdog.
 *
 * compiled: gcc 12.2 for Cortex-M0+, Pico SDK 2.2.0 (RP2040), no warnings
 * tried: on the host, with a simulated UART. Not tried on silicon.
 */
#include "hardware/irq.h"
#include "hardware/sync.h"
#include "hardware/uart.h"
#include "hardware/watchdog.h"
#include "pico/stdlib.h"
#include "vel2d_receiver.h"

#define LOOP_MS 30
#define HANG_MS 100                     /* resets an MCU that hangs */
#define UART_ERRORS 0xF00               /* overrun, break, parity, frame: with each byte */

void set_velocity(double x, double y, double omega);    /* yours: m/s, m/s, rad/s */

static vel2d_receiver receiver;

static uint32_t now_ms(void) { return to_ms_since_boot(get_absolute_time()); }

static void on_uart(void)
{
    while (uart_is_readable(uart0)) {
        uint32_t received = uart_get_hw(uart0)->dr;
        uint8_t byte = (uint8_t)received;
        if (received & UART_ERRORS)
            vel2d_idle(&receiver);
        else
            vel2d_feed(&receiver, &byte, 1, now_ms());
    }
}

static void start(void)
{
    vel2d_begin(&receiver, NULL);
    uart_init(uart0, 115200);
    gpio_set_function(0, GPIO_FUNC_UART);
    gpio_set_function(1, GPIO_FUNC_UART);
    irq_set_exclusive_handler(UART0_IRQ, on_uart);
    irq_set_enabled(UART0_IRQ, true);
    uart_set_irq_enables(uart0, true, false);
    watchdog_enable(HANG_MS, true);
}

static void control(void)
{
    static char text[VEL2D_REPORT];
    uint32_t interrupts = save_and_disable_interrupts();
    vel2d_velocity velocity = vel2d_now(&receiver, now_ms());
    size_t length = vel2d_report(&receiver, now_ms(), text);
    restore_interrupts(interrupts);
    set_velocity(velocity.x, velocity.y, velocity.omega);
    uart_write_blocking(uart0, (const uint8_t *)text, length);      /* 9 ms */
    watchdog_update();
}

int main(void)
{
    absolute_time_t next = get_absolute_time();
    start();
    for (;;) {
        control();
        next = delayed_by_ms(next, LOOP_MS);
        sleep_until(next);
    }
}
