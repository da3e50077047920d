//! AER: addresses of pixels without a time, as GenX320 sends them over its parallel port.
//!
//! | bit 18 | 17..9 | 8..0 |
//! |---|---|---|
//! | polarity: 1 ON | x | y |
//!
//! Source: "AER Format" in Prophesee's documentation. An event happens when its word arrives: the receiver has the time.

use crate::{Event, Polarity};

/// Lowest bit of the polarity.
const POLARITY_SHIFT: u32 = 18;
/// Lowest bit of x.
const X_SHIFT: u32 = 9;
/// Mask of x, and of y.
const SIDE: u32 = (1 << X_SHIFT) - 1;

/// Returns the event of a word that arrived at `t_us`; `None` if a bit above the polarity is set, which no word has.
#[inline]
#[must_use]
pub const fn event(word: u32, t_us: u64) -> Option<Event> {
    if word >> POLARITY_SHIFT > 1 {
        return None;
    }
    Some(Event {
        t_us,
        x: (word >> X_SHIFT & SIDE) as u16,
        y: (word & SIDE) as u16,
        polarity: Polarity::from_bool(word >> POLARITY_SHIFT == 1),
    })
}

/// Returns the word of an event; `None` if its pixel is outside the format's 512 x 512.
#[inline]
#[must_use]
pub const fn word(event: Event) -> Option<u32> {
    let (x, y) = (event.x as u32, event.y as u32);
    if x > SIDE || y > SIDE {
        return None;
    }
    Some((event.polarity as u32) << POLARITY_SHIFT | x << X_SHIFT | y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_have_polarity_x_and_y() {
        let at = |x, y, polarity| Event {
            t_us: 9,
            x,
            y,
            polarity,
        };
        for (event_at, bits) in [
            (at(319, 1, Polarity::On), 1 << 18 | 319 << 9 | 1),
            (at(0, 511, Polarity::Off), 511),
        ] {
            assert_eq!(word(event_at), Some(bits));
            assert_eq!(event(bits, 9), Some(event_at));
        }
        assert_eq!(word(at(512, 0, Polarity::On)), None);
        assert_eq!(event(1 << 19, 9), None);
    }
}
