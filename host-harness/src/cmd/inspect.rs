//! `eecvs inspect`: prints one row per frame.

use std::io::{Write, stdout};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use eecvs::frame_file::{FrameReader, Located};
use eecvs::reconstruct::coefficients::CoefficientDecoder;
use eecvs::reconstruct::same_window;
use eecvs::reconstruct::ways::{Way, Ways};
use eecvs_cli::options::tell_link;
use eecvs_nostd::{Fidelity, Header, Mode};
use event_files::input::piped::{name_of, open_bytes};
use serde::Serialize;

/// Print one row per frame of a file
#[derive(Debug, Args)]
pub struct Inspect {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Print a JSON array of objects instead of the table
    #[arg(long)]
    json: bool,
}

/// One frame; the fields are the JSON keys.
#[derive(Debug, Serialize)]
struct Row {
    index: u64,
    seq: u32,
    window: u64,
    part: u32,
    t0_us: u64,
    duration_us: u32,
    window_events: u32,
    events: u32,
    /// Number of pixels, for a transform frame; other frames have it only in their payload.
    pixels: Option<u32>,
    mode: &'static str,
    coder: Option<&'static str>,
    time_tolerance_us: Option<u32>,
    bins: Option<u16>,
    /// What the frame encodes of the window's events.
    fidelity: String,
    /// Period of the readout, if times are coded by scans.
    scan_period_us: Option<f64>,
    /// Bytes of the order of events of equal time, if it is coded.
    order_bytes: Option<u32>,
    /// Whether the frame decodes without earlier frames.
    key: bool,
    density_per_px_s: f64,
    regime: &'static str,
    transform: &'static str,
    m: u8,
    grid: u16,
    step: f64,
    /// Largest number of events of pixels that are sent as times; 0 if none is.
    few: u8,
    /// Pixels and bits by the way in which they are sent, in a transform frame that decodes.
    ways: Option<Ways>,
    /// Bytes that the frame takes in the file.
    bytes: usize,
    /// Bytes of the frame itself: more, if it is short in the file.
    frame_bytes: usize,
    late: u32,
    filtered: u32,
    dropped: u32,
    thinned: u32,
    saturated: u32,
    truncated: bool,
    /// Whether the clock fell back before this window.
    begins_run: bool,
}

impl Inspect {
    /// Prints one row per frame, in a file with frames of several sensors too.
    ///
    /// # Errors
    /// Fails if the file cannot be read or holds no frame. If frames are damaged or missing, fails after printing
    /// all the others.
    pub fn run(self) -> Result<()> {
        let name = name_of(&self.input);
        let mut reader = FrameReader::new(open_bytes(&self.input)?).of_all_sensors();
        let mut out = stdout().lock();
        let mut index = 0;
        let mut windows = 0;
        let mut open = None;
        // And the number of frames that do not decode.
        let mut total: Option<(Ways, u64)> = None;
        let mut decoder = CoefficientDecoder::default();
        while let Some(located) = reader
            .next_frame()
            .with_context(|| format!("{name}: cannot read"))?
        {
            // Windows are numbered as in decoding, so that `decode --window` accepts these numbers. The first frame
            // of a window may be lost.
            let header = located.frame.header;
            let goes_on = open.is_some_and(|earlier| same_window(&earlier, &header));
            windows += u64::from(header.events > 0 && !goes_on);
            open = (header.events > 0 && !header.last).then_some(header);
            // `decode` says why a frame does not decode. Frames of a dense coder need those before them.
            let ways = Ways::of(&located.frame, &mut decoder).ok().flatten();
            if header.mode.is_transform() {
                let (total, without) = total.get_or_insert_default();
                match &ways {
                    Some(ways) => total.add(ways),
                    None => *without += 1,
                }
            }
            let row = Row::new(index, windows.max(1) - 1, &located, ways);
            if self.json {
                // The bracket waits for the first frame, so that a file without frames leaves stdout empty.
                let before = if index == 0 { '[' } else { ',' };
                write!(out, "{before}\n{}", serde_json::to_string(&row)?).context("stdout")?;
            } else {
                if index == 0 {
                    Row::print_titles(&mut out).context("stdout")?;
                }
                row.print(&mut out).context("stdout")?;
            }
            index += 1;
        }
        if index == 0 {
            bail!("{name}: {}", reader.report().why_empty());
        }
        if self.json {
            writeln!(out, "\n]").context("stdout")?;
        } else if let Some((total, without)) = total {
            print_ways(&mut out, &total, without).context("stdout")?;
        }
        out.flush().context("stdout")?;
        tell_link(&name, reader.report())
    }
}

impl Row {
    fn new(index: u64, window: u64, located: &Located<'_>, ways: Option<Ways>) -> Self {
        let header = &located.frame.header;
        let density = eecvs_nostd::Density {
            events: header.window_events,
            pixels: header.sensor.pixels(),
            duration_us: header.duration_us,
        };
        let (mut coder, mut time_tolerance_us, mut bins) = (None, None, None);
        if let Mode::Hybrid(hybrid) = header.mode {
            coder = Some(hybrid.coder.name());
            time_tolerance_us = hybrid.fidelity.within_us();
            if let Fidelity::Bins(count) = hybrid.fidelity {
                bins = Some(count);
            }
        }
        if let Mode::Coefficients(by) = header.mode {
            coder = Some(by.name());
        }
        let is_transform = header.mode.is_transform();
        Self {
            index,
            seq: header.sequence,
            window,
            part: header.part,
            t0_us: header.t0_us,
            duration_us: header.duration_us,
            window_events: header.window_events,
            events: header.events,
            pixels: is_transform.then_some(header.pixels),
            mode: if is_transform { "transform" } else { "hybrid" },
            coder,
            time_tolerance_us,
            bins,
            fidelity: fidelity(header),
            scan_period_us: header
                .scans
                .map(|scans| f64::from(scans.readout().period_q16()) / 65_536.0),
            order_bytes: header.order.map(|order| order.bytes),
            key: header.is_key,
            density_per_px_s: density.per_pixel_s(),
            regime: header.regime.name(),
            transform: header.transform.name(),
            m: header.m,
            grid: header.grid,
            step: f64::from(header.quantiser.step_log2()).exp2(),
            few: header.timed_max,
            ways,
            bytes: located.stored,
            frame_bytes: located.frame.bytes,
            late: header.late,
            filtered: header.filtered,
            dropped: header.dropped,
            thinned: header.thinned,
            saturated: header.saturated,
            truncated: header.truncated,
            begins_run: header.begins_run,
        }
    }

    fn print_titles(out: &mut impl Write) -> std::io::Result<()> {
        writeln!(
            out,
            "{:>6} {:>6} {:>17} {:>9} {:>8} {:>8} {:>15} {:>8} {:4} {:>3} {:>4} {:>9} {:>8} {:>5} {:>5} {:>5} {:>6}",
            "index",
            "seq",
            "t0_us",
            "dur_us",
            "events",
            "coder",
            "fidelity",
            "regime",
            "tr",
            "m",
            "grid",
            "step",
            "bytes",
            "late",
            "filt",
            "drop",
            "order"
        )
    }

    fn print(&self, out: &mut impl Write) -> std::io::Result<()> {
        let Self {
            index,
            seq,
            t0_us,
            duration_us,
            events,
            coder,
            fidelity,
            regime,
            transform,
            m,
            grid,
            step,
            bytes,
            late,
            filtered,
            dropped,
            order_bytes,
            ..
        } = self;
        // In bytes; blank if the order is not coded.
        let order = order_bytes.map_or(String::new(), |bytes| bytes.to_string());
        let coder = coder.unwrap_or("");
        writeln!(
            out,
            "{index:>6} {seq:>6} {t0_us:>17} {duration_us:>9} {events:>8} {coder:>8} \
             {fidelity:>15} {regime:>8} {transform:4} {m:>3} {grid:>4} {step:>9} {bytes:>8} {late:>5} {filtered:>5} {dropped:>5} {order:>6}"
        )
    }
}

/// Prints how the pixels of all frames were sent, and what that took.
fn print_ways(out: &mut impl Write, ways: &Ways, without: u64) -> std::io::Result<()> {
    let named = [
        ("single events", ways.single),
        ("few events as times", ways.times),
        ("coefficients", ways.coefficients),
    ];
    writeln!(out)?;
    for (name, Way { pixels, bits }) in named {
        writeln!(out, "{name:>20} {pixels:>10} pixels {bits:>12.0} bits")?;
    }
    if without > 0 {
        writeln!(out, "and {without} frames that do not decode")?;
    }
    Ok(())
}

/// Describes what a frame encodes of the events of its window.
fn fidelity(header: &Header) -> String {
    let told = match header.mode {
        Mode::Transform | Mode::Coefficients(_) => "coefficients".to_owned(),
        Mode::Hybrid(hybrid) => match hybrid.fidelity {
            Fidelity::Lossless => "exact".to_owned(),
            Fidelity::ToleranceUs(tolerance_us) => format!("within {tolerance_us} us"),
            Fidelity::SpreadUs(width_us) => format!("spread over {width_us} us"),
            Fidelity::Bins(1) => "1 bin".to_owned(),
            Fidelity::Bins(count) => format!("{count} bins"),
        },
    };
    // The rate control left out some events of the window.
    let thinned = if header.thinned > 0 { ", thinned" } else { "" };
    told + thinned
}
