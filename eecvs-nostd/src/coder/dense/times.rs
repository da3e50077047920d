//! Times of a pixel in the dense coder: codes its first cell, then for each further event whether it exists, its
//! polarity and its distance from the one before.
//!
//! A cell or distance is coded as a symbol, which gives its magnitude and upper bits, and plain bits below. Where
//! events of neighbouring pixels come together, as under flickering lamps, those bits can be predicted: rows that
//! *follow* code them by a neighbour's event at a distance of the same length in bits, for as long as they agree.
//! Some rows always try this; how often all bits are right there decides whether the other rows do it.

use crate::coder::content::{Content, END, Node};
use crate::coder::range::symbols::Symbols;
use crate::coder::range::{Binary, Probability};
use crate::coder::scan::{FINE_BITS as BESIDE_BITS, fine_of, fine_parts};

/// Most bytes that an event takes: 53 decisions of up to 7.4 bits, a symbol of 15 bits, and 39 plain bits.
pub(crate) const EVENT_BYTES_MAX: usize = 72;

/// Upper bits of a first cell that are learned.
pub(crate) const FIRST_BITS: u32 = 5;
pub(crate) const FIRST_SYMBOLS: usize = 1 + (1 << FIRST_BITS);
/// Number of lengths in bits, the longest, for which three more bits of a distance are learned.
const FINE_LENGTHS: u32 = 6;
const FINE_BITS: u32 = 3;
/// Symbols for shorter distances, one per length in bits. In windows whose cells have numbers of up to
/// [`FIRST_BITS`] bits, every distance has a symbol of its own.
pub(crate) const COARSE: u32 = 15;
pub(crate) const DISTANCES: usize = 1 + COARSE as usize + (FINE_LENGTHS << FINE_BITS) as usize;
/// Lengths in bits of distances in rows that follow; coded by decisions from the top.
pub(crate) const LENGTHS: usize = 16;

/// Contexts by the length in bits of a pixel's last distance.
pub(crate) const OF_LAST: [u8; 16] = [0, 1, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 11, 11];
pub(crate) const LASTS: usize = 12;
/// Maps these contexts to those used where less than half of the window is left.
pub(crate) const OF_LAST_LATE: [u8; LASTS] = [0, 1, 1, 1, 1, 1, 1, 1, 2, 3, 4, 5];
/// Contexts of whether there is another event, by the same length; 0 where there was no distance.
pub(crate) const OF_LAST_MORE: [u8; 16] = [0, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5];
/// Contexts by the length in bits of a neighbour's distance; 0 for none.
pub(crate) const OF_NEAR: [u8; 17] = [0, 1, 1, 1, 1, 1, 2, 3, 4, 5, 6, 7, 7, 7, 8, 8, 8];
pub(crate) const NEARS: usize = 9;
/// Contexts of what is left of the window: powers of two, and one for the least.
pub(crate) const RESTS: usize = 6;

/// How many events of a neighbour are searched for one of the same polarity.
pub(crate) const LOOK_AHEAD: usize = 4;
/// Contexts of a prefix: 15 places by the candidate's bit; 3 after the first difference by its direction and the
/// candidate's bit; and a tree of 3 bits without a candidate.
pub(crate) const PREFIX_CONTEXTS: usize = 30 + 12 + 8;
/// Lengths in bits between which each length has a set of prefix contexts: all shorter ones share the first set,
/// and all longer ones the last. First cells have the set after these.
pub(crate) const PREFIX_LENGTHS: (u32, u32) = (4, 13);
pub(crate) const PREFIX_FIRST: usize = (PREFIX_LENGTHS.1 - PREFIX_LENGTHS.0 + 1) as usize;

/// Magnitudes of a distance from a scan that are learned; larger ones are plain.
const BESIDE_LEARNED: u32 = 4;

/// One row in this many always tries to follow.
const TRIAL_ROWS: usize = 16;
/// Trials before their result counts, and trials at which both counts are halved.
const TRIALS_MIN: u16 = 32;
pub(crate) const TRIALS_MAX: u16 = 512;
/// Fewest bits of a candidate in a trial: by chance one trial in 32 is right. Rows follow if more than one in 16
/// is.
pub(crate) const TRIAL_LENGTH: u32 = 6;
const TRIALS_PER_MATCH: u16 = 16;

/// Everything learned of times.
#[derive(Debug, Clone)]
pub(crate) struct LearnedTimes {
    pub(crate) first: Symbols<FIRST_SYMBOLS>,
    pub(crate) more: [Probability; 3 * RESTS * 6 * 4 * 2],
    pub(crate) flips: [Probability; 16 * 2 * 3 * 3],
    pub(crate) distances: [Symbols<DISTANCES>; LASTS * 2 + LASTS],
    pub(crate) lengths: [[Probability; LENGTHS]; LASTS * NEARS * 2],
    pub(crate) prefixes: [[Probability; PREFIX_CONTEXTS]; PREFIX_FIRST + 1],
    /// Whether a distance from a scan is above 0, 1, 2 and 3.
    beside: [Probability; BESIDE_LEARNED as usize],
    /// Whether the event is before the scan, at a distance of 1 and of more.
    before_scan: [Probability; 2],
    pub(crate) trials: u16,
    pub(crate) matches: u16,
}

impl LearnedTimes {
    pub(crate) const UNSET: Self = Self {
        first: Symbols::UNSET,
        more: [Probability::UNSET; _],
        flips: [Probability::UNSET; _],
        distances: [const { Symbols::UNSET }; _],
        lengths: [[Probability::UNSET; _]; _],
        prefixes: [[Probability::UNSET; _]; _],
        beside: [Probability::UNSET; _],
        before_scan: [Probability::UNSET; _],
        trials: 0,
        matches: 0,
    };

    pub(crate) fn restart(&mut self) {
        self.first.restart();
        self.more.fill(Probability::EVEN);
        self.flips.fill(Probability::EVEN);
        self.distances.iter_mut().for_each(Symbols::restart);
        self.lengths.as_flattened_mut().fill(Probability::EVEN);
        self.prefixes.as_flattened_mut().fill(Probability::EVEN);
        self.beside.fill(Probability::EVEN);
        self.before_scan.fill(Probability::EVEN);
        (self.trials, self.matches) = (0, 0);
    }

    /// Returns how row `y` uses its neighbours' times.
    pub(crate) const fn following(&self, y: usize) -> Following {
        if y.is_multiple_of(TRIAL_ROWS) || self.trials < TRIALS_MIN {
            Following::Tries
        } else if self.matches * TRIALS_PER_MATCH > self.trials {
            Following::Does
        } else {
            Following::Not
        }
    }

    fn tried(&mut self, matches: bool) {
        self.trials += 1;
        self.matches += u16::from(matches);
        if self.trials >= TRIALS_MAX {
            self.trials /= 2;
            self.matches /= 2;
        }
    }
}

/// How a row uses its neighbours' times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Following {
    Not,
    Does,
    /// Follows, and counts how often that is right.
    Tries,
}

/// What is known of a neighbouring pixel once its events are coded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Neighbour {
    /// Handle of its first event, for [`Content::at`].
    pub(crate) list: u32,
    /// Cell of its last event, at most 2^31 - 1, above the event's polarity in the lowest bit.
    pub(crate) last: u32,
}

impl Neighbour {
    /// A pixel without events.
    pub(crate) const NONE: Self = Self { list: END, last: 0 };

    const fn last(cell: u32, on: bool) -> u32 {
        (if cell >> 31 == 0 { cell } else { u32::MAX >> 1 }) << 1 | on as u32
    }

    /// Returns the polarity of the last event if that event is after `cell`.
    #[inline(always)]
    const fn after(self, cell: u32) -> Option<bool> {
        if self.last >> 1 > cell {
            Some(self.last & 1 == 1)
        } else {
            None
        }
    }
}

/// Result of coding a pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CodedPixel {
    pub(crate) events: u32,
    /// Its last event, as in [`Neighbour`].
    pub(crate) last: u32,
    /// Whether the frame goes on after the pixel.
    pub(crate) goes_on: bool,
}

/// State of the times kept from pixel to pixel.
#[derive(Debug)]
pub(crate) struct Clock {
    pub(crate) cells: u32,
    /// Bits of a cell's number.
    pub(crate) bits: u32,
    /// Bits coded beside a cell: its distance from the scan, or none.
    pub(crate) beside_bits: u32,
    /// Length in bits from which on distances are fine, and up to which they share symbol 0.
    pub(crate) fine: u32,
    coarse: u32,
    /// Length in bits of the last distance between two events of a pixel, up to 15.
    pub(crate) last_length: u32,
}

const fn length_of(value: u32) -> u32 {
    u32::BITS - value.leading_zeros()
}

const fn low_mask(bits: u32) -> u32 {
    if bits < 32 { (1 << bits) - 1 } else { u32::MAX }
}

/// Returns what is learned in a context. Contexts are sums of bounded parts; the bound here is for the compiler.
#[inline(always)]
fn at<T>(learned: &mut [T], context: usize) -> &mut T {
    let last = learned.len() - 1;
    &mut learned[context.min(last)]
}

/// What is known when a distance is coded.
#[derive(Clone, Copy)]
struct Step {
    cell: u32,
    rest: usize,
    flips: bool,
    on: bool,
}

impl Clock {
    /// Starts a frame of `cells` cells (at least 1) and `beside_bits` bits beside each: 0, or those of a distance
    /// from a scan.
    pub(crate) const fn new(cells: u32, beside_bits: u32) -> Self {
        let bits = length_of(cells - 1);
        let fine = bits.saturating_sub(FINE_LENGTHS - 1);
        let fine = if fine > FINE_BITS {
            fine
        } else {
            FINE_BITS + 1
        };
        Self {
            cells,
            bits,
            beside_bits,
            fine,
            coarse: fine.saturating_sub(COARSE),
            last_length: 0,
        }
    }

    /// Codes a pixel's events; `first_on` is the polarity of the first.
    #[inline(always)]
    pub(crate) fn pixel<C: Binary, T: Content>(
        &mut self,
        times: &mut LearnedTimes,
        coder: &mut C,
        content: &mut T,
        first_on: bool,
        ((mut west, mut north), following): ((Neighbour, Neighbour), Following),
    ) -> CodedPixel {
        let follows = following != Following::Not;
        let (told, _) = content.peek();
        let cell = told >> self.beside_bits;
        let candidate = if follows {
            self.first_of(content, west.list, first_on)
                .or_else(|| self.first_of(content, north.list, first_on))
        } else {
            None
        };
        // Here and below, only a number that no encoder writes goes beyond the last cell.
        let mut cell = self
            .first(times, coder, cell, candidate)
            .min(self.cells - 1);
        content.take(self.beside(times, coder, cell, told), first_on);
        let (mut on, mut before, mut events) = (first_on, 2, 1);
        loop {
            let goes_on = !content.is_over() && coder.has_room(EVENT_BYTES_MAX);
            if !goes_on {
                return CodedPixel {
                    events,
                    last: Neighbour::last(cell, on),
                    goes_on,
                };
            }
            let (west_next, north_next) = (west.after(cell), north.after(cell));
            let rest = self.rest(cell);
            let length = if events == 1 { 0 } else { self.last_length };
            let mut context = (events.min(3) as usize - 1) * RESTS + rest;
            context = context * 6 + usize::from(OF_LAST_MORE[length as usize & 15]);
            context = context * 2 + usize::from(north_next.is_some());
            context = context * 2 + usize::from(west_next.is_some());
            context = context * 2 + usize::from(on);
            if !coder.bit(at(&mut times.more, context), content.is_more()) {
                break;
            }
            let (told, next_on) = content.peek();
            let near_on = if follows {
                let (west, north) = (
                    self.after(content, &mut west.list, cell),
                    self.after(content, &mut north.list, cell),
                );
                west.or(north).map(|next| next.1)
            } else {
                west_next.or(north_next)
            };
            let near_on = near_on.map_or(0, |on| 1 + usize::from(on));
            let mut context = self.last_length as usize * 2 + usize::from(on);
            context = (context * 3 + before) * 3 + near_on;
            let next_on = coder.bit(at(&mut times.flips, context), next_on);
            let step = Step {
                cell,
                rest,
                flips: next_on != on,
                on: next_on,
            };
            let distance = (told >> self.beside_bits).wrapping_sub(cell);
            let distance = if follows {
                let lists = (west.list, north.list);
                self.following(times, coder, content, distance, (step, lists, following))
            } else {
                self.distance(times, coder, distance, step)
            };
            cell = cell.saturating_add(distance).min(self.cells - 1);
            before = usize::from(on);
            on = next_on;
            self.last_length = length_of(distance).min(15);
            content.take(self.beside(times, coder, cell, told), on);
            events += 1;
        }
        CodedPixel {
            events,
            last: Neighbour::last(cell, on),
            goes_on: true,
        }
    }

    /// Codes the first cell of a pixel.
    #[inline(always)]
    fn first<C: Binary>(
        &self,
        times: &mut LearnedTimes,
        coder: &mut C,
        cell: u32,
        candidate: Option<u32>,
    ) -> u32 {
        if let Some(candidate) = candidate {
            let contexts = &mut times.prefixes[PREFIX_FIRST];
            return prefix(contexts, coder, (cell, self.bits), Some(candidate));
        }
        let low = self.bits.saturating_sub(FIRST_BITS);
        let top = coder.symbol(&mut times.first, (cell >> low) as usize) as u32;
        top << low | coder.plain(cell & low_mask(low), low)
    }

    /// Returns the context of what is left of the window after a cell: 0 for the least.
    #[inline(always)]
    const fn rest(&self, cell: u32) -> usize {
        let short = self.bits.saturating_sub(length_of(self.cells - cell)) as usize;
        (RESTS - 1).saturating_sub(short)
    }

    /// Codes the distance to the next event.
    #[inline(always)]
    fn distance<C: Binary>(
        &self,
        times: &mut LearnedTimes,
        coder: &mut C,
        distance: u32,
        step: Step,
    ) -> u32 {
        let mut context = usize::from(OF_LAST[self.last_length as usize & 15]).min(LASTS - 1);
        if step.rest < RESTS - 1 {
            // Less than half of the window is left.
            context = LASTS + usize::from(OF_LAST_LATE[context]);
        }
        context = context * 2 + usize::from(step.flips);
        let first_fine = self.fine - self.coarse;
        // Distances beyond the window have no share.
        let last = self.symbol(self.cells - 1 - step.cell);
        let table = at(&mut times.distances, context);
        let symbol = coder.symbol_up_to(table, self.symbol(distance), last) as u32;
        if self.bits <= FIRST_BITS {
            return symbol;
        }
        let (top, low) = if symbol >= first_fine {
            let steps = symbol - first_fine;
            let low = (steps >> FINE_BITS) + self.fine - 1 - FINE_BITS;
            (1 << FINE_BITS | steps & low_mask(FINE_BITS), low)
        } else if symbol > 0 {
            (1, symbol + self.coarse - 1)
        } else {
            (0, self.coarse)
        };
        let low = low.min(31);
        top << low | coder.plain(distance & low_mask(low), low)
    }

    /// Returns the symbol of a distance. Below `fine` bits, symbol 0 stands for all distances of up to `coarse`
    /// bits, and each further symbol for one bit more.
    #[inline(always)]
    const fn symbol(&self, distance: u32) -> usize {
        let length = length_of(distance);
        let symbol = if self.bits <= FIRST_BITS {
            distance
        } else if length < self.fine {
            length.saturating_sub(self.coarse)
        } else {
            let steps = (length - self.fine) << FINE_BITS;
            let step = distance >> (length - 1 - FINE_BITS) & low_mask(FINE_BITS);
            self.fine - self.coarse + steps + step
        };
        symbol as usize
    }

    /// Codes the distance in a row that follows.
    #[inline(always)]
    fn following<C: Binary, T: Content>(
        &self,
        times: &mut LearnedTimes,
        coder: &mut C,
        content: &T,
        distance: u32,
        (step, (west, north), following): (Step, (u32, u32), Following),
    ) -> u32 {
        let away = |list: u32| {
            self.node(content, list)
                .map(|node| node.cell.wrapping_sub(step.cell))
        };
        let near = match (away(west), away(north)) {
            (Some(west), Some(north)) => west.min(north),
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => 0,
        };
        let near = usize::from(OF_NEAR[length_of(near).min(16) as usize]);
        let last = usize::from(OF_LAST[self.last_length as usize & 15]);
        let tree = at(
            &mut times.lengths,
            (last * NEARS + near) * 2 + usize::from(step.flips),
        );
        // 0 stands for all lengths of up to `short` bits.
        let short = self.bits.saturating_sub(LENGTHS as u32 - 1);
        let length = length_of(distance).saturating_sub(short);
        let mut node = 1;
        for i in (0..4).rev() {
            let bit = coder.bit(at(tree, node), length >> i & 1 == 1);
            node = 2 * node + usize::from(bit);
        }
        let length = node as u32 % LENGTHS as u32;
        if length == 0 {
            return coder.plain(distance & low_mask(short), short);
        }
        let low = (length + short - 1).min(31);
        let length = low + 1;
        let like = |list: u32| self.same_length(content, list, (step.cell, step.on, length));
        let candidate = like(west).or_else(|| like(north));
        let (shortest, longest) = PREFIX_LENGTHS;
        let set = length.clamp(shortest, longest) - shortest;
        let contexts = at(&mut times.prefixes, set as usize);
        let told = (distance & low_mask(low), low);
        let distance = 1 << low | prefix(contexts, coder, told, candidate);
        if following == Following::Tries
            && length >= TRIAL_LENGTH
            && let Some(candidate) = candidate
        {
            times.tried(candidate == distance);
        }
        distance
    }

    /// Returns a neighbour's event, with its cell but not the bits beside it.
    #[inline(always)]
    fn node<T: Content>(&self, content: &T, list: u32) -> Option<Node> {
        let node = content.at(list)?;
        Some(Node {
            cell: node.cell >> self.beside_bits,
            ..node
        })
    }

    /// Returns the cell of a neighbour's first event if it has this polarity.
    #[inline(always)]
    fn first_of<T: Content>(&self, content: &T, list: u32, on: bool) -> Option<u32> {
        let first = self.node(content, list)?;
        (first.on == on).then_some(first.cell)
    }

    /// Moves a neighbour's list beyond `cell`. Returns the cell and polarity of its next event.
    #[inline(always)]
    fn after<T: Content>(&self, content: &T, list: &mut u32, cell: u32) -> Option<(u32, bool)> {
        loop {
            let node = self.node(content, *list)?;
            if node.cell > cell {
                return Some((node.cell, node.on));
            }
            *list = node.next;
        }
    }

    /// Returns the distance from `cell` to a neighbour's next event of polarity `on`, if that distance has `length`
    /// bits.
    #[inline(always)]
    fn same_length<T: Content>(
        &self,
        content: &T,
        mut list: u32,
        (cell, on, length): (u32, bool, u32),
    ) -> Option<u32> {
        for _ in 0..LOOK_AHEAD {
            let node = self.node(content, list)?;
            if node.on == on {
                let distance = node.cell.wrapping_sub(cell);
                return (length_of(distance) == length).then_some(distance);
            }
            list = node.next;
        }
        None
    }

    /// Codes the bits beside a cell, if any. Returns them with the cell.
    #[inline(always)]
    fn beside<C: Binary>(
        &self,
        times: &mut LearnedTimes,
        coder: &mut C,
        cell: u32,
        told: u32,
    ) -> u32 {
        if self.beside_bits == 0 {
            return cell;
        }
        let (magnitude, is_before) = fine_parts(told & low_mask(BESIDE_BITS));
        let mut made = 0;
        while made < BESIDE_LEARNED
            && coder.bit(at(&mut times.beside, made as usize), magnitude > made)
        {
            made += 1;
        }
        if made == BESIDE_LEARNED {
            made += coder.plain(magnitude.saturating_sub(made), BESIDE_BITS - 1);
        }
        let sign = at(&mut times.before_scan, usize::from(made > 1));
        let is_before = made > 0 && coder.bit(sign, is_before);
        cell << BESIDE_BITS | fine_of(made, is_before)
    }
}

/// Codes the low `bits` bits of a value; a candidate may share the upper ones.
#[inline(always)]
fn prefix<C: Binary>(
    contexts: &mut [Probability; PREFIX_CONTEXTS],
    coder: &mut C,
    (value, bits): (u32, u32),
    candidate: Option<u32>,
) -> u32 {
    let mut made = 0;
    let mut left = bits;
    let mut code = |context: usize, left: &mut u32| {
        *left -= 1;
        let bit = coder.bit(at(contexts, context), value >> *left & 1 == 1);
        made = made << 1 | u32::from(bit);
        bit
    };
    match candidate {
        Some(candidate) => {
            // Follow the candidate as long as it is right.
            let mut differs = None;
            while left > 0 && differs.is_none() {
                let expected = candidate >> (left - 1) & 1 == 1;
                let place = (left - 1).min(14) as usize;
                let bit = code(2 * place + usize::from(expected), &mut left);
                differs = (bit != expected).then_some(bit);
            }
            // Near the candidate: a value just above it goes on with zeros, one just below it with ones.
            if let Some(up) = differs {
                for i in 0..3 {
                    if left == 0 {
                        break;
                    }
                    let expected = candidate >> (left - 1) & 1 == 1;
                    let context = 30 + 4 * i + 2 * usize::from(up) + usize::from(expected);
                    if code(context, &mut left) == up {
                        break;
                    }
                }
            }
        }
        None => {
            let mut node = 1;
            for _ in 0..3 {
                if left == 0 {
                    break;
                }
                node = 2 * node + usize::from(code(42 + node, &mut left));
            }
        }
    }
    let rest = coder.plain(value & low_mask(left), left);
    let high = if left < 32 { made << left } else { 0 };
    high | rest
}
