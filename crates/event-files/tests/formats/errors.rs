//! Tests the kinds of errors, by which a program that reads files decides what to do.

use std::io;
use std::path::Path;

use event_files::{ErrorKind, Reading, create, open};
use event_types::test_events::event;
use event_types::{Event, Sensor};

/// Returns the kind of error with which opening or reading a file ends, if any.
fn kind(folder: &Path, name: &str, bytes: &[u8]) -> Option<ErrorKind> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    let mut reader = match open(&path, Reading::default()) {
        Ok(reader) => reader,
        Err(error) => return Some(error.kind()),
    };
    loop {
        match reader.read(&mut Vec::new()) {
            Ok(0) => return None,
            Ok(_) => {}
            Err(error) => return Some(error.kind()),
        }
    }
}

#[test]
fn kinds_tell_what_can_be_done() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let evt3 = b"% evt 3.0\n% geometry 4x4\n% end\n";
    let cases: [(&str, &[u8], Option<ErrorKind>); 10] = [
        ("whole.csv", b"t,x,y,p\n1,2,3,1\n", None),
        (
            "cut.csv",
            b"t,x,y,p\n1,2,3,1\n2,3",
            Some(ErrorKind::Damaged),
        ),
        (
            "order.txt",
            b"4 4\n1500 1 2 1\n1501 1 2 0\n",
            Some(ErrorKind::Undecided),
        ),
        (
            "names.csv",
            b"a,b,c,d\n1,2,3,1\n",
            Some(ErrorKind::Undecided),
        ),
        (
            "unit.csv",
            b"t,x,y,p\n9e19,2,3,1\n",
            Some(ErrorKind::Undecided),
        ),
        (
            "size.raw",
            b"% evt 3.0\n\x00\x80",
            Some(ErrorKind::Undecided),
        ),
        (
            "word.raw",
            b"% evt 9.0\n\x00\x80",
            Some(ErrorKind::Unsupported),
        ),
        ("noise", &[0xff; 64], Some(ErrorKind::Unsupported)),
        (
            "cut.raw",
            &[&evt3[..], &[7]].concat(),
            Some(ErrorKind::Damaged),
        ),
        (
            "outside.csv",
            b"t,x@4,y@4,p\n1,9,3,1\n",
            Some(ErrorKind::Damaged),
        ),
    ];
    for (name, bytes, want) in cases {
        assert_eq!(kind(folder, name, bytes), want, "{name}");
    }
    let absent = open(&folder.join("absent.raw"), Reading::default()).err();
    let absent = absent.expect("no such file");
    assert_eq!(absent.kind(), ErrorKind::Io(io::ErrorKind::NotFound));
    assert!(absent.to_string().contains("absent.raw"), "{absent}");
}

#[test]
fn what_a_format_cannot_hold_is_told_from_what_was_asked_wrongly() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, sensor: Sensor, events: &[Event]| {
        let mut writer = create(&folder.path().join(name), sensor)?;
        writer.write(events)?;
        writer.finish()
    };
    let small = Sensor::new(34, 34).expect("a sensor");
    let large = Sensor::new(1280, 720).expect("a sensor");
    let cases = [
        (
            "large.bin",
            large,
            vec![event(1, 300, 1, true)],
            ErrorKind::CannotHold,
        ),
        (
            "late.bin",
            small,
            vec![event(1 << 40, 1, 1, true)],
            ErrorKind::CannotHold,
        ),
        ("name.xyz", small, vec![], ErrorKind::Unsupported),
        (
            "none/a.csv",
            small,
            vec![],
            ErrorKind::Io(io::ErrorKind::NotFound),
        ),
    ];
    for (name, sensor, events, want) in cases {
        let error = write(name, sensor, &events).expect_err(name);
        assert_eq!(error.kind(), want, "{error:?}");
    }
}
