//! A scene's light changes no faster than its bound says, and jumps at no other times than those of its switches.

use event_emulator::{Light, PRESETS, SceneLight, Tile};
use event_types::Sensor;

const SENSOR: Sensor = Sensor {
    width: 173,
    height: 130,
};

#[test]
fn no_scene_changes_faster_than_its_bound() {
    for preset in PRESETS {
        let light = SceneLight::new(preset, SENSOR, 3);
        let mut tightest = 0.0_f64;
        for i in 0..400_u64 {
            let tile = Tile {
                x: (i * 37 % 140) as u16,
                // Half of the tiles lie in the way of the small object of the night's scene.
                y: if i % 2 == 0 { 54 } else { i * 53 % 122 } as u16,
                width: 33,
                height: 8,
            };
            let from_ns = i * 7_654_321;
            let span_ns = [50_000, 700_000, 9_000_000][i as usize % 3];
            let until_ns = (from_ns + span_ns).min(light.next_switch_ns(tile, from_ns));
            let bound = light.rate_bound(tile, from_ns, until_ns);
            let mut before = vec![0.0; tile.pixels()];
            let mut after = before.clone();
            light.sample(tile, from_ns, &mut before);
            let parts = 20;
            let mut at_ns = from_ns;
            for part in 1..=parts {
                // The last sample is before the switch.
                let next_ns = from_ns + (until_ns - 1 - from_ns) * part / parts;
                light.sample(tile, next_ns, &mut after);
                let seconds = (next_ns - at_ns) as f64 * 1e-9;
                for (before, after) in before.iter().zip(&after) {
                    let change = f64::from(after - before).abs();
                    // The last bits of light in f32.
                    assert!(
                        change <= bound * seconds + 4e-6,
                        "{preset:?} {tile:?} {at_ns} to {next_ns} ns: {change}, bound {}",
                        bound * seconds
                    );
                    tightest = tightest.max((change - 4e-6) / (bound * seconds));
                }
                at_ns = next_ns;
                before.copy_from_slice(&after);
            }
        }
        // The bound is not far too high either: a scene would be sampled in vain.
        assert!(tightest > 0.2, "{preset:?}: {tightest}");
    }
}
