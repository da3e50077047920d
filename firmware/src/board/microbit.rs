//! micro:bit (Cortex-M0), in QEMU only.

/// Returns whether this is an emulator, which takes semihosting calls.
#[must_use]
pub fn is_emulated() -> bool {
    true
}
