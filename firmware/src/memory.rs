//! The memory that a setup divides: windows, a frame, and what the dense coder learns, if that coder is used.
//!
//! | | fast, coefficients | dense | small image |
//! |---|---|---|---|
//! | a frame | 4 KiB | 8 KiB: a window that overran it would begin anew with every frame | 4 KiB |
//! | dense coder | | its model, and a few rows | |
//! | windows | two, 88 KiB | what is left | one, 22.6 KiB |

use core::mem::ManuallyDrop;

use eecvs_nostd::Config;
use eecvs_nostd::coder::dense::DenseMemory;
#[cfg(feature = "full")]
use eecvs_nostd::coder::dense::model::Model;
#[cfg(feature = "full")]
use eecvs_nostd::coder::dense::words;
#[cfg(feature = "full")]
use eecvs_nostd::{Coder, Hybrid, Mode};

/// Number of windows that take turns. Where there is one, events wait in the link's ring while it is encoded.
pub const WINDOWS: usize = if cfg!(feature = "full") { 2 } else { 1 };
/// Words for all windows; memory.x has the budget.
#[cfg(feature = "full")]
const WINDOW_WORDS: usize = 22 * 1024;
/// Words for the window: at 320 x 320 it holds 2,048 events. memory/small.x has the budget.
#[cfg(not(feature = "full"))]
const WINDOW_WORDS: usize = 2 * 2048 + 1700;
/// Size of the largest frame in bytes.
const FRAME_BYTES: usize = 4096;
/// Size of the dense coder's largest frame in bytes.
#[cfg(feature = "full")]
const DENSE_FRAME_BYTES: usize = 8192;
/// Most words for the dense coder's rows with which the window before is still kept. It saves some hundredths of
/// the bits in quiet scenes, and a longer window saves as much.
#[cfg(feature = "full")]
const PREVIOUS_WORDS_MAX: usize = WINDOW_WORDS / 16;
/// Words left for the dense coder's rows and the windows.
#[cfg(feature = "full")]
const REST_WORDS: usize =
    (WINDOW_WORDS * 4 + FRAME_BYTES - DENSE_FRAME_BYTES - size_of::<Model>()) / 4;

#[repr(C)]
struct Plain {
    windows: [u32; WINDOW_WORDS],
    out: [u8; FRAME_BYTES],
}

#[cfg(feature = "full")]
#[repr(C)]
struct ForDense {
    rest: [u32; REST_WORDS],
    out: [u8; DENSE_FRAME_BYTES],
    model: Model,
}

#[repr(C)]
union Memory {
    plain: ManuallyDrop<Plain>,
    #[cfg(feature = "full")]
    dense: ManuallyDrop<ForDense>,
}

const _: () = assert!(size_of::<Memory>() == size_of::<Plain>());

static mut MEMORY: Memory = Memory {
    plain: ManuallyDrop::new(Plain {
        windows: [0; WINDOW_WORDS],
        out: [0; FRAME_BYTES],
    }),
};

/// Parts of the memory, as divided for a setup.
pub struct Shares {
    /// For all windows.
    pub windows: &'static mut [u32],
    /// For a frame.
    pub out: &'static mut [u8],
    /// For the dense coder, if it is used.
    pub dense: Option<DenseMemory<'static>>,
}

/// Divides the memory, zeroed, for a configuration; `None` if the dense coder does not fit.
///
/// # Safety
/// Nothing that was lent before may still be in use.
pub unsafe fn divide(config: &Config) -> Option<Shares> {
    let memory = &raw mut MEMORY;
    // SAFETY: nobody else has a reference to it. It holds only integers, for which zeros are valid; writing all
    // bytes also initialises what may have been padding.
    unsafe { memory.write_bytes(0, 1) };
    #[cfg(feature = "full")]
    if let Mode::Hybrid(Hybrid {
        coder: Coder::Dense,
        ..
    }) = config.mode
    {
        // SAFETY: all bytes of the union were written.
        return divide_for_dense(config, unsafe { &mut *memory.cast() });
    }
    #[cfg(not(feature = "full"))]
    let _ = config;
    // SAFETY: as above.
    let Plain { windows, out } = unsafe { &mut *memory.cast() };
    Some(Shares {
        windows,
        out,
        dense: None,
    })
}

#[cfg(feature = "full")]
fn divide_for_dense(config: &Config, memory: &'static mut ForDense) -> Option<Shares> {
    let ForDense { rest, out, model } = memory;
    let sensor = config.window.sensor;
    let with_previous = words(sensor, true);
    let needed = match with_previous <= PREVIOUS_WORDS_MAX {
        true => with_previous,
        false => words(sensor, false),
    };
    let (words, windows) = rest.split_at_mut_checked(needed)?;
    Some(Shares {
        windows,
        out,
        dense: Some(DenseMemory { model, words }),
    })
}
