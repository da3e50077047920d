//! What commands leave where a call of the system fails, the disk is full, or a signal ends them: each output is the
//! old file, byte for byte, or the whole new one; no temporary file stays that the process could have removed; and the
//! status is 0 only where every output is whole.
//!
//! Every call by which a command changes a file is a place. The usual tests take some places of each command;
//! `cargo xtask faults` takes all, each with every plan, and kills every command at random moments.
#![cfg(target_os = "linux")]

mod case;
mod judge;
mod outside;
mod run;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use case::{CASES, Case, Cost, Kind};
use judge::Reference;
use run::Bench;

/// Places of each command in the usual tests.
const PLACES: usize = 5;

/// Kills at random moments in the whole campaign, without those that come after the command's end.
const KILLS: usize = 1000;

/// Attempts for each kill that is wanted: a command may end before nearly every one.
const ATTEMPTS: usize = 4;

/// Whether all places are wanted, if only of some commands.
fn is_whole() -> bool {
    std::env::var_os("EECVS_FAULTS_ALL").is_some()
}

/// Whether a command is wanted: all are, unless the variable has a word of its line.
fn is_wanted(case: &Case) -> bool {
    let word = std::env::var("EECVS_FAULTS_ALL").unwrap_or_default();
    word == "1" || format!("{} {}", case.program, case.line).contains(&word)
}

/// How many of a command's places are tried, each with one plan unless it is all; `None` if the command is left out.
fn places_of(case: &Case) -> Option<usize> {
    if !is_wanted(case) {
        return None;
    }
    match (is_whole(), case.cost) {
        (true, Cost::Minutes(places)) => Some(places),
        (true, _) => Some(usize::MAX),
        (false, Cost::Quick) => Some(PLACES),
        (false, _) => None,
    }
}

/// The error numbers, in turn.
const ERRORS: [i32; 2] = [libc::ENOSPC, libc::EIO];

/// The plans for place `at`, counted from 1, whose call is `call`.
fn plans(at: usize, call: &str) -> Vec<String> {
    let signals = [libc::SIGTERM, libc::SIGINT];
    let mut plans = vec![
        format!("{at}e{}", ERRORS[at % 2]),
        format!("{at}f"),
        format!("{at}k"),
        format!("{at}g{}", signals[at % 2]),
    ];
    if call.starts_with("write") {
        plans.extend([format!("{at}s"), format!("{at}h")]);
    }
    plans
}

/// The name of a plan without its place.
fn kind_of(plan: &str) -> &'static str {
    let letter = plan.trim_start_matches(|c: char| c.is_ascii_digit());
    match letter {
        "e28" => "ENOSPC",
        "e5" => "EIO",
        "f" => "full from here on",
        "k" => "killed",
        "h" => "killed in a write",
        "s" => "short write",
        _ => "TERM or INT",
    }
}

/// Runs a case with a plan, and returns what is wrong with the outcome.
fn fault(
    bench: &Bench,
    case: &Case,
    reference: &Reference,
    plan: &str,
    call: &str,
) -> Option<String> {
    let (before, outcome) = bench.run(case, plan);
    let kind = kind_of(plan);
    let is_stopped = kind == "TERM or INT";
    let mut wrong = reference.fault(bench, case, &before, &outcome, call, is_stopped);
    let status = outcome.status.code();
    if kind == "short write" && status != Some(0) {
        wrong = wrong.or(Some("a short write is no error".to_owned()));
    }
    // What was on its way when the signal came is lost, or nothing had arrived, which is said.
    let is_loss = case.is_live() && status == Some(1);
    if is_stopped && !is_loss && !matches!(status, Some(0 | 130)) {
        wrong = wrong.or(Some("a signal ends it with 0 or 130".to_owned()));
    }
    let is_complete = || reference.is_complete(bench, &outcome.files);
    if case.kind == Kind::Together && wrong.is_none() && !is_complete() {
        let again = bench.end(bench.start(case, "0-"));
        if !again.is_success() {
            wrong = Some(format!("again: {}", again.stderr));
        }
    }
    wrong.map(|wrong| {
        format!(
            "{} {}: {kind} at {call} ({plan}): {wrong}; {}: {}",
            case.program, case.line, outcome.status, outcome.stderr
        )
    })
}

/// Prints what was counted, and fails if anything is wrong.
fn tell(counts: &BTreeMap<&str, usize>, wrong: &[String]) {
    assert!(!counts.is_empty(), "no command is tried");
    for (kind, count) in counts {
        println!("{count:>6}  {kind}");
    }
    assert!(
        wrong.is_empty(),
        "{} of them are wrong:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

#[test]
fn every_output_is_old_or_whole_when_a_call_fails() {
    let bench = Bench::new();
    let (mut counts, mut wrong) = (BTreeMap::new(), Vec::new());
    let (mut places, mut turn) = (0, 0);
    for case in CASES {
        let Some(most) = places_of(case) else {
            continue;
        };
        let reference = Reference::of(&bench, case);
        let all = reference.calls.len();
        let step = all.div_ceil(most);
        places += all;
        for at in (0..all).step_by(step) {
            let call = &reference.calls[at];
            let mut plans = plans(at + 1, call);
            if most != usize::MAX {
                turn += 1;
                plans = vec![plans.swap_remove(turn % plans.len())];
            }
            for plan in plans {
                *counts.entry(kind_of(&plan)).or_insert(0) += 1;
                wrong.extend(fault(&bench, case, &reference, &plan, call));
            }
        }
        if is_whole() {
            println!("{all:>6}  places of {} {}", case.program, case.line);
        }
    }
    println!("{places:>6}  places in all");
    tell(&counts, &wrong);
}

/// Kills at moments that have nothing to do with calls.
#[test]
fn every_output_is_old_or_whole_when_a_command_is_killed() {
    let bench = Bench::new();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let (mut counts, mut wrong) = (BTreeMap::new(), Vec::new());
    // A case of minutes is killed once: the others make up for it.
    let is_slow = |case: &Case| matches!(case.cost, Cost::Minutes(_));
    let slow = CASES.iter().filter(|case| is_slow(case)).count();
    let kills_of = |case: &Case| match is_whole() && !is_slow(case) {
        true => (KILLS - slow).div_ceil(CASES.len() - slow),
        false => 1,
    };
    let attempts_of = |case: &Case| match is_whole() {
        true => kills_of(case) * ATTEMPTS,
        false => 1,
    };
    for case in CASES {
        if places_of(case).is_none() {
            continue;
        }
        let begun = Instant::now();
        let reference = Reference::of(&bench, case);
        let longest_us = begun.elapsed().as_micros() as u64 / 2;
        let mut missing = kills_of(case);
        for _ in 0..attempts_of(case) {
            if missing == 0 {
                break;
            }
            let before = bench.prepare(case);
            let mut child = bench.start(case, "0-");
            std::thread::sleep(Duration::from_micros(random.next_u64() % longest_us.max(1)));
            child.kill();
            let outcome = bench.end(child);
            let kind = match outcome.is_killed() {
                true => "killed at a random moment",
                false => "ended before",
            };
            missing -= usize::from(outcome.is_killed());
            *counts.entry(kind).or_insert(0) += 1;
            let fault = reference.fault(&bench, case, &before, &outcome, "", false);
            wrong.extend(fault.map(|fault| format!("{}: {fault}", case.line)));
        }
    }
    tell(&counts, &wrong);
}
