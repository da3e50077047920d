//! Runs a small study as a whole.

use std::sync::atomic::{AtomicUsize, Ordering};

use eecvs_nostd::{Coder, Fidelity};
use event_emulator::Preset;

use super::*;
use crate::baseline::Baseline;
use crate::downstream::segment::classical::Classical;
use crate::study::claims::{Claim, Verdict};
use crate::study::effort::M;
use crate::study::equal_errors::Asked;
use crate::study::set::SCENES;

const EFFORT: Effort = Effort {
    scene_us: 40_000,
    m: &[8, 16],
    m_curve: &[4],
    tolerances_us: &[50],
    bins: &[8],
    speed_s: 0.01,
    ..Effort::QUICK
};

fn set() -> Set {
    let scenes = Set::scenes(&EFFORT).unwrap();
    let keep = [Preset::OutdoorDark.name(), Preset::IndoorDarkBlur.name()];
    let sources = scenes.sources.into_iter();
    Set {
        sources: sources
            .filter(|source| keep.contains(&source.name.as_str()))
            .collect(),
        ..scenes
    }
}

#[test]
fn a_study_has_every_row_and_goes_on_where_it_was_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rows.jsonl");
    let sets = [set()];
    let record = Record::new(&sets, &[], &EFFORT, "built-in");
    let (store, _) = Store::open(&path, record.clone(), true).unwrap();
    run(&sets, &EFFORT, &Classical, &store, &|_, _| ()).unwrap();
    let results = store.results();
    let methods = EFFORT.methods();
    assert_eq!(results.quality.len(), 2 * methods.len());
    for row in &results.quality {
        let all = [
            row.bits_per_event,
            row.packed_bits_per_event,
            row.mse,
            row.ssim,
            row.emd_time_ms,
            row.emd_pixel_us,
            row.volume_error,
        ];
        assert!(all.iter().all(|value| value.is_finite()), "{row:?}");
        let is_lossless = row.setting == "lossless";
        if let Some(most_us) = row.setting.strip_suffix(" us on average") {
            assert_eq!(row.method, "best");
            assert!(
                row.emd_pixel_us <= most_us.parse::<f64>().unwrap(),
                "{row:?}"
            );
        }
        assert!(row.volume_error == 0.0 || !is_lossless, "{row:?}");
        assert!(row.exact_fraction == 1.0 || !is_lossless, "{row:?}");
        // Even arrays may preserve every time of a quiet scene.
        assert_eq!(
            row.exact_fraction == 1.0,
            row.emd_pixel_us == 0.0,
            "{row:?}"
        );
        // The codec transmits exact counts.
        if Baseline::ALL
            .iter()
            .all(|baseline| baseline.name() != row.method)
        {
            assert_eq!((row.mse, row.events_decoded), (0.0, row.events), "{row:?}");
        }
    }
    let with = |has: fn(Method) -> bool| methods.iter().filter(|method| has(**method)).count();
    assert_eq!(results.times.len(), 2 * with(Method::has_time_errors));
    assert_eq!(results.perception.len(), 2 * with(Method::has_perception));
    for times in &results.times {
        let source = sets[0]
            .sources
            .iter()
            .find(|s| s.name == times.source)
            .unwrap();
        let all = times.counts.iter().sum::<u64>() + times.unpaired;
        assert_eq!(all, source.events.len() as u64, "{times:?}");
    }

    // Stored rows are not measured again, and measuring the missing ones again gives the same rows.
    let text = std::fs::read_to_string(&path).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let kept = lines.len() - 12;
    std::fs::write(&path, lines[..kept].join("\n") + "\n").unwrap();
    let (store, count) = Store::open(&path, record, true).unwrap();
    // The first line is the record.
    assert_eq!(count, kept - 1);
    let first = AtomicUsize::new(usize::MAX);
    run(&sets, &EFFORT, &Classical, &store, &|done, total| {
        assert_eq!(total, 2 * methods.len());
        first.fetch_min(done, Ordering::Relaxed);
    })
    .unwrap();
    // Speed and density have tasks of their own, which do not count as tasks of a source.
    assert_eq!(first.into_inner(), count - 2);
    let again = store.results();
    assert_eq!(again.quality, results.quality);
    assert_eq!(again.times, results.times);
    assert_eq!(again.perception, results.perception);
    equal_errors(&results);
    claims(results);
}

/// The fewest bits fall as the error that is asked for grows.
fn equal_errors(results: &Results) {
    let times = [128, 2048].map(Asked::TimesUs);
    for source in results.sources(SCENES) {
        for name in ["best", "events", "dwt"] {
            let [fine, coarse] = times.map(|asked| {
                let bits = results.fewest_bits(SCENES, source, name, asked);
                bits.unwrap_or(f64::INFINITY)
            });
            assert!(coarse <= fine && coarse.is_finite(), "{source}, {name}");
        }
    }
    let (median, sources) = results.fewest_bits_median(SCENES, "best", times[1]);
    assert!(median.is_some() && sources == 2);
    assert!(results.beats_fixed(SCENES, "best").1 > 0);
    assert_eq!(results.beats_fixed(SCENES, "no such").1, 0);
}

/// Checks the claims on the rows, and again with the DTFT made the best and the worst.
fn claims(mut results: Results) {
    assert_eq!(results.claims().len(), 6);
    let nothing = Results {
        quality: Vec::new(),
        speed: Vec::new(),
        perception: Vec::new(),
        ..results.clone()
    };
    let holds = |claim: &Claim| claim.verdict == Verdict::Holds;
    assert!(!nothing.claims().iter().any(holds));
    let answer = &results.answer()[0];
    let (method, emd, sources) = &answer.at_lossless[0];
    assert_eq!((method.as_str(), *emd, *sources), ("events", Some(0.0), 2));
    assert!(answer.dense_bits < answer.default_bits);
    // A DTFT that beats all others is recognised, and one that does not.
    for (emd, wins) in [(0.0, "in 2,"), (1e9, "in 0,")] {
        for row in results
            .quality
            .iter_mut()
            .filter(|row| row.method == "dtft" && row.m == M)
        {
            (row.emd_time_ms, row.emd_pixel_us) = (emd, emd);
        }
        let claim = &results.claims()[0];
        assert!(
            claim
                .here
                .contains(&format!("emd_pixel_us is lowest by the DTFT {wins}")),
            "{claim:?}"
        );
    }
    let lossless = Method::Hybrid {
        coder: Coder::Fast,
        fidelity: Fidelity::Lossless,
    };
    assert_eq!(lossless.key(), "hybrid-fast 0 lossless");
}
