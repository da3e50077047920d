//! Where the walks in assembly find their segments.
#![allow(unsafe_code)]

use crate::group::Group;
use crate::window::Window;

/// What a walk goes over.
#[repr(C)]
pub struct Source<'w> {
    pub group: *mut Group,
    pub window: *mut Window<'w>,
}

/// Goes to the next 32 segments of which some have events; returns those, 0 where there are none.
///
/// # Safety
/// Both are there, and nothing else has a reference to them.
pub unsafe extern "C" fn next_segments(source: &mut Source<'_>, first: &mut u32) -> u32 {
    // SAFETY: as above.
    let (group, window) = unsafe { (&mut *source.group, &mut *source.window) };
    match window.take_segments(&mut group.cursor) {
        Some((first_segment, segments)) => {
            *first = first_segment;
            segments
        }
        None => 0,
    }
}
