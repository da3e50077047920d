/* What a small image has of libeecvs: words from one buffer, frames into another, for a sensor of 320 x 320 with windows
 * of 2,048 events. It is linked to be measured, and not run. */
#include "eecvs.h"

static uint64_t memory[EECVS_FAST_BYTES(320, 320, 2048) / 8];
static unsigned char frame[EECVS_FRAME_BYTES_MIN];
volatile unsigned char words[512];
volatile unsigned char *volatile sent;

int main(int count, char **arguments) {
    eecvs_config config;
    eecvs_encoder *encoder;
    size_t taken, bytes;
    (void)arguments;
    eecvs_config_init(&config, 320, 320);
    config.window_events = 2048;
    if (eecvs_encoder_new(&config, memory, sizeof memory, &encoder) != EECVS_STATUS_OK) return 1;
    while (count) {
        eecvs_push_evt2(encoder, (const void *)words, sizeof words / 4, &taken);
        while (eecvs_next_frame(encoder, frame, sizeof frame, &bytes) == EECVS_STATUS_OK) sent = frame;
    }
    return eecvs_flush(encoder) != EECVS_STATUS_OK;
}
