//! Tests truncated and damaged recordings: readers return the events before the damage, then an error that states
//! the offset, or a clean end; they never panic.

use std::path::Path;

use event_types::{Event, Polarity, Sensor};
use proptest::prelude::*;

use crate::support::{FORMATS, fitted, read, read_as, written};

const EVENTS: u32 = 3000;

fn recordings() -> impl Iterator<Item = (&'static str, Sensor, Vec<Event>, Vec<u8>)> {
    FORMATS.iter().map(|&(extension, sensor)| {
        let mut state = 1_u32;
        let mut random = |below: u16| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 16) % u32::from(below)) as u16
        };
        let events: Vec<Event> = (0..EVENTS)
            .map(|i| Event {
                t_us: 77_000_000 + u64::from(i) * 300,
                x: random(sensor.width),
                y: random(sensor.height),
                polarity: Polarity::from_bool(random(2) == 1),
            })
            .collect();
        let folder = tempfile::tempdir().expect("a folder");
        let events = fitted(extension, events);
        let bytes = written(folder.path(), extension, sensor, &events);
        (extension, sensor, events, bytes)
    })
}

fn check_error(extension: &str, error: Option<&event_files::Error>) {
    if let Some(error) = error {
        let text = format!("{error:#}");
        assert!(text.contains("byte "), "{extension}: no offset in {text:?}");
        assert!(
            !text.contains('\n'),
            "{extension}: more than a line: {text:?}"
        );
    }
}

#[test]
fn truncated_anywhere() {
    for (extension, sensor, events, bytes) in recordings() {
        let mut errors = 0;
        let mut most = 0;
        let step = bytes.len() / 400 + 1;
        for length in (0..bytes.len())
            .step_by(step)
            .chain(bytes.len() - 40..bytes.len())
        {
            let (got, error) =
                read_as(&format!("test.{extension}"), &bytes[..length], Some(sensor));
            check_error(extension, error.as_ref());
            assert!(
                events.starts_with(&got),
                "{extension}: other events of {length} bytes"
            );
            errors += u32::from(error.is_some());
            most = most.max(got.len());
            // The directory of a zip, HDF5 or Parquet file is at its end, and so is an LZ4 frame's checksum; the
            // last column of a batch begins late; MCAP's blocks have 64 kB; Event Stream counts up to the first
            // event's time in bytes; SQLite refuses a file that is shorter than it states.
            let is_whole = [
                "npz", "mat", "h5", "aedat4", "arrow", "arrows", "parquet", "mcap", "db3", "es",
            ]
            .contains(&extension);
            if !is_whole && length > bytes.len() / 2 {
                assert!(
                    got.len() > 1000,
                    "{extension}: {} events of {length} bytes",
                    got.len()
                );
            }
        }
        assert!(errors > 0, "{extension}: no truncation was noticed");
        assert!(
            matches!(extension, "npz" | "mat" | "h5" | "parquet" | "db3")
                || most >= EVENTS as usize - 24,
            "{extension}: {most}"
        );
    }
}

#[test]
fn flipped_bytes() {
    for (extension, sensor, events, bytes) in recordings() {
        let mut noticed = 0;
        let step = bytes.len() / 200 + 1;
        for (index, at) in (0..bytes.len()).step_by(step).chain(0..200).enumerate() {
            for flip in [0xff, 1 << (index % 8)] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                let (got, error) = read_as(&format!("test.{extension}"), &damaged, Some(sensor));
                check_error(extension, error.as_ref());
                noticed += u32::from(error.is_some() || got != events);
                // MCAP's chunks have a CRC, and its summary counts their messages.
                if extension == "mcap" && (1000..bytes.len() - 1000).contains(&at) {
                    assert!(
                        events.starts_with(&got) && (error.is_some() || got == events),
                        "{} events of {}, byte {at} is another: {error:?}",
                        got.len(),
                        events.len()
                    );
                }
                // In formats of fixed-size words, everything decoded before the damage is right.
                if matches!(
                    extension,
                    "aedat" | "evt2.raw" | "evt21.raw" | "dat" | "csv" | "txt"
                ) && at > 1000
                {
                    let same = got.iter().zip(&events).take_while(|(a, b)| a == b).count();
                    let before = (at - 1000) * events.len() / bytes.len() / 2;
                    assert!(
                        same >= before,
                        "{extension}: {same} events before byte {at}"
                    );
                }
            }
        }
        assert!(noticed > 0, "{extension}");
    }
}

/// A damaged index is rejected, or leads to a place in the file.
#[test]
fn seeking_in_damaged_bags() {
    for (extension, sensor, events, bytes) in recordings() {
        if !matches!(extension, "mcap" | "bag") {
            continue;
        }
        let t_us = events[EVENTS as usize / 2].t_us;
        let (mut sought, mut unsought) = (0, 0);
        let end = bytes.len();
        for (index, at) in (0..200).chain(end - 700..end).enumerate() {
            let mut damaged = bytes.clone();
            damaged[at] ^= [0xff, 1 << (index % 8)][index % 2];
            let source = Box::new(std::io::Cursor::new(damaged));
            let opened = event_files::open_source(source, "damaged", Some(sensor));
            let Ok(mut reader) = opened else { continue };
            match reader.seek(t_us) {
                Ok(true) => sought += 1,
                Ok(false) => unsought += 1,
                Err(error) => check_error(extension, Some(&error)),
            }
            let mut got = Vec::new();
            loop {
                match reader.read(&mut got) {
                    Ok(0) => break,
                    Ok(_) => assert!(got.len() <= events.len(), "{extension}: flip at {at}"),
                    Err(error) => {
                        check_error(extension, Some(&error));
                        break;
                    }
                }
            }
        }
        assert!(
            sought > 0 && unsought > 0,
            "{extension}: {sought}, {unsought}"
        );
    }
}

#[test]
fn nonsense_is_no_recording() {
    let magics: [&[u8]; 11] = [
        b"",
        b"#!AER-DAT4.0\r\n",
        b"#!AER-DAT2.0\r\n",
        b"% evt 2.0\n",
        b"% evt 3.0\n",
        b"% evt 2.1\n% geometry 9x9\n% end\n",
        b"% evt 4.0\n% geometry 9x9\n% end\n",
        b"% Version 2\n% Width 9\n% Height 9\n\x0c\x08",
        b"t,x,y,p\n",
        b"PK\x03\x04",
        b"240 180\n",
    ];
    for magic in magics {
        for tail in [
            vec![],
            vec![0; 3],
            vec![0xff; 1000],
            (0..=255).collect::<Vec<u8>>(),
        ] {
            let bytes = [magic, &tail].concat();
            let (_, error) = read(&bytes, None);
            check_error("nonsense", error.as_ref());
        }
    }
    for (bytes, word) in [
        (&b"#!AER-DAT3.1\r\n"[..], "END-HEADER"),
        (b"#!AER-DAT5.0\r\n", "AEDAT"),
        (b"% evt 5.0\n% end\n", "EVT 5.0"),
        (b"% evt 2.1\n% end\n", "--width"),
        (
            b"% evt 2.1\n% endianness big\n% geometry 4x4\n% end\n",
            "endianness big",
        ),
        (
            b"% Data file containing CD events.\n% Version 2\n",
            "truncated",
        ),
        (
            b"% Data file containing CD events.\n% Version 2\n\x0c\x08",
            "--width",
        ),
        (b"% Version 7\n% Width 3\n% Height 3\n\x0c\x08", "version 7"),
        (b"% Version 2\n\x0e\x08", "triggers"),
        (b"% T0 -1\n% Width 3\n% Height 3\n\x0c\x08", "T0"),
        (b"% Data file containing flow\n\x28\x1c", "type 40"),
        (b"\x89HDF\r\n\x1a\n", "damaged HDF5 file"),
        (b"\x89PNG\r\n\x1a\n", "known format"),
        (b"", "empty"),
        (
            b"#!AER-DAT2.0\r\n# AEChip: x.CochleaAMS1c\r\n",
            "CochleaAMS1c",
        ),
    ] {
        let error = read(bytes, None).1.expect("no recording").to_string();
        assert!(error.contains(word), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Anything may follow one of Prophesee's headers.
    #[test]
    fn any_words_are_survived(
        header in prop::sample::select(vec![
            &b"% evt 2.0\n% geometry 640x480\n% end\n"[..],
            b"% evt 2.1\n% geometry 2048x2048\n% end\n",
            b"% evt 2.1\n% endianness legacy\n% geometry 640x480\n% end\n",
            b"% evt 3.0\n% geometry 640x480\n% T0 1152921504606846976\n% end\n",
            b"% evt 4.0\n% geometry 2048x2048\n% end\n",
            b"% Data file containing events\n% Width 999\n% Height 999\n\x00\x08",
            b"% Version 2\n% Width 2048\n% Height 2048\n% T0 1152921504606846976\n\x0c\x08",
        ]),
        // In half of the cases, word types are at their right places.
        words in prop::collection::vec(
            prop_oneof![
                any::<[u8; 4]>(),
                (any::<[u8; 4]>(), prop::sample::select(vec![0x00, 0x10, 0x80, 0xa0, 0xb0, 0xd0, 0xe0]))
                    .prop_map(|(word, kind)| [word[0], word[1], word[2] & 0x0f, word[3] & 0x0f | kind]),
            ],
            0..200,
        ),
        left in 0..4_usize,
    ) {
        let mut bytes = [header, &words.concat()].concat();
        bytes.truncate(bytes.len() - left.min(4 * words.len()));
        let (_, error) = read(&bytes, None);
        check_error("words", error.as_ref());
    }
}

/// Real recordings contain what this crate's writers do not write: frames, triggers, large headers.
#[test]
fn truncated_real_recordings() {
    let shared = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    for file in [
        "davis346_building_dense/davis.aedat4",
        "davis240_boxes_moderate/IMU_translBoxes.aedat",
        "gen3_vga_dense_evt2/evt2.raw",
        "imx636_sparse_dat/gen4.dat",
        "derived_layouts/davis346_building_xytp.npz",
        "derived_layouts/davis346_building_txyp.txt",
        "derived_layouts/davis346_building_mvsec_layout.hdf5",
        "derived_layouts/davis346_building_dsec_layout.h5",
    ] {
        let Ok(bytes) = std::fs::read(shared.join(file)) else {
            eprintln!("skipped: {file} is absent");
            continue;
        };
        let (whole, error) = read(&bytes, None);
        assert!(error.is_none(), "{file}: {error:?}");
        let size = Some(Sensor {
            width: 640,
            height: 480,
        });
        for part in 0..40 {
            let length = bytes.len() * part / 40 + part;
            let (got, error) = read(&bytes[..length], size);
            check_error(file, error.as_ref());
            assert!(
                whole.starts_with(&got),
                "{file}: other events of {length} bytes"
            );
        }
    }
}
