//! Serialised messages, passed through `ros2-client` unchanged.
//!
//! Publishers and subscriptions of `ros2-client` accept only types that `serde` serialises, not bytes. In CDR a
//! tuple is the sequence of its elements. The bytes are therefore written as a tuple: first eight at a time as
//! `u64`, which are aligned from the start and so need no padding, then the remaining ones singly. Words are
//! little-endian, as is the serialiser.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The bytes of a message after its four bytes of encapsulation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raw(pub Vec<u8>);

/// Bytes in a word.
const WORD: usize = size_of::<u64>();

impl Serialize for Raw {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (words, rest) = self.0.as_chunks::<WORD>();
        let mut tuple = serializer.serialize_tuple(words.len() + rest.len())?;
        for word in words {
            tuple.serialize_element(&u64::from_le_bytes(*word))?;
        }
        for byte in rest {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for Raw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // The number of elements is unknown: read until there are no more.
        deserializer.deserialize_tuple(usize::MAX, Elements)
    }
}

struct Elements;

impl<'de> Visitor<'de> for Elements {
    type Value = Raw;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("bytes")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Raw, A::Error> {
        let mut bytes = Vec::new();
        // An element that does not fit into the remaining bytes consumes none of them.
        while let Ok(Some(word)) = elements.next_element::<u64>() {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
        while let Ok(Some(byte)) = elements.next_element::<u8>() {
            bytes.push(byte);
            if bytes.len() % WORD == 0 {
                return Err(A::Error::custom("a word was left out"));
            }
        }
        Ok(Raw(bytes))
    }
}

#[cfg(test)]
mod tests {
    use byteorder::LittleEndian;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn bytes_pass_as_they_are(bytes: Vec<u8>) {
            let raw = Raw(bytes);
            let sent = cdr_encoding::to_vec::<Raw, LittleEndian>(&raw).unwrap();
            prop_assert_eq!(&sent, &raw.0);
            let (back, taken) = cdr_encoding::from_bytes::<Raw, LittleEndian>(&sent).unwrap();
            prop_assert_eq!(taken, sent.len());
            prop_assert_eq!(back, raw);
        }
    }
}
