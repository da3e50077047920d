//! Traces a link as USB transfers, into a pcapng file that Wireshark can open.
//!
//! The link type is `USB_LINUX_MMAPPED` (220): a 64-byte header as written by the kernel's usbmon, in this
//! machine's byte order like the rest of the file, followed by the data.

use std::borrow::Cow;
use std::io::Write;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketBlock;
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::{DataLink, PcapError};

use super::control::{Control, Request};
use super::{Link, LinkError, Loss, Outlet, Received};

const HEADER: usize = 64;
const CONTROL: u8 = 2;
const BULK: u8 = 3;

/// Linux error codes that a transfer's status field holds.
const EPIPE: i32 = -32;
const EPROTO: i32 = -71;
const EOVERFLOW: i32 = -75;
const ESHUTDOWN: i32 = -108;

/// Bus address under which the transfers are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Bus number.
    pub bus: u16,
    /// Device address.
    pub address: u8,
    /// Endpoint of the stream, with the direction bit.
    pub endpoint: u8,
}

/// A trace file that links and control sides write to; clones share it.
#[derive(Clone)]
pub struct Tracer {
    shared: Arc<Mutex<Shared>>,
    place: Place,
}

struct Shared {
    writer: PcapNgWriter<Box<dyn Write + Send>>,
    started: (Instant, Duration),
    next: u64,
    /// The first write error: nothing is written after it, while the links keep running.
    failed: Option<PcapError>,
}

/// One event of usbmon.
struct Packet<'p> {
    /// `S` for submission, `C` for completion.
    event: u8,
    id: u64,
    kind: u8,
    endpoint: u8,
    at: Instant,
    status: i32,
    length: usize,
    setup: Option<[u8; 8]>,
    /// `None` if the data belong to the other event of the transfer.
    data: Option<&'p [u8]>,
}

impl Tracer {
    /// Begins a trace in `out`, which should be buffered; `name` is the interface name in the file.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn new(out: Box<dyn Write + Send>, place: Place, name: &str) -> Result<Self, PcapError> {
        let mut writer = PcapNgWriter::new(out)?;
        writer.write_pcapng_block(InterfaceDescriptionBlock {
            linktype: DataLink::USB_LINUX_MMAPPED,
            snaplen: 0,
            options: vec![
                InterfaceDescriptionOption::IfName(Cow::Borrowed(name)),
                // Timestamps in nanoseconds (10^-9 s).
                InterfaceDescriptionOption::IfTsResol(9),
            ],
        })?;
        let unix = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Ok(Self {
            shared: Arc::new(Mutex::new(Shared {
                writer,
                started: (Instant::now(), unix),
                next: 1,
                failed: None,
            })),
            place,
        })
    }

    /// Wraps a link so that its transfers are traced.
    pub fn link<L: Link>(&self, inner: L) -> Trace<L> {
        Trace {
            inner,
            tracer: self.clone(),
        }
    }

    /// Wraps a control side so that its requests are traced.
    pub fn control<C: Control>(&self, inner: C) -> TraceControl<C> {
        TraceControl {
            inner,
            tracer: self.clone(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the trace and flushes `out`.
    ///
    /// # Errors
    /// The first write error, now or earlier.
    pub fn finish(&self) -> Result<(), PcapError> {
        let mut shared = self.lock();
        match shared.failed.take() {
            Some(error) => Err(error),
            None => shared.writer.get_mut().flush().map_err(PcapError::IoError),
        }
    }

    /// Sends bytes to the device with `send`, and traces the transfer.
    fn sending(
        &self,
        bytes: &[u8],
        send: impl FnOnce() -> Result<(), LinkError>,
    ) -> Result<(), LinkError> {
        let asked = Instant::now();
        let sent = send();
        let status = if sent.is_ok() { 0 } else { ESHUTDOWN };
        let endpoint = self.place.endpoint & 0x7F;
        let times = (asked, Instant::now());
        self.transfer((BULK, endpoint), times, None, (bytes.len(), status), bytes);
        sent
    }

    /// Writes a transfer, submitted at `asked` and completed at `ended`.
    fn transfer(
        &self,
        (kind, endpoint): (u8, u8),
        (asked, ended): (Instant, Instant),
        setup: Option<[u8; 8]>,
        (length, status): (usize, i32),
        data: &[u8],
    ) {
        let mut shared = self.lock();
        let id = shared.next;
        shared.next += 1;
        let into = endpoint & 0x80 != 0;
        let (event, at) = (b'S', asked.min(ended));
        shared.write(
            self.place,
            &Packet {
                event,
                id,
                kind,
                endpoint,
                at,
                // -EINPROGRESS.
                status: -115,
                length,
                setup,
                data: (!into).then_some(data),
            },
        );
        shared.write(
            self.place,
            &Packet {
                event: b'C',
                id,
                kind,
                endpoint,
                at: ended,
                status,
                length: data.len(),
                setup: None,
                data: into.then_some(data),
            },
        );
    }
}

impl Shared {
    fn write(&mut self, place: Place, packet: &Packet<'_>) {
        if self.failed.is_some() {
            return;
        }
        let (started, unix) = self.started;
        let time = packet.at.checked_duration_since(started).map_or_else(
            || unix - (started - packet.at).min(unix),
            |since| unix + since,
        );
        let data = packet.data.unwrap_or_default();
        let mut bytes = Vec::with_capacity(HEADER + data.len());
        bytes.extend(packet.id.to_ne_bytes());
        bytes.extend([packet.event, packet.kind, packet.endpoint, place.address]);
        bytes.extend(place.bus.to_ne_bytes());
        bytes.push(if packet.setup.is_some() { 0 } else { b'-' });
        bytes.push(match packet.data {
            Some(data) if !data.is_empty() => 0,
            _ if packet.endpoint & 0x80 != 0 => b'<',
            _ => b'>',
        });
        bytes.extend((time.as_secs() as i64).to_ne_bytes());
        bytes.extend((time.subsec_micros() as i32).to_ne_bytes());
        bytes.extend(packet.status.to_ne_bytes());
        bytes.extend((packet.length as u32).to_ne_bytes());
        bytes.extend((data.len() as u32).to_ne_bytes());
        bytes.extend(packet.setup.unwrap_or_default());
        // Interval, start frame, flags and number of descriptors apply to interrupt and isochronous transfers only.
        bytes.extend([0; 16]);
        debug_assert_eq!(bytes.len(), HEADER);
        bytes.extend(data);
        let written = self.writer.write_pcapng_block(EnhancedPacketBlock {
            interface_id: 0,
            timestamp: time,
            original_len: bytes.len() as u32,
            data: Cow::Owned(bytes),
            options: Vec::new(),
        });
        self.failed = written.err();
    }
}

/// A link that is traced.
pub struct Trace<L> {
    inner: L,
    tracer: Tracer,
}

impl<L: Link> Link for Trace<L> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let asked = Instant::now();
        let stream = (BULK, self.tracer.place.endpoint);
        let received = self.inner.receive(timeout);
        let now = Instant::now();
        let ended = |status: i32, data: &[u8], at: Instant| {
            let length = (data.len(), status);
            self.tracer
                .transfer(stream, (asked, at), None, length, data);
        };
        match &received {
            Ok(Received::Bytes { bytes, at }) => ended(0, bytes, *at),
            Ok(Received::Lost { cause, .. }) => {
                let status = match cause {
                    Loss::Overflow => EOVERFLOW,
                    Loss::Stalled => EPIPE,
                    Loss::Damaged | Loss::Injected => EPROTO,
                };
                ended(status, &[], now);
            }
            Ok(Received::Nothing | Received::Ended) => {}
            Err(LinkError::Stalled { .. }) => ended(EPIPE, &[], now),
            Err(_) => ended(ESHUTDOWN, &[], now),
        }
        received
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.tracer.sending(bytes, || self.inner.send(bytes))
    }

    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        Ok(Box::new(TraceOutlet {
            inner: self.inner.outlet()?,
            tracer: self.tracer.clone(),
        }))
    }
}

/// The sending side of a link, traced.
struct TraceOutlet {
    inner: Box<dyn Outlet>,
    tracer: Tracer,
}

impl Outlet for TraceOutlet {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.tracer.sending(bytes, || self.inner.send(bytes))
    }
}

/// A control side that is traced.
pub struct TraceControl<C> {
    inner: C,
    tracer: Tracer,
}

fn setup(request: Request, length: usize) -> [u8; 8] {
    let mut setup = [0; 8];
    (setup[0], setup[1]) = (request.kind, request.request);
    setup[2..4].copy_from_slice(&request.value.to_le_bytes());
    setup[4..6].copy_from_slice(&request.index.to_le_bytes());
    let length = u16::try_from(length).unwrap_or(u16::MAX);
    setup[6..].copy_from_slice(&length.to_le_bytes());
    setup
}

fn status<T>(result: &Result<T, LinkError>) -> i32 {
    match result {
        Ok(_) => 0,
        Err(LinkError::Unplugged { .. }) => ESHUTDOWN,
        Err(_) => EPIPE,
    }
}

impl<C: Control> TraceControl<C> {
    fn note<T>(
        &self,
        (kind, endpoint): (u8, u8),
        asked: Instant,
        setup: Option<[u8; 8]>,
        result: &Result<T, LinkError>,
        (length, data): (usize, &[u8]),
    ) {
        let times = (asked, Instant::now());
        let ended = (length, status(result));
        self.tracer
            .transfer((kind, endpoint), times, setup, ended, data);
    }
}

impl<C: Control> Control for TraceControl<C> {
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError> {
        let asked = Instant::now();
        let result = self.inner.control_out(request, data);
        let setup = Some(setup(request, data.len()));
        self.note((CONTROL, 0), asked, setup, &result, (data.len(), data));
        result
    }

    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        let asked = Instant::now();
        let result = self.inner.control_in(request, data);
        let got = *result.as_ref().unwrap_or(&0);
        let setup = Some(setup(request, data.len()));
        let answer = (data.len(), &data[..got.min(data.len())]);
        self.note((CONTROL, 0x80), asked, setup, &result, answer);
        result
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError> {
        let asked = Instant::now();
        let result = self.inner.bulk_out(endpoint, data);
        self.note((BULK, endpoint), asked, None, &result, (data.len(), data));
        result
    }

    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError> {
        let asked = Instant::now();
        let result = self.inner.bulk_in(endpoint, data);
        let got = *result.as_ref().unwrap_or(&0);
        let answer = (data.len(), &data[..got.min(data.len())]);
        self.note((BULK, endpoint), asked, None, &result, answer);
        result
    }

    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError> {
        let asked = Instant::now();
        let result = self.inner.clear_halt(endpoint);
        // The standard request CLEAR_FEATURE(ENDPOINT_HALT).
        let request = Request {
            kind: 0x02,
            request: 1,
            value: 0,
            index: endpoint.into(),
        };
        let setup = Some(setup(request, 0));
        self.note((CONTROL, 0), asked, setup, &result, (0, &[]));
        result
    }

    fn wait(&mut self, duration: Duration) {
        self.inner.wait(duration);
    }

    fn release(&self) -> u16 {
        self.inner.release()
    }

    fn serial(&mut self) -> Option<String> {
        self.inner.serial()
    }

    fn name(&self) -> &str {
        self.inner.name()
    }
}
