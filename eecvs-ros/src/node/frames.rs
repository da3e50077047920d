//! Publishes frames as messages, whichever operator encoded them.

use anyhow::Result;

use super::{Context, Sender};
use crate::message::{Frame, Header, Time};
use crate::operator::{Encoded, Span};
use crate::transport::Qos;

/// Publishes frames on `frames`, with sequence numbers.
pub struct FrameSender {
    sender: Sender<Frame>,
    frame: Frame,
}

impl FrameSender {
    /// Creates a sender for the frames of an operator and the sensor `frame_id`.
    ///
    /// # Errors
    /// The transport refuses the topic.
    pub fn new(context: &mut Context, qos: Qos, operator: &str, frame_id: &str) -> Result<Self> {
        Ok(Self {
            sender: context.publisher("frames", qos)?,
            frame: Frame {
                header: Header {
                    frame_id: frame_id.to_owned(),
                    ..Header::default()
                },
                operator_name: operator.to_owned(),
                ..Frame::default()
            },
        })
    }

    /// Publishes a frame whose window ended at `stamp`.
    ///
    /// # Errors
    /// The transport does not accept the message.
    pub fn send(&mut self, encoded: Encoded<'_>, stamp: Time) -> Result<()> {
        let Span {
            sensor,
            t0_us,
            duration_us,
        } = encoded.span;
        let frame = &mut self.frame;
        frame.header.stamp = stamp;
        frame.t0_us = t0_us;
        frame.duration_us = duration_us;
        frame.height = sensor.height.into();
        frame.width = sensor.width.into();
        frame.events = encoded.events;
        frame.data.clear();
        frame.data.extend_from_slice(encoded.data);
        self.sender.send(frame)?;
        frame.seq += 1;
        Ok(())
    }

    /// Returns the number of frames sent.
    #[must_use]
    pub const fn sent(&self) -> u64 {
        self.frame.seq
    }
}
