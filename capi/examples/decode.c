/* Decodes frames on stdin to lines of "t_us x y polarity" on stdout: decode < frames > events.txt */
#include <inttypes.h>
#include <stdio.h>

#include "eecvs.h"

static unsigned char bytes[1 << 16];
static eecvs_event events[4096];

int main(void) {
    eecvs_decoder *decoder = eecvs_decoder_new();
    size_t count, read;
    eecvs_losses losses;
    if (decoder == NULL) return 1;
    do {
        read = fread(bytes, 1, sizeof bytes, stdin);
        if (read > 0 ? eecvs_decoder_push(decoder, bytes, read) : eecvs_decoder_finish(decoder)) return 1;
        while (eecvs_decoder_next(decoder, events, 4096, &count) == EECVS_STATUS_OK)
            for (size_t i = 0; i < count; i++)
                printf("%" PRIu64 " %u %u %u\n", events[i].t_us, (unsigned)events[i].x, (unsigned)events[i].y,
                       (unsigned)events[i].polarity);
    } while (read > 0);
    eecvs_decoder_losses(decoder, &losses);
    eecvs_decoder_free(decoder);
    fprintf(stderr, "%" PRIu64 " frames, %" PRIu64 " lost, %" PRIu64 " bytes of none\n", losses.frames, losses.frames_lost,
            losses.damaged_bytes);
    return losses.frames > 0 && losses.frames_lost == 0 && losses.damaged_bytes == 0 ? 0 : 1;
}
