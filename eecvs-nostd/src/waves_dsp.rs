//! A pixel of several events of the DTFT on up to 32 frequencies: [`crate::pixel_encoder`]'s stages
//! with the kept sums side by side from the start and the output's state in registers.
//!
//! The stages in Rust stay for other processors and other grids; all give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use crate::bits::{BitWriter, Position};
use crate::fixed_point::Sum;
use crate::group::Impulses;
use crate::pack::{Packer, put_levels};
use crate::packing::{Packing, Shape, width_of};
use crate::phase::PhaseScale;
use crate::prune_dsp;
use crate::trace::{Stage, Trace};
use crate::transform::wave::Two;
use crate::transform::{Basis, Dtft, Transform};

/// Whether [`Waves`] are for this frame.
pub fn is_for(packing: &Packing) -> bool {
    packing.transform == Transform::Dtft
        && packing.quantiser.step_log2() <= 0
        && prune_dsp::is_for(packing.shape())
}

/// Words that a pixel takes at the most: counts and gap, 3 * 31 bits and 4; the set, a bit and 32;
/// the levels' width, up to 32; and what was there before.
const PLACE_WORDS_MAX: usize = 4 + 1 + 1 + 1;

/// What pixels of a frame have in common, and memory lent for their sums.
#[derive(Debug)]
pub struct Waves<'e> {
    pub shape: Shape,
    pub scale: PhaseScale,
    /// 2K sums.
    pub sums: &'e mut [Sum],
    /// Room for 2K numbers.
    pub numbers: &'e mut [u32],
}

/// Words that a pixel takes at the most, with levels of up to 32 bits.
pub const fn words_max(shape: Shape) -> usize {
    PLACE_WORDS_MAX + 2 * shape.r
}

impl Waves<'_> {
    /// Encodes a pixel of 2 to a chunk of events at a raster index. The output has room for it.
    #[inline(always)]
    pub fn encode<T: Trace>(
        &mut self,
        (index, on, events): (u32, u32, u32),
        impulses: &Impulses<'_>,
        packer: &mut Packer,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        let Shape { grid, r, quantiser } = self.shape;
        let shift = quantiser.shift() & 31;
        let mut kept = 0;
        if events == 2 {
            trace.enter(Stage::Prune);
            let two = Two::new(impulses, self.scale);
            kept = prune_dsp::of_two(two.difference(), on != 1, self.shape);
            trace.enter(Stage::Accumulate);
            two.exponentials(kept & !1, self.sums);
        }
        if kept == 0 {
            trace.enter(Stage::Accumulate);
            Dtft::accumulate(impulses.clone(), self.scale, grid, self.sums);
            if let Some(zeroth) = self.sums.first_chunk_mut() {
                *zeroth = [
                    Sum::from_bits((2 * on).wrapping_sub(events).cast_signed() << 25),
                    Sum::ZERO,
                ];
            }
            trace.enter(Stage::Prune);
            kept = prune_dsp::largest(self.sums, events, self.shape, self.numbers);
            trace.enter(Stage::Quantise);
            // SAFETY: the set has no index of K or above, and there are 2K sums.
            unsafe { gather(self.sums.as_mut_ptr(), kept & !1) };
        }
        trace.enter(Stage::Quantise);
        let pairs = r as u32 - (kept & 1);
        // SAFETY: the pairs are those that have just been written.
        let spread = unsafe { spread(self.sums.as_ptr(), pairs) } >> shift;
        trace.enter(Stage::Pack);
        let is_low = kept == !(u32::MAX << (r as u32 & 31));
        let (code, code_bits) = packer.place_code(index, (on, events - on), writer);
        let code = code | (u32::from(is_low) << (code_bits & 31));
        let code_bits = code_bits + 1;
        let (set, set_bits) = if is_low { (0, 0) } else { (kept, grid as u32) };
        // No clamp as in `Packing::level_bits_max`: the step is 1 at the most, and events few.
        let most = width_of(events - 1) + packer.one_bits();
        let bits = width_of(spread) + 1;
        if bits > PAIR_BITS_MAX || pairs == 0 {
            writer.put_clean(code, code_bits);
            writer.put_clean(set, set_bits);
            let Some(levels) = self.numbers.get_mut(..2 * pairs as usize) else {
                return;
            };
            for (level, sum) in levels.iter_mut().zip(&*self.sums) {
                *level = (sum.to_bits() >> shift).cast_unsigned();
            }
            if pairs > 0 {
                put_levels(most, levels, spread, writer);
            }
            return;
        }
        let zeros = most - bits;
        let fields = Fields {
            code,
            code_bits,
            set,
            set_bits,
            width: 1 << (zeros & 31),
            width_bits: zeros + 1,
            sums: self.sums.as_ptr(),
            pairs,
            shift,
            bits,
        };
        let writer: *mut BitWriter<'_> = writer;
        // SAFETY: the pointer is that of the reference. `put_fields` reads the pairs and writes the
        // position and fewer words from there on than there is room for. The build script sets
        // `eecvs_dsp` only for cores that have the instructions.
        unsafe {
            let (position, words, _) = BitWriter::raw_parts(writer);
            put_fields(&fields, &mut *position, words);
        }
    }
}

/// Bits of the widest levels of which a word has room for two.
const PAIR_BITS_MAX: u32 = 16;
/// And four.
const FOUR_BITS_MAX: u32 = 8;

/// Moves the pairs of `set` to the front, ascending.
///
/// # Safety
/// `sums` has a pair for every k up to the highest of the set.
#[unsafe(naked)]
unsafe extern "C" fn gather(sums: *mut Sum, set: u32) {
    naked_asm!(
        "push {{r4, lr}}",
        "mov r12, r0",
        "rbit r1, r1",
        "cbz r1, 3f",
        "2:",
        "clz r2, r1",
        "add r0, r0, r2, lsl #3",
        "lsls r1, r2",
        "ldrd r3, r4, [r0], #8",
        "strd r3, r4, [r12], #8",
        "lsls r1, r1, #1",
        "bne 2b",
        "3:",
        "pop {{r4, pc}}",
    )
}

/// The bits that are not copies of the sign, of any of the numbers.
///
/// # Safety
/// `sums` has `pairs` pairs.
#[unsafe(naked)]
unsafe extern "C" fn spread(sums: *const Sum, pairs: u32) -> u32 {
    naked_asm!(
        "push {{r4-r6, lr}}",
        "mov r12, r0",
        "movs r0, #0",
        "subs r1, #2",
        "blo 3f",
        "2:",
        "ldm r12!, {{r2-r5}}",
        "eor r2, r2, r2, asr #31",
        "orrs r0, r2",
        "eor r3, r3, r3, asr #31",
        "orrs r0, r3",
        "eor r4, r4, r4, asr #31",
        "orrs r0, r4",
        "eor r5, r5, r5, asr #31",
        "orrs r0, r5",
        "subs r1, #2",
        "bhs 2b",
        "3:",
        "adds r1, #2",
        "beq 4f",
        "ldrd r2, r3, [r12]",
        "eor r2, r2, r2, asr #31",
        "orrs r0, r2",
        "eor r3, r3, r3, asr #31",
        "orrs r0, r3",
        "4:",
        "pop {{r4-r6, pc}}",
    )
}

/// What [`put_fields`] puts, in this order: three values that have no bits beyond theirs, 32 at the
/// most, and the sums' levels.
#[derive(Debug)]
#[repr(C)]
struct Fields {
    code: u32,
    code_bits: u32,
    set: u32,
    set_bits: u32,
    width: u32,
    width_bits: u32,
    sums: *const Sum,
    /// 1 or more.
    pairs: u32,
    shift: u32,
    /// Bits of a level, 1 to [`PAIR_BITS_MAX`].
    bits: u32,
}

const _: () = assert!(offset_of!(Fields, sums) == 24);

/// Appends `$value`; overwrites `$bits`, which it has no bits beyond.
///
/// r9: bits of the next word; r8: 0; r10: the bit where the value goes; r12: where the word goes;
/// r11: another register.
macro_rules! put {
    ($value:literal, $bits:literal) => {
        concat!(
            // What the word has no room for is in r8.
            "umlal r9, r8, ",
            $value,
            ", r10\n",
            "lsls r11, r10, ",
            $bits,
            "\n",
            "bne 2f\n",
            "str r9, [r12], #4\n",
            "mov r9, r8\n",
            "mov r8, #0\n",
            "rsb ",
            $bits,
            ", ",
            $bits,
            ", #0\n",
            "ror r11, r10, ",
            $bits,
            "\n",
            "2:\n",
            "mov r10, r11\n",
        )
    };
}

/// # Safety
/// There are the words from the position on, and the pairs.
#[unsafe(naked)]
unsafe extern "C" fn put_fields(fields: &Fields, position: &mut Position, words: *mut [u8; 4]) {
    naked_asm!(
        "push {{r0-r2, r4-r11, lr}}",
        "ldm r1, {{r1, r9, r10}}",
        "add r12, r2, r1, lsl #2",
        "rsb r10, r10, #32",
        "movs r1, #1",
        "lsl r10, r1, r10",
        "mov r8, #0",
        "ldm r0!, {{r1-r6}}",
        put!("r1", "r2"),
        put!("r3", "r4"),
        put!("r5", "r6"),
        // r2: sums; r3: pairs; r7: shift; r6: bits of a level.
        "ldm r0, {{r2, r3, r7}}",
        "ldr r6, [r0, #12]",
        // r4: 2^bits; r5: the highest bit of each of two levels, later of four.
        "movs r1, #1",
        "lsl r4, r1, r6",
        "lsrs r1, r4, #1",
        "mla r5, r1, r4, r1",
        "cmp r6, #{four_bits_max}",
        "bhi 5f",
        "subs r3, #2",
        "blo 4f",
        "mla r5, r5, r4, r1",
        "mla r5, r5, r4, r1",
        "lsls r6, r6, #2",
        "3:",
        "ldm r2!, {{r0, r1, r11, lr}}",
        "asrs r0, r7",
        "asrs r1, r7",
        "asr r11, r11, r7",
        "asr lr, lr, r7",
        "mla r11, lr, r4, r11",
        "mla r1, r11, r4, r1",
        "mla r0, r1, r4, r0",
        // A negative level has borrowed from its neighbour, which half of a range more gives back.
        "adds r0, r0, r5",
        "eors r0, r5",
        "mov r1, r6",
        put!("r0", "r1"),
        "subs r3, #2",
        "bhs 3b",
        "lsrs r6, r6, #2",
        "lsrs r1, r4, #1",
        "mla r5, r1, r4, r1",
        "4:",
        "adds r3, #2",
        "beq 6f",
        // By pairs.
        "5:",
        "lsls r6, r6, #1",
        "7:",
        "ldrd r0, r1, [r2], #8",
        "asrs r0, r7",
        "asrs r1, r7",
        "mla r0, r1, r4, r0",
        "adds r0, r0, r5",
        "eors r0, r5",
        "mov r1, r6",
        put!("r0", "r1"),
        "subs r3, #1",
        "bne 7b",
        "6:",
        "ldrd r1, r2, [sp, #4]",
        "sub r2, r12, r2",
        "lsrs r2, r2, #2",
        "rbit r3, r10",
        "clz r3, r3",
        "rsb r3, r3, #32",
        "stm r1, {{r2, r9}}",
        "str r3, [r1, #8]",
        "add sp, #12",
        "pop {{r4-r11, pc}}",
        four_bits_max = const FOUR_BITS_MAX,
    )
}
