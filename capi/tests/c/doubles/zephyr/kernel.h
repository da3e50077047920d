/* In place of Zephyr's. */
#include <stdint.h>
