//! Events of EVT 2.1 words, of up to 32 each, into a window: each is taken as the EVT 2.0 words with the same fields.

use event_types::evt21::{COLUMNS, Evt21Decoder, Order, Word};

use crate::window::{Taken, Window};

/// What takes EVT 2.1 words: their decoder, and how far it has come in a word whose events are of two windows.
#[derive(Debug, Clone, Copy)]
pub struct VectorIntake {
    decoder: Evt21Decoder,
    /// A word that a closed window has in part, and the columns of it that are left.
    begun: Option<([u8; 8], u32)>,
}

impl VectorIntake {
    /// Begins before the first word, and adds `base_us` to the format's times.
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            decoder: Evt21Decoder::new(base_us),
            begun: None,
        }
    }
}

impl Window<'_> {
    /// Adds the events of EVT 2.1 words, whose bytes have this order, up to the event that closes the window.
    ///
    /// If it takes fewer words than given, encode the window and push the rest again: the first of these is then the one
    /// whose events the closed window has in part or not at all, and what it has is not taken twice.
    pub fn push_vectors(
        &mut self,
        intake: &mut VectorIntake,
        order: Order,
        words: &[[u8; 8]],
    ) -> Taken {
        let mut taken = Taken::default();
        for bytes in words {
            // A word that is not the one begun is one that the caller has given in its place.
            let left = intake.begun.take().filter(|(word, _)| word == bytes);
            match intake.decoder.decode(order.word(*bytes)) {
                Word::Vector(vector) => {
                    let mut vector = vector.only(left.map_or(u32::MAX, |(_, columns)| columns));
                    let columns = vector.columns();
                    let beyond = vector.drop_beyond();
                    let mut events = [[0; 4]; COLUMNS as usize];
                    let mut count = 0;
                    for (event, word) in events.iter_mut().zip(vector) {
                        *event = word.to_le_bytes();
                        count += 1;
                    }
                    let events = events.get(..count).unwrap_or_default();
                    let pushed = self.push_words(intake.decoder.evt2(), events);
                    taken.events += pushed.events;
                    taken.outside += pushed.outside;
                    if pushed.words < count {
                        let left =
                            (0..pushed.words).fold(columns, |left, _| left & left.wrapping_sub(1));
                        intake.begun = Some((*bytes, left));
                        break;
                    }
                    // The window's count of what it leaves out has these, too.
                    self.count_dropped(beyond);
                    taken.events += beyond;
                    taken.outside += beyond;
                    // A vector without events says nothing.
                    taken.ignored += u32::from(columns == 0);
                }
                Word::Time => {}
                Word::Untimed(events) => taken.ignored += events.max(1),
                Word::Other => taken.ignored += 1,
            }
            taken.words += 1;
        }
        taken
    }
}
