//! What is really seen in a scene: the object, the motion and the depth at each pixel, at any time.

#[cfg(test)]
mod tests;

use event_types::stream::Result;
use event_types::{Sensor, ensure};

use crate::SceneConfig;
use crate::light::scene::camera::Camera;
use crate::light::scene::pattern::{Pattern, Placed};

/// What kind of object is seen at a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ObjectKind {
    /// The background, which moves with the camera.
    Background,
    /// A box that may travel and turn: a person, a vehicle, a rotor.
    Box,
    /// A lamp, which flickers and stays where it is in the picture.
    Lamp,
}

impl ObjectKind {
    /// Returns the name, for example `box`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Background => "background",
            Self::Box => "box",
            Self::Lamp => "lamp",
        }
    }
}

/// The objects, the motion and the depth of a scene, in both models of the pixel: they are those of the light.
///
/// Arrays have a value for each pixel, row by row. Times are those of the events, in us, from the scene's beginning
/// ([`SceneConfig::start_us`]) on; the scene goes on after its duration. Light is that of the time itself: an event comes
/// later, by the latency of its pixel and of the readout.
///
/// Objects are boxes and lamps that multiply the light of what lies behind them: in a box, the background's texture is
/// seen, too, with the background's motion. The values are those of the object. The background's flow is the same in all
/// pixels of a row, so that it is known behind an object from a pixel beside it.
///
/// ```
/// use event_emulator::{Preset, SceneConfig, SceneTruth};
///
/// # fn main() -> Result<(), event_types::stream::Error> {
/// let truth = SceneTruth::new(&SceneConfig::model_1(Preset::OutdoorLowBrightness, 1))?;
/// let pixels = truth.sensor().pixels() as usize;
/// let (mut object, mut flow) = (vec![0; pixels], vec![[0.0; 2]; pixels]);
/// truth.objects_at(500_000, &mut object)?;
/// truth.flow_at(500_000, &mut flow)?;
/// let vehicle = object.iter().position(|object| *object == 1).expect("a vehicle");
/// // It crosses 0.9 of the picture's width of 346 pixels in a second.
/// assert!((flow[vehicle][0] - 0.9 * 346.0).abs() < 1e-3);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SceneTruth {
    sensor: Sensor,
    start_us: u64,
    camera: Camera,
    patterns: Vec<Pattern>,
}

impl SceneTruth {
    /// Makes the truth of a scene.
    ///
    /// # Errors
    /// Those of [`crate::emulate`].
    pub fn new(config: &SceneConfig) -> Result<Self> {
        config.check()?;
        let script = config.preset.script();
        Ok(Self {
            sensor: config.sensor,
            start_us: config.start_us,
            camera: script.camera,
            patterns: script.patterns,
        })
    }

    /// Returns the sensor's size.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns what the objects are, by their numbers: 0 is the background.
    #[must_use]
    pub fn objects(&self) -> Vec<ObjectKind> {
        let objects = self.patterns.iter().map(|pattern| match pattern {
            Pattern::Box { .. } => ObjectKind::Box,
            Pattern::Flicker { .. } => ObjectKind::Lamp,
        });
        std::iter::once(ObjectKind::Background)
            .chain(objects)
            .collect()
    }

    /// Returns whether the scene has a depth: its camera moves sideways, and rows move at different speeds.
    #[must_use]
    pub fn has_depth(&self) -> bool {
        self.camera.parallax != 0.0 && self.camera.moves()
    }

    /// Writes the number of the object at each pixel: 0 for the background, n for object n of [`Self::objects`].
    ///
    /// A pixel is in an object if its centre is in the object's outline, which runs through the middle of a box's soft
    /// edge of 1.5 pixels; an object thinner than a pixel may miss some. A lamp has its pixels also while it is dark. Where
    /// objects overlap, the one with the highest number counts.
    ///
    /// # Errors
    /// `object` does not have a value for each pixel; the time is before the scene's beginning.
    pub fn objects_at(&self, t_us: u64, object: &mut [u8]) -> Result<()> {
        let t = self.check(t_us, object.len())?;
        object.fill(0);
        self.paint(t, object, |number, _, _| number);
        Ok(())
    }

    /// Writes the optical flow at each pixel: the velocity in the picture, in pixels per second to the right and down, of
    /// the point that is seen at the pixel's centre.
    ///
    /// With the camera's velocity c in pixels of the background per second, and the pace k of the pixel's row, the
    /// background has
    ///
    /// ```text
    /// flow = (-k c_x, -c_y)          k = 1 + parallax ((i + 1/2) / 6 - 1/2), row in band i = 0..5 of six
    /// ```
    ///
    /// and a box with its centre at p0, velocity v and angular velocity w has, at p = (x, y),
    ///
    /// ```text
    /// flow = (v_x - w (y - p0_y), v_y + w (x - p0_x))
    /// ```
    ///
    /// Lamps have 0. It is exact to the rounding of `f32`: tests hold the light's change along the flow, in 0.1 ms, to 2 % of
    /// that in a pixel, and what an object's pixels cover after 0.2 s along its flow to a pixel. Where a point of the
    /// background goes over to another band of rows, it goes on with that one's speed.
    ///
    /// # Errors
    /// As [`Self::objects_at`].
    pub fn flow_at(&self, t_us: u64, flow: &mut [[f32; 2]]) -> Result<()> {
        let t = self.check(t_us, flow.len())?;
        let (u, v) = self.camera.velocity(t);
        self.fill_rows(flow, |pace| [(-u * pace) as f32, -v as f32]);
        let motions = self.patterns.iter();
        let motions: Vec<_> = motions.map(|p| p.motion(t, self.sensor)).collect();
        self.paint(t, flow, |number, x, y| {
            let motion = motions.get(usize::from(number) - 1);
            motion.map_or([0.0; 2], |motion| motion.at(x, y))
        });
        Ok(())
    }

    /// Writes the depth at each pixel, relative to that of the picture's middle: 1/k, with the pace k of
    /// [`Self::flow_at`]; NaN in objects, which have none.
    ///
    /// Scenes are flat, and their unit of length is a pixel. Rows that pass at different speeds are what a camera sees that
    /// moves sideways, flow = -f T / Z, so speeds give ratios of depths: the depth is in units of the depth that passes at the
    /// mean speed. A scene's vertical motion is the same in all rows, that of a camera that tilts; it says nothing of depth.
    ///
    /// # Errors
    /// As [`Self::objects_at`]; a scene without depth ([`Self::has_depth`]).
    pub fn depth_at(&self, t_us: u64, depth: &mut [f32]) -> Result<()> {
        let t = self.check(t_us, depth.len())?;
        ensure!(
            self.has_depth(),
            Refused,
            "the scene has no depth: all rows of its background move alike"
        );
        self.fill_rows(depth, |pace| (1.0 / pace) as f32);
        self.paint(t, depth, |_, _, _| f32::NAN);
        Ok(())
    }

    /// Returns the time since the scene's beginning in s.
    fn check(&self, t_us: u64, values: usize) -> Result<f64> {
        let pixels = self.sensor.pixels() as usize;
        ensure!(
            values == pixels,
            Refused,
            "an array of {values} values for {} x {} pixels: give {pixels}",
            self.sensor.width,
            self.sensor.height
        );
        let Some(since_us) = t_us.checked_sub(self.start_us) else {
            event_types::bail!(
                Refused,
                "time {t_us} us is before the scene's beginning at {} us: give a later one",
                self.start_us
            );
        };
        Ok(since_us as f64 * 1e-6)
    }

    /// Writes the background's value to each pixel, by the pace of its row.
    fn fill_rows<T: Clone>(&self, values: &mut [T], value: impl Fn(f64) -> T) {
        let rows = values.chunks_mut(usize::from(self.sensor.width));
        for (y, row) in (0..self.sensor.height).zip(rows) {
            row.fill(value(self.camera.row_speed(y, self.sensor.height)));
        }
    }

    /// Writes the value of an object's number, column and row to each pixel of the objects at `t` seconds.
    fn paint<T>(&self, t: f64, values: &mut [T], value: impl Fn(u8, u16, u16) -> T) {
        for (number, pattern) in (1..).zip(&self.patterns) {
            let placed = pattern.place(t, self.sensor);
            for (x, y) in placed.iter().flat_map(Placed::pixels) {
                let index = usize::from(y) * usize::from(self.sensor.width) + usize::from(x);
                if let Some(of_pixel) = values.get_mut(index) {
                    *of_pixel = value(number, x, y);
                }
            }
        }
    }
}
