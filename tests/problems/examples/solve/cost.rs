//! What a run costs: included by the other examples.

use nix::time::{ClockId, clock_gettime};

/// CPU time of this process, all threads, seconds.
pub fn cpu_secs() -> f64 {
    clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)
        .map_or(f64::NAN, |t| t.tv_sec() as f64 + 1e-9 * t.tv_nsec() as f64)
}

/// Most memory this process ever held, MB.
pub fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kb| kb / 1024.0)
}

/// The text of a file, unpacked if its name ends in `.gz`.
pub fn read_text(path: &str) -> std::io::Result<String> {
    let file = std::fs::File::open(path)?;
    let mut text = String::new();
    if path.ends_with(".gz") {
        std::io::Read::read_to_string(&mut flate2::read::GzDecoder::new(file), &mut text)?;
    } else {
        std::io::Read::read_to_string(&mut std::io::BufReader::new(file), &mut text)?;
    }
    Ok(text)
}
