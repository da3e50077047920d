//! The command `eecvs-ros` with a custom operator beside the project's own.
//!
//! `cargo run -p eecvs-ros --example operator -- encode --operator steps` encodes with it; `decode` of the same
//! program selects it by the name in the frames.

use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Polarity};
use eecvs_ros::operator::{Span, WindowCoder, Windowed};

/// Lossless coder that keeps the order of arrival: per event, the time step as a variable-length integer in groups
/// of seven bits, then row, column and polarity.
struct Steps;

impl WindowCoder for Steps {
    fn name(&self) -> &'static str {
        "steps"
    }

    fn encode(&self, span: Span, events: &[Event], data: &mut Vec<u8>) {
        let mut last_us = span.t0_us;
        for event in events {
            // The step may be negative: zigzag coding puts its sign into the lowest bit.
            let step = event.t_us.wrapping_sub(last_us) as i64;
            let mut left = ((step << 1) ^ (step >> 63)) as u64;
            while left >= 0x80 {
                data.push(left as u8 | 0x80);
                left >>= 7;
            }
            data.push(left as u8);
            last_us = event.t_us;
            let on = u16::from(event.polarity == Polarity::On);
            data.extend_from_slice(&event.y.to_le_bytes());
            data.extend_from_slice(&(event.x << 1 | on).to_le_bytes());
        }
    }

    fn decode(&self, span: Span, data: &[u8]) -> Result<Vec<Event>> {
        let mut events = Vec::new();
        let mut last_us = span.t0_us;
        let mut rest = data;
        while !rest.is_empty() {
            let (mut zigzag, mut shift) = (0_u64, 0);
            loop {
                let (byte, behind) = rest.split_first().context("a step is cut off")?;
                rest = behind;
                ensure!(shift < 64, "a step of more than 64 bits");
                zigzag |= u64::from(byte & 0x7f) << shift;
                shift += 7;
                if byte & 0x80 == 0 {
                    break;
                }
            }
            let step = (zigzag >> 1) ^ (zigzag & 1).wrapping_neg();
            last_us = last_us.wrapping_add(step);
            let ([y0, y1, x0, x1], behind) =
                rest.split_first_chunk().context("an event is cut off")?;
            rest = behind;
            let (y, x) = (
                u16::from_le_bytes([*y0, *y1]),
                u16::from_le_bytes([*x0, *x1]),
            );
            events.push(Event {
                t_us: last_us,
                x: x >> 1,
                y,
                polarity: Polarity::from_bool(x & 1 == 1),
            });
        }
        Ok(events)
    }
}

fn main() -> ExitCode {
    eecvs_ros::run(vec![Box::new(Windowed::new(Steps))])
}
