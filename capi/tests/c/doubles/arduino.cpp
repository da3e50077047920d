// Runs the sketch of Arduino's library: in place of Arduino's core.
#include <cstdio>

struct {
    void begin(unsigned long) {}
    void print(unsigned long number) { std::printf("%lu", number); }
    void print(const char *text) { std::fputs(text, stdout); }
    void println(const char *text) { std::puts(text); }
} Serial;

#include "../../../arduino/examples/encode/encode.ino"

int main() {
    setup();
    loop();
}
