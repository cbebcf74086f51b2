/* Times dpc_step over the readings of a binary file, a run again and again: prints median, 99.9 % and worst in ns. */
#define _POSIX_C_SOURCE 199309L
#include "dpc_controller.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define MOST 100000
#define COLUMNS (DPC_POSITIONS + 2)

static double readings[MOST][COLUMNS];
static double taken[MOST * 10];

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

int main(int count, char **arguments)
{
    FILE *file = fopen(count > 1 ? arguments[1] : "", "rb");
    size_t rows, k, done = 0;
    double sum = 0;
    int again, i;

    if (!file)
        return 2;
    rows = fread(readings, sizeof readings[0], MOST, file);
    fclose(file);
    for (again = 0; again < 10; again++) {
        dpc_controller controller;

        dpc_init(&controller);
        for (k = 0; k < rows; k++) {
            struct timespec begin, end;
            dpc_reading reading;
            dpc_report report;

            for (i = 0; i < DPC_POSITIONS; i++) {
                reading.positions[i] = readings[k][i];
                reading.present[i] = 1;
            }
            reading.limit_switch = 0;
            clock_gettime(CLOCK_MONOTONIC, &begin);
            sum += (double)dpc_step(&controller, &reading, &report);
            clock_gettime(CLOCK_MONOTONIC, &end);
            dpc_sent(&controller, (dpc_real)readings[k][DPC_POSITIONS + 1]);
            taken[done++] = 1e9 * (double)(end.tv_sec - begin.tv_sec) + (double)(end.tv_nsec - begin.tv_nsec);
        }
    }
    qsort(taken, done, sizeof taken[0], ascending);
    printf("%.0f %.0f %.0f %g\n", taken[done / 2], taken[done - 1 - done / 1000], taken[done - 1], sum);
    return 0;
}
