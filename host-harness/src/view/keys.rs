//! Keys that are pressed while frames are shown. The terminal hands them over one by one, and does not show them.

use std::time::Duration;

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Space: stop at the frame that is shown, or go on.
    Pause,
    /// Full stop: show the next frame, and pause.
    Step,
    /// Arrows to the left and the right: a second of playback.
    Near(Way),
    /// Arrows down and up, and keys for pages: ten seconds of playback.
    Far(Way),
    /// Home: the start.
    Start,
    /// q: end.
    Quit,
}

/// A direction in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// To earlier frames.
    Back,
    /// To later frames.
    On,
}

/// Takes the first key from bytes of a terminal; `None` if they hold no whole one. What means nothing is left out.
fn take(bytes: &mut Vec<u8>) -> Option<Key> {
    while let Some((&first, rest)) = bytes.split_first() {
        let (key, len) = match (first, rest) {
            (b' ', _) => (Some(Key::Pause), 1),
            (b'.', _) => (Some(Key::Step), 1),
            (b'q' | b'Q', _) => (Some(Key::Quit), 1),
            (0x1B, [b'[' | b'O', tail @ ..]) => {
                // Parameters, then one letter or sign; or it is none of a terminal.
                let end = tail.iter().position(|byte| !(0x20..=0x3F).contains(byte))?;
                let key = match (&tail[..end], tail[end]) {
                    ([], b'A') | ([b'5'], b'~') => Some(Key::Far(Way::On)),
                    ([], b'B') | ([b'6'], b'~') => Some(Key::Far(Way::Back)),
                    ([], b'C') => Some(Key::Near(Way::On)),
                    ([], b'D') => Some(Key::Near(Way::Back)),
                    ([], b'H') | ([b'1' | b'7'], b'~') => Some(Key::Start),
                    _ => None,
                };
                (key, 3 + end)
            }
            // The rest of it may follow.
            (0x1B, []) => return None,
            _ => (None, 1),
        };
        bytes.drain(..len);
        if key.is_some() {
            return key;
        }
    }
    None
}

/// The keys of the terminal at stdin; dropping them gives it back as it was.
#[derive(Debug)]
pub struct Keys {
    #[cfg(unix)]
    terminal: unix::Terminal,
    bytes: Vec<u8>,
}

impl Keys {
    /// Takes the keys of the terminal; `None` if stdin is none, if it is another program's at the moment, or where the
    /// system has other terminals.
    #[must_use]
    pub fn open() -> Option<Self> {
        #[cfg(unix)]
        return Some(Self {
            terminal: unix::Terminal::open()?,
            bytes: Vec::new(),
        });
        #[cfg(not(unix))]
        None
    }

    /// Waits for a key, at most for `time`.
    pub fn next(&mut self, time: Duration) -> Option<Key> {
        let key = take(&mut self.bytes);
        if key.is_some() {
            return key;
        }
        #[cfg(unix)]
        self.terminal.read(time, &mut self.bytes);
        #[cfg(not(unix))]
        std::thread::sleep(time);
        let key = take(&mut self.bytes);
        // A sequence without end is no key.
        if self.bytes.len() > 64 {
            self.bytes.clear();
        }
        #[cfg(unix)]
        if self.terminal.is_closed {
            return Some(Key::Quit);
        }
        key
    }
}

#[cfg(unix)]
mod unix {
    use std::io::{IsTerminal, stdin};
    use std::sync::{Mutex, PoisonError};
    use std::thread::sleep;
    use std::time::Duration;

    use eecvs_cli::stop::restore_at_end;

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::process::getpgrp;
    use rustix::termios::{
        LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcgetpgrp, tcsetattr,
    };

    /// How the terminal was, while it is another.
    static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

    /// Gives the terminal back as it was.
    fn restore() {
        let before = BEFORE.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(before) = before {
            // If the terminal is gone, nothing needs to be restored. What was typed ahead was for this program.
            let _ = tcsetattr(stdin(), OptionalActions::Flush, &before);
        }
    }

    /// The terminal at stdin, without lines and echo.
    #[derive(Debug)]
    pub(super) struct Terminal {
        pub(super) is_closed: bool,
    }

    impl Terminal {
        pub(super) fn open() -> Option<Self> {
            let stdin = stdin();
            // In the background, a change of the terminal would stop this program.
            if !stdin.is_terminal() || tcgetpgrp(&stdin).ok()? != getpgrp() {
                return None;
            }
            let before = tcgetattr(&stdin).ok()?;
            let mut terminal = before.clone();
            // Ctrl-C and Ctrl-Z stay what they are.
            terminal
                .local_modes
                .remove(LocalModes::ICANON | LocalModes::ECHO);
            terminal.special_codes[SpecialCodeIndex::VMIN] = 1;
            terminal.special_codes[SpecialCodeIndex::VTIME] = 0;
            tcsetattr(&stdin, OptionalActions::Now, &terminal).ok()?;
            *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = Some(before);
            // A second signal ends the process without dropping anything.
            restore_at_end(restore);
            Some(Self { is_closed: false })
        }

        /// Waits for bytes, at most for `time`, and appends them.
        pub(super) fn read(&mut self, time: Duration, bytes: &mut Vec<u8>) {
            let stdin = stdin();
            let timeout = Timespec::try_from(time).ok();
            let mut ready = [PollFd::new(&stdin, PollFlags::IN)];
            if poll(&mut ready, timeout.as_ref()).is_err() {
                sleep(time);
                return;
            }
            let seen = ready[0].revents();
            if seen.contains(PollFlags::IN) {
                let mut room = [0; 64];
                match rustix::io::read(&stdin, &mut room) {
                    Ok(count) => bytes.extend_from_slice(&room[..count]),
                    Err(_) => sleep(time),
                }
            } else if !seen.is_empty() {
                self.is_closed = true;
            }
        }
    }

    impl Drop for Terminal {
        fn drop(&mut self) {
            restore();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(bytes: &[u8]) -> Vec<Key> {
        let mut bytes = bytes.to_vec();
        std::iter::from_fn(|| take(&mut bytes)).collect()
    }

    #[test]
    fn keys_are_those_of_terminals() {
        assert_eq!(all(b" .q"), [Key::Pause, Key::Step, Key::Quit]);
        let arrows = [
            Key::Far(Way::On),
            Key::Far(Way::Back),
            Key::Near(Way::On),
            Key::Near(Way::Back),
        ];
        assert_eq!(all(b"\x1b[A\x1b[B\x1b[C\x1b[D"), arrows);
        assert_eq!(all(b"\x1bOA\x1bOB\x1bOC\x1bOD"), arrows);
        assert_eq!(all(b"\x1b[5~\x1b[6~"), arrows[..2]);
        assert_eq!(all(b"\x1b[H\x1b[1~\x1bOH"), [Key::Start; 3]);
    }

    #[test]
    fn what_means_nothing_is_left_out() {
        // Letters, a key with Ctrl, a function key, an escape alone, bytes beyond ASCII.
        assert_eq!(
            all("xyz\x1b[1;5C\x1b[15~\x1b\u{e9} ".as_bytes()),
            [Key::Pause]
        );
    }

    #[test]
    fn a_key_may_come_in_pieces() {
        let mut bytes = Vec::new();
        for byte in b"\x1b[5" {
            bytes.push(*byte);
            assert_eq!(take(&mut bytes), None);
        }
        bytes.push(b'~');
        assert_eq!(take(&mut bytes), Some(Key::Far(Way::On)));
        assert!(bytes.is_empty());
    }
}
