//! The page that `eecvs demo` writes: pictures, charts and the measured table.

use std::fmt::Write as _;

use eecvs::encode::EncodeSummary;
use eecvs_bench::marks::Marks;
use eecvs_bench::record_file::{Name, name};
use event_metrics::Comparison;
use serde::{Deserialize, Serialize};

/// Results of encoding and decoding the scene in one way.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// `auto`, `dct`, `dtft` or `dwt`; or the name of a coder, with its tolerance if any.
    #[serde(deserialize_with = "name")]
    pub name: Name,
    /// Whether the frames hold coefficients.
    pub is_transform: bool,
    /// Summary of the encoder.
    pub encoded: EncodeSummary,
    /// Comparison of the decoded events with the original ones.
    pub compared: Comparison,
}

const HEADINGS: [&str; 8] = [
    "frames",
    "windows dct/dtft/dwt",
    "bits/event",
    "Mev/s",
    "mse",
    "ssim",
    "emd_time ms",
    "emd_pixel us",
];

impl Row {
    /// Formats the number of windows, per transform if there is one.
    fn windows(&self) -> String {
        let e = &self.encoded;
        if self.is_transform {
            format!("{}/{}/{}", e.windows_dct, e.windows_dtft, e.windows_dwt)
        } else {
            e.windows.to_string()
        }
    }

    fn cells(&self) -> [String; 8] {
        let (e, c) = (&self.encoded, &self.compared);
        [
            self.name.to_owned(),
            self.windows(),
            format!("{:.1}", e.bits_per_event),
            format!("{:.2}", e.events_per_s / 1e6),
            format!("{:.2e}", c.mse),
            format!("{:.4}", c.ssim),
            format!("{:.4}", c.emd_time_ms),
            format!("{:.1}", c.emd_pixel_us),
        ]
    }
}

/// Formats the table for the terminal.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let cells: Vec<_> = rows.iter().map(Row::cells).collect();
    let widths: [usize; 8] = std::array::from_fn(|i| {
        cells
            .iter()
            .map(|row| row[i].len())
            .chain([HEADINGS[i].len()])
            .max()
            .unwrap_or(0)
    });
    let line = |cells: [&str; 8]| {
        let cells = cells
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("{cell:>width$}"));
        cells.collect::<Vec<_>>().join("  ") + "\n"
    };
    let body = cells
        .iter()
        .map(|row| line(std::array::from_fn(|i| row[i].as_str())));
    line(HEADINGS) + &body.collect::<String>()
}

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "demo",
    command: "eecvs demo --save README.md",
};

/// Formats the table for README.md, without the metrics that are exact for all rows.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| frames | windows dct/dtft/dwt | bits/event | encoding, Mev/s | emd_time, ms | \
         emd_pixel, us |\n|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let name = match row.name {
            "fast" => "events, fast coder",
            "dense" => "events, dense coder",
            "dense50us" => "the same within 50 us",
            "auto" => "coefficients, by density",
            "dct" => "DCT",
            "dtft" => "DTFT",
            "dwt" => "Haar DWT",
            other => other,
        };
        let (e, c) = (&row.encoded, &row.compared);
        let _ = writeln!(
            text,
            "| {name} | {} | {:.1} | {:.1} | {:.3} | {:.0} |",
            row.windows(),
            e.bits_per_event,
            e.events_per_s / 1e6,
            c.emd_time_ms,
            c.emd_pixel_us
        );
    }
    text
}

/// Contents of the page.
#[derive(Debug)]
pub struct Page<'p> {
    /// Description of the scene.
    pub scene: &'p str,
    /// Description of the settings, such as M and the window.
    pub setting: &'p str,
    /// Picture files with their captions.
    pub pictures: &'p [(String, String)],
    /// The measured rows.
    pub rows: &'p [Row],
}

impl Page<'_> {
    /// Formats the page as HTML that refers only to the files beside it.
    #[must_use]
    pub fn html(&self) -> String {
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\">\n\
             <title>EECVS: {scene}</title>\n<style>\n\
             body {{ font: 16px/1.5 sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }}\n\
             img {{ max-width: 100%; border: 1px solid #ccc }}\n\
             table {{ border-collapse: collapse }}\n\
             td, th {{ padding: .2em .8em; text-align: right; border-bottom: 1px solid #ccc }}\n\
             </style>\n<h1>EECVS: {scene}</h1>\n<p>{setting}</p>\n",
            scene = escape(self.scene),
            setting = escape(self.setting),
        );
        for (file, caption) in self.pictures {
            let (file, caption) = (escape(file), escape(caption));
            let _ = writeln!(
                html,
                "<figure><img src=\"{file}\" alt=\"{caption}\">\
                 <figcaption>{caption}</figcaption></figure>"
            );
        }
        html += "<h2>Measured</h2>\n<table>\n<tr>";
        for heading in HEADINGS {
            let _ = write!(html, "<th>{heading}</th>");
        }
        html += "</tr>\n";
        for row in self.rows {
            html += "<tr>";
            for cell in row.cells() {
                let _ = write!(html, "<td>{}</td>", escape(&cell));
            }
            html += "</tr>\n";
        }
        html += "</table>\n<p>mse and ssim compare the signed event counts per pixel and window, \
             which the link carries exactly; the times are what the coefficients lose. Mev/s is \
             for one thread of this machine.</p>\n</html>\n";
        html
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use eecvs_bench::marks::of_project;

    use super::*;

    #[test]
    fn the_readme_has_the_marks_and_these_rows() {
        let row = |name| Row {
            is_transform: true,
            name,
            encoded: EncodeSummary {
                windows_dct: 8,
                windows_dtft: 15,
                windows_dwt: 9,
                bits_per_event: 52.34,
                events_per_s: 24.68e6,
                ..EncodeSummary::default()
            },
            compared: Comparison {
                events_a: 1,
                events_b: 1,
                exact_fraction: 0.0,
                exact_fraction_b: 0.0,
                missing_events: 1,
                surplus_events: 1,
                surplus_fraction: 1.0,
                mse: 0.0,
                ssim: 1.0,
                emd_time_ms: 0.0899,
                emd_pixel_us: 119.6,
            },
        };
        let expected =
            document(&["fast", "dense", "dense50us", "auto", "dct", "dtft", "dwt"].map(row));
        let line = "| coefficients, by density | 8/15/9 | 52.3 | 24.7 | 0.090 | 120 |";
        assert_eq!(expected.lines().nth(5), Some(line));
        // The terminal's table has more digits.
        let terminal = table(&[row("auto")]);
        let cells: Vec<&str> = terminal
            .lines()
            .nth(1)
            .unwrap()
            .split_whitespace()
            .collect();
        let of_terminal = [
            "auto", "8/15/9", "52.3", "24.68", "0.00e0", "1.0000", "0.0899", "119.6",
        ];
        assert_eq!(cells, of_terminal);
        let readme = of_project("README.md");
        let content = MARKS.content(&readme).unwrap();
        let name = |line: &str| line.split('|').nth(1).map(str::to_owned);
        let names = |text: &str| text.lines().map(name).collect::<Vec<_>>();
        assert_eq!(names(content), names(&expected));
        assert_eq!(content.lines().next(), expected.lines().next());
    }
}
