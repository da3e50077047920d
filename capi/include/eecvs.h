/*
 * eecvs.h: encodes the events of an event camera, and decodes them.
 *
 * Made of the Rust sources in capi/src: EECVS_BLESS=1 cargo test -p eecvs-capi --test header writes it again.
 */


#ifndef EECVS_H
#define EECVS_H

#include <stddef.h>
#include <stdint.h>

/* The decoder is not in the libraries for microcontrollers: define EECVS_ENCODER_ALONE there. */
#ifndef EECVS_ENCODER_ALONE
#define EECVS_HAS_DECODER
#endif

/**
 * Version of the interface: it is raised when a function or a structure changes.
 */
#define EECVS_ABI_VERSION 1

/**
 * Alignment of an encoder's memory in bytes.
 */
#define EECVS_ALIGN 8

/**
 * Smallest room for a frame in bytes.
 */
#define EECVS_FRAME_BYTES_MIN 2048

/**
 * What a function returns: 0 and more are no errors.
 */
enum eecvs_status
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * All was done.
     */
    EECVS_STATUS_OK = 0,
    /**
     * The window is closed, or there are decoded events to take: take the frames or the events, then go on with the
     * rest of the input.
     */
    EECVS_STATUS_CLOSED = 1,
    /**
     * There is nothing left: no frame of a closed window, no window of the frames so far.
     */
    EECVS_STATUS_NONE = 2,
    /**
     * A pointer is null, or not aligned for what it points to.
     */
    EECVS_STATUS_ERROR_POINTER = -1,
    /**
     * The memory is too small: see `eecvs_encoder_size`.
     */
    EECVS_STATUS_ERROR_MEMORY = -2,
    /**
     * The width, the height, the duration or the number of events of windows is 0 or too large.
     */
    EECVS_STATUS_ERROR_WINDOW = -3,
    /**
     * The coder or the transform has no such number, or this library was built without it.
     */
    EECVS_STATUS_ERROR_CODER = -4,
    /**
     * M is not in 1 to 64, or the step is not in 2^-15 to 2^8.
     */
    EECVS_STATUS_ERROR_COEFFICIENTS = -5,
    /**
     * The coder has no tolerance of times, or no filter of isolated events.
     */
    EECVS_STATUS_ERROR_FIDELITY = -6,
    /**
     * The budget is too small for the headers of a second's windows, or the coder has none.
     */
    EECVS_STATUS_ERROR_BUDGET = -7,
    /**
     * A field that is 0 or 1 is neither.
     */
    EECVS_STATUS_ERROR_FLAG = -8,
    /**
     * The room for a frame is below `EECVS_FRAME_BYTES_MIN`.
     */
    EECVS_STATUS_ERROR_ROOM = -9,
    /**
     * The pixel is not on the sensor.
     */
    EECVS_STATUS_ERROR_OUTSIDE = -10,
    /**
     * There is no room for another hot pixel.
     */
    EECVS_STATUS_ERROR_HOT = -11,
    /**
     * The frames hold no windows, or more than a limit allows.
     */
    EECVS_STATUS_ERROR_FRAMES = -12,
    /**
     * The decoder was finished.
     */
    EECVS_STATUS_ERROR_FINISHED = -13,
    /**
     * A fault of the library itself: please report it.
     */
    EECVS_STATUS_ERROR_INTERNAL = -14,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum eecvs_status eecvs_status;
#else
typedef int32_t eecvs_status;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * How windows are coded: values of `eecvs_config.coder`.
 */
enum eecvs_coder
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint8_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * The events themselves, quickly.
     */
    EECVS_CODER_FAST = 0,
    /**
     * The events themselves in their order of arrival: the quickest, for more bits. Exact, and without a budget.
     */
    EECVS_CODER_QUICK = 1,
    /**
     * The events themselves, in the fewest bits that a microcontroller has room for.
     */
    EECVS_CODER_DENSE = 2,
    /**
     * Coefficients of a transform.
     */
    EECVS_CODER_TRANSFORM = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum eecvs_coder eecvs_coder;
#else
typedef uint8_t eecvs_coder;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Transforms: values of `eecvs_config.transform`.
 */
enum eecvs_transform
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint8_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * Discrete cosine transform.
     */
    EECVS_TRANSFORM_DCT = 0,
    /**
     * Discrete-time Fourier transform.
     */
    EECVS_TRANSFORM_DTFT = 1,
    /**
     * Haar wavelet transform.
     */
    EECVS_TRANSFORM_DWT = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum eecvs_transform eecvs_transform;
#else
typedef uint8_t eecvs_transform;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The order of the bytes of an EVT 2.1 word.
 */
enum eecvs_word_order
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint8_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * The whole word is little-endian: GenX320.
     */
    EECVS_WORD_ORDER_LITTLE = 0,
    /**
     * The upper half comes first, each half little-endian: IMX636 and Gen 4.1.
     */
    EECVS_WORD_ORDER_UPPER_FIRST = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum eecvs_word_order eecvs_word_order;
#else
typedef uint8_t eecvs_word_order;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

#if defined(EECVS_HAS_DECODER)
/**
 * A decoder of frames.
 */
typedef struct eecvs_decoder eecvs_decoder;
#endif

/**
 * An encoder, in memory of the caller: free that when it is no longer used.
 */
typedef struct eecvs_encoder eecvs_encoder;

/**
 * Configuration of an encoder. `eecvs_config_init` fills it; change what differs.
 */
typedef struct eecvs_config {
    /**
     * Columns of the sensor, 1 to 2048.
     */
    uint16_t width;
    /**
     * Rows of the sensor, 1 to 2048.
     */
    uint16_t height;
    /**
     * Duration of a window in microseconds, at least 1.
     */
    uint32_t window_us;
    /**
     * Most events of a window: a fuller one is closed early. On machines of 32 bits at most 32767.
     */
    uint32_t window_events;
    /**
     * How windows are coded, an `eecvs_coder`.
     */
    uint8_t coder;
    /**
     * The transform, an `eecvs_transform`; also that of the volume that a decoder makes of events.
     */
    uint8_t transform;
    /**
     * Number of coefficients M, 1 to 64.
     */
    uint8_t m;
    /**
     * log2 of the quantiser's step, -15 to 8.
     */
    int8_t step_log2;
    /**
     * Largest error of a decoded time in microseconds; 0 for exact times, unless a budget asks for less. Of events alone,
     * not of the quick coder.
     */
    uint32_t tolerance_us;
    /**
     * Most bytes of the frames of any second; 0 for no budget. Of events alone, not of the quick coder. A window that would
     * take more has its times within a tolerance, up to half a window, then fewer events: `eecvs_losses` counts both.
     */
    uint32_t bytes_per_second;
    /**
     * Room for so many pixels that are never sent: see `eecvs_add_hot`.
     */
    uint32_t hot_pixels;
    /**
     * Number of windows after which the dense coder begins anew, so that a decoder that has lost a frame can go on.
     */
    uint16_t key_windows;
    /**
     * 1 to remove events without another one at their pixel or at a neighbour in the same window, else 0.
     */
    uint8_t remove_isolated;
    /**
     * 1 to send pixels of few events as the times of these in place of coefficients, else 0.
     */
    uint8_t few_as_times;
} eecvs_config;

/**
 * An event.
 */
typedef struct eecvs_event {
    /**
     * Time in microseconds.
     */
    uint64_t t_us;
    /**
     * Column.
     */
    uint16_t x;
    /**
     * Row.
     */
    uint16_t y;
    /**
     * 0 for OFF, any other value for ON.
     */
    uint8_t polarity;
} eecvs_event;

#if defined(EECVS_HAS_DECODER)
/**
 * What a decoder has seen.
 */
typedef struct eecvs_losses {
    /**
     * Frames decoded.
     */
    uint64_t frames;
    /**
     * Bytes that belong to no frame.
     */
    uint64_t damaged_bytes;
    /**
     * Frames that never came, by their numbers.
     */
    uint64_t frames_lost;
    /**
     * Frames that came and cannot be decoded: malformed, too large, or dependent on a lost one.
     */
    uint64_t frames_refused;
    /**
     * Events that the encoder counted as lost: outside the sensor, dropped before it, or late.
     */
    uint64_t events_dropped;
    /**
     * Events that its filter removed, and those of hot pixels.
     */
    uint64_t events_filtered;
    /**
     * Events that its budget left out.
     */
    uint64_t events_thinned;
    /**
     * Events decoded at times that are not exact: within a tolerance, the encoder's or its budget's, or of coefficients.
     */
    uint64_t events_approximate;
} eecvs_losses;
#endif

/**
 * What an encoder has done since it was made.
 */
typedef struct eecvs_counts {
    /**
     * Events taken, including those outside the sensor.
     */
    uint64_t events;
    /**
     * Events outside the sensor, which are in no frame.
     */
    uint64_t outside;
    /**
     * Events lost before the encoder, by `eecvs_count_dropped`.
     */
    uint64_t dropped;
    /**
     * Words that were neither events nor times, and events before the first time.
     */
    uint64_t ignored;
    /**
     * Frames made.
     */
    uint64_t frames;
    /**
     * Bytes of these.
     */
    uint64_t bytes;
} eecvs_counts;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Fills a configuration: the fast coder, exact times, windows of 32,768 us with at most 2,048 events, no budget, no
 * filter; for coefficients the DCT with M = 16 and a step of 2^-6.
 *
 * # Safety
 * `config` is null or points to a configuration that can be written.
 */
eecvs_status eecvs_config_init(struct eecvs_config *config,
                               uint16_t width,
                               uint16_t height);

#if defined(EECVS_HAS_DECODER)
/**
 * Makes a decoder; null if there is no memory. `eecvs_decoder_free` frees it.
 */
struct eecvs_decoder *eecvs_decoder_new(void);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Frees a decoder, or does nothing with null.
 *
 * # Safety
 * `it` is null or a decoder that is not used again.
 */
void eecvs_decoder_free(struct eecvs_decoder *it);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Takes bytes of frames, cut anywhere, from a file or a link. Take the events by `eecvs_decoder_next` before the next
 * call, or the bytes pile up. `EECVS_STATUS_ERROR_FRAMES` after `eecvs_decoder_next` has returned it: nothing follows.
 *
 * # Safety
 * `it` is a decoder that no other call has; `bytes` points to `count` bytes.
 */
eecvs_status eecvs_decoder_push(struct eecvs_decoder *it,
                                const uint8_t *bytes,
                                size_t count);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Says that no bytes follow, so that the last window can be taken.
 *
 * # Safety
 * `it` is a decoder that no other call has.
 */
eecvs_status eecvs_decoder_finish(struct eecvs_decoder *it);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Writes at most `room` decoded events, at least 1, to `events`, and how many to `*count`: window by window, each in the
 * order of its times.
 *
 * `EECVS_STATUS_NONE` if there are none until further bytes are pushed, or at the end after `eecvs_decoder_finish`.
 * Damaged and missing frames are left out and counted: `eecvs_decoder_losses`.
 *
 * # Safety
 * `it` is a decoder that no other call has; `events` points to `room` events that can be written; `count` can be written.
 */
eecvs_status eecvs_decoder_next(struct eecvs_decoder *it,
                                struct eecvs_event *events,
                                size_t room,
                                size_t *count);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Writes the sensor's size, which the first frame states: `EECVS_STATUS_NONE` before it.
 *
 * # Safety
 * `it` is a decoder that no other call has; `width` and `height` can be written.
 */
eecvs_status eecvs_decoder_sensor(struct eecvs_decoder *it, uint16_t *width, uint16_t *height);
#endif

#if defined(EECVS_HAS_DECODER)
/**
 * Writes what the decoder has seen so far to `*losses`.
 *
 * # Safety
 * `it` is a decoder that no other call has; `losses` can be written.
 */
eecvs_status eecvs_decoder_losses(struct eecvs_decoder *it, struct eecvs_losses *losses);
#endif

/**
 * Writes the bytes of memory that an encoder of this configuration takes to `*bytes`.
 *
 * # Safety
 * `config` and `bytes` are null or point to such values.
 */
eecvs_status eecvs_encoder_size(const struct eecvs_config *config, size_t *bytes);

/**
 * Makes an encoder in `memory`, of `bytes` bytes and aligned to `EECVS_ALIGN`, and writes it to `*made`; null if it
 * fails. The memory stays lent until the encoder is no longer used.
 *
 * # Safety
 * `config` and `made` are null or point to such values; `memory` is null, or `bytes` bytes can be read and written there
 * that nothing else uses.
 */
eecvs_status eecvs_encoder_new(const struct eecvs_config *config,
                               void *memory,
                               size_t bytes,
                               struct eecvs_encoder **made);

/**
 * Takes events from the front of `count` ones, and writes how many to `*taken`.
 *
 * `EECVS_STATUS_OK` if it took all. `EECVS_STATUS_CLOSED` if the window is closed, as the next event is not of it: take
 * its frames by `eecvs_next_frame`, then push the rest. Events outside the sensor are taken and counted.
 *
 * # Safety
 * `it` is an encoder that no other call has; `events` points to `count` events; `taken` is null or can be written.
 */
eecvs_status eecvs_push(struct eecvs_encoder *it,
                        const struct eecvs_event *events,
                        size_t count,
                        size_t *taken);

/**
 * Takes little-endian words of EVT 2.0 from the front of `count` ones, as a sensor sends them, and writes how many to
 * `*taken`. Otherwise as `eecvs_push`, at less than half the cost; `words` need not be aligned.
 *
 * # Safety
 * `it` is an encoder that no other call has; `words` points to 4 `count` bytes; `taken` is null or can be written.
 */
eecvs_status eecvs_push_evt2(struct eecvs_encoder *it,
                             const void *words,
                             size_t count,
                             size_t *taken);

/**
 * Takes words of EVT 2.1 from the front of `count` ones, whose bytes have an order of `eecvs_word_order`, and writes how
 * many to `*taken`; `EECVS_STATUS_ERROR_FLAG` if there is no such order. Otherwise as `eecvs_push_evt2`, with a time of
 * its own: an encoder takes words of one format. A word whose events are of two windows is taken with the second: push
 * it again, as the first of the rest; in place of another word it would be taken whole.
 *
 * # Safety
 * `it` is an encoder that no other call has; `words` points to 8 `count` bytes; `taken` is null or can be written.
 */
eecvs_status eecvs_push_evt21(struct eecvs_encoder *it,
                              const void *words,
                              size_t count,
                              uint8_t order,
                              size_t *taken);

/**
 * Takes words of AER from the front of `count` ones, as a GenX320 sends them over its parallel port, one to a `uint32_t`,
 * and writes how many to `*taken`. They have no time of their own: all have arrived at `now_us`. Otherwise as
 * `eecvs_push`; a word with a bit above the 19 of the format is ignored and counted.
 *
 * # Safety
 * `it` is an encoder that no other call has; `words` points to `count` words; `taken` is null or can be written.
 */
eecvs_status eecvs_push_aer(struct eecvs_encoder *it,
                            const uint32_t *words,
                            size_t count,
                            uint64_t now_us,
                            size_t *taken);

/**
 * Closes the open window, so that its frames can be taken: at the end of a recording.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_flush(struct eecvs_encoder *it);

/**
 * Closes the open window if its time has passed by the sensor's clock, although no event has come since.
 * `EECVS_STATUS_CLOSED` if there is a closed window, now or before: take its frames.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_pass(struct eecvs_encoder *it,
                        uint64_t now_us);

/**
 * Makes the next frame of the closed window in `out`, and writes its number of bytes to `*bytes`.
 *
 * `EECVS_STATUS_NONE` if there is none left, with 0 bytes: push further events. A frame has any size up to `room`, which
 * has to be at least `EECVS_FRAME_BYTES_MIN`; a window that takes more is several frames.
 *
 * # Safety
 * `it` is an encoder that no other call has; `out` points to `room` bytes that can be written; `bytes` can be written.
 */
eecvs_status eecvs_next_frame(struct eecvs_encoder *it,
                              uint8_t *out,
                              size_t room,
                              size_t *bytes);

/**
 * Keeps a pixel out of the open window and all later ones, as one that fires all the time; `eecvs_config.hot_pixels` is
 * the room. Frames count its events with those that a filter removed.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_add_hot(struct eecvs_encoder *it,
                           uint16_t x,
                           uint16_t y);

/**
 * Counts events that were lost before they could be pushed: the next frame says so, of at most 2^32 - 1.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_count_dropped(struct eecvs_encoder *it,
                                 uint32_t events);

/**
 * Changes `eecvs_config.bytes_per_second` from the next window on; 0 for no budget. One that the headers alone would
 * exceed is raised to what these take. See there for what a budget does to times.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_set_budget(struct eecvs_encoder *it,
                              uint32_t bytes_per_second);

/**
 * Changes `eecvs_config.tolerance_us` from the next window on.
 *
 * # Safety
 * `it` is an encoder that no other call has.
 */
eecvs_status eecvs_set_tolerance(struct eecvs_encoder *it, uint32_t tolerance_us);

/**
 * Writes what the encoder has done to `*counts`.
 *
 * # Safety
 * `it` is an encoder that no other call has; `counts` can be written.
 */
eecvs_status eecvs_get_counts(struct eecvs_encoder *it, struct eecvs_counts *counts);

/**
 * Returns a status as a few English words, also of numbers that are no status.
 */
const char *eecvs_status_name(int32_t status);

/**
 * Returns `EECVS_ABI_VERSION` of the library, to be compared with that of the header.
 */
uint32_t eecvs_abi_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* EECVS_H */

/**
 * Most bytes of an encoder's memory that are not for a window.
 */
#define EECVS_STATE_BYTES (sizeof(void *) < 8 ? 1280 : 1792)

/**
 * Bytes of memory that an encoder with the fast coder takes at most, to be lent as
 * static uint64_t memory[EECVS_FAST_BYTES(320, 320, 2048) / 8];
 * Each hot pixel takes 4 more, rounded up to 8. `eecvs_encoder_size` has the other coders' bytes.
 */
#define EECVS_FAST_BYTES(width, height, window_events)                                    \
    (EECVS_STATE_BYTES + 8 * (size_t)(window_events) +                                      \
     ((sizeof(void *) < 8 ? 2 : 4) * EECVS_SEGMENTS(width, height) + 7) / 8 * 8 +           \
     ((EECVS_SEGMENTS(width, height) + 31) / 32 * 4 + 7) / 8 * 8)

/**
 * Segments of a sensor: runs of 32 pixels in a row, each with a list of events.
 */
#define EECVS_SEGMENTS(width, height) (((size_t)(width) + 31) / 32 * (size_t)(height))
