//! Every shared recording that fits a model's sensor, as that model's stream and back.
//!
//! Skipped, with a notice, where the shared recordings are absent. A device counts from 0: times are
//! those after the recording's first event.

use std::path::Path;

use eecvs_nostd::{Event, Sensor};

use super::scene::{model, parser, sorted_frames};

const FILES: [&str; 12] = [
    "davis346_static_sparse/davis346.aedat4",
    "davis346_building_dense/davis.aedat4",
    "gen3_vga_dense_evt2/evt2.raw",
    "dvxl_person_moderate/data_sample.aedat4",
    "davis240_boxes_moderate/IMU_translBoxes.aedat",
    "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    "dvs128_walking_sparse/neal_walking.aedat",
    "dvs128_standup/cam255_alex_standing_up2.aedat",
    "derived_layouts/davis346_building_xytp.npz",
    "derived_layouts/davis346_building_txyp.txt",
    "es_csv_1ms_grid/dvs.csv",
    "imx636_sparse_evt3/evt3.raw",
];

fn read(path: &Path) -> Option<(Sensor, Vec<Event>)> {
    if !path.exists() {
        eprintln!("skipped: {} is absent", path.display());
        return None;
    }
    let mut reader = event_files::open(path, None).expect("a recording");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a recording") > 0 {}
    let first = events.first().map_or(0, |event| event.t_us);
    for event in &mut events {
        event.t_us = event.t_us.saturating_sub(first);
    }
    Some((reader.sensor(), events))
}

#[test]
fn every_recording_that_fits_comes_back() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    for file in FILES {
        let Some((sensor, events)) = read(&data.join(file)) else {
            continue;
        };
        let sorted = events.is_sorted_by_key(|event| event.t_us);
        for name in [
            "dvs128",
            "davis240",
            "davis346",
            "dvxplorer",
            "dvxplorer-mipi",
        ] {
            let Some(mut writer) = model(name).writer(sensor) else {
                continue;
            };
            assert!(sorted, "{file}: its times run back");
            let mut bytes = Vec::new();
            writer.write(&events, &mut bytes).expect("events in order");
            writer.finish(&mut bytes).expect("events in order");
            let mut parser = parser(
                name,
                if name == "dvs128" {
                    super::scene::sensor(128, 128)
                } else {
                    sensor
                },
            );
            let mut back = Vec::new();
            for transfer in bytes.chunks(8192 - 1) {
                parser.parse(transfer, &mut back);
            }
            assert_eq!(parser.losses().iter().count(), 0);
            let wanted = sorted_frames(name, events.clone());
            assert!(back == wanted, "{file} as {name}");
            let per_event = bytes.len() as f64 / events.len() as f64;
            println!(
                "{file} as {name}: {} events, {per_event:.2} bytes each",
                events.len()
            );
        }
    }
}
