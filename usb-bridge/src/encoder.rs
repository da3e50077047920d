//! An encoder on USB or on a serial port that the host configures: restart, setup and both directions at once.
//!
//! The protocol is that of [`mcu_link`], whatever the link; this module adds the parts specific to USB.

use std::io::{self, ErrorKind, Read, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Config;
use eecvs_nostd::event_link::Setup;
use mcu_link::Connection;
use mcu_link::connection::Halves;

use crate::device::mcu::{NAME, RESTART};
use crate::link::control::{Control, Request};
use crate::link::{Link, LinkError, Outlet, Received};
use crate::session::Source;

/// Longest wait for one receive.
const WAIT: Duration = Duration::from_millis(100);
/// Bytes per send, so that the sender checks often enough whether the exchange has ended.
const PIECE: usize = 4096;

type Shared = Arc<Mutex<Box<dyn Link>>>;

/// An encoder whose session has begun.
pub struct Encoder {
    /// The device, with [`Nowhere`] in place of its link.
    source: Source,
    link: Shared,
}

impl Encoder {
    /// Begins a session: the encoder drops what an earlier host left in it. A serial port has no such request;
    /// there the setup begins the session.
    ///
    /// # Errors
    /// The device is not an encoder, or it refuses the request.
    pub fn begin(mut source: Source) -> Result<Self> {
        let name = source.link.name().to_owned();
        ensure!(
            source.model.name() == NAME,
            "{name}: is a {}, not an encoder that can be set up",
            source.info.name
        );
        if let Some(control) = &mut source.control {
            restart(control.as_mut()).with_context(|| format!("{name}: beginning a session"))?;
        }
        let link = std::mem::replace(&mut source.link, Box::new(Nowhere));
        Ok(Self {
            source,
            link: Arc::new(Mutex::new(link)),
        })
    }

    /// Returns the device, without its link: model, identity and control side.
    #[must_use]
    pub const fn source(&self) -> &Source {
        &self.source
    }

    /// Returns the name of the link, for messages.
    #[must_use]
    pub fn name(&self) -> String {
        lock(&self.link).name().to_owned()
    }

    /// Opens a connection over the link. An exchange on it fails if nothing moves for `patience`.
    ///
    /// # Errors
    /// The link cannot send to the device.
    pub fn connect(&self, patience: Duration) -> Result<Connection> {
        Ok(Connection::new(self, patience)?)
    }

    /// Sets the encoder up and returns its stream from the first byte after its answer on.
    ///
    /// # Errors
    /// The encoder does not answer, or refuses; the message gives the reason.
    pub fn set_up(self, wish: &Wish<'_>) -> Result<Source> {
        let name = self.name();
        let mut connection = self.connect(mcu_link::PATIENCE)?;
        let setup = Setup::new(&wish.config, 0);
        let sensor = wish.config.window.sensor;
        mcu_link::set_up(&mut connection, &setup)
            .and_then(|_| mcu_link::keep_out(&mut connection, sensor, wish.hot))
            .with_context(|| name)?;
        let rest = connection.incoming().take_rest();
        drop(connection);
        let link = Arc::into_inner(self.link).context("the link is still in use")?;
        let inner = link.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok(Source {
            link: Box::new(Begun {
                inner,
                rest,
                at: Some(Instant::now()),
            }),
            ..self.source
        })
    }
}

/// What an encoder shall do.
pub struct Wish<'w> {
    /// Configuration of the encoding.
    pub config: Config,
    /// Hot pixels that the encoder shall never send, as (column, row): each once, in raster order.
    pub hot: &'w [(u16, u16)],
}

/// Makes the encoder drop what it has queued, and what it has received but not yet used.
fn restart(control: &mut dyn Control) -> Result<(), LinkError> {
    control.control_out(Request::vendor_out(RESTART, 0, 0), &[])
}

fn lock(link: &Shared) -> MutexGuard<'_, Box<dyn Link>> {
    link.lock().unwrap_or_else(PoisonError::into_inner)
}

impl mcu_link::Link for Encoder {
    fn halves(&self) -> io::Result<Halves> {
        let outlet = lock(&self.link).outlet().map_err(io::Error::other)?;
        Ok(Halves {
            reader: Box::new(Reader {
                link: Arc::clone(&self.link),
                rest: Vec::new(),
                used: 0,
            }),
            writer: Box::new(Writer(outlet)),
        })
    }
}

/// Reads from the encoder.
struct Reader {
    link: Shared,
    /// Bytes of the last transfer, of which `used` are consumed.
    rest: Vec<u8>,
    used: usize,
}

impl Read for Reader {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.used == self.rest.len() {
            self.rest.clear();
            self.used = 0;
            match lock(&self.link).receive(WAIT).map_err(io::Error::other)? {
                Received::Bytes { bytes, .. } => self.rest.extend_from_slice(bytes),
                Received::Ended => return Ok(0),
                // A loss shows in the sequence numbers of frames and packets.
                Received::Nothing | Received::Lost { .. } => {
                    return Err(ErrorKind::WouldBlock.into());
                }
            }
        }
        let left = self.rest.get(self.used..).unwrap_or(&[]);
        let len = left.len().min(out.len());
        out[..len].copy_from_slice(&left[..len]);
        self.used += len;
        Ok(len)
    }
}

/// Writes to the encoder.
struct Writer(Box<dyn Outlet>);

impl Write for Writer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = bytes.get(..PIECE).unwrap_or(bytes);
        self.0.send(piece).map_err(io::Error::other)?;
        Ok(piece.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A link that first returns bytes received before it was handed over.
struct Begun {
    inner: Box<dyn Link>,
    rest: Vec<u8>,
    /// When `rest` arrived; `None` once it has been returned.
    at: Option<Instant>,
}

impl Link for Begun {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        match self.at.take() {
            Some(at) if !self.rest.is_empty() => Ok(Received::Bytes {
                bytes: &self.rest,
                at,
            }),
            _ => self.inner.receive(timeout),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        self.inner.outlet()
    }
}

/// Placeholder for a link that is in use elsewhere.
struct Nowhere;

impl Link for Nowhere {
    fn name(&self) -> &str {
        "nowhere"
    }

    fn receive(&mut self, _: Duration) -> Result<Received<'_>, LinkError> {
        Ok(Received::Ended)
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }
}
