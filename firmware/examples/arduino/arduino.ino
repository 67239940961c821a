/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The receiver on an Arduino: Nano Every, Uno, Mega, ESP32, RP2040, Teensy.
 *
 * compiled: avr-gcc 5.4, Arduino AVR core 1.8.7 (Uno, Mega); gcc 12.2, Teensy core 2026-06 (4.0)
 * tried: on the host, and on a simulated ATmega328P with the bridge. Not tried on silicon.
 *
 * It sets no hardware watchdog: each family of boards has another one.
 */
#include <vel2d_receiver.h>

#define LINE Serial                     /* USB; Serial1: pins of most boards */

static vel2d_receiver receiver;

/* Yours: m/s forward, m/s left, rad/s counter-clockwise. It must return within 20 ms. */
static void drive(double x, double y, double omega)
{
#ifdef LED_BUILTIN
    digitalWrite(LED_BUILTIN, x != 0 || y != 0 || omega != 0 ? HIGH : LOW);
#endif
}

/* No more than came by now, so that no flood keeps loop() from the watchdog. */
static void feed()
{
    for (int count = LINE.available(); count > 0; count--) {
        uint8_t byte = (uint8_t)LINE.read();
        vel2d_feed(&receiver, &byte, 1, millis());
    }
}

/* No more than there is room for: it never waits. A core that names none (mbed) sends nothing. */
static void report()
{
    static char text[VEL2D_REPORT];
    static size_t length, sent;
    if (sent == length) {
        length = vel2d_report(&receiver, millis(), text);
        sent = 0;
    }
    for (int room = LINE.availableForWrite(); room > 0 && sent < length; room--)
        LINE.write((uint8_t)text[sent++]);
}

void setup()
{
    vel2d_settings settings = VEL2D_DEFAULTS;
    settings.most.x = settings.most.y = 0.55;           /* of your rover: more is refused */
    settings.most.omega = 1.76;
    settings.gap_ms = 20;               /* more than a turn of loop() takes */
    vel2d_begin(&receiver, &settings);
#ifdef LED_BUILTIN
    pinMode(LED_BUILTIN, OUTPUT);
#endif
    LINE.begin(115200);                 /* the parameter baud of the bridge */
}

void loop()
{
    feed();
    vel2d_velocity velocity = vel2d_now(&receiver, millis());
    drive(velocity.x, velocity.y, velocity.omega);
    report();
}
