/* Board file of serial_bench.c, to fill in: replace the body of each function by calls of your vendor's library.
 *
 * As written it drives no hardware: the arms hang, and the cart moves as it is told.
 */
#include "serial_bench.h"
#include <math.h>

/* Counts of a full turn of each joint's encoder, and of a metre of the cart's. */
#define COUNTS 4096
#define COUNTS_PER_METRE 100000

/* Replace: registers of two quadrature counters and of the cart's. Each joint counts relative to the arm before it. */
static int32_t joint_counts[ARMS], cart_counts;

int hardware_due(void) {
    /* Replace: a flag that the interrupt of a timer sets once a period, and that this function clears. */
    return 0;
}

int hardware_receive(void) {
    /* Replace: the next byte of the UART's receive buffer, or -1. */
    return -1;
}

void hardware_transmit(const uint8_t *data, int size) {
    /* Replace: copy the bytes to the buffer from which DMA or an interrupt feeds the UART. */
    (void)data;
    (void)size;
}

int hardware_exchange(double acceleration, double velocity, double positions[ARMS + 1]) {
    double angle = 0.0;
    /* Latch all counters at the same moment before reading them, if your timers can. */
    for (int arm = 0; arm < ARMS; arm++) {
        /* A joint encoder measures the angle to the previous arm; the sum is the absolute angle. */
        angle += 2 * 3.14159265358979323846 * joint_counts[arm] / COUNTS;
        positions[arm] = angle;
    }
    positions[ARMS] = (double)cart_counts / COUNTS_PER_METRE;
    /* Replace: give the drive its velocity (or acceleration). A stepper takes steps at velocity × steps per metre. */
    (void)acceleration;
    cart_counts += (int32_t)lround(velocity * PERIOD * COUNTS_PER_METRE);
    /* Replace: the limit switches. */
    return 0;
}
