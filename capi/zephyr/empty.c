/* A library of Zephyr's has a source; this one's is in Rust. */
typedef int eecvs_module;
