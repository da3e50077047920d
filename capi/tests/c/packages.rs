//! The ways in which C and C++ programs find the library: `make install`, pkg-config, CMake, and the examples of what this
//! machine has no tools for, Zephyr and Arduino, against doubles of the few functions that they call.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{compile, folder, frames, has, library, run, scene, words};

/// Runs a command; returns what it writes.
fn output(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {said}");
    String::from_utf8(output.stdout).expect("text")
}

/// Installs the library that is built with the tests under a folder.
fn install(under: &Path) {
    let built = under.join("built");
    fs::create_dir(&built).expect("a folder");
    fs::copy(library(), built.join("libeecvs.a")).expect("the library can be copied");
    let mut shared = library();
    for (extension, name) in [("so", "libeecvs.so"), ("dylib", "libeecvs.dylib")] {
        shared.set_extension(extension);
        if shared.exists() {
            fs::copy(&shared, built.join(name)).expect("the library can be copied");
        }
    }
    output(
        Command::new("make")
            .arg("-C")
            .arg(folder())
            .arg("install")
            .arg(format!("PREFIX={}", under.display()))
            .arg(format!("FOLDER={}", built.display())),
    );
}

/// Encodes a scene by a built example, and compares the frames.
fn encodes(program: &Path, libraries: &Path) {
    let scene = scene();
    let sensor = [scene.sensor.width, scene.sensor.height].map(|side| side.to_string());
    let mut command = Command::new(program);
    command.args(&sensor).env("LD_LIBRARY_PATH", libraries);
    let encoded = run(&mut command, &words(&scene.events));
    assert!(
        encoded == frames(&scene),
        "{}: {} bytes",
        program.display(),
        encoded.len()
    );
}

#[test]
fn an_installed_library_is_found_by_pkg_config() {
    if !["make", "pkg-config", "cc"].into_iter().all(has) {
        return;
    }
    let made = tempfile::tempdir().expect("a folder");
    install(made.path());
    let flags = |with: &[&str]| {
        let mut command = Command::new("pkg-config");
        command.args(with).arg("eecvs");
        command.env("PKG_CONFIG_PATH", made.path().join("lib/pkgconfig"));
        let flags = output(&mut command);
        flags
            .split_whitespace()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!(flags(&["--modversion"]), [version]);
    let shared = made.path().join("shared");
    let fixed = made.path().join("static");
    for (program, with) in [
        (&shared, vec!["--cflags", "--libs"]),
        (&fixed, vec!["--cflags", "--libs", "--static"]),
    ] {
        let mut command = Command::new("cc");
        if program == &fixed {
            // Without it the linker takes the shared library beside.
            fs::remove_file(made.path().join("lib/libeecvs.so")).ok();
        }
        command
            .arg("-std=c99")
            .arg(folder().join("examples/encode.c"));
        output(command.args(flags(&with)).arg("-o").arg(program));
        encodes(program, &made.path().join("lib"));
    }
}

#[test]
fn an_installed_library_is_found_by_cmake() {
    if !["make", "cmake", "cc", "c++"].into_iter().all(has) {
        return;
    }
    let made = tempfile::tempdir().expect("a folder");
    install(made.path());
    let build = made.path().join("build");
    output(
        Command::new("cmake")
            .arg("-S")
            .arg(folder().join("examples/cmake"))
            .arg("-B")
            .arg(&build)
            .arg(format!("-DCMAKE_PREFIX_PATH={}", made.path().display())),
    );
    output(Command::new("cmake").arg("--build").arg(&build));
    encodes(&build.join("encode"), made.path());
    run(&mut Command::new(build.join("round_trip")), &[]);
}

#[test]
fn the_examples_of_zephyr_and_arduino_encode() {
    let doubles = folder().join("tests/c/doubles");
    let made = tempfile::tempdir().expect("a folder");
    let said = |compiler: &str, standard: &str, source: PathBuf, name: &str| {
        let to = made.path().join(name);
        compile(
            compiler,
            standard,
            &[format!("-I{}", doubles.display())],
            &source,
            &to,
        );
        output(&mut Command::new(to))
    };
    if has("cc") {
        let said = said(
            "cc",
            "-std=c99",
            folder().join("zephyr/sample/src/main.c"),
            "zephyr",
        );
        assert!(
            said.starts_with("2000 events in ") && said.ends_with(" frames\n"),
            "{said}"
        );
    }
    if has("c++") {
        let said = said("c++", "-std=c++17", doubles.join("arduino.cpp"), "arduino");
        assert!(
            said.starts_with("2000 events in ") && said.ends_with(" bytes\n"),
            "{said}"
        );
    }
}
