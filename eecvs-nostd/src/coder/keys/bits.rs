//! Bits and varints of slice headers, lowest bit first.

/// Writes into a byte slice; what does not fit is counted but not written.
#[derive(Debug)]
pub struct Writer<'a> {
    out: &'a mut [u8],
    bytes: usize,
    pending: u32,
    count: u32,
}

impl<'a> Writer<'a> {
    /// Returns a writer at the front of `out`.
    pub const fn new(out: &'a mut [u8]) -> Self {
        Self {
            out,
            bytes: 0,
            pending: 0,
            count: 0,
        }
    }

    /// Writes a byte; no bits may be pending.
    pub fn byte(&mut self, byte: u8) {
        if let Some(at) = self.out.get_mut(self.bytes) {
            *at = byte;
        }
        self.bytes += 1;
    }

    /// Writes a number, seven bits a byte.
    pub fn varint(&mut self, mut value: u32) {
        while value >= 128 {
            self.byte(value as u8 | 128);
            value >>= 7;
        }
        self.byte(value as u8);
    }

    /// Writes up to 16 bits.
    pub fn bits(&mut self, value: u32, count: u32) {
        self.pending |= value << self.count;
        self.count += count;
        while self.count >= 8 {
            self.byte(self.pending as u8);
            self.pending >>= 8;
            self.count -= 8;
        }
    }

    /// Fills the last byte of bits with zeros.
    pub fn align(&mut self) {
        if self.count > 0 {
            self.byte(self.pending as u8);
            (self.pending, self.count) = (0, 0);
        }
    }

    /// Returns the number of bytes so far, those that did not fit included.
    pub const fn bytes(&self) -> usize {
        self.bytes
    }
}

/// Reads what [`Writer`] wrote; `None` is the end.
#[derive(Debug)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    pending: u32,
    count: u32,
}

impl<'a> Reader<'a> {
    /// Returns a reader of `bytes` from `at` on.
    pub const fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            pending: 0,
            count: 0,
        }
    }

    /// Reads a byte; no bits may be pending.
    pub fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    /// Reads a number of up to 32 bits in its shortest form.
    pub fn varint(&mut self) -> Option<u32> {
        let mut value = 0_u32;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.byte()?;
            let bits = u32::from(byte & 127);
            if (bits << shift) >> shift != bits || (byte == 0 && shift > 0) {
                return None;
            }
            value |= bits << shift;
            if byte < 128 {
                return Some(value);
            }
        }
        None
    }

    /// Reads up to 16 bits.
    pub fn bits(&mut self, count: u32) -> Option<u32> {
        while self.count < count {
            self.pending |= u32::from(self.byte()?) << self.count;
            self.count += 8;
        }
        let value = self.pending & ((1 << count) - 1);
        self.pending >>= count;
        self.count -= count;
        Some(value)
    }

    /// Returns the next six bits, those beyond the end 0.
    #[inline(always)]
    pub fn peek_six(&mut self) -> u32 {
        // That no byte is left is what `skip` finds.
        if self.count < 6
            && let Some(byte) = self.byte()
        {
            self.pending |= u32::from(byte) << self.count;
            self.count += 8;
        }
        self.pending & 63
    }

    /// Skips up to six bits that were peeked.
    #[inline(always)]
    pub fn skip(&mut self, count: u32) -> Option<()> {
        self.count = self.count.checked_sub(count)?;
        self.pending >>= count;
        Some(())
    }

    /// Skips the rest of a byte, which has to be zeros.
    pub fn align(&mut self) -> Option<()> {
        // A byte that was only peeked is put back.
        self.at -= (self.count / 8) as usize;
        let rest = self.pending & ((1 << (self.count % 8)) - 1);
        (self.pending, self.count) = (0, 0);
        (rest == 0).then_some(())
    }

    /// Returns where the next byte is.
    pub const fn at(&self) -> usize {
        self.at
    }
}
