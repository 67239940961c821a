/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* The UART of an ATmega328P of 16 MHz as stdin and stdout of values.c, 115200 baud. */
#include <avr/io.h>
#include <stdio.h>

static int put(char byte, FILE *stream)
{
    (void)stream;
    loop_until_bit_is_set(UCSR0A, UDRE0);
    UDR0 = (uint8_t)byte;
    return 0;
}

static int get(FILE *stream)
{
    (void)stream;
    loop_until_bit_is_set(UCSR0A, RXC0);
    return UDR0;
}

static void __attribute__((constructor)) begin(void)
{
    UBRR0 = 16;
    UCSR0A = 1 << U2X0;
    UCSR0B = 1 << RXEN0 | 1 << TXEN0;
    fdevopen(put, get);
}
