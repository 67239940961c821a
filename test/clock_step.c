// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Preloaded into a process under test: its system clock is off by what the file $CLOCK_STEP holds
// (int64, seconds). The monotonic clock and everybody else's clocks stay as they are. Waits until
// a moment of the system clock go to a kernel that knows nothing of the step: they are put right.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

#define SINCE_BOOT 1000000000       // no machine runs for 30 years: larger is the system clock

static int64_t step(void) {
    static volatile int64_t *shared;
    if (!shared) {
        const char *path = getenv("CLOCK_STEP");
        int fd = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
        void *found = fd < 0 ? MAP_FAILED : mmap(0, sizeof *shared, PROT_READ, MAP_SHARED, fd, 0);
        static int64_t none;
        shared = found == MAP_FAILED ? &none : found;
    }
    return *shared;
}

static struct timespec real_until(const struct timespec *until) {
    struct timespec found = *until;
    if (found.tv_sec > SINCE_BOOT) found.tv_sec -= step();
    return found;
}

// The condition variables of today have a second version on x86-64; dlsym finds the first.
static void *next(const char *name) {
    void *found = dlvsym(RTLD_NEXT, name, "GLIBC_2.3.2");
    return found ? found : dlsym(RTLD_NEXT, name);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(clock, now);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) now->tv_sec += step();
    return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec found;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &found);
    now->tv_sec = found.tv_sec;
    now->tv_usec = found.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec found;
    clock_gettime(CLOCK_REALTIME, &found);
    if (now) *now = found.tv_sec;
    return found.tv_sec;
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict until) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real) real = next("pthread_cond_timedwait");
    struct timespec then = real_until(until);
    return real(condition, mutex, &then);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "sem_timedwait");
    struct timespec then = real_until(until);
    return real(semaphore, &then);
}
