//! The parameters of a sensor's readout, and those of known cameras.

use event_types::stream::Result;
use event_types::{Sensor, bail, ensure};

use crate::parameters::{Parameter, check, parameters};

parameters! {
    /// How a sensor's events reach the host. Every field is a row of [`READOUT_PARAMETERS`].
    pub struct ReadoutParameters;
    /// The parameters of the readout, in the order in which events meet them.
    pub const READOUT_PARAMETERS;

    scan_us: 0.0, "us", 0.0 to 100_000.0,
        "Time in which all columns are read in turn, from the last to the first; 0 for an arbiter, which reads rows that ask.",
        "an arbiter";
    row_ns: 0.0, "ns", 0.0 to 1_000_000.0,
        "Time in which the arbiter chooses a row.",
        "as of an arbiter that takes no time";
    event_ns: 0.0, "ns", 0.0 to 1_000_000.0,
        "Time in which an event, or a group of them, is read.",
        "as of an arbiter that takes no time";
    group_columns: 1.0, "1", 1.0 to 2_048.0,
        "Neighbouring columns of a row that are read at once.",
        "single events";
    row_time: 0.0, "1", 0.0 to 1.0,
        "1 if the events of a row that are read together have one time, 0 if each has its own.",
        "single events";
    tick_us: 1.0, "us", 1.0 to 100_000.0,
        "Step of times, in whole microseconds.",
        "that of most cameras";
    link_per_us: 10_000.0, "1/us", 0.001 to 10_000.0,
        "Events that the link to the host takes per microsecond.",
        "as of a link that takes all";
    buffer_events: 65_536.0, "1", 1.0 to 16_777_216.0,
        "Events that wait for the link; further ones are lost.",
        "estimate";
}

/// Names of the parameters that are whole numbers.
const WHOLE: [&str; 4] = ["group_columns", "row_time", "tick_us", "buffer_events"];

impl ReadoutParameters {
    /// Sets a parameter by its name in [`READOUT_PARAMETERS`].
    ///
    /// # Errors
    /// An unknown name; a value outside of the parameter's range, or no whole number where it has to be one.
    pub fn set(&mut self, name: &str, value: f64) -> Result<()> {
        let found = READOUT_PARAMETERS
            .iter()
            .find(|parameter| parameter.name == name);
        let Some(parameter) = found else {
            let names = READOUT_PARAMETERS.iter().map(|parameter| parameter.name);
            bail!(
                Refused,
                "there is no parameter {name} of the readout; the parameters are {}",
                names.collect::<Vec<_>>().join(", ")
            );
        };
        (parameter.set)(self, value);
        self.check_one(parameter)
    }

    /// Checks that all parameters are in their ranges.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn check(&self) -> Result<()> {
        READOUT_PARAMETERS
            .iter()
            .try_for_each(|parameter| self.check_one(parameter))
    }

    fn check_one(&self, parameter: &Parameter<Self>) -> Result<()> {
        let value = parameter.of(self);
        check(parameter, value)?;
        ensure!(
            !WHOLE.contains(&parameter.name) || value.fract() == 0.0,
            Refused,
            "{} is {value}; give a whole number",
            parameter.name
        );
        Ok(())
    }
}

/// A camera whose readout is known.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    /// Name on the command line.
    pub name: &'static str,
    /// One line that says which camera it is.
    pub about: &'static str,
    /// Its sensor's size.
    pub sensor: Sensor,
    /// Its readout.
    pub readout: ReadoutParameters,
    /// Where its figures come from.
    pub source: &'static str,
}

impl Camera {
    /// Returns the camera of this name in [`CAMERAS`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<&'static Self> {
        CAMERAS.iter().find(|camera| camera.name == name)
    }
}

const fn of(width: u16, height: u16) -> Sensor {
    Sensor { width, height }
}

/// What cameras have unless their row says otherwise.
const USUAL: ReadoutParameters = ReadoutParameters {
    scan_us: 0.0,
    row_ns: 0.0,
    event_ns: 0.0,
    group_columns: 1.0,
    row_time: 0.0,
    tick_us: 1.0,
    link_per_us: 10_000.0,
    buffer_events: 65_536.0,
};

/// The cameras.
pub const CAMERAS: &[Camera] = &[
    Camera {
        name: "dvs128",
        about: "DVS128: an arbiter of single events, on USB 2",
        sensor: of(128, 128),
        readout: ReadoutParameters {
            event_ns: 500.0,
            link_per_us: 1.0,
            buffer_events: 512.0,
            ..USUAL
        },
        source: "2 events per us on the chip: Lichtsteiner 2008; 1 per us at the host: Gallego 2022, table 1; the buffer is \
                 an assumption",
    },
    Camera {
        name: "davis240",
        about: "DAVIS240: an arbiter of rows, word by word, on USB 2",
        sensor: of(240, 180),
        readout: ReadoutParameters {
            row_ns: 80.0,
            event_ns: 80.0,
            row_time: 1.0,
            link_per_us: 10.0,
            ..USUAL
        },
        source: "12 events per us: Brandli 2014; a row's time as an event's, its common time, 10 events per us on USB 2 and \
                 the buffer are assumptions",
    },
    Camera {
        name: "davis346",
        about: "DAVIS346: an arbiter of rows, word by word, on USB 3",
        sensor: of(346, 260),
        readout: ReadoutParameters {
            row_ns: 80.0,
            event_ns: 80.0,
            row_time: 1.0,
            link_per_us: 12.0,
            ..USUAL
        },
        source: "80 ns an event, 12 events per us: iniVation 2020; a row's time as an event's, its common time and the \
                 buffer are assumptions",
    },
    Camera {
        name: "dvxplorer",
        about: "DVXplorer: a scan of all columns in 200 us, on USB 3",
        sensor: of(640, 480),
        readout: ReadoutParameters {
            scan_us: 200.0,
            link_per_us: 165.0,
            ..USUAL
        },
        source: "columns from the last to the first in some 200 us: estimated from a recording of a DVXplorer Lite; \
                 165 events per us: iniVation 2020; the buffer is an assumption",
    },
    Camera {
        name: "gen3",
        about: "Prophesee Gen3 VGA: an arbiter of rows, on USB 3",
        sensor: of(640, 480),
        readout: ReadoutParameters {
            row_ns: 15.0,
            event_ns: 15.0,
            link_per_us: 50.0,
            ..USUAL
        },
        source: "66 events per us: Gallego 2022, table 1; 1.6 Gbit/s of the EVK3 (Prophesee), 32 bits an event in EVT 2; a \
                 row's time and the buffer are assumptions",
    },
    Camera {
        name: "gen41",
        about: "Prophesee Gen4.1 HD: rows in blocks of 32 columns, on USB 3",
        sensor: of(1_280, 720),
        readout: ReadoutParameters {
            row_ns: 30.0,
            event_ns: 30.0,
            group_columns: 32.0,
            row_time: 1.0,
            link_per_us: 100.0,
            ..USUAL
        },
        source: "1,066 events per us: Finateu 2020, here 32 in 30 ns as in EVT 2.1 and 3; 1.6 Gbit/s of the EVK3 \
                 (Prophesee), 16 bits an event; a row's time, its common time and the buffer are assumptions",
    },
    Camera {
        name: "imx636",
        about: "Sony IMX636: as gen41",
        sensor: of(1_280, 720),
        readout: ReadoutParameters {
            row_ns: 30.0,
            event_ns: 30.0,
            group_columns: 32.0,
            row_time: 1.0,
            link_per_us: 100.0,
            ..USUAL
        },
        source: "those of gen41: the same pixel array, made in series; that its readout is the same is an assumption",
    },
    Camera {
        name: "genx320",
        about: "Prophesee GenX320: rows in blocks of 32 columns, on a slow link",
        sensor: of(320, 320),
        readout: ReadoutParameters {
            row_ns: 100.0,
            event_ns: 100.0,
            group_columns: 32.0,
            row_time: 1.0,
            link_per_us: 10.0,
            buffer_events: 4_096.0,
            ..USUAL
        },
        source: "blocks of 32 columns as in EVT 2.1 (Prophesee); no figure of its speed was found: all others are assumptions",
    },
];
