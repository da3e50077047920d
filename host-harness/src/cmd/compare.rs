//! `eecvs compare`: measures the distortion between two recordings.

use std::io::Read;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use eecvs_cli::memory::look_for;
use eecvs_cli::options::ReadingOptions;
use eecvs_cli::output::{print, print_json};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;
use event_emulator::Cause;
use event_files::Reading;
use event_files::content::Rereadable;
use event_files::numpy::byte_list::ByteList;
use event_files::output::is_dash;
use event_metrics::denoising::{Denoising, denoising};
use event_metrics::{Comparison, clock};
use serde::Serialize;

use crate::digest::{self, Digested, EventsDigest};

/// Compare recording B with recording A: frames, event times and events
///
/// The windows are cut from recording A: half-open, consecutive, aligned to its first event. The exit status is 0
/// however much the recordings differ: events that B lacks (missing) or has in addition (surplus) are counted.
#[derive(Debug, Clone, clap::Args)]
pub struct Compare {
    /// The original recording
    a: PathBuf,
    /// The recording to judge, e.g. the decoded one
    b: PathBuf,
    /// Window length in microseconds
    #[arg(long, value_name = "T", default_value_t = 32_768,
          value_parser = clap::value_parser!(u64).range(1..))]
    window_us: u64,
    /// Align the clocks first if they differ by a constant
    #[arg(long)]
    align: bool,
    /// Truth of recording A, as eecvs emulate --truth writes it: also say what B, as a filter left it, has of A's signal
    /// and noise
    #[arg(long, value_name = "FILE.npz")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    reading: ReadingOptions,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Compare {
    /// Compares and prints the result on stdout.
    ///
    /// # Errors
    /// Fails if a recording or the truth cannot be read, or for the reasons given at [`event_metrics::compare`] and
    /// [`denoising`].
    pub fn run(self) -> Result<()> {
        let reading = self.reading.reading();
        ensure!(
            !(is_dash(&self.a) && is_dash(&self.b)),
            "stdin is one recording: name a file for the other"
        );
        let (a, b) = (Rereadable::of(&self.a)?, Rereadable::of(&self.b)?);
        // Clocks are only shifted to later times, since no time is below 0.
        let open = |recording: &Rereadable, later_us: i64| {
            let time_offset_us = reading.time_offset_us.saturating_add(later_us.max(0));
            let reading = Reading {
                time_offset_us,
                ..reading.clone()
            };
            recording.open(reading)
        };
        let truth = self.truth.map(Truth::open).transpose()?;
        for recording in [&a, &b] {
            look_for(open(recording, 0)?.sensor(), recording.name())?;
        }
        let context = || format!("{} against {}", a.name(), b.name());
        let offset_us =
            clock::offset_us(&mut *open(&a, 0)?, &mut *open(&b, 0)?).with_context(context)?;
        let ahead_us = if self.align {
            offset_us.unwrap_or(0)
        } else {
            0
        };
        let progress = Progress::new("events");
        let comparison = event_metrics::compare(
            &|| open(&a, ahead_us),
            &|| open(&b, ahead_us.saturating_neg()),
            self.window_us,
            &mut |events| progress.set(events),
        );
        drop(progress);
        let comparison = comparison.with_context(context)?;
        let denoising = match truth {
            Some(mut truth) => {
                let progress = Progress::new("events");
                let mut recording = Digested::new(open(&a, ahead_us)?);
                let denoising = denoising(
                    &mut recording,
                    &mut truth.causes,
                    &mut *open(&b, ahead_us.saturating_neg())?,
                    &mut |events| progress.set(events),
                );
                let denoising = denoising
                    .with_context(|| format!("{}: {}", truth.path.display(), context()))?;
                truth.check(&denoising, &recording.digest, a.name())?;
                Some(denoising)
            }
            None => None,
        };
        match offset_us {
            Some(offset_us) if offset_us != 0 && !self.align => say!(
                "eecvs: the clock of {} is {offset_us} us ahead of that of {}: --align removes \
                 this offset",
                b.name(),
                a.name()
            ),
            None if self.align => {
                say!(
                    "eecvs: no constant offset between the clocks was found: compared as they are"
                );
            }
            _ => {}
        }
        let report = Report {
            comparison,
            denoising,
            clock_offset_us: offset_us,
            aligned: self.align && offset_us.is_some(),
        };
        if self.json {
            print_json(&report)
        } else {
            print(&report.table())
        }
    }
}

/// The JSON object.
#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    comparison: Comparison,
    /// What B has of A's signal and noise, with --truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    denoising: Option<Denoising>,
    /// How far B's clock is ahead of A's in microseconds; null if no constant offset was found.
    clock_offset_us: Option<i64>,
    /// Whether that offset was removed before the comparison.
    aligned: bool,
}

impl Report {
    fn table(&self) -> String {
        let mut rows = rows(&self.comparison);
        if let Some(denoising) = &self.denoising {
            rows.extend(denoising_rows(denoising));
        }
        lines(&rows)
    }
}

/// The truth about recording A.
struct Truth {
    path: PathBuf,
    causes: ByteList,
    /// Digest of the events that it is about.
    digest: Vec<u8>,
}

impl Truth {
    fn open(path: PathBuf) -> Result<Self> {
        let causes = ByteList::open(&path, "cause")?;
        let list = ByteList::open(&path, digest::ARRAY)?;
        let mut digest = Vec::new();
        // One byte more than it has shows that a list is longer.
        list.take(digest::BYTES as u64 + 1)
            .read_to_end(&mut digest)?;
        Ok(Self {
            path,
            causes,
            digest,
        })
    }

    /// Checks that the truth is about the events that were read of recording A, and has no other causes than there are.
    fn check(&self, found: &Denoising, digest: &EventsDigest, recording: &str) -> Result<()> {
        let name = self.path.display();
        ensure!(
            self.digest == digest.finish(),
            "{name}: is the truth about other events than those of {recording}, or of these in another order: give the \
             recording that eecvs emulate wrote beside it (--keep-order keeps the order in .eecvs)"
        );
        let causes = Cause::ALL.len();
        ensure!(
            found.by_cause.len() <= causes,
            "{name}/cause: has a cause of number {}, and there are {causes} from 0 on",
            found.by_cause.len() - 1
        );
        Ok(())
    }
}

/// A metric: its name, its value, its unit.
type Row = (&'static str, String, &'static str);

/// Formats one line per metric: name, value, unit.
pub fn table(c: &Comparison) -> String {
    lines(&rows(c))
}

fn rows(c: &Comparison) -> Vec<Row> {
    // Rounded down, so that 1.000000 means exactly 1.
    let floor = |share: f64| format!("{:.6}", (share * 1e6).floor() / 1e6);
    // Rounded up, so that 0.000000 means exactly 0.
    let ceiling = |share: f64| format!("{:.6}", (share * 1e6).ceil() / 1e6);
    vec![
        ("events_a", c.events_a.to_string(), ""),
        ("events_b", c.events_b.to_string(), ""),
        ("exact_fraction", floor(c.exact_fraction), ""),
        ("exact_fraction_b", floor(c.exact_fraction_b), ""),
        ("missing_events", c.missing_events.to_string(), ""),
        ("surplus_events", c.surplus_events.to_string(), ""),
        ("surplus_fraction", ceiling(c.surplus_fraction), ""),
        ("mse", format!("{:.3e}", c.mse), ""),
        ("ssim", floor(c.ssim), ""),
        ("emd_time_ms", format!("{:.6}", c.emd_time_ms), "ms"),
        ("emd_pixel_us", format!("{:.3}", c.emd_pixel_us), "us"),
    ]
}

/// Returns what a filter kept: its shares, and for each cause the events kept of all.
fn denoising_rows(d: &Denoising) -> Vec<Row> {
    let share = |share: Option<f64>| share.map_or("-".to_owned(), |share| format!("{share:.6}"));
    let mut rows = vec![
        ("precision", share(d.precision), ""),
        ("recall", share(d.recall), ""),
        ("noise_removed", share(d.noise_removed), ""),
    ];
    let names = Cause::ALL.into_iter().map(Cause::name);
    for (name, count) in names.zip(&d.by_cause) {
        rows.push((name, format!("{} of {}", count.kept, count.events), ""));
    }
    rows
}

/// Formats rows of a name, a value and its unit, with the values below each other.
fn lines(rows: &[Row]) -> String {
    let width = rows.iter().map(|row| row.1.len()).max().unwrap_or(0);
    rows.iter()
        .map(|(name, value, unit)| {
            let line = format!("{name:<16}  {value:>width$} {unit}");
            format!("{}\n", line.trim_end())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERFECT: Comparison = Comparison {
        events_a: 1000,
        events_b: 7,
        exact_fraction: 1.0,
        exact_fraction_b: 1.0,
        missing_events: 0,
        surplus_events: 0,
        surplus_fraction: 0.0,
        mse: 0.0,
        ssim: 1.0,
        emd_time_ms: 0.0,
        emd_pixel_us: 12.5,
    };

    #[test]
    fn the_json_object_has_the_documented_keys() {
        let json = serde_json::to_string(&PERFECT).unwrap();
        assert_eq!(
            json,
            r#"{"events_a":1000,"events_b":7,"exact_fraction":1.0,"exact_fraction_b":1.0,"missing_events":0,"surplus_events":0,"surplus_fraction":0.0,"mse":0.0,"ssim":1.0,"emd_time_ms":0.0,"emd_pixel_us":12.5}"#
        );
    }

    #[test]
    fn the_table_is_aligned() {
        let table = table(&PERFECT);
        let lines: Vec<_> = table.lines().collect();
        assert_eq!(lines[0], "events_a              1000");
        assert_eq!(lines[2], "exact_fraction    1.000000");
        assert_eq!(lines[6], "surplus_fraction  0.000000");
        assert_eq!(lines[10], "emd_pixel_us        12.500 us");
        // A share that is not 0 is not shown as 0.
        let surplus = Comparison {
            surplus_events: 1,
            surplus_fraction: 1e-9,
            ..PERFECT
        };
        assert!(super::table(&surplus).contains("surplus_fraction  0.000001"));
    }

    #[test]
    fn usage_is_checked() {
        #[derive(clap::Parser)]
        struct Command {
            #[command(flatten)]
            compare: Compare,
        }
        use clap::Parser;
        let parse = |args: &str| Command::try_parse_from(args.split(' '));
        assert_eq!(parse("x a b").unwrap().compare.window_us, 32_768);
        for wrong in [
            "x a",
            "x a b --window-us 0",
            "x a b --width 9",
            "x a b --width 0 --height 9",
        ] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
