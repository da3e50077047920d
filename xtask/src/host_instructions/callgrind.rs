//! Runs the cases under Callgrind and reads what it wrote.

use std::collections::BTreeMap;
use std::env::{self, consts};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use anyhow::{Context, ensure};
use object::{Object, ObjectSymbol};

use super::cases::{self, Case};
use super::counts::{Count, Counts};

/// The function of `cases` inside of which instructions count.
const COUNTED: &str = "count_these";

/// Features of the processor that the compiler may have been told to use.
macro_rules! features {
    ($($name:literal)*) => {
        [$((cfg!(target_feature = $name)).then_some($name)),*].into_iter().flatten()
    };
}

/// The instructions of every case.
pub fn measure() -> anyhow::Result<Counts> {
    ensure!(
        Command::new("valgrind").arg("--version").output().is_ok(),
        "valgrind is missing: apt-get install valgrind"
    );
    let folder = tempfile::tempdir().context("cannot create a folder for the inputs")?;
    let folder = folder.path();
    cases::prepare(folder)?;
    // Natively first: which cases there are, and that their answers are right.
    let cases = cases::run(folder)?;
    let profile = folder.join("callgrind.out");
    let program = env::current_exe().context("cannot find this program's own file")?;
    let counted = symbol(&program)?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--demangle=no"])
        .args(["--compress-strings=no", "--compress-pos=no"])
        .arg(format!("--toggle-collect={counted}"))
        .arg(format!("--dump-after={counted}"))
        .arg(format!("--callgrind-out-file={}", profile.display()))
        .arg(&program)
        .arg("host-cases")
        .arg(folder)
        .output()
        .context("valgrind cannot be started")?;
    ensure!(
        output.status.success(),
        "valgrind: {}:\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    let cases = cases
        .into_iter()
        .enumerate()
        .map(|(i, (name, events)): (usize, Case)| {
            let file = profile.with_extension(format!("out.{}", i + 1));
            let count = || {
                let text = fs::read_to_string(&file).context("cannot read the profile")?;
                count(&text, &program, events)
            };
            let count = count().with_context(|| format!("{}: {name}", file.display()))?;
            Ok((name, count))
        })
        .collect::<anyhow::Result<BTreeMap<_, _>>>()?;
    Ok(Counts {
        rustc: rustc()?,
        target: target(),
        cases,
    })
}

/// The name of `COUNTED` as the linker has it. With a pattern in its place, Callgrind 3.19 counts,
/// but writes no file when the function returns.
fn symbol(program: &Path) -> anyhow::Result<String> {
    let bytes = fs::read(program)?;
    let file = object::File::parse(&*bytes)?;
    let mut names = file.symbols().filter_map(|symbol| symbol.name().ok());
    let name = names.find(|name| name.contains(COUNTED));
    Ok(name.context("a program without symbols")?.to_owned())
}

/// The instructions of a profile, those of the program apart.
fn count(profile: &str, program: &Path, events: usize) -> anyhow::Result<Count> {
    let (mut instructions, mut elsewhere) = (0, 0);
    let mut is_own = false;
    let mut lines = profile.lines();
    while let Some(line) = lines.next() {
        if let Some(object) = line.strip_prefix("ob=") {
            is_own = Path::new(object) == program;
        } else if line.starts_with("calls=") {
            // What follows is the cost of a call, whose own lines are elsewhere.
            lines.next();
        } else if line.starts_with(|first: char| first.is_ascii_digit()) {
            let cost = line.split_ascii_whitespace().nth(1).unwrap_or("0");
            let cost: u64 = cost
                .parse()
                .with_context(|| format!("not a cost line: {line}"))?;
            *(if is_own {
                &mut instructions
            } else {
                &mut elsewhere
            }) += cost;
        }
    }
    let total = format!("summary: {}", instructions + elsewhere);
    ensure!(
        instructions > 0 && profile.lines().any(|line| line == total),
        "the counts do not add up to those of Callgrind"
    );
    Ok(Count {
        events,
        instructions,
        elsewhere,
    })
}

/// The compiler: another one makes other code.
fn rustc() -> anyhow::Result<String> {
    let Output { stdout, .. } = Command::new("rustc")
        .arg("--version")
        .output()
        .context("rustc cannot be started")?;
    Ok(String::from_utf8_lossy(&stdout).trim().to_owned())
}

/// What the compiler made code for, and the vectors that are looked for when the program runs.
fn target() -> String {
    let mut target = format!("{} {}", consts::ARCH, consts::OS);
    for feature in features!("avx" "avx2" "avx512f" "bmi1" "bmi2" "fma" "popcnt" "sse3" "sse4.2") {
        target += " +";
        target += feature;
    }
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        target += ", avx2 at run time";
    }
    target
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_read_by_object() {
        let profile = "events: Ir\nsummary: 48\n\nob=/a\nfn=f\n10 5\n11 3\ncob=/c\ncfn=g\ncalls=2 7\n\
                       12 40\n\nob=/c\nfn=g\n7 40\n\ntotals: 48\n";
        let found = count(profile, Path::new("/a"), 4).unwrap();
        assert_eq!((found.instructions, found.elsewhere), (8, 40));
        assert!(count(profile, Path::new("/b"), 4).is_err());
        assert!(count(&profile.replace("48", "49"), Path::new("/a"), 4).is_err());
    }
}
