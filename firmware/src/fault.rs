//! How a panic, a fault, an exception that nothing expects, or a stack that crossed its floor ends: a board restarts, an
//! emulator exits with an error. What it was is kept in memory that a restart leaves alone, and logged after it.

use core::arch::global_asm;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
#[cfg(not(feature = "mps2"))]
use cortex_m_rt::exception;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};

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

/// Reports a fault; `pointer` is the stack pointer at that time.
extern "C" fn report(pointer: u32) -> ! {
    let cause = match stack::is_overflow(pointer) {
        true => Cause::StackOverflow,
        false => Cause::HardFault,
    };
    end(cause, pointer)
}

/// Ends the program because of an exception without a handler.
pub fn unexpected(number: i16) -> ! {
    let pointer = cortex_m::register::msp::read();
    end(Cause::Unexpected(number), pointer)
}

/// Ends the program: it restarts on a board, and ends an emulator with an error.
pub fn stop() -> ! {
    end(Cause::Stopped, 0)
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

fn end(cause: Cause, pointer: u32) -> ! {
    // The processor pushes r0 to r3, r12, lr, pc and its status where a fault begins.
    let [lr, pc] = match cause {
        Cause::HardFault => stack::words(pointer, 5).unwrap_or_default(),
        Cause::StackOverflow | Cause::Unexpected(_) | Cause::Stopped => [0; 2],
    };
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
        Cause::HardFault | Cause::Unexpected(_) => defmt::error!("{}", record),
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
#[cfg(not(feature = "microbit"))]
fn status() -> [u32; 2] {
    // SAFETY: these registers are read alone, which changes nothing.
    let scb = unsafe { &*SCB::PTR };
    [scb.cfsr.read(), scb.hfsr.read()]
}

/// The core has no such registers.
#[cfg(feature = "microbit")]
fn status() -> [u32; 2] {
    [0; 2]
}

impl Record {
    /// Keeps the record for the program after a restart.
    fn keep(&self) {
        let (kind, number) = match self.cause {
            Cause::StackOverflow => (0, 0),
            Cause::HardFault => (1, 0),
            Cause::Unexpected(number) => (2, number),
            Cause::Stopped => (3, 0),
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

    /// Returns what ended the program before this one, if a fault did, and forgets it. Called once, at the start.
    #[must_use]
    pub fn take() -> Option<Self> {
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
