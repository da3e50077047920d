//! Requests a sensor's frames again.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::{Session, Wait};

use super::{Came, Shared, came};
use crate::key::{Kind, Name};
use crate::link::said;
use crate::message::{Message, Wish};

/// How long answers are accepted.
const ANSWERS: Duration = Duration::from_secs(30);

/// Requests frames from a sensor; the answers go into the same inbox as everything else.
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
        // Several sensors may have the name.
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        // Answers inherit these settings: they give way to new frames.
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataLow)
        .timeout(ANSWERS)
        .callback(move |reply| {
            if let Ok(sample) = reply.result() {
                let at_us = end.shared.clock.now_us();
                end.shared
                    .put(came(end.name.clone(), Kind::Again, sample, at_us));
            }
        })
        .wait();
    asked.map_err(said(key))
}

/// Reports, when it is dropped with the callback of a request, that no further answer will come.
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
