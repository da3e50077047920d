//! What a command may leave.

use crate::case::{Case, Kind};
use crate::run::{Bench, Files, Outcome};

/// The files that a case leaves where nothing fails, and how a whole one is known.
pub struct Reference {
    files: Vec<(String, Whole)>,
    pub calls: Vec<String>,
}

enum Whole {
    /// The same bytes in every run.
    Bytes(Vec<u8>),
    /// Of this length, since dates or random numbers are in it.
    Length(usize),
    /// With this many events.
    Events(u64),
    /// Text that ends so, since keys are random, or figures of speed have more or fewer digits.
    End(&'static str),
}

/// The ends of the texts whose length differs from run to run.
const ENDS: [&str; 5] = [
    "</html>\n",
    "</html>",
    "-----END CERTIFICATE-----\n",
    "-----END PRIVATE KEY-----\n",
    "\n",
];

impl Reference {
    /// Runs a case twice without a fault.
    pub fn of(bench: &Bench, case: &Case) -> Self {
        let (_, first) = bench.run(case, "0-");
        let (before, second) = bench.run(case, "0-");
        for outcome in [&first, &second] {
            assert!(outcome.is_success(), "{}: {}", case.line, outcome.stderr);
        }
        let mut files = Vec::new();
        for (name, bytes) in &second.files {
            if before.get(name) == Some(bytes) {
                continue;
            }
            let other = first.files.get(name).map_or(&[][..], Vec::as_slice);
            let end = || ENDS.into_iter().find(|end| bytes.ends_with(end.as_bytes()));
            let whole = if other == bytes {
                Whole::Bytes(bytes.clone())
            } else if let Some(events) = bench.events(name) {
                Whole::Events(events)
            } else if let (true, Some(end)) = (case.has_text_of_its_run(name), end()) {
                Whole::End(end)
            } else {
                assert_eq!(other.len(), bytes.len(), "{}: {name}", case.line);
                Whole::Length(bytes.len())
            };
            files.push((name.clone(), whole));
        }
        assert!(!files.is_empty(), "{}: writes nothing", case.line);
        let mut calls = second.calls;
        // Another run may have a call more, if it has threads.
        calls.truncate(first.calls.len());
        Self { files, calls }
    }

    /// Returns whether a file of the case is whole.
    fn is_whole(&self, bench: &Bench, name: &str, bytes: &[u8]) -> bool {
        let found = self.files.iter().find(|(known, _)| known == name);
        match found.map(|(_, whole)| whole) {
            Some(Whole::Bytes(whole)) => bytes == whole,
            Some(Whole::Length(length)) => bytes.len() == *length,
            Some(Whole::Events(events)) => bench.events(name) == Some(*events),
            Some(Whole::End(end)) => bytes.ends_with(end.as_bytes()),
            None => false,
        }
    }

    /// Returns whether every file of the case is there and whole.
    pub fn is_complete(&self, bench: &Bench, files: &Files) -> bool {
        self.files.iter().all(|(name, _)| {
            let bytes = files.get(name);
            bytes.is_some_and(|bytes| self.is_whole(bench, name, bytes))
        })
    }

    /// Returns what is wrong with what a command left of `before`; `failed` is the call at which its plan set in.
    pub fn fault(
        &self,
        bench: &Bench,
        case: &Case,
        before: &Files,
        outcome: &Outcome,
        failed: &str,
        is_stopped: bool,
    ) -> Option<String> {
        let is_whole = |name: &str, bytes: &[u8]| {
            // What a live source has sent until it was stopped is whole too, if its end says so.
            let is_shorter = is_stopped && case.is_live() && bytes != b"old";
            let is_ended = || {
                let end = match name.rsplit('.').next() {
                    Some("mcap") => &b"\x89MCAP0\r\n"[..],
                    Some("gif") => b";",
                    Some("yaml" | "csv") => b"\n",
                    _ => return bench.events(name).is_some(),
                };
                bytes.ends_with(end)
            };
            self.is_whole(bench, name, bytes) || is_shorter && is_ended()
        };
        if outcome.stderr.contains("panicked") {
            return Some("it panics".to_owned());
        }
        let is_success = outcome.is_success();
        for (name, bytes) in &outcome.files {
            let is_old = before.get(name) == Some(bytes);
            if is_old || is_whole(name, bytes) {
                continue;
            }
            let own = name.rsplit('/').next().unwrap_or(name);
            let is_known = self.files.iter().any(|(known, _)| known == name);
            let is_allowed = match case.kind {
                // Nobody could remove it.
                _ if !is_known && outcome.is_killed() => true,
                _ if !is_known && failed.starts_with("unlink") => true,
                Kind::Appended => {
                    !is_success && before.get(name).is_some_and(|old| bytes.starts_with(old))
                }
                Kind::Live => own.starts_with("incomplete-") && !is_success,
                Kind::Growing => !is_success,
                // The messages of half a bag can be indexed again.
                Kind::Folder(last) => !last.is_empty() && own != last && !is_success,
                _ => false,
            };
            if !is_allowed {
                return Some(format!(
                    "{name} is neither old nor whole: {} bytes",
                    bytes.len()
                ));
            }
        }
        for name in before.keys() {
            if !outcome.files.contains_key(name) {
                return Some(format!("{name} is gone"));
            }
        }
        let missing = self.files.iter().find(|(name, _)| {
            let bytes = outcome.files.get(name);
            bytes.is_none_or(|bytes| !is_whole(name, bytes))
        });
        let (missing, _) = missing?;
        if is_stopped && is_success && case.is_live() {
            return None;
        }
        if is_success {
            return Some(format!("status 0, but {missing} is not whole"));
        }
        if let Kind::Folder(last) = case.kind
            && !last.is_empty()
            && outcome.files.keys().any(|name| name.ends_with(last))
        {
            return Some(format!("{last} is there, but {missing} is not whole"));
        }
        None
    }
}
