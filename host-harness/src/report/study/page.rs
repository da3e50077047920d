//! The page of a study, as HTML that needs no other file.

use std::fmt::Write as _;

use super::colours::label;
use super::figures::Figure;
use super::section::Section;
use super::table::{Table, escape};
use super::tables;
use crate::study::Results;
use crate::study::claims::{Answer, Verdict, figure};

const STYLE: &str = "\
:root { color-scheme: light }
* { box-sizing: border-box }
body { font: 16px/1.55 system-ui, sans-serif; color: #222; background: #fff; max-width: 78rem;
  margin: 0 auto; padding: 1rem }
h1 { font-size: 1.7rem; line-height: 1.2 } h2 { margin-top: 2.5rem; border-bottom: 2px solid #0072b2 }
h3 { margin: 1.5rem 0 .3rem } p { max-width: 46rem }
.answer { border-left: 4px solid #0072b2; padding: .2rem 0 .2rem 1rem; font-size: 1.08rem }
.wide { overflow-x: auto; max-width: 100% }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums }
th, td { padding: .22rem .6rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap }
.text { text-align: left }
tbody th { font-weight: 500 }
th:first-child { position: sticky; left: 0; background: #fff }
thead th { border-bottom: 2px solid #888; font-weight: 600; vertical-align: bottom; white-space: normal }
tbody tr:last-child > * { border-bottom: 2px solid #888 }
figure { margin: 1rem 0 } figure svg, figure img { max-width: 100%; height: auto; display: block }
figcaption { font-size: .9rem; color: #444; max-width: 46rem }
dt { font-weight: 600; margin-top: .9rem } dd { margin: .1rem 0 0 0; max-width: 46rem }
.holds { color: #00694b } .partly { color: #8a5a00 } .fails { color: #a33b00 }
nav a { margin-right: 1rem } footer { margin-top: 3rem; font-size: .85rem; color: #444 }
nav a { display: inline-block }
@media (max-width: 600px) { body { padding: .6rem } h1 { font-size: 1.35rem } tbody th { white-space: normal; min-width: 7.5rem }
  figure svg { max-width: none } figure img { width: 980px; max-width: none } }
";

/// Formats the page of a study; figures follow the tables of their section.
///
/// # Errors
/// Fails if a picture cannot be encoded as PNG.
pub fn html(results: &Results, figures: &[Figure]) -> anyhow::Result<String> {
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <link rel=\"icon\" href=\"data:,\">\n\
         <title>EECVS: what is kept of events, and at what rate</title>\n<style>\n{STYLE}</style></head>\n\
         <body>\n<h1>EECVS: what is kept of events, and at what rate</h1>\n"
    );
    for answer in results.answer() {
        let _ = writeln!(html, "<p class=\"answer\">{}</p>", escape(&text(&answer)));
    }
    html += "<nav>";
    for section in Section::ALL {
        let (id, name) = (section.id(), section.title());
        let _ = write!(html, "<a href=\"#{id}\">{name}</a> ");
    }
    html += "</nav>\n";
    for section in Section::ALL {
        let (id, name) = (section.id(), section.title());
        let _ = writeln!(html, "<h2 id=\"{id}\">{name}</h2>");
        html += &content(section, results);
        for figure in figures.iter().filter(|figure| figure.section == section) {
            html += &figure.html()?;
        }
    }
    let record = &results.record;
    let _ = writeln!(
        html,
        "<footer>EECVS {}, {} study, seed {}, windows of {} us, segmenter {}. {}. {}.</footer>\n</body></html>",
        escape(&record.version),
        escape(&record.effort),
        record.seed,
        record.window_us,
        escape(&record.segmenter),
        escape(&record.machine),
        escape(&record.date)
    );
    Ok(html)
}

fn content(section: Section, results: &Results) -> String {
    let all = |tables: Vec<Table>| tables.iter().map(Table::html).collect::<String>();
    match section {
        Section::Rate => String::from(
            "<p>A point is a setting of a representation: the M of coefficients, the channels of \
             an array, the tolerance of events. The bits are those of the best packing of each: \
             the codec's dense coder, and for arrays 8 or 32 bits per number, of the active pixels \
             alone, compressed by xz. A missing or surplus event counts as a window, 32,768 \
             us.</p>\n",
        ),
        Section::Claims => claims(results),
        Section::TableOne => {
            let mut tables = tables::equal_errors(results);
            tables.extend(tables::table_one(results));
            tables.push(tables::other_arrays(results));
            all(tables)
        }
        Section::TableTwo => all(vec![tables::table_two(results)]),
        Section::TableThree => all(vec![tables::table_three(results)]),
        Section::Perception => all(tables::tables_four_and_five(results)),
        Section::Density => all(vec![tables::regimes(results)]),
        Section::Sources => all(vec![tables::sources(results)]),
    }
}

fn claims(results: &Results) -> String {
    let mut html = String::from(
        "<p>The paper (arXiv 2603.14738) measures on EHPT-XC and MVSEC, which are not shipped with \
         this program; the results here are of emulated scenes of the same kinds, and of \
         recordings where there are any. We do not know which event-time distance its EMD is: two \
         are given here.</p>\n<dl>\n",
    );
    for claim in results.claims() {
        let (class, verdict) = match claim.verdict {
            Verdict::Holds => ("holds", "Holds here."),
            Verdict::Partly => ("partly", "Holds here in part."),
            Verdict::Fails => ("fails", "Does not hold here."),
            Verdict::Unknown => ("partly", "Not measured here."),
        };
        let _ = writeln!(
            html,
            "<dt>{}</dt><dd><strong class=\"{class}\">{verdict}</strong> {}</dd>",
            escape(&claim.claim),
            escape(&claim.here)
        );
    }
    html + "</dl>\n"
}

/// Formats the answer to what keeps events best at equal bits.
#[must_use]
pub fn text(answer: &Answer) -> String {
    let Answer {
        set,
        sources,
        default_bits,
        dense_bits,
        ..
    } = answer;
    let (lossless, half) = (
        list(answer, &answer.at_lossless),
        list(answer, &answer.at_half),
    );
    let no_more = "do not come back from so few bits";
    format!(
        "On the {sources} {set}, events by the fast coder of microcontrollers come back exactly, \
         at {default_bits:.1} bits per event in the median; those by the dense coder do so at \
         {dense_bits:.1}. At no more bits than the dense coder takes, the best setting of each \
         representation leaves an event off by this much in the median (emd_pixel): {lossless}. At \
         half of these bits: {half}. Representations that are not named {no_more}."
    )
}

/// Lists representations and their errors; those that cover all sources come first.
fn list(answer: &Answer, rows: &[(String, Option<f64>, usize)]) -> String {
    let parts = rows.iter().filter_map(|(method, emd, count)| {
        let emd = (*emd)?;
        let error = if emd == 0.0 {
            "nothing".to_owned()
        } else {
            format!("{} us", figure(emd))
        };
        let of = if *count == answer.sources {
            String::new()
        } else {
            format!(" (in {count} of {})", answer.sources)
        };
        Some(format!("{} {error}{of}", label(method)))
    });
    let parts: Vec<_> = parts.collect();
    if parts.is_empty() {
        "none of them".to_owned()
    } else {
        parts.join(", ")
    }
}

impl Figure {
    /// Formats the figure for the page.
    ///
    /// # Errors
    /// Fails if the picture cannot be encoded as PNG.
    fn html(&self) -> anyhow::Result<String> {
        let caption = escape(&self.caption);
        let picture = match &self.svg {
            Some(svg) => svg.clone(),
            None => format!(
                "<img alt=\"{caption}\" src=\"data:image/png;base64,{}\">",
                base64(&self.png.png()?)
            ),
        };
        Ok(format!(
            "<figure><div class=\"wide\">{picture}</div><figcaption>{caption}</figcaption></figure>\n"
        ))
    }
}

/// Encodes as in RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |i: usize| chunk.get(i).copied().map_or(0, u32::from);
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            if i <= chunk.len() {
                text.push(char::from(LETTERS[(word >> (18 - 6 * i) & 63) as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        let of = |text: &str| base64(text.as_bytes());
        assert_eq!(
            ["", "f", "fo", "foo", "foob", "fooba", "foobar"].map(of),
            [
                "", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"
            ]
        );
        assert_eq!(base64(&[0xfb, 0xff]), "+/8=");
    }
}
