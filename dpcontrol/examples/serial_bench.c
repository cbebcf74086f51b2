/* A bench on a microcontroller, which speaks dpcontrol's packets over a serial line (dpcontrol/guide/packets.md).
 *
 * Compile it with a file of the four functions below for your board; serial_hardware.c is such a file to fill in. The
 * microcontroller must be little-endian, as all Cortex-M are. The bench keeps its own clock and applies the newest
 * command once a period. Without packets for WATCHDOG seconds it brakes the cart.
 *
 *     cc -Os -c serial_bench.c
 */
#include "serial_bench.h"
#include <math.h>
#include <string.h>

/* Deceleration when the cart is stopped, m/s². */
#ifndef BRAKE
#define BRAKE 10.0
#endif
/* Time without packets until the cart brakes, s. */
#ifndef WATCHDOG
#define WATCHDOG 0.1
#endif
#define LEAVING (20 * WATCHDOG) /* until the next loop can connect, s */
#define MOST 256                /* bytes of the longest frame */

enum { HELLO = 1, WELCOME, READING, COMMAND, STOP, BYE, START };
enum { WELL, FAULT, SILENCE };
static const uint32_t NONE = 0xffffffff;

#pragma pack(push, 1)
typedef struct { char magic[4]; uint8_t version, kind; uint16_t count; uint64_t session; uint32_t sequence; } Head;
typedef struct { Head head; double period; uint32_t ticks; uint64_t session; } Welcome;
typedef struct {
    Head head;
    uint32_t tick, heard, held, ignored;
    double trip;
    int8_t touched;
    uint8_t condition;
    uint16_t size;
    double positions[ARMS + 1];
} Reading;
typedef struct { Head head; uint32_t tick; double acceleration; } Command;
#pragma pack(pop)

static Reading reading;
static uint64_t session;
static uint32_t newest, silent;
static int running, stopped, fresh;
static double velocity, acceleration;

/* CRC-32 of IEEE 802.3, bit by bit: 80 bytes take some 10 µs on a Cortex-M7. */
static uint32_t crc32(const uint8_t *data, int size) {
    uint32_t crc = 0xffffffff;
    for (int i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320 : 0);
    }
    return ~crc;
}

/* Sends a packet with its CRC, encoded by COBS, between two zero bytes. */
static void send_packet(const void *packet, int size) {
    uint8_t data[MOST], frame[MOST + 4];
    uint32_t crc = crc32(packet, size);
    int code = 1, end = 2;
    memcpy(data, packet, size);
    memcpy(data + size, &crc, 4);
    frame[0] = 0;
    /* A code byte counts itself and the bytes up to the next zero; packets are shorter than its 254. */
    for (int i = 0; i < size + 4; i++) {
        if (data[i]) {
            frame[end++] = data[i];
        } else {
            frame[code] = end - code;
            code = end++;
        }
    }
    frame[code] = end - code;
    frame[end++] = 0;
    hardware_transmit(frame, end);
}

/* Decodes a frame in place; returns the size of its packet, or -1 if it is damaged. */
static int decoded(uint8_t *frame, int size) {
    uint32_t crc;
    int from = 0, to = 0;
    while (from < size) {
        int code = frame[from++];
        if (from + code - 1 > size) return -1;
        for (int i = 1; i < code; i++) frame[to++] = frame[from++];
        if (code < 255 && from < size) frame[to++] = 0;
    }
    if (to < 4 + (int)sizeof(Head)) return -1;
    memcpy(&crc, frame + to - 4, 4);
    return crc == crc32(frame, to - 4) ? to - 4 : -1;
}

static void brake(uint8_t condition) {
    stopped = 1;
    if (reading.condition == WELL) reading.condition = condition;
}

static void command(const Command *packet, int size) {
    if (size != sizeof *packet || (reading.heard != NONE && packet->tick <= reading.heard)) return;
    /* No command answers a reading that was not sent. */
    if (reading.tick == NONE || packet->tick > reading.tick) return;
    reading.heard = packet->tick;
    fresh = 1;
    if (!isfinite(packet->acceleration)) {
        brake(FAULT);
    } else if (!stopped) {
        acceleration = packet->acceleration;
    }
}

static void welcome(const Head *asked) {
    /* The next run has another number, so that no packet of this run can act in it. */
    session = session * 6364136223846793005u + asked->session + 1;
    Welcome answer = {{"dpcb", 2, WELCOME, ARMS, asked->session, 1}, PERIOD, 0xfffffffe, session};
    newest = 0;
    send_packet(&answer, sizeof answer);
}

static void start(void) {
    /* The loop asks again until the cart of the last run stands still. */
    if (velocity != 0) return;
    acceleration = 0;
    reading = (Reading){{"dpcb", 2, READING, ARMS, session, 0}, NONE, NONE, 0, 0, 0, 0, WELL, 0, {0}};
    running = 1;
    stopped = silent = 0;
    fresh = 1;
}

static void take(const uint8_t *data, int size) {
    Head head;
    if (size < 0) {
        reading.ignored++;
        return;
    }
    memcpy(&head, data, sizeof head);
    if (memcmp(head.magic, "dpcb\2", 5)) {
        reading.ignored++;
    } else if (head.kind == HELLO) {
        if (!running) welcome(&head);
    } else if (head.session != session || head.sequence <= newest) {
        reading.ignored++;
    } else {
        newest = head.sequence;
        silent = 0;
        if (head.kind == START && !running) start();
        if (head.kind == COMMAND && running) {
            Command packet;
            memcpy(&packet, data, sizeof packet);
            command(&packet, size);
        }
        if (head.kind == STOP || head.kind == BYE) brake(WELL);
        if (head.kind == BYE) running = 0;
    }
}

void bench_receive(uint8_t byte) {
    static uint8_t frame[MOST];
    static int size;
    if (byte) {
        /* A longer frame is dropped as damaged. */
        if (size < MOST) frame[size] = byte;
        size += size < MOST + 1;
        return;
    }
    if (size) take(frame, size > MOST ? -1 : decoded(frame, size));
    size = 0;
}

void bench_tick(void) {
    double demand = acceleration;
    if (stopped || !running) {
        double most = BRAKE * PERIOD;
        double change = velocity > most ? -most : velocity < -most ? most : -velocity;
        demand = change / PERIOD;
    }
    velocity += demand * PERIOD;
    reading.touched = hardware_exchange(demand, velocity, reading.positions);
    if (!running) return;
    if (++silent > LEAVING / PERIOD) running = 0;
    if (silent > WATCHDOG / PERIOD && !stopped) brake(SILENCE);
    reading.held += reading.tick != NONE && !fresh && !stopped;
    fresh = 0;
    reading.tick++;
    reading.head.sequence++;
    send_packet(&reading, sizeof reading);
}

int main(void) {
    for (;;) {
        int byte;
        while ((byte = hardware_receive()) >= 0) bench_receive(byte);
        if (hardware_due()) bench_tick();
    }
}
