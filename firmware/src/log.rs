//! Destination of defmt's bytes: RTT on a board, semihosting in QEMU. One image serves both.

use core::cell::RefCell;

use cortex_m_semihosting::hio::{HostStream, hstdout};
use critical_section::{Mutex, RestoreState};
use rtt_target::UpChannel;

use crate::board;

enum Sink {
    /// Not determined yet.
    Unknown,
    Rtt(UpChannel),
    Semihosting(HostStream),
    /// Neither accepted the log.
    None,
}

struct Log {
    encoder: defmt::Encoder,
    sink: Sink,
    restore: Option<RestoreState>,
}

static LOG: Mutex<RefCell<Log>> = Mutex::new(RefCell::new(Log {
    encoder: defmt::Encoder::new(),
    sink: Sink::Unknown,
    restore: None,
}));

impl Sink {
    fn open() -> Self {
        if board::is_emulated() {
            return hstdout().map_or(Self::None, Self::Semihosting);
        }
        let channels = rtt_target::rtt_init! {
            up: {
                0: { size: 1024, mode: rtt_target::ChannelMode::NoBlockTrim, name: "defmt" }
            }
        };
        Self::Rtt(channels.up.0)
    }

    fn write(&mut self, bytes: &[u8]) {
        match self {
            Self::Rtt(channel) => {
                channel.write(bytes);
            }
            Self::Semihosting(stream) => {
                // A host that does not listen is no reason to stop.
                let _ = stream.write_all(bytes);
            }
            Self::Unknown | Self::None => {}
        }
    }
}

#[defmt::global_logger]
struct Logger;

// SAFETY: `acquire` enters a critical section that `release` leaves, so no two loggers overlap; the borrow of the
// log is short and never held across a call into defmt.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: paired with `release`, which defmt calls exactly once after this.
        let restore = unsafe { critical_section::acquire() };
        with(|log| {
            if matches!(log.sink, Sink::Unknown) {
                log.sink = Sink::open();
            }
            log.restore = Some(restore);
            let Log { encoder, sink, .. } = log;
            encoder.start_frame(|bytes| sink.write(bytes));
        });
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let restore = with(|log| {
            let Log { encoder, sink, .. } = log;
            encoder.end_frame(|bytes| sink.write(bytes));
            log.restore.take()
        });
        if let Some(Some(restore)) = restore {
            // SAFETY: this is the state that `acquire` got.
            unsafe { critical_section::release(restore) };
        }
    }

    unsafe fn write(bytes: &[u8]) {
        with(|log| {
            let Log { encoder, sink, .. } = log;
            encoder.write(bytes, |bytes| sink.write(bytes));
        });
    }
}

/// Runs `act` on the log; `None` if the log is in use, so that a fault in the middle of it does not end in another
/// one.
fn with<R>(act: impl FnOnce(&mut Log) -> R) -> Option<R> {
    critical_section::with(|token| {
        let mut log = LOG.borrow(token).try_borrow_mut().ok()?;
        Some(act(&mut log))
    })
}
