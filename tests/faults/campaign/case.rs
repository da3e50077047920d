//! The commands that write files, each with small inputs.

/// What a command writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Files, each in the place of an old one.
    Files,
    /// Files that a live source fills: until they are complete, they are `incomplete-NAME`.
    Live,
    /// A new folder, in which one file is the last: without it the folder is not finished.
    Folder(&'static str),
    /// Files that appear together, after which the command can be repeated if it failed.
    Together,
}

/// A command with its outputs.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    pub program: &'static str,
    /// Its arguments, with `IN` for the folder of the inputs.
    pub line: &'static str,
    /// Files that are there before, and are replaced.
    pub old: &'static [&'static str],
    pub kind: Kind,
}

impl Case {
    /// Whether a file is text whose length differs from run to run: a key, a certificate, or times.
    pub fn has_text_of_its_run(&self, name: &str) -> bool {
        self.kind == Kind::Together || name.ends_with(".yaml")
    }

    /// Whether a source sends what is written, as long as nobody stops it.
    pub fn is_live(&self) -> bool {
        self.kind == Kind::Live || self.program == "eecvs-ros" || self.line.starts_with("view")
    }
}

const fn files(line: &'static str, old: &'static [&'static str]) -> Case {
    Case {
        program: "eecvs",
        line,
        old,
        kind: Kind::Files,
    }
}

const fn live(line: &'static str, old: &'static [&'static str]) -> Case {
    Case {
        program: "eecvs-usb",
        line,
        old,
        kind: Kind::Live,
    }
}

/// The commands by which the inputs are made.
pub const INPUTS: [(&str, &str); 8] = [
    (
        "eecvs",
        "emulate motorcycle -o large.raw --width 120 --height 90 --duration-us 300000",
    ),
    (
        "eecvs",
        "emulate motorcycle -o scene.raw --width 40 --height 30 --duration-us 60000",
    ),
    (
        "eecvs",
        "emulate motorcycle -o wide.raw --width 32 --height 24 --duration-us 60000",
    ),
    (
        "eecvs",
        "encode scene.raw -o scene.eecvs --window-us 10000 --mode transform --transform dct",
    ),
    ("eecvs", "encode wide.raw -o wide.eecvs"),
    (
        "eecvs-usb",
        "capture --device sim:dvs128:scene.raw -o scene.stream --rate max",
    ),
    ("eecvs-hub", "keys fleet hub yard"),
    ("eecvs-hub", "keys fleet sensor door"),
];

pub const CASES: &[Case] = &[
    files(
        "emulate motorcycle -o OUT.raw --width 40 --height 30 --duration-us 60000 --overwrite",
        &["OUT.raw"],
    ),
    files("convert IN/scene.raw OUT.raw --overwrite", &["OUT.raw"]),
    files("convert IN/scene.raw OUT.csv --overwrite", &["OUT.csv"]),
    files("convert IN/scene.raw OUT.txt --overwrite", &["OUT.txt"]),
    files("convert IN/scene.raw OUT.dat --overwrite", &["OUT.dat"]),
    files("convert IN/scene.raw OUT.es --overwrite", &["OUT.es"]),
    files(
        "emulate motorcycle -o OUT.aedat --width 128 --height 128 --duration-us 20000 --overwrite",
        &["OUT.aedat"],
    ),
    files(
        "emulate motorcycle -o OUT.bin --width 34 --height 34 --duration-us 60000 --overwrite",
        &["OUT.bin"],
    ),
    files("convert IN/scene.raw OUT.evt2 --overwrite", &["OUT.evt2"]),
    files("convert IN/scene.raw OUT.evt21 --overwrite", &["OUT.evt21"]),
    files("convert IN/scene.raw OUT.evt4 --overwrite", &["OUT.evt4"]),
    files(
        "convert IN/scene.raw OUT.arrows --overwrite",
        &["OUT.arrows"],
    ),
    files(
        "convert IN/scene.raw OUT.aedat4 --overwrite",
        &["OUT.aedat4"],
    ),
    files("convert IN/scene.raw OUT.h5 --overwrite", &["OUT.h5"]),
    files("convert IN/scene.raw OUT.npz --overwrite", &["OUT.npz"]),
    files("convert IN/scene.raw OUT.npy --overwrite", &["OUT.npy"]),
    files("convert IN/scene.raw OUT.mat --overwrite", &["OUT.mat"]),
    files("convert IN/scene.raw OUT.bag --overwrite", &["OUT.bag"]),
    files("convert IN/scene.raw OUT.mcap --overwrite", &["OUT.mcap"]),
    files("convert IN/scene.raw OUT.db3 --overwrite", &["OUT.db3"]),
    files(
        "convert IN/scene.raw OUT.parquet --overwrite",
        &["OUT.parquet"],
    ),
    files("convert IN/scene.raw OUT.arrow --overwrite", &["OUT.arrow"]),
    // Of many blocks.
    files("convert IN/large.raw OUT.raw --overwrite", &["OUT.raw"]),
    files("convert IN/large.raw OUT.csv --overwrite", &["OUT.csv"]),
    files("convert IN/large.raw OUT.es --overwrite", &["OUT.es"]),
    files(
        "convert IN/large.raw OUT.aedat4 --overwrite",
        &["OUT.aedat4"],
    ),
    files("convert IN/large.raw OUT.h5 --overwrite", &["OUT.h5"]),
    files("convert IN/large.raw OUT.mcap --overwrite", &["OUT.mcap"]),
    files(
        "convert IN/large.raw OUT.parquet --overwrite",
        &["OUT.parquet"],
    ),
    files(
        "encode IN/large.raw -o OUT.eecvs --overwrite",
        &["OUT.eecvs"],
    ),
    files(
        "encode IN/scene.raw -o OUT.eecvs --overwrite",
        &["OUT.eecvs"],
    ),
    files(
        "calibrate IN/scene.raw -o OUT.toml --overwrite",
        &["OUT.toml"],
    ),
    files(
        "monitor IN/scene.raw --chart OUT.svg --histogram TWO.svg --overwrite",
        &["OUT.svg", "TWO.svg"],
    ),
    files(
        "view IN/scene.raw -o OUT.gif --frames 3 --overwrite",
        &["OUT.gif"],
    ),
    files("view IN/scene.raw -o OUT.png --overwrite", &["OUT.png"]),
    files(
        "decode IN/scene.eecvs -o OUT.csv --volume OUT.npy --overwrite",
        &["OUT.csv", "OUT.npy"],
    ),
    files(
        "decode IN/scene.eecvs --volume OUT.npz --all-windows --overwrite",
        &["OUT.npz"],
    ),
    files(
        "decode IN/scene.eecvs --volume OUT.npy --all-windows --overwrite",
        &["OUT.npy", "OUT.times.npy"],
    ),
    Case {
        program: "eecvs",
        line: "view IN/scene.raw -o OUT/ --frames 3",
        old: &[],
        kind: Kind::Folder(""),
    },
    Case {
        program: "eecvs",
        line: "split IN/two.eecvs -o OUT",
        old: &[],
        kind: Kind::Folder(""),
    },
    Case {
        program: "eecvs",
        line: "bench --errors --quick -o OUT",
        old: &[],
        kind: Kind::Folder(""),
    },
    live(
        "capture --device sim:dvs128:IN/scene.raw -o OUT.raw --rate max --overwrite",
        &["OUT.raw"],
    ),
    live(
        "capture --device sim:dvs128:IN/scene.raw -o OUT.aedat4 --rate max --overwrite",
        &["OUT.aedat4"],
    ),
    live(
        "capture --device sim:dvs128:IN/scene.raw -o OUT.eecvs --rate max --overwrite",
        &["OUT.eecvs"],
    ),
    live(
        "capture --device replay:IN/scene.stream -o OUT.stream --rate max --overwrite",
        &["OUT.stream"],
    ),
    live(
        "forward --device replay:IN/scene.stream --rate max --to file:OUT.eecvs --overwrite",
        &["OUT.eecvs"],
    ),
    Case {
        program: "eecvs-ros",
        line: "--loopback --domain-id 92 compose emulate record --ros-args -p \
               emulate:recording:=IN/scene.raw -p emulate:wait_s:=20 -p record:output:=OUT -p record:idle_s:=1",
        old: &[],
        kind: Kind::Folder("metadata.yaml"),
    },
    Case {
        program: "eecvs-hub",
        line: "keys new hub yard",
        old: &[],
        kind: Kind::Together,
    },
    Case {
        program: "eecvs-hub",
        line: "keys fleet receiver desk --hears door",
        old: &[],
        kind: Kind::Together,
    },
];
