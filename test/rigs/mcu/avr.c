/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * avr PROGRAM.elf: an ATmega328P of 16 MHz (simavr), its UART and the LED of an Arduino Uno.
 *
 * Input: "MS HEX" is what comes to its UART then, "MS reset", "MS end".
 * Output: "MS TEXT" is a line that it sends, "MS led 0" or 1 its LED when that changes.
 *
 * avr PROGRAM.elf pty: in real time; its UART is a pty, "0 pty PATH". Input: a line resets it.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define CYCLES_PER_MS 16000
#define BOOTLOADER_MS 1000              /* after a reset: what comes is not for the program */

static avr_t *avr;
static avr_irq_t *input;
static int line_fd = -1;

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
    if (line_fd >= 0 && write(line_fd, &byte, 1) != 1)
        exit(1);
    if (byte == '\n' || length == sizeof line - 1) {
        printf("%u %s\n", now(), line);
        memset(line, 0, sizeof line);
        length = 0;
    } else if (byte != '\r') {
        line[length++] = (char)byte;
    }
}

static void run_until(unsigned ms)
{
    while (now() < ms)
        if (avr_run(avr) == cpu_Crashed)
            exit(1);
}

static void handle(const char *what)
{
    unsigned byte;
    if (strcmp(what, "reset") == 0)
        avr_reset(avr);
    else
        for (; sscanf(what, "%2x", &byte) == 1 && strcmp(what, "end"); what += 2)
            avr_raise_irq(input, byte);
}

static void run_scripted(void)
{
    unsigned at;
    char what[256];
    while (scanf("%u %255s", &at, what) == 2) {
        run_until(at);
        handle(what);
    }
}

static unsigned host_ms(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (unsigned)(time.tv_sec * 1000 + time.tv_nsec / 1000000);
}

static void run_on_pty(void)
{
    struct pollfd ready[2] = {{0, POLLIN, 0}, {posix_openpt(O_RDWR | O_NOCTTY), POLLIN, 0}};
    unsigned begin = host_ms();
    uint8_t bytes[32];
    line_fd = ready[1].fd;
    grantpt(line_fd);
    unlockpt(line_fd);
    open(ptsname(line_fd), O_RDWR | O_NOCTTY);          /* else the line ends with its first user */
    printf("0 pty %s\n", ptsname(line_fd));
    for (;;) {
        poll(ready, 2, host_ms() - begin < now());
        if (ready[1].revents) {
            ssize_t count = read(line_fd, bytes, sizeof bytes);
            for (ssize_t at = 0; at < count; at++)
                avr_raise_irq(input, bytes[at]);
        }
        if (ready[0].revents) {
            if (read(0, bytes, sizeof bytes) <= 0)
                return;
            avr_reset(avr);
            usleep(1000 * BOOTLOADER_MS);
            tcflush(line_fd, TCIFLUSH);
            begin = host_ms() - now();
        }
        run_until(now() + 1);
    }
}

int main(int count, char **options)
{
    elf_firmware_t program = {0};
    uint32_t flags = 0;
    if (count < 2 || elf_read_firmware(options[1], &program))
        return 1;
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->frequency = 1000 * CYCLES_PER_MS;
    avr_load_firmware(avr, &program);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT),
                            on_byte, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 5), on_led, NULL);
    setlinebuf(stdout);
    (count == 3 ? run_on_pty : run_scripted)();
    return 0;
}
