//! The stack's floor. The linker scripts put the stack below all other memory, so that an overflow
//! leaves RAM and faults instead of overwriting a buffer; the runtime paints it before `main`.

use core::ptr::addr_of;

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Returns whether a stack pointer is below the stack.
#[must_use]
pub fn is_overflow(pointer: u32) -> bool {
    pointer < addr_of!(_stack_end) as u32
}

/// Returns two words of the stack, `at` words from a pointer; `None` if they are not all in it.
#[must_use]
pub fn words(pointer: u32, at: u32) -> Option<[u32; 2]> {
    let first = pointer.checked_add(4 * at)?;
    let end = addr_of!(_stack_start) as u32;
    if !first.is_multiple_of(4) || is_overflow(pointer) || first.checked_add(8)? > end {
        return None;
    }
    let first = core::ptr::with_exposed_provenance::<[u32; 2]>(first as usize);
    // SAFETY: both words are aligned and lie in the stack, which is RAM.
    Some(unsafe { first.read_volatile() })
}

/// Returns how many bytes of the stack were ever written to.
#[must_use]
pub fn used_bytes() -> u32 {
    let start = addr_of!(_stack_start);
    let mut word = addr_of!(_stack_end);
    // SAFETY: both addresses are from the linker, and every word between them is RAM. The read is volatile, as the
    // words below the stack pointer belong to no Rust object.
    while word < start && unsafe { word.read_volatile() } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    (start as u32).wrapping_sub(word as u32)
}
