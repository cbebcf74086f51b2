/* What a board provides for serial_bench.c: the number of arms, the period, and four functions. */
#ifndef SERIAL_BENCH_H
#define SERIAL_BENCH_H
#include <stdint.h>

#ifndef ARMS
#define ARMS 2
#endif
/* Time between ticks, s: that of your timer. */
#ifndef PERIOD
#define PERIOD 0.001
#endif

/* Returns 1 once in each period, by a timer of the board, and 0 otherwise. */
int hardware_due(void);

/* Returns the next byte from the serial line, or -1 if none has arrived. */
int hardware_receive(void);

/* Puts bytes into the transmit buffer of the serial line, without waiting for the line. */
void hardware_transmit(const uint8_t *data, int size);

/* Latches all encoders and then sets the drive; called once a period.
 *
 * acceleration, m/s², and velocity, m/s, are those of the cart for the next period: give your drive the one that it takes.
 * positions[0] to positions[ARMS - 1] are the absolute angles of the arms, rad, zero hanging, counter-clockwise
 * positive. positions[ARMS] is the position of the cart, m, zero at the middle, positive to the right.
 * Returns -1 while the left limit switch is touched, +1 while the right one is, else 0. */
int hardware_exchange(double acceleration, double velocity, double positions[ARMS + 1]);

#endif
