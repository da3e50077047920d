//! `eecvs info`: prints what a recording holds.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use eecvs_cli::options::{ReadingOptions, tell_damage};
use eecvs_cli::output::{print, print_json, rows};
use eecvs_cli::progress::Progress;
use event_files::recording_info::{RecordingInfo, info};

/// Print what a recording holds
#[derive(Debug, Args)]
pub struct Info {
    /// Recording to read
    file: PathBuf,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Info {
    /// Reads the recording and prints what it holds.
    ///
    /// # Errors
    /// Fails if the recording cannot be read to its end.
    pub fn run(self) -> Result<()> {
        let progress = Progress::new("events");
        let info = info(&self.file, &self.reading.reading(), &mut |events| {
            progress.advance(events);
        })?;
        drop(progress);
        if self.json {
            print_json(&info)?;
        } else {
            print(&table(&info))?;
        }
        tell_damage(info.damage.as_deref(), None, &self.file, false)
    }
}

fn table(info: &RecordingInfo) -> String {
    let time = |t: Option<u64>| t.map_or_else(|| "none".to_owned(), |t| t.to_string());
    let facts = [
        (
            "sensor",
            info.sensor
                .clone()
                .unwrap_or_else(|| "not named".to_owned()),
        ),
        ("format", info.format.clone()),
        ("width", info.width.to_string()),
        ("height", info.height.to_string()),
        ("events", info.events.to_string()),
        ("on", info.on.to_string()),
        ("off", info.off.to_string()),
        ("t_first_us", time(info.t_first_us)),
        ("t_last_us", time(info.t_last_us)),
        ("duration_s", format!("{:.6}", info.duration_s)),
        ("rate_eps", format!("{:.1}", info.rate_eps)),
        ("times_back", info.times_back.to_string()),
        ("back_max_us", info.back_max_us.to_string()),
        ("sum_x", info.sum_x.to_string()),
        ("sum_y", info.sum_y.to_string()),
        ("sha256_events", info.sha256_events.clone()),
        ("xxh128_sum_events", info.xxh128_sum_events.clone()),
    ];
    rows(facts.into_iter().chain(info.findings.rows()))
}
