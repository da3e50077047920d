//! The endpoint of a simulated camera that sends a [`Stream`].

use super::{Due, Stream};
use crate::peripheral::Bulk;

/// An endpoint that sends a stream while its camera runs.
pub struct StreamEndpoint {
    stream: Box<dyn Stream>,
    runs: bool,
    has_ended: bool,
    is_halted: bool,
}

impl StreamEndpoint {
    /// Creates the endpoint of a camera that does not run yet.
    #[must_use]
    pub fn new(stream: Box<dyn Stream>) -> Self {
        Self {
            stream,
            runs: false,
            has_ended: false,
            is_halted: false,
        }
    }

    /// Sets whether the camera runs; every start sends the stream from its beginning.
    pub fn set_running(&mut self, runs: bool) {
        if runs && !self.runs {
            self.stream.start();
            self.has_ended = false;
        }
        self.runs = runs;
    }

    /// Sets the clock of a running camera to 0. That of a stopped one starts at 0 anyway.
    pub fn reset_time(&mut self) {
        if self.runs && !self.has_ended {
            self.stream.reset_time();
        }
    }

    /// Sends at most `room` bytes that are due. A camera whose stream has ended stays quiet; if the recording cannot
    /// be read, the endpoint halts.
    pub fn send(&mut self, room: usize, data: &mut Vec<u8>) -> Bulk {
        if self.is_halted {
            return Bulk::Stall;
        }
        if !self.runs || self.has_ended || room == 0 {
            return Bulk::Wait;
        }
        let before = data.len();
        match self.stream.take(room, data) {
            Ok(due) => self.has_ended = due == Due::Ended,
            Err(_) => {
                self.has_ended = true;
                self.is_halted = true;
            }
        }
        match (data.len() > before, self.is_halted) {
            (true, _) => Bulk::Data,
            (false, true) => Bulk::Stall,
            (false, false) => Bulk::Wait,
        }
    }

    /// Ends a halt.
    pub fn clear_halt(&mut self) {
        self.is_halted = false;
    }
}
