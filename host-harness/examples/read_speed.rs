//! Read speed of recordings: `cargo run --release --example read_speed -- FILE...`
//!
//! Every file is read several times, verified to give the same events, and timed from opening to
//! the end. Printed are the median and the spread in million events per second.

use std::path::Path;
use std::time::Instant;

use host_harness::formats;

/// Timed runs of a file, after one that is not.
const RUNS: usize = 9;

fn main() -> anyhow::Result<()> {
    println!(
        "{:8} {:>10} {:>10} {:>10} {:>10}  file",
        "format", "events", "median", "min", "max"
    );
    for file in std::env::args().skip(1) {
        let (format, want) = read(Path::new(&file))?;
        let mut rates = Vec::new();
        for _ in 0..RUNS {
            let start = Instant::now();
            let (_, got) = read(Path::new(&file))?;
            let seconds = start.elapsed().as_secs_f64();
            anyhow::ensure!(got == want, "{file}: two runs differ");
            rates.push(got.0 as f64 / seconds / 1e6);
        }
        rates.sort_by(f64::total_cmp);
        let (median, min, max) = (rates[RUNS / 2], rates[0], rates[RUNS - 1]);
        println!(
            "{format:8} {:>10} {median:>10.2} {min:>10.2} {max:>10.2}  {file}",
            want.0
        );
    }
    Ok(())
}

/// Format, number of events and a sum over them.
fn read(path: &Path) -> anyhow::Result<(&'static str, (u64, u64))> {
    let mut reader = formats::open(path, None)?;
    let mut events = Vec::with_capacity(formats::BATCH_EVENTS);
    let (mut count, mut sum) = (0, 0_u64);
    while reader.read(&mut events)? > 0 {
        count += events.len() as u64;
        for event in events.drain(..) {
            let pixel = u64::from(event.x) << 16 ^ u64::from(event.y);
            sum = sum.wrapping_add(event.t_us.rotate_left(7) ^ pixel ^ event.polarity as u64);
        }
    }
    Ok((reader.format(), (count, sum)))
}
