//! Reads windows from messages of frames, as they arrive: shared by `decode` and `log`.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use eecvs::decode::FrameCounts;
use eecvs::window_limit::WindowLimit;

use super::{Context, Now};
use crate::message::{Frame, Message as _, from_cdr, sequence_of};
use crate::one_publisher::OnePublisher;
use crate::operator::{Decoded, Decoder, Operators};
use crate::sequence::Sequence;
use crate::transport::Qos;

/// Longest wait before the stop request is checked again.
const WAIT: Duration = Duration::from_millis(20);

/// Interval at which losses are reported.
const TELL: Duration = Duration::from_secs(5);

/// Counts of the frames received.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    /// Messages received, including those left out.
    pub frames: u64,
    /// Losses according to the sequence numbers.
    pub sequence: Sequence,
    /// Messages left out.
    pub refused: u64,
    /// Why the latest of them was left out.
    pub why_refused: Option<String>,
    /// Messages of other publishers, which are not among those above.
    pub others: u64,
}

impl Account {
    /// Returns the counts of what was lost, each with what it counts.
    #[must_use]
    pub const fn losses(&self) -> [(u64, &'static str); 3] {
        [
            (self.sequence.lost, "frames have not arrived"),
            (self.refused, "frames were left out"),
            (self.others, "frames of another publisher were left out"),
        ]
    }

    fn refuse(&mut self, why: String) {
        self.refused += 1;
        self.why_refused = Some(why);
    }

    fn tell(&self, context: &Context, told: &mut (u64, u64)) {
        if self.sequence.lost > told.0 {
            context.say(&format!("{} frames have not arrived", self.sequence.lost));
        }
        if self.refused > told.1 {
            let why = self.why_refused.as_deref().unwrap_or_default();
            context.say(&format!("{} frames were left out: {why}", self.refused));
        }
        *told = (self.sequence.lost, self.refused);
    }
}

/// Receives frames on `frames`, decodes each with the operator that it names, and counts them.
pub struct FrameReader<'o> {
    subscription: OnePublisher,
    operators: &'o Operators,
    limit: WindowLimit,
    decoder: Option<(String, Box<dyn Decoder>)>,
    idle: Option<Duration>,
    latest: Instant,
    account: Account,
    tell: Now,
    /// Numbers of lost and left-out frames that have been reported.
    told: (u64, u64),
}

impl<'o> FrameReader<'o> {
    /// Subscribes to `frames`; frames of windows beyond `limit` are left out. The stream ends after `idle_s` seconds without frames, once there was one.
    ///
    /// # Errors
    /// The transport refuses the topic.
    pub fn new(
        context: &mut Context,
        operators: &'o Operators,
        qos: Qos,
        limit: WindowLimit,
        idle_s: Option<u32>,
    ) -> Result<Self> {
        Ok(Self {
            subscription: context.one_publisher::<Frame>("frames", qos)?,
            operators,
            limit,
            decoder: None,
            idle: idle_s.map(|s| Duration::from_secs(s.into())),
            latest: Instant::now(),
            account: Account::default(),
            tell: Now::every(TELL),
            told: (0, 0),
        })
    }

    /// Returns the next frame that can be decoded; `ready` receives the windows that end before or with it. Returns
    /// `None` at the end, or when a stop is requested. Losses are reported on stderr from time to time.
    ///
    /// # Errors
    /// The subscription has ended.
    pub fn next_frame(
        &mut self,
        context: &Context,
        ready: &mut Vec<Decoded>,
    ) -> Result<Option<Frame>> {
        loop {
            let is_idle = self.account.frames > 0
                && self.idle.is_some_and(|idle| self.latest.elapsed() >= idle);
            if is_idle || context.stop.is_asked() {
                self.account.tell(context, &mut self.told);
                return Ok(None);
            }
            if self.tell.is_due() {
                self.account.tell(context, &mut self.told);
            }
            let taken = self.subscription.take(WAIT)?;
            self.account.others = self.subscription.left_out();
            let Some(taken) = taken else {
                continue;
            };
            self.latest = Instant::now();
            self.account.frames += 1;
            if taken.is_new_publisher {
                self.account.sequence.restart();
                // Its frames depend on none of those before.
                self.end(ready);
                self.decoder = None;
            }
            // A message that is left out is not lost.
            if let Some(number) = sequence_of(Frame::TYPE, &taken.cdr) {
                self.account.sequence.follow(number);
            }
            match from_cdr::<Frame>(&taken.cdr) {
                Err(malformed) => self.account.refuse(malformed.to_string()),
                Ok(frame) => match self.decode(&frame, ready) {
                    Err(error) => self.account.refuse(format!("{error:#}")),
                    Ok(()) => return Ok(Some(frame)),
                },
            }
        }
    }

    /// Decodes a frame with the operator that it names.
    fn decode(&mut self, frame: &Frame, ready: &mut Vec<Decoded>) -> Result<()> {
        let is_other = self
            .decoder
            .as_ref()
            .is_none_or(|(name, _)| *name != frame.operator_name);
        if is_other {
            let Some(operator) = self.operators.find(&frame.operator_name) else {
                bail!(
                    "unknown operator {:?}; known operators: {}",
                    frame.operator_name,
                    self.operators.names()
                );
            };
            self.end(ready);
            self.decoder = Some((frame.operator_name.clone(), operator.decoder(self.limit)));
        }
        match &mut self.decoder {
            Some((_, decoder)) => decoder.take(frame, &mut |window| ready.push(window)),
            None => Ok(()),
        }
    }

    /// Ends the stream: `ready` receives the window that is still open, if any.
    pub fn end(&mut self, ready: &mut Vec<Decoded>) {
        if let Some((_, decoder)) = &mut self.decoder {
            decoder.end(&mut |window| ready.push(window));
        }
    }

    /// Returns the counts of the frames received so far.
    #[must_use]
    pub const fn account(&self) -> &Account {
        &self.account
    }

    /// Returns what the frames of the latest operator report about their events: how many they hold, and how many
    /// are late, filtered, dropped or thinned.
    #[must_use]
    pub fn counts(&self) -> FrameCounts {
        self.decoder
            .as_ref()
            .map_or_else(FrameCounts::default, |(_, decoder)| decoder.counts())
    }
}
