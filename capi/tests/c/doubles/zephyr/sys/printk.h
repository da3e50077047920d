/* In place of Zephyr's. */
#include <stdio.h>
#define printk printf
