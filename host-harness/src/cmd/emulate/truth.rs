//! The truth about a recording, in an `.npz` beside it: causes of its events; objects, motion and depth of a scene.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs_cli::options::OutputOptions;
use eecvs_cli::progress::Progress;
use eecvs_nostd::Event;
use event_emulator::{Cause, SceneConfig, SceneTruth};
use event_files::output::{Kind, OutputFile, is_one_output};
use event_files::video::Fps;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

use crate::digest::{self, EventsDigest};
use crate::npy::{header, write_array};

/// Heading of the flags in the help.
const HEADING: &str = "Truth";

/// Flow and masks are nearly all repetition: the lowest level finds it.
const DEFLATE_LEVEL: i64 = 1;

/// Arrays of this size or more need ZIP's 64-bit fields.
const LARGE_BYTES: u64 = 1 << 31;

/// Values that are turned into bytes at a time.
const VALUES: usize = 1 << 13;

/// Frames per second, if no others are asked for.
const FPS: u64 = 30;

/// The flags of the truth.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = HEADING)]
pub struct TruthOptions {
    /// Arrays of the truth to write beside the recording: the cause of each event (model 2), and of a scene frames with
    /// the object, the optical flow and the depth at each pixel
    #[arg(long, value_name = "FILE.npz", requires = "output", conflicts_with_all = ["list", "print_pixel", "print_readout"])]
    truth: Option<PathBuf>,

    /// Frames per second of a scene's truth, above 0 and at most 1000000 [default: 30]
    #[arg(long, value_name = "F", requires = "truth")]
    truth_fps: Option<Fps>,
}

impl TruthOptions {
    /// Checks the output before any work is done.
    ///
    /// # Errors
    /// The file cannot be written, or is the recording or an input; a rate of frames that a video does not have.
    pub fn check<'p>(
        &self,
        recording: &Path,
        is_video: bool,
        overwrite: OutputOptions,
        inputs: impl IntoIterator<Item = &'p Path>,
    ) -> Result<()> {
        let Some(path) = &self.truth else {
            return Ok(());
        };
        let name = path.display();
        overwrite.check(path, Kind::Truth, inputs)?;
        let ending = path.extension().unwrap_or_default();
        ensure!(
            ending.eq_ignore_ascii_case("npz"),
            "{name}: the truth is written as .npz: give a name with this ending"
        );
        ensure!(
            !is_one_output(path, recording),
            "{name}: -o and --truth write the same file: give one of them another name"
        );
        ensure!(
            !is_video || self.truth_fps.is_none(),
            "{name}: the truth of a video has no frames, but the causes of its events: leave --truth-fps out"
        );
        Ok(())
    }

    /// Begins the truth of a scene.
    ///
    /// # Errors
    /// The file cannot be created; times above 2^63 us.
    pub fn of_scene(&self, config: &SceneConfig, has_causes: bool) -> Result<Option<TruthFile>> {
        let Some(path) = &self.truth else {
            return Ok(None);
        };
        ensure!(
            i64::try_from(config.start_us.saturating_add(config.duration_us)).is_ok(),
            "{}: times above 2^63 us cannot be held: give an earlier --start-us",
            path.display()
        );
        let fps = match self.truth_fps {
            Some(fps) => fps,
            None => Fps::new(FPS, 1).context("30 frames per second")?,
        };
        let frames = Frames::new(fps, config);
        let scene = (SceneTruth::new(config)?, frames);
        TruthFile::create(path, has_causes, Some(scene)).map(Some)
    }

    /// Begins the truth of a video: the causes of its events.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn of_video(&self) -> Result<Option<TruthFile>> {
        let path = self.truth.as_deref();
        path.map(|path| TruthFile::create(path, true, None))
            .transpose()
    }
}

/// The times of frames: from the scene's beginning on, to before its end.
#[derive(Debug, Clone, Copy)]
struct Frames {
    fps: Fps,
    start_us: u64,
    count: u64,
}

impl Frames {
    fn new(fps: Fps, config: &SceneConfig) -> Self {
        let is_before = |number: u64| fps.time_us(number).is_some_and(|t| t < config.duration_us);
        // Frames are 1 us apart or more, so that there are as many as microseconds at most.
        let (mut count, mut most) = (0, config.duration_us);
        while count < most {
            let middle = count + (most - count) / 2;
            match is_before(middle) {
                true => count = middle + 1,
                false => most = middle,
            }
        }
        Self {
            fps,
            start_us: config.start_us,
            count,
        }
    }

    fn times_us(self) -> impl Iterator<Item = u64> {
        let since_us = move |number| self.fps.time_us(number).unwrap_or(u64::MAX);
        (0..self.count).map(move |number| self.start_us.saturating_add(since_us(number)))
    }
}

/// A file of truth that is being written.
///
/// The number of events is known only at the end: until then their causes wait in an unnamed file beside the output. Frames
/// are computed when they are written, one at a time.
#[derive(Debug)]
pub struct TruthFile {
    out: OutputFile,
    path: PathBuf,
    causes: Option<BufWriter<File>>,
    counts: [u64; Cause::ALL.len()],
    digest: EventsDigest,
    scene: Option<(SceneTruth, Frames)>,
}

/// What a file of truth has, for the report.
#[derive(Debug, Clone)]
pub struct TruthCounts {
    pub path: PathBuf,
    /// Frames of a scene.
    pub frames: Option<u64>,
    /// Events by their causes, where these are known.
    pub causes: Option<[u64; Cause::ALL.len()]>,
}

impl TruthFile {
    fn create(path: &Path, has_causes: bool, scene: Option<(SceneTruth, Frames)>) -> Result<Self> {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let causes = has_causes.then(|| {
            tempfile::tempfile_in(folder.unwrap_or(Path::new("."))).with_context(|| {
                format!(
                    "{}: no temporary file can be created beside it",
                    path.display()
                )
            })
        });
        Ok(Self {
            causes: causes.transpose()?.map(BufWriter::new),
            out: OutputFile::create(path)?,
            path: path.to_owned(),
            counts: Default::default(),
            digest: EventsDigest::default(),
            scene,
        })
    }

    /// Returns whether causes are to be pushed.
    pub const fn has_causes(&self) -> bool {
        self.causes.is_some()
    }

    /// Appends the recording's next events, and their causes.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn push(&mut self, events: &[Event], causes: &[Cause]) -> Result<()> {
        self.digest.push(events);
        for cause in causes {
            if let Some(count) = self.counts.get_mut(*cause as usize) {
                *count += 1;
            }
        }
        let Some(file) = &mut self.causes else {
            return Ok(());
        };
        let bytes: Vec<u8> = causes.iter().map(|cause| *cause as u8).collect();
        file.write_all(&bytes).with_context(|| {
            format!(
                "{}: its temporary file cannot be written",
                self.path.display()
            )
        })
    }

    /// Writes all arrays.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn pack(&mut self) -> Result<()> {
        let failed = || format!("{}: cannot be written", self.path.display());
        let mut arrays = Arrays(zip::ZipWriter::new_stream(&mut self.out));
        let mut put = || {
            if let Some((truth, frames)) = &self.scene {
                arrays.scene(truth, *frames)?;
            }
            if let Some(causes) = &mut self.causes {
                let events = self.counts.iter().sum();
                causes.flush()?;
                let file = causes.get_mut();
                file.rewind()?;
                arrays.stream("cause", "|u1", &[events], BufReader::new(file))?;
                arrays.names("cause_names", &Cause::ALL.map(Cause::name))?;
                let digest = self.digest.finish();
                arrays.stream(digest::ARRAY, "|u1", &[digest.len() as u64], &digest[..])?;
            }
            anyhow::Ok(())
        };
        if let Err(error) = put() {
            // Dropped, it would try to end the archive, and print a second message about that.
            std::mem::forget(arrays);
            return Err(error).with_context(failed);
        }
        let out = arrays.0.finish().with_context(failed)?.into_inner();
        out.flush().with_context(failed)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// It cannot be written to the disk or renamed.
    pub fn keep(self) -> Result<TruthCounts> {
        self.out.finish()?;
        Ok(TruthCounts {
            path: self.path,
            frames: self.scene.map(|(_, frames)| frames.count),
            causes: self.causes.map(|_| self.counts),
        })
    }
}

/// An `.npz` that is being written.
struct Arrays<W: Write>(zip::ZipWriter<zip::write::StreamWriter<W>>);

impl<W: Write> Arrays<W> {
    /// Begins an array; its values follow.
    fn begin(&mut self, name: &str, dtype: &str, sides: &[u64]) -> Result<()> {
        self.entry(name, sides)?;
        Ok(self.0.write_all(&header(dtype, sides))?)
    }

    /// Writes an array of bytes that are read.
    fn stream(&mut self, name: &str, dtype: &str, sides: &[u64], values: impl Read) -> Result<()> {
        self.entry(name, sides)?;
        Ok(write_array(&mut self.0, dtype, sides, values)?)
    }

    /// Begins an entry of an array whose values have 8 bytes or fewer.
    fn entry(&mut self, name: &str, sides: &[u64]) -> Result<()> {
        let values = sides.iter().copied().fold(8, u64::saturating_mul);
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(DEFLATE_LEVEL))
            .large_file(values >= LARGE_BYTES);
        Ok(self.0.start_file(format!("{name}.npy"), options)?)
    }

    /// Writes a list of names.
    fn names(&mut self, name: &str, names: &[&str]) -> Result<()> {
        let longest = names.iter().map(|name| name.chars().count()).max();
        let longest = longest.unwrap_or(0).max(1);
        self.begin(name, &format!("<U{longest}"), &[names.len() as u64])?;
        for name in names {
            let padded = name.chars().chain(std::iter::repeat('\0')).take(longest);
            let bytes: Vec<u8> = padded.flat_map(|c| u32::from(c).to_le_bytes()).collect();
            self.0.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Appends numbers to the array that was begun.
    fn put<T, const N: usize>(
        &mut self,
        bytes: &mut Vec<u8>,
        values: &[T],
        of: impl Fn(&T) -> [u8; N],
    ) -> Result<()> {
        for values in values.chunks(VALUES) {
            bytes.clear();
            bytes.extend(values.iter().flat_map(&of));
            self.0.write_all(bytes)?;
        }
        Ok(())
    }

    /// Writes the arrays of a scene's frames, one after the other: each frame is computed for each array.
    fn scene(&mut self, truth: &SceneTruth, frames: Frames) -> Result<()> {
        let progress = Progress::new("frames of truth");
        let sensor = truth.sensor();
        let pixels = sensor.pixels() as usize;
        let sides = [frames.count, sensor.height.into(), sensor.width.into()];
        let bytes = &mut Vec::new();
        let of_float = |value: &f32| value.to_le_bytes();

        self.begin("t_us", "<i8", &[frames.count])?;
        for t_us in frames.times_us() {
            // Checked: all are below 2^63.
            self.0.write_all(&t_us.to_le_bytes())?;
        }

        self.begin("object", "|u1", &sides)?;
        let mut object = vec![0; pixels];
        for (done, t_us) in (1..).zip(frames.times_us()) {
            truth.objects_at(t_us, &mut object)?;
            self.0.write_all(&object)?;
            progress.set(done);
        }
        drop(object);
        let names: Vec<&str> = truth.objects().iter().map(|kind| kind.name()).collect();
        self.names("object_names", &names)?;

        let [count, height, width] = sides;
        self.begin("flow", "<f4", &[count, height, width, 2])?;
        let mut flow = vec![[0.0; 2]; pixels];
        for (done, t_us) in (1..).zip(frames.times_us()) {
            truth.flow_at(t_us, &mut flow)?;
            self.put(bytes, flow.as_flattened(), of_float)?;
            progress.set(done);
        }
        drop(flow);

        if truth.has_depth() {
            self.begin("depth", "<f4", &sides)?;
            let mut depth = vec![0.0; pixels];
            for (done, t_us) in (1..).zip(frames.times_us()) {
                truth.depth_at(t_us, &mut depth)?;
                self.put(bytes, &depth, of_float)?;
                progress.set(done);
            }
        }
        Ok(())
    }
}
