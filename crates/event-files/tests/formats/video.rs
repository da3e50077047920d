//! Frames of videos: every source, and what is refused.

use std::path::{Path, PathBuf};

use event_files::reading::TimeUnit;
use event_files::video::{Fps, RawGray, VideoReading, open_video};
use event_types::Sensor;
use event_types::stream::{Response, Result};

/// Times and numbers of all frames.
type Read = Vec<(u64, Vec<f32>)>;

fn read(path: &Path, reading: &VideoReading) -> Result<Read> {
    let mut reader = open_video(path, reading)?;
    let (mut all, mut values) = (Vec::new(), Vec::new());
    while let Some(t_us) = reader.read(&mut values)? {
        assert_eq!(values.len(), reader.sensor().pixels() as usize);
        all.push((t_us, values.clone()));
    }
    Ok(all)
}

fn at_fps(fps: u64) -> VideoReading {
    VideoReading {
        fps: Fps::new(fps, 1),
        ..VideoReading::default()
    }
}

/// A folder for a test's files.
struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Returns the error of reading these bytes.
    fn refused(&self, name: &str, bytes: &[u8], reading: &VideoReading) -> String {
        let path = self.write(name, bytes);
        let error = read(&path, reading).expect_err(name);
        let error = format!("{error:#}");
        assert!(error.contains(name), "{error}");
        error
    }
}

fn assert_close(numbers: &[f32], expected: &[f32]) {
    assert_eq!(numbers.len(), expected.len());
    for (a, b) in numbers.iter().zip(expected) {
        assert!((a - b).abs() < 1e-5, "{numbers:?} {expected:?}");
    }
}

/// Two frames of 3 x 2 pixels: luma of one and of another byte, and the rest.
fn y4m(header: &str, luma: [&[u8]; 2], rest: usize) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 {header}\n").into_bytes();
    for (frame, luma) in luma.into_iter().enumerate() {
        bytes.extend_from_slice(if frame == 0 {
            b"FRAME\n"
        } else {
            b"FRAME Ip Xa=b\n"
        });
        bytes.extend_from_slice(luma);
        bytes.extend(vec![77; rest]);
    }
    bytes
}

#[test]
fn y4m_of_every_chroma_gives_its_luma() {
    let files = Files::new();
    let (black, white) = ([16_u8, 235, 16, 235, 126, 16], [235_u8; 6]);
    for (chroma, rest) in [("C420jpeg ", 4), ("", 4), ("C422 ", 8), ("C444alpha ", 18)] {
        let header = format!("W3 H2 F30000:1001 Ip A0:0 {chroma}XYSCSS=X Q7");
        let path = files.write("a.y4m", &y4m(&header, [&black, &white], rest));
        let frames = read(&path, &VideoReading::default()).unwrap();
        assert_eq!(frames.len(), 2);
        assert_eq!((frames[0].0, frames[1].0), (0, 33_367));
        let half = 110.0 / 219.0;
        assert_close(&frames[0].1, &[0.0, 1.0, 0.0, 1.0, half, 0.0]);
        assert_close(&frames[1].1, &[1.0; 6]);
    }
    // Full range: by the header, by the caller, and for gray.
    let bytes = [0_u8, 51, 102, 153, 204, 255];
    let steps = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
    let full = VideoReading {
        full_range: Some(true),
        ..VideoReading::default()
    };
    for (header, rest, reading) in [
        (
            "W3 H2 F25:1 C420 XCOLORRANGE=FULL",
            4,
            &VideoReading::default(),
        ),
        ("W3 H2 F25:1 C420 XCOLORRANGE=LIMITED", 4, &full),
        ("W3 H2 F25:1 Cmono", 0, &VideoReading::default()),
    ] {
        let path = files.write("b.y4m", &y4m(header, [&bytes, &bytes], rest));
        let frames = read(&path, reading).unwrap();
        assert_close(&frames[1].1, &steps);
        assert_eq!(frames[1].0, 40_000);
    }
    // 10 bits in two bytes.
    let deep: Vec<u8> = [64_u16, 940, 502, 64, 64, 64]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let path = files.write("c.y4m", &y4m("W3 H2 F25:1 Ip C420p10", [&deep, &deep], 8));
    let frames = read(&path, &at_fps(100)).unwrap();
    assert_close(&frames[0].1, &[0.0, 1.0, 0.5, 0.0, 0.0, 0.0]);
    assert_eq!(frames[1].0, 10_000);
}

#[test]
fn damaged_y4m_is_refused() {
    let files = Files::new();
    let luma = [7_u8; 6];
    let whole = y4m("W3 H2 F25:1 Ip C420", [&luma, &luma], 4);
    let header = 1 + whole.iter().position(|byte| *byte == b'\n').unwrap();
    for end in 0..whole.len() {
        let path = files.write("cut.y4m", &whole[..end]);
        // Between two frames nothing is missing.
        let is_whole = [header, header + 6 + 10].contains(&end);
        let got = read(&path, &VideoReading::default());
        assert!(got.is_err() || is_whole, "{end}: {got:?}");
    }
    let said = files.refused(
        "cut.y4m",
        &whole[..whole.len() - 1],
        &VideoReading::default(),
    );
    assert!(said.contains("frame 1 ends after 9 of 10 bytes"), "{said}");
    for (header, what) in [
        ("W3 F25:1", "states no size"),
        ("W1000000000 H1000000000 F25:1", "scale the video"),
        ("W0 H2 F25:1", "sides of 1"),
        ("Wx H2 F25:1", "Wx is no size"),
        ("W3 H2 F25:1 It C420", "yadif"),
        ("W3 H2 F25:1 Im C420", "yadif"),
        ("W3 H2 F25:1 Crgb", "chroma rgb is not known"),
        ("W3 H2 F0:1", "no frame rate"),
        ("W3 H2 F0:0", "give --fps"),
        ("W3 H2", "give --fps"),
        ("W3 H2 F9000000:1", "no frame rate"),
    ] {
        let said = files.refused(
            "bad.y4m",
            &y4m(header, [&luma, &luma], 4),
            &VideoReading::default(),
        );
        assert!(said.contains(what), "{header}: {said}");
    }
    let mut other = whole.clone();
    let second = whole.len() - 10 - 14;
    other[second] = b'f';
    let said = files.refused("bad.y4m", &other, &VideoReading::default());
    assert!(
        said.contains(&format!("byte {second}: no FRAME where frame 1")),
        "{said}"
    );
    // Any damage is an error or other numbers.
    for at in 0..whole.len() {
        for byte in [0, b'\n', b' ', b'9', 0xff] {
            let mut other = whole.clone();
            other[at] = byte;
            let _ = read(&files.write("any.y4m", &other), &VideoReading::default());
        }
    }
}

fn png(
    width: u32,
    height: u32,
    color: png::ColorType,
    depth: png::BitDepth,
    data: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(data)
        .unwrap();
    bytes
}

fn gray(width: u32, data: &[u8]) -> Vec<u8> {
    let height = data.len() as u32 / width;
    png(
        width,
        height,
        png::ColorType::Grayscale,
        png::BitDepth::Eight,
        data,
    )
}

#[test]
fn a_folder_of_png_is_a_video() {
    let files = Files::new();
    let wide = [0, 0, 0xff, 0xff, 0x80, 0x00];
    let rgb = [255, 0, 0, 0, 255, 0, 51, 51, 51];
    files.write(
        "v/f10.png",
        &png(3, 1, png::ColorType::Rgb, png::BitDepth::Eight, &rgb),
    );
    files.write(
        "v/f9.PNG",
        &png(
            3,
            1,
            png::ColorType::Grayscale,
            png::BitDepth::Sixteen,
            &wide,
        ),
    );
    let opaque = [0, 255, 102, 255, 255, 255];
    let alpha = png::ColorType::GrayscaleAlpha;
    files.write(
        "v/f11.png",
        &png(3, 1, alpha, png::BitDepth::Eight, &opaque),
    );
    files.write("v/notes.txt", b"no frame");
    let folder = files.0.path().join("v");
    let frames = read(&folder, &at_fps(50)).unwrap();
    assert_eq!(
        frames.iter().map(|(t_us, _)| *t_us).collect::<Vec<_>>(),
        [0, 20_000, 40_000]
    );
    assert_close(&frames[0].1, &[0.0, 1.0, 32_768.0 / 65_535.0]);
    assert_close(&frames[1].1, &[0.2126, 0.7152, 0.2]);
    assert_close(&frames[2].1, &[0.0, 0.4, 1.0]);

    let said = |reading: &VideoReading| format!("{:#}", read(&folder, reading).unwrap_err());
    assert!(said(&VideoReading::default()).contains("give --fps"));
    files.write("v/f12.png", &gray(1, &[1, 2]));
    let error = said(&at_fps(50));
    assert!(
        error.contains("f12.png") && error.contains("1 x 2"),
        "{error}"
    );
    let transparent = [0, 255, 102, 254, 255, 255];
    files.write(
        "v/f12.png",
        &png(3, 1, alpha, png::BitDepth::Eight, &transparent),
    );
    assert!(said(&at_fps(50)).contains("opaque"));
    let whole = gray(3, &[1, 2, 3]);
    for end in 0..whole.len() {
        files.write("v/f12.png", &whole[..end]);
        let error = said(&at_fps(50));
        assert!(error.contains("f12.png"), "{end}: {error}");
    }
    // A header that claims 10^9 x 10^9 pixels, with its checksum.
    let mut huge = whole.clone();
    for side in [16, 20] {
        huge[side..side + 4].copy_from_slice(&1_000_000_000_u32.to_be_bytes());
    }
    let mut crc = flate2::Crc::new();
    crc.update(&huge[12..29]);
    huge[29..33].copy_from_slice(&crc.sum().to_be_bytes());
    files.write("v/f8.png", &huge);
    let error = said(&at_fps(50));
    assert!(
        error.contains("f8.png") && error.contains("scale"),
        "{error}"
    );
    std::fs::create_dir(files.0.path().join("empty")).unwrap();
    let error = read(&files.0.path().join("empty"), &at_fps(50)).unwrap_err();
    assert!(error.to_string().contains("no PNG files"), "{error}");
}

#[test]
fn times_come_from_a_file() {
    let files = Files::new();
    for (name, byte) in [("v/1.png", 0), ("v/2.png", 9), ("v/3.png", 0)] {
        files.write(name, &gray(1, &[byte]));
    }
    let folder = files.0.path().join("v");
    let with = |text: &str, unit| {
        let reading = VideoReading {
            times: Some(files.write("times.txt", text.as_bytes())),
            time_unit: unit,
            ..VideoReading::default()
        };
        read(&folder, &reading).map_err(|error| format!("{error:#}"))
    };
    let times = |read: Read| read.into_iter().map(|(t_us, _)| t_us).collect::<Vec<_>>();
    let seconds = with("# s\n0.5\n\n1.0000004\r\n1.6e9", Some(TimeUnit::S)).unwrap();
    assert_eq!(times(seconds), [500_000, 1_000_000, 1_600_000_000_000_000]);
    let us = with("7\n8\n10\n", Some(TimeUnit::Us)).unwrap();
    assert_eq!(times(us), [7, 8, 10]);
    let long = "1".repeat(5_000);
    for (text, what) in [
        ("7\n8\n", "line 3: the times end here, but frame 2"),
        (
            "7\n8\n9\n10\n",
            "line 4: a time, but there are 3 frames only",
        ),
        ("7\n7\n9\n", "frame 1: its time, 7 us, is not later"),
        ("7\n9\n8\n", "3.png: frame 2: its time, 8 us, is not later"),
        ("7\n-8\n9\n", "line 2: is no time"),
        ("7\n8 b.png\n9\n", "line 2: is no time"),
        ("nan\n8\n9\n", "line 1: is no time"),
        (long.as_str(), "line 1: is no time"),
        ("", "line 1: the times end here"),
    ] {
        let said = with(text, Some(TimeUnit::Us)).unwrap_err();
        assert!(said.contains(what), "{text}: {said}");
    }
    assert!(with("7\n8\n9\n", None).unwrap_err().contains("--time-unit"));
}

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(data);
    bytes
}

fn floats(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

#[test]
fn arrays_of_numpy_are_videos() {
    let files = Files::new();
    let fps = at_fps(1_000);
    let steps = [0.0, 0.2, 0.4, 1.0];
    let wide: Vec<u8> = [0_u16, 13_107, 26_214, 65_535]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let wide_be: Vec<u8> = wide.chunks(2).flat_map(|pair| [pair[1], pair[0]]).collect();
    for (descr, data) in [
        ("|u1", vec![0, 51, 102, 255]),
        ("<u2", wide),
        (">u2", wide_be),
        ("<f4", floats(&steps)),
    ] {
        for shape in ["(2, 1, 2)", "(2, 2, 1, 1)"] {
            let path = files.write("a.npy", &npy(descr, shape, &data));
            let frames = read(&path, &fps).unwrap();
            assert_eq!((frames[0].0, frames[1].0), (0, 1_000));
            assert_close(&frames[0].1, &steps[..2]);
            assert_close(&frames[1].1, &steps[2..]);
            let linear = open_video(&path, &fps).unwrap().response() == Response::Linear;
            assert_eq!(linear, descr == "<f4");
        }
    }
    let white = |white| VideoReading {
        white: Some(white),
        ..fps.clone()
    };
    let path = files.write("a.npy", &npy("<i4", "(1, 1, 1)", &[200, 0, 0, 0]));
    assert_close(&read(&path, &white(400.0)).unwrap()[0].1, &[0.5]);
    let path = files.write("a.npy", &npy("<f4", "(1, 1, 1)", &floats(&[3.0])));
    assert_close(&read(&path, &white(1.0)).unwrap()[0].1, &[3.0]);

    let bytes = |value: f32| npy("<f4", "(2, 1, 1)", &floats(&[0.5, value]));
    let good = bytes(0.5);
    for (array, what) in [
        (bytes(f32::NAN), "frame 1: the pixel at x = 0, y = 0 is NaN"),
        (bytes(f32::INFINITY), "is no light"),
        (bytes(-0.1), "-0.1, which is no light"),
        (bytes(37.0), "give --white"),
        (
            good[..good.len() - 1].to_vec(),
            "frame 1 ends after 3 of 4 bytes",
        ),
        (
            [good.as_slice(), &[0]].concat(),
            "bytes follow the 2 frames",
        ),
        (
            npy("<f4", "(4,)", &[0; 16]),
            "give frames as (frames, rows, columns)",
        ),
        (
            npy("<f4", "(1, 1000000000, 1000000000)", &[]),
            "scale the video",
        ),
        (
            npy("<f4", "(18446744073709551615, 1, 1)", &[0; 8]),
            "frame 2 ends after 0",
        ),
        (npy("<i8", "(1, 1, 1)", &[0; 8]), "--white"),
        (npy("<U3", "(1, 1, 1)", &[0; 12]), "not of numbers"),
    ] {
        let said = files.refused("bad.npy", &array, &fps);
        assert!(said.contains(what), "{what}: {said}");
    }
    let fortran = npy("<f4", "(1, 1, 1)", &[0; 4]);
    let fortran =
        String::from_utf8_lossy(&fortran[10..fortran.len() - 4]).replace("False", "True ");
    let mut array = b"\x93NUMPY\x01\x00".to_vec();
    array.extend_from_slice(&(fortran.len() as u16).to_le_bytes());
    array.extend_from_slice(fortran.as_bytes());
    assert!(
        files
            .refused("bad.npy", &array, &fps)
            .contains("ascontiguousarray")
    );
    let said = files.refused("bad.npy", &good, &VideoReading::default());
    assert!(said.contains("give --fps"), "{said}");
    for at in 0..good.len() {
        let mut other = good.clone();
        other[at] ^= 0x15;
        let _ = read(&files.write("any.npy", &other), &fps);
        let _ = read(&files.write("any.npy", &good[..at]), &fps);
    }
}

fn npz(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, array) in arrays {
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file(format!("{name}.npy"), options).unwrap();
        std::io::Write::write_all(&mut zip, array).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn an_npz_has_frames_and_their_times() {
    let files = Files::new();
    let frames = || npy("|u1", "(3, 1, 2)", &[0, 255, 0, 255, 255, 0]);
    let longs = |values: [i64; 3]| {
        values
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    let times = |read: Read| read.into_iter().map(|(t_us, _)| t_us).collect::<Vec<_>>();
    let none = VideoReading::default();
    for (name, descr, data) in [
        ("times_us", "<i8", longs([5, 1_000_005, 1_000_006])),
        ("t_ns", "<i8", longs([5_000, 1_000_005_000, 1_000_005_999])),
        ("timestamps", "<m8[us]", longs([5, 1_000_005, 1_000_006])),
        ("t_s", "<f4", floats(&[5e-6, 1.000_005, 1.000_006])),
    ] {
        let array = npy(descr, "(3,)", &data);
        let path = files.write(
            "a.npz",
            &npz(&[
                ("video", frames()),
                (name, array),
                ("other", frames()[..20].to_vec()),
            ]),
        );
        assert_eq!(
            times(read(&path, &none).unwrap()),
            [5, 1_000_005, 1_000_006],
            "{name}"
        );
        assert_eq!(
            times(read(&path, &at_fps(1_000)).unwrap()),
            [0, 1_000, 2_000]
        );
    }
    let unit = VideoReading {
        time_unit: Some(TimeUnit::Ms),
        ..VideoReading::default()
    };
    let array = |values| npy("<i8", "(3,)", &longs(values));
    let path = files.write(
        "a.npz",
        &npz(&[("video", frames()), ("t", array([1, 2, 4]))]),
    );
    assert_eq!(times(read(&path, &unit).unwrap()), [1_000, 2_000, 4_000]);
    let two = npz(&[("a", frames()), ("b", frames()), ("t_us", array([1, 2, 4]))]);
    let path = files.write("a.npz", &two);
    assert_eq!(times(read(&path.join("b"), &none).unwrap()), [1, 2, 4]);
    for (bytes, what) in [
        (two, "a and b may both be frames"),
        (npz(&[("a", frames())]), "no array of 3 times"),
        (
            npz(&[("a", frames()), ("t", array([1, 2, 4]))]),
            "--time-unit",
        ),
        (
            npz(&[("a", frames()), ("t_us", array([1, 2, 2]))]),
            "is not later",
        ),
        (
            npz(&[("a", frames()), ("t_us", array([1, -2, 2]))]),
            "time 1 is missing, negative",
        ),
        (
            npz(&[("t_us", array([1, 2, 3]))]),
            "no array of shape (frames, rows, columns)",
        ),
        (b"PK\x03\x04 and nothing".to_vec(), "damaged npz"),
    ] {
        let said = files.refused("bad.npz", &bytes, &none);
        assert!(said.contains(what), "{what}: {said}");
    }
    // A frame that is damaged: its CRC-32 says so.
    let mut damaged = npz(&[("a", frames()), ("t_us", array([1, 2, 4]))]);
    if let Some(at) = damaged
        .windows(6)
        .position(|w| w == [0, 255, 0, 255, 255, 0])
    {
        damaged[at] ^= 1;
        assert!(files.refused("bad.npz", &damaged, &none).contains("CRC-32"));
    }
}

#[test]
fn gray_pixels_without_a_header_need_their_size() {
    let files = Files::new();
    let raw = |wide| VideoReading {
        raw: Some(RawGray {
            sensor: Sensor {
                width: 2,
                height: 1,
            },
            wide,
        }),
        ..at_fps(10)
    };
    let path = files.write("a.gray", &[0, 255, 51, 0, 102, 204]);
    let frames = read(&path, &raw(false)).unwrap();
    assert_eq!(frames.len(), 3);
    assert_eq!(frames[2].0, 200_000);
    assert_close(&frames[2].1, &[0.4, 0.8]);
    let said = files.refused("a.gray", &[0, 255, 51, 0, 102, 204], &raw(true));
    assert!(said.contains("frame 1 ends after 2 of 4 bytes"), "{said}");
    let said = files.refused("a.gray", &[1, 2, 3, 4], &at_fps(10));
    assert!(said.contains("no video that is known"), "{said}");
    let said = files.refused(
        "a.gray",
        &[],
        &VideoReading {
            fps: None,
            ..raw(false)
        },
    );
    assert!(said.contains("give --fps"), "{said}");
}

/// A record of a ROS 1 bag.
fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut header = Vec::new();
    for (name, value) in fields {
        header.extend_from_slice(&((name.len() + 1 + value.len()) as u32).to_le_bytes());
        header.extend_from_slice(name.as_bytes());
        header.push(b'=');
        header.extend_from_slice(value);
    }
    [
        &(header.len() as u32).to_le_bytes(),
        header.as_slice(),
        &(data.len() as u32).to_le_bytes(),
        data,
    ]
    .concat()
}

#[test]
fn a_bag_of_images_is_a_video() {
    let connection = |number: u8, topic: &str, kind: &str| {
        // The data is fields, as in a header.
        let data = record(
            &[("topic", topic.as_bytes()), ("type", kind.as_bytes())],
            &[],
        );
        let data = &data[4..data.len() - 4];
        record(
            &[
                ("op", &[7]),
                ("conn", &[number, 0, 0, 0]),
                ("topic", topic.as_bytes()),
            ],
            data,
        )
    };
    let image = |number: u8, nanos: u32, pixels: [u8; 2]| {
        let mut data: Vec<u8> = [0, 9, nanos, 0, 1, 2, 5]
            .iter()
            .flat_map(|v: &u32| v.to_le_bytes())
            .collect();
        data.extend_from_slice(b"mono8\0");
        data.extend_from_slice(&[2, 0, 0, 0, 2, 0, 0, 0]);
        data.extend_from_slice(&pixels);
        record(
            &[
                ("op", &[2]),
                ("conn", &[number, 0, 0, 0]),
                ("time", &[0; 8]),
            ],
            &data,
        )
    };
    let bag = |second_ns| {
        [
            b"#ROSBAG V2.0\n".to_vec(),
            connection(0, "/imu", "sensor_msgs/Imu"),
            connection(1, "/left", "sensor_msgs/Image"),
            connection(2, "/right", "sensor_msgs/Image"),
            image(1, 1_000, [0, 255]),
            image(2, 5_000, [51, 51]),
            image(1, second_ns, [102, 0]),
        ]
        .concat()
    };
    let files = Files::new();
    let path = files.write("a.bag", &bag(7_000));
    let none = VideoReading::default();
    let frames = read(&path, &none).unwrap();
    assert_eq!(
        (frames[0].0, frames[1].0, frames.len()),
        (9_000_001, 9_000_007, 2)
    );
    assert_close(&frames[1].1, &[0.4, 0.0]);
    assert_eq!(
        open_video(&path, &none).unwrap().response(),
        Response::Linear
    );
    let right = read(&path.join("right"), &none).unwrap();
    assert_eq!((right[0].0, right.len()), (9_000_005, 1));
    let said = files.refused("a.bag", &bag(1_000), &none);
    assert!(
        said.contains("is not later") && said.contains("--fps"),
        "{said}"
    );
    let said = read(&path.join("imu"), &none).unwrap_err().to_string();
    assert!(said.contains("not images"), "{said}");
    let said = files.refused("a.bag", &bag(7_000)[..120], &none);
    assert!(!said.is_empty());
}

#[test]
fn frames_of_davis_recordings_are_read() {
    for name in [
        "davis346_static_sparse/davis346.aedat4",
        "davis346_building_dense/davis.aedat4",
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../shared/data")
            .join(name);
        if !path.is_file() {
            eprintln!("skipped: {} is not there", path.display());
            continue;
        }
        let mut reader = open_video(&path, &VideoReading::default()).unwrap();
        assert_eq!(
            reader.sensor(),
            Sensor {
                width: 346,
                height: 260
            }
        );
        let (mut values, mut times) = (Vec::new(), Vec::new());
        let mut range = (1.0_f32, 0.0_f32);
        while let Some(t_us) = reader.read(&mut values).unwrap() {
            times.push(t_us);
            for value in &values {
                range = (range.0.min(*value), range.1.max(*value));
            }
        }
        let mut events = event_files::open(&path, None).unwrap();
        let mut batch = Vec::new();
        while events.read(&mut batch).unwrap() > 0 {}
        let span = batch[0].t_us..batch[batch.len() - 1].t_us;
        eprintln!(
            "{name}: {} frames, {range:?}, {:?} in {span:?}",
            times.len(),
            times.first()
        );
        assert!(times.len() >= 3 && range.1 - range.0 > 0.3);
        let near = times
            .iter()
            .filter(|t_us| **t_us + 100_000 > span.start && **t_us < span.end + 100_000);
        assert_eq!(near.count(), times.len());
    }
}
