//! Asking a sensor for frames once more.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::ConsolidationMode;
use zenoh::{Session, Wait};

use super::{Came, Shared, came};
use crate::key::{Kind, Name};
use crate::link::said;
use crate::message::{Message, Wish};

/// How long answers are listened to.
const ANSWERS: Duration = Duration::from_secs(30);

/// Asks a sensor for frames; answers come as everything else does.
pub(super) fn ask(
    shared: &Arc<Shared>,
    session: &Session,
    name: &Name,
    number: u64,
    wish: &Wish,
) -> Result<()> {
    let key = name.key(Kind::Again);
    let end = Answered {
        shared: Arc::clone(shared),
        name: name.clone(),
        number,
    };
    let asked = session
        .get(key.as_str())
        .payload(wish.to_bytes())
        .consolidation(ConsolidationMode::None)
        // Answers have what the question has: they make way for what is new.
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataLow)
        .timeout(ANSWERS)
        .callback(move |reply| {
            if let Ok(sample) = reply.result() {
                end.shared.put(came(end.name.clone(), Kind::Again, sample));
            }
        })
        .wait();
    asked.map_err(said(key))
}

/// Tells, when it is dropped with the callback of a question, that no further answer comes.
struct Answered {
    shared: Arc<Shared>,
    name: Name,
    number: u64,
}

impl Drop for Answered {
    fn drop(&mut self) {
        self.shared
            .put(Came::Answered(self.name.clone(), self.number));
    }
}
