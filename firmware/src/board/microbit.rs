//! micro:bit (Cortex-M0), in QEMU only.

/// Whether this is an emulator, which takes semihosting calls.
#[must_use]
pub fn is_emulated() -> bool {
    true
}
