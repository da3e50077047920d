//! The example in C on the cores that microcontrollers have, in QEMU: its frames are those of Rust on this machine; what it
//! is linked with, and how large that is.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use object::{Object, ObjectSection, ObjectSymbol};

use crate::{folder, frames, has, scene, words};

struct Core {
    name: &'static str,
    /// For `capi/build.sh`.
    target: &'static str,
    compiler: &'static str,
    flags: &'static [&'static str],
    emulator: &'static str,
    machine: &'static str,
    /// Where the machine has its code and its RAM, with its size.
    code: (u32, u32),
    ram: (u32, u32),
}

/// What the library for it also serves differs from it in little.
const M4: Core = Core {
    name: "Cortex-M4",
    target: "thumbv7em-none-eabihf",
    compiler: "arm-none-eabi-gcc",
    flags: &[
        "-mcpu=cortex-m4",
        "-mthumb",
        "-mfloat-abi=hard",
        "-mfpu=fpv4-sp-d16",
    ],
    emulator: "qemu-system-arm",
    machine: "mps2-an386",
    code: (0, 4 << 20),
    ram: (0x2000_0000, 4 << 20),
};

const M33: Core = Core {
    name: "Cortex-M33",
    flags: &[
        "-mcpu=cortex-m33",
        "-mthumb",
        "-mfloat-abi=hard",
        "-mfpu=fpv5-sp-d16",
    ],
    machine: "mps2-an505",
    code: (0x1000_0000, 4 << 20),
    ram: (0x3800_0000, 4 << 20),
    ..M4
};

const CORES: [Core; 8] = [
    // No machine has this core; a Cortex-M3 has its instructions.
    Core {
        name: "Cortex-M0+",
        target: "thumbv6m-none-eabi",
        flags: &["-mcpu=cortex-m0plus", "-mthumb"],
        machine: "mps2-an385",
        ..M4
    },
    Core {
        name: "Cortex-M3",
        target: "thumbv7m-none-eabi",
        flags: &["-mcpu=cortex-m3", "-mthumb"],
        machine: "mps2-an385",
        ..M4
    },
    M4,
    Core {
        name: "Cortex-M7",
        flags: &[
            "-mcpu=cortex-m7",
            "-mthumb",
            "-mfloat-abi=hard",
            "-mfpu=fpv5-sp-d16",
        ],
        machine: "mps2-an500",
        ..M4
    },
    M33,
    Core {
        name: "Cortex-M33 without the DSP extension",
        target: "thumbv8m.main-none-eabihf",
        flags: &[
            "-mcpu=cortex-m33+nodsp",
            "-mthumb",
            "-mfloat-abi=hard",
            "-mfpu=fpv5-sp-d16",
        ],
        ..M33
    },
    Core {
        name: "Cortex-M55",
        flags: &["-mcpu=cortex-m55", "-mthumb", "-mfloat-abi=hard"],
        machine: "mps3-an547",
        code: (0, 512 << 10),
        ram: (0x3000_0000, 512 << 10),
        ..M4
    },
    Core {
        name: "RV32IMAC",
        target: "riscv32imac-unknown-none-elf",
        compiler: "riscv64-unknown-elf-gcc",
        flags: &["-march=rv32imac_zicsr", "-mabi=ilp32"],
        emulator: "qemu-system-riscv32",
        machine: "virt",
        code: (0x8000_0000, 4 << 20),
        ram: (0x8040_0000, 4 << 20),
    },
];

impl Core {
    /// Most bytes of code and constants, and of memory without the stack, in a small image.
    fn small(&self) -> (u64, u64) {
        let code = match self.emulator == M4.emulator {
            true => 24 << 10,
            // Its instructions take more bytes.
            false => 25 << 10,
        };
        (code, 48 << 10)
    }
}

impl Core {
    /// Whether its compiler, its emulator and Rust's library for it are there.
    fn is_there(&self) -> bool {
        if ![self.compiler, self.emulator].into_iter().all(has) {
            return false;
        }
        let installed = Command::new("rustup")
            .args(["target", "add", self.target])
            .output();
        if !installed.is_ok_and(|output| output.status.success()) {
            println!("skipped: rustup cannot add {}", self.target);
            return false;
        }
        true
    }

    /// The library for this core, with these features beside the fast coder.
    fn library(&self, features: &str) -> PathBuf {
        // A folder of its own: cargo holds that of the tests.
        let target = folder().join("../target/capi").join(features);
        let output = Command::new(folder().join("build.sh"))
            .args([self.target, features])
            .env("CARGO_TARGET_DIR", target)
            .env_remove("RUSTFLAGS")
            .output()
            .expect("build.sh runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {said}", self.name);
        let folder = String::from_utf8(output.stdout).expect("text");
        Path::new(folder.trim_end()).join("libeecvs.a")
    }

    /// Links a program in C with the library.
    fn link(&self, library: &Path, source: &Path, to: &Path) {
        let bare = folder().join("tests/c/bare");
        let regions = [
            ("code_start", self.code.0),
            ("code_bytes", self.code.1),
            ("ram_start", self.ram.0),
            ("ram_bytes", self.ram.1),
        ]
        .map(|(name, value)| format!("-Wl,--defsym={name}={value}"));
        let output = Command::new(self.compiler)
            .args(self.flags)
            .args(["-O2", "-std=c99", "-ffreestanding", "-nostdlib"])
            .args(["-Wall", "-Wextra", "-Wconversion", "-Werror"])
            .args([
                "-ffunction-sections",
                "-fdata-sections",
                "-Wl,--gc-sections",
            ])
            .arg("-DEECVS_ENCODER_ALONE")
            .arg("-I")
            .arg(folder().join("include"))
            .arg("-I")
            .arg(&bare)
            .args([source, &bare.join("libc.c"), library])
            .arg("-lgcc")
            .arg("-T")
            .arg(bare.join("bare.ld"))
            .args(regions)
            .arg("-o")
            .arg(to)
            .output()
            .expect("the compiler runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {said}", self.name);
    }

    /// Runs a program in a folder, with arguments.
    fn run(&self, program: &Path, at: &Path, arguments: &[&str]) {
        let arguments = arguments.iter().map(|argument| format!(",arg={argument}"));
        let semihosting = format!(
            "enable=on,target=native{}",
            arguments.collect::<Vec<_>>().concat()
        );
        let mut child = Command::new(self.emulator)
            .args(["-M", self.machine, "-bios", "none", "-nographic"])
            .args(["-monitor", "none", "-serial", "none"])
            .args(["-semihosting-config", &semihosting, "-kernel"])
            .arg(program)
            .current_dir(at)
            .spawn()
            .expect("the emulator starts");
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().expect("the emulator can be waited for") {
                break status;
            }
            if begun.elapsed() > Duration::from_secs(120) {
                child.kill().expect("the emulator can be ended");
                panic!("{}: no end after two minutes", self.name);
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        assert!(status.success(), "{}: {status}", self.name);
    }
}

/// Bytes of code and constants, and of memory.
fn sizes(program: &Path) -> (u64, u64) {
    use object::SectionKind as Kind;
    let file = fs::read(program).expect("the program");
    let elf = object::File::parse(&*file).expect("an ELF file");
    let bytes = |kinds: &[Kind]| {
        let sections = elf.sections();
        let wanted = sections.filter(|section| kinds.contains(&section.kind()));
        wanted.map(|section| section.size()).sum()
    };
    (
        bytes(&[Kind::Text, Kind::ReadOnlyData, Kind::Data]),
        bytes(&[Kind::Data, Kind::UninitializedData]),
    )
}

/// Functions of Rust's that a program has only where it can panic.
fn panics(program: &Path) -> Vec<String> {
    let file = fs::read(program).expect("the program");
    let elf = object::File::parse(&*file).expect("an ELF file");
    let names = elf
        .symbols()
        .filter_map(|symbol| symbol.name().ok().map(str::to_owned));
    names.filter(|name| name.contains("panic")).collect()
}

/// Encodes a scene by the example on a core with the library of these features, and compares the frames.
fn encode(core: &Core, features: &str) {
    let scene = scene();
    let sensor = [scene.sensor.width, scene.sensor.height].map(|side| side.to_string());
    let made = tempfile::tempdir().expect("a folder");
    let program = made.path().join("encode");
    let source = folder().join("examples/encode.c");
    core.link(&core.library(features), &source, &program);
    fs::write(made.path().join("in"), words(&scene.events)).expect("the words can be written");
    core.run(&program, made.path(), &["encode", &sensor[0], &sensor[1]]);
    let encoded = fs::read(made.path().join("out")).expect("the frames");
    assert!(
        encoded == frames(&scene),
        "{}: {} bytes",
        core.name,
        encoded.len()
    );
}

/// Links what a small image has of the library of these features; returns its code and its memory in bytes. It cannot
/// panic.
fn small(core: &Core, features: &str) -> (u64, u64) {
    let made = tempfile::tempdir().expect("a folder");
    let program = made.path().join("small");
    let source = folder().join("tests/c/bare/small.c");
    core.link(&core.library(features), &source, &program);
    assert_eq!(panics(&program), [""; 0], "{} {features}", core.name);
    let (code, ram) = sizes(&program);
    println!(
        "{} {features}: {code} bytes of code and constants, {ram} of memory",
        core.name
    );
    (code, ram)
}

#[test]
fn the_c_program_makes_the_same_frames_on_every_core() {
    for core in CORES.iter().filter(|core| core.is_there()) {
        encode(core, "small");
        let (code, ram) = small(core, "small");
        let most = core.small();
        assert!(code <= most.0 && ram <= most.1, "{}", core.name);
    }
}

#[test]
fn every_feature_makes_the_same_frames() {
    if M4.is_there() {
        let bytes = ["", "budget", "full"].map(|features| {
            encode(&M4, features);
            small(&M4, features).0
        });
        assert!(bytes.is_sorted(), "{bytes:?}");
    }
}
