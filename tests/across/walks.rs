//! The encoder's walks, which have a transform's stages in one piece, against the stages one by one:
//! the same frames, byte for byte.

use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::kernel::Table;
use eecvs_nostd::transform::GRID_MAX;
use eecvs_nostd::{
    Config, Encoded, Event, NoRoom, OUTPUT_BYTES_MIN, Push, Scratch, Sensor, Slot, Transform,
    Window, WindowBuffers, WindowEncoder, bitmap_words, segments,
};
use proptest::prelude::*;
use strategies::{config, events, sensor};

/// Every frame of `events`.
fn frames(
    config: Config,
    events: &[Event],
    frame_bytes: usize,
    next: impl Fn(&mut WindowEncoder<'_>, &mut Window<'_>, &mut [u8]) -> Result<Option<Encoded>, NoRoom>,
) -> Vec<Vec<u8>> {
    let Sensor { width, height } = config.window.sensor;
    let segments = segments(width, height);
    let mut slots = vec![Slot::EMPTY; 4096];
    let (mut heads, mut bitmap) = (vec![0; segments], vec![0; bitmap_words(segments)]);
    let buffers = WindowBuffers {
        slots: &mut slots,
        heads: &mut heads,
        bitmap: &mut bitmap,
    };
    let mut window = Window::new(config.window, buffers).expect("a window");
    let scratch = Scratch {
        sums: &mut [Sum::ZERO; 2 * GRID_MAX],
        totals: &mut [WideSum::ZERO; 2 * GRID_MAX],
        magnitudes: &mut [0; 2 * GRID_MAX],
        dense: None,
        tree: None,
        keys: None,
        coefficients: None,
        hot: &mut [],
        order: &mut [],
    };
    let mut encoder = WindowEncoder::new(config, scratch).expect("an encoder");
    let mut out = vec![0; frame_bytes];
    let mut all = Vec::new();
    let mut take = |window: &mut Window<'_>| {
        while let Some(frame) = next(&mut encoder, window, &mut out).expect("room") {
            all.push(out[frame.range].to_vec());
        }
    };
    for event in events {
        while window.push(*event) == Push::Closed {
            take(&mut window);
        }
    }
    window.flush();
    take(&mut window);
    all
}

/// Any grid and step, those of the walks above all.
fn job() -> impl Strategy<Value = (Config, Vec<Event>)> {
    let transform = proptest::sample::select(vec![Transform::Dct, Transform::Dtft]);
    let shape = prop_oneof![
        2 => Just((8, None)),
        1 => Just((16, None)),
        2 => (1..=32_u8, proptest::option::of(1..=40_u16)),
    ];
    let step_log2 = prop_oneof![Just(-6), Just(0), Just(-15), -15..=8_i8];
    (sensor(), transform, shape, step_log2).prop_flat_map(
        |(sensor, transform, shape, step_log2)| {
            let config = config(sensor).prop_map(move |config| Config {
                transform: Some(transform),
                m: shape.0,
                grid: shape.1,
                quantiser: eecvs_nostd::Quantiser::new(step_log2).expect("-15 to 8"),
                ..config
            });
            (config, events(sensor, 600))
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn walks_and_stages_make_the_same_frames(
        (config, events) in job(),
        frame_bytes in prop_oneof![Just(1 << 16), OUTPUT_BYTES_MIN..4 * OUTPUT_BYTES_MIN],
    ) {
        let walks = frames(config, &events, frame_bytes, |encoder, window, out| {
            encoder.next_frame(window, out)
        });
        let stages = frames(config, &events, frame_bytes, |encoder, window, out| {
            encoder.next_frame_with::<Table>(window, out)
        });
        prop_assert_eq!(walks, stages);
    }
}
