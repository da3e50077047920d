//! An encoder at the other end of the event link, in a thread: what the firmware does, and what a
//! broken one might.

use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::thread;

use eecvs::encode::HostStorage;
use eecvs_nostd::coder::dense;
use eecvs_nostd::event_link::{
    FIELDS_BYTES_MAX, HotNumbers, Kind, PACKET_BYTES_MAX, Packet, Receiver, Refusal, Setup, Status,
};
use eecvs_nostd::evt2::{Evt2Decoder, Word};
use eecvs_nostd::{Encoder, Push};

/// What goes wrong, at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    None,
    /// A bit of this frame turns over on the way.
    FlipBit(u32),
    /// The encoder itself makes another frame: a well-formed one with an event less.
    SkipEvent(u32),
    /// This frame is lost.
    LoseFrame(u32),
    /// This frame comes twice.
    RepeatFrame(u32),
    /// Bytes of no frame come before this one.
    Garbage(u32),
    /// Every frame comes, but the status counts one more.
    Miscount,
    /// Counts in the status run since the start, and the setup is answered twice.
    AnswerTwice,
    /// After this frame the encoder restarts.
    Restart(u32),
    /// After this frame it says nothing more.
    Stall(u32),
    /// After this frame it closes the link.
    Close(u32),
    /// The status has another layout.
    Status,
    /// The sensor is too large.
    Refuse,
    /// There is no memory for the second hot pixel.
    RefuseHot,
    /// It holds no window.
    NoWindow,
}

#[derive(Debug, Clone, Copy)]
pub struct Behaviour {
    pub window_events: u32,
    pub frame_bytes: u32,
    /// Setups that are lost, as by a UART that is not ready.
    pub deaf_to: u32,
    /// Of ten packets of words, those that a full encoder drops where it may not wait.
    pub full_for: u32,
    pub fault: Fault,
}

impl Behaviour {
    pub const GOOD: Self = Self {
        window_events: 700,
        frame_bytes: 800,
        deaf_to: 0,
        full_for: 3,
        fault: Fault::None,
    };
}

/// A peer that takes connections, one after the other.
pub struct Peer {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

impl Peer {
    pub fn start(behaviour: Behaviour) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("uart");
        let listener = UnixListener::bind(&path).expect("a socket");
        // Ends with the test's process.
        thread::spawn(move || {
            let mut board = Board {
                listener,
                stream: None,
                received: Vec::new(),
                taken: 0,
                receiver: Receiver::new(),
                behaviour,
                status: Status::default(),
            };
            let mut setup = None;
            loop {
                setup = match setup {
                    None => board.wait_for_setup(),
                    Some(setup) => board.encode(setup),
                };
            }
        });
        Self {
            _folder: folder,
            path,
        }
    }

    pub fn connect(&self) -> UnixStream {
        UnixStream::connect(&self.path).expect("the peer listens")
    }
}

struct Board {
    listener: UnixListener,
    stream: Option<UnixStream>,
    received: Vec<u8>,
    taken: usize,
    /// Outlives connections: a UART does not notice them.
    receiver: Receiver,
    behaviour: Behaviour,
    status: Status,
}

impl Board {
    /// The next packet of this connection or a later one.
    fn packet(&mut self) -> (Kind, u32, Vec<u8>) {
        loop {
            while let Some(byte) = self.received.get(self.taken) {
                self.taken += 1;
                if let Some(packet) = self.receiver.push(*byte) {
                    return (packet.kind, packet.position, packet.body.to_vec());
                }
            }
            self.status.damaged_bytes = self.receiver.damaged_bytes();
            self.received.resize(4096, 0);
            self.taken = 0;
            let stream = self.stream.get_or_insert_with(|| {
                let (stream, _) = self.listener.accept().expect("a connection");
                stream
            });
            let read = stream.read(&mut self.received).unwrap_or(0);
            self.received.truncate(read);
            if read == 0 {
                self.stream = None;
            }
        }
    }

    /// What is sent without a connection is lost.
    fn send(&mut self, bytes: &[u8]) {
        if let Some(stream) = &mut self.stream {
            let _ = stream.write_all(bytes);
        }
    }

    fn answer(&mut self, kind: Option<Kind>, running: bool) {
        let mut status = self.status;
        status.answers = kind.map_or(0, |kind| kind as u8);
        status.running = running;
        status.damaged_bytes = self.receiver.damaged_bytes();
        status.window_events = match self.behaviour.fault {
            Fault::NoWindow => 0,
            _ => self.behaviour.window_events,
        };
        status.frame_bytes = self.behaviour.frame_bytes;
        status.frames +=
            u32::from(self.behaviour.fault == Fault::Miscount && kind == Some(Kind::Flush));
        let mut body = [0; FIELDS_BYTES_MAX];
        let mut length = status.write(&mut body).expect("a short status");
        length -= usize::from(self.behaviour.fault == Fault::Status);
        let mut bytes = [0; PACKET_BYTES_MAX];
        let packet = Packet {
            kind: Kind::Status,
            position: 0,
            body: &body[..length],
        };
        let length = packet.write(&mut bytes).expect("a short packet");
        self.send(&bytes[..length]);
    }

    fn wait_for_setup(&mut self) -> Option<Setup> {
        loop {
            if let (Kind::Setup, _, body) = self.packet() {
                if self.behaviour.deaf_to > 0 {
                    self.behaviour.deaf_to -= 1;
                    continue;
                }
                return Setup::parse(&body);
            }
        }
    }

    /// Encodes until the next setup, which it returns.
    fn encode(&mut self, setup: Setup) -> Option<Setup> {
        let config = setup.config().expect("a setup that the host sends");
        let mut storage =
            HostStorage::new(config.window.sensor, self.behaviour.window_events as usize);
        let mut encoder = storage.encoder(config).expect("a setup that can run");
        let mut out = vec![0; self.behaviour.frame_bytes as usize];
        let mut words = Evt2Decoder::new(setup.time_base_us);
        let refused = self.behaviour.fault == Fault::Refuse;
        if self.behaviour.fault == Fault::AnswerTwice {
            self.answer(Some(Kind::Setup), true);
        } else {
            self.status = Status::default();
        }
        self.status.dense_words = dense::words(config.window.sensor, true) as u32;
        self.status.refusal = refused.then_some(Refusal::Windows);
        self.answer(Some(Kind::Setup), !refused);
        let mut hot = Vec::new();
        let (mut events, mut packets) = (0_u32, 0_u32);
        loop {
            let (kind, position, body) = self.packet();
            if kind == Kind::Setup {
                return Setup::parse(&body);
            }
            let lost = position.wrapping_sub(events);
            events = position;
            self.status.lost += lost;
            encoder.window().count_dropped(lost);
            if kind == Kind::Hot {
                let mut numbers = HotNumbers::START;
                let sensor = config.window.sensor;
                let read = std::iter::from_fn(|| numbers.read(&body));
                hot.extend(read.map(|number| sensor.pixel(number).expect("on the sensor")));
                if self.behaviour.fault == Fault::RefuseHot {
                    hot.truncate(1);
                    self.status.refusal = Some(Refusal::HotRoom);
                }
                encoder = storage
                    .encoder_without(config, &hot)
                    .expect("a setup that can run");
                self.status.hot_pixels = hot.len() as u32;
                self.answer(Some(Kind::Hot), true);
            }
            if kind == Kind::Flush {
                encoder.flush();
                self.frames(&mut encoder, &mut out)?;
                self.answer(Some(Kind::Flush), true);
            }
            if kind != Kind::Words {
                continue;
            }
            packets += 1;
            let full = setup.when_full == Setup::DROP && packets % 10 < self.behaviour.full_for;
            for word in body.as_chunks().0 {
                let Word::Event(event) = words.decode(u32::from_le_bytes(*word)) else {
                    continue;
                };
                events = events.wrapping_add(1);
                self.status.events += 1;
                if full {
                    encoder.window().count_dropped(1);
                    self.status.dropped += 1;
                    continue;
                }
                if self.behaviour.fault == Fault::SkipEvent(self.status.events) {
                    continue;
                }
                while encoder.push(event) == Push::Closed {
                    self.frames(&mut encoder, &mut out)?;
                }
            }
        }
    }

    /// Sends the frames of the closed window; `None` where the encoder has ended.
    fn frames(&mut self, encoder: &mut Encoder<'_>, out: &mut [u8]) -> Option<()> {
        while let Some(frame) = encoder.next_frame(out).expect("room for a frame") {
            let number = frame.header.sequence;
            let bytes = &mut out[frame.range];
            self.status.frames += 1;
            self.status.windows += u32::from(frame.header.last);
            self.status.encode_ns += u64::from(frame.header.events) * 400;
            match self.behaviour.fault {
                Fault::FlipBit(at) if at == number => bytes[bytes.len() / 2] ^= 4,
                Fault::LoseFrame(at) if at == number => continue,
                Fault::RepeatFrame(at) if at == number => self.send(bytes),
                Fault::Garbage(at) if at == number => self.send(b"no frame \xEE\xC5\xEE"),
                _ => {}
            }
            self.send(bytes);
            match self.behaviour.fault {
                Fault::Restart(at) if at == number => {
                    self.answer(None, false);
                    return None;
                }
                Fault::Stall(at) if at == number => loop {
                    thread::park();
                },
                Fault::Close(at) if at == number => {
                    self.stream = None;
                    return None;
                }
                _ => {}
            }
        }
        Some(())
    }
}
