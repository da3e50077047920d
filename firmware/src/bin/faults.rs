//! Ends in each way that `fault.rs` knows, one after the other, and compares after each restart what was kept of it. For
//! QEMU's STM32F405, which keeps its memory over a restart as the chip does.
#![no_std]
#![no_main]

use core::arch::naked_asm;
use core::hint::black_box;
use core::mem::MaybeUninit;

use cortex_m::peripheral::{NVIC, SCB};
use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hprintln;
use eecvs_firmware::fault::{self, Cause, Record};

/// How many ends there have been, and a mark that this number was written.
#[unsafe(link_section = ".uninit.ends")]
static mut ENDS: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();
const MARK: u32 = 0x0E4D_0E4D;

/// An interrupt without a handler.
#[derive(Clone, Copy)]
struct Unbound;

// SAFETY: the chip has this interrupt.
unsafe impl cortex_m::interrupt::InterruptNumber for Unbound {
    fn number(self) -> u16 {
        5
    }
}

/// Number of the interrupt that cannot be masked, less 16.
const NMI: i16 = 2 - 16;
/// An address without memory.
const NOWHERE: usize = 0x6000_0000;
/// In the status of faults: an instruction that is none, a read that failed at a known address.
const UNDEFINED: u32 = 1 << 16;
const NO_MEMORY: u32 = 1 << 9;

/// An instruction that is none.
#[unsafe(naked)]
extern "C" fn undefined() {
    naked_asm!("udf #0");
}

/// Recurses with a frame of at least 256 bytes per level.
#[inline(never)]
fn descend(levels: u32) -> u32 {
    let frame = black_box([levels; 64]);
    if levels == 0 {
        return 0;
    }
    descend(levels - 1).wrapping_add(black_box(frame)[levels as usize % 64])
}

fn end_by_instruction() {
    undefined();
}

fn end_by_interrupt() {
    NVIC::pend(Unbound);
    // SAFETY: it is the image's end.
    unsafe { NVIC::unmask(Unbound) };
    cortex_m::asm::dsb();
}

fn end_by_nmi() {
    // SAFETY: it is the image's end.
    unsafe { (*SCB::PTR).icsr.write(1 << 31) };
    cortex_m::asm::dsb();
}

fn end_by_read() {
    let nowhere = core::ptr::with_exposed_provenance::<u32>(NOWHERE);
    // SAFETY: there is no memory that another reference could have; the read ends the image.
    black_box(unsafe { nowhere.read_volatile() });
}

fn end_by_overflow() {
    black_box(descend(u32::MAX));
}

fn end_by_stop() {
    fault::stop();
}

fn is_undefined(record: &Record) -> bool {
    record.cause == Cause::HardFault
        && record.pc == undefined as *const () as u32 & !1
        && record.lr != 0
        && record.status[0] == UNDEFINED
}

fn is_interrupt(record: &Record) -> bool {
    record.cause == Cause::Unexpected(5)
}

fn is_nmi(record: &Record) -> bool {
    record.cause == Cause::Unexpected(NMI)
}

fn is_read(record: &Record) -> bool {
    record.cause == Cause::HardFault && record.pc != 0 && record.status[0] & NO_MEMORY > 0
}

fn is_overflow(record: &Record) -> bool {
    record.cause == Cause::StackOverflow && record.pc == 0
}

fn is_stop(record: &Record) -> bool {
    record.cause == Cause::Stopped
}

/// What ends the image, and whether a record is of it.
type End = (fn(), fn(&Record) -> bool);

static ALL: [End; 6] = [
    (end_by_instruction, is_undefined),
    (end_by_interrupt, is_interrupt),
    (end_by_nmi, is_nmi),
    (end_by_read, is_read),
    (end_by_overflow, is_overflow),
    (end_by_stop, is_stop),
];

#[entry]
fn main() -> ! {
    fault::restart_in_emulators();
    let record = Record::take();
    // SAFETY: any bits are integers, and a volatile read takes those that are there; nothing else runs.
    let [mark, ends] = unsafe { (&raw const ENDS).read_volatile().assume_init() };
    let ends = if mark == MARK { ends as usize } else { 0 };
    let is_kept = match (record, ends.checked_sub(1).and_then(|last| ALL.get(last))) {
        (Some(record), Some((_, is_it))) => is_it(&record),
        (None, None) => true,
        _ => false,
    };
    if !is_kept || Record::take().is_some() {
        hprintln!("end {}: {:?}", ends, record);
        debug::exit(EXIT_FAILURE);
    }
    if let Some((end, _)) = ALL.get(ends) {
        let next = MaybeUninit::new([MARK, ends as u32 + 1]);
        // SAFETY: nothing else runs.
        unsafe { (&raw mut ENDS).write_volatile(next) };
        end();
        hprintln!("end {} did not end the image", ends);
        debug::exit(EXIT_FAILURE);
    }
    hprintln!("faults: {} ends, each kept over a restart", ends);
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}
