//! Processor time and memory used by this process, read from Linux's `/proc`.

/// Processor time and memory at one moment; `None` where the system has no `/proc`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    cpu_s: Option<f64>,
    /// Peak resident memory, in bytes.
    pub memory_peak_bytes: Option<u64>,
}

impl Usage {
    /// Returns the usage up to now.
    #[must_use]
    pub fn now() -> Self {
        Self {
            cpu_s: cpu_s(),
            memory_peak_bytes: std::fs::read_to_string("/proc/self/status")
                .ok()
                .as_deref()
                .and_then(peak_bytes),
        }
    }

    /// Returns the processor time of all threads since this snapshot, in seconds; 0 where the system does not
    /// report it.
    #[must_use]
    pub fn cpu_s(&self) -> f64 {
        match (Self::now().cpu_s, self.cpu_s) {
            (Some(now), Some(then)) => now - then,
            _ => 0.0,
        }
    }
}

/// Returns user plus system time of all threads of the process, including ended ones, in seconds.
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The process name, in brackets, may itself contain spaces and brackets.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
    // Linux counts in units of 1/100 s here, whatever the kernel's tick rate.
    Some((ticks(11)? + ticks(12)?) / 100.0)
}

fn peak_bytes(status: &str) -> Option<u64> {
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_time_and_memory() {
        if std::fs::metadata("/proc/self/stat").is_err() {
            println!("skipped: there is no /proc");
            return;
        }
        let before = Usage::now();
        let mut sum = 0_u64;
        while before.cpu_s() < 0.05 {
            sum = (0..100_000).fold(sum, |sum: u64, i| std::hint::black_box(sum.wrapping_add(i)));
        }
        let bytes = vec![1_u8; 1 << 24];
        assert_eq!(
            bytes.iter().map(|byte| u64::from(*byte)).sum::<u64>(),
            1 << 24
        );
        assert!(Usage::now().memory_peak_bytes.unwrap() > 1 << 24);
    }
}
