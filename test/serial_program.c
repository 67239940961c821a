/* Copyright 2026 The mecarover_serial authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * A program for test_strace.py: a thread that polls and reads, write and writev, a change of the
 * rate, a copied descriptor, two children (one runs this file again) and a burst. PORT TURNS.
 */
#define _DEFAULT_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#define BURST 6000

static int port;
static long wanted, got;

static void *hear(void *unused)
{
    struct pollfd watched = {port, POLLIN, 0};
    char data[512];
    while (got < wanted && poll(&watched, 1, 10000) > 0) {
        long size = read(port, data, sizeof data);
        got += size > 0 ? size : 0;
    }
    return unused;
}

static void say(int where, const char *text, int turns)
{
    for (int at = 0; at < turns; at++)
        if (write(where, text, strlen(text)) < 0)
            exit(1);
}

int main(int count, char **arguments)
{
    int turns = atoi(arguments[2]);
    if (count > 3) {
        say(atoi(arguments[3]), "run again", turns);
        return 0;
    }
    port = open(arguments[1], O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios settings;
    tcgetattr(port, &settings);
    cfmakeraw(&settings);
    cfsetspeed(&settings, B1000000);
    tcsetattr(port, TCSANOW, &settings);
    tcflush(port, TCIOFLUSH);
    wanted = turns * (6 + 5 + 5 + 9) + BURST;
    pthread_t thread;
    pthread_create(&thread, NULL, hear, NULL);
    say(port, "write!", turns);
    for (int at = 0; at < turns; at++) {
        unsigned char head[] = {0xff, 0xff, at}, rest[] = {'\n', '\\'};
        struct iovec parts[] = {{head, 3}, {rest, 2}};
        if (writev(port, parts, 2) != 5)
            return 1;
    }
    cfsetspeed(&settings, B57600);
    tcsetattr(port, TCSADRAIN, &settings);
    int copy = dup(port);
    if (fork() == 0) {
        say(copy, "child", turns);
        _exit(0);
    }
    wait(NULL);
    if (fork() == 0) {
        char number[12];
        sprintf(number, "%d", copy);
        execl(arguments[0], arguments[0], "", arguments[2], number, NULL);
    }
    wait(NULL);
    static char burst[BURST];
    for (long at = 0, size; at < BURST; at += size > 0 ? size : 0)
        size = write(port, burst + at, BURST - at);
    pthread_join(thread, NULL);
    close(copy);
    close(port);
    return got == wanted ? 7 : 1;
}
