//! Passes the frames that an encoder writes to a sensor's link.

use std::io::{self, Write};

use anyhow::Result;
use eecvs_nostd::Frame;

use crate::uplink::Uplink;

/// A writer that takes one frame of docs/wire-format.md per write and passes it to an [`Uplink`].
pub struct FrameSink<'u> {
    uplink: &'u Uplink,
    /// Converts the sensor's time to the time at which it was due, by the run's clock.
    end_us: &'u dyn Fn(u64) -> u64,
    failed: Option<anyhow::Error>,
}

impl<'u> FrameSink<'u> {
    /// Creates a sink; `end_us` converts the sensor's time to the time at which it was due, by the run's clock: in
    /// microseconds since 1970.
    pub fn new(uplink: &'u Uplink, end_us: &'u dyn Fn(u64) -> u64) -> Self {
        Self {
            uplink,
            end_us,
            failed: None,
        }
    }

    /// Returns `written`, or the link's error if there was one, since that is the cause of a failed write.
    ///
    /// # Errors
    /// The link's error, else the error in `written`.
    pub fn finish<T>(self, written: Result<T>) -> Result<T> {
        self.failed.map_or(written, Err)
    }
}

impl Write for FrameSink<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let sent = Frame::parse(bytes)
            .map_err(|error| anyhow::anyhow!("a frame from this encoder cannot be read: {error}"))
            .and_then(|frame| {
                let header = frame.header;
                let end_us = header.t0_us.saturating_add(header.duration_us.into());
                self.uplink
                    .send_parsed(&header, bytes, (self.end_us)(end_us))
            });
        match sent {
            Ok(()) => Ok(bytes.len()),
            Err(error) => {
                self.failed = Some(error);
                Err(io::Error::other("not sent"))
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
