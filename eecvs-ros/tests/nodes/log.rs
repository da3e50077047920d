//! The tables of `log`: what an encoder counted, and the values that the decoder of files finds, in every kind of file.

use std::io::Cursor;
use std::path::Path;
use std::time::{Duration, Instant};

use clap::Parser;
use eecvs::decode::WindowReader;
use eecvs::encode::{EncodeSummary, Limits};
use eecvs::frame_file::FrameReader;
use eecvs_cli::codec::CodecOptions;
use eecvs_nostd::Sensor;
use eecvs_ros::arguments::RosArguments;
use eecvs_ros::message::{Frame, Header, Message, Time, to_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::node::log::Log;
use eecvs_ros::node::{Context, NAMESPACE};
use eecvs_ros::operator::{Eecvs, Job, Operator, Operators, Windowed};
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::local::Local;
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use usb_bridge::stop::Stop;

use crate::program::{PATIENCE, Program, QOS};
use crate::tables::{Row, csv, mcap, number, parquet};

#[derive(Parser)]
#[command(args_override_self = true)]
struct LogLine {
    #[command(flatten)]
    log: Log,
}

#[derive(Parser)]
struct CodecLine {
    #[command(flatten)]
    codec: CodecOptions,
}

fn scene() -> Box<dyn EventReader> {
    let mut config = SceneConfig::model_1(Preset::IndoorFlying, 1);
    config.duration_us = 200_000;
    config.sensor = Sensor::new(120, 90).unwrap();
    Box::new(emulate(config).unwrap())
}

/// What an operator makes of the scene, as messages, frames of few bytes so that windows take several.
fn encoded(operator: &dyn Operator, flags: &str) -> (EncodeSummary, Vec<Frame>) {
    let line = std::iter::once("codec").chain(flags.split_whitespace());
    let codec = CodecLine::parse_from(line).codec;
    let limits = Limits {
        frame_bytes: 3000,
        ..Limits::default()
    };
    let job = Job {
        codec: &codec,
        limits,
    };
    let mut frames = Vec::new();
    let summary = operator.encode(scene(), &job, &mut |encoded| {
        let span = encoded.span;
        let seq = frames.len() as u64;
        frames.push(Frame {
            header: Header {
                stamp: Time::from_ns(1_700_000_000_000_000_001 + seq as i64),
                frame_id: String::new(),
            },
            seq,
            t0_us: span.t0_us,
            duration_us: span.duration_us,
            height: span.sensor.height.into(),
            width: span.sensor.width.into(),
            events: encoded.events,
            operator_name: operator.name().to_owned(),
            data: encoded.data.to_vec(),
        });
        Ok(())
    });
    (summary.unwrap(), frames)
}

/// Runs the node until messages have not come for a second.
fn log(messages: &[Vec<u8>], operators: &Operators, flags: &[&str], stop: &Stop) {
    try_log(messages, operators, flags, stop).unwrap();
}

/// As [`log`], where it may fail.
fn try_log(
    messages: &[Vec<u8>],
    operators: &Operators,
    flags: &[&str],
    stop: &Stop,
) -> anyhow::Result<()> {
    let local = Local::alone();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = local.node(&name, &Parameters::none()).unwrap();
    let topic = format!("{NAMESPACE}/frames");
    let mut publisher = node.publisher(&topic, Frame::TYPE, QOS).unwrap();
    let mut line = vec!["log", "--idle-s", "1", "--depth", "100000"];
    line.extend(flags);
    let log = LogLine::parse_from(line).log;
    let arguments = RosArguments::default().node(NAMESPACE, "log", &[]);
    let context =
        Context::new(&local, arguments.unwrap(), Parameters::none(), stop.clone()).unwrap();
    std::thread::scope(|scope| {
        let run = scope.spawn(|| log.run(context, operators));
        while publisher.subscribers() == 0 {
            assert!(!run.is_finished(), "{:?}", run.join());
            std::thread::sleep(Duration::from_millis(1));
        }
        for message in messages {
            publisher.publish(message).unwrap();
        }
        run.join().unwrap()
    })
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Both tables as every kind of file has them; they are the same.
fn tables_of(messages: &[Vec<u8>], operators: &Operators) -> (Vec<Row>, Vec<Row>) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let names = ["f.csv", "c.csv", "f.parquet", "c.parquet", "both.mcap"].map(path);
    let [f_csv, c_csv, f_parquet, c_parquet, both] = &names;
    std::thread::scope(|scope| {
        for [features, coefficients] in [[f_csv, c_csv], [f_parquet, c_parquet], [both, both]] {
            scope.spawn(move || {
                let flags = [
                    "--features",
                    text(features),
                    "--coefficients",
                    text(coefficients),
                    // Some messages are left out on purpose.
                    "--allow-loss",
                ];
                log(messages, operators, &flags, &Stop::default());
            });
        }
    });
    let features = csv(f_csv);
    let coefficients = csv(c_csv);
    assert!(parquet(f_parquet) == features, "features");
    assert!(parquet(c_parquet) == coefficients, "coefficients");
    assert!(mcap(both, "/event_camera/features") == features);
    assert!(mcap(both, "/event_camera/coefficients") == coefficients);
    (features, coefficients)
}

fn sum(rows: &[Row], column: &str) -> u64 {
    rows.iter()
        .filter_map(|row| row.get(column))
        .map(|text| text.parse::<u64>().unwrap())
        .sum()
}

fn cell<'r>(row: &'r Row, column: &str) -> &'r str {
    row.get(column).map_or("", String::as_str)
}

/// The rows that the decoder of files gives.
fn decoded(frames: &[Frame]) -> (Vec<[String; 8]>, Vec<Vec<String>>) {
    let bytes: Vec<u8> = frames.iter().flat_map(|frame| frame.data.clone()).collect();
    let mut windows = WindowReader::new(FrameReader::new(Cursor::new(bytes)));
    let (mut features, mut coefficients) = (Vec::new(), Vec::new());
    while let Some(window) = windows.next_window().unwrap() {
        let header = window.header;
        let (area, seconds) = (120.0 * 90.0, f64::from(header.duration_us) * 1e-6);
        let density = f64::from(header.window_events) / area / seconds;
        let kept: usize = window.pixels.iter().map(|p| p.coefficients.len()).sum();
        let is_transform = header.mode.is_transform();
        let told = |count: usize| {
            if is_transform {
                count.to_string()
            } else {
                String::new()
            }
        };
        features.push([
            header.t0_us.to_string(),
            header.duration_us.to_string(),
            header.window_events.to_string(),
            format!("{density:.9}"),
            header.regime.name().to_owned(),
            header.transform.name().to_owned(),
            told(kept),
            told(window.pixels.len()),
        ]);
        for pixel in &window.pixels {
            for (k, re, im) in &pixel.coefficients {
                let im = header.transform.is_complex().then(|| number(*im));
                coefficients.push(vec![
                    header.t0_us.to_string(),
                    header.transform.name().to_owned(),
                    pixel.x.to_string(),
                    pixel.y.to_string(),
                    k.to_string(),
                    number(*re),
                    im.unwrap_or_default(),
                ]);
            }
        }
    }
    (features, coefficients)
}

fn check(features: &[Row], coefficients: &[Row], want: &(Vec<[String; 8]>, Vec<Vec<String>>)) {
    let got: Vec<[String; 8]> = features
        .iter()
        .map(|row| {
            let density = cell(row, "density_per_px_s").parse::<f64>().unwrap();
            [
                cell(row, "t0_us").to_owned(),
                cell(row, "duration_us").to_owned(),
                cell(row, "window_events").to_owned(),
                format!("{density:.9}"),
                cell(row, "regime").to_owned(),
                cell(row, "transform").to_owned(),
                cell(row, "coefficients").to_owned(),
                cell(row, "coefficient_pixels").to_owned(),
            ]
        })
        .collect();
    assert_eq!(got, want.0);
    let columns = ["t0_us", "transform", "x", "y", "k", "re", "im"];
    let got: Vec<Vec<String>> = coefficients
        .iter()
        .map(|row| columns.map(|column| cell(row, column).to_owned()).to_vec())
        .collect();
    assert!(got == want.1, "{} rows, {}", got.len(), want.1.len());
}

#[test]
fn tables_hold_what_was_encoded() {
    let operators = Operators::new(Vec::new());
    for (flags, mode, coder) in [
        ("--mode transform --window-us 20000", "transform", "plain"),
        (
            "--mode transform --transform dtft --coder dense",
            "transform",
            "dense",
        ),
        (
            "--mode transform --transform dct --coder fast",
            "transform",
            "fast",
        ),
        ("--mode hybrid --isolated", "hybrid", "fast"),
        (
            "--mode hybrid --coder dense --time-tolerance-us 40",
            "hybrid",
            "dense",
        ),
    ] {
        let (summary, frames) = encoded(&Eecvs, flags);
        assert!(summary.frames > summary.windows, "{flags}: {summary:?}");
        let messages: Vec<Vec<u8>> = frames.iter().map(to_cdr).collect();
        let (features, coefficients) = tables_of(&messages, &operators);
        let counted = [
            ("events", summary.events_encoded),
            ("bytes", summary.bytes_out),
            ("frames", summary.frames),
            ("late", summary.events_late),
            ("filtered", summary.events_filtered),
            ("dropped", summary.events_dropped),
            ("thinned", summary.events_thinned),
            ("coefficients", coefficients.len() as u64),
            ("frames_lost", 0),
        ];
        for (column, count) in counted {
            assert_eq!(sum(&features, column), count, "{flags}: {column}");
        }
        assert_eq!(features.len() as u64, summary.windows, "{flags}");
        assert_eq!(coefficients.is_empty(), mode == "hybrid", "{flags}");
        check(&features, &coefficients, &decoded(&frames));
        let mut bits = 0.0;
        for row in &features {
            assert_eq!((cell(row, "mode"), cell(row, "coder")), (mode, coder));
            let per_event: f64 = cell(row, "bits_per_event").parse().unwrap();
            bits += per_event * cell(row, "events").parse::<f64>().unwrap();
        }
        assert!((bits / 8.0 - summary.bytes_out as f64).abs() < 1e-3);
        let last = features.last().unwrap();
        assert_eq!(cell(last, "seq"), (frames.len() - 1).to_string());
        let stamp_ns = frames.last().unwrap().header.stamp.ns();
        assert_eq!(cell(last, "stamp_ns"), stamp_ns.to_string());
    }
}

#[test]
fn losses_leave_the_rest_as_it_is() {
    let operators = Operators::new(Vec::new());
    let (_, mut frames) = encoded(&Eecvs, "--mode transform --window-us 20000");
    let last = frames.len() - 1;
    // The first of a window and the last of all are missing too.
    frames.retain(|frame| frame.seq % 7 != 3 && frame.seq != 0 && frame.seq != last as u64);
    let mut sent = frames.clone();
    sent[4].operator_name = "none".to_owned();
    let middle = sent[8].data.len() / 2;
    sent[8].data[middle] ^= 1;
    frames.remove(8);
    frames.remove(4);
    let mut messages: Vec<Vec<u8>> = sent.iter().map(to_cdr).collect();
    messages.insert(6, vec![1, 2, 3]);
    let (features, coefficients) = tables_of(&messages, &operators);
    check(&features, &coefficients, &decoded(&frames));
    let bytes: usize = frames.iter().map(|frame| frame.data.len()).sum();
    assert_eq!(sum(&features, "bytes"), bytes as u64);
    let events: u64 = frames.iter().map(|frame| u64::from(frame.events)).sum();
    assert_eq!(sum(&features, "events"), events);
    // Those that were left out have come.
    let missing = (0..last as u64)
        .filter(|seq| *seq > 0 && seq % 7 == 3)
        .count();
    let lost = cell(features.last().unwrap(), "frames_lost");
    assert_eq!(lost, missing.to_string());
    // The same without leave to lose anything.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("f.csv");
    let flags = ["--features", text(&path)];
    let refused = try_log(&messages, &operators, &flags, &Stop::default()).unwrap_err();
    let want = format!("{missing} frames have not arrived, 3 frames were left out");
    assert!(refused.to_string().contains(&want), "{refused}");
    assert!(csv(&path) == features);
}

/// A window coder whose windows tell no more than their span.
struct Counts;

impl eecvs_ros::operator::WindowCoder for Counts {
    fn name(&self) -> &'static str {
        "counts"
    }

    fn encode(
        &self,
        _: eecvs_ros::operator::Span,
        events: &[eecvs_nostd::Event],
        data: &mut Vec<u8>,
    ) {
        data.extend((events.len() as u32).to_le_bytes());
    }

    fn decode(
        &self,
        span: eecvs_ros::operator::Span,
        data: &[u8],
    ) -> anyhow::Result<Vec<eecvs_nostd::Event>> {
        let count = u32::from_le_bytes(data.try_into()?);
        let event = eecvs_nostd::Event {
            t_us: span.t0_us,
            x: 0,
            y: 0,
            polarity: eecvs_nostd::Polarity::On,
        };
        Ok(vec![event; count as usize])
    }
}

#[test]
fn of_another_operator_what_it_tells() {
    let operators = Operators::new(vec![Box::new(Windowed::new(Counts))]);
    let (summary, frames) = encoded(&Windowed::new(Counts), "--window-us 10000");
    let messages: Vec<Vec<u8>> = frames.iter().map(to_cdr).collect();
    let (features, coefficients) = tables_of(&messages, &operators);
    assert!(coefficients.is_empty());
    assert_eq!(features.len() as u64, summary.windows);
    assert_eq!(sum(&features, "events"), summary.events_encoded);
    assert_eq!(sum(&features, "bytes"), summary.bytes_out);
    for row in &features {
        assert_eq!(cell(row, "operator"), "counts");
        let untold = ["mode", "coder", "regime", "transform", "m", "coefficients"];
        assert_eq!(untold.map(|column| cell(row, column)), [""; 6]);
        assert!(cell(row, "density_per_px_s").parse::<f64>().unwrap() > 0.0);
    }
}

#[test]
fn files_are_whole_when_it_is_asked_to_stop() {
    let operators = Operators::new(Vec::new());
    let (_, frames) = encoded(&Eecvs, "--mode transform");
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (features, coefficients) = (path("f.csv"), path("c.parquet"));
    let stop = Stop::default();
    let flags = [
        "--idle-s",
        "600",
        "--features",
        text(&features),
        "--coefficients",
        text(&coefficients),
    ];
    // Without the last frame of the last window.
    let messages: Vec<Vec<u8>> = frames[..frames.len() - 1].iter().map(to_cdr).collect();
    let want = decoded(&frames[..frames.len() - 1]);
    std::thread::scope(|scope| {
        scope.spawn(|| log(&messages, &operators, &flags, &stop));
        let until = Instant::now() + PATIENCE;
        // Windows are there as soon as they have ended.
        while !features.exists() || csv(&features).len() + 1 < want.0.len() {
            assert!(Instant::now() < until);
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(200));
        stop.ask();
    });
    check(&csv(&features), &parquet(&coefficients), &want);
}

#[test]
fn no_frames_are_empty_tables_and_no_file_is_written_over() {
    let operators = Operators::new(Vec::new());
    let stop = Stop::default();
    stop.ask();
    let (features, coefficients) = {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let (features, coefficients) = (path("f.parquet"), path("c.csv"));
        let flags = [
            "--features",
            text(&features),
            "--coefficients",
            text(&coefficients),
        ];
        log(&[], &operators, &flags, &stop);
        let tables = (parquet(&features), csv(&coefficients));
        let run = |flags: &[&str]| {
            let mut line = vec!["log"];
            line.extend(flags);
            let log = LogLine::try_parse_from(line)
                .map_err(|error| error.to_string())?
                .log;
            let local = Local::alone();
            let arguments = RosArguments::default().node(NAMESPACE, "log", &[]);
            let context =
                Context::new(&local, arguments.unwrap(), Parameters::none(), stop.clone()).unwrap();
            let run = log.run(context, &operators);
            run.map_err(|error| format!("{error:#}"))
        };
        let before = std::fs::read(&coefficients).unwrap();
        let new = path("new.csv");
        let flags = [
            "--features",
            text(&new),
            "--coefficients",
            text(&coefficients),
        ];
        let error = run(&flags).unwrap_err();
        assert!(
            error.contains("c.csv") && error.contains("not overwritten"),
            "{error}"
        );
        assert!(!new.exists());
        assert_eq!(std::fs::read(&coefficients).unwrap(), before);
        let flags = ["--features", text(&new), "--coefficients", text(&new)];
        let error = run(&flags).unwrap_err();
        assert!(error.contains("two names") && !new.exists(), "{error}");
        assert!(run(&["--features", "f.txt"]).unwrap_err().contains(".csv"));
        assert!(run(&[]).unwrap_err().contains("--features FILE"));
        tables
    };
    assert!(features.is_empty() && coefficients.is_empty());
}

/// As a program, whose flags are parameters.
#[test]
fn a_program_ends_its_files_when_it_is_terminated() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("log.mcap");
    let [features, coefficients] =
        ["features", "coefficients"].map(|table| format!("log:{table}:={}", file.display()));
    let mut arguments = vec!["compose", "emulate", "encode", "log", "--ros-args"];
    for parameter in [
        features.as_str(),
        coefficients.as_str(),
        "encode:mode:=transform",
        "emulate:repeat:=true",
        "emulate:width:=120",
        "emulate:height:=90",
    ] {
        arguments.extend(["-p", parameter]);
    }
    let program = Program::eecvs_ros(88, &arguments);
    let until = Instant::now() + PATIENCE;
    // A chunk at least.
    while std::fs::metadata(&file).map_or(0, |file| file.len()) < 100_000 {
        assert!(Instant::now() < until);
        std::thread::sleep(Duration::from_millis(50));
    }
    program.terminate();
    let (_, said) = program.finish(PATIENCE);
    assert!(said.contains("log.mcap: written"), "{said}");
    let features = mcap(&file, "/event_camera/features");
    let coefficients = mcap(&file, "/event_camera/coefficients");
    assert_eq!(sum(&features, "coefficients"), coefficients.len() as u64);
    assert!(!coefficients.is_empty());
}
