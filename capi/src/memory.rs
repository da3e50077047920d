//! The caller's memory, divided into the buffers of an encoder.
//!
//! ```text
//! state | slots | heads | bitmap | sums | totals | magnitudes | hot pixels | dense model | dense rows
//! ```

use core::mem::MaybeUninit;

use eecvs_nostd::fixed_point::{Sum, WideSum};
#[cfg(feature = "dense")]
use eecvs_nostd::{
    Coder, Hybrid,
    coder::dense::{self, DenseMemory, model::Model},
};
use eecvs_nostd::{Config, Head, Mode, Scratch, Slot, WindowBuffers, bitmap_words, segments};

use crate::status::EecvsStatus;

/// What the memory is divided in: its alignment is that of every part.
pub type Unit = MaybeUninit<u64>;

/// How many values each buffer has.
struct Counts {
    slots: usize,
    segments: usize,
    numbers: usize,
    hot: usize,
    #[cfg(feature = "dense")]
    dense_words: Option<usize>,
}

impl Counts {
    fn of(config: &Config, window_events: u32, hot_pixels: u32) -> Result<Self, EecvsStatus> {
        let sensor = config.window.sensor;
        let range = |number: u32| usize::try_from(number).map_err(|_| EecvsStatus::ErrorWindow);
        let numbers = match (config.mode, config.transform) {
            (Mode::Transform, Some(transform)) => {
                2 * usize::from(transform.grid_size(config.m.clamp(1, 64), None))
            }
            _ => 0,
        };
        Ok(Self {
            slots: range(window_events)?,
            segments: segments(sensor.width, sensor.height),
            numbers,
            hot: range(hot_pixels)?,
            #[cfg(feature = "dense")]
            dense_words: match config.mode {
                Mode::Hybrid(Hybrid {
                    coder: Coder::Dense,
                    ..
                }) => Some(dense::words(sensor, true)),
                _ => None,
            },
        })
    }

    /// Returns the units of all buffers; `None` beyond the address space.
    fn units(&self) -> Option<usize> {
        let parts = [
            units::<Slot>(self.slots),
            units::<Head>(self.segments),
            units::<u32>(bitmap_words(self.segments)),
            units::<Sum>(self.numbers),
            units::<WideSum>(self.numbers),
            units::<u32>(self.numbers),
            units::<u32>(self.hot),
            #[cfg(feature = "dense")]
            self.dense_words.map_or(Some(0), |words| {
                units::<Model>(1)?.checked_add(units::<u32>(words)?)
            }),
        ];
        parts
            .into_iter()
            .try_fold(0_usize, |sum, part| sum.checked_add(part?))
    }
}

/// Returns how many units `count` values take.
fn units<T>(count: usize) -> Option<usize> {
    Some(
        count
            .checked_mul(size_of::<T>())?
            .div_ceil(size_of::<Unit>()),
    )
}

/// Returns the bytes of an encoder whose state is an `S`.
pub fn bytes<S>(
    config: &Config,
    window_events: u32,
    hot_pixels: u32,
) -> Result<usize, EecvsStatus> {
    let counts = Counts::of(config, window_events, hot_pixels)?;
    let all = counts.units().zip(units::<S>(1));
    let bytes =
        all.and_then(|(buffers, state)| buffers.checked_add(state)?.checked_mul(size_of::<Unit>()));
    bytes
        .filter(|bytes| *bytes <= isize::MAX as usize)
        .ok_or(EecvsStatus::ErrorWindow)
}

/// Takes room for `count` values from the front of `rest`, and sets each.
fn take<T>(
    rest: &mut &'static mut [Unit],
    count: usize,
    value: impl Fn() -> T,
) -> Option<&'static mut [T]> {
    const { assert!(align_of::<T>() <= align_of::<Unit>()) };
    let (part, after) = core::mem::take(rest).split_at_mut_checked(units::<T>(count)?)?;
    *rest = after;
    let first: *mut T = part.as_mut_ptr().cast();
    for at in 0..count {
        // SAFETY: the part has room for `count` values, is aligned for them, and is borrowed here alone.
        unsafe { first.add(at).write(value()) };
    }
    // SAFETY: as above, and every value was written. The part was split off for good, so that nothing else refers to it.
    Some(unsafe { core::slice::from_raw_parts_mut(first, count) })
}

/// The memory, divided: the state's place, the window's buffers, and the encoder's.
pub type Divided = (
    &'static mut [Unit],
    WindowBuffers<'static>,
    Scratch<'static>,
);

/// Divides `memory` for a configuration and a state that is an `S`.
pub fn divide<S>(
    memory: &'static mut [Unit],
    config: &Config,
    window_events: u32,
    hot_pixels: u32,
) -> Result<Divided, EecvsStatus> {
    let counts = Counts::of(config, window_events, hot_pixels)?;
    counts.divide::<S>(memory).ok_or(EecvsStatus::ErrorMemory)
}

impl Counts {
    fn divide<S>(&self, memory: &'static mut [Unit]) -> Option<Divided> {
        let (state, mut rest) = memory.split_at_mut_checked(units::<S>(1)?)?;
        let buffers = WindowBuffers {
            slots: take(&mut rest, self.slots, || Slot::EMPTY)?,
            heads: take(&mut rest, self.segments, || 0)?,
            bitmap: take(&mut rest, bitmap_words(self.segments), || 0)?,
        };
        let scratch = Scratch {
            sums: take(&mut rest, self.numbers, || Sum::ZERO)?,
            totals: take(&mut rest, self.numbers, || WideSum::ZERO)?,
            magnitudes: take(&mut rest, self.numbers, || 0)?,
            hot: take(&mut rest, self.hot, || 0)?,
            #[cfg(feature = "dense")]
            dense: match self.dense_words {
                Some(words) => Some(DenseMemory {
                    model: take(&mut rest, 1, || Model::UNSET)?.first_mut()?,
                    words: take(&mut rest, words, || 0)?,
                }),
                None => None,
            },
            #[cfg(not(feature = "dense"))]
            dense: None,
            tree: None,
            keys: None,
            coefficients: None,
            order: &mut [],
        };
        Some((state, buffers, scratch))
    }
}
