//! Adaptive coders of coefficients: mode `transform` in fewer bits.
//!
//! ```text
//! group -> accumulate -> prune -> quantise -> fast or dense -> frame
//! ```
//!
//! The levels are those of the plain payload ([`crate::pack::packer`]), to the bit. In a pixel of few events they
//! are not independent, as the times of the events determine all of them. Such a pixel is coded by its events: by
//! their cells, and by how its levels differ from those of events in the middle of their cells. Both sides compute
//! the latter with the same kernel. If cells are of one microsecond, or the transform is Haar's, nothing differs. A
//! pixel with too many events for that to pay is coded by its levels. [`fast`] and [`dense`] have the codes.

pub mod dense;
pub mod fast;
mod fields;
pub mod pixel;
pub mod prediction;

use fields::{Fields, SetShape};
use pixel::{Common, Pixel};
use prediction::Prediction;

use crate::coder::cells::Cells;
use crate::pack::unpack::UnpackError;
use crate::prune::low_frequency;
use crate::transform::shape::width_of;
use crate::transform::{Rule, Transform};

/// Memory of the adaptive coders of coefficients.
#[derive(Debug, Clone)]
pub struct CoefficientMemory {
    pub(crate) pixel: Pixel,
    prediction: Prediction,
    learned: dense::Learned,
}

impl CoefficientMemory {
    /// All zero, for memory in `.bss`.
    pub const UNSET: Self = Self {
        pixel: Pixel::EMPTY,
        prediction: Prediction::EMPTY,
        learned: dense::Learned::UNSET,
    };

    /// Returns the current pixel and the memory with which it is coded.
    pub(crate) const fn parts(&mut self) -> (&mut Pixel, dense::Memory<'_>) {
        (&mut self.pixel, (&mut self.prediction, &mut self.learned))
    }

    /// Resets what the dense coder has learned.
    pub fn restart(&mut self) {
        self.learned.restart();
    }
}

/// Codes what follows a pixel's place and its majority polarity (ON if there are as many of both); the pixel has at
/// most `left` events. `west` and `north` are the neighbours' numbers of events.
fn tell<F: Fields>(
    fields: &mut F,
    common: &Common,
    (pixel, prediction): (&mut Pixel, &mut Prediction),
    (is_on, left): (bool, u32),
    (west, north): (u32, u32),
) -> Result<(), UnpackError> {
    let events = fields.number(fields::events(west, north), pixel.count().wrapping_sub(1));
    if events >= left {
        return Err(UnpackError::Events);
    }
    let events = events + 1;
    let most = if is_on { events / 2 } else { (events - 1) / 2 };
    let mut minor = pixel.on.min(pixel.off);
    if most == 0 {
        minor = 0;
    } else {
        minor = fields.number(fields::minor(events), minor);
    }
    let major = events.checked_sub(minor).filter(|_| minor <= most);
    let major = major.ok_or(UnpackError::Events)?;
    (pixel.on, pixel.off) = if is_on {
        (major, minor)
    } else {
        (minor, major)
    };
    if events == 1 {
        pixel.cell = fields.top(0, pixel.cell, common.cells_log2);
        return sound(fields);
    }
    if let Some(cells) = common.timed_cells(events) {
        tell_events(fields, cells, pixel)?;
        sound(fields)?;
        // A pixel has only one encoding.
        let coded = pixel.events.iter().take(events as usize);
        return if coded.is_sorted() {
            Ok(())
        } else {
            Err(UnpackError::Levels)
        };
    }
    let power = fields::power(events);
    pixel.is_told = common.may_tell(events) && fields.flag(fields::TOLD + power, pixel.is_told);
    if pixel.is_told {
        tell_events(fields, common.cells, pixel)?;
        tell_differences(fields, common, pixel, prediction)?;
    } else {
        tell_set(fields, common, pixel)?;
        tell_levels(fields, common, pixel);
    }
    sound(fields)?;
    check_levels(common, pixel)
}

/// Returns [`UnpackError::Ended`] if a decoder's bits have ended.
fn sound<F: Fields>(fields: &F) -> Result<(), UnpackError> {
    if fields.is_sound() {
        Ok(())
    } else {
        Err(UnpackError::Ended)
    }
}

/// Codes the cells and polarities of a pixel's events.
fn tell_events<F: Fields>(
    fields: &mut F,
    cells: Cells,
    pixel: &mut Pixel,
) -> Result<(), UnpackError> {
    let (mut on_left, mut off_left) = (pixel.on, pixel.off);
    let count = cells.count();
    let bits = width_of(count - 1);
    let (mut cell, mut last_bits, mut last_on) = (0, 0, false);
    for (i, event) in pixel
        .events
        .iter_mut()
        .take((on_left + off_left) as usize)
        .enumerate()
    {
        let is_free = on_left > 0 && off_left > 0;
        let after = on_left + off_left - 1;
        let mut is_on = on_left > 0;
        if is_free {
            let context = usize::from(last_on) * 16 + last_bits.min(15) as usize;
            is_on = fields.flag(fields::FLIP + context, *event & 1 == 1);
        }
        if i == 0 {
            let table = 1 + (fields::power(on_left + off_left) - 1).min(fields::TOPS - 2);
            cell = fields.top(table, *event >> 1, bits);
        } else {
            let context = fields::distance(last_bits, after, is_on != last_on);
            let distance = fields.number(context, (*event >> 1).wrapping_sub(cell));
            last_bits = width_of(distance);
            cell = cell.saturating_add(distance);
        }
        if cell >= count {
            return Err(UnpackError::Levels);
        }
        sound(fields)?;
        *event = cell << 1 | u32::from(is_on);
        last_on = is_on;
        on_left -= u32::from(is_on);
        off_left -= u32::from(!is_on);
    }
    Ok(())
}

/// Codes how the levels of a pixel that is coded by its events differ from their prediction.
fn tell_differences<F: Fields>(
    fields: &mut F,
    common: &Common,
    pixel: &mut Pixel,
    prediction: &mut Prediction,
) -> Result<(), UnpackError> {
    let power = fields::power(pixel.count());
    let grid = usize::from(common.packing.grid);
    prediction.make(common, pixel);
    let kept = prediction.kept;
    let is_same_set = kept.words(grid) == pixel.kept.words(grid);
    let events = pixel.count();
    let told = pixel.levels.get(..pixel.levels_len).unwrap_or_default();
    let foretold = prediction.levels(common, &pixel.kept);
    let is_same = is_same_set
        && foretold
            .iter()
            .map(|next| next.level)
            .eq(told.iter().copied());
    if fields.flag(fields::AS_FORETOLD + power, is_same) {
        let foretold = prediction.levels(common, &kept);
        pixel.kept = kept;
        pixel.levels_len = foretold.len();
        for (level, foretold) in pixel.levels.iter_mut().zip(foretold) {
            *level = foretold.level;
        }
        return Ok(());
    }
    let has_set = common.packing.transform.rule() == Rule::Magnitude;
    if !has_set || fields.flag(fields::SAME_SET + power, is_same_set) {
        pixel.kept = kept;
    } else {
        let shape = set_shape(common, events);
        fields.set(Some(kept.words(grid)), pixel.kept.words_mut(grid), shape);
        check_set(common, pixel)?;
    }
    let foretold = prediction.levels(common, &pixel.kept);
    pixel.levels_len = foretold.len();
    let Some(levels) = pixel.levels.get_mut(..foretold.len()) else {
        return Err(UnpackError::Levels);
    };
    for (level, foretold) in levels.iter_mut().zip(foretold) {
        *level = level.wrapping_sub(foretold.level);
    }
    fields.residuals(events, foretold, levels);
    for (level, foretold) in levels.iter_mut().zip(foretold) {
        *level = level.wrapping_add(foretold.level);
    }
    Ok(())
}

fn set_shape(common: &Common, events: u32) -> SetShape {
    SetShape {
        grid: usize::from(common.packing.grid),
        most: common.packing.kept(),
        is_exact: common.packing.transform.is_complex(),
        events,
    }
}

/// Codes which coefficients a pixel has that is coded by its levels.
fn tell_set<F: Fields>(
    fields: &mut F,
    common: &Common,
    pixel: &mut Pixel,
) -> Result<(), UnpackError> {
    let packing = &common.packing;
    let (grid, r) = (usize::from(packing.grid), packing.kept());
    let mut low = crate::prune::Kept::NONE;
    low_frequency(r, &mut low);
    let is_low = pixel.kept.words(grid) == low.words(grid);
    let context = fields::CONTIGUOUS + fields::power(pixel.count());
    let is_low = match packing.transform {
        Transform::Dct => true,
        Transform::Dtft => r == grid || fields.flag(context, is_low),
        Transform::Dwt => false,
    };
    if is_low {
        pixel.kept = low;
    } else {
        let shape = set_shape(common, pixel.count());
        fields.set(None, pixel.kept.words_mut(grid), shape);
    }
    check_set(common, pixel)
}

/// Checks that the set has as many coefficients as it has to.
fn check_set(common: &Common, pixel: &Pixel) -> Result<(), UnpackError> {
    let packing = &common.packing;
    let count = pixel.kept.count(usize::from(packing.grid)) as usize;
    let fits = match packing.transform {
        Transform::Dct | Transform::Dtft => count == packing.kept(),
        Transform::Dwt => count <= packing.kept(),
    };
    if fits {
        Ok(())
    } else {
        Err(UnpackError::Levels)
    }
}

/// Codes levels that have no prediction.
fn tell_levels<F: Fields>(fields: &mut F, common: &Common, pixel: &mut Pixel) {
    let events = pixel.count();
    let widest = common.packing.level_bits_max(events) - 1;
    let count = pixel.levels_of_set(common).min(pixel.levels.len());
    pixel.levels_len = count;
    let numbers = common.numbers();
    // Of re and of im.
    let mut before = [(false, widest); 2];
    for (i, level) in pixel.levels.iter_mut().take(count).enumerate() {
        let height = (4 * i / count.max(1)) as u8;
        let (sign, bits) = before[i % numbers % 2];
        let context = fields::level(events, height, widest.saturating_sub(bits));
        let magnitude = fields.number(context, (*level ^ (*level >> 31)) as u32);
        let context = fields::SIGN + 2 * usize::from(i % numbers == 1) + usize::from(sign);
        let sign = fields.flag(context, *level < 0);
        *level = if sign {
            !(magnitude as i32)
        } else {
            magnitude as i32
        };
        before[i % numbers % 2] = (sign, width_of(magnitude));
    }
}

/// Checks that n events can have these levels.
fn check_levels(common: &Common, pixel: &Pixel) -> Result<(), UnpackError> {
    let most = common.packing.level_bits_max(pixel.count());
    let levels = pixel.levels.get(..pixel.levels_len).unwrap_or_default();
    let spread = levels
        .iter()
        .fold(0, |spread, level| spread | (level ^ (level >> 31)) as u32);
    let is_whole = pixel.levels_len == pixel.levels_of_set(common);
    // A Haar coefficient that is 0 is not sent.
    let is_zero = common.packing.transform == Transform::Dwt
        && pixel.kept.contains(0)
        && pixel.on == pixel.off;
    if is_whole && !is_zero && width_of(spread) < most {
        Ok(())
    } else {
        Err(UnpackError::Levels)
    }
}
