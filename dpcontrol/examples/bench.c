/* A bench in C for dpcontrol's loop, which keeps to version 2 of the packets in dpcontrol/guide/packets.md.
 *
 * It is for a little-endian computer and listens on loopback. Replace `sensors`, `drive` and `brake` by your own functions.
 * Here they move an imaginary cart. The program does not report a reason for a stop (`text`), and it does not check the
 * sequence number. A real rig should check it and request real-time priority from its operating system.
 *
 * cc -D_GNU_SOURCE -Wall -o bench bench.c -lm
 */
#include <arpa/inet.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <time.h>
#pragma pack(push, 1)
typedef struct { char magic[4]; uint8_t version, kind; uint16_t count; uint64_t session; uint32_t sequence; } Head;
typedef struct { Head head; double period; uint32_t ticks; uint64_t session; } Welcome;
typedef struct { Head head; uint32_t tick, heard, held, ignored; double trip; int8_t touched; uint8_t condition;
                 uint16_t size; double positions[3]; } Reading;
typedef struct { Head head; uint32_t tick; double acceleration; char rest[4064]; } Packet;
#pragma pack(pop)
static double x, v, u, period = 0.001;
static void sensors(double p[3]) { x += period * (v + period * u / 2), v += period * u; p[0] = p[1] = 0, p[2] = x; }
static void drive(double acceleration) { u = acceleration; }
static void brake(void) { u = v = 0; }

int main(void) {
    int s = socket(AF_INET, SOCK_DGRAM, 0), running = 0, stopped = 0, silent = 0, fresh = 1;
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons(47000), .sin_addr = {htonl(INADDR_LOOPBACK)}};
    struct sockaddr_in from, loop;
    struct timespec due;
    uint64_t session = (uint64_t)time(NULL) << 20; /* better: from the system's source of random numbers */
    Reading r;
    bind(s, (struct sockaddr *)&here, sizeof here);
    for (;;) {
        Packet p;
        socklen_t size = sizeof from;
        ssize_t n;
        while ((n = recvfrom(s, &p, sizeof p, running ? MSG_DONTWAIT : 0, (struct sockaddr *)&from, &size)) > 0) {
            if (n < (ssize_t)sizeof(Head) || memcmp(p.head.magic, "dpcb\2", 5)) continue;
            if (!running && p.head.kind == 1) {
                Welcome w = {{"dpcb", 2, 2, 2, p.head.session, 1}, period, 600000, ++session};
                loop = from;
                sendto(s, &w, sizeof w, 0, (struct sockaddr *)&loop, sizeof loop);
            }
            if (p.head.session != session || memcmp(&from, &loop, sizeof loop)) { r.ignored++; continue; }
            silent = 0;
            if (!running && p.head.kind == 7) {
                r = (Reading){{"dpcb", 2, 3, 2, session, 0}, -1, -1, 0, 0, 0, 0, 0, 0, {0}};
                running = 1, stopped = 0, clock_gettime(CLOCK_MONOTONIC, &due);
                break;
            }
            if (p.head.kind == 5 || p.head.kind == 6) stopped = 1, brake(), running = p.head.kind == 5;
            if (p.head.kind != 4 || stopped || (r.heard + 1 && p.tick <= r.heard) || p.tick > r.tick) continue;
            r.heard = p.tick, fresh = 1;
            if (isfinite(p.acceleration)) drive(p.acceleration); else stopped = r.condition = 1, brake();
        }
        if (!running) continue;
        r.held += r.tick + 1 && !fresh, fresh = 0, silent++, r.tick++, r.head.sequence++;
        if (silent > 100 && !stopped) stopped = 1, r.condition = 2, brake(); /* 0.1 s */
        if (silent > 2000) running = 0;
        sensors(r.positions);
        sendto(s, &r, sizeof r, 0, (struct sockaddr *)&loop, sizeof loop);
        due.tv_nsec += (long)(1e9 * period);
        if (due.tv_nsec >= 1000000000) due.tv_nsec -= 1000000000, due.tv_sec++;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    }
}
