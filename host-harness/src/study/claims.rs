//! Compares the paper's claims with the measured rows, and finds what keeps events best at equal bits.

use std::collections::BTreeMap;

use super::Results;
use super::density::Densities;
use super::effort::{M, MEAN_ERROR_US};
use super::method::Method;
use super::paper;
use super::quality::Quality;
use super::set::{RECORDINGS, SCENES};
use super::speed::{HOST, MCU};

/// Whether a claim of the paper holds here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The figures given confirm it.
    Holds,
    /// It holds in some of the cases, which the text names.
    Partly,
    /// The figures given contradict it.
    Fails,
    /// There are no rows to decide it.
    Unknown,
}

/// A claim of the paper and what was measured here.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claim {
    /// The paper's claim, in short.
    pub claim: String,
    /// Whether the claim holds.
    pub verdict: Verdict,
    /// The figures measured, and what differs.
    pub here: String,
}

/// The single transforms, as opposed to the choice by density.
pub const FIXED: [&str; 3] = ["dct", "dtft", "dwt"];
/// Methods compared in the paper's Table I.
const TABLE_ONE: [&str; 5] = ["dct", "dtft", "dwt", "ces", "tore"];

/// Reads a metric from a row.
pub type Metric = fn(&Quality) -> f64;
/// Two metrics, as the paper does not say which distance its EMD is: one over the times of a window's events, one
/// over the times of each pixel's events.
const METRICS: [(&str, Metric); 2] = [
    ("emd_time_ms", |row| row.emd_time_ms),
    ("emd_pixel_us", |row| row.emd_pixel_us),
];

impl Results {
    /// Returns the names of a set's sources, in the order of the rows.
    #[must_use]
    pub fn sources(&self, set: &str) -> Vec<&str> {
        let record = self.record.sources.iter();
        record
            .filter(|source| source.set == set)
            .map(|source| source.source.as_str())
            .collect()
    }

    /// Returns the names of the sets that were measured.
    #[must_use]
    pub fn sets(&self) -> Vec<&'static str> {
        let has = |set: &&str| self.record.sources.iter().any(|source| source.set == **set);
        [SCENES, RECORDINGS].into_iter().filter(has).collect()
    }

    /// Returns the densities of the sets, in the order of [`Results::sets`].
    pub fn densities(&self) -> impl Iterator<Item = &Densities> {
        let of = |set: &'static str| self.density.iter().filter(move |of| of.set == set);
        self.sets().into_iter().flat_map(of)
    }

    /// Returns a row of Tables I and II: stored in the natural type, with exact finding of times if there is a
    /// choice, and with a mean error of [`MEAN_ERROR_US`]. A method without coefficients has only one row, whatever `m` is.
    #[must_use]
    pub fn row(&self, set: &str, source: &str, method: &str, m: u8) -> Option<&Quality> {
        self.quality.iter().find(|row| {
            row.set == set
                && row.source == source
                && row.method == method
                && (row.m == m || matches!(row.m, 0 | 2) && !FIXED.contains(&method))
                && (matches!(row.setting.as_str(), "exact" | "lossless" | "f32")
                    || row.setting
                        == (Method::MeanError {
                            most_us: MEAN_ERROR_US,
                        })
                        .setting())
        })
    }

    fn metric(&self, set: &str, source: &str, method: &str, m: u8, metric: Metric) -> Option<f64> {
        self.row(set, source, method, m).map(metric)
    }

    /// Returns every claim, in the order of the paper.
    #[must_use]
    pub fn claims(&self) -> Vec<Claim> {
        vec![
            self.dtft_is_lowest(),
            self.dwt_in_sparse(),
            self.dct_is_fastest(),
            self.emd_over_m(),
            self.adaptive_is_best(),
            self.iou(),
        ]
    }

    fn dtft_is_lowest(&self) -> Claim {
        let mut here = Vec::new();
        let mut most_scenes = Vec::new();
        for set in self.sets() {
            for (name, metric) in METRICS {
                let lowest = |among: &[&str]| {
                    let sources = self.sources(set);
                    let wins = sources.iter().filter(|source| {
                        let of = |method: &str| self.metric(set, source, method, M, metric);
                        of("dtft").is_some_and(|dtft| {
                            among
                                .iter()
                                .filter_map(|m| of(m))
                                .all(|other| dtft <= other)
                        })
                    });
                    (wins.count(), sources.len())
                };
                let (all, count) = lowest(&TABLE_ONE);
                let (fixed, _) = lowest(&FIXED);
                let peaks = self.lowest_by_peaks(set, metric);
                here.push(format!(
                    "of {count} {set}, {name} is lowest by the DTFT in {all}, in {fixed} where \
                     only the three transforms are compared, and in {peaks} where these are \
                     compared by the peaks of summed atoms"
                ));
                if set == SCENES {
                    most_scenes.push(all);
                }
            }
        }
        let verdict = match most_scenes.as_slice() {
            [] => Verdict::Unknown,
            wins if wins.iter().all(|wins| *wins >= paper::DTFT_LOWEST) => Verdict::Holds,
            wins if wins.iter().any(|wins| *wins >= paper::DTFT_LOWEST) => Verdict::Partly,
            _ => Verdict::Fails,
        };
        Claim {
            claim: format!(
                "The DTFT has the lowest EMD in {} of nine scenes (Table I)",
                paper::DTFT_LOWEST
            ),
            verdict,
            here: format!(
                "At M = {M}: {}. Event times are solved for here, with the counts sent on the \
                 link; the paper thresholds summed atoms.",
                here.join("; ")
            ),
        }
    }

    /// Counts the sources in which the DTFT is the best of the three transforms with a decoder like the paper's.
    fn lowest_by_peaks(&self, set: &str, metric: Metric) -> usize {
        let of = |source: &str, method: &str| {
            let mut rows = self.quality.iter();
            let row = rows.find(|row| {
                (row.set.as_str(), row.source.as_str(), row.method.as_str())
                    == (set, source, method)
                    && row.m == M
                    && row.setting == "peaks"
            });
            row.map(metric)
        };
        let wins = |source: &&str| {
            of(source, "dtft").is_some_and(|dtft| {
                FIXED
                    .iter()
                    .filter_map(|method| of(source, method))
                    .all(|other| dtft <= other)
            })
        };
        self.sources(set)
            .iter()
            .filter(|source| wins(source))
            .count()
    }

    fn dwt_in_sparse(&self) -> Claim {
        let mut here = Vec::new();
        let mut wins = Vec::new();
        for set in self.sets() {
            let sparsest = self
                .quality
                .iter()
                .filter(|row| row.set == set)
                .min_by(|a, b| a.density_per_px_s.total_cmp(&b.density_per_px_s));
            let Some(sparsest) = sparsest else { continue };
            let of = |method| self.row(set, &sparsest.source, method, M);
            let (Some(dct), Some(dtft), Some(dwt)) = (of("dct"), of("dtft"), of("dwt")) else {
                continue;
            };
            wins.push(dwt.emd_pixel_us <= dct.emd_pixel_us.min(dtft.emd_pixel_us));
            here.push(format!(
                "in {} ({:.3} events per pixel and second) emd_pixel_us is {} by DWT, {} by DTFT and {} \
                 by DCT, at {:.1}, {:.1} and {:.1} bits per event",
                sparsest.source,
                sparsest.density_per_px_s,
                figure(dwt.emd_pixel_us),
                figure(dtft.emd_pixel_us),
                figure(dct.emd_pixel_us),
                dwt.bits_per_event,
                dtft.bits_per_event,
                dct.bits_per_event,
            ));
        }
        Claim {
            claim: "The DWT is better in the sparse scene".to_owned(),
            verdict: verdict(&wins),
            here: format!("At M = {M}: {}.", here.join("; ")),
        }
    }

    fn dct_is_fastest(&self) -> Claim {
        let mut here = Vec::new();
        let mut wins = Vec::new();
        for target in [HOST, MCU] {
            let of = |method: &str| {
                let mut rows = self.speed.iter();
                let row = rows.find(|row| row.target == target && row.method == method);
                row.map(|row| row.kev_per_s)
            };
            let (Some(dct), Some(dtft), Some(dwt)) = (of("dct"), of("dtft"), of("dwt")) else {
                continue;
            };
            wins.push(dct >= paper::DCT_THROUGHPUT * dtft.max(dwt));
            here.push(format!(
                "{target}: {:.1} times the DTFT's events per second and {:.1} times the DWT's",
                dct / dtft,
                dct / dwt
            ));
        }
        Claim {
            claim: format!(
                "The DCT has {} times the throughput of the others (Table III)",
                paper::DCT_THROUGHPUT
            ),
            verdict: verdict(&wins),
            here: format!("{}.", here.join("; ")),
        }
    }

    fn emd_over_m(&self) -> Claim {
        let mut here = Vec::new();
        let mut same = Vec::new();
        for set in self.sets() {
            for method in FIXED {
                let ratios: Vec<f64> = self
                    .sources(set)
                    .iter()
                    .filter_map(|source| {
                        let of = |m| self.metric(set, source, method, m, |row| row.emd_pixel_us);
                        let (few, many) = (of(8)?, of(24)?);
                        (many > 0.0).then_some(few / many)
                    })
                    .collect();
                let Some(median) = median(ratios) else {
                    continue;
                };
                same.push((0.9..=1.1).contains(&median));
                here.push(format!("{} in {set}: {median:.1}", method.to_uppercase()));
            }
        }
        if here.is_empty() {
            here.push("not measured at both M".to_owned());
        }
        Claim {
            claim: "The EMD does not change from M = 8 to M = 24 (Table II)".to_owned(),
            verdict: verdict(&same),
            here: format!(
                "Median of emd_pixel_us at M = 8 over that at M = 24: {}. If an EMD does not \
                 change, its decoder does not get it from the coefficients.",
                here.join("; ")
            ),
        }
    }

    fn adaptive_is_best(&self) -> Claim {
        let mut here = Vec::new();
        let mut wins = Vec::new();
        let mut equal = Vec::new();
        for set in self.sets() {
            let sources = self.sources(set);
            let (mut best, mut dominated) = (0, 0);
            for source in &sources {
                let fixed: Vec<&Quality> = FIXED
                    .iter()
                    .filter_map(|m| self.row(set, source, m, M))
                    .collect();
                let Some(auto) = self.row(set, source, "auto", M) else {
                    continue;
                };
                best += usize::from(
                    fixed
                        .iter()
                        .all(|row| auto.emd_pixel_us <= row.emd_pixel_us),
                );
                dominated += usize::from(fixed.iter().any(|row| {
                    row.emd_pixel_us <= auto.emd_pixel_us
                        && row.packed_bits_per_event <= auto.packed_bits_per_event
                        && (row.emd_pixel_us, row.packed_bits_per_event)
                            != (auto.emd_pixel_us, auto.packed_bits_per_event)
                }));
            }
            wins.push(best == sources.len());
            here.push(format!(
                "of {} {set}, the choice by density has the lowest emd_pixel_us in {best}; in {dominated} \
                 one of the fixed transforms has no more error at no more bits",
                sources.len()
            ));
            let (auto, cases) = self.beats_fixed(set, "auto");
            let (mean_error, mean_error_cases) = self.beats_fixed(set, "best");
            equal.push(format!(
                "in {set} the choice by density takes fewer bits than every fixed transform in {auto} of \
                 {cases} cases, events within a mean error (best) do in {mean_error} of {mean_error_cases}"
            ));
        }
        Claim {
            claim: "Choosing by density is better than any fixed transform".to_owned(),
            verdict: verdict(&wins),
            here: format!(
                "At M = {M}: {}. At equal errors, of times or of the smoothed volume, every transform at \
                 its best M and step: {}.",
                here.join("; "),
                equal.join("; ")
            ),
        }
    }

    fn iou(&self) -> Claim {
        let [codec, voxel] = paper::IOU_MVSEC_24;
        let mut here = Vec::new();
        let mut wins = Vec::new();
        for set in self.sets() {
            let mean = |method: &str, slices: bool| {
                let rows = self.perception.iter();
                let rows = rows.filter(|row| row.set == set && row.method == method && row.m == 24);
                let iou = rows.filter_map(|row| {
                    let [window, slice] = row.mean_iou();
                    if slices { slice } else { window }
                });
                mean(iou.collect())
            };
            for (slices, name) in [(false, "whole windows"), (true, "tenths of a window")] {
                let (Some(auto), Some(grid)) = (mean("auto", slices), mean("voxel", slices)) else {
                    continue;
                };
                wins.push(auto > grid);
                here.push(format!(
                    "{set}, {name}: {auto:.2} by density, {grid:.2} by voxel grids"
                ));
            }
        }
        if here.is_empty() {
            here.push("not measured at 24 channels".to_owned());
        }
        Claim {
            claim: format!(
                "Segmented with EventSAM at 24 channels, mean IoU is {codec} by the codec and {voxel} by \
                 voxel grids (MVSEC, Table V)"
            ),
            verdict: verdict(&wins),
            here: format!(
                "Mean IoU of matched segments, another segmenter on other scenes: {}. Frames of \
                 whole windows come back exactly, because the counts are sent on the link.",
                here.join("; ")
            ),
        }
    }

    /// Returns the answers for the report's first paragraph, one per set.
    #[must_use]
    pub fn answer(&self) -> Vec<Answer> {
        self.sets()
            .into_iter()
            .filter_map(|set| self.answer_of(set))
            .collect()
    }

    fn answer_of(&self, set: &'static str) -> Option<Answer> {
        let sources = self.sources(set);
        let bits_of = |method: &str| {
            let rows = sources
                .iter()
                .filter_map(|source| self.row(set, source, method, M));
            median(rows.map(|row| row.packed_bits_per_event).collect())
        };
        let default_bits = bits_of("hybrid-fast")?;
        let dense_bits = bits_of("hybrid-dense")?;
        let at = |share: f64| -> Vec<(String, Option<f64>, usize)> {
            let mut best: BTreeMap<String, Vec<f64>> = BTreeMap::new();
            for source in &sources {
                let default = self.row(set, source, "hybrid-dense", M);
                let Some(budget) = default.map(|row| row.packed_bits_per_event * share) else {
                    continue;
                };
                let mut of_source: BTreeMap<String, f64> = BTreeMap::new();
                for row in self.quality.iter().filter(|row| {
                    row.set == set
                        && row.source == *source
                        && row.packed_bits_per_event <= budget + 1e-9
                        && !row.setting.ends_with("peaks")
                        && row.has_times
                }) {
                    let method = family(&row.method).to_owned();
                    let least = of_source.entry(method).or_insert(f64::INFINITY);
                    *least = least.min(row.emd_pixel_us);
                }
                for (method, emd) in of_source {
                    best.entry(method).or_default().push(emd);
                }
            }
            let mut rows: Vec<_> = best
                .into_iter()
                .map(|(method, emds)| {
                    let count = emds.len();
                    (method, median(emds), count)
                })
                .collect();
            rows.sort_by(|a, b| {
                b.2.cmp(&a.2).then(
                    a.1.unwrap_or(f64::INFINITY)
                        .total_cmp(&b.1.unwrap_or(f64::INFINITY)),
                )
            });
            rows
        };
        Some(Answer {
            set,
            sources: sources.len(),
            default_bits,
            dense_bits,
            at_lossless: at(1.0),
            at_half: at(0.5),
        })
    }
}

/// Representations that keep events best at equal bits, over the sources of a set.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// `scenes` or `recordings`.
    pub set: &'static str,
    /// Number of sources in the set.
    pub sources: usize,
    /// Median bits per event of the default: lossless events by the fast coder.
    pub default_bits: f64,
    /// Median bits per event of lossless events by the dense coder.
    pub dense_bits: f64,
    /// Per representation: its name, the median over sources of the least `emd_pixel_us` at no more bits than
    /// lossless events take by the dense coder, and the number of sources in which it fits into these bits.
    pub at_lossless: Vec<(String, Option<f64>, usize)>,
    /// The same at half of those bits.
    pub at_half: Vec<(String, Option<f64>, usize)>,
}

/// Returns the name of a method's representation; both coders of events share one.
#[must_use]
pub fn family(method: &str) -> &str {
    if method.starts_with("hybrid") {
        "events"
    } else {
        method
    }
}

fn verdict(cases: &[bool]) -> Verdict {
    match (
        cases.iter().any(|case| *case),
        cases.iter().all(|case| *case),
    ) {
        _ if cases.is_empty() => Verdict::Unknown,
        (_, true) => Verdict::Holds,
        (true, false) => Verdict::Partly,
        (false, _) => Verdict::Fails,
    }
}

fn mean(values: Vec<f64>) -> Option<f64> {
    let count = values.len() as f64;
    (!values.is_empty()).then(|| values.into_iter().sum::<f64>() / count)
}

/// Returns the median; the mean of the middle two for an even count, `None` for no values.
#[must_use]
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    let upper = *values.get(middle)?;
    if values.len() % 2 == 1 {
        return Some(upper);
    }
    let lower = *values.get(middle.checked_sub(1)?)?;
    Some((lower + upper) / 2.0)
}

/// Formats a number with about three digits.
#[must_use]
pub fn figure(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 {
        "0".to_owned()
    } else if magnitude >= 99.5 {
        format!("{value:.0}")
    } else if magnitude >= 9.95 {
        format!("{value:.1}")
    } else if magnitude >= 0.01 {
        format!("{value:.2}")
    } else {
        format!("{value:.1e}")
    }
}
