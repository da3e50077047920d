//! The same messages for every consumer.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::Frame;

use super::address::Address;
use super::consumer::{Consumer, Message, Report};

/// Messages whose memory is used again: at 50 million events per second, new memory for each would take the
/// system longer than the message itself.
const KEPT: usize = 32;

/// All consumers. As a writer it takes a whole frame with every `write_all`, which is how the encoder
/// gives them.
pub struct FanOut {
    consumers: Vec<Consumer>,
    /// The bytes of the latest messages, the oldest first.
    given: VecDeque<Arc<Vec<u8>>>,
}

impl FanOut {
    /// Opens the way to every address; each has a queue of at most `queue_bytes`.
    ///
    /// # Errors
    /// The first that cannot be reached.
    pub fn start(addresses: &[Address], queue_bytes: usize) -> Result<Self> {
        let start = |address: &Address| Consumer::start(address.clone(), queue_bytes);
        let consumers = addresses.iter().map(start).collect::<Result<_>>()?;
        Ok(Self {
            consumers,
            given: VecDeque::with_capacity(KEPT),
        })
    }

    /// Gives everyone a message of so many events.
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

    /// Room for a message: that of the oldest one, where everyone is done with it.
    fn memory(&mut self) -> Vec<u8> {
        let is_full = self.given.len() >= KEPT;
        let is_done = |oldest: &mut Arc<Vec<u8>>| is_full || Arc::get_mut(oldest).is_some();
        let oldest = self.given.pop_front_if(is_done);
        let mut memory = oldest.and_then(Arc::into_inner).unwrap_or_default();
        memory.clear();
        memory
    }

    /// What became of the messages so far.
    #[must_use]
    pub fn reports(&self) -> Vec<Report> {
        self.consumers.iter().map(Consumer::report).collect()
    }

    /// Ends the stream: waits at most for `grace` until everyone has taken what is queued.
    #[must_use]
    pub fn finish(&self, grace: Duration) -> Vec<Report> {
        for consumer in &self.consumers {
            consumer.end();
        }
        let until = Instant::now() + grace;
        let finish = |consumer: &Consumer| consumer.finish(until);
        self.consumers.iter().map(finish).collect()
    }
}

impl Write for FanOut {
    fn write(&mut self, frame: &[u8]) -> io::Result<usize> {
        let events = Frame::parse(frame).map_or(0, |frame| u64::from(frame.header.events));
        self.give(frame, events);
        Ok(frame.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
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
        let reader = std::thread::spawn(move || {
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
        )
        .unwrap();
        let (_held, _) = stuck.accept().unwrap();
        // The system's own buffers take megabytes of what nobody reads; after that, all is lost.
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
            // The others get the time that a camera gives them.
            let behind = |i: usize| fan_out.reports()[i].sent.messages + 32 < u64::from(count);
            while behind(0) || behind(2) {
                std::thread::yield_now();
            }
        }
        let [written, lagging, read] =
            <[Report; 3]>::try_from(fan_out.finish(Duration::from_millis(300))).unwrap();
        drop(fan_out);
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
        let mut fan_out = FanOut::start(&[address], QUEUE_BYTES).unwrap();
        drop(listener.accept().unwrap());
        let until = Instant::now() + Duration::from_secs(20);
        let mut given = 0;
        let mut back = None;
        listener.set_nonblocking(true).unwrap();
        while back.is_none() && Instant::now() < until {
            fan_out.give(&message(given), 1);
            given += 1;
            std::thread::sleep(Duration::from_millis(2));
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
        let reports = fan_out.finish(Duration::from_secs(1));
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
    fn nobody_there_is_one_line() {
        let free = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let address = Address::Tcp(free.to_string());
        let error = FanOut::start(&[address], 1).err().unwrap();
        assert!(
            error.to_string().starts_with(&format!("tcp://{free}: ")),
            "{error}"
        );
    }
}
