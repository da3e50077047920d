//! Segmentation by ONNX models, which the tests write themselves.

use std::path::{Path, PathBuf};

use eecvs_nostd::{Event, Polarity, Sensor};
use host_harness::downstream::segment::{Frame, Segmenter, open_model};

/// What ONNX files are made of.
mod protobuf {
    pub fn varint(mut value: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while value >= 128 {
            bytes.push(value as u8 | 128);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    }

    pub fn number(field: u64, value: u64) -> Vec<u8> {
        [varint(field << 3), varint(value)].concat()
    }

    pub fn bytes(field: u64, value: &[u8]) -> Vec<u8> {
        [
            varint(field << 3 | 2),
            varint(value.len() as u64),
            value.to_vec(),
        ]
        .concat()
    }

    pub fn text(field: u64, value: &str) -> Vec<u8> {
        bytes(field, value.as_bytes())
    }
}
use protobuf::{bytes, number, text};

const FLOAT: u64 = 1;
const INT64: u64 = 7;

/// A dimension: fixed, or of a name.
enum Dim {
    Fixed(u64),
    Named(&'static str),
}
use Dim::{Fixed, Named};

/// A `ValueInfoProto`.
fn value(name: &str, kind: u64, shape: &[Dim]) -> Vec<u8> {
    let dims: Vec<u8> = shape
        .iter()
        .flat_map(|dim| {
            bytes(
                1,
                &match dim {
                    Fixed(size) => number(1, *size),
                    Named(name) => text(2, name),
                },
            )
        })
        .collect();
    let tensor = [number(1, kind), bytes(2, &dims)].concat();
    [text(1, name), bytes(2, &bytes(1, &tensor))].concat()
}

/// A `TensorProto` of float32.
fn tensor(name: &str, dims: &[u64], values: &[f32]) -> Vec<u8> {
    let dims: Vec<u8> = dims.iter().flat_map(|dim| number(1, *dim)).collect();
    let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    [dims, number(2, FLOAT), text(8, name), bytes(9, &raw)].concat()
}

/// A `NodeProto` with attributes of integers.
fn node(kind: &str, inputs: &[&str], output: &str, attributes: &[(&str, &[u64])]) -> Vec<u8> {
    let inputs: Vec<u8> = inputs.iter().flat_map(|name| text(1, name)).collect();
    let attributes: Vec<u8> = attributes
        .iter()
        .flat_map(|(name, values)| {
            let values: Vec<u8> = values.iter().flat_map(|v| number(8, *v)).collect();
            // 7 is the type of lists of integers.
            bytes(5, &[text(1, name), values, number(20, 7)].concat())
        })
        .collect();
    [inputs, text(2, output), text(4, kind), attributes].concat()
}

/// A `ModelProto` of opset 12.
fn model(
    nodes: &[Vec<u8>],
    tensors: &[Vec<u8>],
    inputs: &[Vec<u8>],
    outputs: &[Vec<u8>],
) -> Vec<u8> {
    let fields = |field: u64, all: &[Vec<u8>]| -> Vec<u8> {
        all.iter().flat_map(|one| bytes(field, one)).collect()
    };
    let graph = [
        fields(1, nodes),
        text(2, "graph"),
        fields(5, tensors),
        fields(11, inputs),
        fields(12, outputs),
    ]
    .concat();
    [
        number(1, 7),
        bytes(7, &graph),
        bytes(8, &[text(1, ""), number(2, 12)].concat()),
    ]
    .concat()
}

const ANY: [Dim; 2] = [Named("height"), Named("width")];

fn image(channels: u64, [height, width]: [Dim; 2]) -> Vec<u8> {
    value("image", FLOAT, &[Fixed(1), Fixed(channels), height, width])
}

/// One convolution of `side` x `side` pixels.
fn convolution(
    channels: u64,
    size: [Dim; 2],
    side: u64,
    weights: &[f32],
    biases: &[f32],
) -> Vec<u8> {
    let classes = biases.len() as u64;
    let pad = side / 2;
    model(
        &[node(
            "Conv",
            &["image", "weights", "biases"],
            "logits",
            &[("kernel_shape", &[side, side]), ("pads", &[pad; 4])],
        )],
        &[
            tensor("weights", &[classes, channels, side, side], weights),
            tensor("biases", &[classes], biases),
        ],
        &[image(channels, size)],
        &[value(
            "logits",
            FLOAT,
            &[Fixed(1), Fixed(classes), Named("h"), Named("w")],
        )],
    )
}

const SENSOR: Sensor = Sensor {
    width: 12,
    height: 8,
};
const PIXELS: usize = 96;

fn event(x: u16, y: u16, is_on: bool) -> Event {
    Event {
        t_us: 0,
        x,
        y,
        polarity: Polarity::from_bool(is_on),
    }
}

/// Some events: ON towards the left, OFF towards the right.
fn frame() -> Frame {
    let mut events = Vec::new();
    for y in 0..8 {
        for x in 0..12 {
            for count in 0..(7 * x + 5 * y + x * y) % 5 {
                events.push(event(x, y, count + x < 8));
            }
        }
    }
    Frame::new(SENSOR, &events)
}

/// ON and OFF of a pixel, 0 outside.
fn counts(frame: &Frame, x: i64, y: i64) -> (i64, i64) {
    if !(0..12).contains(&x) || !(0..8).contains(&y) {
        return (0, 0);
    }
    let pixel = (y * 12 + x) as usize;
    (i64::from(frame.on()[pixel]), i64::from(frame.off()[pixel]))
}

/// `of(x, y)` of every pixel.
fn expected(of: impl Fn(i64, i64) -> u32) -> Vec<u32> {
    let pixels = (0..8).flat_map(|y| (0..12).map(move |x| (x, y)));
    pixels.map(|(x, y)| of(x, y)).collect()
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn model(&self, bytes: &[u8]) -> Box<dyn Segmenter> {
        open_model(&self.file("model.onnx", bytes)).unwrap()
    }
}

fn labels(bytes: &[u8], frame: &Frame) -> Vec<u32> {
    let masks = Folder::new().model(bytes).segment(frame).unwrap();
    assert_eq!(masks.sensor(), frame.sensor());
    masks.labels()
}

fn error(path: &Path) -> String {
    match open_model(path) {
        Ok(_) => panic!("{} was opened", path.display()),
        Err(error) => format!("{error:#}"),
    }
}

#[test]
fn one_class_is_where_its_logit_is_above_0() {
    let frame = frame();
    let of = |x: i64, y: i64| {
        let about = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        let sum: i64 = about
            .map(|(dx, dy)| counts(&frame, x + dx, y + dy))
            .map(|(on, off)| on - off)
            .sum();
        u32::from(sum > 2)
    };
    let expected = expected(of);
    assert!(expected.contains(&0) && expected.contains(&1));
    let model = convolution(1, ANY, 3, &[1.0; 9], &[-2.5]);
    assert_eq!(labels(&model, &frame), expected);
}

#[test]
fn the_class_of_the_greatest_logit_wins() {
    let frame = frame();
    // Logits: 1.5 for the background, ON, and OFF.
    let weights = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0];
    let model = convolution(2, [Fixed(8), Fixed(12)], 1, &weights, &[1.5, 0.0, 0.0]);
    let expected = expected(|x, y| match counts(&frame, x, y) {
        (on, off) if on.max(off) < 2 => 0,
        (on, off) if on >= off => 1,
        _ => 2,
    });
    assert!((0..3).all(|label| expected.contains(&label)));
    assert_eq!(labels(&model, &frame), expected);
}

#[test]
fn masks_of_a_picture_overlap_by_their_logits() {
    let frame = frame();
    let conv = node(
        "Conv",
        &["image", "weights", "biases"],
        "stacked",
        &[("kernel_shape", &[1, 1])],
    );
    let squeeze = node("Squeeze", &["stacked"], "masks", &[("axes", &[0])]);
    // Red and blue, at half of the full colour.
    let tensors = [
        tensor("weights", &[2, 3, 1, 1], &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        tensor("biases", &[2], &[-0.5, -0.5]),
    ];
    let stacked = value(
        "stacked",
        FLOAT,
        &[Fixed(1), Fixed(2), Named("h"), Named("w")],
    );
    let masks = value("masks", FLOAT, &[Fixed(2), Named("h"), Named("w")]);
    // The output named masks is not the first.
    let model = model(
        &[conv, squeeze],
        &tensors,
        &[image(3, ANY)],
        &[stacked, masks],
    );
    let expected = expected(|x, y| {
        let (on, off) = counts(&frame, x, y);
        match (on.min(3), off.min(3)) {
            (on, off) if on.max(off) < 2 => 0,
            (on, off) if on >= off => 1,
            _ => 2,
        }
    });
    assert!((0..3).all(|label| expected.contains(&label)));
    assert_eq!(labels(&model, &frame), expected);
}

#[test]
fn a_fixed_size_is_resized_to_and_back() {
    // One event in each pixel of a box on the grid of 2 x 2 pixels.
    let is_inside = |x: i64, y: i64| (2..8).contains(&x) && (4..8).contains(&y);
    let inside = expected(|x, y| u32::from(is_inside(x, y)));
    let events: Vec<Event> = (0..PIXELS)
        .filter(|pixel| inside[*pixel] == 1)
        .map(|pixel| event((pixel % 12) as u16, (pixel / 12) as u16, true))
        .collect();
    let frame = Frame::new(SENSOR, &events);
    // Half the size: logits of 1/2 inside and -1/2 outside. In between, 3/4 * 3/4 of the corner's
    // logits are of its own side.
    for (height, width) in [(4, 6), (8, 12), (16, 24), (24, 36)] {
        let size = [Fixed(height), Fixed(width)];
        let model = convolution(1, size, 1, &[1.0], &[-0.5]);
        assert_eq!(labels(&model, &frame), inside, "{height} x {width}");
    }
}

#[test]
fn comparisons_are_masks() {
    let frame = frame();
    let nodes = [
        node("Greater", &["image", "one"], "found", &[]),
        node("Squeeze", &["found"], "masks", &[("axes", &[0])]),
    ];
    let one = tensor("one", &[1], &[1.0]);
    // 9: Boolean.
    let masks = value("masks", 9, &[Fixed(1), Named("h"), Named("w")]);
    let model = model(&nodes, &[one], &[image(1, ANY)], &[masks]);
    let expected = expected(|x, y| {
        let (on, off) = counts(&frame, x, y);
        u32::from(on - off > 1)
    });
    assert!(expected.contains(&1));
    assert_eq!(labels(&model, &frame), expected);
}

#[test]
fn models_that_do_not_fit_are_told_from_those_that_do() {
    let folder = Folder::new();
    let identity = |input: Vec<u8>| {
        let output = value(
            "logits",
            FLOAT,
            &[Fixed(1), Fixed(1), Named("h"), Named("w")],
        );
        model(
            &[node("Identity", &["image"], "logits", &[])],
            &[],
            &[input],
            &[output],
        )
    };
    let typed = |kind, shape: &[Dim]| identity(value("image", kind, shape));
    let any = || [Fixed(1), Fixed(1), Named("h"), Named("w")];
    let two = model(
        &[node("Add", &["image", "other"], "logits", &[])],
        &[],
        &[image(1, ANY), value("other", FLOAT, &any())],
        &[value("logits", FLOAT, &any())],
    );
    let cases = [
        (identity(image(4, ANY)), "4 channels"),
        (two, "2 inputs"),
        (typed(INT64, &any()), "must be float32"),
        (
            typed(FLOAT, &[Fixed(1), Fixed(1), Fixed(8)]),
            "3 dimensions",
        ),
        (
            typed(FLOAT, &[Fixed(2), Fixed(1), Named("h"), Named("w")]),
            "one frame at a time",
        ),
        (
            typed(FLOAT, &[Fixed(1), Named("c"), Named("h"), Named("w")]),
            "must be fixed",
        ),
        (
            identity(image(1, [Fixed(1 << 40), Fixed(12)])),
            "1 to 4096 are possible",
        ),
        (
            model(
                &[node("NoSuchOperator", &["image"], "logits", &[])],
                &[],
                &[image(1, ANY)],
                &[value("logits", FLOAT, &any())],
            ),
            "NoSuchOperator",
        ),
        (Vec::new(), "docs/segmentation.md"),
        (b"this is no model".to_vec(), "docs/segmentation.md"),
    ];
    for (number, (bytes, part)) in cases.iter().enumerate() {
        let path = folder.file(&format!("case{number}.onnx"), bytes);
        let error = error(&path);
        assert!(error.contains(part), "{part}: {error}");
        assert!(error.contains(&format!("case{number}.onnx")), "{error}");
    }
    let fine = convolution(1, ANY, 1, &[1.0], &[0.0]);
    assert!(error(&folder.file("model.bin", &fine)).contains("must end in .onnx"));
    assert!(error(&folder.0.path().join("none.onnx")).contains("cannot be opened"));
    assert!(error(folder.0.path()).contains("must end in .onnx"));
    let is_folder = folder.0.path().join("folder.onnx");
    std::fs::create_dir(&is_folder).unwrap();
    assert!(error(&is_folder).contains("folder.onnx"));
}

#[test]
fn models_that_cannot_be_run_are_errors() {
    let folder = Folder::new();
    // Weights for two channels of an image with one, on which the runtime panics, and an output of
    // two dimensions.
    let contradicting = model(
        &[node(
            "Conv",
            &["image", "weights"],
            "logits",
            &[("kernel_shape", &[1, 1])],
        )],
        &[tensor("weights", &[1, 2, 1, 1], &[1.0, 1.0])],
        &[image(1, ANY)],
        &[value("logits", FLOAT, &[])],
    );
    let flat = model(
        &[node("Squeeze", &["image"], "logits", &[("axes", &[0, 1])])],
        &[],
        &[image(1, ANY)],
        &[value("logits", FLOAT, &[])],
    );
    let says_nothing = model(
        &[node(
            "Conv",
            &["image", "weights"],
            "logits",
            &[("kernel_shape", &[1, 1]), ("strides", &[1, 1])],
        )],
        &[tensor("weights", &[1, 1, 1, 1], &[f32::NAN])],
        &[image(1, ANY)],
        &[value("logits", FLOAT, &[])],
    );
    for (bytes, part) in [
        (contradicting, "runtime fails"),
        (flat, "[48, 64]"),
        (says_nothing, "not finite"),
    ] {
        // A frame without events shows it when the model is opened.
        let error = error(&folder.file("model.onnx", &bytes));
        assert!(
            error.contains("model.onnx") && error.contains(part),
            "{error}"
        );
    }
}

#[test]
fn damaged_models_never_panic() {
    let folder = Folder::new();
    let frame = frame();
    let weights = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0];
    let whole = convolution(2, [Fixed(8), Fixed(12)], 1, &weights, &[1.5, 0.0, 0.0]);
    let damaged = (0..whole.len())
        .map(|length| whole[..length].to_vec())
        .chain((0..whole.len()).map(|at| {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            bytes
        }));
    let (mut run, mut refused) = (0, 0);
    for bytes in damaged {
        let found = open_model(&folder.file("model.onnx", &bytes))
            .and_then(|mut model| model.segment(&frame));
        match found {
            Ok(masks) => {
                assert_eq!(masks.labels().len(), PIXELS);
                run += 1;
            }
            Err(error) => {
                assert!(format!("{error:#}").contains("model.onnx"));
                refused += 1;
            }
        }
    }
    assert!(run > 0 && refused > 0, "{run} {refused}");
}
