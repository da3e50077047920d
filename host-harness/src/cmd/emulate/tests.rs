use clap::{CommandFactory, Parser};
use eecvs_nostd::Event;
use event_files::EventWriter;
use event_types::stream::Response;

use super::*;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    emulate: Emulate,
}

fn parse(line: &str) -> Result<Emulate, clap::Error> {
    let words = std::iter::once("emulate").chain(line.split_whitespace());
    Line::try_parse_from(words).map(|line| line.emulate)
}

/// A recording in memory; writing fails once it holds more than `room` events.
struct Memory {
    events: Vec<Event>,
    room: usize,
}

impl EventWriter for Memory {
    fn write(&mut self, events: &[Event]) -> event_types::stream::Result<()> {
        self.events.extend_from_slice(events);
        event_types::ensure!(self.events.len() <= self.room, CannotHold, "full");
        Ok(())
    }

    fn finish(self: Box<Self>) -> event_types::stream::Result<()> {
        Ok(())
    }
}

#[test]
fn flags_are_checked() {
    Line::command().debug_assert();
    let ok = "indoor-flying -o a.csv --seed 9 --width 2048 --height 1 --duration-us 0 --json";
    let parsed = parse(ok).unwrap();
    assert_eq!(parsed.input, Some(Input::Scene(Preset::IndoorFlying)));
    assert_eq!((parsed.width, parsed.height), (Some(2048), Some(1)));
    assert!(parse("--list").unwrap().list);
    for bad in [
        "",
        "indoor-flying",
        "-o a.csv",
        "indoor-flying -o a.csv --width 10",
        "indoor-flying -o a.csv --width 0 --height 1",
        "indoor-flying -o a.csv --width 1 --height 2049",
        "indoor-flying -o a.csv --duration-us -1",
    ] {
        assert!(parse(bad).is_err(), "{bad}");
    }
    let message = parse("moon -o a.csv").unwrap_err().to_string();
    assert!(
        PRESETS.iter().all(|p| message.contains(p.name())),
        "{message}"
    );
}

#[test]
fn list_has_a_line_about_every_scene() {
    let list = scenes();
    assert_eq!(list.lines().count(), PRESETS.len());
    for (line, preset) in list.lines().zip(PRESETS) {
        let about = line.strip_prefix(preset.name()).unwrap();
        assert!(about.trim().len() > 10, "{line}");
    }
    let json = serde_json::to_value(listed()).unwrap();
    let scenes = json.as_array().unwrap();
    assert_eq!(scenes.len(), PRESETS.len());
    for (scene, preset) in scenes.iter().zip(PRESETS) {
        let expected = serde_json::json!({
            "scene": preset.name(),
            "about": preset.about(),
            "width": 346,
            "height": 260,
            "duration_us": 1_000_000,
        });
        assert_eq!(*scene, expected);
    }
}

#[test]
fn every_event_is_written_and_counted() {
    let mut config = SceneConfig::model_1(Preset::Motorcycle, 4);
    config.duration_us = 30_000;
    let mut writer = Memory {
        events: Vec::new(),
        room: usize::MAX,
    };
    let mut emulator = event_emulator::emulate(config).unwrap();
    let written = write_events(&mut emulator, None, &mut writer, None, None).unwrap();
    assert_eq!(written.events, writer.events.len() as u64);
    assert!(written.on > 0 && written.on < written.events);

    let mut again = event_emulator::emulate(config).unwrap();
    let mut expected = Vec::new();
    while again.read(&mut expected).unwrap() > 0 {}
    assert_eq!(writer.events, expected);

    writer.events.clear();
    writer.room = 10;
    let mut emulator = event_emulator::emulate(config).unwrap();
    assert!(write_events(&mut emulator, None, &mut writer, None, None).is_err());
}

/// A night of 2 events per pixel and second.
fn night() -> Emulated {
    Emulated {
        source: Source::Scene(Preset::OutdoorDark),
        readout: None,
        truth: None,
        sensor: Preset::OutdoorDark.sensor(),
        start_us: 0,
        duration_us: 1_000_000,
        model: Model::Steps,
        samples: None,
        written: Written {
            events: 179_920,
            on: 89_000,
        },
        seconds: 0.5,
    }
}

#[test]
fn report_is_one_json_object_or_a_table() {
    let (file, pixel) = (Path::new("x/night.csv"), PixelParameters::default());
    let mut night = night();
    let value = night.json(file, 7, &pixel);
    assert_eq!(value["scene"], "outdoor-dark");
    assert_eq!(value["off"], 90_920);
    assert_eq!(value["density_per_px_s"], 2.0);
    assert!(value.get("pixel").is_none());
    assert!(night.table(file, 7).contains("file      x/night.csv\n"));
    night.duration_us = 0;
    assert_eq!(night.json(file, 7, &pixel)["density_per_px_s"], 0.0);
    night.source = Source::Video {
        name: "a.y4m".to_owned(),
        format: "y4m",
        frames: 31,
        exposure: Exposure::of(Response::Srgb),
    };
    let value = night.json(file, 7, &pixel);
    assert_eq!(
        (&value["video"], &value["frames"]),
        (&"a.y4m".into(), &31.into())
    );
    assert_eq!(
        (&value["response"], &value["white_lux"]),
        (&"srgb".into(), &300.0.into())
    );
    assert!(
        night
            .table(file, 7)
            .contains("light     srgb, white at 300 lx")
    );
}

#[test]
fn model_2_gives_the_same_file_with_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str, flags: &str| {
        let file = dir.path().join(name);
        let line = format!(
            "motorcycle -o {} --width 70 --height 50 --duration-us 30000 --json {flags}",
            file.display()
        );
        parse(&line)
            .unwrap()
            .run()
            .map(|()| std::fs::read(file).unwrap())
    };
    let one = run("1.csv", "--model 2 --threads 1").unwrap();
    assert!(one.len() > 1_000);
    assert_eq!(run("2.csv", "--threads 2").unwrap(), one);
    assert_eq!(run("3.csv", "").unwrap(), one);
    assert_ne!(run("4.csv", "--model 2 --threshold-on 0.5").unwrap(), one);
    assert_ne!(run("5.csv", "--model 1").unwrap(), one);
    for flags in ["--threads 2", "--no-noise", "--leak-hz 1"] {
        let error = run("6.csv", &format!("--model 1 {flags}"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("leave out --model 1"), "{error}");
        assert!(!dir.path().join("6.csv").exists());
    }
    let error = run("7.csv", "--model 2 --threshold-on 0").unwrap_err();
    assert!(error.to_string().contains("give 0.01 to 10"), "{error}");
    assert!(!dir.path().join("7.csv").exists());
}

#[test]
fn the_report_of_model_2_has_the_pixel() {
    let night = Emulated {
        model: Model::Physical,
        samples: Some(89_960_000),
        ..night()
    };
    let (file, pixel) = (Path::new("x.csv"), PixelParameters::default());
    let value = night.json(file, 7, &pixel);
    assert_eq!(value["samples_per_px_s"], 1_000.0);
    assert_eq!(value["pixel"]["refractory_us"], 300.0);
    let text = night.table(file, 7);
    assert!(text.contains("sampled   1000 times/px/s"), "{text}");
}

#[test]
fn a_camera_has_its_size_and_loses_what_its_link_does_not_take() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    let run = |flags: &str| {
        let line = format!(
            "indoor-flying -o {} --overwrite --duration-us 20000 {flags}",
            path.display()
        );
        parse(&line).unwrap().run().unwrap();
        std::fs::read_to_string(&path).unwrap().lines().count()
    };
    let all = run("--width 128 --height 128");
    let read = run("--camera dvs128 --buffer-events 1000000");
    assert_eq!(read, all);
    let part = run("--camera dvs128 --link-per-us 0.001 --buffer-events 50");
    // A header, what the buffer holds, and what goes over the link in 20 ms.
    assert!((50..=90).contains(&part) && part < all, "{part} of {all}");
    let line = format!(
        "indoor-flying -o {} --overwrite --row-ns -1",
        path.display()
    );
    assert!(parse(&line).unwrap().run().is_err());
}

#[test]
fn a_video_is_a_path_that_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.y4m");
    let line = |rest: &str| {
        format!(
            "{} -o {}/b.csv {rest}",
            path.display(),
            folder.path().display()
        )
    };
    assert!(parse(&line("")).is_err());
    let mut video = b"YUV4MPEG2 W16 H2 F100:1 Ip Cmono\n".to_vec();
    for frame in 0..3_u8 {
        video.extend_from_slice(b"FRAME\n");
        video.extend((0..32).map(|i| 20 + 3 * i * frame));
    }
    std::fs::write(&path, &video).unwrap();
    parse(&line("--no-noise --threads 1"))
        .unwrap()
        .run()
        .unwrap();
    let text = std::fs::read_to_string(folder.path().join("b.csv")).unwrap();
    assert!(text.lines().count() > 50, "{text}");
    let said = |rest: &str| {
        let line = line(&format!("--overwrite {rest}"));
        format!("{:#}", parse(&line).unwrap().run().unwrap_err())
    };
    for (flags, what) in [
        ("--model 1", "model 1 has scenes only"),
        ("--width 16 --height 2", "a size of its own"),
        ("--flare 0", "flare is 0"),
        ("--white 0", "white is 0"),
        ("--leak-hz -1", "give 0 to 1000"),
        (
            "--times nowhere.txt --time-unit s",
            "nowhere.txt: cannot be opened",
        ),
    ] {
        assert!(said(flags).contains(what), "{flags}: {}", said(flags));
    }
    // What was there is still there.
    assert_eq!(
        std::fs::read_to_string(folder.path().join("b.csv")).unwrap(),
        text
    );
    video.pop();
    std::fs::write(&path, &video).unwrap();
    let cut = said("");
    assert!(cut.contains("frame 2 ends after 31 of 32 bytes"), "{cut}");
    assert_eq!(cut.matches("a.y4m").count(), 1, "{cut}");
    let absent = parse("nowhere.y4m -o a.csv").unwrap_err().to_string();
    assert!(absent.contains("'nowhere.y4m' is neither"), "{absent}");
    assert_eq!(
        std::fs::read_to_string(folder.path().join("b.csv")).unwrap(),
        text
    );
    let scene = format!("outdoor-dark -o {}/c.csv --fps 30", folder.path().display());
    let error = parse(&scene).unwrap().run().unwrap_err();
    assert!(error.to_string().contains("flags of videos"), "{error}");
    assert!(parse("- --fps 0 -o a.csv").is_err());
    assert!(parse("- --times a.txt -o a.csv").is_err());
}

/// Videos of ffmpeg's test picture, in 8 and 10 bits, become events, and these frames that decode to the same events.
#[test]
fn videos_of_ffmpeg_become_events_and_frames() {
    #[derive(Debug, Parser)]
    struct EncodeLine {
        #[command(flatten)]
        encode: crate::cmd::encode::Encode,
    }

    if std::process::Command::new("ffmpeg")
        .arg("-version")
        .output()
        .is_err()
    {
        eprintln!("skipped: ffmpeg is not there");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let events_of = |name: &str| {
        let mut reader = event_files::open(&folder.path().join(name), None).unwrap();
        assert_eq!((reader.sensor().width, reader.sensor().height), (96, 64));
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    };
    let mut counts = Vec::new();
    for format in ["yuv420p", "yuv444p", "yuvj422p", "yuv420p10le", "gray"] {
        let made = std::process::Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi"])
            .args(["-i", "testsrc=size=96x64:rate=120:duration=0.5"])
            .args([
                "-pix_fmt",
                format,
                "-strict",
                "-1",
                "-f",
                "yuv4mpegpipe",
                "-y",
            ])
            .arg(path("in.y4m"))
            .status()
            .unwrap();
        assert!(made.success(), "{format}");
        let line = format!(
            "{} -o {} --no-noise --overwrite",
            path("in.y4m"),
            path("out.raw")
        );
        parse(&line).unwrap().run().unwrap();
        counts.push(events_of("out.raw").len());
    }
    // The same picture, but for what its chroma loses and its bits round.
    let most = counts.iter().max().copied().unwrap();
    assert!(
        counts
            .iter()
            .all(|count| *count > 500 && 10 * count > 9 * most),
        "{counts:?}"
    );
    let line = format!("encode {} -o {}", path("out.raw"), path("out.eecvs"));
    let line = EncodeLine::try_parse_from(line.split_whitespace()).unwrap();
    line.encode.run().unwrap();
    assert_eq!(events_of("out.raw"), events_of("out.eecvs"));
}

#[test]
fn run_names_what_cannot_be() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.unknown");
    let line = format!("outdoor-dark -o {}", file.display());
    let error = parse(&line).unwrap().run().unwrap_err();
    assert!(format!("{error:#}").contains("scene.unknown"), "{error:#}");
    assert!(!file.exists());
    let file = dir.path().join("scene.raw");
    let late = format!("outdoor-dark -o {} --start-us {}", file.display(), u64::MAX);
    let error = parse(&late).unwrap().run().unwrap_err();
    assert!(format!("{error:#}").contains("earlier start"), "{error:#}");
}
