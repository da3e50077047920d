/*
 * eecvs.hpp: owners in C++17 of what eecvs.h hands out. Failures are exceptions of type eecvs::error.
 */
#ifndef EECVS_HPP
#define EECVS_HPP

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <stdexcept>
#include <vector>

#include "eecvs.h"

namespace eecvs {

/* A status below 0. */
class error : public std::runtime_error {
public:
    explicit error(eecvs_status status) : std::runtime_error(eecvs_status_name(status)), status_(status) {}
    eecvs_status status() const noexcept { return status_; }

private:
    eecvs_status status_;
};

inline eecvs_status check(eecvs_status status) {
    if (status < 0) throw error(status);
    return status;
}

inline eecvs_config config(std::uint16_t width, std::uint16_t height) {
    eecvs_config filled;
    check(eecvs_config_init(&filled, width, height));
    return filled;
}

/* An encoder with its memory; it can be moved. */
class encoder {
public:
    explicit encoder(const eecvs_config &config) {
        std::size_t bytes = 0;
        check(eecvs_encoder_size(&config, &bytes));
        memory_ = std::make_unique<std::uint64_t[]>((bytes + 7) / 8);
        check(eecvs_encoder_new(&config, memory_.get(), bytes, &it_));
    }

    /* Takes events, and calls frame(const std::uint8_t *, std::size_t) with each frame that they complete. */
    template <typename Frame> void push(const eecvs_event *events, std::size_t count, Frame &&frame) {
        for (std::size_t at = 0, taken = 0; at < count; at += taken)
            if (check(eecvs_push(it_, events + at, count - at, &taken)) == EECVS_STATUS_CLOSED) frames(frame);
    }

    /* Takes EVT 2.0 words likewise. */
    template <typename Frame> void push_evt2(const void *words, std::size_t count, Frame &&frame) {
        const auto *bytes = static_cast<const std::uint8_t *>(words);
        for (std::size_t at = 0, taken = 0; at < count; at += taken)
            if (check(eecvs_push_evt2(it_, bytes + 4 * at, count - at, &taken)) == EECVS_STATUS_CLOSED)
                frames(frame);
    }

    /* Takes EVT 2.1 words likewise. */
    template <typename Frame>
    void push_evt21(const void *words, std::size_t count, eecvs_word_order order, Frame &&frame) {
        const auto *bytes = static_cast<const std::uint8_t *>(words);
        for (std::size_t at = 0, taken = 0; at < count; at += taken)
            if (check(eecvs_push_evt21(it_, bytes + 8 * at, count - at, order, &taken)) == EECVS_STATUS_CLOSED)
                frames(frame);
    }

    /* Takes AER words likewise, which have arrived at now_us. */
    template <typename Frame>
    void push_aer(const std::uint32_t *words, std::size_t count, std::uint64_t now_us, Frame &&frame) {
        for (std::size_t at = 0, taken = 0; at < count; at += taken)
            if (check(eecvs_push_aer(it_, words + at, count - at, now_us, &taken)) == EECVS_STATUS_CLOSED)
                frames(frame);
    }

    /* Closes the last window. */
    template <typename Frame> void flush(Frame &&frame) {
        check(eecvs_flush(it_));
        frames(frame);
    }

    eecvs_counts counts() const {
        eecvs_counts counts;
        check(eecvs_get_counts(it_, &counts));
        return counts;
    }

    /* For the functions of eecvs.h. */
    eecvs_encoder *get() const noexcept { return it_; }

private:
    template <typename Frame> void frames(Frame &&frame) {
        std::size_t bytes = 0;
        while (check(eecvs_next_frame(it_, room_.data(), room_.size(), &bytes)) == EECVS_STATUS_OK)
            frame(static_cast<const std::uint8_t *>(room_.data()), bytes);
    }

    std::unique_ptr<std::uint64_t[]> memory_;
    eecvs_encoder *it_ = nullptr;
    std::vector<std::uint8_t> room_ = std::vector<std::uint8_t>(std::size_t{1} << 16);
};

#ifdef EECVS_HAS_DECODER

/* A decoder; it can be moved. */
class decoder {
public:
    decoder() : it_(eecvs_decoder_new()) {
        if (!it_) throw std::bad_alloc();
    }

    /* Takes bytes, and appends the events that they complete. */
    void push(const std::uint8_t *bytes, std::size_t count, std::vector<eecvs_event> &events) {
        check(eecvs_decoder_push(it_.get(), bytes, count));
        take(events);
    }

    /* Appends the last events. */
    void finish(std::vector<eecvs_event> &events) {
        check(eecvs_decoder_finish(it_.get()));
        take(events);
    }

    eecvs_losses losses() const {
        eecvs_losses losses;
        check(eecvs_decoder_losses(it_.get(), &losses));
        return losses;
    }

    /* For the functions of eecvs.h. */
    eecvs_decoder *get() const noexcept { return it_.get(); }

private:
    struct freed {
        void operator()(eecvs_decoder *it) const noexcept { eecvs_decoder_free(it); }
    };

    void take(std::vector<eecvs_event> &events) {
        std::size_t count = 0;
        do {
            const std::size_t before = events.size();
            events.resize(before + 4096);
            const eecvs_status status = eecvs_decoder_next(it_.get(), events.data() + before, 4096, &count);
            events.resize(before + count);
            check(status);
        } while (count > 0);
    }

    std::unique_ptr<eecvs_decoder, freed> it_;
};

#endif

} // namespace eecvs

#endif
