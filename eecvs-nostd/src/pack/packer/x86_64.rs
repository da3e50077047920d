//! Packs pixels whose sums or levels are in vectors: [`Packer`] on a host.

use crate::accumulate::dct8;
use crate::pack::bits_lsb_first::BitWriter;
use crate::pack::packer::Packer;
use crate::transform::shape::width_of;

impl Packer {
    /// Writes a whole pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events: its place and the
    /// levels of its sums, which are in vectors. The output has to have room for it.
    #[inline(always)]
    pub(crate) fn seven_vectors(
        &mut self,
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        sums: dct8::Sums,
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            let levels = sums.levels(self.shift);
            // Unlike `Packing::level_bits_max` without a clamp: the step is at most 1, and events are few.
            let most = width_of((on + off).wrapping_sub(1)) + self.one_bits;
            let bits = width_of(levels.spread()) + 1;
            let width = 1 << (most.wrapping_sub(bits) & 31);
            let width_bits = most.wrapping_sub(bits) + 1;
            writer.put_long(
                u64::from(code) | (width << code_bits),
                code_bits + width_bits,
            );
            let [a, b, c, d] = levels.pairs(bits);
            if bits <= 16 {
                writer.put_long(a | (b << (2 * bits)), 4 * bits);
                writer.put_long(c | (d << (2 * bits)), 3 * bits);
            } else {
                for pair in [a, b, c] {
                    writer.put_long(pair, 2 * bits);
                }
                writer.put_long(d, bits);
            }
        });
    }

    /// Writes a whole pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events with complex
    /// coefficients: its place, the set `kept` (fewer than K, which is at most 32), and the levels of that set,
    /// `bits` bits each, side by side in `pairs`. The output has to have room for it.
    #[inline(always)]
    pub(crate) fn pairs(
        &mut self,
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        (kept, pairs, bits): (u32, &[u64], u32),
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        let grid = u32::from(self.packing.grid);
        let low = !(u32::MAX << (self.packing.kept() as u32 & 31));
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            // A one if the set is k = 0..r, else a zero and a bit for each k.
            let (set, set_bits) = if kept == low {
                (1, 1)
            } else {
                (u64::from(kept) << 1, grid + 1)
            };
            writer.put_long(u64::from(code) | (set << code_bits), code_bits + set_bits);
            let mut left = kept & !1;
            if left == 0 {
                return;
            }
            // The step is at most 1, and events are few: the widest level has 22 bits.
            let most = width_of((on + off).wrapping_sub(1)) + self.one_bits;
            writer.put_unary(most.wrapping_sub(bits) & 31);
            let pair = |k: u32| pairs.get(k as usize).copied().unwrap_or_default();
            if bits > 16 {
                while left != 0 {
                    writer.put_long(pair(left.trailing_zeros()), 2 * bits);
                    left &= left - 1;
                }
                return;
            }
            while left != 0 {
                let first = pair(left.trailing_zeros());
                left &= left - 1;
                if left == 0 {
                    return writer.put_long(first, 2 * bits);
                }
                let second = pair(left.trailing_zeros());
                left &= left - 1;
                writer.put_long(first | (second << (2 * bits)), 4 * bits);
            }
        });
    }
}
