//! One colour for each representation in every chart of a study, from the Okabe-Ito set, which colour-blind readers
//! can distinguish; shapes distinguish them as well.

use plotters::style::RGBColor;

/// Representation, its label in charts, its colour, and whether its points are triangles.
pub const REPRESENTATIONS: [(&str, &str, RGBColor, bool); 11] = [
    ("events", "events (hybrid)", RGBColor(0, 114, 178), false),
    ("best", "best", RGBColor(0, 60, 110), true),
    ("dct", "DCT", RGBColor(213, 94, 0), false),
    ("dtft", "DTFT", RGBColor(230, 159, 0), false),
    ("dwt", "Haar DWT", RGBColor(204, 121, 167), false),
    ("auto", "by density", RGBColor(0, 158, 115), false),
    ("ces", "CES", RGBColor(86, 180, 233), true),
    ("tore", "TORE", RGBColor(0, 0, 0), true),
    ("voxel", "voxel grid", RGBColor(150, 90, 30), true),
    ("event-frame", "event frame", RGBColor(130, 130, 130), true),
    ("time-surface", "time surface", RGBColor(90, 70, 150), true),
];

/// Returns the label of a representation in charts.
#[must_use]
pub fn label(representation: &str) -> &str {
    let known = REPRESENTATIONS
        .iter()
        .find(|(name, ..)| *name == representation);
    known.map_or(representation, |(_, label, ..)| label)
}
