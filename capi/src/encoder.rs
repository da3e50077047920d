//! The encoder.

use core::ffi::c_void;
use core::num::NonZeroU32;
use core::ops::Range;

use eecvs_nostd::evt2::Evt2Decoder;
use eecvs_nostd::evt21::Order;
use eecvs_nostd::window::{Taken, vectors::VectorIntake};
use eecvs_nostd::{Event, Polarity, Push, Window, WindowEncoder, aer};

use crate::config::EecvsConfig;
use crate::memory::{self, Unit};
use crate::pointer::{is_lent, put, slice};
use crate::status::EecvsStatus;

/// An event.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EecvsEvent {
    /// Time in microseconds.
    pub t_us: u64,
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// 0 for OFF, any other value for ON.
    pub polarity: u8,
}

impl From<EecvsEvent> for Event {
    fn from(event: EecvsEvent) -> Self {
        Self {
            t_us: event.t_us,
            x: event.x,
            y: event.y,
            polarity: Polarity::from_bool(event.polarity != 0),
        }
    }
}

#[cfg(feature = "decoder")]
impl From<Event> for EecvsEvent {
    fn from(event: Event) -> Self {
        Self {
            t_us: event.t_us,
            x: event.x,
            y: event.y,
            polarity: u8::from(event.polarity == Polarity::On),
        }
    }
}

/// What an encoder has done since it was made.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EecvsCounts {
    /// Events taken, including those outside the sensor.
    pub events: u64,
    /// Events outside the sensor, which are in no frame.
    pub outside: u64,
    /// Events lost before the encoder, by `eecvs_count_dropped`.
    pub dropped: u64,
    /// Words that were neither events nor times, and events before the first time.
    pub ignored: u64,
    /// Frames made.
    pub frames: u64,
    /// Bytes of these.
    pub bytes: u64,
}

/// An encoder, in memory of the caller: free that when it is no longer used.
#[derive(Debug)]
pub struct EecvsEncoder {
    window: Window<'static>,
    encoder: WindowEncoder<'static>,
    evt2: Evt2Decoder,
    evt21: VectorIntake,
    counts: EecvsCounts,
}

/// The order of the bytes of an EVT 2.1 word.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EecvsWordOrder {
    /// The whole word is little-endian: GenX320.
    Little = 0,
    /// The upper half comes first, each half little-endian: IMX636 and Gen 4.1.
    UpperFirst = 1,
}

impl EecvsEncoder {
    fn push(&mut self, event: Event) -> Push {
        let pushed = self.window.push(event);
        self.counts.outside = self
            .counts
            .outside
            .wrapping_add((pushed == Push::Outside).into());
        self.counts.events = self
            .counts
            .events
            .wrapping_add((pushed != Push::Closed).into());
        pushed
    }

    /// Counts what was taken of words; returns the number of these.
    fn count(&mut self, taken: Taken) -> usize {
        let counts = &mut self.counts;
        counts.events = counts.events.wrapping_add(taken.events.into());
        counts.outside = counts.outside.wrapping_add(taken.outside.into());
        counts.ignored = counts.ignored.wrapping_add(taken.ignored.into());
        taken.words
    }
}

/// Writes how many of `count` were taken to `*taken`, and returns whether these are all.
///
/// # Safety
/// `taken` is null or can be written.
unsafe fn report(
    pushed: Result<usize, EecvsStatus>,
    count: usize,
    taken: *mut usize,
) -> EecvsStatus {
    // SAFETY: as the caller promises.
    unsafe { put(taken, *pushed.as_ref().unwrap_or(&0)) };
    match pushed {
        Ok(done) if done < count => EecvsStatus::Closed,
        Ok(_) => EecvsStatus::Ok,
        Err(status) => status,
    }
}

/// Returns the encoder behind a pointer.
///
/// # Safety
/// The pointer is null, or `eecvs_encoder_new` returned it, its memory has not been used for anything else since, and no
/// other call has it at the same time.
unsafe fn encoder<'a>(encoder: *mut EecvsEncoder) -> Result<&'a mut EecvsEncoder, EecvsStatus> {
    if !is_lent(encoder) {
        return Err(EecvsStatus::ErrorPointer);
    }
    // SAFETY: as the caller promises, and as was checked.
    Ok(unsafe { &mut *encoder })
}

const fn status(result: Result<(), EecvsStatus>) -> EecvsStatus {
    match result {
        Ok(()) => EecvsStatus::Ok,
        Err(status) => status,
    }
}

/// Writes the bytes of memory that an encoder of this configuration takes to `*bytes`.
///
/// # Safety
/// `config` and `bytes` are null or point to such values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_encoder_size(
    config: *const EecvsConfig,
    bytes: *mut usize,
) -> EecvsStatus {
    let size = || {
        // SAFETY: as the caller promises.
        let [config] = (unsafe { slice(config, 1) })? else {
            return Err(EecvsStatus::ErrorPointer);
        };
        let parsed = config.parse()?;
        memory::bytes::<EecvsEncoder>(&parsed, config.window_events, config.hot_pixels)
    };
    match size() {
        Ok(size) if is_lent(bytes) => {
            // SAFETY: it is not null and aligned, and the caller lends what it points to.
            unsafe { bytes.write(size) };
            EecvsStatus::Ok
        }
        Ok(_) => EecvsStatus::ErrorPointer,
        Err(status) => status,
    }
}

/// Makes an encoder in `memory`, of `bytes` bytes and aligned to `EECVS_ALIGN`, and writes it to `*made`; null if it
/// fails. The memory stays lent until the encoder is no longer used.
///
/// # Safety
/// `config` and `made` are null or point to such values; `memory` is null, or `bytes` bytes can be read and written there
/// that nothing else uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_encoder_new(
    config: *const EecvsConfig,
    memory: *mut c_void,
    bytes: usize,
    made: *mut *mut EecvsEncoder,
) -> EecvsStatus {
    // SAFETY: as the caller promises.
    unsafe { put(made, core::ptr::null_mut()) };
    let make = || {
        // SAFETY: as the caller promises.
        let [config] = (unsafe { slice(config, 1) })? else {
            return Err(EecvsStatus::ErrorPointer);
        };
        let first: *mut Unit = memory.cast();
        if !is_lent(first) || !is_lent(made) {
            return Err(EecvsStatus::ErrorPointer);
        }
        let parsed = config.parse()?;
        let needed =
            memory::bytes::<EecvsEncoder>(&parsed, config.window_events, config.hot_pixels)?;
        if bytes < needed {
            return Err(EecvsStatus::ErrorMemory);
        }
        // SAFETY: the memory is aligned, has these bytes, which need no value, and belongs to the encoder from here on, as
        // the caller promises.
        let memory = unsafe { core::slice::from_raw_parts_mut(first, needed / size_of::<Unit>()) };
        let (state, buffers, scratch) = memory::divide::<EecvsEncoder>(
            memory,
            &parsed,
            config.window_events,
            config.hot_pixels,
        )?;
        let window = Window::new(parsed.windows(), buffers).ok_or(EecvsStatus::ErrorWindow)?;
        let encoder = WindowEncoder::new(parsed, scratch)?;
        let place: *mut EecvsEncoder = state.as_mut_ptr().cast();
        const { assert!(align_of::<EecvsEncoder>() <= align_of::<Unit>()) };
        // SAFETY: the state's place has the size and the alignment of an encoder, and nothing else refers to it.
        unsafe {
            place.write(EecvsEncoder {
                window,
                encoder,
                evt2: Evt2Decoder::new(0),
                evt21: VectorIntake::new(0),
                counts: EecvsCounts::default(),
            });
            made.write(place);
        }
        Ok(())
    };
    status(make())
}

/// Takes events from the front of `count` ones, and writes how many to `*taken`.
///
/// `EECVS_STATUS_OK` if it took all. `EECVS_STATUS_CLOSED` if the window is closed, as the next event is not of it: take
/// its frames by `eecvs_next_frame`, then push the rest. Events outside the sensor are taken and counted.
///
/// # Safety
/// `it` is an encoder that no other call has; `events` points to `count` events; `taken` is null or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_push(
    it: *mut EecvsEncoder,
    events: *const EecvsEvent,
    count: usize,
    taken: *mut usize,
) -> EecvsStatus {
    let push = || {
        // SAFETY: as the caller promises.
        let (it, events) = unsafe { (encoder(it)?, slice(events, count)?) };
        let taken = events
            .iter()
            .take_while(|event| it.push((**event).into()) != Push::Closed);
        Ok(taken.count())
    };
    // SAFETY: as the caller promises.
    unsafe { report(push(), count, taken) }
}

/// Takes little-endian words of EVT 2.0 from the front of `count` ones, as a sensor sends them, and writes how many to
/// `*taken`. Otherwise as `eecvs_push`, at less than half the cost; `words` need not be aligned.
///
/// # Safety
/// `it` is an encoder that no other call has; `words` points to 4 `count` bytes; `taken` is null or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_push_evt2(
    it: *mut EecvsEncoder,
    words: *const c_void,
    count: usize,
    taken: *mut usize,
) -> EecvsStatus {
    let push = || {
        // SAFETY: as the caller promises.
        let (it, words) = unsafe { (encoder(it)?, slice(words.cast::<[u8; 4]>(), count)?) };
        let taken = it.window.push_words(&mut it.evt2, words);
        Ok(it.count(taken))
    };
    // SAFETY: as the caller promises.
    unsafe { report(push(), count, taken) }
}

/// Takes words of EVT 2.1 from the front of `count` ones, whose bytes have an order of `eecvs_word_order`, and writes how
/// many to `*taken`; `EECVS_STATUS_ERROR_FLAG` if there is no such order. Otherwise as `eecvs_push_evt2`, with a time of
/// its own: an encoder takes words of one format. A word whose events are of two windows is taken with the second: push
/// it again, as the first of the rest; in place of another word it would be taken whole.
///
/// # Safety
/// `it` is an encoder that no other call has; `words` points to 8 `count` bytes; `taken` is null or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_push_evt21(
    it: *mut EecvsEncoder,
    words: *const c_void,
    count: usize,
    order: u8,
    taken: *mut usize,
) -> EecvsStatus {
    let push = || {
        let order = match order {
            0 => Order::Little,
            1 => Order::UpperFirst,
            _ => return Err(EecvsStatus::ErrorFlag),
        };
        // SAFETY: as the caller promises.
        let (it, words) = unsafe { (encoder(it)?, slice(words.cast::<[u8; 8]>(), count)?) };
        let taken = it.window.push_vectors(&mut it.evt21, order, words);
        Ok(it.count(taken))
    };
    // SAFETY: as the caller promises.
    unsafe { report(push(), count, taken) }
}

/// Takes words of AER from the front of `count` ones, as a GenX320 sends them over its parallel port, one to a `uint32_t`,
/// and writes how many to `*taken`. They have no time of their own: all have arrived at `now_us`. Otherwise as
/// `eecvs_push`; a word with a bit above the 19 of the format is ignored and counted.
///
/// # Safety
/// `it` is an encoder that no other call has; `words` points to `count` words; `taken` is null or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_push_aer(
    it: *mut EecvsEncoder,
    words: *const u32,
    count: usize,
    now_us: u64,
    taken: *mut usize,
) -> EecvsStatus {
    let push = || {
        // SAFETY: as the caller promises.
        let (it, words) = unsafe { (encoder(it)?, slice(words, count)?) };
        let taken = words
            .iter()
            .take_while(|word| match aer::event(**word, now_us) {
                Some(event) => it.push(event) != Push::Closed,
                None => {
                    it.counts.ignored = it.counts.ignored.wrapping_add(1);
                    true
                }
            });
        Ok(taken.count())
    };
    // SAFETY: as the caller promises.
    unsafe { report(push(), count, taken) }
}

/// Closes the open window, so that its frames can be taken: at the end of a recording.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_flush(it: *mut EecvsEncoder) -> EecvsStatus {
    // SAFETY: as the caller promises.
    status(unsafe { encoder(it) }.map(|it| it.window.flush()))
}

/// Closes the open window if its time has passed by the sensor's clock, although no event has come since.
/// `EECVS_STATUS_CLOSED` if there is a closed window, now or before: take its frames.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_pass(it: *mut EecvsEncoder, now_us: u64) -> EecvsStatus {
    // SAFETY: as the caller promises.
    let passed = unsafe { encoder(it) }.map(|it| {
        it.window.pass(now_us);
        match it.window.closed() {
            Some(_) => EecvsStatus::Closed,
            None => EecvsStatus::Ok,
        }
    });
    passed.unwrap_or_else(|error| error)
}

/// Makes the next frame of the closed window in `out`, and writes its number of bytes to `*bytes`.
///
/// `EECVS_STATUS_NONE` if there is none left, with 0 bytes: push further events. A frame has any size up to `room`, which
/// has to be at least `EECVS_FRAME_BYTES_MIN`; a window that takes more is several frames.
///
/// # Safety
/// `it` is an encoder that no other call has; `out` points to `room` bytes that can be written; `bytes` can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_next_frame(
    it: *mut EecvsEncoder,
    out: *mut u8,
    room: usize,
    bytes: *mut usize,
) -> EecvsStatus {
    if !is_lent(out) || !is_lent(bytes) {
        return EecvsStatus::ErrorPointer;
    }
    let room = room.min(isize::MAX as usize);
    let mut made = 0;
    let mut next = || {
        // SAFETY: as the caller promises; no more bytes than a slice may have.
        let (it, out) = unsafe { (encoder(it)?, core::slice::from_raw_parts_mut(out, room)) };
        if room < crate::EECVS_FRAME_BYTES_MIN {
            return Err(EecvsStatus::ErrorRoom);
        }
        let frame = it.encoder.next_frame(&mut it.window, out);
        let Some(frame) = frame.map_err(|_| EecvsStatus::ErrorRoom)? else {
            return Ok(EecvsStatus::None);
        };
        let Range { start, end } = frame.range;
        if start > end || end > out.len() {
            return Err(EecvsStatus::ErrorInternal);
        }
        made = end - start;
        it.counts.frames = it.counts.frames.wrapping_add(1);
        it.counts.bytes = it.counts.bytes.wrapping_add(made as u64);
        // Frames begin at the output's front: what a caller sends.
        let out = out.as_mut_ptr();
        // SAFETY: both ranges lie in the output, as was checked.
        unsafe { core::ptr::copy(out.add(start), out, made) };
        Ok(EecvsStatus::Ok)
    };
    let status = next().unwrap_or_else(|error| error);
    // SAFETY: as the caller promises.
    unsafe { put(bytes, made) };
    status
}

/// Keeps a pixel out of the open window and all later ones, as one that fires all the time; `eecvs_config.hot_pixels` is
/// the room. Frames count its events with those that a filter removed.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_add_hot(it: *mut EecvsEncoder, x: u16, y: u16) -> EecvsStatus {
    // SAFETY: as the caller promises.
    let it = unsafe { encoder(it) };
    status(it.and_then(|it| it.encoder.add_hot((x, y)).map(drop).map_err(Into::into)))
}

/// Counts events that were lost before they could be pushed: the next frame says so, of at most 2^32 - 1.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_count_dropped(it: *mut EecvsEncoder, events: u32) -> EecvsStatus {
    // SAFETY: as the caller promises.
    status(unsafe { encoder(it) }.map(|it| {
        it.window.count_dropped(events);
        it.counts.dropped = it.counts.dropped.wrapping_add(events.into());
    }))
}

/// Changes `eecvs_config.bytes_per_second` from the next window on; 0 for no budget. One that the headers alone would
/// exceed is raised to what these take. See there for what a budget does to times.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_set_budget(
    it: *mut EecvsEncoder,
    bytes_per_second: u32,
) -> EecvsStatus {
    // SAFETY: as the caller promises.
    let it = unsafe { encoder(it) };
    let budget = NonZeroU32::new(bytes_per_second);
    status(it.and_then(|it| it.encoder.set_budget(budget).map_err(Into::into)))
}

/// Changes `eecvs_config.tolerance_us` from the next window on.
///
/// # Safety
/// `it` is an encoder that no other call has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_set_tolerance(
    it: *mut EecvsEncoder,
    tolerance_us: u32,
) -> EecvsStatus {
    // SAFETY: as the caller promises.
    let it = unsafe { encoder(it) };
    status(it.and_then(|it| it.encoder.set_tolerance(tolerance_us).map_err(Into::into)))
}

/// Writes what the encoder has done to `*counts`.
///
/// # Safety
/// `it` is an encoder that no other call has; `counts` can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_get_counts(
    it: *mut EecvsEncoder,
    counts: *mut EecvsCounts,
) -> EecvsStatus {
    if !is_lent(counts) {
        return EecvsStatus::ErrorPointer;
    }
    // SAFETY: as the caller promises.
    status(unsafe { encoder(it).map(|it| put(counts, it.counts)) })
}
