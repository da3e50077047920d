// Encodes events and decodes them again: 0 if every event comes back.
#include <algorithm>
#include <tuple>
#include <vector>

#include "eecvs.hpp"

int main() {
    eecvs_config config = eecvs::config(64, 48);
    config.window_us = 1000;
    eecvs::encoder encoder(config);
    eecvs::decoder decoder;
    std::vector<eecvs_event> sent, back;
    for (std::uint64_t i = 0; i < 20000; i++)
        sent.push_back({7 * i, static_cast<std::uint16_t>(i * 31 % 64), static_cast<std::uint16_t>(i * 17 % 48),
                        static_cast<std::uint8_t>(i % 2)});
    auto take = [&](const std::uint8_t *bytes, std::size_t count) { decoder.push(bytes, count, back); };
    encoder.push(sent.data(), sent.size(), take);
    encoder.flush(take);
    decoder.finish(back);
    auto key = [](const eecvs_event &e) { return std::make_tuple(e.t_us, e.x, e.y, e.polarity); };
    std::sort(back.begin(), back.end(), [&](auto &a, auto &b) { return key(a) < key(b); });
    auto is_same = [&](auto &a, auto &b) { return key(a) == key(b); };
    bool all = std::equal(sent.begin(), sent.end(), back.begin(), back.end(), is_same);
    try { // A failure is an exception.
        eecvs_config wrong = eecvs::config(0, 48);
        eecvs::encoder{wrong};
        all = false;
    } catch (const eecvs::error &error) {
        all = all && error.status() == EECVS_STATUS_ERROR_WINDOW;
    }
    return all && encoder.counts().events == 20000 && decoder.losses().frames_lost == 0 ? 0 : 1;
}
