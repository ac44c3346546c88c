//! Whether a recording was made as fast as what it shows happened.
//!
//! A replay or a simulation may run faster than real time: then arrivals say nothing about rates, silences and clocks.

/// Seconds of the devices per second of arrivals beyond which a recording was not made in real time. Quartzes differ by a
/// ten-thousandth, what a queue holds back at the ends of a short recording by some tenths.
pub(crate) const FASTEST: f64 = 1.5;
/// Shortest span, by the devices' stamps, that is compared, seconds.
const SHORTEST_SECS: f64 = 1.0;

/// Seconds of a device's stamps per second of arrivals; `None` where there is too little to compare.
pub(crate) fn pace(stamped_secs: f64, arrived_secs: f64) -> Option<f64> {
    (stamped_secs >= SHORTEST_SECS).then(|| stamped_secs / arrived_secs.max(1e-9))
}

/// The slowest of the paces, where all of them say that a recording was made faster than real time. One device alone whose stamps
/// run ahead has a clock that was set.
pub(crate) fn faster_than_real_time(paces: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let slowest = paces.flatten().reduce(f64::min)?;
    (slowest > FASTEST).then_some(slowest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_replay_is_known_by_all_its_devices() {
        let all = |paces: &[f64]| faster_than_real_time(paces.iter().copied().map(Some));
        assert_eq!(all(&[40.0, 37.0, 52.0]), Some(37.0));
        // A clock that was set ahead must not hide the silences of a recording in real time.
        assert_eq!(all(&[40.0, 1.0]), None);
        assert_eq!(all(&[]), None);
        assert_eq!(
            faster_than_real_time([None, Some(3.0)].into_iter()),
            Some(3.0)
        );
        assert_eq!(pace(0.5, 0.1), None);
        assert_eq!(pace(10.0, 5.0), Some(2.0));
    }
}
