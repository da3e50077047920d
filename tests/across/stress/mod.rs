//! The core where numbers are at their worst: edges of windows and atoms, crowded pixels, events
//! that cancel, levels on a border, times at the ends of their range, exact ties.
//!
//! Takes some seconds. `STRESS=20 cargo test --release -p eecvs-tests --test across stress::` searches
//! twenty times as long.

mod any_window;
mod cancelling;
mod crowded;
mod haar_edges;
mod quantiser_edges;
mod saturation;
mod ties;
mod times;
mod worst_places;

/// How much longer than usual a search takes: the environment's `STRESS`, 1 without it.
fn effort() -> usize {
    let asked = std::env::var("STRESS").ok();
    asked.map_or(1, |asked| asked.parse().expect("STRESS is a number"))
}

/// Seeded numbers: SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// 0..`end`, which is not 0.
    fn below(&mut self, end: u32) -> u32 {
        (((self.next() >> 32) * u64::from(end)) >> 32) as u32
    }
}
