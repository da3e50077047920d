//! The nine scene types of the paper's evaluation, as parameters of their light.

use event_types::Sensor;

use super::camera::Camera;
use super::pattern::Pattern;
use super::texture::Look;

/// A named scene.
///
/// The names are those of the paper's Table I. The recordings of that table are not included; a preset imitates the
/// light, the camera and the moving objects that its name describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Preset {
    /// Dark room with a bright window, fixed camera, a person and a flickering lamp.
    IndoorDarkHdr,
    /// Dark room, hand-held camera: slow pixels smear what moves.
    IndoorDarkBlur,
    /// Lit room with a bright window, camera panning quickly.
    IndoorHdrBlur,
    /// Daylight, camera panning quickly over buildings.
    OutdoorWellLitBlur,
    /// Street at night, camera panning.
    OutdoorDarkBlur,
    /// View from a drone that sways through a room.
    IndoorFlying,
    /// View from a motorcycle: near ground rushes past, the engine shakes the camera.
    Motorcycle,
    /// Dusk, slow camera, a passing vehicle.
    OutdoorLowBrightness,
    /// Night, fixed camera: noise, hot pixels and a distant light.
    OutdoorDark,
}

/// All presets, in the order of the paper's table.
pub const PRESETS: [Preset; 9] = [
    Preset::IndoorDarkHdr,
    Preset::IndoorDarkBlur,
    Preset::IndoorHdrBlur,
    Preset::OutdoorWellLitBlur,
    Preset::OutdoorDarkBlur,
    Preset::IndoorFlying,
    Preset::Motorcycle,
    Preset::OutdoorLowBrightness,
    Preset::OutdoorDark,
];

/// What is seen in a preset.
#[derive(Debug, Clone)]
pub(crate) struct Script {
    pub(crate) look: Look,
    pub(crate) camera: Camera,
    pub(crate) patterns: Vec<Pattern>,
}

const LOOK: Look = Look {
    light: 0.0,
    hdr: 2.0,
    patches: 160,
    contrast: 1.0,
    grain: 0.02,
};

impl Preset {
    /// Returns the name used on the command line, for example `indoor-flying`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::IndoorDarkHdr => "indoor-dark-hdr",
            Self::IndoorDarkBlur => "indoor-dark-blur",
            Self::IndoorHdrBlur => "indoor-hdr-blur",
            Self::OutdoorWellLitBlur => "outdoor-well-lit-blur",
            Self::OutdoorDarkBlur => "outdoor-dark-blur",
            Self::IndoorFlying => "indoor-flying",
            Self::Motorcycle => "motorcycle",
            Self::OutdoorLowBrightness => "outdoor-low-brightness",
            Self::OutdoorDark => "outdoor-dark",
        }
    }

    /// Returns a one-line description of the scene.
    #[must_use]
    pub const fn about(self) -> &'static str {
        match self {
            Self::IndoorDarkHdr => {
                "Dark room with a bright window, fixed camera, a person and a flickering lamp"
            }
            Self::IndoorDarkBlur => "Dark room, hand-held camera: slow pixels smear what moves",
            Self::IndoorHdrBlur => "Lit room with a bright window, camera panning quickly",
            Self::OutdoorWellLitBlur => "Daylight, camera panning quickly over buildings",
            Self::OutdoorDarkBlur => "Street at night, camera panning",
            Self::IndoorFlying => "View from a drone that sways through a room",
            Self::Motorcycle => {
                "View from a motorcycle: near ground rushes past, the engine shakes the camera"
            }
            Self::OutdoorLowBrightness => "Dusk, slow camera, a passing vehicle",
            Self::OutdoorDark => "Night, fixed camera: noise, hot pixels and a distant light",
        }
    }

    /// Returns the preset with the given name, or `None` if the name is unknown.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        PRESETS.into_iter().find(|preset| preset.name() == name)
    }

    /// Returns the default sensor of the scene: 346 x 260, a DAVIS346.
    #[must_use]
    pub const fn sensor(self) -> Sensor {
        Sensor {
            width: 346,
            height: 260,
        }
    }

    /// Returns the default duration of the scene in us: one second.
    #[must_use]
    pub const fn duration_us(self) -> u64 {
        1_000_000
    }

    /// Returns the parameters of the preset.
    pub(crate) fn script(self) -> Script {
        match self {
            Self::IndoorDarkHdr => indoor_dark_hdr(),
            Self::IndoorDarkBlur => indoor_dark_blur(),
            Self::IndoorHdrBlur => indoor_hdr_blur(),
            Self::OutdoorWellLitBlur => outdoor_well_lit_blur(),
            Self::OutdoorDarkBlur => outdoor_dark_blur(),
            Self::IndoorFlying => indoor_flying(),
            Self::Motorcycle => motorcycle(),
            Self::OutdoorLowBrightness => outdoor_low_brightness(),
            Self::OutdoorDark => outdoor_dark(),
        }
    }
}

/// Returns a person or vehicle that crosses the picture: an upright box.
const fn walker(from: f64, velocity: f64, half: (f64, f64), gain: f32) -> Pattern {
    Pattern::Box {
        start: (from, 0.6),
        velocity: (velocity, 0.0),
        lap: 1.6,
        half,
        spin_hz: 0.0,
        gain,
    }
}

fn indoor_dark_hdr() -> Script {
    Script {
        look: Look {
            light: -2.5,
            hdr: 3.0,
            ..LOOK
        },
        camera: Camera::STATIC,
        patterns: vec![
            walker(0.72, 0.45, (0.03, 0.11), 0.9),
            Pattern::Box {
                start: (0.7, 0.3),
                velocity: (0.0, 0.0),
                lap: 1.0,
                half: (0.09, 0.012),
                spin_hz: 0.4,
                gain: 1.1,
            },
            Pattern::Flicker {
                area: (0.05, 0.1, 0.075, 0.14),
                hz: 100.0,
                depth: 0.9,
                square: false,
                rest: 0.6,
            },
        ],
    }
}

fn indoor_dark_blur() -> Script {
    Script {
        look: Look {
            light: -3.0,
            hdr: 1.0,
            patches: 60,
            contrast: 0.8,
            ..LOOK
        },
        camera: Camera {
            drift: (10.0, 2.0),
            pulse: 1.0,
            pulse_hz: 1.3,
            sway: [(2.0, 1.5, 1.1), (0.0, 0.0, 0.0)],
            parallax: 0.0,
        },
        patterns: Vec::new(),
    }
}

fn indoor_hdr_blur() -> Script {
    Script {
        look: Look {
            light: 0.0,
            hdr: 3.0,
            patches: 90,
            ..LOOK
        },
        camera: Camera {
            drift: (52.0, 8.0),
            pulse: 1.0,
            pulse_hz: 1.6,
            sway: [(5.0, 4.0, 1.9), (0.0, 0.0, 0.0)],
            parallax: 0.2,
        },
        patterns: vec![Pattern::Flicker {
            area: (0.8, 0.05, 0.83, 0.09),
            hz: 100.0,
            depth: 0.8,
            square: false,
            rest: 0.3,
        }],
    }
}

fn outdoor_well_lit_blur() -> Script {
    Script {
        look: Look {
            light: 1.5,
            hdr: 2.0,
            patches: 140,
            ..LOOK
        },
        camera: Camera {
            drift: (-75.0, 8.0),
            pulse: 1.0,
            pulse_hz: 1.4,
            sway: [(4.0, 3.0, 2.3), (0.0, 0.0, 0.0)],
            parallax: 0.3,
        },
        patterns: vec![walker(0.1, 0.5, (0.08, 0.12), -1.0)],
    }
}

fn outdoor_dark_blur() -> Script {
    Script {
        look: Look {
            light: -3.5,
            hdr: 2.5,
            patches: 80,
            ..LOOK
        },
        camera: Camera {
            drift: (26.0, 3.0),
            pulse: 1.0,
            pulse_hz: 1.2,
            sway: [(1.5, 1.5, 1.7), (0.0, 0.0, 0.0)],
            parallax: 0.3,
        },
        patterns: vec![Pattern::Flicker {
            area: (0.3, 0.1, 0.315, 0.125),
            hz: 100.0,
            depth: 1.2,
            square: false,
            rest: 0.2,
        }],
    }
}

fn indoor_flying() -> Script {
    Script {
        look: Look {
            light: 0.7,
            patches: 130,
            contrast: 1.1,
            ..LOOK
        },
        camera: Camera {
            drift: (60.0, 15.0),
            pulse: 1.0,
            pulse_hz: 1.1,
            sway: [(14.0, 10.0, 0.9), (1.0, 1.5, 4.3)],
            parallax: 0.4,
        },
        patterns: vec![
            Pattern::Box {
                start: (0.2, 0.2),
                velocity: (0.0, 0.0),
                lap: 1.0,
                half: (0.16, 0.015),
                spin_hz: 6.0,
                gain: -1.0,
            },
            Pattern::Flicker {
                area: (0.55, 0.0, 0.6, 0.04),
                hz: 100.0,
                depth: 0.8,
                square: false,
                rest: 0.0,
            },
        ],
    }
}

fn motorcycle() -> Script {
    Script {
        look: Look {
            light: 1.5,
            patches: 130,
            contrast: 1.2,
            grain: 0.03,
            ..LOOK
        },
        camera: Camera {
            drift: (170.0, 0.0),
            pulse: 0.7,
            pulse_hz: 0.8,
            sway: [(1.0, 2.0, 3.1), (0.1, 0.4, 23.0)],
            parallax: 1.6,
        },
        patterns: vec![
            Pattern::Box {
                start: (0.0, 0.35),
                velocity: (1.7, 0.1),
                lap: 2.2,
                half: (0.05, 0.03),
                spin_hz: 0.0,
                gain: 1.2,
            },
            Pattern::Flicker {
                area: (0.46, 0.4, 0.5, 0.44),
                hz: 180.0,
                depth: 1.2,
                square: true,
                rest: 0.0,
            },
        ],
    }
}

fn outdoor_low_brightness() -> Script {
    Script {
        look: Look {
            light: -1.8,
            hdr: 2.0,
            patches: 90,
            contrast: 0.9,
            ..LOOK
        },
        camera: Camera {
            drift: (11.0, 1.5),
            pulse: 1.0,
            pulse_hz: 1.5,
            sway: [(1.0, 1.0, 1.3), (0.0, 0.0, 0.0)],
            parallax: 0.4,
        },
        patterns: vec![walker(0.4, 0.9, (0.09, 0.05), 1.0)],
    }
}

fn outdoor_dark() -> Script {
    Script {
        look: Look {
            light: -4.0,
            hdr: 1.5,
            ..LOOK
        },
        camera: Camera::STATIC,
        patterns: vec![
            Pattern::Box {
                start: (0.78, 0.45),
                velocity: (0.3, 0.02),
                lap: 1.5,
                half: (0.012, 0.012),
                spin_hz: 0.0,
                gain: 2.0,
            },
            Pattern::Flicker {
                area: (0.8, 0.3, 0.825, 0.325),
                hz: 5.0,
                depth: 2.0,
                square: true,
                rest: 0.5,
            },
        ],
    }
}
