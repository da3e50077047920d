//! Packs events into messages of type `event_camera_msgs/msg/EventPacket`.
//!
//! | encoding | bytes per event | times |
//! |---|---|---|
//! | `libcaer` | 8 | exact from 0 to 2^64 ns |
//! | `evt3` | 2 to 8 | modulo 2^24 us; a receiver that listens from the start can count how often they wrapped |
//! | `mono` | 8 | exact from 0 to 2^64 ns |
//!
//! Every message can be read on its own. A message ends when it is full, when it spans its maximum time, or when
//! time steps back.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use eecvs_nostd::{Event, Polarity, Sensor};
use usb_bridge::device::WriteStream;
use usb_bridge::device::prophesee::write_evt3::Evt3Stream;

use crate::message::{EventPacket, Header, Time};

/// Encodings of events, by their names in the package `event_camera_codecs`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Encoding {
    /// 8 bytes per event, absolute times
    Libcaer,
    /// 16-bit words as sent by Prophesee's cameras, times of 24 bits
    Evt3,
    /// 8 bytes per event, absolute times; the package's oldest encoding
    Mono,
}

impl Encoding {
    /// Returns the encoding's name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Libcaer => "libcaer",
            Self::Evt3 => "evt3",
            Self::Mono => "mono",
        }
    }
}

/// Size limits of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PacketLimits {
    /// Approximate bytes of events; the other fields add some 30 bytes.
    pub bytes: usize,
    /// Upper bound of the time from the first to the last event, in microseconds, below 2^31.
    pub span_us: u64,
}

/// Upper bound on the bytes of one event: the time after a silence, the row, and a vector or a single event.
const EVENT_BYTES_MAX: usize = 32;

/// Packs events into messages.
pub struct Packer {
    sensor: Sensor,
    encoding: Encoding,
    limits: PacketLimits,
    evt3: Evt3Stream,
    packet: EventPacket,
    /// Time of the message's first event; below, of its latest.
    first_us: u64,
    last_us: u64,
    /// Number of events in the open message.
    events: u64,
}

impl Packer {
    /// Creates a packer for a sensor whose name is `frame_id`.
    #[must_use]
    pub fn new(sensor: Sensor, encoding: Encoding, limits: PacketLimits, frame_id: &str) -> Self {
        Self {
            sensor,
            encoding,
            limits,
            evt3: Evt3Stream::new(sensor),
            packet: EventPacket {
                header: Header {
                    stamp: Time::default(),
                    frame_id: frame_id.to_owned(),
                },
                height: sensor.height.into(),
                width: sensor.width.into(),
                encoding: encoding.name().to_owned(),
                ..EventPacket::default()
            },
            first_us: 0,
            last_us: 0,
            events: 0,
        }
    }

    /// Returns the number of events in the open message.
    #[must_use]
    pub const fn waiting(&self) -> u64 {
        self.events
    }

    /// Packs events; `put` receives each completed message and the number of its events.
    ///
    /// # Errors
    /// An event is outside the sensor, the encoding cannot represent a time, or `put` returns an error.
    pub fn push(
        &mut self,
        events: &[Event],
        mut put: impl FnMut(&EventPacket, u64) -> Result<()>,
    ) -> Result<()> {
        let mut rest = events;
        while let Some(first) = rest.first() {
            if self.events > 0 && !self.takes(first) {
                self.flush(&mut put)?;
            }
            let mut last_us = if self.events > 0 {
                self.last_us
            } else {
                first.t_us
            };
            let (first_us, span_us) = match self.events {
                0 => (first.t_us, self.limits.span_us),
                _ => (self.first_us, self.limits.span_us),
            };
            // The number of events that fit even at the maximum size.
            let room = self.limits.bytes.saturating_sub(self.packet.events.len());
            let most = (room / EVENT_BYTES_MAX).max(1);
            let fitting = rest.iter().take(most).take_while(|event| {
                let fits = event.t_us >= last_us && event.t_us - first_us < span_us.max(1);
                last_us = event.t_us;
                fits
            });
            let (now, later) = rest.split_at(fitting.count().max(1));
            self.add(now)?;
            rest = later;
        }
        Ok(())
    }

    /// Returns whether an event can be added to the open message.
    fn takes(&self, event: &Event) -> bool {
        let has_room = self.packet.events.len() + EVENT_BYTES_MAX <= self.limits.bytes;
        has_room
            && event.t_us >= self.last_us
            && event.t_us - self.first_us < self.limits.span_us.max(1)
    }

    fn add(&mut self, events: &[Event]) -> Result<()> {
        let (Some(first), Some(last)) = (events.first(), events.last()) else {
            return Ok(());
        };
        if self.events == 0 {
            self.first_us = first.t_us;
            self.packet.time_base = match self.encoding {
                Encoding::Evt3 => 0,
                Encoding::Libcaer | Encoding::Mono => {
                    let base_ns = first.t_us.checked_mul(1000);
                    let Some(base_ns) = base_ns else {
                        anyhow::bail!("the time {} us is 2^64 ns or more", first.t_us);
                    };
                    base_ns
                }
            };
            self.evt3.say_all();
        }
        let bytes = &mut self.packet.events;
        if self.encoding == Encoding::Evt3 {
            self.evt3.write(events, bytes)?;
        } else {
            for event in events {
                ensure!(
                    self.sensor.contains(event.x, event.y),
                    "event at x = {}, y = {} is outside the sensor ({}x{})",
                    event.x,
                    event.y,
                    self.sensor.width,
                    self.sensor.height
                );
                // Spans are below 2^31 us, and those of mono below 2^32 ns.
                let since_us = (event.t_us - self.first_us) as u32;
                let on = u32::from(event.polarity == Polarity::On);
                let (x, y) = (u32::from(event.x), u32::from(event.y));
                let [low, high] = match self.encoding {
                    Encoding::Mono => [since_us * 1000, on << 31 | y << 16 | x],
                    _ => [x << 17 | y << 2 | on << 1 | 1, since_us],
                };
                bytes.extend_from_slice(&low.to_le_bytes());
                bytes.extend_from_slice(&high.to_le_bytes());
            }
        }
        self.last_us = last.t_us;
        self.events += events.len() as u64;
        Ok(())
    }

    /// Passes the open message, if it has events, to `put`: stamped with the computer's time, and with the number
    /// of its events.
    ///
    /// # Errors
    /// `put` returns an error.
    pub fn flush(&mut self, put: &mut impl FnMut(&EventPacket, u64) -> Result<()>) -> Result<()> {
        if self.events == 0 {
            return Ok(());
        }
        self.packet.header.stamp = Time::now();
        let result = put(&self.packet, self.events);
        self.packet.seq += 1;
        self.packet.events.clear();
        self.events = 0;
        result
    }
}

impl PacketLimits {
    /// Limits the span to what an encoding can represent: below 2^31 us, for `mono` below 2^32 ns.
    #[must_use]
    pub fn of(encoding: Encoding, bytes: usize, span_us: u64) -> Self {
        let most_us = match encoding {
            Encoding::Mono => u64::from(u32::MAX) / 1000,
            Encoding::Libcaer | Encoding::Evt3 => (1 << 31) - 1,
        };
        Self {
            bytes,
            span_us: span_us.min(most_us),
        }
    }
}
