// What the peers in C and C++ share: arguments, the content of messages, lines of JSON as rclpy_peer.py prints them
// (without `cdr_sha256` and `bytes`).
//
//   PEER listen TYPE TOPIC [--count N] [--seconds S]
//   PEER talk   TYPE TOPIC [--count N] [--seconds S] [--rate HZ] [--bytes B] [--seed X] [--leave-out R --of N]
//
// TYPE is event_camera_msgs/msg/EventPacket or eecvs_msgs/msg/Frame; TOPIC is named as in ROS 2 (/events). Best
// effort, the last 1000 messages are kept, loopback alone; ROS_DOMAIN_ID is the domain.

#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SECOND 1000000000ll
#define DEPTH 1000

struct options {
    bool talk, frame;
    char topic[256]; // as DDS has it
    const char *type;
    uint64_t count;
    double seconds, rate;
    size_t bytes;
    unsigned seed, domain;
    uint64_t leave_out, of;
};

// An EventPacket or a Frame.
struct message {
    int32_t sec;
    uint32_t nanosec, height, width, duration_us, events;
    uint64_t seq, time;
    const char *frame_id, *name; // encoding or operator
    bool is_bigendian;
    const uint8_t *data;
    size_t length;
};

static inline int64_t now(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static inline void nap(double seconds) {
    if (seconds <= 0) return;
    struct timespec t;
    t.tv_sec = (time_t)seconds;
    t.tv_nsec = (long)((seconds - (double)t.tv_sec) * 1e9);
    nanosleep(&t, NULL);
}

static inline struct options parse(int argc, char **argv) {
    struct options o;
    memset(&o, 0, sizeof o);
    o.count = 100, o.seconds = 20, o.rate = 100, o.bytes = 50000, o.seed = 1, o.of = 1;
    bool right = argc >= 4 && argc % 2 == 0 && (!strcmp(argv[1], "talk") || !strcmp(argv[1], "listen"));
    if (right) {
        o.talk = !strcmp(argv[1], "talk");
        o.type = argv[2];
        o.frame = !strcmp(o.type, "eecvs_msgs/msg/Frame");
        right = o.frame || !strcmp(o.type, "event_camera_msgs/msg/EventPacket");
        snprintf(o.topic, sizeof o.topic, "rt%s%s", argv[3][0] == '/' ? "" : "/", argv[3]);
    }
    for (int i = 4; right && i < argc; i += 2) {
        double value = atof(argv[i + 1]);
        if (!strcmp(argv[i], "--count")) o.count = (uint64_t)value;
        else if (!strcmp(argv[i], "--seconds")) o.seconds = value;
        else if (!strcmp(argv[i], "--rate")) o.rate = value;
        else if (!strcmp(argv[i], "--bytes")) o.bytes = (size_t)value;
        else if (!strcmp(argv[i], "--seed")) o.seed = (unsigned)value;
        else if (!strcmp(argv[i], "--leave-out")) o.leave_out = (uint64_t)value;
        else if (!strcmp(argv[i], "--of")) o.of = (uint64_t)value;
        else right = false;
    }
    if (!right || o.of == 0) {
        fprintf(stderr, "usage: %s listen|talk TYPE TOPIC [--count N] [--seconds S] [--rate HZ] [--bytes B] [--seed X] [--leave-out R --of N]\n",
                argv[0]);
        exit(2);
    }
    const char *domain = getenv("ROS_DOMAIN_ID");
    o.domain = domain ? (unsigned)atoi(domain) : 0;
    setvbuf(stdout, NULL, _IOLBF, 0);
    return o;
}

// Whether a number is never published: of every N of them, the last R are not.
static inline bool is_left_out(const struct options *o, uint64_t index) { return index % o->of + o->leave_out >= o->of; }

// The content of a message; `data` has room for the bytes, `frame_id` for 32.
static inline struct message fill(const struct options *o, uint64_t index, uint8_t *data, char *frame_id) {
    struct message m;
    uint64_t state = index * 0x9E3779B97F4A7C15u + o->seed;
    for (size_t i = 0; i < o->bytes; i++) {
        state = state * 6364136223846793005u + 1442695040888963407u;
        data[i] = (uint8_t)(state >> 56);
    }
    snprintf(frame_id, 32, "sensor %" PRIu64, index);
    m.sec = 1700000000 + (int32_t)(index / 1000);
    m.nanosec = (uint32_t)(index % 1000) * 1000000 + 123456;
    m.frame_id = frame_id;
    m.height = 720, m.width = 1280;
    m.seq = index;
    m.time = 0x0001020304050607u + index * 1000;
    m.duration_us = 33333;
    m.events = (uint32_t)(state >> 40);
    m.name = o->frame ? "eecvs" : "evt3";
    m.is_bigendian = index % 2;
    m.data = data, m.length = o->bytes;
    return m;
}

static inline uint32_t turn(uint32_t x, int n) { return x >> n | x << (32 - n); }

// SHA-256 of bytes (FIPS 180-4), in hexadecimal.
static inline void sha256(const uint8_t *data, size_t length, char hex[65]) {
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
        0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
        0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
        0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
        0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
        0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    uint32_t h[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    size_t blocks = (length + 9 + 63) / 64;
    for (size_t b = 0; b < blocks; b++) {
        uint8_t block[64] = {0};
        size_t at = b * 64, part = at >= length ? 0 : length - at < 64 ? length - at : 64;
        if (part) memcpy(block, data + at, part);
        if (at <= length && length < at + 64) block[length - at] = 0x80;
        if (b == blocks - 1)
            for (int i = 0; i < 8; i++) block[56 + i] = (uint8_t)((uint64_t)length * 8 >> (56 - 8 * i));
        uint32_t w[64], v[8];
        for (int i = 0; i < 16; i++)
            w[i] = (uint32_t)block[4 * i] << 24 | block[4 * i + 1] << 16 | block[4 * i + 2] << 8 | block[4 * i + 3];
        for (int i = 16; i < 64; i++)
            w[i] = w[i - 16] + w[i - 7] + (turn(w[i - 15], 7) ^ turn(w[i - 15], 18) ^ w[i - 15] >> 3) +
                   (turn(w[i - 2], 17) ^ turn(w[i - 2], 19) ^ w[i - 2] >> 10);
        memcpy(v, h, sizeof v);
        for (int i = 0; i < 64; i++) {
            uint32_t x = v[7] + (turn(v[4], 6) ^ turn(v[4], 11) ^ turn(v[4], 25)) + ((v[4] & v[5]) ^ (~v[4] & v[6])) + k[i] + w[i];
            uint32_t y = (turn(v[0], 2) ^ turn(v[0], 13) ^ turn(v[0], 22)) + ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
            memmove(v + 1, v, 7 * sizeof *v);
            v[4] += x, v[0] = x + y;
        }
        for (int i = 0; i < 8; i++) h[i] += v[i];
    }
    for (int i = 0; i < 8; i++) snprintf(hex + 8 * i, 9, "%08x", h[i]);
}

static inline void say_text(const char *text) {
    putchar('"');
    for (; *text; text++)
        if (*text == '"' || *text == '\\' || (unsigned char)*text < ' ') printf("\\u%04x", (unsigned char)*text);
        else putchar(*text);
    putchar('"');
}

static inline void say_ready(const struct options *o) {
    printf("{\"ready\": true, \"type\": \"%s\", \"topic\": \"%s\"}\n", o->type, o->topic + 2);
}

// One line for a message; `what` is sent or received.
static inline void say(const char *what, uint64_t index, const struct options *o, const struct message *m) {
    int64_t time_ns = now(CLOCK_REALTIME);
    char hex[65];
    sha256(m->data, m->length, hex);
    printf("{\"%s\": %" PRIu64 ", \"time_ns\": %" PRId64 ", \"seq\": %" PRIu64 ", \"message\": {\"header\": {\"stamp\": {\"sec\": %" PRId32
           ", \"nanosec\": %" PRIu32 "}, \"frame_id\": ", what, index, time_ns, m->seq, m->sec, m->nanosec);
    say_text(m->frame_id);
    if (o->frame) {
        printf("}, \"seq\": %" PRIu64 ", \"t0_us\": %" PRIu64 ", \"duration_us\": %" PRIu32 ", \"height\": %" PRIu32 ", \"width\": %" PRIu32
               ", \"events\": %" PRIu32 ", \"operator_name\": ", m->seq, m->time, m->duration_us, m->height, m->width, m->events);
        say_text(m->name);
        printf(", \"data\"");
    } else {
        printf("}, \"height\": %" PRIu32 ", \"width\": %" PRIu32 ", \"seq\": %" PRIu64 ", \"time_base\": %" PRIu64 ", \"encoding\": ",
               m->height, m->width, m->seq, m->time);
        say_text(m->name);
        printf(", \"is_bigendian\": %s, \"events\"", m->is_bigendian ? "true" : "false");
    }
    printf(": {\"length\": %zu, \"sha256\": \"%s\"}}}\n", m->length, hex);
}

// What was received so far: every number in the order of its coming.
struct tally {
    uint64_t received, disordered, room, *numbers;
};

static inline void take(struct tally *t, const struct options *o, const struct message *m) {
    say("received", t->received, o, m);
    if (t->received && m->seq <= t->numbers[t->received - 1]) t->disordered++;
    if (t->received == t->room) {
        t->room = t->room ? 2 * t->room : 1024;
        t->numbers = (uint64_t *)realloc(t->numbers, t->room * sizeof *t->numbers);
        if (!t->numbers) abort();
    }
    t->numbers[t->received++] = m->seq;
}

static inline int compare(const void *a, const void *b) {
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static inline void say_received(struct tally *t) {
    if (!t->received) {
        printf("{\"summary\": {\"received\": 0, \"first\": null, \"last\": null, \"lost\": [], \"disordered\": 0}}\n");
        return;
    }
    printf("{\"summary\": {\"received\": %" PRIu64 ", \"first\": %" PRIu64 ", \"last\": %" PRIu64 ", \"disordered\": %" PRIu64
           ", \"lost\": [", t->received, t->numbers[0], t->numbers[t->received - 1], t->disordered);
    qsort(t->numbers, t->received, sizeof *t->numbers, compare);
    const char *between = "";
    for (uint64_t i = 1; i < t->received; i++)
        for (uint64_t lost = t->numbers[i - 1] + 1; lost < t->numbers[i]; lost++, between = ", ") printf("%s%" PRIu64, between, lost);
    printf("]}}\n");
    free(t->numbers);
}
