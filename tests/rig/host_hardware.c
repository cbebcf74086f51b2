/* Board file of serial_bench.c for this computer: file descriptor 0 is the line, and arms generated from a model move.
 *
 * With -DSPOILT=N every N-th frame has a wrong byte, and every N-th after its half is cut.
 */
#define _GNU_SOURCE
#include "plant.h"
#include "serial_bench.h"
#include <poll.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#ifndef SPOILT
#define SPOILT 0
#endif

static double state[2 * ARMS + 2];
static struct timespec due;

static double left(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    if (!due.tv_sec) due = now;
    return (due.tv_sec - now.tv_sec) + 1e-9 * (due.tv_nsec - now.tv_nsec);
}

int hardware_due(void) {
    struct pollfd line = {0, POLLIN, 0};
    double wait = left();
    if (wait > 0) {
        struct timespec most = {0, (long)(1e9 * wait)};
        ppoll(&line, 1, &most, NULL);
        /* Nobody has the other end open. */
        if (!(line.revents & POLLIN) && left() > 0) clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        if (left() > 0) return 0;
    }
    due.tv_nsec += (long)(1e9 * PERIOD);
    if (due.tv_nsec >= 1000000000) due.tv_nsec -= 1000000000, due.tv_sec++;
    return 1;
}

int hardware_receive(void) {
    struct pollfd line = {0, POLLIN, 0};
    uint8_t byte;
    return poll(&line, 1, 0) == 1 && (line.revents & POLLIN) && read(0, &byte, 1) == 1 ? byte : -1;
}

void hardware_transmit(const uint8_t *data, int size) {
    static int count;
    uint8_t copy[512];
    memcpy(copy, data, size);
    count++;
    if (SPOILT && count % SPOILT == 0) copy[size / 2] ^= 0x40;
    if (SPOILT && count % SPOILT == SPOILT / 2) size /= 2;
    if (write(0, copy, size) != size) return;
}

int hardware_exchange(double acceleration, double velocity, double positions[ARMS + 1]) {
    casadi_int iw[plant_SZ_IW + 1];
    double next[2 * ARMS + 2], w[plant_SZ_W + 1];
    const double *arg[plant_SZ_ARG] = {state, &acceleration};
    double *res[plant_SZ_RES] = {next};
    (void)velocity;
    memcpy(positions, state, ARMS * sizeof *state);
    positions[ARMS] = state[2 * ARMS];
    plant(arg, res, iw, w, 0);
    memcpy(state, next, sizeof state);
    return 0;
}
