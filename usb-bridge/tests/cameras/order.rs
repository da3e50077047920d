//! What `eecvs-usb capture` and `forward` say of clocks that begin anew.

use eecvs_nostd::Event;

use crate::support::{CAMERA, Folder, SENSOR, events, read, sorted};

/// What a command says in its three ways: the JSON, the table, and the warnings.
fn said(folder: &Folder, arguments: &[&str]) -> (serde_json::Value, String, String) {
    let output = folder.run(&[arguments, &["--json"]].concat());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{errors}");
    let json = serde_json::from_slice(&output.stdout).unwrap();
    let output = folder.run(arguments);
    assert_eq!(String::from_utf8(output.stderr).unwrap(), errors);
    (json, String::from_utf8(output.stdout).unwrap(), errors)
}

/// A row of a table.
fn row<'t>(table: &'t str, name: &str) -> &'t str {
    let line = table.lines().find(|line| line.starts_with(name));
    line.unwrap_or_else(|| panic!("{name}: {table}"))
        .rsplit(' ')
        .next()
        .unwrap()
}

/// A recording in which three events come 50 ms after their time.
fn disordered(folder: &Folder) -> Vec<Event> {
    let mut events = events();
    let late: Vec<Event> = (0..3).map(|i| events[5000 + i]).collect();
    let at = events.partition_point(|event| event.t_us < late[2].t_us + 50_000);
    events.splice(at..at, late);
    let mut writer = event_files::create(&folder.path("late.aedat4"), SENSOR).unwrap();
    writer.write(&events).unwrap();
    writer.finish().unwrap();
    events
}

#[test]
fn a_clock_that_begins_anew_is_a_run_of_its_own_and_told() {
    let folder = Folder::new();
    let events = disordered(&folder);
    let device = "sim:eecvs:late.aedat4";
    let device = ["--device", device, "--rate", "max", "--overwrite"];
    for to in [
        &["capture", "-o", "a.eecvs"][..],
        &["capture", "-o", "a.aedat4"],
        &["forward", "--to", "file:b.eecvs"],
        &["capture", "-o", "c.eecvs", "--set-up", "128x128"],
        &["forward", "--to", "file:d.eecvs", "--set-up", "128x128"],
    ] {
        let (json, table, errors) = said(&folder, &[to, &device[..]].concat());
        let runs = json["runs"].as_u64().unwrap();
        assert_eq!(
            (runs, &json["events_late"]),
            (2, &0.into()),
            "{to:?}: {json}"
        );
        assert_eq!(
            (row(&table, "runs of the clock"), row(&table, "events late")),
            ("2", "0")
        );
        assert_eq!(errors.lines().count(), 1, "{errors}");
        assert!(
            errors.contains("clock restarts: 1;") && errors.contains("2 runs"),
            "{errors}"
        );
    }
    for name in ["a.eecvs", "a.aedat4", "b.eecvs", "c.eecvs", "d.eecvs"] {
        assert_eq!(read(&folder.path(name)), sorted(events.clone()), "{name}");
    }
    let camera = [
        "capture",
        "--device",
        CAMERA,
        "--rate",
        "max",
        "--overwrite",
    ];
    let (json, table, errors) = said(&folder, &[&camera[..], &["-o", "c.eecvs"]].concat());
    assert_eq!(
        (&json["runs"], row(&table, "runs of the clock")),
        (&1.into(), "1")
    );
    assert_eq!(errors, "");
}
