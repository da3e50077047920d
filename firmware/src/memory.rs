//! The memory that a setup divides: windows, a frame, and what the dense coder learns where it is the one
//! that is asked for.
//!
//! | | fast, coefficients | dense |
//! |---|---|---|
//! | a frame | 4 KiB | 8 KiB: a window that overran it would begin anew with every frame |
//! | dense coder | | its model, and a few rows |
//! | windows | 88 KiB | what is left |

use core::mem::ManuallyDrop;

use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{DenseMemory, words};
use eecvs_nostd::{Coder, Config, Hybrid, Mode};

/// Memory of all windows in words: memory.x has its budget.
const WINDOW_WORDS: usize = 22 * 1024;
/// Largest frame.
const FRAME_BYTES: usize = 4096;
/// Largest frame of the dense coder.
const DENSE_FRAME_BYTES: usize = 8192;
/// Words of the dense coder's rows, beyond which the window before is not kept: it saves some hundredths of
/// the bits of quiet scenes, and a window that is longer saves as much.
const PREVIOUS_WORDS_MAX: usize = WINDOW_WORDS / 16;
/// What is left for the dense coder's rows and the windows.
const REST_WORDS: usize =
    (WINDOW_WORDS * 4 + FRAME_BYTES - DENSE_FRAME_BYTES - size_of::<Model>()) / 4;

#[repr(C)]
struct Plain {
    windows: [u32; WINDOW_WORDS],
    out: [u8; FRAME_BYTES],
}

#[repr(C)]
struct ForDense {
    rest: [u32; REST_WORDS],
    out: [u8; DENSE_FRAME_BYTES],
    model: Model,
}

#[repr(C)]
union Memory {
    plain: ManuallyDrop<Plain>,
    dense: ManuallyDrop<ForDense>,
}

const _: () = assert!(size_of::<Memory>() == size_of::<Plain>());

static mut MEMORY: Memory = Memory {
    plain: ManuallyDrop::new(Plain {
        windows: [0; WINDOW_WORDS],
        out: [0; FRAME_BYTES],
    }),
};

/// The parts of the memory.
pub struct Shares {
    /// Of all windows.
    pub windows: &'static mut [u32],
    /// Of a frame.
    pub out: &'static mut [u8],
    /// Of the dense coder, where it is asked for.
    pub dense: Option<DenseMemory<'static>>,
}

/// Divides the memory, zeroed, for a configuration; `None` where the dense coder has no room.
///
/// # Safety
/// Nothing that was lent before may be in use any more.
pub unsafe fn divide(config: &Config) -> Option<Shares> {
    let memory = &raw mut MEMORY;
    // SAFETY: nobody else has a reference to it. Integers are all there is in it, of which zeros are a
    // value; they also make bytes of what may have been padding.
    unsafe { memory.write_bytes(0, 1) };
    let Mode::Hybrid(Hybrid {
        coder: Coder::Dense,
        ..
    }) = config.mode
    else {
        // SAFETY: all of the union was written.
        let Plain { windows, out } = unsafe { &mut *memory.cast() };
        return Some(Shares {
            windows,
            out,
            dense: None,
        });
    };
    // SAFETY: as above.
    let ForDense { rest, out, model } = unsafe { &mut *memory.cast() };
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
