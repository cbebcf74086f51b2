/* Runs the controller on a bench that is reached over UDP, in real time: POSIX sockets and clock, no heap.
 *
 *     main_udp udp://ADDRESS:PORT [--key-file FILE] [--insecure] [--real-time]
 *
 * Implements version 2 of the packets in dpcontrol's guide (dpcontrol/guide/packets.md).
 * The bench has the clock: it sends a reading each period, and uses the newest command that it has. A reading that is
 * lost counts as a tick without any measurement, so that the controller's ticks stay the bench's. The key that both
 * ends share stands in FILE or in the environment's DPCONTROL_RIG_KEY; beyond this computer it is needed, unless
 * --insecure is given. SIGINT and SIGTERM stop the cart and end the run.
 *
 * At the end a sentence on stderr says how the run ended and how deadlines were kept; stdout has the same figures as
 * one line of JSON, times in seconds. Exit code: 0 for a whole run, 1 for one that ended early, 2 for wrong arguments
 * or a bench that does not answer or fit.
 */
#define _POSIX_C_SOURCE 200809L

#include "dpc_controller.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <sched.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define ANSWER 10.0    /* s to wait for the bench's welcome */
#define ASK_EVERY 0.2  /* s between HELLOs */
#define PATIENCE 0.02  /* s for which a reading may be overdue before its tick goes on without it */
#define SILENCE 1.0    /* s without any packet after which the bench counts as gone */
#define STOPPING 0.25  /* s for which STOP is repeated after an interrupt: longer than a cart brakes */
#define DRIFT 1e-4     /* by how much the two clocks may differ in pace */
#define MOST_REFUSED 256 /* packets that are refused in a row before the clock is looked at again */

enum { HELLO = 1, WELCOME, READING, COMMAND, STOP, BYE, START };
enum { FAULT = 1, SILENT = 2, HARD_STOP = 3 };
enum { HEAD = 20, SEAL = 16, READING_HEAD = 28, LARGEST = 4096, LONGEST_KEY = 4096, SHORTEST_KEY = 16, TEXT = 512 };

typedef struct {
    uint32_t tick, heard, held, ignored;
    double trip, positions[DPC_POSITIONS];
    int limit_switch, condition;
} bench_reading;

static struct {
    int socket;
    unsigned char key[LONGEST_KEY];
    size_t key_size;
    uint64_t request, session; /* of HELLO, and of this run */
    uint32_t sequence, newest;   /* sequence numbers */
    double period, begin, last_packet;
    uint32_t ticks;
    int arms;
    bench_reading reading, waiting; /* the newest that was taken, and one that came before its tick */
    int waits;
    char text[TEXT]; /* the bench's last sentence */
    int error;       /* errno of the last packet that could not be sent or taken */
} rig;

static struct {
    double worst; /* delay of a tick, s */
    long ticks, missed, lost, held, ignored, refused;
} kept;

static volatile sig_atomic_t interrupted;
static sigset_t while_waiting; /* signals that are held back then */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void take_interrupt(int number)
{
    interrupted = number;
}

static char last_text[TEXT]; /* the last message, which is also sent to the bench at the end */

/* Says a sentence on stderr, and returns the exit code. */
static int complain(int code, const char *format, ...)
{
    va_list rest;
    va_start(rest, format);
    vsnprintf(last_text, sizeof last_text, format, rest);
    va_end(rest);
    fprintf(stderr, "main_udp: %s\n", last_text);
    return code;
}

/* SHA-256 (FIPS 180-4) and HMAC (RFC 2104). */

typedef struct {
    uint32_t h[8];
    unsigned char block[64];
    uint64_t size;
} sha256;

static uint32_t turned(uint32_t x, int bits)
{
    return x >> bits | x << (32 - bits);
}

static void sha_block(sha256 *s)
{
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
        0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
        0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
        0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
        0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
        0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    uint32_t w[64], v[8];
    for (int i = 0; i < 16; i++) {
        const unsigned char *b = s->block + 4 * i;
        w[i] = (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
    }
    for (int i = 16; i < 64; i++) {
        uint32_t a = w[i - 15], b = w[i - 2];
        w[i] = w[i - 16] + (turned(a, 7) ^ turned(a, 18) ^ a >> 3) + w[i - 7] + (turned(b, 17) ^ turned(b, 19) ^ b >> 10);
    }
    memcpy(v, s->h, sizeof v);
    for (int i = 0; i < 64; i++) {
        uint32_t a = v[0], e = v[4];
        uint32_t one = v[7] + (turned(e, 6) ^ turned(e, 11) ^ turned(e, 25)) + ((e & v[5]) ^ (~e & v[6])) + k[i] + w[i];
        uint32_t two = (turned(a, 2) ^ turned(a, 13) ^ turned(a, 22)) + ((a & v[1]) ^ (a & v[2]) ^ (v[1] & v[2]));
        memmove(v + 1, v, 7 * sizeof v[0]);
        v[4] += one;
        v[0] = one + two;
    }
    for (int i = 0; i < 8; i++)
        s->h[i] += v[i];
}

static void sha_begin(sha256 *s)
{
    static const uint32_t first[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memcpy(s->h, first, sizeof first);
    s->size = 0;
}

static void sha_add(sha256 *s, const void *data, size_t size)
{
    const unsigned char *from = data;
    for (size_t i = 0; i < size; i++) {
        s->block[s->size++ % 64] = from[i];
        if (s->size % 64 == 0)
            sha_block(s);
    }
}

static void sha_end(sha256 *s, unsigned char digest[32])
{
    uint64_t bits = 8 * s->size;
    unsigned char pad = 0x80, length[8];
    for (int i = 0; i < 8; i++)
        length[i] = (unsigned char)(bits >> (56 - 8 * i));
    sha_add(s, &pad, 1);
    for (pad = 0; s->size % 64 != 56;)
        sha_add(s, &pad, 1);
    sha_add(s, length, 8);
    for (int i = 0; i < 32; i++)
        digest[i] = (unsigned char)(s->h[i / 4] >> (24 - 8 * (i % 4)));
}

/* The seal of a packet that `role` sends: the first 16 bytes of HMAC-SHA256 of role and packet. */
static void seal(const char *role, const unsigned char *data, size_t size, unsigned char digest[32])
{
    unsigned char key[64] = {0}, pad[64];
    sha256 s;
    if (rig.key_size > sizeof key) {
        sha_begin(&s);
        sha_add(&s, rig.key, rig.key_size);
        sha_end(&s, key);
    } else
        memcpy(key, rig.key, rig.key_size);
    for (int i = 0; i < 64; i++)
        pad[i] = key[i] ^ 0x36;
    sha_begin(&s);
    sha_add(&s, pad, 64);
    sha_add(&s, role, strlen(role));
    sha_add(&s, data, size);
    sha_end(&s, digest);
    for (int i = 0; i < 64; i++)
        pad[i] = key[i] ^ 0x5c;
    sha_begin(&s);
    sha_add(&s, pad, 64);
    sha_add(&s, digest, 32);
    sha_end(&s, digest);
}

/* Numbers in packets, little-endian whatever this computer is. */

static unsigned char *put(unsigned char *to, uint64_t value, int bytes)
{
    while (bytes-- > 0) {
        *to++ = (unsigned char)value;
        value >>= 8;
    }
    return to;
}

static uint64_t get(const unsigned char *from, int bytes)
{
    uint64_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | from[bytes];
    return value;
}

static unsigned char *put_double(unsigned char *to, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put(to, bits, 8);
}

static double get_double(const unsigned char *from)
{
    uint64_t bits = get(from, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Sends a packet; one that cannot be sent is like one lost on the way. */
static void send_message(int kind, int count, const unsigned char *body, size_t size)
{
    unsigned char data[LARGEST], digest[32], *to = data;
    memcpy(to, "dpcb\2", 5);
    to = put(to + 5, (uint64_t)kind, 1);
    to = put(to, (uint64_t)count, 2);
    to = put(to, rig.session, 8);
    to = put(to, ++rig.sequence, 4);
    memcpy(to, body, size);
    size += HEAD;
    if (rig.key_size) {
        seal("loop", data, size, digest);
        memcpy(data + size, digest, SEAL);
        size += SEAL;
    }
    if (send(rig.socket, data, size, 0) < 0)
        rig.error = errno;
}

static void say_command(long tick, double acceleration)
{
    unsigned char body[12];
    put_double(put(body, (uint64_t)tick, 4), acceleration);
    send_message(COMMAND, 0, body, sizeof body);
}

static void say_start(void)
{
    unsigned char body[8 * DPC_LEAD + 1], *to = body;
    for (long k = 0; k < DPC_LEAD; k++)
        to = put_double(to, (double)dpc_queued(k));
    send_message(START, DPC_LEAD, body, (size_t)(to - body));
}

static void say_bye(void)
{
    size_t size = strlen(last_text);
    /* Where it was cut, perhaps within a letter. */
    while (size > TEXT - 5 && last_text[size - 1] & 0x80)
        size--;
    send_message(BYE, (int)size, (const unsigned char *)last_text, size);
}

/* Keeps a sentence of the bench, fit to be printed. */
static void note(const unsigned char *text, size_t size)
{
    size = size < TEXT ? size : TEXT - 1;
    for (size_t i = 0; i < size; i++)
        rig.text[i] = (char)(text[i] < 0x20 || text[i] == 0x7f ? '?' : text[i]);
    rig.text[size] = 0;
}

/* Tells whether a packet is the bench's, of this run and whole; kind and body are given back then. */
static int is_ours(const unsigned char *data, size_t size, int *kind, int *count, const unsigned char **body,
                   size_t *body_size)
{
    unsigned char digest[32], differs = 0;
    if (size < HEAD || memcmp(data, "dpcb\2", 5) != 0)
        return 0;
    if (rig.key_size) {
        if (size < HEAD + SEAL)
            return 0;
        size -= SEAL;
        seal("bench", data, size, digest);
        for (int i = 0; i < SEAL; i++)
            differs |= digest[i] ^ data[size + (size_t)i];
        if (differs)
            return 0;
    }
    *kind = data[5];
    *count = (int)get(data + 6, 2);
    *body = data + HEAD;
    *body_size = size - HEAD;
    return get(data + 8, 8) == rig.session;
}

static int read_reading(const unsigned char *body, size_t size, int count, bench_reading *to)
{
    size_t text;
    if (size < READING_HEAD || count != DPC_ARMS)
        return 0;
    to->tick = (uint32_t)get(body, 4);
    to->heard = (uint32_t)get(body + 4, 4);
    to->held = (uint32_t)get(body + 8, 4);
    to->ignored = (uint32_t)get(body + 12, 4);
    to->trip = get_double(body + 16);
    to->limit_switch = body[24] != 0;
    to->condition = body[25];
    text = (size_t)get(body + 26, 2);
    body += READING_HEAD;
    size -= READING_HEAD;
    if (size != 8 * DPC_POSITIONS + text || to->tick >= rig.ticks)
        return 0;
    for (int i = 0; i < DPC_POSITIONS; i++)
        to->positions[i] = get_double(body + 8 * i);
    if (text)
        note(body + 8 * DPC_POSITIONS, text);
    return 1;
}

/* Returns the kind of the next packet that is to be believed, or 0 if none came until then or a signal did.
 *
 * Of WELCOME the numbers are in `rig`, of READING in `reading`, of BYE the sentence in rig.text. */
static int hear(double until, bench_reading *reading)
{
    unsigned char data[LARGEST];
    const unsigned char *body;
    size_t body_size;
    int kind, count;
    for (int refused = 0; refused < MOST_REFUSED;) {
        ssize_t size = recv(rig.socket, data, sizeof data, 0);
        uint32_t sequence;
        if (size < 0) {
            double left = until - now();
            struct timespec wait;
            fd_set sockets;
            int gone = errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR;
            if (gone) {
                /* Nobody listens there now; a bench that is started again might. */
                rig.error = errno;
                left = left < ASK_EVERY ? left : ASK_EVERY;
            }
            if (left <= 0)
                return 0;
            wait.tv_sec = (time_t)left;
            wait.tv_nsec = (long)(1e9 * (left - (double)wait.tv_sec));
            FD_ZERO(&sockets);
            FD_SET(rig.socket, &sockets);
            if (pselect(gone ? 0 : rig.socket + 1, gone ? NULL : &sockets, NULL, NULL, &wait, &while_waiting) <= 0 || gone)
                return 0;
            continue;
        }
        if (!is_ours(data, (size_t)size, &kind, &count, &body, &body_size)) {
            refused++;
            /* A second answer to a HELLO that was sent twice is no sign of strangers. */
            kept.refused += rig.session == rig.request || size < HEAD || get(data + 8, 8) != rig.request;
            continue;
        }
        sequence = (uint32_t)get(data + 16, 4);
        if (sequence <= rig.newest) {
            refused++;
            continue;
        }
        if (kind == WELCOME && body_size == 20 && rig.session == rig.request) {
            rig.arms = count;
            rig.period = get_double(body);
            rig.ticks = (uint32_t)get(body + 8, 4);
            rig.session = get(body + 12, 8);
            rig.sequence = rig.newest = 0;
            return WELCOME;
        }
        if (kind == READING && read_reading(body, body_size, count, reading)) {
            rig.newest = sequence;
            return READING;
        }
        if (kind == BYE && body_size == (size_t)count) {
            note(body, body_size);
            return BYE;
        }
        refused++;
        kept.refused++;
    }
    return 0;
}

/* Asks for a run; returns 0, or the exit code. */
static int introduce(const char *address)
{
    double end = now() + ANSWER;
    unsigned char number[8];
    int random = open("/dev/urandom", O_RDONLY);
    if (random < 0 || read(random, number, sizeof number) != (ssize_t)sizeof number)
        return complain(2, "/dev/urandom cannot be read: %s", strerror(errno));
    close(random);
    rig.session = rig.request = get(number, 8);
    while (now() < end && !interrupted) {
        double again = now() + ASK_EVERY;
        send_message(HELLO, 0, number, 0);
        while (now() < again && !interrupted) {
            int kind = hear(again, &rig.reading);
            if (kind == BYE)
                return complain(2, "%s: %s", address, rig.text);
            if (kind != WELCOME)
                continue;
            kept.refused = 0;
            if (rig.arms != DPC_ARMS)
                return complain(2, "%s has %d arms, this controller is for %d", address, rig.arms, DPC_ARMS);
            if (!(fabs(rig.period / DPC_PERIOD - 1) <= 1e-6))
                return complain(2, "%s ticks at %g Hz, this controller at %g Hz; export it with --rate %g", address,
                                1 / rig.period, 1 / DPC_PERIOD, 1 / rig.period);
            if ((long)rig.ticks < DPC_TICKS)
                return complain(2, "%s can run for %lu ticks, this controller takes %ld", address,
                                (unsigned long)rig.ticks, DPC_TICKS);
            return 0;
        }
    }
    if (interrupted)
        return complain(1, "interrupted before the run began");
    return complain(2, "%s: no bench answered for %g s (%ld packets came and were refused)%s%s; start one with "
                    "`dpcontrol rig`, and give both the same key, if any", address, ANSWER, kept.refused,
                    rig.error ? ": " : "", rig.error ? strerror(rig.error) : "");
}

/* Waits for the reading of tick k. Returns 1 where it came, 0 where the tick must go on without it, -1 where the run
 * is over, which was reported. */
static int next_reading(long k)
{
    if (rig.waits) {
        if (rig.waiting.tick != (uint32_t)k)
            return 0;
        rig.waits = 0;
        rig.reading = rig.waiting;
        return 1;
    }
    if (k == 0) {
        rig.last_packet = now();
        say_start();
    }
    for (;;) {
        double due = k ? rig.begin + (double)k * DPC_PERIOD : now(), begin, clock;
        bench_reading came;
        int kind = hear(due + PATIENCE, &came);
        clock = now();
        if (kind == READING) {
            rig.last_packet = clock;
            rig.error = 0;
            /* The earliest that any reading came, in units of the bench's clock, which may go a little slower. */
            begin = clock - came.tick * DPC_PERIOD;
            rig.begin = rig.begin + DRIFT * DPC_PERIOD < begin ? rig.begin + DRIFT * DPC_PERIOD : begin;
            if (came.tick == (uint32_t)k) {
                rig.reading = came;
                return 1;
            }
            if (came.tick > (uint32_t)k) {
                rig.waiting = came;
                rig.waits = 1;
                return 0;
            }
        } else if (kind == BYE) {
            return complain(-1, "at t = %.3f s the bench ended the run: %s", (double)k * DPC_PERIOD, rig.text);
        } else if (clock - rig.last_packet > SILENCE) {
            return complain(-1, "at t = %.3f s the bench is gone: %s for %.3g s", (double)k * DPC_PERIOD,
                            rig.error ? strerror(rig.error) : "nothing came from it", clock - rig.last_packet);
        } else if (k == 0) {
            if (interrupted)
                return 0;
            say_start(); /* it may have been lost */
        } else if (clock >= due + PATIENCE || interrupted)
            return 0;
    }
}

static void account(long k, int came)
{
    double lateness = now() - (rig.begin + (double)k * DPC_PERIOD);
    kept.worst = lateness > kept.worst ? lateness : kept.worst;
    kept.ticks++;
    kept.missed += lateness > DPC_PERIOD;
    kept.lost += !came;
    if (came) {
        kept.held = (long)rig.reading.held;
        kept.ignored = (long)rig.reading.ignored;
    }
}

static void report_deadlines(void)
{
    long rejected = kept.ignored + kept.refused;
    fprintf(stderr, "%ld of %ld deadlines missed; ticks began up to %.3g ms late; %ld readings lost or too late; "
            "%ld packets rejected; the bench repeated a command %ld times\n",
            kept.missed, kept.ticks, 1e3 * kept.worst, kept.lost, rejected, kept.held);
    printf("{\"ticks\": %ld, \"missed\": %ld, \"worst\": %.9g, \"lost\": %ld, \"held\": %ld, \"rejected\": %ld}\n",
           kept.ticks, kept.missed, kept.worst, kept.lost, kept.held, rejected);
}

/* Runs the controller to its end; returns the exit code. */
static int run(void)
{
    static const char *const outcomes[] = {
        "", "", "", "", "the estimate is lost", "a position was not measured for too long",
        "the cart must brake now to stay on its track", "tracking is lost", "a sensor repeats itself",
        "a limit switch answered", "the arms have left the reference and the cart runs off after them",
        "the cart does not follow the commands: is the drive on?",
        "the cart moves against the commands: check the signs of drive and scale"};
    static dpc_controller controller;
    dpc_reading reading = {{0}, {0}, 0, 0};
    dpc_report report;
    int stopped_by = 0;
    long ended_at = 0;
    double stopping_until = 0;
    dpc_init(&controller);
    for (long k = 0; k < DPC_TICKS || stopping_until > 0; k++) {
        int came = next_reading(k);
        if (came < 0)
            return 1;
        if (interrupted && stopping_until <= 0) {
            stopping_until = now() + STOPPING;
            ended_at = k;
        }
        if (stopping_until > 0) {
            send_message(STOP, 0, (const unsigned char *)"", 0);
            if (now() >= stopping_until || k + 1 >= (long)rig.ticks)
                return complain(1, "interrupted at t = %.3f s: the cart was stopped", (double)ended_at * DPC_PERIOD);
            continue;
        }
        account(k, came);
        for (int i = 0; i < DPC_POSITIONS; i++) {
            reading.present[i] = came != 0;
            reading.positions[i] = rig.reading.positions[i];
        }
        reading.limit_switch = came && rig.reading.limit_switch;
        if (came && rig.reading.condition == SILENT && !stopped_by)
            return complain(1, "the bench stopped the cart: %s", rig.text);
        dpc_step(&controller, &reading, &report);
        if (report.stop)
            send_message(STOP, 0, (const unsigned char *)"", 0);
        else
            say_command(k, (double)report.command);
        if (came && (rig.reading.condition == FAULT || rig.reading.condition == HARD_STOP))
            return complain(1, "at t = %.3f s the bench failed: %s", (double)k * DPC_PERIOD, rig.text);
        if (report.stopped_by && !stopped_by) {
            stopped_by = report.stopped_by;
            ended_at = k;
        }
        if (report.done)
            break;
    }
    if (stopped_by)
        return complain(1, "the run was stopped at t = %.3f s: %s", (double)ended_at * DPC_PERIOD,
                        stopped_by <= DPC_DRIVE_REVERSED ? outcomes[stopped_by] : "the controller gave it up");
    return complain(0, "the run is over: it came to the end of %s", DPC_ITINERARY);
}

static int is_blank(unsigned char c)
{
    return c == ' ' || (c >= '\t' && c <= '\r');
}

/* Takes the shared key, blanks at its ends dropped; returns 0, or the exit code. */
static int take_key(const char *file)
{
    const char *variable = getenv("DPCONTROL_RIG_KEY"), *where = file ? file : "DPCONTROL_RIG_KEY";
    size_t begin = 0, end = 0;
    if (file) {
        FILE *stream = fopen(file, "rb");
        if (!stream)
            return complain(2, "--key-file %s: %s; give a file that holds the key", file, strerror(errno));
        end = fread(rig.key, 1, sizeof rig.key, stream);
        fclose(stream);
    } else if (variable) {
        end = strlen(variable) < sizeof rig.key ? strlen(variable) : sizeof rig.key;
        memcpy(rig.key, variable, end);
    } else
        return 0;
    while (end > 0 && is_blank(rig.key[end - 1]))
        end--;
    while (begin < end && is_blank(rig.key[begin]))
        begin++;
    rig.key_size = end - begin;
    memmove(rig.key, rig.key + begin, rig.key_size);
    if (rig.key_size < SHORTEST_KEY)
        return complain(2, "%s: a key of %lu bytes is too short; at least %d are needed, as from `openssl rand -hex 32`",
                        where, (unsigned long)rig.key_size, SHORTEST_KEY);
    return 0;
}

/* Connects the socket to udp://ADDRESS:PORT; returns 0, or the exit code. */
static int connect_to(const char *address, int insecure)
{
    struct sockaddr_in to;
    char host[64], after;
    unsigned port;
    int room = 1 << 20;
    memset(&to, 0, sizeof to);
    to.sin_family = AF_INET;
    if (sscanf(address, "udp://%63[0-9.]:%u%c", host, &port, &after) != 2 || port == 0 || port > 65535 ||
        inet_pton(AF_INET, host, &to.sin_addr) != 1)
        return complain(2, "%s: must be udp://ADDRESS:PORT with an address in numbers, as udp://127.0.0.1:47000", address);
    to.sin_port = htons((uint16_t)port);
    if (ntohl(to.sin_addr.s_addr) >> 24 != 127 && !rig.key_size && !insecure)
        return complain(2, "%s is another computer, so both ends need a shared key: give its file with --key-file or the "
                        "key in DPCONTROL_RIG_KEY, or --insecure to let anyone there drive the cart", address);
    rig.socket = socket(AF_INET, SOCK_DGRAM, 0);
    if (rig.socket < 0 || connect(rig.socket, (const struct sockaddr *)&to, sizeof to) != 0 ||
        fcntl(rig.socket, F_SETFL, O_NONBLOCK) != 0)
        return complain(2, "%s: %s; check the address", address, strerror(errno));
    /* What comes during a stall should wait there. */
    setsockopt(rig.socket, SOL_SOCKET, SO_RCVBUF, &room, sizeof room);
    return 0;
}

/* Asks for priority over all ordinary work; without the right to it the run goes on as it is. */
static void take_priority(void)
{
    struct sched_param first = {0};
    first.sched_priority = 1;
    if (sched_setscheduler(0, SCHED_FIFO, &first) != 0 || mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
        complain(0, "no priority over other work: %s", strerror(errno));
}

int main(int count, char **arguments)
{
    const char *address = NULL, *key_file = NULL;
    int insecure = 0, real_time = 0, code;
    struct sigaction action;
    sigset_t signals;
    for (int i = 1; i < count; i++) {
        if (strcmp(arguments[i], "--insecure") == 0)
            insecure = 1;
        else if (strcmp(arguments[i], "--real-time") == 0)
            real_time = 1;
        else if (strcmp(arguments[i], "--key-file") == 0 && i + 1 < count)
            key_file = arguments[++i];
        else if (arguments[i][0] != '-' && !address)
            address = arguments[i];
        else
            return complain(2, "%s: not an option; main_udp udp://ADDRESS:PORT [--key-file FILE] [--insecure] "
                            "[--real-time]", arguments[i]);
    }
    if (!address)
        return complain(2, "give the bench's address, as `dpcontrol rig` prints it: udp://ADDRESS:PORT");
    if ((code = take_key(key_file)) || (code = connect_to(address, insecure)))
        return code;
    /* Taken while packets are waited for, and nowhere else. */
    memset(&action, 0, sizeof action);
    action.sa_handler = take_interrupt;
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigemptyset(&signals);
    sigaddset(&signals, SIGINT);
    sigaddset(&signals, SIGTERM);
    sigprocmask(SIG_BLOCK, &signals, &while_waiting);
    sigdelset(&while_waiting, SIGINT);
    sigdelset(&while_waiting, SIGTERM);
    if ((code = introduce(address))) {
        /* A bench that has answered need not wait. */
        if (rig.session != rig.request)
            say_bye();
        return code;
    }
    if (real_time)
        take_priority();
    rig.begin = HUGE_VAL;
    code = run();
    send_message(STOP, 0, (const unsigned char *)"", 0);
    say_bye();
    report_deadlines();
    return code;
}
