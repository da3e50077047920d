//! `libeecvs`: the encoder for microcontrollers and hosts, and the decoder for hosts, in C's terms.
//!
//! `include/eecvs.h` is made of this crate and has the same documentation; `include/eecvs.hpp` owns what it hands out.
//!
//! ```text
//! events | EVT 2.0 words -> eecvs_push -> window -> eecvs_next_frame -> bytes -> eecvs_decoder_push -> events
//! ```
//!
//! The encoder lives in memory of the caller, and has neither a heap nor globals: as many as there is memory for run
//! beside each other, each on one thread at a time. Every failure is a status.
#![no_std]

#[cfg(feature = "decoder")]
extern crate std;

mod config;
#[cfg(feature = "decoder")]
mod decoder;
mod encoder;
mod memory;
mod pointer;
mod status;

pub use config::{EecvsCoder, EecvsConfig, EecvsTransform, eecvs_config_init};
#[cfg(feature = "decoder")]
pub use decoder::{
    EecvsDecoder, EecvsLosses, eecvs_decoder_finish, eecvs_decoder_free, eecvs_decoder_losses,
    eecvs_decoder_new, eecvs_decoder_next, eecvs_decoder_push, eecvs_decoder_sensor,
};
pub use encoder::{
    EecvsCounts, EecvsEncoder, EecvsEvent, EecvsWordOrder, eecvs_add_hot, eecvs_count_dropped,
    eecvs_encoder_new, eecvs_encoder_size, eecvs_flush, eecvs_get_counts, eecvs_next_frame,
    eecvs_pass, eecvs_push, eecvs_push_aer, eecvs_push_evt2, eecvs_push_evt21, eecvs_set_budget,
    eecvs_set_tolerance,
};
pub use status::{EecvsStatus, eecvs_abi_version, eecvs_status_name};

/// Version of the interface: it is raised when a function or a structure changes.
pub const EECVS_ABI_VERSION: u32 = 1;

/// Alignment of an encoder's memory in bytes.
pub const EECVS_ALIGN: usize = 8;

/// Smallest room for a frame in bytes.
pub const EECVS_FRAME_BYTES_MIN: usize = 2048;

const _: () = assert!(EECVS_FRAME_BYTES_MIN >= eecvs_nostd::OUTPUT_BYTES_MIN);

/// Most bytes of an encoder's memory that are not for a window: the header's `EECVS_STATE_BYTES`.
const STATE_BYTES: usize = if size_of::<usize>() < 8 { 1280 } else { 1792 };

const _: () = assert!(size_of::<EecvsEncoder>() <= STATE_BYTES);

/// Without the standard library there is nobody else who ends a program that panics.
#[cfg(all(not(feature = "decoder"), not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
