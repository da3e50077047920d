//! A hub: a router that observes its sensors and limits their rates.

use std::collections::{BTreeMap, HashMap};
use std::net::TcpListener;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use usb_bridge::stop::Stop;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

use crate::access::{Access, RECEIVERS};
use crate::board::{Board, HubFigures, page};
use crate::key::{Kind, Name, name_of};
use crate::link::{CLOSES_SOON, Links, Router, ask_clock, close, said};
use crate::message::{Budget, Message, Stamp, Status};
use crate::panicked;

/// Options of a hub.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Name of the hub.
    pub name: String,
    /// Pattern of the names of sensors to watch; `None` if the hub only routes.
    pub watch: Option<String>,
    /// Limits on sensors' rates in bytes per second, by patterns of names: the first match applies.
    pub budgets: Vec<(String, u32)>,
    /// Limit on the rate of all sensors together, in bytes per second: shared evenly, and what some do not use goes
    /// to the others.
    pub total: Option<u32>,
    /// Access control; `None` for a hub without keys, which admits anyone.
    pub access: Option<Access>,
}

/// Interval at which sensors are sent their budgets, and clocks that are due are asked for.
const TELL: Duration = Duration::from_secs(1);

/// A run that was heard within this time is live: a sensor sends its status twice a second.
const LIVE: Duration = Duration::from_secs(2);

/// Longest sleep before the stop request is checked again.
const LOOK: Duration = Duration::from_millis(50);

/// Longest wait until the router is closed.
const CLOSES: Duration = Duration::from_secs(10);

/// A hub, which runs until it is dropped.
pub struct Hub {
    shared: Arc<Shared>,
    stop: Stop,
    threads: Vec<JoinHandle<Result<()>>>,
    watching: Vec<Subscriber<()>>,
    /// Declared last, and so dropped last, since the fields above use its session.
    router: Arc<Router>,
}

struct Shared {
    options: Options,
    board: Arc<Board>,
    sensors: Mutex<HashMap<Name, Demand>>,
    receivers: Mutex<std::collections::HashSet<String>>,
}

/// The recent rates of the runs of a name: of one sensor, unless the name was given to several.
#[derive(Debug, Default)]
struct Demand {
    runs: BTreeMap<u64, Made>,
    /// The budget that each was last sent.
    told: Option<u32>,
}

/// What a run has made.
#[derive(Debug, Clone, Copy)]
struct Made {
    bytes: u64,
    at: Instant,
    bytes_per_s: f64,
}

impl Demand {
    fn bytes_per_s(&self) -> f64 {
        self.runs.values().map(|made| made.bytes_per_s).sum()
    }

    /// Returns how many sensors share what the name is allowed: 1, unless the name was given to several.
    fn sharing(&self) -> u32 {
        let live = self.runs.values().filter(|made| made.at.elapsed() < LIVE);
        (live.count() as u32).max(1)
    }

    /// Forgets runs that have ended; returns whether any is left.
    fn tidy(&mut self, kept: Duration) -> bool {
        self.runs.retain(|_, made| made.at.elapsed() < kept);
        !self.runs.is_empty()
    }
}

impl Hub {
    /// Starts a hub: listens, connects, and watches sensors. With `page`, serves its page there.
    ///
    /// # Errors
    /// Settings or keys are invalid, or an endpoint cannot be listened on.
    pub fn start(options: Options, links: &Links, page: Option<TcpListener>) -> Result<Self> {
        let router = Arc::new(Router::start(links, options.access.as_ref())?);
        let shared = Arc::new(Shared {
            board: Arc::new(Board::new(&options.name)),
            options,
            sensors: Mutex::default(),
            receivers: Mutex::default(),
        });
        let watching = watch(&shared, router.session())?;
        let stop = Stop::default();
        let mut threads = Vec::new();
        let (own, own_router, own_stop) = (Arc::clone(&shared), Arc::clone(&router), stop.clone());
        threads.push(spawn("hub", move || {
            own.allow(&own_router, &own_stop);
            Ok(())
        })?);
        if let Some(listener) = page {
            let (board, stop) = (Arc::clone(&shared.board), stop.clone());
            threads.push(spawn("page", move || page::serve(board, listener, stop))?);
        }
        Ok(Self {
            shared,
            stop,
            threads,
            watching,
            router,
        })
    }

    /// Returns the board, which holds what the hub knows.
    #[must_use]
    pub fn board(&self) -> &Arc<Board> {
        &self.shared.board
    }

    /// Returns the number of other hubs that are connected.
    #[must_use]
    pub fn routers(&self) -> usize {
        self.router.routers()
    }

    /// Returns whether one of the hub's threads has ended, such as that of a failed page.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.threads.iter().any(JoinHandle::is_finished)
    }

    /// Stops the hub: its threads, its subscriptions and its router. Nobody can connect to it afterwards.
    ///
    /// # Errors
    /// A thread of the hub, such as that of its page, failed earlier.
    pub fn finish(mut self) -> Result<()> {
        self.end(CLOSES)
    }

    /// As [`finish`](Self::finish), but does not wait for the router for longer than a moment: for a process that is
    /// about to end.
    ///
    /// # Errors
    /// Those of [`finish`](Self::finish).
    pub fn finish_soon(mut self) -> Result<()> {
        self.end(CLOSES_SOON)
    }

    fn end(&mut self, closes: Duration) -> Result<()> {
        if self.stop.is_asked() {
            return Ok(());
        }
        self.stop.ask();
        let mut result = Ok(());
        for thread in self.threads.drain(..) {
            result = result.and(thread.join().unwrap_or_else(panicked));
        }
        self.watching.clear();
        close(self.router.session(), closes);
        result
    }
}

impl Drop for Hub {
    fn drop(&mut self) {
        // Callers that want the error call [`Hub::finish`].
        let _ = self.end(CLOSES);
    }
}

fn spawn(
    name: &str,
    run: impl FnOnce() -> Result<()> + Send + 'static,
) -> Result<JoinHandle<Result<()>>> {
    let builder = thread::Builder::new().name(name.to_owned());
    builder.spawn(run).context("starting a thread of the hub")
}

/// Subscribes to what the sensors publish, and passes it to the board.
fn watch(shared: &Arc<Shared>, session: &Session) -> Result<Vec<Subscriber<()>>> {
    let Some(names) = &shared.options.watch else {
        return Ok(Vec::new());
    };
    let mut watching = Vec::new();
    let key = Kind::Frames.of_all(names);
    let board = Arc::clone(&shared.board);
    let declared = session
        .declare_subscriber(key.clone())
        .callback(move |sample| {
            let Some(name) = name_of(sample.key_expr().as_str(), Kind::Frames) else {
                return board.malformed(None);
            };
            let stamp = sample.attachment().map(zenoh::bytes::ZBytes::to_bytes);
            match stamp.and_then(|stamp| Stamp::from_bytes(&stamp)) {
                Some(stamp) => board.frame(&name, stamp, &sample.payload().to_bytes()),
                None => board.malformed(Some(&name)),
            }
        })
        .wait();
    watching.push(declared.map_err(said(key))?);
    let key = Kind::Status.of_all(names);
    let own = Arc::clone(shared);
    let declared = session
        .declare_subscriber(key.clone())
        .callback(move |sample| {
            let Some(name) = name_of(sample.key_expr().as_str(), Kind::Status) else {
                return own.board.malformed(None);
            };
            match Status::from_bytes(&sample.payload().to_bytes()) {
                Some(status) => own.status(&name, status),
                None => own.board.malformed(Some(&name)),
            }
        })
        .wait();
    watching.push(declared.map_err(said(key))?);
    let key = Kind::Alive.of_all(names);
    let board = Arc::clone(&shared.board);
    let declared = session
        .liveliness()
        .declare_subscriber(key.clone())
        .history(true)
        .callback(move |sample| {
            if let Some(name) = name_of(sample.key_expr().as_str(), Kind::Alive) {
                board.alive(&name, sample.kind() == SampleKind::Put);
            }
        })
        .wait();
    watching.push(declared.map_err(said(key))?);
    let key = format!("{RECEIVERS}/**");
    let own = Arc::clone(shared);
    let declared = session
        .liveliness()
        .declare_subscriber(key.clone())
        .history(true)
        .callback(move |sample| {
            let mut receivers = own.receivers.lock().unwrap_or_else(PoisonError::into_inner);
            let token = sample.key_expr().as_str().to_owned();
            if sample.kind() != SampleKind::Put {
                receivers.remove(&token);
            } else if receivers.len() < RECEIVERS_MAX {
                receivers.insert(token);
            }
        })
        .wait();
    watching.push(declared.map_err(said(key))?);
    Ok(watching)
}

/// Maximum number of receivers that are counted.
const RECEIVERS_MAX: usize = 10_000;

/// Maximum number of sensors that are sent budgets.
const SENSORS_MAX: usize = 10_000;

/// Maximum number of runs of a name whose rates are known at once.
const RUNS_MAX: usize = 16;

impl Shared {
    fn status(&self, name: &Name, status: Status) {
        let now = Instant::now();
        let mut sensors = self.sensors.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = sensors.contains_key(name);
        if is_known || sensors.len() < SENSORS_MAX {
            let demand = sensors.entry(name.clone()).or_default();
            if demand.runs.len() < RUNS_MAX || demand.runs.contains_key(&status.run) {
                let made = demand.runs.entry(status.run).or_insert(Made {
                    bytes: status.bytes,
                    at: now,
                    bytes_per_s: 0.0,
                });
                let since_s = now.saturating_duration_since(made.at).as_secs_f64();
                if since_s >= 0.25 {
                    let bytes = status.bytes.saturating_sub(made.bytes);
                    *made = Made {
                        bytes: status.bytes,
                        at: now,
                        bytes_per_s: bytes as f64 / since_s,
                    };
                }
            }
        }
        drop(sensors);
        self.board.status(name, status);
    }

    /// Sends sensors their budgets, asks for clocks, and updates the board's counts of connections, at an interval of
    /// [`TELL`].
    fn allow(&self, router: &Router, stop: &Stop) {
        let mut told: Option<Instant> = None;
        while !stop.is_asked() {
            if told.is_some_and(|told| told.elapsed() < TELL) {
                thread::sleep(LOOK);
                continue;
            }
            told = Some(Instant::now());
            let receivers = self
                .receivers
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .len();
            self.board.hub(HubFigures {
                routers: router.routers(),
                receivers,
            });
            self.ask_clocks(router.session());
            if self.options.budgets.is_empty() && self.options.total.is_none() {
                continue;
            }
            let mut sensors = self.sensors.lock().unwrap_or_else(PoisonError::into_inner);
            sensors.retain(|_, demand| demand.tidy(10 * TELL));
            let own: Vec<Option<u32>> = sensors.keys().map(|name| self.own(name)).collect();
            let demands: Vec<Wanted> = sensors
                .values()
                .zip(own)
                .map(|(demand, own)| Wanted::of(demand, own))
                .collect();
            let shares = match self.options.total {
                Some(total) => shares(total, &demands),
                None => demands.iter().map(|wanted| wanted.most).collect(),
            };
            let mut budgets = Vec::new();
            for ((name, demand), share) in sensors.iter_mut().zip(shares) {
                // Sensors of one name hear the same budget.
                let share = share.map(|share| (share / demand.sharing()).max(1));
                demand.told = share;
                budgets.push((name.key(Kind::Budget), share));
            }
            drop(sensors);
            for (key, bytes_per_second) in budgets {
                let budget = Budget { bytes_per_second };
                // A message that gets lost is followed by another.
                let _ = router.session().put(key, budget.to_bytes()).wait();
            }
        }
    }

    /// Asks sensors for their clocks, so that latencies can be measured.
    fn ask_clocks(&self, session: &Session) {
        for name in self.board.clocks_due() {
            let (board, own) = (Arc::clone(&self.board), name.clone());
            // A question that cannot be sent now is sent later.
            let _ = ask_clock(session, &name, board.clock(), move |trip| {
                board.trip(&own, trip);
            });
        }
    }

    /// Returns the limit set for a sensor's name.
    fn own(&self, name: &Name) -> Option<u32> {
        let name = KeyExpr::new(name.as_str()).ok()?;
        let of_names = |(names, _): &&(String, u32)| {
            KeyExpr::new(names.as_str()).is_ok_and(|names| names.includes(&name))
        };
        self.options
            .budgets
            .iter()
            .find(of_names)
            .map(|(_, budget)| *budget)
    }
}

/// The rate that a sensor could use, and its limit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wanted {
    bytes_per_s: f64,
    most: Option<u32>,
}

impl Wanted {
    /// A sensor near its budget is assumed to want any amount more, since it is held back.
    fn of(demand: &Demand, most: Option<u32>) -> Self {
        let bytes_per_s = demand.bytes_per_s();
        let is_held = demand
            .told
            .is_some_and(|told| bytes_per_s > f64::from(told) * f64::from(demand.sharing()) * 0.75);
        let more = if is_held {
            f64::INFINITY
        } else {
            bytes_per_s * 1.5 + 16_384.0
        };
        Self {
            bytes_per_s: more.min(most.map_or(f64::INFINITY, f64::from)),
            most,
        }
    }
}

/// Shares out a total: no sensor gets less than another while it wants more. What no sensor wants now is shared out
/// too, for those that want more the next moment.
fn shares(total: u32, wanted: &[Wanted]) -> Vec<Option<u32>> {
    let total = f64::from(total);
    let now: Vec<f64> = wanted.iter().map(|wanted| wanted.bytes_per_s).collect();
    let first = filled(total, &now);
    let most = |wanted: &Wanted| wanted.most.map_or(f64::INFINITY, f64::from);
    let room: Vec<f64> = first
        .iter()
        .zip(wanted)
        .map(|(share, wanted)| most(wanted) - share)
        .collect();
    let second = filled(total - first.iter().sum::<f64>(), &room);
    let both = first.iter().zip(second);
    both.map(|(first, second)| Some(((first + second) as u32).max(1)))
        .collect()
}

/// Distributes a total over vessels of the given sizes, all filled to the same height, or to their size if that is
/// less.
fn filled(total: f64, sizes: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by(|&a, &b| sizes[a].total_cmp(&sizes[b]));
    let mut filled = vec![0.0; sizes.len()];
    let mut left = total.max(0.0);
    for (place, &at) in order.iter().enumerate() {
        let even = left / (sizes.len() - place) as f64;
        filled[at] = sizes[at].min(even);
        left -= filled[at];
    }
    filled
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn wanted(bytes_per_s: f64) -> Wanted {
        Wanted {
            bytes_per_s,
            most: None,
        }
    }

    #[test]
    fn a_total_is_shared_evenly_among_those_that_want_it() {
        let all = |shares: Vec<Option<u32>>| -> Vec<u32> { shares.into_iter().flatten().collect() };
        let flood = wanted(f64::INFINITY);
        assert_eq!(all(shares(1000, &[flood, flood])), [500, 500]);
        assert_eq!(
            all(shares(1000, &[flood, wanted(100.0), flood])),
            [450, 100, 450]
        );
        assert_eq!(
            all(shares(1000, &[wanted(100.0), wanted(300.0)])),
            [400, 600]
        );
        let bounded = Wanted {
            bytes_per_s: 200.0,
            most: Some(200),
        };
        assert_eq!(all(shares(1000, &[bounded, flood])), [200, 800]);
        assert!(shares(1000, &[]).is_empty());
    }

    proptest! {
        #[test]
        fn no_total_is_exceeded(
            total in 1000_u32..100_000_000,
            wants in prop::collection::vec((0.0_f64..1e8, prop::option::of(1_u32..100_000_000)), 1..200),
        ) {
            let wants: Vec<Wanted> = wants
                .into_iter()
                .map(|(bytes, most)| Wanted { bytes_per_s: bytes.min(most.map_or(f64::INFINITY, f64::from)), most })
                .collect();
            let shares = shares(total, &wants);
            let sum: u64 = shares.iter().map(|share| u64::from(share.unwrap())).sum();
            // Each share may be rounded up by a byte.
            prop_assert!(sum <= u64::from(total) + wants.len() as u64, "{} {}", sum, total);
            for (share, wanted) in shares.iter().zip(&wants) {
                prop_assert!(wanted.most.is_none_or(|most| share.unwrap() <= most));
            }
        }
    }
}
