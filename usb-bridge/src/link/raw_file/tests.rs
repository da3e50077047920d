//! Tests of stream files.

use std::io::{Cursor, Read, Seek};
use std::time::Duration;

use proptest::prelude::*;

use super::*;

pub(crate) fn header() -> Header {
    Header {
        model: "davis346".to_owned(),
        name: "DAVIS346".to_owned(),
        serial: Some("00000123".to_owned()),
        firmware: "logic 18".to_owned(),
        stream: "davis".to_owned(),
        sensor: Sensor {
            width: 346,
            height: 260,
        },
        started_ns: 1_700_000_000_000_000_000,
        program: "test".to_owned(),
    }
}

type Told = (Duration, Result<Vec<u8>, (Option<u64>, Loss)>);

fn write(records: &[Told]) -> Vec<u8> {
    let mut writer = RawWriter::new(Vec::new(), &header()).unwrap();
    for (time, record) in records {
        match record {
            Ok(bytes) => writer.bytes(*time, bytes).unwrap(),
            Err((bytes, cause)) => writer.lost(*time, *bytes, *cause).unwrap(),
        }
    }
    writer.finish().unwrap()
}

fn read<R: Read + Seek>(reader: &mut RawReader<R>) -> Vec<Told> {
    let (mut all, mut bytes) = (Vec::new(), Vec::new());
    while let Some(record) = reader.next(&mut bytes).unwrap() {
        all.push(match record {
            Record::Bytes { time } => (time, Ok(bytes.clone())),
            Record::Lost { time, bytes, cause } => (time, Err((bytes, cause))),
        });
    }
    all
}

fn some() -> Vec<Told> {
    (0..40u64)
        .map(|number| {
            let record = match number % 7 {
                3 => Err((Some(number), Loss::Overflow)),
                5 => Err((None, Loss::Stalled)),
                _ => Ok(vec![number as u8; 100_000]),
            };
            (Duration::from_millis(10 * number), record)
        })
        .collect()
}

#[test]
fn a_file_says_what_was_written_and_is_sought_by_its_index() {
    let records = some();
    let file = write(&records);
    let mut reader = RawReader::new(Cursor::new(&file)).unwrap();
    assert_eq!(*reader.header(), header());
    assert!(reader.is_indexed());
    assert_eq!(read(&mut reader), records);
    assert_eq!(reader.cut(), None);
    for from in [0, 15, 210, 211, 390, 1000] {
        let time = Duration::from_millis(from);
        reader.seek(time).unwrap();
        let expected: Vec<_> = records
            .iter()
            .filter(|one| one.0 >= time)
            .cloned()
            .collect();
        assert_eq!(read(&mut reader), expected, "{from} ms");
        assert_eq!(reader.cut(), None);
    }
    // Without the index, seeking walks through the records.
    let mut reader = RawReader::new(Cursor::new(&file[..file.len() - 1])).unwrap();
    assert!(!reader.is_indexed());
    reader.seek(Duration::from_millis(211)).unwrap();
    assert_eq!(read(&mut reader), records[22..]);
    assert!(reader.cut().is_some());
}

#[test]
fn other_files_and_later_versions_are_refused_in_one_line() {
    let told = |bytes: &[u8]| {
        RawReader::new(Cursor::new(bytes))
            .err()
            .unwrap()
            .to_string()
    };
    assert!(told(b"").starts_with("byte 0: this is not a stream file"));
    assert!(told(b"% evt 3.0\n0123456789012345").starts_with("byte 0: this is not a stream file"));
    let file = write(&[]);
    let mut later = file.clone();
    later[8] = 2;
    assert!(told(&later).starts_with("byte 8: the stream file has version 2"));
    let mut damaged = file.clone();
    damaged[30] ^= 1;
    assert!(told(&damaged).contains("the header is damaged"));
    for length in MAGIC.len()..usize::from(u16::from_le_bytes([file[10], file[11]])) {
        let told = told(&file[..length]);
        assert!(told.contains("the header is damaged"), "{length}: {told}");
    }
}

fn small() -> impl Strategy<Value = Vec<Told>> {
    let record = prop_oneof![
        prop::collection::vec(any::<u8>(), 1..40).prop_map(Ok),
        (any::<Option<u32>>(), 0..4usize)
            .prop_map(|(bytes, cause)| Err((bytes.map(u64::from), CAUSES[cause].0))),
    ];
    prop::collection::vec((0..1_000_000u64, record), 0..12).prop_map(|mut all| {
        all.sort_by_key(|one| one.0);
        all.into_iter()
            .map(|(time, record)| (Duration::from_nanos(time), record))
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_file_cut_off_anywhere_is_read_up_to_there(records in small(), at in any::<prop::sample::Index>()) {
        let file = write(&records);
        let first = usize::from(u16::from_le_bytes([file[10], file[11]]));
        let length = first + at.index(file.len() - first);
        let mut reader = RawReader::new(Cursor::new(&file[..length])).unwrap();
        let read = read(&mut reader);
        prop_assert!(reader.cut().is_some());
        // Whole records, then at most one partial record.
        let parts = read.iter().zip(&records).filter(|(read, written)| read != written);
        for (index, (part, whole)) in parts.enumerate() {
            let (Ok(part), Ok(whole)) = (&part.1, &whole.1) else { panic!("another record") };
            prop_assert!(index == 0 && whole.starts_with(part));
        }
        let got: usize = read.iter().filter_map(|one| one.1.as_ref().ok()).map(Vec::len).sum();
        // Whatever is missing was not in the file.
        let overhead: usize = records.iter().map(|one| RECORD + if one.1.is_err() { 8 } else { 0 }).sum();
        prop_assert!(got + overhead + RECORD >= length - first || read.len() == records.len());
    }

    #[test]
    fn damage_is_skipped_told_and_never_a_panic(
        records in small(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), 1..=255u8), 1..5),
        from in 0..1_000_000u64,
    ) {
        let mut file = write(&records);
        let first = usize::from(u16::from_le_bytes([file[10], file[11]]));
        for (at, change) in damage {
            let at = first + at.index(file.len() - first);
            file[at] ^= change;
        }
        let mut reader = RawReader::new(Cursor::new(&file)).unwrap();
        prop_assert!(read(&mut reader).len() <= 2 * records.len() + 2);
        reader.seek(Duration::from_nanos(from)).unwrap();
        read(&mut reader);
    }
}

#[test]
fn a_damaged_record_is_told_and_the_next_one_is_read() {
    let records = some();
    let mut file = write(&records);
    let first = usize::from(u16::from_le_bytes([file[10], file[11]]));
    file[first + 5] ^= 0xFF;
    let mut reader = RawReader::new(Cursor::new(&file)).unwrap();
    let read = read(&mut reader);
    assert_eq!(read[0].1, Err((Some(100_024), Loss::Damaged)));
    assert_eq!(read[1..], records[1..]);
}
