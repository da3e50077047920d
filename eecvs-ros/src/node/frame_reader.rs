//! Messages of frames to windows, as they come: what `decode` and `log` have in common.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use eecvs::decode::FrameCounts;

use super::{Context, Now, receive};
use crate::message::Frame;
use crate::operator::{Decoded, Decoder, Operators};
use crate::sequence::Sequence;
use crate::transport::{Qos, Subscription};

/// Longest wait between two looks at whether to stop.
const WAIT: Duration = Duration::from_millis(20);

/// How often losses are told.
const TELL: Duration = Duration::from_secs(5);

/// What came of the frames.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    /// Messages.
    pub frames: u64,
    /// Those that never came, by their numbers.
    pub sequence: Sequence,
    /// Messages that were left out.
    pub refused: u64,
    /// Why the latest of them was.
    pub why_refused: Option<String>,
}

impl Account {
    fn refuse(&mut self, why: String) {
        self.refused += 1;
        self.why_refused = Some(why);
    }

    fn tell(&self, context: &Context, told: &mut (u64, u64)) {
        if self.sequence.lost > told.0 {
            context.say(&format!("{} frames have not come", self.sequence.lost));
        }
        if self.refused > told.1 {
            let why = self.why_refused.as_deref().unwrap_or_default();
            context.say(&format!("{} frames were left out: {why}", self.refused));
        }
        *told = (self.sequence.lost, self.refused);
    }
}

/// Takes frames from `frames`, decodes them by the operators that they name, and keeps account.
pub struct FrameReader<'o> {
    subscription: Box<dyn Subscription>,
    operators: &'o Operators,
    decoder: Option<(String, Box<dyn Decoder>)>,
    idle: Option<Duration>,
    latest: Instant,
    account: Account,
    tell: Now,
    /// Frames lost and left out that were told.
    told: (u64, u64),
}

impl<'o> FrameReader<'o> {
    /// Subscribes; so many seconds without frames are the end, once there was one.
    ///
    /// # Errors
    /// The transport refuses.
    pub fn new(
        context: &mut Context,
        operators: &'o Operators,
        qos: Qos,
        idle_s: Option<u32>,
    ) -> Result<Self> {
        Ok(Self {
            subscription: context.subscription::<Frame>("frames", qos)?,
            operators,
            decoder: None,
            idle: idle_s.map(|s| Duration::from_secs(s.into())),
            latest: Instant::now(),
            account: Account::default(),
            tell: Now::every(TELL),
            told: (0, 0),
        })
    }

    /// The next frame that decodes; `ready` gets the windows that end before or with it. None at the end, or when
    /// it is to stop. What was lost is told now and then.
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
            let Some(frame) = receive::<Frame>(self.subscription.as_mut(), WAIT)? else {
                continue;
            };
            self.latest = Instant::now();
            self.account.frames += 1;
            match frame {
                Err(malformed) => self.account.refuse(malformed.to_string()),
                Ok(frame) => {
                    self.account.sequence.follow(frame.seq);
                    match self.decode(&frame, ready) {
                        Err(error) => self.account.refuse(format!("{error:#}")),
                        Ok(()) => return Ok(Some(frame)),
                    }
                }
            }
        }
    }

    /// Decodes a frame by the operator that it names.
    fn decode(&mut self, frame: &Frame, ready: &mut Vec<Decoded>) -> Result<()> {
        let is_other = self
            .decoder
            .as_ref()
            .is_none_or(|(name, _)| *name != frame.operator_name);
        if is_other {
            let Some(operator) = self.operators.find(&frame.operator_name) else {
                bail!(
                    "operator {:?} is not known: {}",
                    frame.operator_name,
                    self.operators.names()
                );
            };
            self.end(ready);
            self.decoder = Some((frame.operator_name.clone(), operator.decoder()));
        }
        match &mut self.decoder {
            Some((_, decoder)) => decoder.take(frame, &mut |window| ready.push(window)),
            None => Ok(()),
        }
    }

    /// No further frame is read: `ready` gets the window whose end has not come.
    pub fn end(&mut self, ready: &mut Vec<Decoded>) {
        if let Some((_, decoder)) = &mut self.decoder {
            decoder.end(&mut |window| ready.push(window));
        }
    }

    /// What came so far.
    #[must_use]
    pub const fn account(&self) -> &Account {
        &self.account
    }

    /// What the latest operator's frames say of events that are not in them.
    #[must_use]
    pub fn counts(&self) -> FrameCounts {
        self.decoder
            .as_ref()
            .map_or_else(FrameCounts::default, |(_, decoder)| decoder.counts())
    }
}
