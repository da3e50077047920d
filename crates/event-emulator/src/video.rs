//! The events of a video, read like a recording.

use event_types::stream::{BATCH_EVENTS, EventReader, Result, Skipped, VideoReader};
use event_types::{Event, Sensor, bail, ensure};

use crate::array::PixelArray;
use crate::light::video::VideoLight;
use crate::light::video::exposure::Exposure;
use crate::light::video::motion::Motion;
use crate::noise::Cause;
use crate::parameters::PixelParameters;

/// Frames that are known at a time end when there are so many, or when they take as long.
const FRAMES_MAX: usize = 16;
const FRAMES_US: u64 = 20_000;

/// Largest distance of a frame that a tile leaves out from the line that stands for it, in largest changes between two
/// samples.
const SKIPPED: f64 = 0.04;

/// What of a video is emulated, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoConfig {
    /// What light the frames' numbers stand for.
    pub exposure: Exposure,
    /// Time of the first frame in the events, in us; `None` for its own.
    pub start_us: Option<u64>,
    /// Longest duration from the first frame on, in us; `None` for all of the video.
    pub duration_us: Option<u64>,
    /// Seed of the pixels' mismatch and noise.
    pub seed: u64,
}

/// A running emulation of a video, in model 2; its events are read through [`EventReader`].
///
/// From frame to frame, the light of a pixel is a line of ln E; the last frame is the end. Where one line through several
/// frames is, for all pixels of a tile, within 0.04 times what [`PixelParameters::sample_change`] allows, it stands for
/// theirs. Frames of 20 ms and 16 of them at most are in memory at a time, two if they are longer apart, and one that is
/// read. Events are ordered by time, then y, then x, then OFF before ON.
pub struct VideoEmulator {
    frames: Frames,
    array: PixelArray<VideoLight>,
    skipped: Skipped,
}

/// The frames of a video, as they become light.
struct Frames {
    reader: Box<dyn VideoReader>,
    config: VideoConfig,
    /// Time of the first frame in the video and in the events, in us.
    first_us: u64,
    start_us: u64,
    /// Time of the latest frame, and of the end if it is known, since the first frame.
    known_us: u64,
    end_us: Option<u64>,
    /// Memory of the next frame.
    frame: Vec<f32>,
    count: u64,
    motion: Motion,
}

/// Starts the emulation of a video: reads its first frames.
///
/// # Errors
/// The video cannot be read or has fewer than two frames; parameters that [`PixelParameters::check`] or
/// [`Exposure::check`] refuses.
pub fn emulate_video(
    mut reader: Box<dyn VideoReader>,
    config: VideoConfig,
    parameters: &PixelParameters,
) -> Result<VideoEmulator> {
    config.exposure.check()?;
    parameters.check()?;
    let mut frame = Vec::new();
    let Some(first_us) = reader.read(&mut frame)? else {
        bail!(Refused, "the video has no frames: give two or more");
    };
    config.exposure.expose(&mut frame);
    let threshold = parameters.threshold_on.min(parameters.threshold_off);
    let skipped = SKIPPED * parameters.sample_change * threshold;
    let mut light = VideoLight::new(reader.sensor(), frame, skipped as f32);
    let mut frames = Frames {
        reader,
        config,
        first_us,
        start_us: config.start_us.unwrap_or(first_us),
        known_us: 0,
        end_us: None,
        frame: Vec::new(),
        count: 1,
        motion: Motion::default(),
    };
    frames.read_ahead(&mut light)?;
    ensure!(
        frames.count > 1,
        Refused,
        "the video has one frame only: events come of the change from frame to frame; give two or more"
    );
    Ok(VideoEmulator {
        frames,
        array: PixelArray::new(light, parameters, config.seed)?,
        skipped: Skipped::default(),
    })
}

impl Frames {
    /// Reads further frames, or notes that there are none.
    fn read_ahead(&mut self, light: &mut VideoLight) -> Result<()> {
        let from_us = self.known_us;
        while light.known() < FRAMES_MAX
            && self.known_us - from_us < FRAMES_US
            && self.end_us.is_none()
        {
            self.read(light)?;
        }
        Ok(())
    }

    /// Reads a further frame, or notes that there is none.
    fn read(&mut self, light: &mut VideoLight) -> Result<()> {
        let Some(t_us) = self.reader.read(&mut self.frame)? else {
            self.end_us = Some(self.known_us);
            return Ok(());
        };
        self.known_us = since(self.first_us, t_us, self.start_us)?;
        self.config.exposure.expose(&mut self.frame);
        light.push(&mut self.frame, self.known_us * 1_000);
        let (before, after) = light.latest();
        self.motion.add(self.reader.sensor(), before, after);
        self.count += 1;
        let duration_us = self.config.duration_us;
        self.end_us = duration_us.filter(|end_us| *end_us <= self.known_us);
        Ok(())
    }
}

/// Returns the time of a frame since the first one, both in us.
fn since(first_us: u64, t_us: u64, start_us: u64) -> Result<u64> {
    let since_us = t_us.saturating_sub(first_us);
    // In nanoseconds, times have 64 bits.
    ensure!(
        since_us <= u64::MAX / 1_000 && start_us.checked_add(since_us).is_some(),
        Refused,
        "a frame at {t_us} us, the first one at {first_us} us and a start of {start_us} us: the times are beyond 2^64; \
         give an earlier start"
    );
    Ok(since_us)
}

impl VideoEmulator {
    /// Lets the threads of rayon's current pool share the work; the events are the same.
    #[must_use]
    pub fn parallel(mut self, is_parallel: bool) -> Self {
        self.array = self.array.parallel(is_parallel);
        self
    }

    /// Returns the time in us of the first frame in the events.
    #[must_use]
    pub fn start_us(&self) -> u64 {
        self.frames.start_us
    }

    /// Returns how much of the video has been emulated, in us.
    #[must_use]
    pub fn elapsed_us(&self) -> u64 {
        self.array.elapsed_us()
    }

    /// Returns the number of frames read so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames.count
    }

    /// Returns the samples of light taken so far, over all pixels.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.array.samples()
    }

    /// Returns the motion found between frames so far.
    #[must_use]
    pub fn motion(&self) -> &Motion {
        &self.frames.motion
    }

    /// Reads as [`EventReader::read`] does, and appends the cause of each event.
    ///
    /// # Errors
    /// Those of the video's reader.
    pub fn read_with_causes(
        &mut self,
        events: &mut Vec<Event>,
        causes: &mut Vec<Cause>,
    ) -> Result<usize> {
        self.read_some(events, Some(causes))
    }

    fn read_some(
        &mut self,
        events: &mut Vec<Event>,
        mut causes: Option<&mut Vec<Cause>>,
    ) -> Result<usize> {
        loop {
            let end_us = self.frames.end_us;
            let span_us = (self.frames.start_us, end_us.unwrap_or(self.frames.known_us));
            let read = self
                .array
                .read(BATCH_EVENTS, span_us, events, causes.as_deref_mut());
            if read > 0 || end_us.is_some() {
                return Ok(read);
            }
            let light = self.array.light_mut();
            light.forget();
            self.frames.read_ahead(light)?;
        }
    }
}

impl EventReader for VideoEmulator {
    fn format(&self) -> &'static str {
        self.frames.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.frames.reader.sensor()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        self.read_some(events, None)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

#[cfg(test)]
mod tests {
    use event_types::Polarity;
    use event_types::stream::Response;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 70,
        height: 9,
    };

    /// A video whose pixels are all alike, of times and ln E relative to white.
    struct Alike(Vec<(u64, f32)>, usize);

    impl VideoReader for Alike {
        fn format(&self) -> &'static str {
            "test"
        }

        fn sensor(&self) -> Sensor {
            SENSOR
        }

        fn response(&self) -> Response {
            Response::Linear
        }

        fn read(&mut self, values: &mut Vec<f32>) -> Result<Option<u64>> {
            let frame = self.0.get(self.1).copied();
            self.1 += 1;
            values.clear();
            values.resize(SENSOR.pixels() as usize, 0.0);
            values.fill(frame.map_or(0.0, |(_, ln)| ln.exp()));
            Ok(frame.map(|(t_us, _)| t_us))
        }
    }

    const CONFIG: VideoConfig = VideoConfig {
        exposure: Exposure {
            response: Response::Linear,
            white_lux: 300.0,
            flare: 1e-5,
        },
        start_us: None,
        duration_us: None,
        seed: 3,
    };

    fn emulator(frames: &[(u64, f32)], config: VideoConfig) -> Result<VideoEmulator> {
        let reader = Box::new(Alike(frames.to_vec(), 0));
        let mut ideal = PixelParameters::ideal();
        ideal.set("threshold_on", 0.25)?;
        ideal.set("threshold_off", 0.5)?;
        emulate_video(reader, config, &ideal)
    }

    fn events(frames: &[(u64, f32)], config: VideoConfig) -> Vec<Event> {
        let mut emulator = emulator(frames, config).unwrap();
        let mut events = Vec::new();
        while emulator.read(&mut events).unwrap() > 0 {}
        events
    }

    /// A rise of 2.6 in 100 ms, then a fall of 2.6 in 200 ms.
    const RISE_AND_FALL: [(u64, f32); 3] = [(7_000, -3.0), (107_000, -0.4), (307_000, -3.0)];

    #[test]
    fn crossings_between_frames_are_at_the_times_of_the_line() {
        let events = events(&RISE_AND_FALL, CONFIG);
        let of_pixel = |x, y| {
            events
                .iter()
                .filter(move |event| (event.x, event.y) == (x, y))
        };
        for (x, y) in [(0, 0), (69, 8), (33, 4)] {
            let on: Vec<f64> = of_pixel(x, y)
                .filter(|event| event.polarity == Polarity::On)
                .map(|event| event.t_us as f64)
                .collect();
            // The reference is at random at first; from event to event it is a threshold: 0.25 at 26 per second.
            assert!((9..=11).contains(&on.len()), "{on:?}");
            for pair in on.windows(2) {
                assert!((pair[1] - pair[0] - 9_615.4).abs() < 2.0, "{on:?}");
            }
            let off: Vec<f64> = of_pixel(x, y)
                .filter(|event| event.polarity == Polarity::Off)
                .map(|event| event.t_us as f64)
                .collect();
            assert!((4..=5).contains(&off.len()), "{off:?}");
            for pair in off.windows(2) {
                // Flare takes 2e-4 off the range of 2.6.
                assert!((pair[1] - pair[0] - 38_461.5).abs() < 4.0, "{off:?}");
            }
            // Down from the last ON event by 0.5: the time to the top, and twice as long back, and the threshold's.
            let last = on.last().unwrap();
            let back = 107_000.0 + 2.0 * (107_000.0 - last) + 38_461.5;
            assert!((off[0] - back).abs() < 15.0, "{on:?} {off:?}");
        }
    }

    #[test]
    fn frames_on_the_line_change_nothing() {
        let more: Vec<(u64, f32)> = (0..=300_u64)
            .map(|i| {
                let t_us = 7_000 + 1_000 * i;
                let rise = i.min(100) as f32 * 0.026;
                let fall = i.saturating_sub(100) as f32 * 0.013;
                (t_us, -3.0 + rise - fall)
            })
            .collect();
        let (few, many) = (events(&RISE_AND_FALL, CONFIG), events(&more, CONFIG));
        assert_eq!(few.len(), many.len());
        let place = |event: &Event| (event.x, event.y, event.t_us);
        let (mut a, mut b): (Vec<_>, Vec<_>) = (
            few.iter().map(place).collect(),
            many.iter().map(place).collect(),
        );
        a.sort_unstable();
        b.sort_unstable();
        for (a, b) in a.iter().zip(&b) {
            assert_eq!((a.0, a.1), (b.0, b.1));
            assert!(a.2.abs_diff(b.2) <= 10, "{a:?} {b:?}");
        }
    }

    /// Light of 3 Hz with a ripple of 40 Hz, in a frame each millisecond: a smaller `sample_change` leaves out none.
    #[test]
    fn frames_that_are_left_out_hardly_change_events() {
        let ripple = |i: u64| {
            let cycles = i as f32 * core::f32::consts::TAU * 1e-3;
            (
                1_000 * i,
                0.5 * (3.0 * cycles).sin() + 0.02 * (40.0 * cycles).sin() - 2.0,
            )
        };
        let frames: Vec<(u64, f32)> = (0..=1_000).map(ripple).collect();
        let run = |sample_change: f64| {
            let reader = Box::new(Alike(frames.clone(), 0));
            let mut ideal = PixelParameters::ideal();
            ideal.set("sample_change", sample_change).unwrap();
            let mut emulator = emulate_video(reader, CONFIG, &ideal).unwrap();
            let mut events = Vec::new();
            while emulator.read(&mut events).unwrap() > 0 {}
            events.sort_unstable_by_key(|event| (event.y, event.x, event.t_us));
            (events, emulator.samples())
        };
        let ((all, samples), (some, fewer)) = (run(0.01), run(1.0));
        assert!(fewer * 2 < samples, "{fewer} of {samples}");
        // 0.04 of a threshold, half of the ripple, may be missing where the light turns.
        let share = some.len() as f64 / all.len() as f64;
        assert!((0.98..=1.0).contains(&share), "{share}");
        let same_pixel = |a: &Event, b: &Event| (a.x, a.y) == (b.x, b.y);
        let pixels = (all.chunk_by(same_pixel)).zip(some.chunk_by(same_pixel));
        let mut differences_us: Vec<u64> = pixels
            .filter(|(a, b)| a.len() == b.len())
            .flat_map(|(a, b)| a.iter().zip(b))
            .map(|(a, b)| a.t_us.abs_diff(b.t_us))
            .collect();
        assert!(differences_us.len() * 2 > all.len());
        differences_us.sort_unstable();
        let most = differences_us.len() * 9 / 10;
        // At the steepest, light takes 0.7 ms for 0.04 of a threshold.
        assert!(differences_us[most] <= 1_100, "{}", differences_us[most]);
    }

    #[test]
    fn threads_change_nothing_and_times_are_as_asked_for() {
        let all = events(&RISE_AND_FALL, CONFIG);
        assert!(
            all.iter()
                .all(|event| (7_000..307_000).contains(&event.t_us))
        );
        let mut parallel = emulator(&RISE_AND_FALL, CONFIG).unwrap().parallel(true);
        let (mut other, mut causes) = (Vec::new(), Vec::new());
        while parallel.read_with_causes(&mut other, &mut causes).unwrap() > 0 {}
        assert_eq!(all, other);
        assert_eq!(causes.len(), all.len());
        assert!(causes.iter().all(|cause| *cause == Cause::Signal));
        assert_eq!((parallel.frames(), parallel.elapsed_us()), (3, 300_000));
        let config = VideoConfig {
            start_us: Some(0),
            duration_us: Some(150_000),
            ..CONFIG
        };
        let part = events(&RISE_AND_FALL, config);
        let until = all.partition_point(|event| event.t_us < 157_000);
        let shifted: Vec<Event> = all[..until]
            .iter()
            .map(|event| Event {
                t_us: event.t_us - 7_000,
                ..*event
            })
            .collect();
        assert_eq!(part, shifted);
    }

    #[test]
    fn what_cannot_be_emulated_is_refused() {
        let refused = |frames: &[(u64, f32)], config| {
            let refused = emulator(frames, config).err().expect("an error");
            refused.to_string()
        };
        assert!(refused(&[], CONFIG).contains("no frames"));
        assert!(refused(&[(1, 0.0)], CONFIG).contains("one frame only"));
        let late = [(0, 0.0), (u64::MAX, 0.0)];
        assert!(refused(&late, CONFIG).contains("earlier start"));
        let config = VideoConfig {
            start_us: Some(u64::MAX),
            ..CONFIG
        };
        assert!(refused(&RISE_AND_FALL, config).contains("earlier start"));
        let mut dark = CONFIG;
        dark.exposure.flare = 0.0;
        assert!(refused(&RISE_AND_FALL, dark).contains("flare is 0"));
    }
}
