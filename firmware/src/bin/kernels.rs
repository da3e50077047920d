//! Counts instructions of every kernel of the accumulate stage on the pixels of a cut, in QEMU: prints a line of
//! JSON for each kernel, transform and M. `cargo xtask kernels` builds and runs this.
//!
//! The cut is the file `cut.words` in the folder in which QEMU runs, read over semihosting;
//! `crates/eecvs-bench/src/kernel_image.rs` writes it and describes its content. What is counted is what the host
//! times: every pixel, from its impulses, oldest first, to sums in memory. The impulses are where a window has
//! them, in lists of slots. The pixels come in two parts, those with few events and the crowded ones, which are
//! counted one after the other.
//!
//! A second pass computes a checksum of all sums, which are the same as the host's bit by bit, also those in f32.
//! These are instructions, not cycles: there are no flash wait states and no pipeline.
#![no_std]
#![no_main]

use core::arch::asm;
use core::hint::black_box;

use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::{hprintln, nr, syscall};
use eecvs_firmware as _;
use eecvs_nostd::Slot;
use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::lists::{LaidOut, Lists};
use eecvs_nostd::group::{Impulse, Impulses};
use eecvs_nostd::kernel::{
    Accumulate, Haar, Libm, Micromath, Precise, PreciseSum, Recurrence, Table,
};
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft, Dwt};
use heapless::Vec;
use static_cell::ConstStaticCell;

/// Most events, and so most pixels, of a cut.
const EVENTS: usize = 8192;
/// Most windows of a cut, each in two parts.
const WINDOWS: usize = 128;
/// Values of M that are measured.
const M: [u8; 4] = [8, 16, 24, 64];
/// 2K of the largest K.
const NUMBERS: usize = 256;
/// Sums of a pixel with several chunks.
type Totals = [u64; NUMBERS];
/// Ends with the 0 that semihosting expects.
const FILE: &[u8] = b"cut.words\0";

static CUT: ConstStaticCell<Cut> = ConstStaticCell::new(Cut::EMPTY);
static SLOTS: ConstStaticCell<[Slot; EVENTS]> = ConstStaticCell::new([Slot::EMPTY; EVENTS]);
static TOTALS: ConstStaticCell<Totals> = ConstStaticCell::new([0; NUMBERS]);

/// One part of a window's pixels.
#[derive(Clone, Copy)]
struct Window {
    scale: PhaseScale,
    pixels: usize,
}

/// A cut in memory.
struct Cut {
    windows: Vec<Window, WINDOWS>,
    /// Events of each pixel.
    lengths: Vec<u16, EVENTS>,
    /// Number of windows, pixels and events in the first part.
    few: [usize; 3],
}

/// Some pixels of a cut.
#[derive(Clone, Copy)]
struct Part<'c> {
    windows: &'c [Window],
    lengths: &'c [u16],
    lists: LaidOut<'c>,
    /// Number of impulses before them.
    first: usize,
}

impl Cut {
    const EMPTY: Self = Self {
        windows: Vec::new(),
        lengths: Vec::new(),
        few: [0; 3],
    };

    /// Reads the file; `None` if it is missing, is not a cut, or does not fit.
    fn read(&mut self, lists: &mut Lists<'_>) -> Option<()> {
        let mut impulses = 0;
        let mut input = Input::open()?;
        for part in 0..2 {
            for _ in 0..input.word()? {
                let scale = PhaseScale::new(input.word()?);
                let pixels = input.word()? as usize;
                self.windows.push(Window { scale, pixels }).ok()?;
                for _ in 0..pixels {
                    let events = input.word()?;
                    self.lengths.push(u16::try_from(events).ok()?).ok()?;
                    let words = core::iter::from_fn(|| input.word());
                    let first = lists.push(words.take(events as usize).map(|word| Impulse {
                        offset_us: word >> 1,
                        is_on: word % 2 == 1,
                    }))?;
                    // Differs after a list that was short of words.
                    (first == impulses).then_some(())?;
                    impulses += events as usize;
                }
            }
            if part == 0 {
                self.few = [self.windows.len(), self.lengths.len(), impulses];
            }
        }
        (lists.push([])? == impulses).then_some(())
    }

    /// Returns the pixels with few events, and the crowded ones.
    fn parts<'c>(&'c self, lists: LaidOut<'c>) -> [Part<'c>; 2] {
        let [windows, pixels, first] = self.few;
        let windows = self.windows.split_at(windows);
        let lengths = self.lengths.split_at(pixels);
        let part = |windows, lengths, first| Part {
            windows,
            lengths,
            lists,
            first,
        };
        [
            part(windows.0, lengths.0, 0),
            part(windows.1, lengths.1, first),
        ]
    }
}

/// Reads words of the host's file.
struct Input {
    handle: usize,
    buffer: [u8; Self::BYTES],
    at: usize,
    end: usize,
}

impl Input {
    const BYTES: usize = 1024;

    fn open() -> Option<Self> {
        // SAFETY: SYS_OPEN reads a name of that many bytes, which ends with a 0.
        let handle = unsafe { syscall!(OPEN, FILE.as_ptr(), nr::open::R_BINARY, FILE.len() - 1) };
        (handle != usize::MAX).then_some(Self {
            handle,
            buffer: [0; Self::BYTES],
            at: 0,
            end: 0,
        })
    }

    fn word(&mut self) -> Option<u32> {
        if self.at == self.end {
            // SAFETY: SYS_READ writes at most that many bytes, which the buffer has.
            let left =
                unsafe { syscall!(READ, self.handle, self.buffer.as_mut_ptr(), Self::BYTES) };
            self.at = 0;
            self.end = Self::BYTES.checked_sub(left)?;
        }
        let word = self.buffer.get(self.at..self.end)?.first_chunk()?;
        self.at += word.len();
        Some(u32::from_le_bytes(*word))
    }
}

/// A sum of a kernel.
trait Number: Copy + Default {
    /// Returns its bits; a shorter type fills the lower ones.
    fn bits(self) -> u64;

    /// Adds the sum to the bits of a pixel's total.
    fn add_to(self, total: &mut u64);
}

impl Number for Sum {
    fn bits(self) -> u64 {
        u64::from(self.to_bits() as u32)
    }

    #[inline(always)]
    fn add_to(self, total: &mut u64) {
        *total = total.wrapping_add(i64::from(self.to_bits()) as u64);
    }
}

impl Number for PreciseSum {
    fn bits(self) -> u64 {
        self.to_bits() as u64
    }

    #[inline(always)]
    fn add_to(self, total: &mut u64) {
        *total = total.wrapping_add(self.to_bits() as u64);
    }
}

impl Number for f32 {
    fn bits(self) -> u64 {
        u64::from(self.to_bits())
    }

    #[inline(always)]
    fn add_to(self, total: &mut u64) {
        *total = u64::from((f32::from_bits(*total as u32) + self).to_bits());
    }
}

/// Receives the sums of every chunk.
trait Listen<S> {
    fn chunk(&mut self, sums: &[S]);
}

/// Ignores the sums.
impl<S> Listen<S> for () {
    #[inline(always)]
    fn chunk(&mut self, _: &[S]) {}
}

/// Computes a checksum of the sums of k = 1 to K - 1.
struct Checksum {
    value: u32,
    grid: usize,
    /// Number of sums that are coefficients: K, or 2K for a complex transform.
    values: usize,
}

impl<S: Number> Listen<S> for Checksum {
    fn chunk(&mut self, sums: &[S]) {
        let sums = sums.get(..self.values).unwrap_or_default();
        for part in sums.chunks(self.grid) {
            for sum in part.iter().skip(1) {
                let bits = sum.bits();
                for word in [bits as u32, (bits >> 32) as u32] {
                    self.value = (self.value.rotate_left(5) ^ word).wrapping_mul(0x9e37_79b1);
                }
            }
        }
    }
}

/// A kernel with its memory.
struct Core<A: Accumulate<B>, B: Basis> {
    grid: usize,
    work: A::Work,
    /// Sums of a chunk.
    sums: [A::Sum; NUMBERS],
}

impl<A: Accumulate<B>, B: Basis> Core<A, B>
where
    A::Sum: Number,
{
    fn new() -> Self {
        Self {
            grid: 0,
            work: A::Work::default(),
            sums: [A::Sum::default(); NUMBERS],
        }
    }

    /// Accumulates a pixel of at most one chunk into `sums`. Not inlined, so that the code that is counted is the
    /// code that is checked.
    #[inline(never)]
    fn whole(&mut self, impulses: &Impulses<'_>, scale: &PhaseScale) {
        A::accumulate_list(impulses, *scale, self.grid, &mut self.work, &mut self.sums);
    }

    /// Accumulates a chunk of a larger pixel; returns the other events if the kernel has them at hand.
    #[inline(never)]
    fn chunk<'l>(&mut self, impulses: &Impulses<'l>, scale: &PhaseScale) -> Option<Impulses<'l>> {
        A::accumulate_list(impulses, *scale, self.grid, &mut self.work, &mut self.sums)
    }

    /// Accumulates every pixel of a part: into `sums`, or into `totals` if it has several chunks.
    #[inline(never)]
    fn pass(&mut self, part: Part<'_>, totals: &mut Totals, listener: &mut impl Listen<A::Sum>) {
        let (mut lengths, mut first) = (part.lengths, part.first);
        for window in part.windows {
            let pixels;
            (pixels, lengths) = lengths.split_at(window.pixels);
            for events in pixels {
                let pixel = part.lists.impulses(first);
                first += usize::from(*events);
                if usize::from(*events) <= CHUNK_EVENTS {
                    self.whole(&pixel, &window.scale);
                    listener.chunk(&self.sums);
                } else {
                    self.several(pixel, &window.scale, totals, listener);
                }
                black_box(&self.sums);
            }
        }
    }

    /// Accumulates a pixel with several chunks. Separate, so that the few such pixels do not weigh on the many.
    #[cold]
    #[inline(never)]
    fn several(
        &mut self,
        mut pixel: Impulses<'_>,
        scale: &PhaseScale,
        totals: &mut Totals,
        listener: &mut impl Listen<A::Sum>,
    ) {
        let totals = totals.get_mut(..B::values(self.grid)).unwrap_or_default();
        totals.fill(0);
        while !pixel.is_empty() {
            let rest = self.chunk(&pixel, scale);
            listener.chunk(&self.sums);
            for (total, sum) in totals.iter_mut().zip(&self.sums) {
                sum.add_to(total);
            }
            pixel = rest.unwrap_or_else(|| {
                let _ = pixel.nth(CHUNK_EVENTS - 1);
                pixel
            });
        }
        black_box(totals);
    }
}

/// What is counted, and the counter.
struct Bench<'b> {
    counter: counter::Counter,
    parts: [Part<'b>; 2],
    totals: &'b mut Totals,
}

impl Bench<'_> {
    /// Measures a kernel at every M; `None` if the counter cannot hold a count.
    #[inline(never)]
    fn measure<A: Accumulate<B>, B: Basis>(&mut self) -> Option<()>
    where
        A::Sum: Number,
    {
        let mut core = Core::<A, B>::new();
        for m in M {
            // Hide K from the compiler here, as the encoder does not know it either.
            core.grid = black_box(usize::from(B::TRANSFORM.grid_size(m, None)));
            let mut counts = [0; 2];
            for (part, count) in self.parts.into_iter().zip(&mut counts) {
                *count = self
                    .counter
                    .count(|| core.pass(part, self.totals, &mut ()))?;
            }
            let mut checksum = Checksum {
                value: 0,
                grid: core.grid,
                values: B::values(core.grid),
            };
            for part in self.parts {
                core.pass(part, self.totals, &mut checksum);
            }
            let [few, crowded] = counts;
            hprintln!(
                "{{\"kernel\":\"{}\",\"transform\":\"{}\",\"m\":{m},\"few\":{few},\
                 \"crowded\":{crowded},\"check\":{}}}",
                A::KERNEL.name(),
                B::TRANSFORM.name(),
                checksum.value
            );
        }
        Some(())
    }

    fn measure_all(&mut self) -> Option<()> {
        self.measure::<Table, Dct>()?;
        self.measure::<Recurrence, Dct>()?;
        self.measure::<Precise, Dct>()?;
        self.measure::<Micromath, Dct>()?;
        self.measure::<Libm, Dct>()?;
        self.measure::<Table, Dtft>()?;
        self.measure::<Recurrence, Dtft>()?;
        self.measure::<Precise, Dtft>()?;
        self.measure::<Micromath, Dtft>()?;
        self.measure::<Libm, Dtft>()?;
        self.measure::<Haar, Dwt>()
    }
}

/// With QEMU's `-icount shift=0` an instruction takes one nanosecond of virtual time, and its TIM2 runs at 1 GHz.
#[cfg(feature = "stm32f405")]
mod counter {
    use stm32f4::stm32f405::{Peripherals, TIM2};

    /// Counts instructions with the timer TIM2.
    pub struct Counter(TIM2);

    impl Counter {
        /// Starts the counter; returns `None` on a second call.
        pub fn new() -> Option<Self> {
            let peripherals = Peripherals::take()?;
            peripherals
                .RCC
                .apb1enr()
                .modify(|_, w| w.tim2en().enabled());
            peripherals.TIM2.cr1().modify(|_, w| w.cen().enabled());
            Some(Self(peripherals.TIM2))
        }

        /// Returns the instructions of `run`, which have to be below 2^32.
        pub fn count(&mut self, run: impl FnOnce()) -> Option<u32> {
            let before = self.0.cnt().read().bits();
            run();
            Some(self.0.cnt().read().bits().wrapping_sub(before))
        }
    }
}

/// With QEMU's `-icount shift=0` an instruction takes one nanosecond of virtual time, and the SysTick timer of this
/// machine runs at 25 MHz: a tick is 40 instructions.
#[cfg(feature = "mps2")]
mod counter {
    use cortex_m::Peripherals;
    use cortex_m::peripheral::SYST;
    use cortex_m::peripheral::syst::SystClkSource;

    const TICK: u32 = 40;
    const TICKS: u32 = 1 << 24;

    /// Counts instructions with the SysTick timer, to a tick.
    pub struct Counter(SYST);

    impl Counter {
        /// Starts the counter; returns `None` on a second call.
        pub fn new() -> Option<Self> {
            let mut timer = Peripherals::take()?.SYST;
            timer.set_clock_source(SystClkSource::Core);
            timer.set_reload(TICKS - 1);
            timer.clear_current();
            timer.enable_counter();
            Some(Self(timer))
        }

        /// Returns the instructions of `run`; `None` if they take 2^24 ticks or more.
        pub fn count(&mut self, run: impl FnOnce()) -> Option<u32> {
            self.0.clear_current();
            // The timer reloads at the next tick.
            while SYST::get_current() == 0 {}
            let before = SYST::get_current();
            run();
            let after = SYST::get_current();
            (!self.0.has_wrapped()).then(|| before.wrapping_sub(after) * TICK)
        }
    }
}

/// Counts a loop with a known number of instructions: 2 * 100,000.
fn known_loop(counter: &mut counter::Counter) -> Option<u32> {
    counter.count(|| {
        let turns = 100_000;
        // SAFETY: this counts a register down and touches nothing else.
        unsafe {
            asm!("2:", "subs {0}, #1", "bne 2b", inout(reg) turns => _, options(nomem, nostack));
        }
    })
}

fn run() -> Option<()> {
    let mut counter = counter::Counter::new()?;
    let counted = known_loop(&mut counter)?;
    if !(199_900..200_100).contains(&counted) {
        hprintln!(
            "the timer counted {counted} for 200,000 instructions: does QEMU run with -icount shift=0?"
        );
        return None;
    }
    let cut = CUT.take();
    let mut lists = Lists::new(SLOTS.take());
    if cut.read(&mut lists).is_none() {
        hprintln!("cut.words: the file is missing, or does not hold a cut that fits in memory");
        return None;
    }
    let mut bench = Bench {
        counter,
        parts: cut.parts(lists.laid_out()),
        totals: TOTALS.take(),
    };
    bench.measure_all()
}

#[entry]
fn main() -> ! {
    let status = match run() {
        Some(()) => EXIT_SUCCESS,
        None => EXIT_FAILURE,
    };
    debug::exit(status);
    loop {
        cortex_m::asm::wfi();
    }
}
