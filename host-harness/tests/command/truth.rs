//! The truth beside an emulated recording: as many causes as events, in their order, and the scene's frames.

use std::fs::File;
use std::io::Read;
use std::process::Command;

use event_emulator::{Camera, Cause, Model, Preset, Readout, SceneConfig, SceneTruth, emulate};
use event_files::video::{VideoReading, open_video};
use event_types::{Event, Sensor};

use crate::support::{Folder, count, number};

/// An array of an `.npz`.
struct Array {
    dtype: String,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

/// Reads an array; `None` if there is none of this name.
fn array(folder: &Folder, file: &str, name: &str) -> Option<Array> {
    let file = File::open(folder.path(file)).expect("a file");
    let mut zip = zip::ZipArchive::new(file).expect("a zip file");
    let mut entry = zip.by_name(&format!("{name}.npy")).ok()?;
    let mut bytes = Vec::new();
    entry.read_to_end(&mut bytes).expect("a whole entry");
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(&bytes[10..data]).expect("an ASCII header");
    let shape = header.split(['(', ')']).nth(1).expect("a shape");
    let shape = shape
        .split(',')
        .map(str::trim)
        .filter(|side| !side.is_empty());
    Some(Array {
        dtype: header.split('\'').nth(3).expect("a type").to_owned(),
        shape: shape.map(|side| side.parse().expect("a number")).collect(),
        bytes: bytes.split_off(data),
    })
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let numbers = bytes.as_chunks().0.iter();
    numbers.map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

/// The events of a scene that the host gets, and their causes, by the library.
fn expected(
    config: SceneConfig,
    camera: Option<&Camera>,
    link_per_us: f64,
) -> (Vec<Event>, Vec<u8>) {
    let mut emulator = emulate(config).expect("a scene");
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    while emulator
        .read_with_causes(&mut events, &mut causes)
        .expect("model 2")
        > 0
    {}
    if let Some(camera) = camera {
        let mut parameters = camera.readout;
        parameters.link_per_us = link_per_us;
        parameters.buffer_events = 100.0;
        let mut readout = Readout::new(config.sensor, &parameters).expect("a readout");
        let (mut got, mut of_got) = (Vec::new(), Vec::new());
        readout.push(&events, Some(&causes), &mut got, Some(&mut of_got));
        readout.finish(&mut got, Some(&mut of_got));
        let lost = readout.losses();
        assert!(lost.unread + lost.link > 0, "{}: {lost:?}", camera.name);
        (events, causes) = (got, of_got);
    }
    let causes = causes.into_iter().map(|cause| cause as u8);
    (events, causes.collect())
}

#[test]
fn each_event_of_the_recording_has_its_cause() {
    let folder = Folder::new();
    let sensor = Sensor {
        width: 80,
        height: 60,
    };
    let config = SceneConfig {
        sensor,
        duration_us: 60_000,
        start_us: 5_000,
        model: Model::Physical,
        ..SceneConfig::new(Preset::OutdoorDarkBlur, 2)
    };
    let line = "emulate outdoor-dark-blur -o a.raw --truth a.npz --seed 2 --model 2 --width 80 --height 60 \
                --duration-us 60000 --start-us 5000 --json";
    let mut noise = 0;
    for (camera, link) in [
        (None, 0.0),
        (Some("dvs128"), 0.002),
        (Some("davis346"), 0.003),
        (Some("dvxplorer"), 0.004),
        (Some("imx636"), 0.005),
    ] {
        let flags = camera.map_or_else(String::new, |camera| {
            format!("--camera {camera} --link-per-us {link} --buffer-events 100")
        });
        for threads in [1, 2] {
            let report = folder
                .eecvs(&format!("{line} {flags} --threads {threads}"))
                .ok()
                .object();
            let camera = camera.map(|name| Camera::from_name(name).expect("a camera"));
            let (events, causes) = expected(config, camera, link);
            assert_eq!(folder.events("a.raw"), (sensor, events));
            let found = array(&folder, "a.npz", "cause").expect("causes");
            assert_eq!(
                (found.dtype.as_str(), found.shape.as_slice()),
                ("|u1", &[causes.len()][..])
            );
            assert_eq!(found.bytes, causes, "{flags}");
            for (number, cause) in (0_u8..).zip(Cause::ALL) {
                let events = causes.iter().filter(|other| **other == number).count();
                assert_eq!(count(&report["causes"], cause.name()), events as u64);
                noise += usize::from(number > 0) * events;
            }
        }
    }
    assert!(noise > 100, "{noise}");
    // Without noise, there is signal alone.
    folder.eecvs(&format!("{line} --no-noise")).ok();
    let found = array(&folder, "a.npz", "cause").expect("causes");
    assert!(!found.bytes.is_empty() && found.bytes.iter().all(|cause| *cause == 0));
}

#[test]
fn frames_are_those_of_the_scene_in_both_models() {
    let folder = Folder::new();
    let sensor = Sensor {
        width: 64,
        height: 48,
    };
    let pixels = 64 * 48;
    for (preset, model) in [
        (Preset::IndoorFlying, Model::Physical),
        (Preset::IndoorDarkHdr, Model::Steps),
    ] {
        let config = SceneConfig {
            sensor,
            duration_us: 90_000,
            start_us: 1_234,
            ..SceneConfig::model_1(preset, 1)
        };
        let report = folder
            .eecvs(&format!(
                "emulate {} -o a.raw --truth a.npz --truth-fps 29.97 --model {} --width 64 --height 48 --duration-us 90000 \
                 --start-us 1234 --json",
                preset.name(),
                model.name()
            ))
            .ok()
            .object();
        // 33,367 us apart.
        let times_us = [1_234, 34_601, 67_967];
        assert_eq!(count(&report, "truth_frames"), 3);
        let found = |name: &str| array(&folder, "a.npz", name);
        let times = found("t_us").expect("times");
        let expected: Vec<u8> = times_us
            .iter()
            .flat_map(|t: &u64| t.to_le_bytes())
            .collect();
        assert_eq!((times.shape, times.bytes), (vec![3], expected));

        let truth = SceneTruth::new(&config).expect("a scene");
        let (mut object, mut flow, mut depth) =
            (vec![0; pixels], vec![[0.0; 2]; pixels], vec![0.0; pixels]);
        let objects = found("object").expect("objects");
        assert_eq!(
            (objects.dtype.as_str(), objects.shape.as_slice()),
            ("|u1", &[3, 48, 64][..])
        );
        let flows = found("flow").expect("flow");
        assert_eq!(
            (flows.dtype.as_str(), flows.shape.as_slice()),
            ("<f4", &[3, 48, 64, 2][..])
        );
        let (flows, depths) = (floats(&flows.bytes), found("depth"));
        assert_eq!(depths.is_some(), truth.has_depth());
        for (frame, t_us) in times_us.into_iter().enumerate() {
            let of_frame = frame * pixels..(frame + 1) * pixels;
            truth.objects_at(t_us, &mut object).expect("a time");
            assert_eq!(objects.bytes[of_frame.clone()], object);
            assert!(object.contains(&1) && object.contains(&2));
            truth.flow_at(t_us, &mut flow).expect("a time");
            assert_eq!(
                flows[2 * of_frame.start..2 * of_frame.end],
                *flow.as_flattened()
            );
            if let Some(depths) = &depths {
                truth.depth_at(t_us, &mut depth).expect("a depth");
                let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&floats(&depths.bytes)[of_frame]), bits(&depth));
            }
        }
        let causes = found("cause");
        assert_eq!(causes.is_some(), model == Model::Physical);
        assert_eq!(report["causes"].is_null(), causes.is_none());

        // The reader of videos takes the masks for frames, with the times beside them.
        let path = folder.path("a.npz/object");
        let mut video = open_video(&path, &VideoReading::default()).expect("frames");
        let mut values = Vec::new();
        for (frame, t_us) in times_us.into_iter().enumerate() {
            assert_eq!(video.read(&mut values).expect("a frame"), Some(t_us));
            let bytes = &objects.bytes[frame * pixels..];
            let same = values.iter().zip(bytes);
            assert!(
                same.into_iter()
                    .all(|(value, byte)| (value * 255.0).round() == f32::from(*byte))
            );
        }
    }
}

#[test]
fn numpy_reads_the_truth() {
    let python = std::env::var("EECVS_PYTHON").unwrap_or("python3".to_owned());
    let folder = Folder::new();
    let line = "emulate motorcycle -o a.csv --truth a.npz --model 2 --width 64 --height 48 --duration-us 100000";
    folder.eecvs(line).ok();
    let events = folder.events("a.csv").1.len();
    let script = r"
import sys
try:
    import numpy as np
except ImportError:
    sys.exit(77)
a = np.load('a.npz')
assert a.files == ['t_us', 'object', 'object_names', 'flow', 'depth', 'cause', 'cause_names', 'events_sha256'], a.files
assert a['t_us'].tolist() == [0, 33333, 66667] and a['t_us'].dtype == np.int64
assert a['object_names'].tolist() == ['background', 'box', 'lamp']
assert a['cause_names'].tolist() == ['signal', 'leak', 'shot-noise', 'hot', 'stuck']
assert a['object'].shape == (3, 48, 64) and a['object'].dtype == np.uint8
assert a['flow'].shape == (3, 48, 64, 2) and a['flow'].dtype == np.float32
assert (np.isnan(a['depth']) == (a['object'] > 0)).all()
assert (a['flow'][a['object'] == 2] == 0).all()
assert a['cause'].shape == (int(sys.argv[1]),) and a['cause'].dtype == np.uint8 and a['cause'].max() < 5
";
    let output = Command::new(&python)
        .args(["-c", script, &events.to_string()])
        .current_dir(folder.path("."))
        .output();
    let output = match output {
        Ok(output) if output.status.code() != Some(77) => output,
        _ => {
            eprintln!("skipped: {python} with numpy is absent");
            return;
        }
    };
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
}

#[test]
fn a_video_has_causes_and_mistakes_are_refused_before_anything_is_done() {
    let folder = Folder::new();
    let mut video = b"YUV4MPEG2 W16 H2 F100:1 Ip Cmono\n".to_vec();
    for frame in 0..3_u8 {
        video.extend_from_slice(b"FRAME\n");
        video.extend((0..32).map(|i| 20 + 3 * i * frame));
    }
    folder.write("a.y4m", video);
    folder
        .eecvs("emulate a.y4m -o a.raw --truth a.npz --luma-range full --link-per-us 0.001 --buffer-events 5")
        .ok();
    let causes = array(&folder, "a.npz", "cause").expect("causes");
    assert_eq!(causes.shape, [folder.events("a.raw").1.len()]);
    assert!(causes.shape > vec![4]);
    assert!(
        array(&folder, "a.npz", "object").is_none() && array(&folder, "a.npz", "t_us").is_none()
    );

    folder.write("old.npz", "kept");
    std::fs::hard_link(folder.path("old.npz"), folder.path("same.npz")).expect("a link");
    let scene = "emulate outdoor-dark --width 16 --height 16 --duration-us 1000";
    for (line, reason) in [
        (format!("{scene} -o b.raw --truth old.npz"), "--overwrite"),
        (format!("{scene} -o b.raw --truth b.npy"), ".npz"),
        (format!("{scene} -o b.raw --truth b"), ".npz"),
        (format!("{scene} -o b.raw --truth -"), ".npz"),
        (format!("{scene} -o b.raw --truth none/b.npz"), "no folder"),
        (format!("{scene} -o b.npz --truth b.npz"), "same file"),
        (format!("{scene} -o ./b.npz --truth b.npz"), "same file"),
        (
            format!("{scene} -o old.npz --truth same.npz --overwrite"),
            "same file",
        ),
        (
            format!("{scene} -o b.raw --truth b.npz --start-us 9223372036854775807"),
            "2^63",
        ),
        (format!("{scene} -o b.unknown --truth b.npz"), "b.unknown"),
        (
            "emulate a.y4m -o b.raw --truth b.npz --truth-fps 30".to_owned(),
            "--truth-fps",
        ),
        (
            "emulate a.y4m -o b.raw --truth b.npz --model 1".to_owned(),
            "model 1",
        ),
    ] {
        folder.as_is(&line).fails(&[reason]);
        assert!(
            !folder.path("b.raw").exists() && !folder.path("b.npz").exists(),
            "{line}"
        );
        assert_eq!(folder.bytes("old.npz"), b"kept", "{line}");
    }
    for line in [
        format!("{scene} -o b.raw --truth b.npz --truth-fps 0"),
        format!("{scene} -o b.raw --truth b.npz --truth-fps 1000001"),
        format!("{scene} -o b.raw --truth-fps 30"),
        "emulate --list --truth b.npz".to_owned(),
    ] {
        let outcome = folder.as_is(&line);
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
    // A recording that cannot be written leaves no truth, and the old one as it was.
    folder
        .as_is(&format!(
            "{scene} -o /dev/full --format evt2 --model 2 --truth old.npz --overwrite"
        ))
        .fails(&["/dev/full"]);
    assert_eq!(folder.bytes("old.npz"), b"kept");
    // An empty recording has a truth of nothing.
    folder
        .as_is("emulate outdoor-dark -o e.raw --duration-us 0 --model 2 --truth e.npz")
        .ok();
    for (name, shape) in [("object", vec![0, 260, 346]), ("cause", vec![0])] {
        let empty = array(&folder, "e.npz", name).expect("an array");
        assert_eq!((empty.shape, empty.bytes.len()), (shape, 0));
    }
}

#[test]
fn a_filter_is_judged_by_the_truth() {
    let folder = Folder::new();
    let line = "emulate outdoor-dark-blur -o a.raw --truth a.npz --model 2 --width 64 --height 48 --duration-us 300000";
    folder.eecvs(line).ok();
    let (sensor, events) = folder.events("a.raw");
    let causes = array(&folder, "a.npz", "cause").expect("causes").bytes;
    let write = |name: &str, keep: &dyn Fn(usize, u8) -> bool| {
        let kept = events.iter().zip(&causes).enumerate();
        let kept: Vec<Event> = kept
            .filter(|(index, (_, cause))| keep(*index, **cause))
            .map(|(_, (event, _))| *event)
            .collect();
        let mut writer = event_files::create(&folder.path(name), sensor).expect("a file");
        writer.write(&kept).expect("events");
        writer.finish().expect("a file");
        kept.len()
    };
    let judged = |name: &str| {
        let line = format!("compare a.raw {name} --truth a.npz --json");
        folder.eecvs(&line).ok().object()["denoising"].clone()
    };
    let signal = write("signal.raw", &|_, cause| cause == 0);
    let found = judged("signal.raw");
    for share in ["precision", "recall", "noise_removed"] {
        assert_eq!(number(&found, share), 1.0, "{found}");
    }
    let kept = write("third.raw", &|index, _| index % 3 == 0);
    let found = judged("third.raw");
    let of_signal = causes
        .iter()
        .step_by(3)
        .filter(|cause| **cause == 0)
        .count();
    assert_eq!(number(&found, "precision"), of_signal as f64 / kept as f64);
    assert_eq!(number(&found, "recall"), of_signal as f64 / signal as f64);

    // The encoder's filter of isolated events: more noise is removed than signal.
    folder.eecvs("encode a.raw -o b.eecvs --isolated").ok();
    let found = judged("b.eecvs");
    let (recall, removed) = (number(&found, "recall"), number(&found, "noise_removed"));
    assert!(removed > 0.3 && removed > 1.5 * (1.0 - recall), "{found}");
    assert!(number(&found, "precision") > signal as f64 / causes.len() as f64);

    let table = folder
        .eecvs("compare a.raw third.raw --truth a.npz")
        .ok()
        .stdout;
    let line = format!("{of_signal} of {signal}");
    assert!(
        table.contains("precision") && table.contains(&line),
        "{table}"
    );
    // As many events, but others, or in another order.
    let table = |folder: &Folder, name: &str, swap: bool| {
        folder
            .eecvs(&format!("convert a.raw {name} --overwrite"))
            .ok();
        let text = String::from_utf8(folder.bytes(name)).expect("text");
        let mut lines: Vec<&str> = text.lines().collect();
        let last = lines.len() - 1;
        let time = |line: &str| line.split(',').next().map(str::to_owned);
        if swap {
            let same = (1..last).find(|i| time(lines[*i]) == time(lines[i + 1]));
            let same = same.expect("two events of one time");
            lines.swap(same, same + 1);
        } else {
            lines[last] = lines[last - 1];
        }
        folder.write(name, lines.join("\n") + "\n");
    };
    table(&folder, "swapped.csv", true);
    table(&folder, "other.csv", false);
    for (line, reason) in [
        (
            "compare signal.raw a.raw --truth a.npz",
            "another recording",
        ),
        (
            "compare swapped.csv a.raw --truth a.npz",
            "in another order",
        ),
        ("compare other.csv a.raw --truth a.npz", "other events"),
        (
            "compare a.raw a.raw --truth none.npz",
            "none.npz: cannot be opened",
        ),
        ("compare a.raw a.raw --truth a.raw", "a.raw: byte 0"),
    ] {
        folder.eecvs(line).fails(&[reason]);
    }
    folder
        .eecvs("emulate motorcycle -o c.raw --truth c.npz --model 1 --duration-us 10000")
        .ok();
    folder
        .eecvs("compare c.raw c.raw --truth c.npz")
        .fails(&["has no array cause, but t_us, object"]);
    // A truth that is damaged.
    let mut bytes = folder.bytes("a.npz");
    let place = bytes
        .windows(9)
        .position(|name| name == b"cause.npy")
        .expect("an entry");
    bytes[place + 200] ^= 1;
    folder.write("a.npz", bytes);
    folder
        .eecvs("compare a.raw a.raw --truth a.npz")
        .fails(&["a.npz"]);
}
