//! Sequence numbers of messages, and the losses that they reveal.

/// What a sequence number reveals about the messages before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// It is the next number, or the first.
    InOrder,
    /// This many messages before it are missing.
    Lost(u64),
    /// It arrived after a later one.
    Late,
    /// It arrived before.
    Repeated,
    /// The publisher restarted its count.
    Restarted,
}

/// How far back a number may lie to count as late; a number further back is a restart.
const LATE_MAX: u64 = 1000;

/// Which of the latest numbers have arrived, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Come([u64; COME / 64]);

/// Number of latest sequence numbers that are remembered.
const COME: usize = 1024;

const _: () = assert!(COME as u64 > LATE_MAX);

impl Come {
    const fn place(number: u64) -> (usize, u64) {
        let place = number as usize % COME;
        (place / 64, 1 << (place % 64))
    }

    const fn has(&self, number: u64) -> bool {
        let (word, bit) = Self::place(number);
        self.0[word] & bit != 0
    }

    const fn set(&mut self, number: u64) {
        let (word, bit) = Self::place(number);
        self.0[word] |= bit;
    }

    /// Clears the bits of the `count` numbers before this one.
    fn miss(&mut self, number: u64, count: u64) {
        for back in 1..=count.min(COME as u64) {
            let (word, bit) = Self::place(number.wrapping_sub(back));
            self.0[word] &= !bit;
        }
    }
}

/// Tracks the sequence numbers of one publisher's messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sequence {
    next: Option<u64>,
    first: u64,
    come: Come,
    /// Messages that have not arrived.
    pub lost: u64,
    /// Messages that arrived after a later one.
    pub late: u64,
    /// Messages that arrived more than once.
    pub repeated: u64,
    /// Number of times that the publisher restarted its count.
    pub restarts: u64,
}

impl Sequence {
    /// Begins the numbers of another publisher; the counts go on.
    pub fn restart(&mut self) {
        if self.next.take().is_some() {
            self.restarts += 1;
        }
        self.first = 0;
        self.come = Come::default();
    }

    /// Records the number of a message that has arrived, and classifies it.
    pub fn follow(&mut self, number: u64) -> Order {
        let order = match self.next {
            None => Order::InOrder,
            Some(next) if number == next => Order::InOrder,
            Some(next) if number > next => Order::Lost(number - next),
            Some(next) if number > 0 && next - number <= LATE_MAX => {
                if self.come.has(number) {
                    Order::Repeated
                } else {
                    Order::Late
                }
            }
            Some(_) => Order::Restarted,
        };
        match order {
            Order::InOrder => {
                if self.next.is_none() {
                    self.first = number;
                }
            }
            Order::Lost(messages) => {
                self.lost = self.lost.saturating_add(messages);
                self.come.miss(number, messages);
            }
            Order::Late => {
                self.late += 1;
                // It was counted as lost, unless it precedes the first number.
                if number >= self.first {
                    self.lost = self.lost.saturating_sub(1);
                }
                self.come.set(number);
                return order;
            }
            Order::Repeated => {
                self.repeated += 1;
                return order;
            }
            Order::Restarted => {
                self.restarts += 1;
                self.first = number;
                self.come = Come::default();
            }
        }
        self.come.set(number);
        self.next = Some(number.saturating_add(1));
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_counted() {
        let mut sequence = Sequence::default();
        for (number, order) in [
            (7, Order::InOrder),
            (8, Order::InOrder),
            (11, Order::Lost(2)),
            (9, Order::Late),
            (9, Order::Repeated),
            (11, Order::Repeated),
            (12, Order::InOrder),
            (0, Order::Restarted),
            (1, Order::InOrder),
            (5000, Order::Lost(4998)),
            (3000, Order::Restarted),
            (u64::MAX, Order::Lost(u64::MAX - 3001)),
            (u64::MAX, Order::InOrder),
        ] {
            assert_eq!(sequence.follow(number), order, "{number}");
        }
        assert_eq!((sequence.late, sequence.repeated), (1, 2));
        assert_eq!(sequence.restarts, 2);
        let lost = sequence.lost;
        sequence.restart();
        for number in [70_000, 70_001] {
            assert_eq!(sequence.follow(number), Order::InOrder);
        }
        assert_eq!((sequence.lost, sequence.restarts), (lost, 3));
    }

    #[test]
    fn what_comes_late_is_not_lost_and_what_comes_again_is() {
        let mut sequence = Sequence::default();
        for number in (0..2000).filter(|number| number % 3 != 0) {
            sequence.follow(number);
        }
        // The first number to arrive is 1: what precedes it is not known to be missing.
        assert_eq!(sequence.lost, 666);
        assert_eq!(Sequence::default().follow(0), Order::InOrder);
        for number in 1100..1999 {
            sequence.follow(number);
        }
        let late = (1100..1999).filter(|number| number % 3 == 0).count() as u64;
        assert_eq!((sequence.late, sequence.repeated), (late, 899 - late));
        assert_eq!(sequence.lost, 666 - late);
    }
}
