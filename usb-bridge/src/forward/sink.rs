//! Writes a consumer's messages to its address.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::unix::net::UnixStream;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use eecvs::frame_file::{FrameFileWriter, FrameSink};
use eecvs_nostd::Frame;
use event_files::output::create_bytes;

use super::address::Address;
use super::datagram::Cutter;
use super::refusal;
use crate::resolve::addresses;

/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(3);
/// Time after which a blocked write checks whether it may go on.
const WAIT: Duration = Duration::from_millis(100);
/// Number of datagrams that announce the end, in case some are lost.
const ENDS: usize = 3;

/// An open connection, socket or file to which messages are written.
#[derive(Debug)]
pub enum Sink {
    /// A TCP connection.
    Tcp(TcpStream),
    /// A UDP socket, the cutter of its stream and the buffer of a datagram.
    Udp(UdpSocket, Cutter, Vec<u8>),
    /// A connected Unix domain socket.
    Unix(UnixStream),
    /// A device, a pipe, or a file of packets, or one that has no message yet.
    File(File),
    /// A file of frames.
    Frames(Box<FrameFileWriter<File>>),
    /// Standard output.
    Stdout,
}

impl Sink {
    /// Opens the sink at an address; an existing file is replaced.
    ///
    /// # Errors
    /// Nobody listens at the address, or the file cannot be created.
    pub fn open(address: &Address) -> io::Result<Self> {
        Ok(match address {
            Address::Tcp(to) => {
                let stream = connect(to)?;
                stream.set_write_timeout(Some(WAIT))?;
                // Without Nagle's algorithm a frame does not wait for the next one.
                stream.set_nodelay(true)?;
                Self::Tcp(stream)
            }
            Address::Udp(to) => {
                let socket = udp(to)?;
                socket.set_write_timeout(Some(WAIT))?;
                Self::Udp(socket, Cutter::new(stream_number()), Vec::new())
            }
            Address::Unix(path) => {
                let stream = UnixStream::connect(path)?;
                stream.set_write_timeout(Some(WAIT))?;
                Self::Unix(stream)
            }
            Address::File(path) => Self::File(create_bytes(path)?),
            Address::Stdout => Self::Stdout,
        })
    }

    /// Returns whether the consumer can refuse the connection: whether there is one.
    #[must_use]
    pub const fn may_refuse(&self) -> bool {
        matches!(self, Self::Tcp(_) | Self::Unix(_))
    }

    /// Returns why the consumer refused this connection, if it has said so: it took nothing of what was sent.
    pub fn refusal(&mut self) -> Option<String> {
        match self {
            Self::Tcp(stream) => {
                stream.set_nonblocking(true).ok()?;
                let word = refusal::receive(stream);
                stream.set_nonblocking(false).ok()?;
                word
            }
            Self::Unix(stream) => {
                stream.set_nonblocking(true).ok()?;
                let word = refusal::receive(stream);
                stream.set_nonblocking(false).ok()?;
                word
            }
            Self::Udp(..) | Self::File(_) | Self::Frames(_) | Self::Stdout => None,
        }
    }

    /// Sends a message; a slow consumer is waited for while `goes_on` returns true.
    ///
    /// # Errors
    /// The consumer is gone; `TimedOut` if the message was given up; `WouldBlock` if the system had no room for a
    /// datagram.
    pub fn send(&mut self, message: &[u8], goes_on: &dyn Fn() -> bool) -> io::Result<()> {
        if let Self::File(file) = self
            && Frame::parse(message).is_ok()
            && file.metadata()?.is_file()
        {
            *self = Self::Frames(Box::new(FrameFileWriter::new(file.try_clone()?)));
        }
        match self {
            Self::Tcp(stream) => send_all(stream, message, goes_on),
            Self::Unix(stream) => send_all(stream, message, goes_on),
            Self::File(file) => file.write_all(message),
            Self::Frames(file) => {
                let frame = Frame::parse(message).map_err(io::Error::other)?;
                file.frame(&frame.header, message)
            }
            Self::Stdout => {
                let mut out = io::stdout().lock();
                out.write_all(message)?;
                out.flush()
            }
            Self::Udp(socket, cutter, datagram) => {
                let mut dropped = Ok(());
                let sent = cutter.cut(message, datagram, |datagram| match socket.send(datagram) {
                    Ok(_) => Ok(()),
                    // The receiver notices the gap in the sequence numbers.
                    Err(error) if is_full(&error) => {
                        dropped = Err(ErrorKind::WouldBlock.into());
                        Ok(())
                    }
                    Err(error) => Err(error),
                });
                // Fetches an error that the remote host has already reported, such as a closed port.
                let sent = sent.and_then(|()| match socket.take_error()? {
                    Some(error) => Err(error),
                    None => Ok(()),
                });
                if sent.is_err() {
                    // Nobody listened to this stream; a receiver that appears later gets a new stream from its
                    // beginning.
                    cutter.begin_anew();
                }
                sent.and(dropped)
            }
        }
    }

    /// Announces the end of the stream over UDP, and marks it in a file of frames; a closed connection needs no
    /// announcement.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn end(&mut self) -> io::Result<()> {
        if let Self::Frames(file) = self {
            return file.end();
        }
        if let Self::Udp(socket, cutter, datagram) = self
            && !cutter.is_at_start()
        {
            cutter.end(datagram);
            for _ in 0..ENDS {
                // A receiver that misses the announcement keeps waiting.
                let _ = socket.send(datagram);
            }
        }
        Ok(())
    }

    /// Returns whether the sink can be used further after this error, although the message is lost: UDP has no
    /// connection that could break.
    #[must_use]
    pub fn survives(&self, error: &io::Error) -> bool {
        let is_away = matches!(
            error.kind(),
            ErrorKind::ConnectionRefused
                | ErrorKind::HostUnreachable
                | ErrorKind::NetworkUnreachable
                | ErrorKind::NetworkDown
        );
        matches!(self, Self::Udp(..)) && (is_away || is_full(error))
    }

    /// Returns whether it makes sense to open the sink again after it failed.
    #[must_use]
    pub const fn comes_back(&self) -> bool {
        matches!(self, Self::Tcp(_) | Self::Udp(..) | Self::Unix(_))
    }
}

/// Returns whether the system had no room for a datagram.
fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn send_all(stream: &mut impl Write, message: &[u8], goes_on: &dyn Fn() -> bool) -> io::Result<()> {
    let mut left = message;
    while !left.is_empty() {
        match stream.write(left) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(sent) => left = &left[sent..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
                    && goes_on() => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                return Err(ErrorKind::TimedOut.into());
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn connect(to: &str) -> io::Result<TcpStream> {
    first(to, |address| TcpStream::connect_timeout(&address, CONNECT))
}

fn udp(to: &str) -> io::Result<UdpSocket> {
    first(to, |address| {
        let any = if address.is_ipv4() {
            "0.0.0.0:0"
        } else {
            "[::]:0"
        };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        Ok(socket)
    })
}

/// Opens the first address of a name that can be opened; returns the last error otherwise.
fn first<T>(to: &str, open: impl Fn(SocketAddr) -> io::Result<T>) -> io::Result<T> {
    let mut last = ErrorKind::NotFound.into();
    for address in addresses(to, &|| true)? {
        match open(address) {
            Ok(opened) => return Ok(opened),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Returns a number that differs between starts of the program.
fn stream_number() -> u32 {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    (now.as_micros() as u32) ^ std::process::id().rotate_left(16)
}
