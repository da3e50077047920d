//! Emulates a scene by model 2, and says what its pixels did: `cargo run --release --example emulate -- motorcycle`.

use event_emulator::{Cause, Model, Preset, SceneConfig, emulate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args()
        .nth(1)
        .unwrap_or("indoor-flying".to_owned());
    let preset = Preset::from_name(&name).ok_or("unknown scene")?;
    let mut emulator = emulate(SceneConfig {
        model: Model::Physical,
        ..SceneConfig::new(preset, 1)
    })?;
    let begun = std::time::Instant::now();
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    while emulator.read_with_causes(&mut events, &mut causes)? > 0 {}
    println!("{name}: {} events in {:.2?}", events.len(), begun.elapsed());
    let pixels = f64::from(preset.sensor().pixels());
    let samples = emulator.samples().unwrap_or(0) as f64 / pixels;
    println!("{samples:.0} samples of each pixel");
    for cause in Cause::ALL {
        let count = causes.iter().filter(|other| **other == cause).count();
        println!("{:10} {:.3} per pixel", cause.name(), count as f64 / pixels);
    }
    Ok(())
}
