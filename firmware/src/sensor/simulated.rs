//! A sensor and its transfer in QEMU, on an MPS2 board: words are played at the times of their events.
//!
//! A timer's interrupt stands for that of a filled block. The transfer itself is a read of the host's file `sensor.words`
//! by semihosting, straight into the block, in which no time passes, as a DMA takes none of the processor's. The file,
//! which `crates/mcu-link/src/sensor/` writes, has all numbers little-endian:
//!
//! | part | content |
//! |---|---|
//! | head | bytes of the setup that follows (32 bits), the setup as on the event link, the link's bytes per second (32 bits) |
//! | each block | when it is full, in microseconds from the start (32 bits); its words (16 bits) and events (16 bits); the words |
//!
//! As two blocks take turns in a DMA, the next one is overwritten if the interrupt has not come by the time it is full:
//! its events are lost, and counted as such.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m_semihosting::{nr, syscall};
use critical_section::Mutex;
use eecvs_nostd::event_link::{FIELDS_BYTES_MAX, Setup};
use eecvs_nostd::ingest::from_sensor::{Block, Port};

use crate::board::CLOCK_HZ;
use crate::{clock, sensor};

/// Ends with the 0 that semihosting expects.
const FILE: &[u8] = b"sensor.words\0";
/// Time from the start of the timer to that of the recording, in which the encoder is set up.
const LEAD_US: u32 = 10_000;
/// After the last block, time between two tries to hand over what is missing.
const LATER_US: u32 = 1000;
const TICKS_PER_US: u32 = CLOCK_HZ / 1_000_000;

/// Number of the timer's interrupt.
pub const INTERRUPT: i16 = 8;

#[derive(Clone, Copy)]
struct Timer;

// SAFETY: this is the number of the interrupt on the image's board.
unsafe impl cortex_m::interrupt::InterruptNumber for Timer {
    fn number(self) -> u16 {
        INTERRUPT as u16
    }
}

/// Registers of timer 0 (CMSDK APB timer), from its base address on.
const TIMER: *mut u32 = core::ptr::with_exposed_provenance_mut(0x4000_0000);
const CONTROL: usize = 0;
const VALUE: usize = 1;
const INTERRUPT_CLEAR: usize = 3;
const ENABLE: u32 = 1;
const INTERRUPT_ENABLE: u32 = 1 << 3;

fn write(register: usize, value: u32) {
    // SAFETY: this is one of the timer's four registers, which are words; only this module uses the timer.
    unsafe { TIMER.add(register).write_volatile(value) }
}

/// Whether the recording is over and all of it was handed over.
static ENDED: AtomicBool = AtomicBool::new(false);
/// Number of events in blocks that were overwritten.
static OVERRUN: AtomicU32 = AtomicU32::new(0);
/// The link's bytes per second.
static LINK: AtomicU32 = AtomicU32::new(u32::MAX);
static PLAYING: Mutex<Cell<Option<Playing>>> = Mutex::new(Cell::new(None));

/// The host's file, read from its start to its end.
#[derive(Clone, Copy)]
struct File(usize);

impl File {
    fn open() -> Option<Self> {
        // SAFETY: the call reads its name, which ends with 0.
        let handle = unsafe { syscall!(OPEN, FILE.as_ptr(), nr::open::R_BINARY, FILE.len() - 1) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Fills all of `bytes`; `None` if the file ends before.
    fn read(self, bytes: &mut [u8]) -> Option<()> {
        // SAFETY: the host writes to these bytes alone.
        let left = unsafe { syscall!(READ, self.0, bytes.as_mut_ptr(), bytes.len()) };
        (left == 0).then_some(())
    }

    fn word(self) -> Option<u32> {
        let mut word = [0; 4];
        self.read(&mut word)?;
        Some(u32::from_le_bytes(word))
    }
}

/// A block of the recording.
#[derive(Clone, Copy)]
struct Next {
    full_us: u32,
    words: usize,
    events: u32,
}

impl Next {
    fn read(file: File) -> Option<Self> {
        let full_us = file.word()?;
        let sizes = file.word()?;
        Some(Self {
            full_us,
            words: (sizes & 0xffff) as usize,
            events: sizes >> 16,
        })
    }
}

/// What the timer's interrupt goes on with.
struct Playing {
    file: File,
    port: Port<'static, 'static>,
    block: Option<Block<'static>>,
    /// The clock's ticks at the recording's start.
    start: u32,
    next: Option<Next>,
}

/// Opens the recording and returns its setup; `None` if there is none.
pub fn open() -> Option<Setup> {
    let file = File::open()?;
    let mut body = [0; FIELDS_BYTES_MAX];
    let body = body.get_mut(..file.word()? as usize)?;
    file.read(body)?;
    let setup = Setup::parse(body)?;
    LINK.store(file.word()?, Ordering::Relaxed);
    let next = Next::read(file)?;
    let (port, block) = sensor::transfer()?;
    let playing = Playing {
        file,
        port,
        block: Some(block),
        start: clock::ticks().wrapping_add(LEAD_US * TICKS_PER_US),
        next: Some(next),
    };
    playing.wait();
    critical_section::with(|token| PLAYING.borrow(token).set(Some(playing)));
    write(CONTROL, ENABLE | INTERRUPT_ENABLE);
    // SAFETY: the interrupt shares data only through queues.
    unsafe { NVIC::unmask(Timer) };
    Some(setup)
}

/// Body of the timer's interrupt.
pub fn on_timer() {
    sensor::on_transfer(|| {
        write(INTERRUPT_CLEAR, 1);
        let playing = critical_section::with(|token| PLAYING.borrow(token).take());
        let mut playing = playing?;
        let is_handed_over = playing.play();
        playing.wait();
        critical_section::with(|token| PLAYING.borrow(token).set(Some(playing)));
        is_handed_over
    });
}

impl Playing {
    /// Hands over the block that is full; returns whether there was room for it, if there is one.
    fn play(&mut self) -> Option<bool> {
        let block = self.block.take()?;
        let is_over = self.next.is_none();
        let words = match self.next {
            Some(next) => {
                let (next, words) = self.read(next, block);
                self.next = next;
                words
            }
            None => 0,
        };
        self.block = Some(self.port.exchange(block, words));
        let is_handed_over = !self.port.is_missing();
        if is_over && is_handed_over {
            ENDED.store(true, Ordering::Relaxed);
        }
        Some(is_handed_over)
    }

    /// Reads the words of a block; returns the next one, after those that were overwritten.
    fn read(&mut self, this: Next, block: &mut [[u8; 4]]) -> (Option<Next>, usize) {
        let words = this.words.min(block.len());
        let to = block.get_mut(..words).unwrap_or_default();
        let _ = self.file.read(to.as_flattened_mut());
        let mut next = Next::read(self.file);
        while let Some(late) = next.filter(|next| self.is_past(next.full_us)) {
            next = self.overwrite(late);
        }
        (next, words)
    }

    /// Counts the events of a block that was overwritten; returns the one after it.
    #[inline(never)]
    fn overwrite(&mut self, late: Next) -> Option<Next> {
        let mut words = [0; 4 * sensor::BLOCK_WORDS];
        let _ = self.file.read(words.get_mut(..4 * late.words)?);
        self.port.count_lost(late.events);
        OVERRUN.store(overrun().wrapping_add(late.events), Ordering::Relaxed);
        Next::read(self.file)
    }

    fn is_past(&self, us: u32) -> bool {
        self.ticks_until(us) < 0
    }

    /// Returns the ticks from now until a time of the recording.
    fn ticks_until(&self, us: u32) -> i32 {
        let at = self.start.wrapping_add(us.wrapping_mul(TICKS_PER_US));
        at.wrapping_sub(clock::ticks()) as i32
    }

    /// Sets the timer to the time of the next block.
    fn wait(&self) {
        let ticks = match self.next {
            Some(next) => self.ticks_until(next.full_us).max(1),
            None => (LATER_US * TICKS_PER_US) as i32,
        };
        write(VALUE, ticks as u32);
    }
}

/// Returns the number of events in blocks that were overwritten.
pub fn overrun() -> u32 {
    OVERRUN.load(Ordering::Relaxed)
}

/// Returns whether the recording is over and all of it was handed over.
pub fn ended() -> bool {
    ENDED.load(Ordering::Relaxed)
}

/// Returns the bytes per second of the link that carries the frames away.
pub fn link_bytes_per_second() -> u32 {
    LINK.load(Ordering::Relaxed).max(1)
}
