//! `eecvs convert`: converts a recording from one event-file format to another.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use eecvs_cli::options::{
    FollowOptions, FormatOptions, OutputOptions, ReadingOptions, TimeOptions, tell_damage,
};
use eecvs_cli::order::SortOptions;
use eecvs_cli::output::{Place, rows};
use event_files::convert::{Conversion, Converted, Crop, Filter, convert};

/// Convert a recording, or a part of it, to another format
#[derive(Debug, Args)]
pub struct Convert {
    /// Recording to read
    #[arg(value_name = "IN")]
    input: PathBuf,

    /// Recording to write; the extension names the format
    #[arg(value_name = "OUT")]
    output: PathBuf,

    #[command(flatten)]
    times: TimeOptions,

    /// Only this part of the sensor; its corner becomes (0, 0)
    #[arg(long, value_name = "X,Y,W,H", value_parser = crop)]
    crop: Option<Crop>,

    /// Drop or change what the output's format cannot hold, and count it, instead of failing
    #[arg(long)]
    allow_loss: bool,

    #[command(flatten)]
    sort: SortOptions,

    #[command(flatten)]
    follow: FollowOptions,

    #[command(flatten)]
    reading: ReadingOptions,

    #[command(flatten)]
    format: FormatOptions,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

fn crop(text: &str) -> Result<Crop> {
    let numbers: Vec<u16> = text
        .split(',')
        .map(|number| {
            number
                .trim()
                .parse()
                .with_context(|| format!("`{number}` is not a number"))
        })
        .collect::<Result<_>>()?;
    let [x, y, width, height] = numbers[..] else {
        bail!("four numbers are needed: left column, top row, width, height");
    };
    Ok(Crop {
        x,
        y,
        width,
        height,
    })
}

impl Convert {
    /// Converts and prints how many events were read and written.
    ///
    /// # Errors
    /// Fails if a recording cannot be read to its end, or the output's format cannot hold its events.
    pub fn run(self) -> Result<()> {
        self.times.check("eecvs convert");
        let conversion = Conversion {
            filter: Filter {
                from_us: self.times.from_us,
                to_us: self.times.to_us,
                crop: self.crop,
            },
            allow_loss: self.allow_loss,
            sort: self.sort.is_asked(),
            follow: self.follow.follow()?,
            format: Some(self.format.of(&self.output)?),
            ..Conversion::default()
        };
        self.overwrite
            .check(&self.output, self.format.kind(), [self.input.as_path()])?;
        let reading = self.reading.reading();
        let converted = convert(&self.input, &self.output, &reading, &conversion)?;
        let place = Place::beside([self.output.as_path()]);
        place.tell(self.json, &converted, || table(&converted))?;
        let followed = conversion.follow.is_some();
        let output = converted.incomplete_output.as_deref();
        let output = output.unwrap_or(&self.output);
        tell_damage(
            converted.damage.as_deref(),
            Some(output),
            &self.output,
            followed,
        )
    }
}

fn table(converted: &Converted) -> String {
    let lost = converted.lost;
    let mut lines = vec![
        ("events in", converted.events_in.to_string()),
        ("events out", converted.events_out.to_string()),
    ];
    let counts = [
        ("times shifted by, us", lost.shifted_us),
        ("lost: outside the format", lost.outside),
        ("lost: beyond its times", lost.beyond_time),
        ("times raised", lost.raised),
    ];
    for (what, count) in counts {
        if count > 0 {
            lines.push((what, count.to_string()));
        }
    }
    lines.extend(converted.findings.rows());
    rows(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_are_four_numbers() {
        assert_eq!(
            crop("1,2,30,40").unwrap(),
            Crop {
                x: 1,
                y: 2,
                width: 30,
                height: 40
            }
        );
        for wrong in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,3,-4",
            "a,b,c,d",
            "70000,0,1,1",
        ] {
            assert!(crop(wrong).is_err(), "{wrong}");
        }
    }
}
