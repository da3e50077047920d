//! Segmentation by ONNX models, which the tests write themselves.

use std::path::{Path, PathBuf};

use eecvs_bench::source::Source;
use eecvs_nostd::{Event, Polarity, Sensor};
use event_emulator::Preset;
use host_harness::downstream::segment::{Frame, Segmenter, open_model};
use host_harness::downstream::segmentation;

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
const INT32: u64 = 6;
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

/// A `NodeProto` with attributes of lists of integers.
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

/// A `NodeProto` with an attribute of one integer.
fn node_of(kind: &str, input: &str, output: &str, (name, value): (&str, u64)) -> Vec<u8> {
    // 2 is the type of integers.
    let attribute = [text(1, name), number(3, value), number(20, 2)].concat();
    [node(kind, &[input], output, &[]), bytes(5, &attribute)].concat()
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
    convolution_and(channels, size, side, weights, biases, &[], "logits", FLOAT)
}

/// One convolution to `logits`, and nodes after it that make the output `last`.
#[allow(clippy::too_many_arguments)]
fn convolution_and(
    channels: u64,
    size: [Dim; 2],
    side: u64,
    weights: &[f32],
    biases: &[f32],
    after: &[Vec<u8>],
    last: &str,
    kind: u64,
) -> Vec<u8> {
    let classes = biases.len() as u64;
    let pad = side / 2;
    let conv = node(
        "Conv",
        &["image", "weights", "biases"],
        "logits",
        &[("kernel_shape", &[side, side]), ("pads", &[pad; 4])],
    );
    model(
        &[&[conv], after].concat(),
        &[
            tensor("weights", &[classes, channels, side, side], weights),
            tensor("biases", &[classes], biases),
        ],
        &[image(channels, size)],
        &[value(last, kind, &[])],
    )
}

/// One convolution of 1 x 1 pixels of a frame's two channels, and nodes after it that make the output `last`.
fn weighted(weights: &[f32], biases: &[f32], after: &[Vec<u8>], last: &str, kind: u64) -> Vec<u8> {
    convolution_and(2, ANY, 1, weights, biases, after, last, kind)
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

/// The labels of a box on the grid of 2 x 2 pixels, and one event in each of its pixels.
fn filled_box() -> (Vec<u32>, Vec<Event>) {
    let is_inside = |x: i64, y: i64| (2..8).contains(&x) && (4..8).contains(&y);
    let inside = expected(|x, y| u32::from(is_inside(x, y)));
    let events: Vec<Event> = (0..PIXELS)
        .filter(|pixel| inside[*pixel] == 1)
        .map(|pixel| event((pixel % 12) as u16, (pixel / 12) as u16, true))
        .collect();
    (inside, events)
}

#[test]
fn a_fixed_size_is_resized_to_and_back() {
    let (inside, events) = filled_box();
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
fn probabilities_are_cut_at_a_half() {
    let frame = frame();
    let folder = Folder::new();
    let (weights, biases) = ([1.0, -1.0], [-0.75]);
    let logits = weighted(&weights, &biases, &[], "logits", FLOAT);
    let sigmoid = node("Sigmoid", &["logits"], "shares", &[]);
    let shares = weighted(&weights, &biases, &[sigmoid], "shares", FLOAT);
    let expected = expected(|x, y| {
        let (on, off) = counts(&frame, x, y);
        u32::from(on - off > 0)
    });
    assert!(expected.contains(&0) && expected.contains(&1));
    for (bytes, name) in [
        (logits, "logits above 0"),
        (shares, "probabilities above 0.5"),
    ] {
        let model = folder.model(&bytes);
        assert!(model.name().contains(name), "{}", model.name());
        assert_eq!(model.segment(&frame).unwrap().labels(), expected, "{name}");
    }
    // Shares of classes are compared with each other, as their logits are.
    let (weights, biases) = ([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], [1.5, 0.0, 0.0]);
    let softmax = node_of("Softmax", "logits", "shares", ("axis", 1));
    let classes = labels(&weighted(&weights, &biases, &[], "logits", FLOAT), &frame);
    let shares = weighted(&weights, &biases, &[softmax], "shares", FLOAT);
    assert_eq!(labels(&shares, &frame), classes);
    assert!(folder.model(&shares).name().contains("3 classes"));
}

#[test]
fn values_that_were_probabilities_and_are_not_are_refused() {
    // Up to 0.2 in the frames of the trial.
    let model = Folder::new().model(&weighted(&[0.05; 2], &[0.0], &[], "logits", FLOAT));
    assert!(model.name().contains("probabilities"), "{}", model.name());
    let some = Frame::new(SENSOR, &[event(3, 2, true); 15]);
    assert_eq!(model.segment(&some).unwrap().areas(), [1]);
    let many = Frame::new(SENSOR, &[event(3, 2, true); 50]);
    let error = format!("{:#}", model.segment(&many).unwrap_err());
    for part in ["model.onnx", "`logits`", "export logits"] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn integers_are_labels() {
    let frame = frame();
    // Without ties, which the runtime decides otherwise.
    let (weights, biases) = ([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], [1.5, 0.0, 0.25]);
    let classes = labels(&weighted(&weights, &biases, &[], "logits", FLOAT), &frame);
    assert!((0..3).all(|label| classes.contains(&label)));
    let greatest = node_of("ArgMax", "logits", "labels", ("axis", 1));
    let model = weighted(&weights, &biases, &[greatest], "labels", INT64);
    assert_eq!(labels(&model, &frame), classes);
    assert!(Folder::new().model(&model).name().contains("(labels"));
    // What is below 0 is background, and there may be gaps: ON - OFF, twice.
    let cast = node_of("Cast", "logits", "labels", ("to", INT32));
    let model = weighted(&[2.0, -2.0], &[0.0], &[cast], "labels", INT32);
    let found = Folder::new().model(&model);
    let sums = |x, y| {
        let (on, off) = counts(&frame, x, y);
        (on - off).max(0) as u32
    };
    let expected = expected(sums);
    assert!(expected.contains(&3));
    // Labels are numbered anew.
    let mut known = expected.clone();
    known.sort_unstable();
    known.dedup();
    let place = |label: &u32| known.iter().position(|other| other == label).unwrap() as u32;
    let expected: Vec<u32> = expected.iter().map(place).collect();
    assert_eq!(found.segment(&frame).unwrap().labels(), expected);
    // More labels than segments can be meant.
    let sensor = Sensor::new(30, 10).unwrap();
    let mut events = Vec::new();
    for pixel in 0..300 {
        let at = event(pixel % 30, pixel / 30, true);
        events.extend(std::iter::repeat_n(at, usize::from(pixel)));
    }
    let error = found.segment(&Frame::new(sensor, &events)).unwrap_err();
    assert!(format!("{error:#}").contains("299 labels"), "{error:#}");
}

#[test]
fn an_output_of_another_size_is_resized() {
    let (inside, events) = filled_box();
    let conv = node(
        "Conv",
        &["image", "weights", "biases"],
        "logits",
        &[("kernel_shape", &[2, 2]), ("strides", &[2, 2])],
    );
    let half = model(
        &[conv],
        &[
            tensor("weights", &[1, 1, 2, 2], &[0.25; 4]),
            tensor("biases", &[1], &[-0.5]),
        ],
        &[image(1, ANY)],
        &[value("logits", FLOAT, &[])],
    );
    assert_eq!(labels(&half, &Frame::new(SENSOR, &events)), inside);
}

#[test]
fn a_model_that_says_nothing_scores_nothing() {
    let source = Source::scene(Preset::Motorcycle, 1, 100_000).unwrap();
    let folder = Folder::new();
    let softmax = || node_of("Softmax", "logits", "shares", ("axis", 1));
    let constant = |bias| weighted(&[0.0; 2], &[bias], &[], "logits", FLOAT);
    let silent = [
        constant(-1.0),
        constant(1.0),
        // Of one class, the share is 1 everywhere.
        weighted(&[1.0; 2], &[0.0], &[softmax()], "shares", FLOAT),
        // Classes that are alike everywhere.
        weighted(&[1.0; 4], &[0.0; 2], &[], "logits", FLOAT),
    ];
    for bytes in silent {
        let found = segmentation(&source, &source.events, 10_000, &*folder.model(&bytes)).unwrap();
        assert_eq!((found.mean_iou, found.foreground_iou), (None, None));
    }
    let tells = folder.model(&weighted(&[1.0; 2], &[-0.5], &[], "logits", FLOAT));
    let found = segmentation(&source, &source.events, 10_000, &*tells).unwrap();
    assert_eq!(found.mean_iou, Some(1.0));
    assert!(found.frames > 5, "{found:?}");
}

#[test]
fn names_tell_models_and_outputs_apart() {
    let folder = Folder::new();
    let name = |bytes: &[u8]| folder.model(bytes).name().to_owned();
    let [one, other] =
        [0.0, 0.5].map(|bias| weighted(&[1.0; 2], &[bias - 1.0], &[], "logits", FLOAT));
    assert_eq!(name(&one), name(&one));
    assert_ne!(name(&one), name(&other));
    assert!(!name(&one).contains("output"));
    let two = model(
        &[
            node("Neg", &["image"], "first", &[]),
            node("Identity", &["image"], "second", &[]),
        ],
        &[],
        &[image(1, ANY)],
        &["first", "second"].map(|name| value(name, FLOAT, &[])),
    );
    assert!(name(&two).contains("of output `first`"), "{}", name(&two));
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
            "1 to 4096 are supported",
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
    // NaN on every frame, and infinite where there are events.
    let says_nothing = weighted(&[f32::NAN, 0.0], &[0.0], &[], "logits", FLOAT);
    let overflows = weighted(
        &[1e38, 0.0],
        &[0.0],
        &[node("Mul", &["logits", "logits"], "squares", &[])],
        "squares",
        FLOAT,
    );
    // Rows, columns and classes in other orders.
    let turned = |perm: [u64; 4]| {
        let turn = node("Transpose", &["logits"], "turned", &[("perm", &perm)]);
        weighted(&[1.0, 0.0, 0.0, 1.0], &[0.0; 2], &[turn], "turned", FLOAT)
    };
    // A convolution whose size is that of its weights only.
    let unsized_weights = model(
        &[node(
            "Conv",
            &["image", "weights"],
            "logits",
            &[("pads", &[1; 4])],
        )],
        &[tensor("weights", &[1, 1, 3, 3], &[1.0; 9])],
        &[image(1, ANY)],
        &[value("logits", FLOAT, &[])],
    );
    let classes_of_integers = weighted(
        &[1.0, 0.0, 0.0, 1.0],
        &[0.0; 2],
        &[node_of("Cast", "logits", "whole", ("to", INT32))],
        "whole",
        INT32,
    );
    for (bytes, part) in [
        (contradicting, "runtime failed"),
        (flat, "[260, 346]"),
        (says_nothing, "`logits` has values that are not finite"),
        (overflows, "`squares` has values that are not finite"),
        (turned([0, 2, 3, 1]), "channels before rows and columns"),
        (turned([0, 1, 3, 2]), "rows before columns"),
        (unsized_weights, "on a frame of 346 x 260 pixels"),
        (classes_of_integers, "2 classes of integers"),
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
        let found =
            open_model(&folder.file("model.onnx", &bytes)).and_then(|model| model.segment(&frame));
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
