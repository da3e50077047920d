/* The start of a C program on a bare core in QEMU, and as much of the C library as the examples use: their standard
 * input and output are the files `in` and `out` of the host, by semihosting. */
#include <stdarg.h>
#include <stdint.h>

#include "stdio.h"
#include "stdlib.h"

extern char stack_top[], data_start[], data_end[], data_load[], bss_start[], bss_end[];
extern int main(int count, char **arguments);

enum { SYS_OPEN = 0x01, SYS_WRITE = 0x05, SYS_READ = 0x06, SYS_GET_CMDLINE = 0x15, SYS_EXIT_EXTENDED = 0x20 };

static intptr_t host(int operation, void *arguments) {
#if defined(__riscv)
    register intptr_t a0 __asm__("a0") = operation;
    register void *a1 __asm__("a1") = arguments;
    __asm__ volatile(".option push\n.option norvc\n.balign 16\n"
                     "slli x0, x0, 0x1f\nebreak\nsrai x0, x0, 7\n.option pop"
                     : "+r"(a0) : "r"(a1) : "memory");
    return a0;
#else
    register intptr_t r0 __asm__("r0") = operation;
    register void *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
#endif
}

struct file {
    const char *name;
    intptr_t mode; /* that of semihosting: 1 for "rb", 5 for "wb" */
    intptr_t handle; /* one more than the host's; 0 until it is open */
};
static FILE files[3] = {{"in", 1, 0}, {"out", 5, 0}, {":tt", 5, 0}};
FILE *const stdin = &files[0], *const stdout = &files[1], *const stderr = &files[2];

/* Reads or writes; returns how many bytes it did. */
static size_t transfer(int operation, const void *bytes, size_t count, FILE *file) {
    if (file->handle == 0) {
        size_t length = 0;
        while (file->name[length]) length++;
        file->handle = 1 + host(SYS_OPEN, (intptr_t[]){(intptr_t)file->name, file->mode, (intptr_t)length});
    }
    if (file->handle == 0) exit(98);
    intptr_t left = host(operation, (intptr_t[]){file->handle - 1, (intptr_t)bytes, (intptr_t)count});
    return left < 0 || (size_t)left > count ? 0 : count - (size_t)left;
}

size_t fread(void *to, size_t size, size_t count, FILE *file) {
    return transfer(SYS_READ, to, size * count, file) / size;
}

size_t fwrite(const void *from, size_t size, size_t count, FILE *file) {
    return transfer(SYS_WRITE, from, size * count, file) / size;
}

/* Knows %s alone. */
int fprintf(FILE *file, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    for (; *format; format++) {
        if (format[0] == '%' && format[1] == 's') {
            for (const char *text = va_arg(arguments, const char *); *text; text++) fwrite(text, 1, 1, file);
            format++;
        } else {
            fwrite(format, 1, 1, file);
        }
    }
    va_end(arguments);
    return 0;
}

/* Nothing is buffered. */
int fflush(FILE *file) {
    (void)file;
    return 0;
}

void exit(int status) {
    host(SYS_EXIT_EXTENDED, (intptr_t[]){0x20026, status});
    for (;;) {}
}

int atoi(const char *text) {
    int number = 0;
    for (; *text >= '0' && *text <= '9'; text++) number = 10 * number + (*text - '0');
    return number;
}

/* Any fault or interrupt ends the program. */
static void fault(void) { exit(99); }

static void run(void) {
    static char line[256];
    static char *arguments[16];
    int count = 0;
    intptr_t size = sizeof line;
    for (char *to = data_start, *from = data_load; to < data_end;) *to++ = *from++;
    for (char *to = bss_start; to < bss_end;) *to++ = 0;
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the FPU and the vector unit */
#endif
    host(SYS_GET_CMDLINE, (intptr_t[]){(intptr_t)line, size});
    for (char *at = line; *at && count < 16;) {
        while (*at == ' ') *at++ = 0;
        if (*at) arguments[count++] = at;
        while (*at && *at != ' ') at++;
    }
    exit(main(count, arguments));
}

#if defined(__riscv)
__attribute__((naked, section(".vectors"), used)) static void reset(void) {
    __asm__("la t0, %1\ncsrw mtvec, t0\nla sp, stack_top\ncall %0" ::"i"(run), "i"(fault));
}
#else
__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))stack_top, run, fault, fault, fault, fault, fault, fault,
    fault, fault, fault, fault, fault, fault, fault, fault,
};
#endif
