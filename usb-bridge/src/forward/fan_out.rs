//! Gives the same messages to every consumer.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs::frame_file::FrameSink;
use eecvs_cli::output::io_causes;
use eecvs_nostd::Header;
use thiserror::Error;

use super::address::Address;
use super::consumer::{Consumer, LAST, Message, Report};

/// Messages whose memory is reused. At 50 million events per second, allocating new memory for each message would
/// take the system longer than the message itself.
const KEPT: usize = 32;

/// Longest wait for the first attempts to reach the consumers.
pub const TRIED: Duration = Duration::from_secs(4);
/// Period at which a wait looks.
const LOOK: Duration = Duration::from_millis(2);

/// Error that ends a stream before its source does: every consumer has stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("no consumer is left")]
pub struct NobodyLeft;

impl NobodyLeft {
    /// Returns whether this is the cause of an error.
    #[must_use]
    pub fn is_cause_of(error: &anyhow::Error) -> bool {
        io_causes(error).any(|io| {
            let inner = io.get_ref();
            inner.and_then(|inner| inner.downcast_ref()) == Some(&Self)
        })
    }
}

/// All consumers of a stream.
pub struct FanOut {
    consumers: Vec<Consumer>,
    /// Bytes of the latest messages, the oldest first.
    given: VecDeque<Arc<Vec<u8>>>,
}

impl FanOut {
    /// Starts a consumer at every address, each with a queue of at most `queue_bytes` bytes, and waits for the first
    /// attempts to reach them: at most [`TRIED`], and while `goes_on` returns true. A consumer that is away is tried again;
    /// existing files are replaced only with `overwrite`.
    ///
    /// # Errors
    /// That of the first address that cannot be used.
    pub fn start(
        addresses: &[Address],
        queue_bytes: usize,
        overwrite: bool,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<Self> {
        let start = |address: &Address| Consumer::start(address.clone(), queue_bytes, overwrite);
        let consumers: Vec<Consumer> = addresses.iter().map(start).collect::<Result<_>>()?;
        let until = Instant::now() + TRIED;
        while !consumers.iter().all(Consumer::is_tried) && Instant::now() < until && goes_on() {
            thread::sleep(LOOK);
        }
        consumers.iter().try_for_each(Consumer::check)?;
        Ok(Self {
            consumers,
            given: VecDeque::with_capacity(KEPT),
        })
    }

    /// Gives every consumer a message with this number of events.
    pub fn give(&mut self, bytes: &[u8], events: u64) {
        let mut memory = self.memory();
        memory.extend_from_slice(bytes);
        let memory = Arc::new(memory);
        self.given.push_back(Arc::clone(&memory));
        let message = Message {
            bytes: memory,
            events,
        };
        for consumer in &self.consumers {
            consumer.give(message.clone());
        }
    }

    /// Gives every consumer a message, unless all of them have stopped.
    fn take(&mut self, bytes: &[u8], events: u64) -> io::Result<()> {
        if self.is_over() {
            return Err(io::Error::other(NobodyLeft));
        }
        self.give(bytes, events);
        Ok(())
    }

    /// Returns a buffer for a message: that of the oldest message if every consumer is done with it.
    fn memory(&mut self) -> Vec<u8> {
        let is_full = self.given.len() >= KEPT;
        let is_done = |oldest: &mut Arc<Vec<u8>>| is_full || Arc::get_mut(oldest).is_some();
        let oldest = self.given.pop_front_if(is_done);
        let mut memory = oldest.and_then(Arc::into_inner).unwrap_or_default();
        memory.clear();
        memory
    }

    /// Returns what has happened to the messages so far.
    #[must_use]
    pub fn reports(&self) -> Vec<Report> {
        self.consumers.iter().map(Consumer::report).collect()
    }

    /// Returns whether every consumer has stopped for good.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.consumers.iter().all(Consumer::is_done)
    }

    /// Ends the stream: waits up to `grace`, and while `goes_on` returns true, until every consumer has taken what is
    /// queued. Files count as complete only if `is_whole`, that is, the stream ended as it should.
    #[must_use]
    pub fn finish(
        self,
        grace: Duration,
        goes_on: &dyn Fn() -> bool,
        is_whole: bool,
    ) -> Vec<Report> {
        for consumer in &self.consumers {
            consumer.end();
        }
        let until = Instant::now() + grace;
        while !self.is_over() && Instant::now() < until && goes_on() {
            thread::sleep(LOOK);
        }
        for consumer in &self.consumers {
            consumer.give_up();
        }
        let last = Instant::now() + LAST;
        while !self.is_over() && Instant::now() < last {
            thread::sleep(LOOK);
        }
        let consumers = self.consumers.into_iter();
        consumers
            .map(|consumer| consumer.finish(is_whole))
            .collect()
    }
}

impl FrameSink for FanOut {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> io::Result<()> {
        self.take(bytes, header.events.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::net::TcpListener;
    use std::os::unix::net::UnixListener;

    const QUEUE_BYTES: usize = 1 << 16;

    fn message(i: u32) -> Vec<u8> {
        let mut message = vec![i as u8; 1000];
        message[..4].copy_from_slice(&i.to_le_bytes());
        message
    }

    #[test]
    fn one_that_stops_reading_costs_the_others_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("all");
        let stuck = TcpListener::bind("127.0.0.1:0").unwrap();
        let path = folder.path().join("socket");
        let reading = UnixListener::bind(&path).unwrap();
        let reader = thread::spawn(move || {
            let mut bytes = Vec::new();
            reading.accept().unwrap().0.read_to_end(&mut bytes).unwrap();
            bytes
        });
        let mut fan_out = FanOut::start(
            &[
                Address::File(file.clone()),
                Address::Tcp(stuck.local_addr().unwrap().to_string()),
                Address::Unix(path),
            ],
            QUEUE_BYTES,
            true,
            &|| true,
        )
        .unwrap();
        let (_held, _) = stuck.accept().unwrap();
        // The system's own buffers accept megabytes that nobody reads; after that, everything is lost.
        let (mut count, mut all) = (0, Vec::new());
        let (mut taken, mut since) = (0, Instant::now());
        let is_lagging = |fan_out: &FanOut| fan_out.reports()[1].lost.messages > 100;
        while since.elapsed() < Duration::from_millis(600) || !is_lagging(&fan_out) {
            let now = fan_out.reports()[1].sent.messages;
            if now > taken {
                (taken, since) = (now, Instant::now());
            }
            assert!(count < 200_000, "{:?}", fan_out.reports());
            fan_out.give(&message(count), 3);
            all.extend(message(count));
            count += 1;
            assert!(fan_out.given.len() <= KEPT);
            // The other consumers get the time that a camera would give them.
            let behind = |i: usize| fan_out.reports()[i].sent.messages + 32 < u64::from(count);
            while behind(0) || behind(2) {
                thread::yield_now();
            }
        }
        let [written, lagging, read] =
            <[Report; 3]>::try_from(fan_out.finish(Duration::from_secs(2), &|| true, true))
                .unwrap();
        for report in [&written, &read] {
            assert_eq!(report.lost.messages, 0, "{report:?}");
            assert_eq!(report.sent.messages, u64::from(count));
            assert_eq!(report.sent.events, 3 * u64::from(count));
        }
        assert_eq!(std::fs::read(&file).unwrap(), all);
        assert_eq!(reader.join().unwrap(), all);
        assert!(lagging.lost.messages > 0, "{lagging:?}");
        assert_eq!(
            lagging.lost.messages + lagging.sent.messages,
            u64::from(count)
        );
        assert!(lagging.failure.is_some());
        assert!(lagging.queue_peak_bytes <= QUEUE_BYTES);
    }

    #[test]
    fn one_that_vanishes_comes_back_and_its_losses_are_counted() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(listener.local_addr().unwrap().to_string());
        let mut fan_out = FanOut::start(&[address], QUEUE_BYTES, false, &|| true).unwrap();
        drop(listener.accept().unwrap());
        let until = Instant::now() + Duration::from_secs(20);
        let mut given = 0;
        let mut back = None;
        listener.set_nonblocking(true).unwrap();
        while back.is_none() && Instant::now() < until {
            fan_out.give(&message(given), 1);
            given += 1;
            thread::sleep(Duration::from_millis(2));
            back = listener.accept().ok();
        }
        let (mut stream, _) = back.expect("it comes back");
        stream.set_nonblocking(false).unwrap();
        fan_out.give(&message(u32::MAX), 1);
        given += 1;
        let mut last = [0; 4];
        while last != u32::MAX.to_le_bytes() {
            let mut bytes = [0; 1000];
            stream.read_exact(&mut bytes).unwrap();
            last.copy_from_slice(&bytes[..4]);
        }
        let reports = fan_out.finish(Duration::from_secs(1), &|| true, true);
        let report = &reports[0];
        assert_eq!(report.reconnects, 1);
        assert!(report.lost.messages > 0, "{report:?}");
        assert_eq!(
            report.lost.messages + report.sent.messages,
            u64::from(given)
        );
        assert_eq!(report.failure, None);
    }

    #[test]
    fn one_that_comes_late_gets_what_waits_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let free = listener.local_addr().unwrap();
        drop(listener);
        let (file, path) = (folder.path().join("all"), folder.path().join("socket"));
        let addresses = [
            Address::File(file.clone()),
            Address::Tcp(free.to_string()),
            Address::Unix(path.clone()),
        ];
        let mut fan_out = FanOut::start(&addresses, QUEUE_BYTES, false, &|| true).unwrap();
        let reports = fan_out.reports();
        for (report, is_there) in reports.iter().zip([true, false, false]) {
            assert_eq!(report.failure.is_none(), is_there, "{report:?}");
        }
        fan_out.give(&message(0), 1);
        let listener = UnixListener::bind(&path).unwrap();
        let (mut stream, _) = listener.accept().unwrap();
        fan_out.give(&message(1), 1);
        let mut bytes = [0; 2000];
        stream.read_exact(&mut bytes).unwrap();
        assert_eq!(bytes[..], [message(0), message(1)].concat());
        assert!(!fan_out.is_over());
        let [written, absent, late] =
            <[Report; 3]>::try_from(fan_out.finish(Duration::from_secs(2), &|| true, true))
                .unwrap();
        for report in [&written, &late] {
            assert_eq!(report.sent.messages, 2, "{report:?}");
            assert_eq!((report.reached, report.reconnects), (true, 0), "{report:?}");
            assert_eq!(report.failure, None);
        }
        assert_eq!((absent.reached, absent.lost.messages), (false, 2));
        assert!(absent.failure.is_some());
        assert_eq!(std::fs::read(file).unwrap(), bytes);
    }

    /// Messages sent to nobody are lost and counted as such; a receiver that appears later gets a stream from its
    /// beginning.
    #[test]
    fn datagrams_that_nobody_takes_are_lost_and_do_not_end_it() {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let to = socket.local_addr().unwrap();
        drop(socket);
        let address = Address::Udp(to.to_string());
        let mut fan_out = FanOut::start(&[address], QUEUE_BYTES, false, &|| true).unwrap();
        let settled = |fan_out: &FanOut, count: u64| {
            let until = Instant::now() + Duration::from_secs(20);
            loop {
                let report = fan_out.reports().remove(0);
                if report.sent.messages + report.lost.messages == count {
                    return report;
                }
                assert!(Instant::now() < until, "{report:?}");
                thread::sleep(Duration::from_millis(2));
            }
        };
        fan_out.give(&message(0), 1);
        fan_out.give(&message(1), 1);
        let report = settled(&fan_out, 2);
        assert_eq!((report.lost.messages, report.reached), (2, false));
        assert!(report.failure.is_some());
        let socket = std::net::UdpSocket::bind(to).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        fan_out.give(&message(2), 1);
        let report = settled(&fan_out, 3);
        assert_eq!((report.sent.messages, report.reached), (1, true));
        assert_eq!((report.failure, report.reconnects), (None, 0));
        let mut bytes = [0; 2000];
        let length = socket.recv(&mut bytes).unwrap();
        assert!(bytes[..length].ends_with(&message(2)));
        // The first datagram of its stream.
        assert_eq!(bytes[8..16], [0; 8]);
        let _ = fan_out.finish(Duration::from_secs(2), &|| true, true);
        assert!(socket.recv(&mut bytes).unwrap() < 20, "the end");
    }

    #[test]
    fn a_file_is_complete_or_marked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.eecvs");
        std::fs::write(&path, "old").unwrap();
        let address = Address::File(path.clone());
        let start =
            || FanOut::start(std::slice::from_ref(&address), QUEUE_BYTES, true, &|| true).unwrap();
        let mut fan_out = start();
        fan_out.give(b"new", 1);
        let reports = fan_out.finish(Duration::from_secs(2), &|| true, false);
        let failure = reports[0].failure.clone().unwrap();
        assert!(failure.contains("incomplete-a.eecvs"), "{failure}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert!(
            FanOut::start(std::slice::from_ref(&address), QUEUE_BYTES, false, &|| true).is_err()
        );
        let mut fan_out = start();
        fan_out.give(b"new", 1);
        let reports = fan_out.finish(Duration::from_secs(2), &|| true, true);
        assert_eq!(reports[0].failure, None);
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(!folder.path().join("incomplete-a.eecvs").exists());
    }

    #[test]
    fn where_nobody_is_left_it_is_over() {
        let mut fan_out = FanOut::start(
            &[Address::File("/dev/full".into())],
            QUEUE_BYTES,
            false,
            &|| true,
        )
        .unwrap();
        let until = Instant::now() + Duration::from_secs(20);
        while fan_out.take(b"bytes", 0).is_ok() {
            assert!(Instant::now() < until);
            thread::sleep(Duration::from_millis(2));
        }
        assert!(fan_out.is_over());
    }
}
