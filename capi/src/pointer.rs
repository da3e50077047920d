//! Pointers of callers.

use crate::status::EecvsStatus;

/// Returns whether a pointer can be used at all.
pub fn is_lent<T>(place: *const T) -> bool {
    !place.is_null() && place.is_aligned()
}

/// Returns what a pointer and a number point to.
///
/// # Safety
/// The pointer is null, not aligned, or `count` values that nobody changes can be read there during the call.
pub unsafe fn slice<'a, T>(first: *const T, count: usize) -> Result<&'a [T], EecvsStatus> {
    if count == 0 {
        return Ok(&[]);
    }
    let is_sized = count
        .checked_mul(size_of::<T>())
        .is_some_and(|bytes| bytes <= isize::MAX as usize);
    if !is_lent(first) || !is_sized {
        return Err(EecvsStatus::ErrorPointer);
    }
    // SAFETY: checked, and as the caller promises.
    Ok(unsafe { core::slice::from_raw_parts(first, count) })
}

/// Writes a result to where the caller wants it; nowhere if that is null.
///
/// # Safety
/// The pointer is null, not aligned, or can be written.
pub unsafe fn put<T>(place: *mut T, value: T) {
    if is_lent(place) {
        // SAFETY: checked, and as the caller promises.
        unsafe { place.write(value) };
    }
}
