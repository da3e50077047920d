//! Connections that cannot do harm: their number is bounded, and none waits without end.
//!
//! A client that sends nothing, sends slowly, or does not take its answer is disconnected after a while. If there
//! are too many connections, one is closed at once, those first that never got an answer.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use axum::serve::Listener;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, Sleep, sleep_until};

/// Maximum number of simultaneous connections.
pub const CONNECTIONS_MAX: usize = 256;

/// Time limit for a whole request, from the start of the connection or the request's first byte.
const ASKING: Duration = Duration::from_secs(10);

/// Time limit for an answer and the wait for the next request, from the answer's first byte.
const ANSWERING: Duration = Duration::from_secs(30);

/// Wait after an error of the system, typically too many open files.
const RETRY: Duration = Duration::from_millis(100);

/// What is known of a connection outside the task that serves it.
#[derive(Debug)]
struct Entry {
    is_ended: AtomicBool,
    waker: Mutex<Option<Waker>>,
    /// Whether the connection ever got an answer, and since when it is in its present state.
    state: Mutex<(bool, Instant)>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[derive(Debug, Default)]
struct Open {
    entries: BTreeMap<u64, Arc<Entry>>,
    next: u64,
}

impl Open {
    /// Registers a new connection and returns its number. If there are too many, another one is ended to make room.
    fn enter(&mut self, entry: Arc<Entry>) -> u64 {
        while self.entries.len() >= CONNECTIONS_MAX {
            let longest = self
                .entries
                .iter()
                .min_by_key(|(_, entry)| *lock(&entry.state));
            let Some(number) = longest.map(|(number, _)| *number) else {
                break;
            };
            if let Some(ended) = self.entries.remove(&number) {
                ended.is_ended.store(true, Ordering::Relaxed);
                if let Some(waker) = lock(&ended.waker).take() {
                    waker.wake();
                }
            }
        }
        self.next += 1;
        self.entries.insert(self.next, entry);
        self.next
    }
}

/// A listener for axum with a bounded number of connections.
pub struct Bounded {
    listener: TcpListener,
    open: Arc<Mutex<Open>>,
}

impl Bounded {
    /// Bounds the connections that a listener accepts.
    pub fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            open: Arc::default(),
        }
    }
}

impl Listener for Bounded {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => {
                    // Sends small answers at once; a failure only delays them.
                    let _ = stream.set_nodelay(true);
                    return (Connection::new(stream, &self.open), address);
                }
                Err(_) => tokio::time::sleep(RETRY).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection with deadlines.
pub struct Connection {
    stream: TcpStream,
    open: Arc<Mutex<Open>>,
    number: u64,
    entry: Arc<Entry>,
    is_answering: bool,
    deadline: Pin<Box<Sleep>>,
}

impl Connection {
    fn new(stream: TcpStream, open: &Arc<Mutex<Open>>) -> Self {
        let now = Instant::now();
        let entry = Arc::new(Entry {
            is_ended: AtomicBool::new(false),
            waker: Mutex::default(),
            state: Mutex::new((false, now)),
        });
        Self {
            stream,
            open: Arc::clone(open),
            number: lock(open).enter(Arc::clone(&entry)),
            entry,
            is_answering: false,
            deadline: Box::pin(sleep_until(now + ASKING)),
        }
    }

    /// Returns an error if the connection is to end; otherwise the task will be woken when it is.
    fn check(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        lock(&self.entry.waker).replace(context.waker().clone());
        let is_ended = self.entry.is_ended.load(Ordering::Relaxed);
        if is_ended || self.deadline.as_mut().poll(context).is_ready() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        Ok(())
    }

    /// Switches between request and answer. Only a switch starts another deadline, not every byte.
    fn turn(&mut self, is_answering: bool) {
        if self.is_answering == is_answering {
            return;
        }
        self.is_answering = is_answering;
        let now = Instant::now();
        *lock(&self.entry.state) = (true, now);
        let time = if is_answering { ANSWERING } else { ASKING };
        self.deadline.as_mut().reset(now + time);
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        lock(&self.open).entries.remove(&self.number);
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.check(context)?;
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if buffer.filled().len() > before {
            self.turn(false);
        }
        read
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.check(context)?;
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        if matches!(written, Poll::Ready(Ok(1..))) {
            self.turn(true);
        }
        written
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.check(context)?;
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, pieces);
        if matches!(written, Poll::Ready(Ok(1..))) {
            self.turn(true);
        }
        written
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
