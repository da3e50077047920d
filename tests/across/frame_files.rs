//! Files of frames: their end marks show what is missing, and their index finds any time.

use std::collections::HashSet;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::num::{NonZeroU32, NonZeroUsize};
use std::ops::Range;

use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, encode};
use eecvs::frame_file::index::Index;
use eecvs::frame_file::mark::{self, BEGIN, End, Mark, MarkError, Segment, Stretch, Totals};
use eecvs::frame_file::{FrameFileWriter, FrameReader, FrameSink, LinkReport};
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs_nostd::{
    Coder, Config, Density, Effort, Event, Fidelity, Header, Hybrid, Mode, Scan, Sensor,
    Thresholds, WindowConfig, scan,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::{EventReader, Skipped};
use proptest::prelude::*;

/// Events in memory.
struct Memory(Sensor, Vec<Event>, Skipped);

impl EventReader for Memory {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.0
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let read = self.1.len();
        events.append(&mut self.1);
        Ok(read)
    }

    fn skipped(&self) -> &Skipped {
        &self.2
    }
}

const SENSOR: Sensor = Sensor {
    width: 64,
    height: 48,
};

fn events(duration_us: u64) -> Vec<Event> {
    let scene = SceneConfig {
        sensor: SENSOR,
        duration_us,
        ..SceneConfig::model_1(Preset::OutdoorWellLitBlur, 7)
    };
    let mut reader = emulate(scene).expect("a scene");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("events") > 0 {}
    events
}

fn encoded(events: Vec<Event>, coder: Coder, key_windows: u16, out: &mut dyn FrameSink) {
    encoded_as(events, config(coder, key_windows), out);
}

fn config(coder: Coder, key_windows: u16) -> Config {
    let mode = Mode::Hybrid(Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    });
    Config {
        key_windows,
        ..Config::new(
            WindowConfig::new(SENSOR, 4096),
            Thresholds::new(0, 0).expect("equal thresholds"),
            mode,
        )
    }
}

fn encoded_as(events: Vec<Event>, config: Config, out: &mut dyn FrameSink) {
    let mut reader = Memory(SENSOR, events, Skipped::default());
    let threads = NonZeroUsize::MIN;
    encode(
        &mut reader,
        config,
        Limits::default(),
        threads,
        out,
        &mut |_| {},
    )
    .expect("encoded");
}

fn file(events: &[Event], coder: Coder) -> Vec<u8> {
    let mut out = FrameFileWriter::new(Vec::new());
    encoded(events.to_vec(), coder, 8, &mut out);
    out.finish().expect("memory")
}

fn stream(events: &[Event], coder: Coder) -> Vec<u8> {
    let mut out = Vec::new();
    encoded(events.to_vec(), coder, 8, &mut out);
    out
}

/// Returns the frames' bytes and the report.
fn read(bytes: &[u8]) -> (Vec<u8>, LinkReport) {
    let mut reader = FrameReader::new(bytes);
    let mut frames = Vec::new();
    while let Some(located) = reader.next_frame().expect("memory") {
        frames.extend(located.bytes);
    }
    (frames, reader.report().clone())
}

fn end_mark_of(file: &[u8]) -> (usize, End) {
    let size = u32::from_le_bytes(file[file.len() - 8..file.len() - 4].try_into().expect("4"));
    let at = file.len() - size as usize;
    match Mark::parse(&file[at..]) {
        Ok((Mark::End(end), bytes)) => {
            assert_eq!(bytes, size as usize);
            (at, end)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn marks_surround_the_frames_of_the_stream() {
    let events = events(200_000);
    let (file, stream) = (file(&events, Coder::Dense), stream(&events, Coder::Dense));
    let (at, end) = end_mark_of(&file);
    assert_eq!(file[..BEGIN.len()], BEGIN);
    assert_eq!(end.totals.bytes, (at - BEGIN.len()) as u64);
    assert_eq!(end.totals.events, events.len() as u64);
    assert_eq!(end.totals.runs, 1);

    let (frames, report) = read(&file);
    assert_eq!(frames, stream);
    assert_eq!((report.segments_ended, report.frames_unmarked), (1, 0));
    assert!(report.is_clean() && !report.has_loss());
    let (frames, report) = read(&stream);
    assert_eq!(frames, stream);
    assert_eq!(
        (report.segments_ended, report.frames_unmarked),
        (0, report.frames)
    );
    assert!(report.is_clean() && !report.has_loss());
}

#[test]
fn every_cut_is_noticed_and_everything_before_it_is_given() {
    let file = file(&events(60_000), Coder::Fast);
    let stream = read(&file).0;
    let (at, _) = end_mark_of(&file);
    for cut in (0..file.len()).filter(|cut| cut % 37 == 0 || *cut + 200 > at) {
        let (frames, report) = read(&file[..cut]);
        assert!(stream.starts_with(&frames), "{cut}");
        let is_begun = cut >= BEGIN.len();
        assert_eq!(report.segments_cut_short, u64::from(is_begun), "{cut}");
        assert_eq!(report.has_loss(), cut > 0, "{cut}");
        assert_eq!(frames.len() == stream.len(), cut >= at, "{cut}");
    }
}

#[test]
fn every_flipped_bit_is_noticed() {
    let file = file(&events(20_000), Coder::Fast);
    for at in 0..file.len() {
        let mut damaged = file.clone();
        damaged[at] ^= 1 << (at % 8);
        let report = read(&damaged).1;
        assert!(report.has_loss(), "{at}: {report:?}");
    }
}

/// Short frames are the same frames, bit for bit.
#[test]
fn short_frames_save_most_of_a_header() {
    let all = events(2_000_000);
    // Windows of some events, with pauses; of one polarity now and then, and of another regime.
    let sparse: Vec<Event> = all
        .iter()
        .copied()
        .filter(|event| event.x % 16 == 0 && event.t_us / 50_000 % 3 != 1)
        .collect();
    for coder in [Coder::Fast, Coder::Dense] {
        let (file, stream) = (file(&sparse, coder), stream(&sparse, coder));
        let (frames, report) = read(&file);
        assert_eq!(frames, stream);
        let (at, _) = end_mark_of(&file);
        let saved = (stream.len() - (at - BEGIN.len())) as u64;
        assert!(
            saved > 14 * report.frames,
            "{saved} of {} frames",
            report.frames
        );
    }
}

/// Frames whose fidelity changes from window to window are short all the same.
#[test]
fn short_frames_say_another_fidelity() {
    let all = events(2_000_000);
    let sparse: Vec<Event> = all.into_iter().filter(|event| event.x % 16 == 0).collect();
    for coder in [Coder::Fast, Coder::Dense] {
        let config = Config {
            max_emd_us: NonZeroU32::new(300),
            ..config(coder, 8)
        };
        let (mut file, mut stream) = (FrameFileWriter::new(Vec::new()), Vec::new());
        encoded_as(sparse.clone(), config, &mut file);
        encoded_as(sparse.clone(), config, &mut stream);
        let file = file.finish().expect("memory");
        let (frames, report) = read(&file);
        assert_eq!(frames, stream);
        let mut changes = HashSet::new();
        let mut reader = FrameReader::new(&file[..]);
        while let Some(located) = reader.next_frame().expect("memory") {
            changes.insert(located.frame.header.mode);
        }
        assert!(changes.len() > 1, "{changes:?}");
        let (at, _) = end_mark_of(&file);
        let saved = (stream.len() - (at - BEGIN.len())) as u64;
        assert!(
            saved > 12 * report.frames,
            "{saved} of {} frames",
            report.frames
        );
    }
}

/// A reader goes on at the next whole frame.
#[test]
fn damage_costs_some_kilobytes_at_most() {
    let file = file(&events(2_000_000), Coder::Fast);
    let (at, _) = end_mark_of(&file);
    let all = read(&file).0.len();
    for place in (BEGIN.len()..at).step_by(4_999) {
        let mut damaged = file.clone();
        damaged[place] ^= 0x10;
        let (frames, report) = read(&damaged);
        assert!(report.damaged_bytes > 0 && report.has_loss(), "{place}");
        // The frames of 8 KiB, as long as they would be with their headers, and those at both ends.
        assert!(
            all - frames.len() < 20_000,
            "{place}: {}",
            all - frames.len()
        );
    }
}

/// Windows of three densities in turn, in runs of a few windows to some hundred.
fn of_all_regimes() -> (Vec<Event>, Thresholds) {
    let kept = |window: u64| match (window / 7 % 3, window / 150 % 3) {
        (0, _) | (_, 0) => 6,
        (1, _) | (_, 1) => 3,
        _ => 1,
    };
    let all = events(3_000_000).into_iter();
    let events = all.filter(|event| u64::from(event.x) * 31 % kept(event.t_us / 4096) == 0);
    let events: Vec<Event> = events.collect();
    let windows = 3_000_000 / 4096;
    // Of the windows' numbers of events, a third and two thirds.
    let mut counts = vec![0_u32; windows + 1];
    for event in &events {
        counts[(event.t_us / 4096) as usize] += 1;
    }
    counts.sort_unstable();
    let tau = |at: usize| {
        let density = Density {
            events: counts[at],
            pixels: SENSOR.pixels(),
            duration_us: 4096,
        };
        (density.per_pixel_s() * 1e12) as u64
    };
    let thresholds = Thresholds::new(tau(windows / 3), tau(windows * 2 / 3)).expect("ordered");
    (events, thresholds)
}

/// Short frames follow from the latest one of their regime, which a reader that begins at a stretch, or goes on after
/// damage, may not have read.
#[test]
fn frames_of_every_regime_are_found_from_any_stretch() {
    let (events, thresholds) = of_all_regimes();
    for coder in [Coder::Fast, Coder::Keys, Coder::Quick, Coder::Dense] {
        let mut out = FrameFileWriter::new(Vec::new());
        let config = Config {
            thresholds,
            ..config(coder, 8)
        };
        encoded_as(events.clone(), config, &mut out);
        let file = out.finish().expect("memory");
        let (_, end) = end_mark_of(&file);
        assert!(
            end.stretches.len() > 5,
            "{coder:?}: {}",
            end.stretches.len()
        );
        let mut regimes = HashSet::new();
        let mut reader = FrameReader::new(&file[..]);
        while let Some(located) = reader.next_frame().expect("memory") {
            regimes.insert(located.frame.header.regime);
        }
        assert_eq!(regimes.len(), 3);
        for stretch in &end.stretches {
            // The whole stretch, and its last millisecond.
            for from in [stretch.start_us, stretch.end_us - 1000] {
                let times = from..stretch.end_us;
                let wanted = events.iter().filter(|event| times.contains(&event.t_us));
                let found = between(&file, times.clone()).0;
                assert_eq!(found.len(), wanted.count(), "{coder:?} {times:?}");
            }
        }
        let (at, _) = end_mark_of(&file);
        let all = read(&file).0.len();
        for place in (BEGIN.len()..at).step_by(7_919) {
            let mut damaged = file.clone();
            damaged[place] ^= 0x10;
            let lost = all - read(&damaged).0.len();
            assert!(lost < 24_000, "{coder:?}, {place}: {lost}");
        }
    }
}

/// The numbers of frames do not show that the last ones are missing, nor that a file has another one's frames.
#[test]
fn frames_that_are_missing_at_the_end_are_noticed() {
    let file = file(&events(60_000), Coder::Fast);
    let (at, _) = end_mark_of(&file);
    let mut reader = FrameReader::new(&file[..]);
    let mut last = 0;
    while let Some(located) = reader.next_frame().expect("memory") {
        last = located.offset as usize;
    }
    let shorter = [&file[..last], &file[at..]].concat();
    let report = read(&shorter).1;
    assert_eq!((report.frames_lost, report.segments_different), (0, 1));
    assert!(report.has_loss());
}

#[test]
fn files_put_end_to_end_are_read_as_such() {
    let events = events(60_000);
    let (file, stream) = (file(&events, Coder::Dense), stream(&events, Coder::Dense));
    for (parts, ended, unmarked, cut_short) in [
        (vec![&file[..], &file], 2, false, 0),
        (vec![&file[..], &file, &file], 3, false, 0),
        (vec![&stream[..], &file], 1, true, 0),
        (vec![&file[..], &stream], 1, true, 0),
        (vec![&file[..], &BEGIN, &file], 2, false, 1),
        (vec![&BEGIN[..], &stream, &file], 1, false, 1),
        (vec![&BEGIN[..]], 0, false, 1),
    ] {
        let report = read(&parts.concat()).1;
        assert_eq!(report.segments_ended, ended, "{report:?}");
        assert_eq!(report.frames_unmarked > 0, unmarked, "{report:?}");
        assert_eq!(report.segments_cut_short, cut_short, "{report:?}");
        assert_eq!(report.segments_different, 0, "{report:?}");
    }
    // A file that is shorter than what repetitions are looked for in, too.
    let short = self::file(&events[..100], Coder::Fast);
    let (frames, report) = read(&[&short[..], &short].concat());
    assert_eq!(frames, [read(&short).0, read(&short).0].concat());
    assert_eq!((report.frames_repeated, report.restarts), (0, 1));
}

/// The mark that a stream or a cut file lacks is the one that a writer would have put there, damage aside.
#[test]
fn the_missing_mark_is_the_writers() {
    let events = events(200_000);
    let (file, stream) = (file(&events, Coder::Fast), stream(&events, Coder::Fast));
    let (at, end) = end_mark_of(&file);
    for bytes in [&stream[..], &file[..at], &file] {
        let mut reader = FrameReader::new(bytes);
        while reader.next_frame().expect("memory").is_some() {}
        let missing = reader.missing_end(bytes.len() as u64);
        match missing {
            Some(missing) if bytes.len() == at => assert_eq!(missing, end),
            Some(missing) => {
                // Its frames are not short.
                assert_eq!(bytes.len(), stream.len());
                assert_eq!(missing.totals.bytes, stream.len() as u64);
                assert!(missing.totals.has_same_frames(&end.totals));
            }
            None => assert_eq!(bytes.len(), file.len()),
        }
    }
    // Behind damage, before which one frame is gone.
    let mut damaged = stream;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    damaged.extend(b"and what was never a frame");
    let mut reader = FrameReader::new(&damaged[..]);
    while reader.next_frame().expect("memory").is_some() {}
    let missing = reader.missing_end(damaged.len() as u64).expect("a mark");
    assert_eq!(missing.totals.bytes, damaged.len() as u64);
    damaged.extend(missing.to_bytes());
    let report = read(&damaged).1;
    assert_eq!((report.segments_ended, report.segments_different), (1, 0));
    let index = Index::read(&mut Cursor::new(&damaged)).expect("memory");
    assert!(index.is_some());
}

/// Counts the bytes that are read.
struct Counted<'b>(Cursor<&'b [u8]>, u64);

impl Read for Counted<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(bytes)?;
        self.1 += read as u64;
        Ok(read)
    }
}

impl Seek for Counted<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

/// Returns the events of these times, and how many bytes were read for them.
fn between(file: &[u8], times: Range<u64>) -> (Vec<Event>, u64) {
    let mut source = Counted(Cursor::new(file), 0);
    let mut reader = WindowReader::new(FrameReader::new(&mut source));
    assert!(reader.seek(times.clone()).expect("memory"));
    let mut decoder = EventDecoder::new(Finder::default());
    let mut events = Vec::new();
    while let Some(mut window) = reader.next_window().expect("memory") {
        decoder.fill(&mut window);
        events.extend(
            window
                .events
                .iter()
                .filter(|event| times.contains(&event.t_us)),
        );
    }
    assert!(!reader.report().has_loss(), "{:?}", reader.report());
    (events, source.1)
}

fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_unstable_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
    events
}

#[test]
fn any_times_are_found() {
    // A clock that falls back, twice.
    let mut events = events(400_000);
    let again: Vec<Event> = events.iter().copied().step_by(3).collect();
    events.extend(&again);
    events.extend(again.iter().map(|event| Event {
        t_us: event.t_us + 100_000,
        ..*event
    }));
    for coder in [Coder::Fast, Coder::Dense, Coder::Tree(Effort::One)] {
        let one = file(&events, coder);
        for (file, copies) in [(one.clone(), 1), ([one.clone(), one].concat(), 2)] {
            let all = sorted(between(&file, 0..u64::MAX).0);
            assert_eq!(all, sorted(events.repeat(copies)));
            for from in (0..620_000).step_by(29_501) {
                for span in [0, 1, 1000, 40_000, 700_000] {
                    let times = from..from + span;
                    let wanted = all.iter().filter(|event| times.contains(&event.t_us));
                    let wanted: Vec<Event> = wanted.copied().collect();
                    assert_eq!(sorted(between(&file, times.clone()).0), wanted, "{times:?}");
                }
            }
        }
    }
}

/// Windows before those of the times, in the same stretch of the file, are decoded only if these depend on them.
#[test]
fn only_the_windows_of_the_times_are_decoded() {
    let events = events(3_000_000);
    let tree = Coder::Tree(Effort::One);
    for (coder, key_windows) in [(Coder::Fast, 8), (Coder::Keys, 8), (tree, 1), (tree, 8)] {
        let mut out = FrameFileWriter::new(Vec::new());
        encoded(events.clone(), coder, key_windows, &mut out);
        let file = out.finish().expect("memory");
        let stands_alone = coder != tree || key_windows == 1;
        let mut most_before = 0;
        for from in (100_000..3_000_000).step_by(300_007) {
            let times = from..from + 1000;
            let mut reader = WindowReader::new(FrameReader::new(Cursor::new(&file)));
            assert!(reader.seek(times.clone()).expect("memory"));
            let mut wanted = 0;
            while let Some(window) = reader.next_window().expect("memory") {
                wanted += u64::from(window.header.window_events);
            }
            assert!(wanted > 0, "{from}: no events");
            let before = reader.counts().events_exact - wanted;
            assert!(!stands_alone || before == 0, "{coder:?}, {from}: {before}");
            most_before = most_before.max(before);
        }
        assert!(
            stands_alone || most_before > 0,
            "no window has one before it"
        );
    }
}

/// The work for a millisecond does not grow with the file.
#[test]
fn a_millisecond_takes_a_stretch_and_the_index() {
    let events = events(3_000_000);
    let file = file(&events, Coder::Fast);
    let (at, end) = end_mark_of(&file);
    let mark_bytes = (file.len() - at) as u64;
    // The index is at most 0.5 % of a file.
    assert!(
        200 * mark_bytes <= file.len() as u64,
        "{mark_bytes} of {}",
        file.len()
    );
    let stretch = end
        .stretches
        .iter()
        .map(|stretch| stretch.bytes)
        .max()
        .expect("some");
    assert!(stretch < 32_768, "{stretch}");
    for from in (0..3_000_000).step_by(100_003) {
        let (_, bytes) = between(&file, from..from + 1000);
        // The mark and its size, the begin mark, and the stretches of the windows at both ends.
        assert!(bytes <= mark_bytes + 20 + 3 * stretch, "{from}: {bytes}");
    }
}

#[test]
fn what_is_before_an_old_file_is_found_by_reading_it() {
    let events = events(60_000);
    let (file, stream) = (file(&events, Coder::Fast), stream(&events, Coder::Dense));
    let joined = [&stream[..], &file].concat();
    let all = between(&joined, 0..u64::MAX).0;
    assert_eq!(all.len(), 2 * events.len());
    let some = between(&joined, 10_000..20_000).0;
    let wanted = all
        .iter()
        .filter(|event| (10_000..20_000).contains(&event.t_us));
    assert_eq!(some.len(), wanted.count());
    // No index: nothing changes.
    for bytes in [
        &stream[..],
        &[&file[..], &stream].concat(),
        &file[1..],
        b"",
        b"text",
    ] {
        let index = Index::read(&mut Cursor::new(bytes)).expect("memory");
        let whole_end = bytes.ends_with(&file[file.len() - 8..]) && bytes.len() + 1 == file.len();
        assert_eq!(index.is_some(), whole_end);
    }
}

/// An index that lies would let events be missed where it is used.
#[test]
fn an_index_of_other_frames_is_noticed() {
    let file = file(&events(2_000_000), Coder::Fast);
    let (at, end) = end_mark_of(&file);
    assert!(end.stretches.len() > 3);
    let mut lies = vec![end.clone(); 5];
    lies[0].stretches[1].start_us += 1;
    lies[1].stretches[1].end_us -= 1;
    lies[2].stretches[1].bytes += 12;
    lies[2].stretches[2].bytes -= 12;
    lies[3].stretches[1].events += 1;
    lies[3].stretches[2].events -= 1;
    lies[4].totals.hash ^= 1;
    for (number, lie) in lies.iter().enumerate() {
        let lying = [&file[..at], &lie.to_bytes()].concat();
        let report = read(&lying).1;
        assert_eq!(report.segments_different, 1, "{number}");
        assert!(report.has_loss(), "{number}");
    }
    assert_eq!(
        read(&[&file[..at], &end.to_bytes()].concat())
            .1
            .segments_ended,
        1
    );
}

/// A header for frames that are never decoded.
fn header(number: u32) -> Header {
    let bytes = stream(&events(5_000), Coder::Fast);
    let Scan::Frame(frame) = scan(&bytes) else {
        panic!("no frame");
    };
    Header {
        sequence: number,
        ..frame.header
    }
}

#[test]
fn the_index_of_a_long_file_is_bounded() {
    let mut segment = Segment::default();
    let (frame, header) = (vec![7; 9000], header(0));
    for number in 0..200_000_u64 {
        let header = Header {
            t0_us: number * 4096,
            duration_us: 4096,
            ..header
        };
        segment.add(&header, &frame);
    }
    let end = segment.end();
    assert!((mark::STRETCHES_MAX / 2..=mark::STRETCHES_MAX).contains(&end.stretches.len()));
    let bytes = end.to_bytes();
    assert!(bytes.len() < 2 << 20, "{}", bytes.len());
    assert_eq!(
        Mark::parse(&bytes),
        Ok((Mark::End(end.clone()), bytes.len()))
    );
    let mut at = 0;
    for stretch in &end.stretches {
        assert_eq!(stretch.offset, at);
        assert_eq!(stretch.start_us, stretch.offset / 9000 * 4096);
        at += stretch.bytes;
    }
    assert_eq!(at, end.totals.bytes);
}

/// Prefixes that claim the largest mark, end to end; checking each of them would take hours.
#[test]
fn marks_claimed_inside_of_each_other_cost_no_more_than_their_length() {
    let size = (mark::MARK_BYTES_MAX - 12) as u32;
    let mut claim = vec![0xEE, 0xC8, 1, 1];
    claim.extend(size.to_le_bytes());
    let stream: Vec<u8> = claim.into_iter().cycle().take(64 << 20).collect();
    let mut reader = FrameReader::new(&stream[..]);
    assert!(reader.next_frame().expect("memory").is_none());
    assert_eq!(reader.report().damaged_bytes, stream.len() as u64);
    // Four times the stream and the longest message, and each byte once more.
    assert!(
        reader.checked_bytes() <= 6 * stream.len() as u64,
        "{}",
        reader.checked_bytes()
    );
}

fn stretch() -> impl Strategy<Value = Stretch> {
    let count = prop_oneof![0..300_u64, 0..u64::from(u32::MAX)];
    let time = prop_oneof![0..1_000_000_u64, any::<u64>()];
    (
        [count.clone(), count.clone(), count.clone(), count],
        time,
        any::<u32>(),
    )
        .prop_map(
            |([bytes, frames, events, runs], start_us, span_us)| Stretch {
                offset: 0,
                bytes,
                frames,
                events,
                runs,
                start_us,
                end_us: start_us.saturating_add(span_us.into()),
            },
        )
}

proptest! {
    #[test]
    fn marks_come_back(stretches in proptest::collection::vec(stretch(), 0..20), hash: u32) {
        let mut end = End { totals: Totals { hash, ..Totals::default() }, stretches };
        for stretch in &mut end.stretches {
            stretch.offset = end.totals.bytes;
            end.totals.bytes += stretch.bytes;
            end.totals.frames += stretch.frames;
            end.totals.events += stretch.events;
            end.totals.runs += stretch.runs;
        }
        let mut bytes = end.to_bytes();
        let size = bytes.len();
        prop_assert_eq!(Mark::parse(&bytes), Ok((Mark::End(end), size)));
        for cut in 0..size {
            prop_assert_eq!(Mark::parse(&bytes[..cut]), Err(MarkError::Incomplete));
        }
        bytes[size / 2] ^= 1;
        prop_assert!(Mark::parse(&bytes).is_err());
    }

    /// Whatever bytes a file ends with, its index is refused or read, and reading goes on.
    #[test]
    fn any_bytes_behind_a_file(tail in proptest::collection::vec(any::<u8>(), 1..60), from: u16) {
        let mut bytes = file(&events(5_000), Coder::Fast);
        bytes.extend(tail);
        let mut reader = WindowReader::new(FrameReader::new(Cursor::new(&bytes)));
        reader.seek(u64::from(from)..u64::MAX).expect("memory");
        while reader.next_window().expect("memory").is_some() {}
    }
}
