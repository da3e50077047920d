//! The word by which a receiver closes a connection whose messages it does not take: a line of text, the only bytes
//! that ever go back to a sender.
//!
//! A consumer that ends its own side of a connection may still read, and one that has closed it looks the same to a
//! sender until that has written in vain. With the word, the sender knows that nothing of this connection was taken.

use std::io::{Read, Write};

/// First bytes of the word.
const BEGIN: &[u8] = b"refused: ";
/// Longest word, in bytes.
const WORD_BYTES_MAX: usize = 512;

/// Sends the word and the reason, as far as the system has room for it at once.
pub fn send(stream: &mut impl Write, why: &str) {
    let mut line = [BEGIN, why.as_bytes()].concat();
    line.truncate(WORD_BYTES_MAX - 1);
    line.push(b'\n');
    // A sender that has gone needs no word.
    let _ = stream.write_all(&line);
}

/// Returns the reason if the word has come; any other bytes are dropped. Reads must not block.
pub fn receive(stream: &mut impl Read) -> Option<String> {
    let mut bytes = [0; WORD_BYTES_MAX];
    let length = stream.read(&mut bytes).ok()?;
    let word = bytes.get(..length)?;
    // A name from elsewhere may hold any characters.
    let word = String::from_utf8_lossy(word.strip_prefix(BEGIN)?);
    let line = word.lines().next().unwrap_or_default();
    Some(line.chars().filter(|one| !one.is_control()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_is_understood_and_nothing_else_is() {
        let mut line = Vec::new();
        send(&mut line, "tcp://a sends \x1b[31malready");
        assert_eq!(
            receive(&mut line.as_slice()).unwrap(),
            "tcp://a sends [31malready"
        );
        let mut long = Vec::new();
        send(&mut long, &"x".repeat(10_000));
        assert_eq!(receive(&mut long.as_slice()).unwrap().len(), 502);
        for other in [&b""[..], b"HTTP/1.1 400\r\n", b"refused"] {
            assert_eq!(receive(&mut &other[..]), None);
        }
    }
}
