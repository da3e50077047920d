//! Packs chunks as Prophesee's ECF does, only for tests: any part of the format can be requested.

/// An event: t, x, y, p.
pub type Numbers = (u64, u16, u16, u8);

/// The packing of x, y and p.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// All three in 24 bits.
    Yxp,
    /// Runs of y; x and p in 12 bits.
    Xp,
    /// Runs of y and p; x with bits for the five columns after it.
    Runs,
}

/// Packs events whose times ascend; no run is longer than `run`.
pub fn pack(events: &[Numbers], form: Form, run: usize) -> Vec<u8> {
    let flags = match form {
        Form::Yxp => 2,
        Form::Xp => 1,
        Form::Runs => 0,
    };
    let mut packed = ((events.len() as u32) << 2 | flags).to_le_bytes().to_vec();
    pack_times(events, run, &mut packed);
    match form {
        Form::Yxp => {
            for four in fours(events, |(_, x, y, p)| {
                u32::from(y) << 12 | u32::from(x) << 1 | u32::from(p)
            }) {
                let [a, b, c, d] = four;
                let words = [
                    a << 8 | b & 0xff,
                    b >> 8 << 16 | c & 0xffff,
                    c >> 16 << 24 | d,
                ];
                packed.extend(words.map(u32::to_le_bytes).concat());
            }
        }
        Form::Xp => {
            pack_rows(events, run, &mut packed);
            for four in fours(events, |(_, x, _, p)| x << 1 | u16::from(p)) {
                let [a, b, c, d] = four;
                let words = [a << 4 | b & 15, b >> 4 << 8 | c & 0xff, c >> 8 << 12 | d];
                packed.extend(words.map(u16::to_le_bytes).concat());
            }
        }
        Form::Runs => {
            pack_rows(events, run, &mut packed);
            pack_columns(events, &mut packed);
            for (p, count) in runs(events.iter().map(|(_, _, _, p)| *p), run) {
                let short = count.min(127);
                packed.push(p << 7 | short as u8);
                if short == 127 {
                    packed.extend((count as u16).to_le_bytes());
                }
            }
        }
    }
    packed
}

fn pack_times(events: &[Numbers], run: usize, packed: &mut Vec<u8>) {
    let mut time = events.first().map_or(0, |(t, ..)| *t);
    packed.extend(time.to_le_bytes());
    for (t, count) in runs(events.iter().map(|(t, ..)| *t), run) {
        let mut step = t - time;
        time = t;
        if step >= 15 {
            while step > 0 {
                packed.push(0xf0 | (step & 15) as u8);
                step >>= 4;
            }
        }
        let short = count.min(15);
        packed.push((step as u8) << 4 | short as u8);
        if short == 15 {
            packed.extend((count as u16).to_le_bytes());
        }
    }
}

fn pack_rows(events: &[Numbers], run: usize, packed: &mut Vec<u8>) {
    for (y, count) in runs(events.iter().map(|(_, _, y, _)| *y), run) {
        let short = count.min(31);
        packed.extend((y << 5 | short as u16).to_le_bytes());
        if short == 31 {
            packed.extend((count as u16).to_le_bytes());
        }
    }
}

fn pack_columns(events: &[Numbers], packed: &mut Vec<u8>) {
    let mut rest = events.iter().map(|(_, x, ..)| *x).peekable();
    while let Some(x) = rest.next() {
        let mut word = x << 5;
        for distance in 1..=5 {
            if rest.next_if_eq(&(x + distance)).is_some() {
                word |= 1 << (5 - distance);
            }
        }
        packed.extend(word.to_le_bytes());
    }
}

/// Returns runs of equal numbers and their lengths, at most `most`.
fn runs<T: Copy + PartialEq>(numbers: impl Iterator<Item = T>, most: usize) -> Vec<(T, usize)> {
    let mut runs: Vec<(T, usize)> = Vec::new();
    for number in numbers {
        match runs.last_mut() {
            Some((same, count)) if *same == number && *count < most => *count += 1,
            _ => runs.push((number, 1)),
        }
    }
    runs
}

/// Returns groups of four events; the last group is filled with zeros.
fn fours<T: Copy + Default>(events: &[Numbers], of: impl Fn(Numbers) -> T) -> Vec<[T; 4]> {
    let four = |part: &[Numbers]| {
        let mut four = [T::default(); 4];
        for (place, event) in four.iter_mut().zip(part) {
            *place = of(*event);
        }
        four
    };
    events.chunks(4).map(four).collect()
}
