/* As much of the C library as the examples use, where there is none: see libc.c. */
#ifndef STDIO_H
#define STDIO_H

#include <stddef.h>

typedef struct file FILE;
extern FILE *const stdin, *const stdout, *const stderr;

size_t fread(void *to, size_t size, size_t count, FILE *file);
size_t fwrite(const void *from, size_t size, size_t count, FILE *file);
int fprintf(FILE *file, const char *format, ...);
int fflush(FILE *file);

#endif
