//! Tests HDF5 files in the layouts of data sets: read back whole, damaged, and refused with a reason.

use std::io::Cursor;
use std::path::Path;

use event_files::{self, EventReader};
use event_types::{Event, Sensor};

use crate::hdf5_writer::ecf::{Form, Numbers, pack};
use crate::hdf5_writer::{Filter, Node, Storage, Type, file};
use crate::support::{drain, read, regular as events};

const U8: Type = Type::Integer(1, false, false);
const U16: Type = Type::Integer(2, false, false);
const U32: Type = Type::Integer(4, false, false);
const I64: Type = Type::Integer(8, true, false);

fn column<const N: usize>(events: &[Event], of: impl Fn(&Event) -> [u8; N]) -> Vec<u8> {
    events.iter().flat_map(of).collect()
}

fn seconds(event: &Event) -> f64 {
    event.t_us as f64 / 1e6
}

fn dataset(of: Type, shape: &[usize], storage: &Storage, data: Vec<u8>) -> Node {
    Node::Dataset {
        of,
        shape: shape.to_vec(),
        storage: storage.clone(),
        data,
    }
}

/// Returns a table of x, y, t in seconds, p = 1 or -1.
fn mvsec(events: &[Event], storage: &Storage) -> Node {
    let row = |e: &Event| {
        let row = [
            f64::from(e.x),
            f64::from(e.y),
            seconds(e),
            f64::from(e.polarity.sign()),
        ];
        row.map(f64::to_le_bytes).concat()
    };
    let data = events.iter().flat_map(row).collect();
    dataset(Type::Double, &[events.len(), 4], storage, data)
}

fn mvsec_file(left: &[Event], right: &[Event], storage: &Storage) -> Vec<u8> {
    let camera = |events: &[Event]| {
        let picture = dataset(U8, &[2, 3], &Storage::Contiguous, vec![0; 6]);
        Node::Group(vec![
            ("events", mvsec(events, storage)),
            ("image_raw", picture),
        ])
    };
    let cameras = vec![("left", camera(left)), ("right", camera(right))];
    file(vec![("davis", Node::Group(cameras))])
}

/// Returns a file of x, y, t in us after `offset_us`, p.
fn dsec_file(events: &[Event], offset_us: i64, storage: &Storage) -> Vec<u8> {
    let shape = &[events.len()];
    let time = |e: &Event| ((e.t_us as i64 - offset_us) as u32).to_le_bytes();
    let columns = vec![
        (
            "x",
            dataset(U16, shape, storage, column(events, |e| e.x.to_le_bytes())),
        ),
        (
            "y",
            dataset(U16, shape, storage, column(events, |e| e.y.to_le_bytes())),
        ),
        ("t", dataset(U32, shape, storage, column(events, time))),
        (
            "p",
            dataset(U8, shape, storage, column(events, |e| [e.polarity as u8])),
        ),
    ];
    let offset = offset_us.to_le_bytes().to_vec();
    file(vec![
        ("events", Node::Group(columns)),
        (
            "ms_to_idx",
            dataset(I64, &[1], &Storage::Contiguous, vec![0; 8]),
        ),
        ("t_offset", dataset(I64, &[], &Storage::Contiguous, offset)),
    ])
}

/// Returns storages: contiguous; chunked with one and with several levels of nodes, with and without filters, with
/// chunks that end beyond the dataset, and with chunks that hold only some of the columns.
fn storages(columns: &[usize]) -> Vec<Storage> {
    let chunk =
        |rows: usize, wide: usize| [vec![rows], columns.iter().map(|_| wide).collect()].concat();
    let gzip = vec![Filter::Deflate];
    vec![
        Storage::Contiguous,
        Storage::Chunked(chunk(1000, 4), vec![]),
        Storage::Chunked(chunk(4096, 4), vec![Filter::Shuffle, Filter::Deflate]),
        Storage::Chunked(chunk(3678, 1), gzip.clone()),
        Storage::Chunked(chunk(90, 3), gzip.clone()),
        Storage::Chunked(chunk(1 << 17, 4), gzip),
        Storage::Chunked(chunk(1001, 4), vec![Filter::Bitshuffle(true)]),
        Storage::Chunked(chunk(5000, 3), vec![Filter::Bitshuffle(false)]),
        Storage::Chunked(chunk(3003, 4), vec![Filter::Blosc2]),
    ]
}

fn open(bytes: &[u8], size: Option<Sensor>) -> Box<dyn EventReader> {
    let source = Box::new(Cursor::new(bytes.to_vec()));
    event_files::open_source(source, "test", size).expect("a recording")
}

fn check(bytes: &[u8], want: &[Event]) {
    let (got, error) = read(bytes, None);
    assert!(error.is_none(), "{error:?}");
    assert!(got == want, "{} events", got.len());
}

/// Number of events, more than two batches, and a start time as in MVSEC, since 1970.
const EVENTS: u32 = 40_000;
const START_US: u64 = 1_506_117_862_200_001;

#[test]
fn mvsec_in_every_storage() {
    let events = events(START_US, EVENTS);
    for storage in storages(&[4]) {
        let bytes = mvsec_file(&events, &events[..100], &storage);
        check(&bytes, &events);
        let reader = open(&bytes, None);
        assert_eq!(reader.format(), "hdf5");
        // The size is that of the data set, not of the largest coordinates.
        let Sensor { width, height } = reader.sensor();
        assert_eq!((width, height), (346, 260));
        let skipped: Vec<_> = reader.skipped().iter().collect();
        assert_eq!(skipped, [("other datasets", 3)]);
    }
}

#[test]
fn a_place_is_named_behind_the_file() {
    let (left, right) = (events(START_US, 300), events(START_US + 5, 200));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("indoor.data.hdf5");
    let bytes = mvsec_file(&left, &right, &Storage::Contiguous);
    std::fs::write(&path, bytes).expect("a file");
    let events_at = |place: &str| {
        let path = path.display().to_string() + place;
        let mut reader = event_files::open(Path::new(&path), None).expect("a recording");
        let (events, error) = drain(reader.as_mut());
        assert!(error.is_none(), "{error:?}");
        events
    };
    assert_eq!(events_at(""), left);
    assert_eq!(events_at("/davis/left/events"), left);
    assert_eq!(events_at("/davis/right/events"), right);
    assert_eq!(events_at("/davis/right"), right);
    let error = event_files::open(&path.join("davis/middle"), None).err();
    let error = format!("{:#}", error.expect("no such group"));
    assert!(error.contains("no events at davis/middle"), "{error}");
    assert!(error.contains("davis/right/events (200 x 4)"), "{error}");
    // A path into a file that is not HDF5.
    std::fs::write(folder.path().join("a.txt"), "1 2 3 1\n").expect("a file");
    let error = event_files::open(&folder.path().join("a.txt/davis"), None).err();
    let error = format!("{:#}", error.expect("a text has no parts"));
    assert!(error.contains("has no parts to name"), "{error}");
}

#[test]
fn dsec_in_every_storage() {
    let offset_us = 49_599_300_523;
    let events = events(offset_us as u64 + 40, EVENTS);
    for storage in storages(&[]) {
        let bytes = dsec_file(&events, offset_us, &storage);
        check(&bytes, &events);
        let Sensor { width, height } = open(&bytes, None).sensor();
        assert_eq!((width, height), (64, 46));
        let given = Sensor {
            width: 640,
            height: 480,
        };
        assert_eq!(open(&bytes, Some(given)).sensor(), given);
    }
}

#[test]
fn columns_of_other_names_and_types() {
    let events = events(1_000_000, 20_000);
    let shape = &[events.len()];
    let storage = &Storage::Chunked(vec![999], vec![Filter::Shuffle, Filter::Deflate]);
    let sign = |e: &Event| [e.polarity.sign() as u8];
    let i8 = Type::Integer(1, true, false);
    let floats = |e: &Event| seconds(e).to_le_bytes();
    let columns = vec![
        (
            "xs",
            dataset(
                I64,
                shape,
                storage,
                column(&events, |e| i64::from(e.x).to_le_bytes()),
            ),
        ),
        (
            "ys",
            dataset(
                Type::Integer(2, true, true),
                shape,
                storage,
                column(&events, |e| e.y.to_be_bytes()),
            ),
        ),
        (
            "timestamp",
            dataset(Type::Double, shape, storage, column(&events, floats)),
        ),
        (
            "polarity",
            dataset(i8, shape, storage, column(&events, sign)),
        ),
    ];
    check(&file(columns), &events);
}

#[test]
fn compounds() {
    let events = events(1_000_000, 20_000);
    let fields = vec![
        ("x", 0, U16),
        ("y", 2, U16),
        ("p", 4, Type::Integer(1, true, false)),
        ("t", 6, I64),
    ];
    let record = |e: &Event| {
        let mut bytes = [0; 14];
        bytes[..2].copy_from_slice(&e.x.to_le_bytes());
        bytes[2..4].copy_from_slice(&e.y.to_le_bytes());
        bytes[4] = e.polarity as u8;
        bytes[6..].copy_from_slice(&e.t_us.to_le_bytes());
        bytes
    };
    for storage in storages(&[]) {
        let of = Type::Compound(fields.clone(), 14);
        let data = column(&events, record);
        let node = dataset(of, &[events.len()], &storage, data);
        check(&file(vec![("events", node)]), &events);
    }
}

const FORMS: [Form; 3] = [Form::Yxp, Form::Xp, Form::Runs];

/// Returns a file of Prophesee's compounds at CD/events, in ECF chunks.
fn ecf_file(events: &[Event], form: Form, rows: usize) -> Vec<u8> {
    let fields = vec![
        ("x", 0, U16),
        ("y", 2, U16),
        ("p", 4, Type::Integer(2, true, false)),
        ("t", 8, I64),
    ];
    let record = |e: &Event| {
        let mut bytes = [0; 16];
        bytes[..2].copy_from_slice(&e.x.to_le_bytes());
        bytes[2..4].copy_from_slice(&e.y.to_le_bytes());
        bytes[4] = e.polarity as u8;
        bytes[8..].copy_from_slice(&e.t_us.to_le_bytes());
        bytes
    };
    let of = Type::Compound(fields, 16);
    let storage = Storage::Chunked(vec![rows], vec![Filter::Ecf(form)]);
    let node = dataset(of, &[events.len()], &storage, column(events, record));
    file(vec![("CD", Node::Group(vec![("events", node)]))])
}

/// Tests chunks of one event, shorter and longer than a batch, with an incomplete last one.
#[test]
fn ecf_in_chunks_of_every_length() {
    let all = events(1_000_000, EVENTS);
    for (rows, count) in [
        (1, 1),
        (1, 500),
        (1000, 1000),
        (1000, 1001),
        (4096, 40_000),
        (16_384, 40_000),
        (65_535, 40_000),
    ] {
        for form in FORMS {
            let bytes = ecf_file(&all[..count], form, rows);
            check(&bytes, &all[..count]);
            let reader = open(&bytes, None);
            assert_eq!(reader.format(), "hdf5");
            let (middle, last) = (all[count / 2].t_us, all[count - 1].t_us);
            for t_us in [0, 1_000_001, middle, last, last + 1] {
                let first = all[..count].partition_point(|event| event.t_us < t_us);
                let got = sought(&bytes, t_us);
                assert!(
                    got == all[first..count],
                    "{rows} rows, from {t_us}: {}",
                    got.len()
                );
            }
        }
    }
}

/// The error names the file and the event, and comes after the events of earlier chunks.
#[test]
fn a_damaged_chunk_of_ecf_is_named() {
    let all = events(1_000_000, 4000);
    let size = Some(Sensor {
        width: 64,
        height: 48,
    });
    for form in FORMS {
        let bytes = ecf_file(&all, form, 1000);
        let starts: Vec<usize> = all
            .chunks(1000)
            .filter_map(|part| {
                let number = |e: &Event| (e.t_us, e.x, e.y, e.polarity as u8);
                let numbers: Vec<Numbers> = part.iter().map(number).collect();
                let packed = pack(&numbers, form, usize::MAX);
                bytes
                    .windows(packed.len())
                    .position(|bytes| bytes == packed)
            })
            .collect();
        assert_eq!(starts.len(), 4, "{form:?}");
        for (chunk, at) in starts.iter().enumerate() {
            let mut damaged = bytes.clone();
            damaged[at + 1] ^= 0x40;
            let (got, error) = read(&damaged, size);
            let error = format!("{:#}", error.expect("a damaged chunk"));
            assert!(got == all[..chunk * 1000], "{} events: {error}", got.len());
            let want = format!("events: event {}: ", chunk * 1000);
            assert!(
                error.contains(&want) && error.contains("test: byte "),
                "{error}"
            );
            assert!(error.contains("ECF: damaged at byte "), "{error}");
        }
    }
}

#[test]
fn events_off_the_sensor_in_ecf_are_named() {
    let mut all = events(1_000_000, 3000);
    all[2345].x = 64;
    let size = Some(Sensor {
        width: 64,
        height: 48,
    });
    for form in FORMS {
        let (got, error) = read(&ecf_file(&all, form, 1000), size);
        let error = format!("{:#}", error.expect("an event off the sensor"));
        assert!(got == all[..2345], "{} events: {error}", got.len());
        assert!(error.contains("event 2345: x = 64"), "{error}");
    }
}

/// Reads files of Prophesee's own encoder, which come with their expected content.
#[test]
fn ecf_of_the_plugin() {
    let folder = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../shared/cases/ecf"
    ));
    let Ok(reference) = std::fs::read_to_string(folder.join("REFERENCE.json")) else {
        println!("skipped: no shared/cases/ecf");
        return;
    };
    let reference: Vec<serde_json::Value> = serde_json::from_str(&reference).expect("JSON");
    for want in &reference {
        let path = folder.join(want["file"].as_str().expect("a name"));
        let mut reader = event_files::open(&path, None).expect("a recording");
        let Sensor { width, height } = reader.sensor();
        let (got, error) = drain(reader.as_mut());
        assert!(error.is_none(), "{error:?}");
        let sum = |of: fn(&Event) -> u64| got.iter().map(of).sum::<u64>();
        for (key, number) in [
            ("width", u64::from(width)),
            ("height", u64::from(height)),
            ("events", got.len() as u64),
            ("on", sum(|e| e.polarity as u64)),
            ("t_first_us", got[0].t_us),
            ("t_last_us", got[got.len() - 1].t_us),
            ("sum_x", sum(|e| u64::from(e.x))),
            ("sum_y", sum(|e| u64::from(e.y))),
        ] {
            assert_eq!(want[key].as_u64(), Some(number), "{key} of {want}");
        }
    }
}

#[test]
fn tables_of_any_order() {
    let events = events(1_000_000, 20_000);
    let of: [fn(&Event) -> i64; 4] = [
        |e| e.t_us as i64,
        |e| i64::from(e.x),
        |e| i64::from(e.y),
        |e| i64::from(e.polarity as u8),
    ];
    for order in [[0, 1, 2, 3], [1, 2, 0, 3], [1, 2, 3, 0]] {
        let row = |e: &Event| {
            order
                .map(|which: usize| of[which](e).to_le_bytes())
                .concat()
        };
        let data = events.iter().flat_map(row).collect();
        let table = dataset(I64, &[events.len(), 4], &Storage::Contiguous, data);
        check(&file(vec![("events", table)]), &events);
    }
}

/// Reads files written by h5py, with the superblocks and indices of newer libraries.
#[test]
fn files_of_the_library() {
    let folder = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fuzz/seeds/read_hdf5"
    ));
    let mvsec = events(START_US, 300);
    let plain = events(1_000_000, 300);
    for (name, want) in [
        ("mvsec_earliest.h5", &mvsec),
        ("mvsec_latest.h5", &mvsec),
        ("mvsec_unlimited.h5", &mvsec),
        ("dsec_latest.h5", &plain),
        ("compound_latest.h5", &plain),
        ("blosc_blosclz.h5", &plain),
        ("blosc_lz4.h5", &plain),
        ("blosc_zlib.h5", &plain),
        ("blosc_zstd.h5", &plain),
        ("blosc_snappy.h5", &plain),
        ("blosc_bits.h5", &plain),
        ("lzf.h5", &plain),
        ("lz4.h5", &plain),
        ("zstandard.h5", &plain),
        ("blosc2_blosclz.h5", &plain),
        ("blosc2_lz4.h5", &plain),
        ("blosc2_zlib.h5", &plain),
        ("blosc2_zstd.h5", &plain),
        ("blosc2_bits.h5", &plain),
        ("blosc2_delta.h5", &plain),
        ("blosc2_stored.h5", &plain),
        ("blosc2_table.h5", &mvsec),
        ("bitshuffle.h5", &plain),
        ("bitshuffle_lz4.h5", &plain),
        ("bitshuffle_zstd.h5", &plain),
    ] {
        let bytes = std::fs::read(folder.join(name)).expect("a seed of the fuzz targets");
        let (got, error) = read(&bytes, None);
        assert!(error.is_none(), "{name}: {error:?}");
        assert_eq!(&got, want, "{name}");
    }
}

#[test]
fn what_is_wrong_is_named() {
    let contiguous = &Storage::Contiguous;
    let good = events(100, 3);
    let bytes = |data: &[u8]| dataset(U8, &[data.len()], contiguous, data.to_vec());
    let columns = |t: Node, x: Node, p: Node| {
        let y = bytes(&[0, 1, 1]);
        file(vec![("t", t), ("x", x), ("y", y), ("p", p)])
    };
    let fine = || bytes(&[0, 1, 1]);
    let signed = dataset(
        Type::Integer(1, true, false),
        &[3],
        contiguous,
        vec![0, 5, 255],
    );
    let filtered = |number| {
        mvsec_file(
            &good,
            &good,
            &Storage::Chunked(vec![2, 4], vec![Filter::Other(number)]),
        )
    };
    let endless = dataset(U8, &[usize::MAX], contiguous, vec![0; 3]);
    let negative = dsec_file(&good, -1, contiguous);
    let cut = {
        let mut bytes = mvsec_file(&good, &good, contiguous);
        bytes.truncate(bytes.len() / 2);
        bytes
    };
    for (bytes, events, want) in [
        (
            columns(signed, fine(), fine()),
            2,
            "t: event 2: the time is negative",
        ),
        (
            columns(fine(), bytes(&[0, 9, 1]), fine()),
            1,
            "x: event 1: x = 9, y = 1 is outside",
        ),
        (
            columns(fine(), fine(), bytes(&[1, 7, 0])),
            1,
            "p: event 1: the polarity",
        ),
        (
            columns(fine(), bytes(&[0, 1]), fine()),
            0,
            "x: 2 values, but 3 times",
        ),
        (
            columns(endless, fine(), fine()),
            0,
            "x: 3 values, but 18446744073709551615 times",
        ),
        (filtered(307), 0, "(bzip2): rewrite it with gzip"),
        (filtered(32008), 0, "bitshuffle: elements of 0 bytes"),
        (filtered(32026), 0, "Blosc 2: damaged Blosc 2 data"),
        (filtered(40000), 0, "40000: rewrite it with gzip"),
        (filtered(32001), 0, "Blosc: damaged Blosc buffer"),
        (filtered(36559), 0, "ECF"),
        (negative, 0, "t_offset: the offset must be one whole number"),
        (cut, 0, "byte "),
        (
            file(vec![
                ("voxels", bytes(&[1, 2])),
                ("a", Node::Group(vec![("b", bytes(&[1]))])),
            ]),
            0,
            "the file has voxels (2), a/b (1): name the dataset",
        ),
        (file(vec![]), 0, "the file has no datasets"),
        (
            file(vec![("events", bytes(&[1, 2]))]),
            0,
            "events: the events must be numbers of shape (N, 4)",
        ),
    ] {
        let size = Some(Sensor {
            width: 9,
            height: 9,
        });
        let (got, error) = read(&bytes, size);
        let error = format!("{:#}", error.expect(want));
        assert!(
            error.contains(want) && error.contains("byte "),
            "{error} is not {want}"
        );
        assert_eq!(got.len(), events, "{error}");
    }
}

#[test]
fn more_events_than_bytes_are_refused() {
    // Chunks that were never written are read as zeros.
    let events = events(100, 64);
    let mut bytes = dsec_file(
        &events,
        0,
        &Storage::Chunked(vec![64], vec![Filter::Deflate]),
    );
    let shape = 64_u64.to_le_bytes();
    let space = [&[1_u8, 1, 0, 0, 0, 0, 0, 0][..], &shape].concat();
    let mut replaced = 0;
    for at in 0..bytes.len() - 16 {
        if bytes[at..at + 16] == space {
            bytes[at + 8..at + 16].copy_from_slice(&(1_u64 << 40).to_le_bytes());
            replaced += 1;
        }
    }
    assert_eq!(replaced, 4);
    let error = read(&bytes, None).1.expect("no such file").to_string();
    assert!(error.contains("more than the file can hold"), "{error}");
}

#[test]
fn events_before_a_damaged_chunk_are_read() {
    let events = events(START_US, 10_000);
    let storage = Storage::Chunked(vec![1000, 4], vec![Filter::Deflate]);
    let bytes = mvsec_file(&events, &[], &storage);
    // Every chunk begins with deflate's two bytes of header; the chunks come first in the file.
    let starts: Vec<usize> = bytes
        .windows(2)
        .enumerate()
        .filter_map(|(at, window)| (at % 8 == 0 && window == [0x78, 0x01]).then_some(at))
        .collect();
    assert!(starts.len() >= 10);
    for chunk in [0, 3, 9] {
        let mut damaged = bytes.clone();
        damaged[starts[chunk] + 40] ^= 0xff;
        let (got, error) = read(&damaged, None);
        let error = format!("{:#}", error.expect("a damaged chunk"));
        assert!(
            got == events[..chunk * 1000],
            "{} events: {error}",
            got.len()
        );
        let want = format!("events: event {}: ", chunk * 1000);
        assert!(error.contains(&want), "{error}");
    }
}

/// Small files with each byte changed in two ways, or cut to each length, give an error or fewer or other events;
/// never a panic, and no more events than the file states.
#[test]
fn damage_anywhere() {
    let events = events(START_US, 200);
    let gzip = Storage::Chunked(vec![60, 4], vec![Filter::Shuffle, Filter::Deflate]);
    let mut files = vec![
        mvsec_file(&events, &[], &Storage::Contiguous),
        mvsec_file(&events, &[], &gzip),
        dsec_file(
            &events,
            77,
            &Storage::Chunked(vec![60], vec![Filter::Deflate]),
        ),
    ];
    let folder = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fuzz/seeds/read_hdf5"
    ));
    for name in [
        "mvsec_latest.h5",
        "mvsec_unlimited.h5",
        "dsec_latest.h5",
        "compound_latest.h5",
        "blosc2_lz4.h5",
        "bitshuffle_lz4.h5",
    ] {
        files.push(std::fs::read(folder.join(name)).expect("a seed of the fuzz targets"));
    }
    files.push(ecf_file(&events, Form::Runs, 60));
    for bytes in files {
        let (whole, _) = read(&bytes, None);
        let mut noticed = 0;
        let mut check = |damaged: &[u8]| {
            let (got, error) = read(damaged, None);
            if let Some(error) = &error {
                let text = format!("{error:#}");
                assert!(text.contains("byte ") && !text.contains('\n'), "{text:?}");
            }
            noticed += u32::from(error.is_some() || got != whole);
        };
        // Most of a file is data: every seventh byte.
        for at in (0..bytes.len()).step_by(7).chain(0..200) {
            for flip in [0xff, 1 << (at % 8)] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                check(&damaged);
            }
        }
        for length in (0..bytes.len()).step_by(61) {
            check(&bytes[..length]);
        }
        assert!(noticed > 100, "{noticed}");
    }
}

/// Seeks `t_us` and returns the events that follow.
fn sought(bytes: &[u8], t_us: u64) -> Vec<Event> {
    let mut reader = open(bytes, None);
    // Seeks from the middle of the file rather than from its start.
    reader.read(&mut Vec::new()).expect("a batch");
    assert!(reader.seek(t_us).expect("a place"));
    let (got, error) = drain(reader.as_mut());
    assert!(error.is_none(), "{error:?}");
    got
}

#[test]
fn seeking_finds_every_event_from_a_time_on() {
    let events = events(2_000_000, EVENTS);
    let chunked = |filter| Storage::Chunked(vec![4096], vec![filter]);
    let storage = &Storage::Chunked(vec![4096], vec![Filter::Shuffle, Filter::Deflate]);
    let folder = tempfile::tempdir().expect("a folder");
    let sensor = Sensor {
        width: 64,
        height: 48,
    };
    let files = [
        // An index without information, no index, and a complete one.
        (1, dsec_file(&events, 1_000_000, storage)),
        (1, mvsec_file(&events, &events[..9], &Storage::Contiguous)),
        (1, dsec_file(&events, 1_000_000, &chunked(Filter::Blosc2))),
        (
            1,
            dsec_file(&events, 1_000_000, &chunked(Filter::Bitshuffle(true))),
        ),
        (
            60,
            crate::support::written(folder.path(), "h5", sensor, &events),
        ),
    ];
    let last = events[events.len() - 1].t_us;
    for (slack, bytes) in files {
        for t_us in [0, 2_000_000, 2_000_001, 2_333_333, last - 1, last, last + 1] {
            let first = events.partition_point(|event| event.t_us < t_us);
            let got = sought(&bytes, t_us);
            assert!(events.ends_with(&got), "{t_us}");
            let more = got.len() - (events.len() - first);
            assert!(more < slack, "{t_us}: {more} earlier events");
        }
    }
}

#[test]
fn a_recording_of_days_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensor = Sensor {
        width: 64,
        height: 48,
    };
    let at = |t_us| Event {
        t_us,
        ..events(0, 1)[0]
    };
    let write = |events: &[Event]| {
        let mut writer = event_files::create(&folder.path().join("a.h5"), sensor).expect("a file");
        writer.write(events)
    };
    let error = write(&[at(5), at(5 + (1 << 37))]).expect_err("two days");
    let error = error.to_string();
    assert!(
        error.contains("event 1") && error.contains("38 hours"),
        "{error}"
    );
    write(&[at(1 << 40), at(3), at((1 << 40) + 100_000_000)]).expect("a step back");
}
