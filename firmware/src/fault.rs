//! How a panic, a fault, an exception that nothing expects, or a stack that crossed its floor ends: a board restarts, an
//! emulator exits with an error. What it was is kept in memory that a restart leaves alone, logged after it, and sent with
//! every status.

use core::arch::global_asm;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
#[cfg(not(feature = "mps2"))]
use cortex_m_rt::exception;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};
use eecvs_nostd::event_link::{self, Restart};

use crate::{board, stack};

/// What ended the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum Cause {
    /// The stack pointer left the stack.
    StackOverflow,
    /// A fault of the processor.
    HardFault,
    /// An exception or an interrupt without a handler: its number less 16, as in the processor's manual.
    Unexpected(i16),
    /// A panic, or what calls [`stop`].
    Stopped,
    /// The watchdog: half a second without progress.
    Watchdog,
}

/// What is known of the end of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub struct Record {
    /// What ended it.
    pub cause: Cause,
    /// Address of the instruction that did not end; 0 if it is not known.
    pub pc: u32,
    /// Where that function was called from; 0 if it is not known.
    pub lr: u32,
    /// The stack pointer.
    pub sp: u32,
    /// The processor's status of faults (CFSR and HFSR); 0 on cores without.
    pub status: [u32; 2],
}

/// A record as it lies in memory: its fields as words, and a sum of these.
type Kept = [u32; 9];

/// Begins a record that is there.
const MAGIC: u32 = 0xEEC5_FA17;

/// Survives a restart: the runtime leaves this section alone.
#[unsafe(link_section = ".uninit.fault")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Whether an emulator restarts, too, as a board does.
static RESTARTS: AtomicBool = AtomicBool::new(false);

// After an overflow the stack pointer is outside of RAM, and nothing may be pushed before it is reset. Hence this
// is not a Rust function, which might begin with a push.
global_asm!(
    ".syntax unified",
    ".section .HardFault.own, \"ax\"",
    ".global HardFault",
    ".type HardFault, %function",
    ".thumb_func",
    "HardFault:",
    "mrs r0, msp",
    "ldr r1, =_stack_start",
    "msr msp, r1",
    "bl {report}",
    ".pool",
    report = sym report,
);

// The watchdog of some boards, before it resets them; the clock's failure on others.
#[cfg(not(feature = "microbit"))]
global_asm!(
    ".syntax unified",
    ".section .NonMaskableInt.own, \"ax\"",
    ".global NonMaskableInt",
    ".type NonMaskableInt, %function",
    ".thumb_func",
    "NonMaskableInt:",
    "mrs r0, msp",
    "bl {report}",
    report = sym report_unmasked,
);

/// Reports the interrupt that cannot be masked; `pointer` is the stack pointer at that time.
#[cfg(not(feature = "microbit"))]
extern "C" fn report_unmasked(pointer: u32) -> ! {
    const NUMBER: i16 = 2 - 16;
    let cause = match board::UNMASKED_IS_WATCHDOG {
        true => Cause::Watchdog,
        false => Cause::Unexpected(NUMBER),
    };
    end(cause, pointer, Some(pointer))
}

/// Reports a fault; `pointer` is the stack pointer at that time.
extern "C" fn report(pointer: u32) -> ! {
    let cause = match stack::is_overflow(pointer) {
        true => Cause::StackOverflow,
        false => Cause::HardFault,
    };
    end(cause, pointer, Some(pointer))
}

/// Ends the program because of an exception without a handler.
pub fn unexpected(number: i16) -> ! {
    let pointer = cortex_m::register::msp::read();
    end(Cause::Unexpected(number), pointer, None)
}

/// Ends the program: it restarts on a board, and ends an emulator with an error.
pub fn stop() -> ! {
    end(Cause::Stopped, 0, None)
}

/// Makes an emulator restart as a board does, in place of ending it.
pub fn restart_in_emulators() {
    RESTARTS.store(true, Ordering::Relaxed);
}

/// Handles every exception without a handler of its own, which the runtime would stop at for ever; the MPS2 boards have
/// theirs in `board/mps2.rs`.
#[cfg(not(feature = "mps2"))]
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    unexpected(number)
}

/// Keeps a record and restarts; `frame` is where the processor pushed r0 to r3, r12, lr, pc and its status, if that is known.
fn end(cause: Cause, pointer: u32, frame: Option<u32>) -> ! {
    let pushed = frame.and_then(|frame| stack::words(frame, 5));
    let [lr, pc] = pushed.unwrap_or_default();
    let record = Record {
        cause,
        pc,
        lr,
        sp: pointer,
        status: status(),
    };
    record.keep();
    match cause {
        Cause::StackOverflow => {
            defmt::error!("stack overflow: the stack pointer was {=u32:#x}", pointer);
        }
        Cause::Stopped => {}
        Cause::HardFault | Cause::Unexpected(_) | Cause::Watchdog => defmt::error!("{}", record),
    }
    loop {
        if board::is_emulated() && !RESTARTS.load(Ordering::Relaxed) {
            debug::exit(EXIT_FAILURE);
        } else {
            SCB::sys_reset();
        }
    }
}

/// Returns the processor's status of faults.
#[cfg(not(armv6m))]
fn status() -> [u32; 2] {
    // SAFETY: these registers are read alone, which changes nothing.
    let scb = unsafe { &*SCB::PTR };
    [scb.cfsr.read(), scb.hfsr.read()]
}

/// The core has no such registers.
#[cfg(armv6m)]
fn status() -> [u32; 2] {
    [0; 2]
}

impl Record {
    /// Returns what of it the status tells.
    #[must_use]
    pub const fn restart(&self) -> Restart {
        Restart {
            cause: match self.cause {
                Cause::StackOverflow => event_link::Cause::StackOverflow,
                Cause::HardFault => event_link::Cause::Fault,
                Cause::Unexpected(_) => event_link::Cause::Unexpected,
                Cause::Stopped => event_link::Cause::Stopped,
                Cause::Watchdog => event_link::Cause::Watchdog,
            },
            pc: self.pc,
            lr: self.lr,
        }
    }

    /// Keeps the record for the program after a restart.
    fn keep(&self) {
        let (kind, number) = match self.cause {
            Cause::StackOverflow => (0, 0),
            Cause::HardFault => (1, 0),
            Cause::Unexpected(number) => (2, number),
            Cause::Stopped => (3, 0),
            Cause::Watchdog => (4, 0),
        };
        let [cfsr, hfsr] = self.status;
        let mut kept = [
            MAGIC,
            kind,
            (number as u16).into(),
            self.pc,
            self.lr,
            self.sp,
            cfsr,
            hfsr,
            0,
        ];
        kept[8] = sum(&kept);
        // SAFETY: nothing else runs: this ends the program, or is called by what ends it.
        unsafe { (&raw mut KEPT).write_volatile(MaybeUninit::new(kept)) };
    }

    /// Returns what ended the program before this one, if it did not end by itself, and forgets it. Called once, at the start.
    #[must_use]
    pub fn take() -> Option<Self> {
        let kept = Self::take_kept();
        #[cfg(feature = "stm32f405")]
        let kept = {
            // Both are forgotten. The chip's watchdog leaves no other record.
            let is_watchdog = board::take_watchdog_reset();
            kept.or_else(|| {
                is_watchdog.then_some(Self {
                    cause: Cause::Watchdog,
                    pc: 0,
                    lr: 0,
                    sp: 0,
                    status: [0; 2],
                })
            })
        };
        kept
    }

    fn take_kept() -> Option<Self> {
        // SAFETY: any bits are integers, and a volatile read takes those that are there; nothing else runs yet.
        let kept = unsafe { (&raw const KEPT).read_volatile().assume_init() };
        // SAFETY: as above.
        unsafe { (&raw mut KEPT).write_volatile(MaybeUninit::new([0; 9])) };
        let [magic, kind, number, pc, lr, sp, cfsr, hfsr, check] = kept;
        if magic != MAGIC || check != sum(&kept) {
            return None;
        }
        let cause = match kind {
            0 => Cause::StackOverflow,
            1 => Cause::HardFault,
            2 => Cause::Unexpected(number as i16),
            4 => Cause::Watchdog,
            _ => Cause::Stopped,
        };
        Some(Self {
            cause,
            pc,
            lr,
            sp,
            status: [cfsr, hfsr],
        })
    }
}

/// A sum of all words but the last, in which their places count.
fn sum(kept: &Kept) -> u32 {
    let words = kept.iter().take(kept.len() - 1);
    words.fold(1, |sum, word| sum.rotate_left(5).wrapping_add(*word))
}
