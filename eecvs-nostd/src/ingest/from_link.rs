//! The event link as an [`EventSource`]: converts received bytes to words, and detects losses by the packets'
//! positions.

use crate::event_link::{HotNumbers, Kind, Packet, Receiver, Setup};
use crate::ingest::{EventSource, Input};
use event_types::evt2::is_event;

/// What to do next with the receiver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Find the next packet.
    Bytes,
    /// Begin the packet that was found.
    Packet,
    /// Pass on its words, from this offset in its body.
    Words(usize),
    /// Pass on its hot pixels.
    Hot(HotNumbers),
}

/// The state of the link, which is kept between bytes.
#[derive(Debug)]
pub struct Link {
    receiver: Receiver,
    step: Step,
    /// The position that the next packet should have.
    position: u32,
    ignored: u32,
}

impl Link {
    /// Creates a link that has received no byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            receiver: Receiver::new(),
            step: Step::Bytes,
            position: 0,
            ignored: 0,
        }
    }

    /// Returns the number of bytes that belonged to no packet; wraps.
    #[must_use]
    pub const fn damaged_bytes(&self) -> u32 {
        self.receiver.damaged_bytes()
    }

    /// Returns the number of repeated or invalid packets, of bytes left over in packets of words or hot pixels, and
    /// of inputs that nobody wanted; wraps.
    #[must_use]
    pub const fn ignored(&self) -> u32 {
        self.ignored
    }

    /// Restarts the link with the next byte, which does not continue the earlier ones because another host sends
    /// it.
    ///
    /// Words that were received but not taken count as ignored, and so do `lost` bytes that did not arrive here.
    pub fn restart(&mut self, lost: u32) {
        if let Step::Words(at) = self.step {
            self.ignore(self.receiver.words(at).len());
        }
        self.ignore(lost as usize);
        self.receiver.restart();
        self.step = Step::Bytes;
    }

    /// Returns a source that takes its bytes from `next_byte`.
    pub const fn source<F: FnMut() -> Option<u8>>(&mut self, next_byte: F) -> LinkSource<'_, F> {
        LinkSource {
            link: self,
            next_byte,
        }
    }

    pub(crate) const fn ignore(&mut self, count: usize) {
        self.ignored = self.ignored.wrapping_add(count as u32);
    }

    fn word(&mut self, at: usize) -> Option<Input> {
        let Some(word) = self.receiver.words(at).first() else {
            self.step = Step::Bytes;
            return None;
        };
        let word = u32::from_le_bytes(*word);
        self.step = Step::Words(at + 4);
        self.position = self.position.wrapping_add(u32::from(is_event(word)));
        Some(Input::Word(word))
    }

    fn hot(&mut self, mut numbers: HotNumbers) -> Input {
        let body = self.receiver.packet().map_or(&[][..], |packet| packet.body);
        let number = numbers.read(body);
        let left_over = body.len() - numbers.bytes().min(body.len());
        if let Some(number) = number {
            self.step = Step::Hot(numbers);
            return Input::Hot(number);
        }
        self.ignore(left_over);
        self.step = Step::Bytes;
        Input::HotEnd
    }

    /// Begins the packet, which the receiver holds until it is asked for the next one.
    fn begin(&mut self) -> Option<Input> {
        self.step = Step::Bytes;
        let Packet {
            kind,
            position,
            body,
        } = self.receiver.packet()?;
        let left_over = body.len() % 4;
        match kind {
            Kind::Setup => {
                if let Some(setup) = Setup::parse(body) {
                    self.position = 0;
                    return Some(Input::Setup(setup));
                }
                self.ignore(1);
                return None;
            }
            Kind::Status => {
                self.ignore(1);
                return None;
            }
            Kind::Words | Kind::Flush | Kind::Hot => {}
        }
        let ahead = position.wrapping_sub(self.position);
        if ahead >= 1 << 31 {
            // A repeated packet: its events were already taken, or counted as lost.
            self.ignore(1);
            None
        } else if ahead > 0 {
            self.position = position;
            self.step = Step::Packet;
            Some(Input::Lost(ahead))
        } else if kind == Kind::Flush {
            Some(Input::Flush)
        } else if kind == Kind::Hot {
            self.step = Step::Hot(HotNumbers::START);
            None
        } else {
            self.ignore(left_over);
            self.step = Step::Words(0);
            None
        }
    }
}

impl Default for Link {
    fn default() -> Self {
        Self::new()
    }
}

/// A [`Link`] with the source of its bytes.
#[derive(Debug)]
pub struct LinkSource<'l, F> {
    link: &'l mut Link,
    next_byte: F,
}

#[cfg(feature = "sensor")]
impl<F> LinkSource<'_, F> {
    /// Counts an input that nobody wanted.
    pub(crate) const fn ignore(&mut self) {
        self.link.ignore(1);
    }
}

impl<F: FnMut() -> Option<u8>> EventSource for LinkSource<'_, F> {
    fn words(&self) -> &[[u8; 4]] {
        match self.link.step {
            Step::Words(at) => self.link.receiver.words(at),
            Step::Bytes | Step::Packet | Step::Hot(_) => &[],
        }
    }

    fn skip(&mut self, words: usize, events: u32) {
        if let Step::Words(at) = &mut self.link.step {
            *at += 4 * words;
            self.link.position = self.link.position.wrapping_add(events);
        }
    }

    #[inline]
    fn next(&mut self) -> Option<Input> {
        let link = &mut *self.link;
        loop {
            let input = match link.step {
                Step::Words(at) => link.word(at),
                Step::Hot(numbers) => Some(link.hot(numbers)),
                Step::Packet => link.begin(),
                Step::Bytes => {
                    if link.receiver.next_packet().is_some() {
                        link.step = Step::Packet;
                    } else if !link.receiver.fill(&mut self.next_byte) {
                        return None;
                    }
                    None
                }
            };
            if input.is_some() {
                return input;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(kind: Kind, body: &[u8], out: &mut [u8]) -> usize {
        let packet = Packet {
            kind,
            position: 0,
            body,
        };
        packet.write(out).unwrap()
    }

    #[test]
    fn a_restart_forgets_what_is_not_whole() {
        let mut flush = [0; 16];
        let flush_len = packet(Kind::Flush, &[], &mut flush);
        let mut words = [0; 32];
        let words_len = packet(Kind::Words, &[0x80; 12], &mut words);
        // Cut anywhere, also in the middle of the packet's words.
        for cut in 0..words_len {
            let mut link = Link::new();
            let mut bytes = words[..cut].iter().copied();
            assert_eq!(link.source(|| bytes.next()).next(), None, "{cut}");
            link.restart(3);
            assert_eq!(link.damaged_bytes(), cut as u32);
            assert_eq!(link.ignored(), 3);
            let mut bytes = flush[..flush_len].iter().copied();
            let input = link.source(|| bytes.next()).next();
            assert_eq!(input, Some(Input::Flush), "{cut}");
        }
        let mut link = Link::new();
        let mut bytes = words[..words_len].iter().copied();
        assert!(matches!(
            link.source(|| bytes.next()).next(),
            Some(Input::Word(_))
        ));
        link.restart(0);
        // Two words of the packet were left.
        assert_eq!((link.damaged_bytes(), link.ignored()), (0, 2));
        assert_eq!(link.source(|| None).next(), None);
    }
}
