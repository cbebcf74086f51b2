/* Gives hostile numbers to every function of the exported header, and reports what must not happen.
 *
 *     ./hostile STEPS SEED
 *
 * Readings are those of the reference, with values that are no numbers, too large, tiny, or far away among them. All
 * commands must be finite and within DPC_ACCELERATION. Every CHECK_EVERY steps, copies of the controller get readings
 * that must stop the cart: an answer of the limit switch, no reading, one position that is never a number, a cart
 * that runs off its track, one that is read beyond its end. Prints what was done; exits with 1 after the first fault.
 */
#include "dpc_controller.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define CHECK_EVERY 400
#define AFTER_STOP 60    /* steps after a stop, until a new run begins */
#define STOPS_WITHIN 2.0 /* s */
#define RUNS_OFF 0.5     /* m/s */
#define BEYOND 1.0       /* m */

static const double odd[] = {
    NAN, INFINITY, -INFINITY, 1e38, -1e38, 3.5e38, 1e308, -1e308, 1e20, 1e6, DPC_FARTHEST, -DPC_FARTHEST, 9999.9, -1e3, 100,
    -10, 6.283185307179586, -3.14159, 0.5, -0.05, 1e-3, 1e-40, -1e-45, 1e-310, 0.0, -0.0
};
static const long ticks[] = { LONG_MIN, -1, 0, 1, DPC_TICKS - 1, DPC_TICKS, LONG_MAX - DPC_LEAD, LONG_MAX };
static unsigned long long state;

/* xorshift64* of Marsaglia and Vigna; the upper bits are good. */
static unsigned drawn(unsigned below)
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return (unsigned)(state * 2685821657736338717ULL >> 33) % below;
}

static double hostile(void)
{
    return odd[drawn(sizeof odd / sizeof *odd)];
}

static dpc_reading of_reference(long tick)
{
    dpc_real row[DPC_STATES];
    dpc_reading reading = { { 0 }, { 0 }, 0, 0 };
    int i;

    dpc_reference(tick, row);
    for (i = 0; i < DPC_POSITIONS; i++) {
        reading.positions[i] = (double)row[i < DPC_ARMS ? i : 2 * DPC_ARMS] + 1e-5 * ((int)drawn(3) - 1);
        reading.present[i] = 1;
    }
    return reading;
}

static int fault(const char *what, long step, double value)
{
    printf("%s at step %ld: %g\n", what, step, value);
    return 1;
}

/* 1 for a command that a drive must not get. */
static int wrong(dpc_real command)
{
    return !(fabs((double)command) <= DPC_ACCELERATION);
}

/* Go on with readings that must bring the cart to rest; 1 if they do not. */
static int goes_on(dpc_controller copy, int check)
{
    const long last = (long)(STOPS_WITHIN * DPC_RATE);
    long k;
    int i;

    for (k = 0; k < last && dpc_status(&copy) != DPC_AT_REST; k++) {
        dpc_reading reading = of_reference(copy.tick);

        if (check == 0)
            reading.limit_switch = 1;
        for (i = 0; check == 1 && i < DPC_POSITIONS; i++)
            reading.present[i] = 0;
        if (check == 2)
            reading.positions[DPC_ARMS] += RUNS_OFF * (double)k * DPC_PERIOD;
        if (check > 2 && check < 3 + DPC_POSITIONS)
            reading.positions[check - 3] = NAN;
        if (check >= 3 + DPC_POSITIONS)
            reading.positions[DPC_ARMS] = check % 2 ? BEYOND : -BEYOND;
        if (wrong(dpc_step(&copy, &reading, NULL)))
            return 1;
    }
    return dpc_status(&copy) != DPC_AT_REST;
}

int main(int count, char **arguments)
{
    const long steps = count > 1 ? strtol(arguments[1], NULL, 10) : 1000;
    long k, running = 0, runs = 1, checks = 0, refused = 0, stopped = 0;
    dpc_controller controller;
    int i, burst = 0;

    state = 88172645463325252ULL + (count > 2 ? strtoull(arguments[2], NULL, 10) : 0);
    dpc_init(&controller);
    for (k = 0; k < steps; k++) {
        dpc_reading reading = of_reference(controller.tick);
        dpc_report report;
        dpc_real command, row[DPC_STATES];
        const double sent = drawn(2) ? hostile() : DPC_ACCELERATION * (drawn(2001) / 1000.0 - 1);

        burst = burst > 0 ? burst - 1 : drawn(1000) ? 0 : 1 + (int)drawn(150);
        for (i = 0; i < DPC_POSITIONS; i++) {
            if (burst ? drawn(2) : !drawn(100))
                reading.positions[i] = hostile();
            if (!drawn(50))
                reading.present[i] = (unsigned char)drawn(256);
        }
        if (!drawn(50))
            reading.age = hostile();
        if (!drawn(3000))
            reading.limit_switch = (int)drawn(UINT_MAX);
        command = dpc_step(&controller, &reading, drawn(4) ? &report : NULL);
        if (wrong(command))
            return fault("command", k, (double)command);
        if (!drawn(20)) {
            const int taken = dpc_sent(&controller, (dpc_real)sent);

            refused += !taken;
            if (taken == wrong((dpc_real)sent))
                return fault("dpc_sent", k, sent);
        }
        i = (int)drawn(sizeof ticks / sizeof *ticks);
        dpc_reference(ticks[i], row);
        if (wrong(dpc_queued(ticks[i])) || !isfinite(row[drawn(DPC_STATES)]))
            return fault("table", k, (double)ticks[i]);
        running += dpc_status(&controller) <= DPC_FINISHED;
        stopped = dpc_status(&controller) <= DPC_FINISHED ? 0 : stopped + 1;
        for (i = 0; k % CHECK_EVERY == 0 && i < 5 + DPC_POSITIONS; i++, checks++)
            if (goes_on(controller, i))
                return fault("the cart goes on", k, i);
        if (stopped > AFTER_STOP) {
            dpc_init(&controller);
            runs++;
        }
    }
    printf("%ld steps, %ld of them running, in %ld runs; %ld checks, %ld refused\n", steps, running, runs, checks, refused);
    return 0;
}
