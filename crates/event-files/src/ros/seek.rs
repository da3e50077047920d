//! Finds a time in a bag.
//!
//! A file's index is used only for its places (chunks, or rows of a table), not for its times: those are the
//! computer's at the arrival and need not follow the sensor's clock. The places are bisected by the times of the
//! first events after each of them.
//!
//! Words of `evt3` and `libcaer_cmp` continue where the previous message ended. After a place, they are therefore
//! skipped until everything is known that later words depend on: for `evt3` both parts of the time, the row, and
//! then a column; for `libcaer_cmp` x and the start of the vectors. If this is known only after the time sought,
//! reading begins at an earlier place.
//!
//! The 24-bit time of `evt3` wraps every 16.8 s. How often it has wrapped since the bag's start is inferred from
//! the computer's stamps in the headers. They must agree with the 24 bits within one second plus a thousandth of
//! the time since the start, up to four seconds, at eight places and wherever a time is looked up. If they do not,
//! the bag is read from its start.

use event_types::stream::Result;
use event_types::{Event, Sensor};

use super::decoder::{Messages, RosDecoder};
use super::message::{Content, Encoding, Head};
use super::message_events::{VECTOR_BASE, VECTOR_X, VectorState};
use super::topics::Topics;
use crate::Skipped;
use crate::evt::evt3::{ADDR_X, ADDR_Y, TIME_BITS, TIME_HIGH, TIME_LOW, VECT_BASE_X, WordDecoder};
use crate::input::Batch;

/// Period in microseconds after which the time of `evt3` wraps.
const PERIOD_US: i64 = 1 << (2 * TIME_BITS);

/// Largest difference between stamps and the sensor's time: a constant, one microsecond more per this many
/// microseconds, and an upper limit.
const APART_US: i64 = 1_000_000;
const APART_PART: i64 = 1000;
const APART_MAX_US: i64 = PERIOD_US / 4;

/// Number of places, spread over the bag, at which the clocks are always compared.
const COMPARED: u128 = 8;

/// A position in the latest message from which events can be read.
struct Start {
    /// Time that no skipped event exceeds.
    t_us: u64,
    /// The computer's time at the arrival of the message.
    stamp_ns: u64,
    content: Content,
    /// The state that earlier words carry over.
    state: State,
}

/// The state that words carry over to later ones.
enum State {
    /// No state.
    Alone,
    Evt3(WordDecoder),
    Vectors(VectorState),
}

/// The error that the sensor's clock and the computer's disagree.
struct ClocksDisagree;

impl RosDecoder {
    /// Goes to the last place whose first event is before a time, or to the beginning; returns `false` if the file
    /// has no places.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(super) fn seek_to(&mut self, t_us: u64) -> Result<bool> {
        let Some(places) = self.messages.places(&mut self.topics)? else {
            return Ok(false);
        };
        let first = self.start_at(0);
        let place = self.last_before(t_us, places, first.as_ref()).unwrap_or(0);
        // As at the beginning, unless a place supplies a state.
        self.events.forget();
        let start = match place {
            0 => None,
            place => self.start_behind(place, first.as_ref()).ok().flatten(),
        };
        let Some(start) = start else {
            self.messages.go(0, &mut self.topics)?;
            return Ok(true);
        };
        self.events.begin(start.content);
        match start.state {
            State::Alone => {}
            State::Evt3(words) => self.events.evt3 = words,
            State::Vectors(words) => self.events.vectors = words,
        }
        Ok(true)
    }

    /// Returns the last of `places` places whose start is before a time; the first place if there is none.
    ///
    /// # Errors
    /// The clocks disagree at some place; that they agree at others may be chance.
    fn last_before(
        &mut self,
        t_us: u64,
        places: u64,
        first: Option<&Start>,
    ) -> Result<u64, ClocksDisagree> {
        if first.is_some_and(|first| matches!(first.state, State::Evt3(_))) {
            for part in 1..=COMPARED {
                let place = u128::from(places.saturating_sub(1)) * part / COMPARED;
                self.start_behind(u64::try_from(place).unwrap_or(0), first)?;
            }
        }
        let (mut place, mut end) = (0, places);
        while end.saturating_sub(place) > 1 {
            let middle = place + (end - place) / 2;
            let start = self.start_behind(middle, first)?;
            match start.is_some_and(|start| start.t_us < t_us) {
                true => place = middle,
                false => end = middle,
            }
        }
        Ok(place)
    }

    /// Returns the start at a place like [`RosDecoder::start_at`], with its time counted from the bag's start,
    /// which is `first`.
    fn start_behind(
        &mut self,
        place: u64,
        first: Option<&Start>,
    ) -> Result<Option<Start>, ClocksDisagree> {
        let (Some(mut start), Some(first)) = (self.start_at(place), first) else {
            return Ok(None);
        };
        match (&first.state, &mut start.state) {
            (State::Alone, State::Alone) | (State::Vectors(_), State::Vectors(_)) => {}
            (State::Evt3(_), State::Evt3(words)) => {
                let since_ns = start.stamp_ns.checked_sub(first.stamp_ns);
                let since_us = since_ns.ok_or(ClocksDisagree)? / 1000;
                let wraps_us = wraps_us(first.t_us, since_us, start.t_us).ok_or(ClocksDisagree)?;
                start.t_us += wraps_us;
                words.add_us(wraps_us);
            }
            // The encoding differs from that at the beginning.
            _ => return Ok(None),
        }
        Ok(Some(start))
    }

    /// Returns the first start after a place; `None` if there are no events, too few words, or damage.
    fn start_at(&mut self, place: u64) -> Option<Start> {
        self.messages.go(place, &mut self.topics).ok()?;
        // Skipped words must not change the reader's state.
        let mut passed = Passed::new(self.events.sensor());
        loop {
            let (messages, topics) = (self.messages.as_mut(), &mut self.topics);
            let head = next(messages, &mut self.events.message, topics)?;
            if (head.width, head.height) != self.told {
                return None;
            }
            if !head.content.is_empty()
                && let Some(start) = passed.take(&self.events.message, &head)?
            {
                return Some(start);
            }
        }
    }
}

/// Returns the head of the next message.
fn next(messages: &mut dyn Messages, message: &mut Vec<u8>, topics: &mut Topics) -> Option<Head> {
    let mut skipped = Skipped::default();
    let (kind, serialisation) = messages.next(message, topics, &mut skipped).ok()??;
    Head::read(message, kind, serialisation).ok()
}

/// Returns the time to add to an `evt3` time `t_us` that counts from its latest wrap and was read `since_us` after
/// `first_us` by the computer's clock; `None` if the two clocks disagree.
fn wraps_us(first_us: u64, since_us: u64, t_us: u64) -> Option<u64> {
    let since_us = i64::try_from(since_us).ok()?;
    let apart_us =
        i64::try_from(first_us).ok()?.checked_add(since_us)? - i64::try_from(t_us).ok()?;
    let wraps_us = apart_us.checked_add(PERIOD_US / 2)?.div_euclid(PERIOD_US) * PERIOD_US;
    let may_be_us = (APART_US + since_us / APART_PART).min(APART_MAX_US);
    let is_near = (apart_us - wraps_us).abs() <= may_be_us;
    u64::try_from(wraps_us).ok().filter(|_| is_near)
}

/// The words skipped after a place, until the state that they carry over is known.
struct Passed {
    evt3: WordDecoder,
    /// Whether both parts of the time, the row, and then a column have occurred.
    high: bool,
    low: bool,
    row: bool,
    column: bool,
    vectors: VectorState,
    /// Whether x and the start of the vectors have occurred.
    x: bool,
    base: bool,
    /// Encoding of the words.
    encoding: Option<Encoding>,
    events: Vec<Event>,
}

impl Passed {
    fn new(sensor: Sensor) -> Self {
        Self {
            evt3: WordDecoder::new(sensor, 0),
            high: false,
            low: false,
            row: false,
            column: false,
            vectors: VectorState::default(),
            x: false,
            base: false,
            encoding: None,
            events: Vec::new(),
        }
    }

    /// Takes a message; returns `Some(None)` if the state is not yet known after it, and `None` on damage or a
    /// change of encoding.
    fn take(&mut self, message: &[u8], head: &Head) -> Option<Option<Start>> {
        let Head {
            content, stamp_ns, ..
        } = *head;
        let start = |t_us, content, state| Start {
            t_us,
            stamp_ns,
            content,
            state,
        };
        if let Some(t_us) = content.first_us(message) {
            // Words of another encoding came before.
            let is_first = self.encoding.is_none();
            return is_first.then(|| Some(start(t_us, content, State::Alone)));
        }
        let Content::Packed {
            encoding,
            base_ns,
            at,
            end,
        } = content
        else {
            return None;
        };
        if *self.encoding.get_or_insert(encoding) != encoding {
            return None;
        }
        self.vectors.message();
        let words = message.get(at..end)?.chunks_exact(2);
        for (number, word) in words.enumerate() {
            let word = u16::from_le_bytes(word.try_into().ok()?);
            let content = Content::Packed {
                encoding,
                base_ns,
                at: at + 2 * (number + 1),
                end,
            };
            if encoding == Encoding::Evt3 {
                if self.evt3(word)? {
                    let sensor = self.evt3.sensor();
                    let words = std::mem::replace(&mut self.evt3, WordDecoder::new(sensor, 0));
                    let t_us = words.t_us()?;
                    return Some(Some(start(t_us, content, State::Evt3(words))));
                }
            } else if self.vector(word) {
                let since_ns = self.vectors.since_us() * 1000;
                let t_us = base_ns.checked_add(since_ns)? / 1000;
                let words = std::mem::take(&mut self.vectors);
                return Some(Some(start(t_us, content, State::Vectors(words))));
            }
        }
        Some(None)
    }

    /// Takes a word of `evt3`; returns whether the state is known after it, `None` if it is damaged.
    fn evt3(&mut self, word: u16) -> Option<bool> {
        self.events.clear();
        let mut batch = Batch::new(&mut self.events);
        let decoded = self.evt3.decode(word, &mut batch, &mut Skipped::default());
        decoded.ok()?;
        match word >> 12 {
            TIME_HIGH => self.high = true,
            TIME_LOW => self.low |= self.high,
            ADDR_Y => self.row = true,
            ADDR_X | VECT_BASE_X => self.column |= self.row,
            _ => {}
        }
        Some(self.high && self.low && self.row && self.column)
    }

    /// Takes a word of `libcaer_cmp`; returns whether the state is known after it.
    fn vector(&mut self, word: u16) -> bool {
        self.vectors.take(word);
        self.x |= word >> 12 == VECTOR_X;
        self.base |= word >> 12 == VECTOR_BASE;
        self.x && self.base
    }
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use event_types::Polarity;

    use super::super::fields::Serialisation;
    use super::super::mcap_writer::Records;
    use super::super::packets::{Message, MessageFile, Packet};
    use super::*;
    use crate::{EventReader, create, open};

    const SENSOR: Sensor = Sensor {
        width: 346,
        height: 260,
    };

    /// Returns events for several chunks, many of them at the same time.
    fn some_events(from: u64, n: u64) -> Vec<Event> {
        (from..from + n)
            .map(|i| Event {
                t_us: 1_700_000_000_000_000 + i / 7 * 7,
                x: (i % 346) as u16,
                y: (i / 346 % 260) as u16,
                polarity: Polarity::from_bool(i % 3 == 0),
            })
            .collect()
    }

    fn write(path: &Path, events: &[Event]) {
        let mut writer = create(path, SENSOR).unwrap();
        writer.write(events).unwrap();
        writer.finish().unwrap();
    }

    fn rest(reader: &mut dyn EventReader) -> Vec<Event> {
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    /// Seeks in `path` to and fro; each time, every event from there on must be read, and at most `before_max`
    /// earlier ones.
    fn check_seeks(path: &Path, want: &[Event], before_max: usize) {
        let mut reader = open(path, None).unwrap();
        assert_eq!(rest(reader.as_mut()), want);
        let (first, last) = (want[0].t_us, want[want.len() - 1].t_us);
        for target in [
            last,
            0,
            first,
            first + 7,
            (first + last) / 2,
            first + (last - first) / 3,
            last - 7,
            last + 1,
            u64::MAX,
        ] {
            assert!(reader.seek(target).unwrap(), "{}", path.display());
            let got = rest(reader.as_mut());
            assert!(want.ends_with(&got), "{}: {target}", path.display());
            let wanted = want.len() - want.partition_point(|event| event.t_us < target);
            assert!(got.len() >= wanted, "{}: {target}", path.display());
            assert!(
                got.len() <= wanted + before_max,
                "{}: {target}: {} events, {wanted} wanted",
                path.display(),
                got.len()
            );
        }
    }

    #[test]
    fn seeking_gives_every_event_from_a_time_on() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 700_000);
        for (name, chunk) in [("a.mcap", 145_000), ("a.bag", 115_000)] {
            let path = folder.path().join(name);
            write(&path, &want);
            check_seeks(&path, &want, chunk);
        }
    }

    #[test]
    fn seeking_goes_over_the_files_of_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| -> PathBuf { folder.path().join(name) };
        let want = some_events(0, 450_000);
        let mut list = "relative_file_paths:\n".to_owned();
        for (number, part) in want.chunks(150_000).enumerate() {
            let name = format!("part_{number}.mcap");
            write(&at(&name), part);
            list += &format!("  - {name}\n");
        }
        std::fs::write(at("metadata.yaml"), list).unwrap();
        check_seeks(folder.path(), &want, 145_000);
    }

    #[test]
    fn without_an_index_nothing_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 300_000);
        for name in ["a.mcap", "a.bag"] {
            let path = folder.path().join(name);
            write(&path, &want);
            let mut bytes = std::fs::read(&path).unwrap();
            bytes.truncate(bytes.len() - 5);
            std::fs::write(&path, &bytes).unwrap();
            let mut reader = open(&path, None).unwrap();
            let mut got = Vec::new();
            reader.read(&mut got).unwrap();
            assert!(!reader.seek(want[200_000].t_us).unwrap());
            while let Ok(1..) = reader.read(&mut got) {}
            assert_eq!(got, want, "{name}");
        }
    }

    /// From an LZ4 chunk that was cut off, whole blocks of 64 kB can be read.
    #[test]
    fn a_chunk_that_was_cut_off_gives_what_it_has() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 100_000);
        let path = folder.path().join("a.mcap");
        write(&path, &want);
        let bytes = std::fs::read(&path).unwrap();
        for part in 1..10 {
            std::fs::write(&path, &bytes[..bytes.len() * part / 10]).unwrap();
            let Ok(mut reader) = open(&path, None) else {
                assert!(part == 1);
                continue;
            };
            let mut got = Vec::new();
            let error = loop {
                match reader.read(&mut got) {
                    Ok(0) => panic!("the cut was not noticed"),
                    Ok(_) => {}
                    Err(error) => break error.to_string(),
                }
            };
            assert!(error.contains("cut off"), "{error}");
            assert!(want.starts_with(&got));
            assert!(
                got.len() + 25_000 > want.len() * part / 10,
                "{part}: {}",
                got.len()
            );
        }
    }

    /// A message that continues where the previous one ended: the computer's time, `time_base`, words.
    type Carried = (u64, u64, Vec<u16>);

    /// Writes a bag of `messages`, a few in each chunk.
    fn write_carried(path: &Path, encoding: &str, messages: &[Carried]) {
        let mut file = Records::create(path, 4000).unwrap();
        for (number, (stamp_us, base_ns, words)) in messages.iter().enumerate() {
            let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            let packet = Packet {
                sequence: number as u64,
                stamp_us: *stamp_us,
                sensor: SENSOR,
                base_ns: *base_ns,
                encoding,
                words: &words,
            };
            let message = Message {
                time_ns: number as u64,
                sequence: number as u64,
                bytes: packet.put(Vec::new(), Serialisation::Cdr),
            };
            file.message(&message).unwrap();
        }
        file.finish().unwrap();
    }

    /// Returns events of 70 s, in runs along x and single, and messages of their words, cut at arbitrary words.
    fn evt3() -> (Vec<Event>, Vec<Carried>) {
        let events: Vec<Event> = (0..60_000_u64)
            .map(|i| {
                let run = i / 5;
                Event {
                    t_us: 5_000_000 + run * 5833,
                    x: (run % 60 * 5 + i % 5 * (1 + run % 4 * 3)) as u16 % 346,
                    y: (run / 11 % 260) as u16,
                    polarity: Polarity::from_bool(run % 7 < 3),
                }
            })
            .collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.raw");
        write(&path, &events);
        let bytes = std::fs::read(&path).unwrap();
        let end = b"% end\n";
        let start = bytes.windows(end.len()).position(|bytes| bytes == end);
        let bytes = &bytes[start.unwrap() + end.len()..];
        let words: Vec<u16> = bytes
            .chunks_exact(2)
            .map(|word| u16::from_le_bytes(word.try_into().unwrap()))
            .collect();
        let mut decoder = WordDecoder::new(SENSOR, 0);
        let messages = words.chunks(301).enumerate().map(|(number, words)| {
            let mut passed = Vec::new();
            for word in words {
                let mut batch = Batch::new(&mut passed);
                let mut skipped = Skipped::default();
                decoder.decode(*word, &mut batch, &mut skipped).unwrap();
            }
            // The computer's clock drifts by one part in 2,000, and stamps come late.
            let t_us = decoder.t_us().unwrap();
            let late_us = number as u64 * 7919 % 300_000;
            let stamp_us = 1_700_000_000_000_000 + t_us + t_us / 2000 + late_us;
            (stamp_us, 0, words.to_vec())
        });
        let messages = messages.collect();
        (events, messages)
    }

    #[test]
    fn words_of_evt3_are_found_over_wraps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (want, messages) = evt3();
        assert!(want.last().unwrap().t_us > 4 << (2 * TIME_BITS));
        assert!(messages.len() > 100);
        write_carried(&path, "evt3", &messages);
        check_seeks(&path, &want, 6000);
        // If the stamps are meaningless or wrong, reading begins at the start.
        let stamps: [fn(u64) -> u64; 4] = [
            |_| 0,
            |t_us| t_us / 2,
            |t_us| 3_500_000_000_000_000 - t_us,
            |t_us| t_us + t_us % 3 * 5_000_000,
        ];
        for stamp in stamps {
            let mut messages = messages.clone();
            for (stamp_us, ..) in &mut messages {
                *stamp_us = stamp(*stamp_us);
            }
            write_carried(&path, "evt3", &messages);
            check_seeks(&path, &want, want.len());
        }
    }

    /// Returns events, many in the same column, and messages whose words state only what changes.
    fn libcaer_cmp() -> (Vec<Event>, Vec<Carried>) {
        let base_us = |t_us: u64| t_us / 10_000 * 10_000;
        let (mut events, mut messages) = (Vec::new(), Vec::<Carried>::new());
        let (mut x, mut below) = (None, None);
        let mut since = None;
        for run in 0..20_000_u64 {
            let t_us = 1_700_000_000_000_000 + run * 37;
            let polarity = Polarity::from_bool(run % 5 < 2);
            let on = u16::from(polarity == Polarity::On) << 11;
            let (column, y) = ((run / 9 % 346) as u16, (run * 13 % 250) as u16);
            let base_ns = base_us(t_us) * 1000;
            if messages
                .last()
                .is_none_or(|(_, last_ns, _)| *last_ns != base_ns)
            {
                messages.push((0, base_ns, Vec::new()));
                since = None;
            }
            let (.., words) = messages.last_mut().unwrap();
            let now = (t_us - base_us(t_us)) as u16;
            if since != Some(now) {
                words.extend([now >> 12, 0x1000 | now & 0xfff]);
                since = Some(now);
            }
            if x != Some(column) {
                words.push(0x2000 | column);
                x = Some(column);
            }
            let rows: Vec<u16> = if run % 3 == 0 {
                vec![0, 2, 3, 7]
            } else {
                vec![0]
            };
            if rows.len() == 1 {
                words.push(0x3000 | on | y);
            } else {
                if below != Some((y, on)) {
                    words.push(0x4000 | on | y);
                }
                words.push(0x5000 | rows.iter().map(|row| 1 << row).sum::<u16>());
                below = Some((y + 8, on));
            }
            events.extend(rows.iter().map(|row| Event {
                t_us,
                x: column,
                y: y + row,
                polarity,
            }));
        }
        (events, messages)
    }

    #[test]
    fn words_of_libcaer_cmp_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (want, messages) = libcaer_cmp();
        write_carried(&path, "libcaer_cmp", &messages);
        check_seeks(&path, &want, 4000);
    }

    #[test]
    fn wraps_are_told_by_clocks_that_agree() {
        let period = PERIOD_US as u64;
        for (first, since, t, want) in [
            (0, 0, 0, Some(0)),
            (5, 3 * period, 5, Some(3 * period)),
            // Across a wrap.
            (period - 9, 20, 11, Some(period)),
            // Up to a second too early or too late.
            (0, period + 999_999, 0, Some(period)),
            (0, period - 999_999, 0, Some(period)),
            (0, 999_999, period - 1, None),
            (0, period + 1_100_000, 0, None),
            (0, period / 2, 0, None),
            // A thousandth of the elapsed time, up to 4 s.
            (0, 100 * period + 2_000_000, 0, Some(100 * period)),
            (0, 10_000 * period + 4_100_000, 0, Some(10_000 * period)),
            (0, 10_000 * period + 4_300_000, 0, None),
            (0, u64::MAX, 0, None),
        ] {
            assert_eq!(wraps_us(first, since, t), want, "{first} {since} {t}");
        }
    }
}
