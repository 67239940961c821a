/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * avr PROGRAM.elf: an ATmega328P of 16 MHz (simavr), its UART and the LED of an Arduino Uno.
 *
 * Input: "MS HEX" is what comes to its UART then, "MS reset", "MS end".
 * Output: "MS TEXT" is a line that it sends, "MS led 0" or 1 its LED when that changes.
 */
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <string.h>

#define CYCLES_PER_MS 16000

static avr_t *avr;

static unsigned now(void) { return (unsigned)(avr->cycle / CYCLES_PER_MS); }

static void on_led(struct avr_irq_t *irq, uint32_t value, void *nothing)
{
    (void)irq;
    (void)nothing;
    printf("%u led %u\n", now(), (unsigned)value);
}

static void on_byte(struct avr_irq_t *irq, uint32_t byte, void *nothing)
{
    static char line[256];
    static size_t length;
    (void)irq;
    (void)nothing;
    if (byte == '\n' || length == sizeof line - 1) {
        printf("%u %s\n", now(), line);
        memset(line, 0, sizeof line);
        length = 0;
    } else if (byte != '\r') {
        line[length++] = (char)byte;
    }
}

static void handle(const char *what)
{
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    unsigned byte;
    if (strcmp(what, "reset") == 0)
        avr_reset(avr);
    else
        for (; sscanf(what, "%2x", &byte) == 1 && strcmp(what, "end"); what += 2)
            avr_raise_irq(input, byte);
}

int main(int count, char **options)
{
    elf_firmware_t program = {0};
    uint32_t flags = 0;
    unsigned at;
    char what[256];
    if (count != 2 || elf_read_firmware(options[1], &program))
        return 1;
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->frequency = 1000 * CYCLES_PER_MS;
    avr_load_firmware(avr, &program);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT),
                            on_byte, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 5), on_led, NULL);
    while (scanf("%u %255s", &at, what) == 2) {
        while (now() < at)
            if (avr_run(avr) == cpu_Crashed)
                return 1;
        handle(what);
    }
    return 0;
}
