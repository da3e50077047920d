//! C and C++ programs, on this machine and on microcontrollers in QEMU: the header compiles without a warning, and what they encode and decode is what
//! Rust does.
//!
//! Without a C compiler, or QEMU, the tests say that they skip.

mod cores;
mod packages;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use eecvs_bench::source::Source;
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::{
    Config, Event, Hybrid, Mode, Push, Scratch, Thresholds, Window, WindowBuffers, WindowConfig,
    WindowEncoder,
};
use event_emulator::Preset;

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The static library, which is built with the tests.
fn library() -> PathBuf {
    let program = std::env::current_exe().expect("this program");
    let built = program.parent().expect("target/PROFILE/deps");
    built.join("libeecvs_capi.a")
}

fn has(program: &str) -> bool {
    let version = Command::new(program).arg("--version").output();
    let found = version.is_ok_and(|version| version.status.success());
    if !found {
        println!("skipped: there is no {program}");
    }
    found
}

/// Compiles a source with every warning an error, and links it.
fn compile(compiler: &str, standard: &str, flags: &[String], source: &Path, to: &Path) {
    let warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"];
    let status = Command::new(compiler)
        .args(["-O1", standard])
        .args(warnings)
        .args(flags)
        .arg("-I")
        .arg(folder().join("include"))
        .arg(source)
        .arg(library())
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(to)
        .status();
    assert!(status.expect("the compiler runs").success(), "{source:?}");
}

/// Runs a program on `input`, and returns what it writes.
fn run(command: &mut Command, input: &[u8]) -> Vec<u8> {
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    let output = std::thread::scope(|scope| {
        scope.spawn(move || std::io::Write::write_all(&mut stdin, input));
        child.wait_with_output().expect("the program ends")
    });
    assert!(output.status.success(), "{command:?}: {}", output.status);
    output.stdout
}

fn scene() -> Source {
    Source::scene(Preset::OutdoorWellLitBlur, 1, 150_000).expect("a scene")
}

fn words(events: &[Event]) -> Vec<u8> {
    let mut encoder = Evt2Encoder::new(0);
    let words = events.iter().flat_map(|event| {
        let (time, word) = encoder.encode(*event).expect("a word");
        time.into_iter().chain([word])
    });
    words.flat_map(u32::to_le_bytes).collect()
}

/// The frames that Rust's encoder makes with the settings of `examples/encode.c`.
fn frames(scene: &Source) -> Vec<u8> {
    let mode = Mode::Hybrid(Hybrid::default());
    let window = WindowConfig::new(scene.sensor, 32_768);
    let config = Config {
        transform: Some(eecvs_nostd::Transform::Dct),
        ..Config::new(window, Thresholds::new(0, 0).expect("equal"), mode)
    };
    let segments = window.segments();
    let (mut slots, mut heads) = (vec![eecvs_nostd::Slot::EMPTY; 2048], vec![0; segments]);
    let mut bitmap = vec![0; eecvs_nostd::bitmap_words(segments)];
    let buffers = WindowBuffers {
        slots: &mut slots,
        heads: &mut heads,
        bitmap: &mut bitmap,
    };
    let mut window = Window::new(config.windows(), buffers).expect("a window");
    let scratch = Scratch {
        sums: &mut [],
        totals: &mut [],
        magnitudes: &mut [],
        dense: None,
        tree: None,
        keys: None,
        coefficients: None,
        hot: &mut [],
        order: &mut [],
    };
    let mut encoder = WindowEncoder::new(config, scratch).expect("a configuration");
    let (mut out, mut frames) = (vec![0; 4096], Vec::new());
    let mut take = |window: &mut Window<'_>| {
        while let Some(frame) = encoder.next_frame(window, &mut out).expect("room") {
            frames.extend_from_slice(&out[frame.range]);
        }
    };
    for event in scene.events.iter() {
        while window.push(*event) == Push::Closed {
            take(&mut window);
        }
    }
    window.flush();
    take(&mut window);
    frames
}

fn lines(events: &[Event]) -> Vec<String> {
    let line = |event: &Event| {
        let Event { t_us, x, y, .. } = event;
        format!("{t_us} {x} {y} {}", u8::from(event.polarity.sign() > 0))
    };
    let mut lines: Vec<_> = events.iter().map(line).collect();
    lines.sort_unstable();
    lines
}

#[test]
fn a_c_program_makes_rusts_frames_and_reads_them() {
    if !has("cc") {
        return;
    }
    let made = tempfile::tempdir().expect("a folder");
    let programs = ["encode", "decode"].map(|name| {
        let to = made.path().join(name);
        let source = folder().join("examples").join(name).with_extension("c");
        compile("cc", "-std=c99", &[], &source, &to);
        to
    });
    let scene = scene();
    let sensor = [scene.sensor.width, scene.sensor.height].map(|side| side.to_string());
    let encoded = run(
        Command::new(&programs[0]).args(&sensor),
        &words(&scene.events),
    );
    assert!(encoded == frames(&scene), "{} bytes", encoded.len());
    let decoded = run(&mut Command::new(&programs[1]), &encoded);
    let mut decoded: Vec<_> = std::str::from_utf8(&decoded)
        .expect("text")
        .lines()
        .collect();
    decoded.sort_unstable();
    assert!(decoded == lines(&scene.events), "{} events", decoded.len());
    if has("valgrind") {
        let checks = ["-q", "--error-exitcode=9", "--leak-check=full"];
        let checked = |program: &Path| {
            let mut command = Command::new("valgrind");
            command.args(checks).arg(program);
            command
        };
        let few = words(&scene.events[..20_000]);
        let frames = run(checked(&programs[0]).args(&sensor), &few);
        run(&mut checked(&programs[1]), &frames);
    }
}

/// Compiles a program and runs it.
fn compile_and_run(compiler: &str, standard: &str, source: &str) {
    if !has(compiler) {
        return;
    }
    let made = tempfile::tempdir().expect("a folder");
    let to = made.path().join("program");
    compile(compiler, standard, &[], &folder().join(source), &to);
    run(&mut Command::new(to), &[]);
}

#[test]
fn a_cpp_program_owns_encoder_and_decoder() {
    compile_and_run("c++", "-std=c++17", "examples/round_trip.cpp");
}

#[test]
fn the_header_reserves_what_an_encoder_takes() {
    compile_and_run("cc", "-std=c99", "tests/c/memory.c");
}
