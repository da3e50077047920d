// Encodes events that go across a sensor of 320 x 320, and prints how many bytes they take.
#define EECVS_ENCODER_ALONE
#include <eecvs.h>

static uint64_t memory[EECVS_FAST_BYTES(320, 320, 512) / 8];
static unsigned char frame[EECVS_FRAME_BYTES_MIN];

static void takeFrames(eecvs_encoder *encoder) {
    size_t bytes;
    // A product sends them here.
    while (eecvs_next_frame(encoder, frame, sizeof frame, &bytes) == EECVS_STATUS_OK) {}
}

void setup() {
    eecvs_config config;
    eecvs_encoder *encoder;
    eecvs_counts counts;
    Serial.begin(115200);
    eecvs_config_init(&config, 320, 320);
    config.window_events = 512;
    eecvs_status status = eecvs_encoder_new(&config, memory, sizeof memory, &encoder);
    if (status != EECVS_STATUS_OK) {
        Serial.println(eecvs_status_name(status));
        return;
    }
    for (uint32_t i = 0; i < 2000; i++) {
        eecvs_event event = {10 * i, (uint16_t)(i % 320), (uint16_t)(i / 7), (uint8_t)(i % 2)};
        while (eecvs_push(encoder, &event, 1, nullptr) == EECVS_STATUS_CLOSED) takeFrames(encoder);
    }
    eecvs_flush(encoder);
    takeFrames(encoder);
    eecvs_get_counts(encoder, &counts);
    Serial.print((unsigned long)counts.events);
    Serial.print(" events in ");
    Serial.print((unsigned long)counts.bytes);
    Serial.println(" bytes");
}

void loop() {}
