//! Says what is seen in a scene, and how it moves: `cargo run --release --example truth -- motorcycle 500000`.

use event_emulator::{Preset, SceneConfig, SceneTruth};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let name = words.next().unwrap_or("motorcycle".to_owned());
    let t_us = words.next().unwrap_or("500000".to_owned()).parse()?;
    let preset = Preset::from_name(&name).ok_or("unknown scene")?;
    let truth = SceneTruth::new(&SceneConfig::model_1(preset, 1))?;
    let pixels = truth.sensor().pixels() as usize;
    let (mut object, mut flow) = (vec![0; pixels], vec![[0.0; 2]; pixels]);
    truth.objects_at(t_us, &mut object)?;
    truth.flow_at(t_us, &mut flow)?;
    println!("{name} after {t_us} us:");
    for (number, kind) in (0_u8..).zip(truth.objects()) {
        let seen = object.iter().zip(&flow);
        let speeds: Vec<f32> = seen
            .filter(|(object, _)| **object == number)
            .map(|(_, [x, y])| x.hypot(*y))
            .collect();
        let (least, most) = speeds.iter().fold((f32::MAX, 0.0_f32), |(least, most), v| {
            (least.min(*v), most.max(*v))
        });
        match speeds.len() {
            0 => println!("{number} {:10} out of sight", kind.name()),
            count => println!(
                "{number} {:10} {count} pixels, {least:.1} to {most:.1} pixels per second",
                kind.name()
            ),
        }
    }
    Ok(())
}
