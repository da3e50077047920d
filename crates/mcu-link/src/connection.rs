//! A byte stream to an encoder, used in both directions at once.

use std::io::{self, ErrorKind, Read, Write};
use std::ops::ControlFlow;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use event_types::bail;
use event_types::stream::{self, Error, Result};

use super::link::{Demultiplexer, Message};

/// Longest time for which a read or a write may block.
const WAIT: Duration = Duration::from_millis(100);
/// Time after the last received byte at which an incomplete message is given up as damaged.
const INCOMPLETE: Duration = Duration::from_secs(5);
/// Maximum number of bytes read at a time.
const READ_BYTES: usize = 1 << 14;

/// A byte stream to an encoder and back, such as a socket of an emulator or a serial port.
pub trait Link {
    /// Returns both directions of the link, each for a thread of its own.
    ///
    /// Reads and writes block for a short time only: if no bytes move, they fail with `TimedOut` or `WouldBlock`.
    ///
    /// # Errors
    /// An I/O error if the link cannot be used.
    fn halves(&self) -> io::Result<Halves>;
}

/// The two directions of a [`Link`].
pub struct Halves {
    /// Direction from the encoder.
    pub reader: Box<dyn Read + Send>,
    /// Direction to the encoder.
    pub writer: Box<dyn Write + Send>,
}

impl Link for UnixStream {
    fn halves(&self) -> io::Result<Halves> {
        self.set_read_timeout(Some(WAIT))?;
        self.set_write_timeout(Some(WAIT))?;
        Ok(Halves {
            reader: Box::new(self.try_clone()?),
            writer: Box::new(self.try_clone()?),
        })
    }
}

/// Returns whether an error means that no bytes moved yet, rather than that the link failed.
fn is_pause(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

/// The sending side of [`Connection::exchange`].
pub struct Sender<'c> {
    writer: &'c mut dyn Write,
    stop: &'c AtomicBool,
    moved: &'c AtomicU64,
}

impl Sender<'_> {
    /// Sends all of `bytes`, however long the encoder blocks the link.
    ///
    /// # Errors
    /// The link failed, or the exchange ended.
    pub fn send(&mut self, bytes: &[u8]) -> Result<()> {
        let mut left = bytes;
        while !left.is_empty() {
            if self.is_stopped() {
                bail!(Other, "the exchange ended");
            }
            match self.writer.write(left) {
                Ok(0) => bail!(Damaged, "the link to the encoder accepts no more bytes"),
                Ok(sent) => {
                    self.moved.fetch_add(sent as u64, Ordering::Relaxed);
                    left = &left[sent..];
                }
                Err(error) if is_pause(&error) => {}
                // Not attached as a source: the command line treats a broken pipe as a harmless end.
                Err(error) => return Err(failed("sending to the encoder", &error)),
            }
        }
        Ok(())
    }

    /// Returns whether the exchange has ended.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits for `duration`, but returns early if `is_over` returns true or the exchange ends.
    pub fn pause(&self, duration: Duration, is_over: impl Fn() -> bool) {
        let started = Instant::now();
        while !self.is_stopped() && !is_over() && started.elapsed() < duration {
            thread::sleep(Duration::from_millis(10));
        }
    }
}

/// A link in use, with the received bytes that have not been consumed yet.
pub struct Connection {
    halves: Halves,
    incoming: Demultiplexer,
    patience: Duration,
}

impl Connection {
    /// Opens a connection over a link; an exchange fails if no bytes move for longer than `patience`.
    ///
    /// # Errors
    /// The link cannot be used.
    pub fn new(link: &dyn Link, patience: Duration) -> Result<Self> {
        let halves = link
            .halves()
            .map_err(|error| failed("the link to the encoder", &error))?;
        Ok(Self {
            halves,
            incoming: Demultiplexer::default(),
            patience,
        })
    }

    /// Returns the demultiplexer, which holds received bytes that have not been consumed yet.
    pub const fn incoming(&mut self) -> &mut Demultiplexer {
        &mut self.incoming
    }

    /// Returns how long an exchange may go without any bytes moving.
    #[must_use]
    pub const fn patience(&self) -> Duration {
        self.patience
    }

    /// Runs `send` in its own thread and passes every received message to `take`, until `take` returns `Break`.
    ///
    /// Sending and receiving must run concurrently, because an encoder whose output is not read stops reading.
    ///
    /// # Errors
    /// An error of `send` or `take`, a failed link, or no bytes moving for longer than the connection's patience.
    pub fn exchange(
        &mut self,
        send: impl FnOnce(&mut Sender<'_>) -> Result<()> + Send,
        mut take: impl FnMut(Message, &mut Demultiplexer) -> Result<ControlFlow<()>>,
    ) -> Result<()> {
        let (stop, moved) = (AtomicBool::new(false), AtomicU64::new(0));
        let Self {
            halves: Halves { reader, writer },
            incoming,
            patience,
        } = self;
        thread::scope(|scope| {
            let sending = scope.spawn(|| {
                let mut sender = Sender {
                    writer,
                    stop: &stop,
                    moved: &moved,
                };
                // An error after the end of the exchange is only a consequence of that end.
                send(&mut sender)
                    .err()
                    .filter(|_| !stop.swap(true, Ordering::Relaxed))
            });
            let received = receive(
                reader.as_mut(),
                incoming,
                *patience,
                &stop,
                &moved,
                &mut take,
            );
            stop.store(true, Ordering::Relaxed);
            match sending.join() {
                Ok(Some(error)) => Err(error),
                Ok(None) => received,
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })
    }
}

fn receive(
    reader: &mut dyn Read,
    incoming: &mut Demultiplexer,
    patience: Duration,
    stop: &AtomicBool,
    moved: &AtomicU64,
    take: &mut dyn FnMut(Message, &mut Demultiplexer) -> Result<ControlFlow<()>>,
) -> Result<()> {
    let mut bytes = vec![0; READ_BYTES];
    let mut sent = 0;
    let (mut last_moved, mut last_received) = (Instant::now(), Instant::now());
    loop {
        while let Some(message) = incoming.next_message() {
            if take(message, incoming)?.is_break() {
                return Ok(());
            }
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        match reader.read(&mut bytes) {
            Ok(0) => bail!(Damaged, "the encoder's end of the link was closed"),
            Ok(read) => {
                incoming.push(&bytes[..read]);
                (last_moved, last_received) = (Instant::now(), Instant::now());
            }
            Err(error) if is_pause(&error) => {
                let now = moved.load(Ordering::Relaxed);
                if now != sent {
                    (sent, last_moved) = (now, Instant::now());
                }
                if last_received.elapsed() > INCOMPLETE {
                    incoming.give_up();
                }
                if last_moved.elapsed() > patience {
                    return Err(stalled(patience));
                }
            }
            Err(error) => return Err(failed("receiving from the encoder", &error)),
        }
    }
}

fn stalled(patience: Duration) -> Error {
    let what = format!(
        "the encoder has neither accepted nor sent anything for {} s",
        patience.as_secs_f32()
    );
    Error::new(stream::ErrorKind::Io(ErrorKind::TimedOut), what)
}

fn failed(what: &str, error: &io::Error) -> Error {
    Error::new(
        stream::ErrorKind::Io(error.kind()),
        format!("{what}: {error}"),
    )
}
