//! The decoder, for a host.

use std::boxed::Box;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::vec::Vec;

use eecvs::ErrorKind;
use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::pushed::{PushError, Pushed};
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs_nostd::Event;

use crate::encoder::EecvsEvent;
use crate::pointer::{is_lent, slice};
use crate::status::EecvsStatus;

/// A decoder of frames.
pub struct EecvsDecoder {
    pushed: Pushed,
    windows: WindowReader<Pushed>,
    finder: EventDecoder,
    events: Vec<Event>,
    taken: usize,
    /// The frames cannot be read on.
    has_failed: bool,
}

/// What a decoder has seen.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EecvsLosses {
    /// Frames decoded.
    pub frames: u64,
    /// Bytes that belong to no frame.
    pub damaged_bytes: u64,
    /// Frames that never came, by their numbers.
    pub frames_lost: u64,
    /// Frames that came and cannot be decoded: malformed, too large, or dependent on a lost one.
    pub frames_refused: u64,
    /// Events that the encoder counted as lost: outside the sensor, dropped before it, or late.
    pub events_dropped: u64,
    /// Events that its filter removed, and those of hot pixels.
    pub events_filtered: u64,
    /// Events that its budget left out.
    pub events_thinned: u64,
    /// Events decoded at times that are not exact: within a tolerance, the encoder's or its budget's, or of coefficients.
    pub events_approximate: u64,
}

/// Runs a call, and turns a fault of the library into a status: no panic leaves it.
fn guarded(call: impl FnOnce() -> Result<EecvsStatus, EecvsStatus>) -> EecvsStatus {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => result.unwrap_or_else(|error| error),
        Err(_) => EecvsStatus::ErrorInternal,
    }
}

/// Returns the decoder behind a pointer.
///
/// # Safety
/// The pointer is null, or `eecvs_decoder_new` returned it, it was not freed, and no other call has it at the same time.
unsafe fn decoder<'a>(it: *mut EecvsDecoder) -> Result<&'a mut EecvsDecoder, EecvsStatus> {
    if !is_lent(it) {
        return Err(EecvsStatus::ErrorPointer);
    }
    // SAFETY: as the caller promises, and as was checked.
    Ok(unsafe { &mut *it })
}

impl EecvsDecoder {
    fn new() -> Self {
        let pushed = Pushed::default();
        Self {
            windows: WindowReader::new(FrameReader::new(pushed.clone()).patient()),
            pushed,
            finder: EventDecoder::new(Finder::Exact),
            events: Vec::new(),
            taken: 0,
            has_failed: false,
        }
    }

    /// Decodes the next window, if none is left and its frames are there.
    fn fill(&mut self) -> Result<(), EecvsStatus> {
        while self.taken == self.events.len() {
            self.taken = 0;
            self.events.clear();
            match self.windows.next_window() {
                Ok(Some(mut window)) => {
                    self.finder.fill(&mut window);
                    core::mem::swap(&mut self.events, &mut window.events);
                    self.windows.reuse(window);
                }
                Ok(None) => break,
                Err(error) if error.kind() == ErrorKind::Io(io::ErrorKind::WouldBlock) => break,
                Err(_) => {
                    self.has_failed = true;
                    return Err(EecvsStatus::ErrorFrames);
                }
            }
        }
        Ok(())
    }
}

/// Makes a decoder; null if there is no memory. `eecvs_decoder_free` frees it.
#[unsafe(no_mangle)]
pub extern "C" fn eecvs_decoder_new() -> *mut EecvsDecoder {
    let made = catch_unwind(|| Box::into_raw(Box::new(EecvsDecoder::new())));
    made.unwrap_or(core::ptr::null_mut())
}

/// Frees a decoder, or does nothing with null.
///
/// # Safety
/// `it` is null or a decoder that is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_free(it: *mut EecvsDecoder) {
    if is_lent(it) {
        let free = || {
            // SAFETY: `eecvs_decoder_new` made it as a box, and the caller gives it back.
            drop(unsafe { Box::from_raw(it) });
        };
        let _ = catch_unwind(AssertUnwindSafe(free));
    }
}

/// Takes bytes of frames, cut anywhere, from a file or a link. Take the events by `eecvs_decoder_next` before the next
/// call, or the bytes pile up. `EECVS_STATUS_ERROR_FRAMES` after `eecvs_decoder_next` has returned it: nothing follows.
///
/// # Safety
/// `it` is a decoder that no other call has; `bytes` points to `count` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_push(
    it: *mut EecvsDecoder,
    bytes: *const u8,
    count: usize,
) -> EecvsStatus {
    guarded(|| {
        // SAFETY: as the caller promises.
        let it = unsafe { decoder(it) }?;
        // SAFETY: as the caller promises.
        let bytes = unsafe { slice(bytes, count) }?;
        if it.has_failed {
            return Err(EecvsStatus::ErrorFrames);
        }
        it.pushed.push(bytes).map_err(|error| match error {
            PushError::Finished => EecvsStatus::ErrorFinished,
            PushError::NoMemory => EecvsStatus::ErrorMemory,
        })?;
        Ok(EecvsStatus::Ok)
    })
}

/// Says that no bytes follow, so that the last window can be taken.
///
/// # Safety
/// `it` is a decoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_finish(it: *mut EecvsDecoder) -> EecvsStatus {
    guarded(|| {
        // SAFETY: as the caller promises.
        unsafe { decoder(it) }?.pushed.finish();
        Ok(EecvsStatus::Ok)
    })
}

/// Writes at most `room` decoded events, at least 1, to `events`, and how many to `*count`: window by window, each in the
/// order of its times.
///
/// `EECVS_STATUS_NONE` if there are none until further bytes are pushed, or at the end after `eecvs_decoder_finish`.
/// Damaged and missing frames are left out and counted: `eecvs_decoder_losses`.
///
/// # Safety
/// `it` is a decoder that no other call has; `events` points to `room` events that can be written; `count` can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_next(
    it: *mut EecvsDecoder,
    events: *mut EecvsEvent,
    room: usize,
    count: *mut usize,
) -> EecvsStatus {
    if !is_lent(count) {
        return EecvsStatus::ErrorPointer;
    }
    // SAFETY: it is not null and aligned, and as the caller promises.
    unsafe { count.write(0) };
    guarded(|| {
        // SAFETY: as the caller promises.
        let it = unsafe { decoder(it) }?;
        if !is_lent(events) {
            return Err(EecvsStatus::ErrorPointer);
        }
        if room == 0 {
            return Err(EecvsStatus::ErrorRoom);
        }
        it.fill()?;
        let ready = it.events.get(it.taken..).unwrap_or_default();
        let ready = ready.get(..room).unwrap_or(ready);
        for (at, event) in ready.iter().enumerate() {
            // SAFETY: there is room for so many, the pointer is aligned, and the caller lends it.
            unsafe { events.add(at).write((*event).into()) };
        }
        it.taken += ready.len();
        // SAFETY: as above.
        unsafe { count.write(ready.len()) };
        match ready.is_empty() {
            true => Ok(EecvsStatus::None),
            false => Ok(EecvsStatus::Ok),
        }
    })
}

/// Writes the sensor's size, which the first frame states: `EECVS_STATUS_NONE` before it.
///
/// # Safety
/// `it` is a decoder that no other call has; `width` and `height` can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_sensor(
    it: *mut EecvsDecoder,
    width: *mut u16,
    height: *mut u16,
) -> EecvsStatus {
    guarded(|| {
        // SAFETY: as the caller promises.
        let it = unsafe { decoder(it) }?;
        if !is_lent(width) || !is_lent(height) {
            return Err(EecvsStatus::ErrorPointer);
        }
        it.fill()?;
        let Some(sensor) = it.windows.sensor() else {
            return Ok(EecvsStatus::None);
        };
        // SAFETY: they are not null and aligned, and the caller lends them.
        unsafe {
            width.write(sensor.width);
            height.write(sensor.height);
        }
        Ok(EecvsStatus::Ok)
    })
}

/// Writes what the decoder has seen so far to `*losses`.
///
/// # Safety
/// `it` is a decoder that no other call has; `losses` can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_decoder_losses(
    it: *mut EecvsDecoder,
    losses: *mut EecvsLosses,
) -> EecvsStatus {
    guarded(|| {
        // SAFETY: as the caller promises.
        let it = unsafe { decoder(it) }?;
        if !is_lent(losses) {
            return Err(EecvsStatus::ErrorPointer);
        }
        let (report, counts) = (it.windows.report(), it.windows.counts());
        let seen = EecvsLosses {
            frames: report.frames,
            damaged_bytes: report.damaged_bytes,
            frames_lost: report.frames_lost,
            frames_refused: report.frames_malformed
                + report.frames_dependent
                + report.frames_crowded
                + report.frames_without_memory,
            events_dropped: counts.events_dropped + counts.events_late,
            events_filtered: counts.events_filtered,
            events_thinned: counts.events_thinned,
            events_approximate: counts.events_approximate,
        };
        // SAFETY: it is not null and aligned, and the caller lends it.
        unsafe { losses.write(seen) };
        Ok(EecvsStatus::Ok)
    })
}
