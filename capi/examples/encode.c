/* Encodes EVT 2.0 words on stdin to frames on stdout: encode WIDTH HEIGHT < words > frames */
#include <stdio.h>
#include <stdlib.h>

#include "eecvs.h"

static uint64_t memory[1 << 15]; /* 256 KiB, aligned to EECVS_ALIGN */
static unsigned char words[4 * 1024], frame[4096];

static void fail(eecvs_status status) {
    fprintf(stderr, "encode: %s\n", eecvs_status_name(status));
    exit(1);
}

static void take_frames(eecvs_encoder *encoder) {
    size_t bytes;
    eecvs_status status;
    while ((status = eecvs_next_frame(encoder, frame, sizeof frame, &bytes)) == EECVS_STATUS_OK)
        fwrite(frame, 1, bytes, stdout);
    if (status != EECVS_STATUS_NONE) fail(status);
}

int main(int count, char **arguments) {
    eecvs_config config;
    eecvs_encoder *encoder;
    if (count != 3) return 2;
    eecvs_config_init(&config, (uint16_t)atoi(arguments[1]), (uint16_t)atoi(arguments[2]));
    eecvs_status status = eecvs_encoder_new(&config, memory, sizeof memory, &encoder);
    if (status != EECVS_STATUS_OK) fail(status);
    for (size_t read; (read = fread(words, 4, sizeof words / 4, stdin)) > 0;)
        for (size_t at = 0, taken; at < read; at += taken) {
            status = eecvs_push_evt2(encoder, words + 4 * at, read - at, &taken);
            if (status == EECVS_STATUS_CLOSED) take_frames(encoder);
            else if (status != EECVS_STATUS_OK) fail(status);
        }
    eecvs_flush(encoder);
    take_frames(encoder);
    return fflush(stdout) == 0 ? 0 : 1;
}
