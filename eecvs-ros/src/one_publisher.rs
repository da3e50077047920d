//! Keeps a subscription to one publisher.
//!
//! The events of two sensors on one topic cannot be told apart, and neither can the frames of two encoders. The
//! first publisher whose message arrives is kept. Messages of others are left out and counted, and both nodes are
//! named at once. Another publisher takes its place when the first is gone and silent, or when a node of the same
//! name publishes and the first has been silent for two seconds: a driver that crashed and was restarted.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_cli::say;

use crate::transport::{Known, NAMED, PUBLISHERS_MAX, PublisherId, Subscription, UNNAMED};

/// Silence after which a publisher that is gone gives way to another.
const GONE: Duration = Duration::from_millis(200);

/// Silence after which a publisher gives way to another one of the same name.
const SILENT: Duration = Duration::from_secs(2);

/// Interval at which it is looked up whether the kept publisher has gone.
const LOOK: Duration = Duration::from_millis(50);

/// Prints one line.
pub type Say = Box<dyn Fn(&str) + Send>;

/// A message that was taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Taken {
    /// The message, as CDR bytes.
    pub cdr: Vec<u8>,
    /// Whether it is the first message of a publisher that took the place of another.
    pub is_new_publisher: bool,
}

/// A publisher.
#[derive(Debug, Clone)]
struct Sender {
    id: PublisherId,
    /// Full name of its node, once it is known.
    node: Option<String>,
}

/// A publisher whose messages are left out.
#[derive(Debug)]
struct Other {
    since: Instant,
    node: Option<String>,
    is_reported: bool,
}

/// A subscription to a topic that keeps to one of its publishers.
pub struct OnePublisher {
    subscription: Box<dyn Subscription>,
    topic: String,
    say: Say,
    kept: Option<Sender>,
    /// When the latest message of the kept publisher arrived.
    latest: Instant,
    looked: Instant,
    others: HashMap<PublisherId, Other>,
    left_out: u64,
    /// When publishers that are not heard were last looked for; `None` once they have been named.
    looked_for_unheard: Option<Instant>,
}

impl OnePublisher {
    /// Wraps a subscription to a topic; `say` prints what happens.
    #[must_use]
    pub fn new(subscription: Box<dyn Subscription>, topic: &str, say: Say) -> Self {
        let now = Instant::now();
        Self {
            subscription,
            topic: topic.to_owned(),
            say,
            kept: None,
            latest: now,
            looked: now,
            others: HashMap::new(),
            left_out: 0,
            looked_for_unheard: Some(now),
        }
    }

    /// Returns the number of messages of other publishers, which were left out.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Returns the oldest waiting message of the kept publisher, or the first that arrives within `wait`.
    ///
    /// # Errors
    /// The transport has ended.
    pub fn take(&mut self, wait: Duration) -> Result<Option<Taken>> {
        self.tell_unheard();
        let until = Instant::now() + wait;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let Some((cdr, id)) = self.subscription.take_from(left)? else {
                self.tell(Instant::now());
                return Ok(None);
            };
            let now = Instant::now();
            if let Some(is_new_publisher) = self.admits(id, now) {
                self.latest = now;
                self.tell(now);
                return Ok(Some(Taken {
                    cdr,
                    is_new_publisher,
                }));
            }
            self.left_out += 1;
            self.tell(now);
        }
    }

    /// Returns whether a message is of the publisher that is kept, and if so whether that is another than before.
    fn admits(&mut self, id: PublisherId, now: Instant) -> Option<bool> {
        let Some(kept) = &self.kept else {
            let node = self.node_of(id);
            self.kept = Some(Sender { id, node });
            return Some(false);
        };
        if kept.id == id {
            return Some(false);
        }
        if !self.others.contains_key(&id) {
            let id = match self.others.len() {
                PUBLISHERS_MAX.. => PublisherId::default(),
                _ => id,
            };
            let node = self.node_of(id);
            self.others.entry(id).or_insert(Other {
                since: now,
                node,
                is_reported: false,
            });
        }
        let silence = now.saturating_duration_since(self.latest);
        if silence < GONE || now.saturating_duration_since(self.looked) < LOOK {
            return None;
        }
        self.looked = now;
        let other = self.node_of(id);
        let kept = self.kept.as_ref()?;
        let is_gone = self.subscription.publisher(kept.id) == Known::Gone;
        let is_again = silence >= SILENT && other.is_some() && other == kept.node;
        if !is_gone && !is_again {
            return None;
        }
        let line = format!(
            "{}: {} {}: {} is the publisher from now on",
            self.topic,
            named(kept.node.as_deref()),
            if is_gone { "has gone" } else { "is silent" },
            named(other.as_deref())
        );
        (self.say)(&line);
        self.others.remove(&id);
        self.kept = Some(Sender { id, node: other });
        Some(true)
    }

    fn node_of(&self, id: PublisherId) -> Option<String> {
        match self.subscription.publisher(id) {
            Known::Node(name) => Some(name),
            Known::Unnamed | Known::Gone => None,
        }
    }

    /// Names, once, publishers whose messages do not come here: those of other programs, of a topic that a node of
    /// this program publishes.
    fn tell_unheard(&mut self) {
        if self
            .looked_for_unheard
            .is_none_or(|at| at.elapsed() < NAMED)
        {
            return;
        }
        let nodes = self.subscription.unheard();
        self.looked_for_unheard = nodes.is_empty().then(Instant::now);
        if !nodes.is_empty() {
            (self.say)(&format!(
                "{} is published in this program, whose messages are used; the messages of {} do \
                 not arrive here",
                self.topic,
                nodes.join(", ")
            ));
        }
    }

    /// Names the other publishers that have not been named.
    fn tell(&mut self, now: Instant) {
        if self.others.values().all(|other| other.is_reported) {
            return;
        }
        let Some(Sender { id, node }) = self.kept.clone() else {
            return;
        };
        let node = node.or_else(|| self.node_of(id));
        let mut lines = Vec::new();
        let waiting: Vec<PublisherId> = self.others.keys().copied().collect();
        for id in waiting {
            let found = self.node_of(id);
            let Some(other) = self.others.get_mut(&id).filter(|other| !other.is_reported) else {
                continue;
            };
            other.node = other.node.take().or(found);
            let is_late = now.saturating_duration_since(other.since) >= NAMED;
            if node.is_some() && other.node.is_some() || is_late {
                other.is_reported = true;
                lines.push(format!(
                    "{} has two publishers: {} is used, and the messages of {} are left out; give \
                     one of them another topic, with -r {}:=OTHER",
                    self.topic,
                    named(node.as_deref()),
                    named(other.node.as_deref()),
                    self.topic
                ));
            }
        }
        for line in lines {
            (self.say)(&line);
        }
        if let Some(kept) = &mut self.kept {
            kept.node = node;
        }
    }
}

impl Drop for OnePublisher {
    /// Names publishers whose nodes were still looked up.
    fn drop(&mut self) {
        self.tell(Instant::now() + NAMED);
    }
}

/// For uses without a node: lines go to stderr.
impl From<Box<dyn Subscription>> for OnePublisher {
    fn from(subscription: Box<dyn Subscription>) -> Self {
        Self::new(
            subscription,
            "the topic",
            Box::new(|line| say!("eecvs-ros: {line}")),
        )
    }
}

fn named(node: Option<&str>) -> &str {
    node.unwrap_or(UNNAMED)
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::sync::{Arc, Mutex};

    use super::*;

    /// Messages of publishers by number, and the names of those that are there.
    #[derive(Default)]
    struct Come {
        messages: VecDeque<(u8, u8)>,
        there: HashMap<u8, &'static str>,
    }

    struct Shared(Arc<Mutex<Come>>);

    impl Subscription for Shared {
        fn take_from(&mut self, _: Duration) -> Result<Option<(Vec<u8>, PublisherId)>> {
            let next = self.0.lock().unwrap().messages.pop_front();
            Ok(next.map(|(id, message)| (vec![message], PublisherId([id; 16]))))
        }

        fn publisher(&self, PublisherId([id, ..]): PublisherId) -> Known {
            let name = self.0.lock().unwrap().there.get(&id).copied();
            name.map_or(Known::Gone, |name| Known::Node(name.to_owned()))
        }

        fn unheard(&self) -> Vec<String> {
            let is_elsewhere = |name: &&&str| name.contains("elsewhere");
            let come = self.0.lock().unwrap();
            let names = come.there.values().filter(is_elsewhere);
            names.map(|name| (*name).to_owned()).collect()
        }

        fn publishers(&self) -> usize {
            self.0.lock().unwrap().there.len()
        }
    }

    type Said = Arc<Mutex<Vec<String>>>;

    fn subscribed() -> (Arc<Mutex<Come>>, Said, OnePublisher) {
        let (come, said) = (Arc::<Mutex<Come>>::default(), Said::default());
        let lines = Arc::clone(&said);
        let say = Box::new(move |line: &str| lines.lock().unwrap().push(line.to_owned()));
        let one = OnePublisher::new(Box::new(Shared(Arc::clone(&come))), "/x", say);
        (come, said, one)
    }

    fn send(come: &Mutex<Come>, messages: &[(u8, u8)]) {
        come.lock().unwrap().messages.extend(messages);
    }

    fn taken(one: &mut OnePublisher) -> Vec<(u8, bool)> {
        let mut all = Vec::new();
        while let Some(taken) = one.take(Duration::ZERO).unwrap() {
            all.push((taken.cdr[0], taken.is_new_publisher));
        }
        all
    }

    #[test]
    fn the_first_publisher_is_kept_and_both_are_named() {
        let (come, said, mut one) = subscribed();
        come.lock().unwrap().there = [(1, "/a/first"), (2, "/a/second")].into();
        send(&come, &[(1, 10), (2, 20), (1, 11), (2, 21), (2, 22)]);
        assert_eq!(taken(&mut one), [(10, false), (11, false)]);
        assert_eq!(one.left_out(), 3);
        let lines = said.lock().unwrap().clone();
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!(
            lines[0].contains("/x has two publishers: /a/first is used"),
            "{lines:?}"
        );
        assert!(
            lines[0].contains("messages of /a/second are left out"),
            "{lines:?}"
        );
    }

    #[test]
    fn another_publisher_follows_one_that_is_gone() {
        let (come, said, mut one) = subscribed();
        come.lock().unwrap().there = [(1, "/a/driver"), (2, "/a/other")].into();
        send(&come, &[(1, 10), (2, 20)]);
        assert_eq!(taken(&mut one), [(10, false)]);
        // Silent, but there.
        std::thread::sleep(GONE + LOOK);
        send(&come, &[(2, 21)]);
        assert_eq!(taken(&mut one), []);
        come.lock().unwrap().there.remove(&1);
        std::thread::sleep(LOOK);
        send(&come, &[(2, 22), (2, 23), (1, 11)]);
        assert_eq!(taken(&mut one), [(22, true), (23, false)]);
        assert_eq!(one.left_out(), 3);
        let lines = said.lock().unwrap().join("\n");
        assert!(
            lines.contains("/a/driver has gone: /a/other is the publisher"),
            "{lines}"
        );
    }

    #[test]
    fn a_node_that_was_restarted_follows_its_silent_predecessor() {
        let (come, said, mut one) = subscribed();
        come.lock().unwrap().there = [(1, "/a/driver"), (2, "/a/driver")].into();
        send(&come, &[(1, 10), (2, 20)]);
        assert_eq!(taken(&mut one), [(10, false)]);
        std::thread::sleep(SILENT);
        send(&come, &[(2, 21)]);
        assert_eq!(taken(&mut one), [(21, true)]);
        assert!(
            said.lock()
                .unwrap()
                .join("\n")
                .contains("/a/driver is silent")
        );
    }

    #[test]
    fn publishers_that_are_not_heard_are_named_once() {
        let (come, said, mut one) = subscribed();
        come.lock().unwrap().there = [(9, "/elsewhere/driver")].into();
        std::thread::sleep(NAMED);
        for _ in 0..2 {
            assert_eq!(taken(&mut one), []);
        }
        let lines = said.lock().unwrap().clone();
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!(
            lines[0].contains("messages of /elsewhere/driver do not arrive here"),
            "{lines:?}"
        );
    }

    #[test]
    fn publishers_without_names_are_reported_at_the_end_at_the_latest() {
        let (come, said, mut one) = subscribed();
        send(&come, &[(1, 10), (2, 20)]);
        assert_eq!(taken(&mut one), [(10, false)]);
        assert!(said.lock().unwrap().is_empty());
        drop(one);
        assert!(said.lock().unwrap()[0].contains("a publisher without a node is used"));
    }
}
