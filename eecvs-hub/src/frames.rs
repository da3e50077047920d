//! Passes the frames that an encoder writes to a sensor's link.

use std::io;

use anyhow::Result;
use eecvs::frame_file::FrameSink;
use eecvs_nostd::Header;

use crate::uplink::Uplink;

/// Takes frames and passes them to an [`Uplink`].
pub struct UplinkSink<'u> {
    uplink: &'u Uplink,
    /// Converts the sensor's time to the time at which it was due, by the run's clock.
    end_us: &'u dyn Fn(u64) -> u64,
    failed: Option<anyhow::Error>,
}

impl<'u> UplinkSink<'u> {
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

impl FrameSink for UplinkSink<'_> {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> io::Result<()> {
        let end_us = header.t0_us.saturating_add(header.duration_us.into());
        let sent = self
            .uplink
            .send_parsed(header, bytes, (self.end_us)(end_us));
        sent.map_err(|error| {
            self.failed = Some(error);
            io::Error::other("not sent")
        })
    }
}
