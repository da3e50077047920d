//! Checks what an encoder sent back: compares every frame and accounts for every event.

use std::ops::ControlFlow;

use eecvs::reconstruct::coefficients::CoefficientDecoder;
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs_nostd::event_link::{Cause, Kind, Restart, Status};
use eecvs_nostd::{Frame, Header, Mode, Order, Sequence};
use event_types::bail;
use event_types::stream::Result;

use super::link::{Demultiplexer, Message};
use super::{Outcome, status_of};

/// Collects the results of a run.
pub struct Account {
    /// The last answer before the first event, from which the counts run.
    begin: Status,
    /// Damaged bytes received before that answer, which do not belong to this run.
    damaged_before: u64,
    /// The host's frames, if they are to be compared.
    expected: Option<Vec<Vec<u8>>>,
    /// Which of the host's frames have been received.
    seen: Vec<bool>,
    sequence: Sequence,
    outcome: Outcome,
    out_of_order: u64,
    malformed: u64,
    coefficients: CoefficientDecoder,
    hybrid: HybridDecoder,
    first_different: Option<String>,
}

impl Account {
    pub fn new(begin: Status, damaged_before: u64, expected: Option<Vec<Vec<u8>>>) -> Self {
        Self {
            begin,
            damaged_before,
            seen: vec![false; expected.as_ref().map_or(0, Vec::len)],
            expected,
            sequence: Sequence::new(),
            outcome: Outcome::default(),
            out_of_order: 0,
            malformed: 0,
            coefficients: CoefficientDecoder::default(),
            hybrid: HybridDecoder::default(),
            first_different: None,
        }
    }

    pub fn take(
        &mut self,
        message: Message,
        incoming: &mut Demultiplexer,
    ) -> Result<ControlFlow<()>> {
        if let Some(status) = status_of(&message)? {
            return self.answer(status, incoming.damaged_bytes());
        }
        match message {
            Message::Frame(header, bytes) => self.frame(&header, &bytes),
            Message::Packet(kind, _) => {
                bail!(Damaged, "the encoder sent a packet of kind {kind:?}")
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    fn answer(&mut self, status: Status, damaged_bytes: u64) -> Result<ControlFlow<()>> {
        const SETUP: u8 = Kind::Setup as u8;
        const FLUSH: u8 = Kind::Flush as u8;
        const HOT: u8 = Kind::Hot as u8;
        match status.answers {
            // The answer to a repeated setup or to repeated hot pixels. It precedes every event, so nothing
            // received so far belongs to this run.
            SETUP | HOT => {
                let expected = self.expected.take();
                *self = Self::new(status, damaged_bytes, expected);
                Ok(ControlFlow::Continue(()))
            }
            FLUSH => {
                self.outcome.status = since(&status, &self.begin);
                Ok(ControlFlow::Break(()))
            }
            _ => bail!(
                Damaged,
                "the encoder restarted in the middle of the recording{}",
                restart(&status).map_or_else(String::new, |text| format!(": {text}"))
            ),
        }
    }

    fn frame(&mut self, header: &Header, bytes: &[u8]) {
        let outcome = &mut self.outcome;
        outcome.frames += 1;
        outcome.bytes.extend_from_slice(bytes);
        outcome.windows += u64::from(header.part == 0 && header.window_events > 0);
        outcome.events_encoded += u64::from(header.events);
        outcome.events_late += u64::from(header.late);
        outcome.events_filtered += u64::from(header.filtered);
        outcome.events_thinned += u64::from(header.thinned);
        outcome.events_lost += u64::from(header.dropped);
        let first = outcome.frames == 1;
        let in_order = self.sequence.follow(header.sequence) == Order::InOrder;
        if !in_order || (first && header.sequence != 0) {
            self.out_of_order += 1;
        }
        let Some(expected) = &self.expected else {
            let whole = Frame::parse(bytes).is_ok_and(|frame| match frame.header.mode {
                Mode::Transform => frame.descriptors().all(|pixel| pixel.is_ok()),
                Mode::Coefficients(coder) => self.coefficients.frame(&frame, coder).is_ok(),
                Mode::Hybrid(hybrid) => self.hybrid.frame(&frame, hybrid).is_ok(),
            });
            self.malformed += u64::from(!whole);
            return;
        };
        let at = header.sequence as usize;
        let difference = match (expected.get(at), self.seen.get_mut(at)) {
            (Some(frame), Some(seen)) if !*seen => {
                *seen = true;
                difference(frame, bytes)
            }
            (Some(_), _) => Some("came twice".to_owned()),
            (None, _) => Some(format!("is one too many: the host has {}", expected.len())),
        };
        match difference {
            None => outcome.frames_identical += 1,
            Some(what) => {
                outcome.frames_different += 1;
                self.first_different
                    .get_or_insert_with(|| format!("frame {at} {what}"));
            }
        }
    }

    pub fn finish(mut self, sent: u64, damaged_bytes: u64) -> Outcome {
        let missing = self.seen.iter().filter(|seen| !**seen).count();
        if let Some(at) = self.seen.iter().position(|seen| !*seen) {
            self.first_different
                .get_or_insert_with(|| format!("frame {at} is missing"));
        }
        let outcome = &mut self.outcome;
        outcome.events = sent;
        outcome.compared = self.expected.is_some();
        outcome.frames_different += missing as u64;
        let accounted = outcome.events_encoded
            + outcome.events_late
            + outcome.events_filtered
            + outcome.events_thinned
            + outcome.events_lost;
        let problems = &mut outcome.problems;
        if let Some(first) = &self.first_different {
            let frames = outcome.frames_different;
            problems.push(format!(
                "{frames} frames differ from the host's or are missing: {first}"
            ));
        }
        if accounted != sent {
            problems.push(format!(
                "{sent} events were sent but {accounted} are accounted for"
            ));
        }
        if self.expected.is_some() && outcome.events_lost > 0 {
            problems.push(format!("{} events were lost", outcome.events_lost));
        }
        if self.malformed > 0 {
            problems.push(format!("{} frames cannot be unpacked", self.malformed));
        }
        if self.out_of_order > 0 {
            problems.push(format!(
                "the frame numbers jump {} times",
                self.out_of_order
            ));
        }
        if u64::from(outcome.status.frames) != outcome.frames & u64::from(u32::MAX) {
            problems.push(format!(
                "{} frames arrived but the encoder sent {}",
                outcome.frames, outcome.status.frames
            ));
        }
        let Status {
            damaged_bytes: damaged_there,
            ignored,
            overruns,
            ..
        } = outcome.status;
        if damaged_there > 0 || ignored > 0 || overruns > 0 {
            problems.push(format!(
                "the encoder received {damaged_there} damaged bytes and {ignored} words that are \
                 not events, and had no time to read {overruns} bytes"
            ));
        }
        let damaged_bytes = damaged_bytes - self.damaged_before;
        if damaged_bytes > 0 {
            problems.push(format!(
                "{damaged_bytes} bytes belong to no frame or packet"
            ));
        }
        self.outcome
    }
}

/// Returns why an encoder started again, for a person.
#[must_use]
pub fn restart(status: &Status) -> Option<String> {
    let Restart { cause, pc, lr } = status.restart?;
    let cause = match cause {
        Cause::StackOverflow => "the stack left its place",
        Cause::Fault => "a fault of the processor",
        Cause::Unexpected => "an interrupt that nothing expects",
        Cause::Stopped => "a panic, or a clock that does not start",
        Cause::Watchdog => "half a second without progress",
    };
    Some(match pc {
        0 => cause.to_owned(),
        _ => format!("{cause}, at {pc:#x}, called from {lr:#x}"),
    })
}

/// Describes where a frame differs from the expected one; `None` if they are equal.
fn difference(expected: &[u8], frame: &[u8]) -> Option<String> {
    if expected == frame {
        return None;
    }
    let same = expected.iter().zip(frame).take_while(|(a, b)| a == b);
    Some(format!(
        "differs at byte {} ({} bytes, the host's has {})",
        same.count(),
        frame.len(),
        expected.len()
    ))
}

/// Returns the counts and times between two statuses, modulo their width.
fn since(status: &Status, begin: &Status) -> Status {
    let mut difference = *status;
    for (count, before) in [
        (&mut difference.events, begin.events),
        (&mut difference.lost, begin.lost),
        (&mut difference.dropped, begin.dropped),
        (&mut difference.ignored, begin.ignored),
        (&mut difference.damaged_bytes, begin.damaged_bytes),
        (&mut difference.overruns, begin.overruns),
        (&mut difference.windows, begin.windows),
        (&mut difference.frames, begin.frames),
    ] {
        *count = count.wrapping_sub(before);
    }
    for (time, before) in [
        (&mut difference.receive_ns, begin.receive_ns),
        (&mut difference.encode_ns, begin.encode_ns),
        (&mut difference.send_ns, begin.send_ns),
    ] {
        *time = time.wrapping_sub(before);
    }
    difference
}
