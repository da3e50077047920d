/* As much of the C library as the examples use, where there is none: see libc.c. */
#ifndef STDLIB_H
#define STDLIB_H

void exit(int status);
int atoi(const char *text);

#endif
