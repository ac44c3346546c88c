//! Allan variance (IEEE 952-1997, annex C), overlapping.

use lsfb_types::{SharedProgress, Stopped};

/// Windows per decade of cluster times.
const PER_DECADE: f64 = 12.0;
/// Longest cluster time as a share of the recording: beyond it too few clusters are left.
const LONGEST_SHARE: f64 = 1.0 / 9.0;
/// Starts of clusters within one cluster: more say next to nothing new.
const STARTS: usize = 16;

/// The Allan variance at one cluster time.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Cluster {
    /// Length of a cluster, seconds.
    pub time_s: f64,
    /// Half the mean square of the difference of neighbouring clusters' means, squared units of the signal.
    pub variance: f64,
    /// How many independent differences that is worth.
    pub freedom: f64,
}

/// Cluster lengths, in samples, of a recording of `count`.
pub(super) fn lengths(count: usize) -> Vec<usize> {
    let longest = (count as f64 * LONGEST_SHARE) as usize;
    let mut lengths: Vec<usize> = (0..)
        .map(|k| 10f64.powf(f64::from(k) / PER_DECADE).round() as usize)
        .take_while(|m| *m <= longest)
        .collect();
    lengths.dedup();
    lengths
}

/// The Allan variance of samples `interval_s` apart at each of the `lengths`, each of which is a unit of the progress.
pub(super) fn allan(
    samples: &[f64],
    interval_s: f64,
    lengths: &[usize],
    progress: &SharedProgress<'_>,
) -> Result<Vec<Cluster>, Stopped> {
    // Sums about the mean: no digits are lost to it.
    let count = samples.len();
    let mean = samples.iter().sum::<f64>() / count.max(1) as f64;
    let mut sums = Vec::with_capacity(count + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for sample in samples {
        sum += sample - mean;
        sums.push(sum);
    }
    lengths
        .iter()
        .filter(|m| **m > 0 && 2 * **m <= count)
        .map(|&m| {
            progress.one_more()?;
            let stride = (m / STARTS).max(1);
            let (mut squares, mut differences) = (0.0, 0.0);
            for start in (0..=count - 2 * m).step_by(stride) {
                let difference = sums[start + 2 * m] - 2.0 * sums[start + m] + sums[start];
                squares += difference * difference;
                differences += 1.0;
            }
            let (n, length) = (count as f64, m as f64);
            // Overlapping clusters of white noise (Howe, Allan, Barnes 1981).
            let freedom = (1.5 * (n - 1.0) / length - 2.0 * (n - 2.0) / n) * 4.0 * length * length
                / (4.0 * length * length + 5.0);
            Ok(Cluster {
                time_s: length * interval_s,
                variance: squares / differences / (2.0 * length * length),
                freedom: freedom.max(1.0),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_types::no_progress;

    fn allan_of(samples: &[f64], lengths: &[usize]) -> Vec<Cluster> {
        let progress = SharedProgress::new("Allan variance", lengths.len(), &no_progress);
        allan(samples, 1.0, lengths, &progress).expect("nobody stops it")
    }

    #[test]
    fn known_series() {
        // The nine-point example of NIST SP 1065: frequencies with an Allan deviation of 91.22945 at 1 and
        // 85.95287 (overlapping) at 2.
        let nbs = [
            892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0,
        ];
        let found = allan_of(&nbs, &[1, 2]);
        assert!((found[0].variance.sqrt() - 91.229_45).abs() < 1e-4);
        assert!((found[1].variance.sqrt() - 85.952_87).abs() < 1e-4);
    }

    #[test]
    fn a_ramp_has_the_slope_of_its_deviation() {
        // y = c t: the Allan deviation is c τ / √2.
        let ramp: Vec<f64> = (0..1000).map(|k| 0.5 * f64::from(k)).collect();
        for cluster in allan_of(&ramp, &lengths(ramp.len())) {
            let expected = 0.5 * cluster.time_s / 2f64.sqrt();
            assert!((cluster.variance.sqrt() / expected - 1.0).abs() < 1e-9);
        }
    }
}
