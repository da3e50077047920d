//! Numbers of messages, and what is missing among them.

/// What a number says of the messages before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// It is the next one, or the first.
    InOrder,
    /// So many before it have not come.
    Lost(u64),
    /// It has come after a later one, or twice.
    Late,
    /// The publisher has begun anew.
    Restarted,
}

/// How far back a number may be that is late; beyond it, counting has begun anew.
const LATE_MAX: u64 = 1000;

/// The numbers of one publisher's messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sequence {
    next: Option<u64>,
    /// Messages that have not come.
    pub lost: u64,
    /// Messages that came after a later one, or twice.
    pub late: u64,
    /// Times that the publisher has begun anew.
    pub restarts: u64,
}

impl Sequence {
    /// Takes the next number.
    pub fn follow(&mut self, number: u64) -> Order {
        let order = match self.next {
            None => Order::InOrder,
            Some(next) if number == next => Order::InOrder,
            Some(next) if number > next => Order::Lost(number - next),
            Some(next) if number > 0 && next - number <= LATE_MAX => Order::Late,
            Some(_) => Order::Restarted,
        };
        match order {
            Order::InOrder => {}
            Order::Lost(messages) => self.lost = self.lost.saturating_add(messages),
            Order::Late => {
                // It was counted as lost before; of a repeated one, nothing was.
                self.late += 1;
                self.lost = self.lost.saturating_sub(1);
                return order;
            }
            Order::Restarted => self.restarts += 1,
        }
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
        assert_eq!((sequence.late, sequence.restarts), (1, 2));
    }
}
