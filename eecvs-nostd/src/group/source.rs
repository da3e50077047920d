//! Supplies the walks in assembly with segments.
#![allow(unsafe_code)]

use crate::group::Group;
use crate::window::Window;

/// The group and the window that a walk visits.
#[repr(C)]
pub struct Source<'w> {
    pub group: *mut Group,
    pub window: *mut Window<'w>,
}

/// Moves to the next 32 segments of which some have events. Returns these segments as bits, or 0 after the last,
/// and writes the number of the first of the 32 to `first`.
///
/// # Safety
/// Both pointers in `source` must be valid, and nothing else may hold a reference to what they point to.
pub unsafe extern "C" fn next_segments(source: &mut Source<'_>, first: &mut u32) -> u32 {
    // SAFETY: the caller guarantees both, as stated above.
    let (group, window) = unsafe { (&mut *source.group, &mut *source.window) };
    match window.take_segments(&mut group.cursor) {
        Some((first_segment, segments)) => {
            *first = first_segment;
            segments
        }
        None => 0,
    }
}
