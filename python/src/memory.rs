//! Growing memory of arrays. The kernel clears memory page by page as it is first written, which takes longer than most
//! readers do: large arrays ask for large pages, as NumPy's own do.

use std::collections::TryReserveError;
use std::mem;
use std::sync::Mutex;

use event_types::Event;

/// Bytes from which on large pages are asked for.
const LARGE_BYTES: usize = 4 << 20;

/// Bytes of which the C library makes a mapping of their own, in any case: more than the largest threshold of glibc, 32 MiB.
/// Memory in its heap is given back and cleared in small pages again and again.
const MAPPED_BYTES: usize = 33 << 20;

/// Most bytes that are reserved by a guess. Memory that is not written takes nothing but addresses.
const GUESS_BYTES_MAX: usize = 1 << 30;

/// Bytes from which on the memory of an array is kept, and most bytes that are.
const KEPT_BYTES: [usize; 2] = [1 << 20, 64 << 20];

/// The memory of the latest large array that was let go of, without events. The kernel would clear it anew for the next
/// one, which takes longer than most readers do.
static KEPT: Mutex<Vec<Event>> = Mutex::new(Vec::new());

/// Returns memory for about as many events, without events: that of an earlier array if it is as large, or none.
pub fn of_earlier(about: u64) -> Vec<Event> {
    // Where another thread looks, or looked when this process was forked, there is none.
    let Ok(mut kept) = KEPT.try_lock() else {
        return Vec::new();
    };
    if kept.capacity() as u64 >= about {
        return mem::take(&mut *kept);
    }
    Vec::new()
}

/// Returns whether memory for so many events is kept when its array is let go of. Until then it keeps its size: what is not
/// written takes nothing but addresses.
pub const fn is_kept(events: usize) -> bool {
    let bytes = events.saturating_mul(size_of::<Event>());
    KEPT_BYTES[0] <= bytes && bytes <= KEPT_BYTES[1]
}

/// Keeps the memory of an array that was let go of.
pub fn keep(mut events: Vec<Event>) {
    events.clear();
    if is_kept(events.capacity())
        && let Ok(mut kept) = KEPT.try_lock()
    {
        *kept = events;
    }
}

/// Makes room for `more` values.
///
/// # Errors
/// The system refuses the memory.
pub fn room<T>(values: &mut Vec<T>, more: usize) -> Result<(), TryReserveError> {
    let before = values.capacity();
    values.try_reserve(more)?;
    if values.capacity() != before {
        large_pages(values);
    }
    Ok(())
}

/// Makes room for about as many values, if the system has it: a guess.
pub fn guess<T>(values: &mut Vec<T>, about: u64) {
    let count = |bytes: usize| (bytes / size_of::<T>()) as u64;
    let about = if about >= count(LARGE_BYTES) {
        about.max(count(MAPPED_BYTES))
    } else {
        about
    };
    // What is refused here is asked for as it is needed.
    let _ = room(values, about.min(count(GUESS_BYTES_MAX)) as usize);
}

/// Asks for large pages for memory that is not written yet.
#[cfg(target_os = "linux")]
fn large_pages<T>(values: &mut Vec<T>) {
    use rustix::mm::{Advice, madvise};
    const PAGE: usize = 1 << 12;
    let spare = values.spare_capacity_mut();
    let bytes = size_of_val(spare);
    if bytes < LARGE_BYTES {
        return;
    }
    let start = spare.as_mut_ptr().cast::<u8>();
    let skip = start.align_offset(PAGE);
    let whole = bytes.saturating_sub(skip) & !(PAGE - 1);
    // SAFETY: these are whole pages inside of memory that the vector owns. The advice changes how they are backed, and
    // nothing of what is in them.
    #[allow(unsafe_code)]
    let _advised = unsafe {
        madvise(
            start.wrapping_add(skip).cast(),
            whole,
            Advice::LinuxHugepage,
        )
    };
}

/// Other systems choose by themselves.
#[cfg(not(target_os = "linux"))]
fn large_pages<T>(_: &mut Vec<T>) {
    let _ = LARGE_BYTES;
}
