/* Encodes events that go across a sensor of 320 x 320, and prints how many bytes they take. */
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#include "eecvs.h"

static uint64_t memory[EECVS_FAST_BYTES(320, 320, 1024) / 8];
static unsigned char frame[EECVS_FRAME_BYTES_MIN];

static void take_frames(eecvs_encoder *encoder) {
    size_t bytes;
    /* A product sends them here. */
    while (eecvs_next_frame(encoder, frame, sizeof frame, &bytes) == EECVS_STATUS_OK) {}
}

int main(void) {
    eecvs_config config;
    eecvs_encoder *encoder;
    eecvs_counts counts;
    eecvs_config_init(&config, 320, 320);
    config.window_events = 1024;
    eecvs_status status = eecvs_encoder_new(&config, memory, sizeof memory, &encoder);
    if (status != EECVS_STATUS_OK) {
        printk("%s\n", eecvs_status_name(status));
        return 1;
    }
    for (uint32_t i = 0; i < 2000; i++) {
        const eecvs_event event = {.t_us = 10 * i, .x = (uint16_t)(i % 320), .y = (uint16_t)(i / 7), .polarity = i % 2};
        while (eecvs_push(encoder, &event, 1, NULL) == EECVS_STATUS_CLOSED) take_frames(encoder);
    }
    eecvs_flush(encoder);
    take_frames(encoder);
    eecvs_get_counts(encoder, &counts);
    printk("%u events in %u bytes of %u frames\n", (unsigned)counts.events, (unsigned)counts.bytes, (unsigned)counts.frames);
    return 0;
}
