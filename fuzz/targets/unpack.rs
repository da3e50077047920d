//! Unpacks any payload after a valid header: it is refused or stays within the header's bounds, and what unpacks
//! packs to the same bits.

use eecvs_nostd::pack::bits_lsb_first::{BitReader, BitWriter};
use eecvs_nostd::transform::shape::PIXEL_BYTES_MAX;
use eecvs_nostd::transform::shape::Timed;
use eecvs_nostd::{Packing, Quantiser, Sensor, Transform};

/// Runs one input.
pub fn run(data: &[u8]) {
    let [
        transform,
        m,
        grid,
        step,
        width,
        height,
        events,
        payload @ ..,
    ] = data
    else {
        return;
    };
    let timed_max = *transform / 3;
    let transform = Transform::ALL[usize::from(*transform) % 3];
    let m = 1 + *m % 64;
    let mut packing = Packing {
        sensor: Sensor {
            width: 1 + u16::from(*width) * 8,
            height: 1 + u16::from(*height) * 8,
        },
        window_events: u32::from(*events) << 8,
        transform,
        m,
        grid: transform
            .grid_size(m, Some(1 + u16::from(*grid) * 4))
            .min(1024),
        quantiser: Quantiser::new((*step % 24) as i8 - 15).expect("-15 to 8"),
        timed: Timed::NONE,
    };
    let duration_us = 1 << (1 + *events % 31);
    if packing.takes_timed(timed_max, duration_us) {
        packing.timed = Timed::new(timed_max, duration_us);
    }
    let mut reader = BitReader::new(payload);
    let mut next = 0;
    let mut events_left = packing.window_events;
    let mut before = 0;
    while let Ok(descriptor) = packing.unpack(&mut next, events_left, &mut reader) {
        events_left -= descriptor.events();
        assert!(packing.sensor.contains(descriptor.x, descriptor.y));
        let mut coefficients = 0;
        descriptor.dequantise(&packing, |k, _, _| {
            assert!(k < packing.grid);
            coefficients += 1;
        });
        assert!(coefficients <= packing.kept());
        let mut bytes = [0; PIXEL_BYTES_MAX];
        let mut writer = BitWriter::new(&mut bytes);
        let mut index = before;
        packing
            .pack(&descriptor, &mut index, &mut writer)
            .expect("a pixel fits");
        assert_eq!(index, next);
        let len = writer.finish();
        let again = packing.unpack(
            &mut before,
            descriptor.events(),
            &mut BitReader::new(&bytes[..len]),
        );
        assert_eq!(again, Ok(descriptor));
    }
}
