//! Encodes any events under any configuration: every event is accounted for, and every frame parses and unpacks.

use std::num::NonZeroU32;

use eecvs::encode::HostStorage;
use eecvs::reconstruct::arrival::Arrivals;
use eecvs::reconstruct::coefficients::CoefficientDecoder;
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs_nostd::{
    Axis, Coder, Config, Effort, Event, Fidelity, Filter, Frame, Hybrid, Mode, Polarity, Push,
    Quantiser, Readout, Region, Sensor, Thresholds, Transform, WindowConfig,
};

/// A mode of every kind.
pub fn to_mode(mode: u8, fidelity: u8) -> Mode {
    let coder = match mode % 5 {
        0 => return Mode::Transform,
        // It is lossless.
        1 if mode >> 6 == 3 => {
            return Mode::Hybrid(Hybrid {
                coder: Coder::Quick,
                fidelity: Fidelity::Lossless,
            });
        }
        1 if mode >> 6 == 2 => Coder::Keys,
        1 => Coder::Fast,
        2 => Effort::from_number(mode >> 6).map_or(Coder::Dense, Coder::Tree),
        3 => return Mode::Coefficients(Coder::Fast),
        _ => return Mode::Coefficients(Coder::Dense),
    };
    let fidelity = match fidelity % 4 {
        0 => Fidelity::Lossless,
        1 => Fidelity::ToleranceUs(u32::from(fidelity)),
        2 => Fidelity::SpreadUs(u32::from(fidelity) << 4),
        _ => Fidelity::Bins(1 + u16::from(fidelity)),
    };
    Mode::Hybrid(Hybrid { coder, fidelity })
}

fn is_spread(mode: Mode) -> bool {
    matches!(mode, Mode::Hybrid(hybrid) if matches!(hybrid.fidelity, Fidelity::SpreadUs(_)))
}

/// Runs one input.
pub fn run(data: &[u8]) {
    let [
        m,
        grid,
        transform,
        step,
        window,
        capacity,
        mode,
        fidelity,
        control,
        key,
        words @ ..,
    ] = data
    else {
        return;
    };
    let sensor = Sensor {
        width: 70,
        height: 5,
    };
    let window_us = 1 << (*window % 32);
    let mode = to_mode(*mode, *fidelity);
    let key_windows = 1 + u16::from(*key >> 4);
    // The least budget accepted, plus up to 63 kB per second.
    let budget = 1_000_000_u32.div_ceil(window_us) * 147 + 1000 * (u32::from(*control) >> 2);
    let config = Config {
        window: WindowConfig::new(sensor, window_us),
        thresholds: Thresholds::new(1 << 40, 1 << 43).expect("in order"),
        transform: Transform::from_code(*transform % 4),
        m: 1 + *m % 64,
        grid: (*grid > 0).then_some(u16::from(*grid)),
        quantiser: Quantiser::new((*step % 24) as i8 - 15).expect("-15 to 8"),
        few_as_times: *control & 1 == 1,
        max_emd_us: NonZeroU32::new(u32::from(*fidelity >> 2) << (*step % 8))
            .filter(|_| mode.is_lossless() && !mode.keeps_arrival()),
        mode,
        key_windows,
        readout: Readout::new(Axis::Columns, 20 << 16, i32::from(*control) << 10),
        filter: Filter {
            region: (*key & 1 == 1).then_some(Region {
                x: 3,
                y: 1,
                width: 50,
                height: 4,
            }),
            isolated: *control & 1 == 1 && !mode.takes_arrival(),
        },
        bytes_per_second: NonZeroU32::new(budget)
            .filter(|_| *control & 2 == 2 && !mode.is_transform() && !mode.takes_arrival()),
        keep_order: *key & 2 == 2 && !mode.is_transform() && !mode.has_keys() && !is_spread(mode),
    };
    let mut storage = HostStorage::new(sensor, 1 + usize::from(*capacity));
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut out = vec![0; eecvs_nostd::OUTPUT_BYTES_MIN];
    let mut accounted = 0;
    let mut decoder = HybridDecoder::default();
    let (mut arrivals, mut window) = (Arrivals::default(), vec![]);
    let mut coefficients = CoefficientDecoder::default();
    let mut frames = |encoder: &mut eecvs_nostd::Encoder<'_>| {
        while let Some(encoded) = encoder.next_frame(&mut out).expect("room for a frame") {
            let frame = Frame::parse(&out[encoded.range]).expect("a whole frame");
            let header = frame.header;
            let events = match header.mode {
                Mode::Transform => frame
                    .descriptors()
                    .map(|descriptor| descriptor.expect("the encoder's own payload").events())
                    .sum::<u32>(),
                Mode::Coefficients(coder) => {
                    let mut events = 0;
                    let found = coefficients.descriptors(&frame, coder, |descriptor| {
                        events += descriptor.events();
                    });
                    found.expect("the encoder's own payload");
                    events
                }
                Mode::Hybrid(hybrid) => {
                    let found = decoder.frame(&frame, hybrid);
                    let found = found.expect("the encoder's own payload");
                    let events = found.len() as u32;
                    if header.part == 0 {
                        window.clear();
                    }
                    window.extend(found);
                    let ordered = arrivals.frame(&frame, &mut window);
                    ordered.expect("the encoder's own order");
                    events
                }
            };
            assert_eq!(events, header.events);
            accounted += events + header.late + header.filtered + header.dropped + header.thinned;
        }
    };
    let mut t_us = 1_u64 << 33;
    let mut pushed = 0;
    for word in words.chunks_exact(4) {
        // Steps of either sign over many magnitudes.
        let step = i64::from(i16::from_le_bytes([word[0], word[1]])) << (word[3] % 16);
        t_us = t_us.saturating_add_signed(step);
        let event = Event {
            t_us,
            x: u16::from(word[2] % 80),
            y: u16::from(word[3] >> 5),
            polarity: Polarity::from_bool(word[3] & 16 != 0),
        };
        while encoder.push(event) == Push::Closed {
            frames(&mut encoder);
        }
        pushed += 1;
    }
    encoder.flush();
    frames(&mut encoder);
    assert_eq!(accounted, pushed);
}
