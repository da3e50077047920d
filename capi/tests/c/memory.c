/* What the header reserves for an encoder with the fast coder is enough, and hardly more than it takes. */
#include <stdio.h>

#include "eecvs.h"

static uint64_t memory[EECVS_FAST_BYTES(640, 480, 4096) / 8];

int main(void) {
    const uint16_t sides[] = {1, 31, 32, 33, 320, 346, 1280, 2048};
    const uint32_t counts[] = {1, 2, 2047, 4096, 1000000};
    for (size_t w = 0; w < sizeof sides / sizeof *sides; w++)
        for (size_t h = 0; h < sizeof sides / sizeof *sides; h++)
            for (size_t n = 0; n < sizeof counts / sizeof *counts; n++) {
                eecvs_config config;
                size_t bytes;
                eecvs_config_init(&config, sides[w], sides[h]);
                config.window_events = counts[n];
                if (eecvs_encoder_size(&config, &bytes) != EECVS_STATUS_OK) return 1;
                const size_t reserved = EECVS_FAST_BYTES(sides[w], sides[h], counts[n]);
                if (reserved < bytes || reserved > bytes + 100) {
                    printf("%u x %u, %u events: %zu of %zu\n", sides[w], sides[h], (unsigned)counts[n], reserved, bytes);
                    return 2;
                }
            }
    eecvs_config config;
    eecvs_encoder *encoder;
    eecvs_config_init(&config, 640, 480);
    config.window_events = 4096;
    return eecvs_encoder_new(&config, memory, sizeof memory, &encoder) == EECVS_STATUS_OK ? 0 : 3;
}
