use event_types::Sensor;

use super::*;
use crate::light::scene::texture::Texture;
use crate::random::Random;
use crate::{Light, Model, PRESETS, Preset, SceneLight, Tile};

const SENSOR: Sensor = Sensor {
    width: 173,
    height: 130,
};

const PIXELS: usize = 173 * 130;

/// A beginning other than 0, which no value may depend on.
const START_US: u64 = 7_000;

fn config(preset: Preset) -> SceneConfig {
    SceneConfig {
        sensor: SENSOR,
        start_us: START_US,
        ..SceneConfig::model_1(preset, 3)
    }
}

fn truth(preset: Preset) -> SceneTruth {
    SceneTruth::new(&config(preset)).unwrap()
}

fn objects(truth: &SceneTruth, since_us: u64) -> Vec<u8> {
    let mut object = vec![9; PIXELS];
    truth.objects_at(START_US + since_us, &mut object).unwrap();
    object
}

fn flow(truth: &SceneTruth, since_us: u64) -> Vec<[f32; 2]> {
    let mut flow = vec![[f32::NAN; 2]; PIXELS];
    truth.flow_at(START_US + since_us, &mut flow).unwrap();
    flow
}

fn place(index: usize) -> (f64, f64) {
    let width = usize::from(SENSOR.width);
    ((index % width) as f64, (index / width) as f64)
}

/// The scene's light at all pixels.
fn light(preset: Preset, since_us: u64) -> Vec<f32> {
    let all = Tile {
        x: 0,
        y: 0,
        width: SENSOR.width,
        height: SENSOR.height,
    };
    let mut light = vec![0.0; PIXELS];
    SceneLight::new(preset, SENSOR, 3).sample(all, since_us * 1_000, &mut light);
    light
}

/// The scene without its objects, between pixels, too.
struct Background {
    texture: Texture,
    camera: Camera,
}

impl Background {
    fn new(preset: Preset) -> Self {
        let script = preset.script();
        let mut texture = Texture::new(&script.look, &mut Random::new(3, 1));
        texture.brighten(300.0_f32.ln());
        Self {
            texture,
            camera: script.camera,
        }
    }

    /// Returns the light at (x, y) as the band of `row` has it.
    fn light(&self, (x, y): (f64, f64), row: f64, t: f64) -> f32 {
        let (u, v) = self.camera.offset(t);
        let mut light = [0.0];
        let pace = self.camera.row_speed(row as u16, SENSOR.height);
        self.texture.sample(u * pace + x, v + y, &mut light);
        light[0]
    }
}

#[test]
fn the_background_s_light_goes_with_its_flow() {
    const DT: f64 = 1e-4;
    for preset in PRESETS {
        let (truth, background) = (truth(preset), Background::new(preset));
        let (mut along, mut change) = (0.0, 0.0);
        for since_us in [0, 313_000, 740_000] {
            let (object, flow) = (objects(&truth, since_us), flow(&truth, since_us));
            let (light, t) = (light(preset, since_us), since_us as f64 * 1e-6);
            for index in (0..PIXELS).step_by(7).filter(|index| object[*index] == 0) {
                let (x, y) = place(index);
                let [vx, vy] = flow[index].map(f64::from);
                let here = background.light((x, y), y, t);
                let later = |way: (f64, f64)| background.light((x + way.0, y + way.1), y, t + DT);
                along += f64::from(later((vx * DT, vy * DT)) - here).abs();
                change += f64::from(later((0.0, 0.0)) - here).abs();
                // It is the light that pixels get, but for what a box's soft edge adds outside of its outline.
                let of_pixel = light[index];
                let is_other = (of_pixel - here).abs() > 1e-3;
                assert!(!is_other || near(&object, index), "{preset:?}: {x} {y}");
            }
        }
        let moves = preset.script().camera.moves();
        assert_eq!(change > 0.0, moves, "{preset:?}");
        // Of the changes in a pixel, what is left is the curvature of the way and the rounding of the light.
        assert!(along <= 0.02 * change, "{preset:?}: {along} of {change}");
    }
}

/// Returns whether a pixel has an object within two pixels, or may have one that is just out of sight.
fn near(object: &[u8], index: usize) -> bool {
    let width = usize::from(SENSOR.width);
    if !(2..width - 2).contains(&(index % width)) {
        return true;
    }
    let around = (-2..=2).flat_map(|dy: isize| (-2..=2).map(move |dx: isize| (dx, dy)));
    around
        .filter_map(|(dx, dy)| index.checked_add_signed(dy * width as isize + dx))
        .any(|index| object.get(index).is_some_and(|object| *object > 0))
}

#[test]
fn objects_are_where_their_light_is() {
    let mut boxes = 0;
    for preset in PRESETS {
        let (truth, background) = (truth(preset), Background::new(preset));
        let patterns = preset.script().patterns;
        let kinds = truth.objects();
        assert_eq!(kinds.len(), patterns.len() + 1);
        for since_us in [120_000, 613_000, 999_000] {
            let (object, light) = (objects(&truth, since_us), light(preset, since_us));
            if patterns.is_empty() {
                assert!(object.iter().all(|object| *object == 0), "{preset:?}");
            }
            let (mut seen, mut area) = (0, 0.0);
            for (index, number) in object.iter().enumerate() {
                let (x, y) = place(index);
                let adds = light[index] - background.light((x, y), y, since_us as f64 * 1e-6);
                match kinds[usize::from(*number)] {
                    ObjectKind::Background => assert!(adds.abs() < 1.2, "{preset:?}: {adds}"),
                    ObjectKind::Lamp => {}
                    ObjectKind::Box => {
                        let Pattern::Box { gain, .. } = patterns[usize::from(*number) - 1] else {
                            unreachable!();
                        };
                        // Half of it at a side, a quarter at a corner.
                        let share = adds / gain;
                        assert!((0.24..1.01).contains(&share), "{preset:?}: {share}");
                        seen += 1;
                        area += share;
                    }
                }
            }
            if seen > 60 {
                boxes += 1;
                // What the soft edge gives outside, it takes inside.
                let share = area / seen as f32;
                assert!((0.75..1.0).contains(&share), "{preset:?}: {share}");
            }
        }
    }
    assert!(boxes > 8, "{boxes}");
}

/// The flow of an object at one moment: that of a rigid body.
struct Rigid {
    at: (f64, f64),
    velocity: [f64; 2],
    spin: f64,
}

impl Rigid {
    /// Reads the flow of an object at two of its pixels; `None` if it is out of sight.
    fn of(truth: &SceneTruth, number: u8, since_us: u64) -> Option<Self> {
        let (object, flow) = (objects(truth, since_us), flow(truth, since_us));
        let first = object.iter().position(|object| *object == number)?;
        let last = object.iter().rposition(|object| *object == number)?;
        let ((x, y), (far_x, far_y)) = (place(first), place(last));
        let (dx, dy) = (far_x - x, far_y - y);
        let [velocity, far] = [first, last].map(|index| flow[index].map(f64::from));
        let turn = (far[1] - velocity[1]) * dx - (far[0] - velocity[0]) * dy;
        Some(Self {
            at: (x, y),
            velocity,
            spin: turn / (dx * dx + dy * dy).max(1.0),
        })
    }

    fn speed(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (dx, dy) = (x - self.at.0, y - self.at.1);
        (
            self.velocity[0] - self.spin * dy,
            self.velocity[1] + self.spin * dx,
        )
    }
}

#[test]
fn pixels_of_objects_go_with_their_flow() {
    const STEP_US: u64 = 2_000;
    const STEPS: u64 = 100;
    const DT: f64 = 1e-6 * STEP_US as f64;
    let width = usize::from(SENSOR.width);
    let (mut boxes, mut lamps) = (0, 0);
    for (preset, first_us) in PRESETS.into_iter().flat_map(|preset| {
        let times = [50_000, 300_000, 550_000];
        times.map(|first_us| (preset, first_us))
    }) {
        let truth = truth(preset);
        let before = objects(&truth, first_us);
        let after = objects(&truth, first_us + STEPS * STEP_US);
        for (number, kind) in (0..).zip(truth.objects()).skip(1) {
            // In the middle of each step.
            let steps = 0..STEPS;
            let steps: Option<Vec<Rigid>> = steps
                .map(|step| Rigid::of(&truth, number, first_us + step * STEP_US + STEP_US / 2))
                .collect();
            let Some(steps) = steps else {
                continue;
            };
            for start in 0..PIXELS {
                let around = [Some(start), start.checked_sub(width), start.checked_sub(1)];
                let around = around
                    .into_iter()
                    .chain([Some(start + 1), Some(start + width)]);
                let mut around = around.map(|index| before.get(index?));
                if !around.all(|object| object == Some(&number)) {
                    continue;
                }
                let mut way = place(start);
                for step in &steps {
                    let speed = step.speed(way);
                    let middle = (way.0 + 0.5 * DT * speed.0, way.1 + 0.5 * DT * speed.1);
                    let speed = step.speed(middle);
                    way = (way.0 + DT * speed.0, way.1 + DT * speed.1);
                }
                let (x, y) = (way.0.round(), way.1.round());
                if !(0.0..f64::from(SENSOR.width)).contains(&x)
                    || !(0.0..f64::from(SENSOR.height)).contains(&y)
                {
                    continue;
                }
                let end = y as usize * width + x as usize;
                // Objects with higher numbers are in front.
                assert!(
                    after[end] >= number,
                    "{preset:?}: {kind:?} {number} from {:?} at {first_us} us to {way:?}",
                    place(start)
                );
                boxes += usize::from(kind == ObjectKind::Box);
                lamps += usize::from(kind == ObjectKind::Lamp);
            }
        }
    }
    assert!(boxes > 2_500 && lamps > 250, "{boxes} {lamps}");
}

#[test]
fn depth_is_the_inverse_of_the_speed() {
    let mut depths = 0;
    for preset in PRESETS {
        let truth = truth(preset);
        let mut depth = vec![0.0; PIXELS];
        let said = truth.depth_at(START_US + 200_000, &mut depth);
        assert_eq!(said.is_ok(), truth.has_depth(), "{preset:?}");
        let Ok(()) = said else {
            let text = said.unwrap_err().to_string();
            assert!(text.contains("no depth"), "{text}");
            continue;
        };
        depths += 1;
        let (object, flow) = (objects(&truth, 200_000), flow(&truth, 200_000));
        let (u, _) = preset.script().camera.velocity(0.2);
        for index in 0..PIXELS {
            assert_eq!(depth[index].is_nan(), object[index] > 0);
            if object[index] == 0 {
                let product = f64::from(flow[index][0] * depth[index]);
                assert!((product + u).abs() <= 1e-5 * u.abs(), "{product} {u}");
            }
        }
        // What is below is nearer.
        assert!(depth[0] > 1.0 && depth[PIXELS - 1] < 1.0);
    }
    assert_eq!(depths, 6);
}

#[test]
fn models_and_seeds_do_not_change_the_truth_and_mistakes_are_refused() {
    let scene = config(Preset::Motorcycle);
    let other = SceneConfig {
        model: Model::Physical,
        seed: 4,
        start_us: 0,
        ..scene
    };
    let other = SceneTruth::new(&other).unwrap();
    let truth = truth(Preset::Motorcycle);
    let mut object = vec![0; PIXELS];
    other.objects_at(300_000, &mut object).unwrap();
    assert_eq!(object, objects(&truth, 300_000));
    assert!(object.contains(&1) && object.contains(&2));
    let said = |result: Result<()>| result.unwrap_err().to_string();
    let early = said(truth.objects_at(START_US - 1, &mut object));
    assert!(early.contains("before the scene's beginning"), "{early}");
    let short = said(truth.flow_at(START_US, &mut [[0.0; 2]; 10]));
    assert!(short.contains("10 values for 173 x 130 pixels"), "{short}");
    // The latest time there is.
    truth.objects_at(u64::MAX, &mut object).unwrap();
    let mut flow = vec![[0.0; 2]; PIXELS];
    truth.flow_at(u64::MAX, &mut flow).unwrap();
    assert!(flow.iter().flatten().all(|speed| speed.is_finite()));
    let mut wrong = scene;
    wrong.sensor.width = 0;
    assert!(SceneTruth::new(&wrong).is_err());
}
