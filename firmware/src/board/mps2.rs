//! ARM MPS2+ boards AN386 (Cortex-M4) and AN500 (Cortex-M7), in QEMU only.

/// Whether this is an emulator, which takes semihosting calls.
#[must_use]
pub fn is_emulated() -> bool {
    true
}
