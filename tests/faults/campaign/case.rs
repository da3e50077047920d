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
    /// A file that grows at its end: what was there stays, whatever fails; a part of what is appended may follow.
    Appended,
    /// New files that grow under their own names: a part of one may be left where the command fails.
    Growing,
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
    /// Programs on the other end, with their arguments, which end with the command.
    pub beside: &'static [(&'static str, &'static str)],
    pub cost: Cost,
}

/// How long a run takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cost {
    /// A second at most.
    Quick,
    /// Seconds: the usual tests leave it out.
    Seconds,
    /// Minutes: the whole campaign takes this many of its places, each with one plan.
    Minutes(usize),
}

impl Case {
    /// Whether a file is text whose length differs from run to run: a key, a certificate, times, or a page of figures.
    pub fn has_text_of_its_run(&self, name: &str) -> bool {
        self.kind == Kind::Together || name.ends_with(".yaml") || name.ends_with(".html")
    }

    /// Whether a source sends what is written, as long as nobody stops it.
    pub fn is_live(&self) -> bool {
        matches!(self.kind, Kind::Live | Kind::Growing)
            || self.program == "eecvs-ros"
            || self.line.starts_with("view")
    }
}

const fn files(line: &'static str, old: &'static [&'static str]) -> Case {
    Case {
        program: "eecvs",
        line,
        old,
        kind: Kind::Files,
        beside: &[],
        cost: Cost::Quick,
    }
}

/// A conversion of an input into the format of this ending.
macro_rules! converted {
    ($from:literal, $ending:literal) => {
        files(
            concat!("convert IN/", $from, " OUT.", $ending, " --overwrite"),
            &[concat!("OUT.", $ending)],
        )
    };
}

const fn live(line: &'static str, old: &'static [&'static str]) -> Case {
    Case {
        program: "eecvs-usb",
        line,
        old,
        kind: Kind::Live,
        beside: &[],
        cost: Cost::Quick,
    }
}

/// A receiver, with a sender that waits for it.
macro_rules! received {
    ($output:literal) => {
        Case {
            beside: &[(
                "eecvs-usb",
                "forward --device replay:IN/scene.stream --rate max --to unix:IN/link",
            )],
            ..live(
                concat!("receive unix:IN/link -o ", $output, " --once --overwrite"),
                &[$output],
            )
        }
    };
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
    files(
        "emulate motorcycle -o OUT.raw --truth OUT.npz --model 2 --width 40 --height 30 --duration-us 40000 --overwrite",
        &["OUT.raw", "OUT.npz"],
    ),
    converted!("scene.raw", "raw"),
    converted!("scene.raw", "csv"),
    converted!("scene.raw", "txt"),
    converted!("scene.raw", "dat"),
    converted!("scene.raw", "es"),
    files(
        "emulate motorcycle -o OUT.aedat --width 128 --height 128 --duration-us 20000 --overwrite",
        &["OUT.aedat"],
    ),
    files(
        "emulate motorcycle -o OUT.bin --width 34 --height 34 --duration-us 60000 --overwrite",
        &["OUT.bin"],
    ),
    converted!("scene.raw", "evt2"),
    converted!("scene.raw", "evt21"),
    converted!("scene.raw", "evt4"),
    converted!("scene.raw", "arrows"),
    converted!("scene.raw", "aedat4"),
    converted!("scene.raw", "h5"),
    converted!("scene.raw", "npz"),
    converted!("scene.raw", "npy"),
    converted!("scene.raw", "mat"),
    converted!("scene.raw", "bag"),
    converted!("scene.raw", "mcap"),
    converted!("scene.raw", "db3"),
    converted!("scene.raw", "parquet"),
    converted!("scene.raw", "arrow"),
    // Of many blocks.
    converted!("large.raw", "raw"),
    converted!("large.raw", "csv"),
    converted!("large.raw", "es"),
    converted!("large.raw", "aedat4"),
    converted!("large.raw", "h5"),
    converted!("large.raw", "mcap"),
    converted!("large.raw", "parquet"),
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
        kind: Kind::Folder(""),
        ..files("view IN/scene.raw -o OUT/ --frames 3", &[])
    },
    Case {
        kind: Kind::Folder(""),
        ..files("split IN/two.eecvs -o OUT", &[])
    },
    Case {
        kind: Kind::Folder(""),
        ..files("bench --errors --quick -o OUT", &[])
    },
    Case {
        kind: Kind::Appended,
        ..files("index OUT.eecvs", &["OUT.eecvs"])
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
    received!("OUT.eecvs"),
    received!("OUT.raw"),
    Case {
        program: "eecvs-ros",
        line: "--loopback --domain-id DOMAIN compose emulate encode log --ros-args -p \
               emulate:recording:=IN/scene.raw -p emulate:wait_s:=20 -p log:features:=OUT.csv -p \
               log:coefficients:=OUT.mcap -p log:idle_s:=1 -p encode:idle_s:=1",
        old: &[],
        kind: Kind::Growing,
        beside: &[],
        cost: Cost::Seconds,
    },
    Case {
        program: "eecvs-hub",
        line: "receive --connect tcp/127.0.0.1:PORT --to OUT --from-start --idle-s 1 --seconds 20",
        old: &[],
        kind: Kind::Growing,
        beside: &[
            ("eecvs-hub", "hub --listen tcp/127.0.0.1:PORT --no-page"),
            (
                "eecvs-hub",
                "sensor door --connect tcp/127.0.0.1:PORT --recording IN/scene.raw --rate max --linger-s 20",
            ),
        ],
        cost: Cost::Seconds,
    },
    Case {
        kind: Kind::Files,
        cost: Cost::Seconds,
        ..files("mcu IN/scene.raw -o OUT.eecvs --overwrite", &["OUT.eecvs"])
    },
    Case {
        kind: Kind::Folder("report.html"),
        cost: Cost::Minutes(20),
        ..files("demo -o OUT", &[])
    },
    Case {
        kind: Kind::Folder("report.html"),
        cost: Cost::Minutes(40),
        ..files("report --quick -o OUT", &[])
    },
    Case {
        program: "eecvs-ros",
        line: "--loopback --domain-id DOMAIN compose emulate record --ros-args -p \
               emulate:recording:=IN/scene.raw -p emulate:wait_s:=20 -p record:output:=OUT -p record:idle_s:=1",
        old: &[],
        kind: Kind::Folder("metadata.yaml"),
        beside: &[],
        cost: Cost::Quick,
    },
    Case {
        program: "eecvs-hub",
        line: "keys new hub yard",
        old: &[],
        kind: Kind::Together,
        beside: &[],
        cost: Cost::Quick,
    },
    Case {
        program: "eecvs-hub",
        line: "keys fleet receiver desk --hears door",
        old: &[],
        kind: Kind::Together,
        beside: &[],
        cost: Cost::Quick,
    },
];
