/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * An MCU with firmware/ for the emulated STM32F405: interrupt for each byte, SysTick, a control
 * loop of 30 ms. USART1 is the line to the host; USART2 says what happens, a line each:
 *
 *     G TICK VELOCITY      a good frame came (24 bytes in hex)
 *     W TICK VELOCITY      the wheels change
 *     M SIZE FEED NOW REPORT      bytes of the receiver in RAM, and of stack that each call takes
 *     V BYTES FRAMES WRONG BAD    with -DVOLUME=BYTES, before all else: damaged bytes from RAM
 */
#ifdef VOLUME
#include "volume.h"
#endif
#include "vel2d_receiver.h"

#define LOOP_MS 30
#define CLOCK_HZ 168000000u
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SYST_CSR REGISTER(0xE000E010)
#define SYST_RVR REGISTER(0xE000E014)
#define SYST_CVR REGISTER(0xE000E018)
#define NVIC_ISER1 REGISTER(0xE000E104)
#define CPACR REGISTER(0xE000ED88)
#define USART1 0x40011000
#define USART2 0x40004400
#define SR(usart) REGISTER(usart)
#define DR(usart) REGISTER((usart) + 4)
#define CR1(usart) REGISTER((usart) + 12)
#define RXNE (1u << 5)
#define TXE (1u << 7)
#define UE_TE_RE (1u << 13 | 1u << 3 | 1u << 2)
#define RXNEIE (1u << 5)
#define KEPT 64                         /* good frames between two turns of the loop */
#define PAINT 0xC0FFEE00u
#define PAINTED 256                     /* words */

extern uint32_t data_start[], data_end[], data_load[], bss_start[], bss_end[], stack_top[];
int main(void);

static volatile uint32_t ticks;
static vel2d_receiver receiver;
static struct { uint32_t tick; vel2d_velocity velocity; } good[KEPT];
static volatile uint32_t good_in;

static void say(const char *text, size_t size)
{
    while (size--) {
        while (!(SR(USART2) & TXE)) {}
        DR(USART2) = (uint8_t)*text++;
    }
}

static void say_number(uint32_t number)
{
    char digits[11];
    unsigned at = sizeof digits;
    do
        digits[--at] = (char)('0' + number % 10);
    while (number /= 10);
    digits[--at] = ' ';
    say(digits + at, sizeof digits - at);
}

static void say_velocity(const char *what, uint32_t tick, const vel2d_velocity *velocity)
{
    const uint8_t *bytes = (const uint8_t *)velocity;
    say(what, 1);
    say_number(tick);
    say(" ", 1);
    for (unsigned at = 0; at < VEL2D_VALUES; at++) {
        say(&"0123456789abcdef"[bytes[at] >> 4], 1);
        say(&"0123456789abcdef"[bytes[at] & 15], 1);
    }
    say("\n", 1);
}

static void on_tick(void) { ticks++; }

static void on_usart1(void)
{
    while (SR(USART1) & RXNE) {
        uint8_t byte = (uint8_t)DR(USART1);
        uint32_t before = receiver.good;
        vel2d_feed(&receiver, &byte, 1, ticks);
        if (receiver.good != before) {
            good[good_in % KEPT].tick = ticks;
            good[good_in % KEPT].velocity = receiver.velocity;
            good_in++;
        }
    }
}

/* Stack that one call takes: paint what is below, call, look how far the paint is gone. */
static __attribute__((noinline)) void call(int what, vel2d_receiver *it, uint8_t *frame)
{
    static char text[VEL2D_REPORT];
    if (what == 0)
        vel2d_feed(it, frame, VEL2D_FRAME, 0);
    else if (what == 1)
        vel2d_now(it, 320);
    else
        vel2d_report(it, 0, text);
}

static __attribute__((noinline)) uint32_t stack_of(int what, vel2d_receiver *it, uint8_t *frame)
{
    volatile uint32_t *low, *here;
    __asm volatile("mov %0, sp" : "=r"(here));
    for (low = here - PAINTED; low < here; low++)
        *low = PAINT;
    call(what, it, frame);
    for (low = here - PAINTED; *low == PAINT;)
        low++;
    return (uint32_t)(here - low) * 4;
}

static void measure(void)
{
    static vel2d_receiver it;
    static uint8_t frame[VEL2D_FRAME];
    vel2d_settings settings = VEL2D_DEFAULTS;
    uint32_t crc;
    settings.ramp_ms = 100;
    vel2d_begin(&it, &settings);
    frame[7] = 0x3F;                    /* a small number, so that there is a ramp */
    crc = vel2d_crc_bytes(frame);
    for (unsigned at = 0; at < 4; at++)
        frame[VEL2D_VALUES + at] = (uint8_t)(crc >> 8 * at);
    say("M", 1);
    say_number(sizeof it);
    for (int what = 0; what < 3; what++)
        say_number(stack_of(what, &it, frame));
    say("\n", 1);
}

#ifdef VOLUME
static void volume(void)
{
    uint32_t bytes = 0, wrong = 0;
    vel2d_begin(&receiver, NULL);
    while (bytes < VOLUME) {
        piece it;
        next_piece(&it, vel2d_crc_bytes);
        bytes += it.size;
        for (unsigned at = 0; at < it.size; at++) {
            uint32_t before = receiver.good;
            vel2d_feed(&receiver, it.bytes + at, 1, 0);
            wrong += receiver.good != before && !was_sent(&receiver.velocity);
        }
        if (it.is_idle)
            vel2d_idle(&receiver);
    }
    say("V", 1);
    say_number(bytes);
    say_number(receiver.good);
    say_number(wrong);
    say_number(receiver.bad);
    say("\n", 1);
}
#endif

int main(void)
{
    vel2d_velocity last = {0, 0, 0};
    uint32_t good_out = 0, next = 0;
    CR1(USART2) = UE_TE_RE;
    measure();
#ifdef VOLUME
    volume();
#endif
    vel2d_begin(&receiver, NULL);
    SYST_RVR = CLOCK_HZ / 1000 - 1;
    SYST_CVR = 0;
    SYST_CSR = 7;
    CR1(USART1) = UE_TE_RE | RXNEIE;
    NVIC_ISER1 = 1u << (37 - 32);
    for (;;) {
        static char text[VEL2D_REPORT];
        vel2d_velocity velocity;
        uint32_t tick, good_until;
        size_t length;
        while ((int32_t)(ticks - next) < 0)
            __asm volatile("wfi");
        next += LOOP_MS;
        __asm volatile("cpsid i" ::: "memory");
        tick = ticks;
        velocity = vel2d_now(&receiver, tick);
        length = vel2d_report(&receiver, tick, text);
        good_until = good_in;
        __asm volatile("cpsie i" ::: "memory");
        for (; good_out != good_until; good_out++)
            say_velocity("G", good[good_out % KEPT].tick, &good[good_out % KEPT].velocity);
        if (velocity.x != last.x || velocity.y != last.y || velocity.omega != last.omega)
            say_velocity("W", tick, &velocity);
        last = velocity;
        for (size_t at = 0; at < length; at++) {
            while (!(SR(USART1) & TXE)) {}
            DR(USART1) = (uint8_t)text[at];
        }
    }
}

void reset(void);
void reset(void)
{
    uint32_t *from = data_load;
    for (uint32_t *to = data_start; to < data_end;)
        *to++ = *from++;
    for (uint32_t *to = bss_start; to < bss_end;)
        *to++ = 0;
    CPACR |= 0xF00000;                  /* the FPU is on */
    __asm volatile("dsb\n isb");
    main();
}

static void hang(void) { say("F\n", 2); for (;;) {} }

__attribute__((section(".vectors"), used)) static void (*const vectors[16 + 38])(void) = {
    (void (*)(void))stack_top, reset, hang, hang, hang, hang, hang, [15] = on_tick,
    [16 + 37] = on_usart1};
