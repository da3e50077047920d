//! Reads zip files of one recording, as data sets are published: the Event Camera Dataset's `events.txt` beside
//! pictures and calibrations, N-MNIST's `.bin`, or a `.raw` or `.aedat4` that was zipped to be sent.
//!
//! The recording is unpacked into an unnamed temporary file, since readers seek. It is the only entry with a
//! recording's ending; if there are several, the one called `events`, otherwise the only one that is not text (a
//! text may be a `readme.txt`); otherwise the user appends its name to the file's: `FILE.zip/NAME`. Zip files
//! inside zip files are not read, but npz files are.

use std::io::{Read, Seek, Write};

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail, ensure};

use crate::format::{FORMATS, open_source};
use crate::input::adjusted::With;
use crate::numpy::npz;
use crate::output::temporary::copy;
use crate::reading::Reading;
use crate::zipped::entry::{Entries, Entry};
use crate::{Assumption, EventReader, Pause, Skipped, text};

/// Largest number of names that a message lists.
const LIST_MAX: usize = 24;

/// Ending of arrays; a zip file that has one is an npz file.
const ARRAY: &str = ".npy";

/// Returns whether a zip file holds no arrays, or the named place in it is not an array.
pub fn holds_one(entries: &Entries, place: Option<&str>) -> bool {
    let is_array = |entry: &Entry| entry.name.ends_with(ARRAY);
    let named = entries.iter().filter(|entry| place == Some(&entry.name));
    !entries.iter().any(is_array) || named.into_iter().any(|entry| !is_array(entry))
}

/// Opens the recording in a zip file.
///
/// # Errors
/// The zip file has no recording or several; the recording is damaged; otherwise those of [`crate::open`].
pub fn open(
    entries: &Entries,
    name: &str,
    place: Option<&str>,
    reading: &Reading,
) -> Result<Box<dyn EventReader>> {
    let entry = find(entries, name, place)?;
    let inside = format!("{name}/{}", entry.name);
    let failed = || format!("{inside}: cannot be unpacked");
    let mut file = tempfile::tempfile().with_context(failed)?;
    let mut unpacked = entries.open(entry);
    copy(&mut unpacked, &mut file, &inside).with_context(failed)?;
    ensure!(
        !unpacked.is_damaged(),
        Damaged,
        "{inside}: its CRC-32 is wrong: damaged data"
    );
    file.flush()
        .and_then(|()| file.rewind())
        .with_context(failed)?;
    let mut magic = [0; 4];
    let begins = file.read(&mut magic).with_context(failed)?;
    file.rewind().with_context(failed)?;
    let reader = if begins == magic.len() && &magic == npz::MAGIC {
        npz::open_arrays(Box::new(file), &inside, reading)?
    } else {
        open_source(Box::new(file), &inside, reading)?
    };
    let mut others = Skipped::default();
    let files = entries.iter().filter(|entry| !is_folder(entry)).count();
    others.add("other files of the zip", files.saturating_sub(1) as u64);
    let is_chosen = place.is_none() && recordings(entries).count() > 1;
    let chosen = is_chosen.then(|| Assumption {
        what: "recording",
        taken: entry.name.clone(),
        why: format!(
            "it is called events or is the only one that is not text; {name}/NAME chooses another"
        ),
    });
    let assumptions = With::new(reader.as_ref(), chosen);
    Ok(Box::new(Inside {
        skipped: all(reader.skipped(), &others),
        reader,
        others,
        assumptions,
    }))
}

/// Finds the recording's entry.
fn find<'a>(entries: &'a Entries, name: &str, place: Option<&str>) -> Result<&'a Entry> {
    if let Some(place) = place {
        let found = entries.iter().find(|entry| entry.name == place);
        return found.with_context(|| {
            format!(
                "{name}: byte 0: the zip file holds no {place}, only {}",
                list(entries.iter())
            )
        });
    }
    let found: Vec<&Entry> = recordings(entries).collect();
    if let [only] = found.as_slice() {
        return Ok(only);
    }
    let called = found.iter().filter(|entry| {
        let file = entry.name.rsplit('/').next().unwrap_or_default();
        file.split('.').next() == Some("events")
    });
    let called: Vec<&&Entry> = called.collect();
    let is_text = |entry: &Entry| {
        let name = entry.name.to_ascii_lowercase();
        let mut endings = [text::FORMAT, text::CSV_FORMAT]
            .iter()
            .flat_map(|format| format.endings);
        endings.any(|ending| name.ends_with(ending))
    };
    let binary: Vec<&&Entry> = found.iter().filter(|entry| !is_text(entry)).collect();
    match (called.as_slice(), binary.as_slice()) {
        ([only], _) | ([], [only]) => Ok(only),
        _ if found.is_empty() => bail!(
            Unsupported,
            "{name}: byte 0: neither arrays nor a recording in the zip file, only {}",
            list(entries.iter())
        ),
        _ => bail!(
            Undecided,
            "{name}: byte 0: several recordings in the zip file: {}: name one, as in {name}/{}",
            list(found.iter().copied()),
            found.first().map_or("", |entry| entry.name.as_str())
        ),
    }
}

/// Returns the entries with endings of recordings, without the files that systems and cameras add.
fn recordings(entries: &Entries) -> impl Iterator<Item = &Entry> {
    entries.iter().filter(|entry| {
        let lower = entry.name.to_ascii_lowercase();
        let mut parts = lower.split('/');
        let is_hidden = parts.any(|part| part.starts_with('.') || part == "__macosx");
        let endings = FORMATS.iter().flat_map(|format| format.endings);
        !is_hidden && !is_folder(entry) && endings.into_iter().any(|ending| lower.ends_with(ending))
    })
}

fn is_folder(entry: &Entry) -> bool {
    entry.name.ends_with('/')
}

fn list<'a>(entries: impl Iterator<Item = &'a Entry>) -> String {
    let names = entries.filter(|entry| !is_folder(entry));
    let names: Vec<&str> = names
        .map(|entry| entry.name.as_str())
        .take(LIST_MAX)
        .collect();
    names.join(", ").escape_debug().to_string()
}

fn all(one: &Skipped, other: &Skipped) -> Skipped {
    let mut all = one.clone();
    other.iter().for_each(|(kind, count)| all.add(kind, count));
    all
}

/// A reader of the recording that also counts the other files.
struct Inside {
    reader: Box<dyn EventReader>,
    others: Skipped,
    skipped: Skipped,
    assumptions: With,
}

impl EventReader for Inside {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.assumptions.all()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let read = self.reader.read(events);
        self.skipped = all(self.reader.skipped(), &self.others);
        self.assumptions.update(self.reader.as_ref());
        read
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.reader.seek(t_us)
    }

    fn pause(&self) -> Pause {
        self.reader.pause()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
