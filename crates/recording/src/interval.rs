//! How far apart the samples of a device are.

use lsfb_types::Timestamp;

/// Steps this many times as long as usual are gaps, steps this many times as short are repetitions: neither says anything.
const ODD: f64 = 3.0;

/// The mean interval of samples whose stamps jitter and have gaps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SampleInterval {
    last: Option<Timestamp>,
    sum_s: f64,
    steps: u32,
}

impl SampleInterval {
    /// Takes the next stamp; the interval so far, seconds, and `None` for the first stamp.
    pub fn secs(&mut self, time: Timestamp) -> Option<f64> {
        let step_s = self.last.map(|last| time.secs_since(last));
        self.last = Some(time);
        if let Some(step_s) = step_s.filter(|step_s| *step_s > 0.0) {
            let usual = self.mean_s().unwrap_or(step_s);
            if step_s > ODD * usual || usual > ODD * step_s {
                // Where the first step was a gap, the next one begins anew.
                if self.steps < 2 {
                    (self.sum_s, self.steps) = (step_s, 1);
                }
            } else {
                self.sum_s += step_s;
                self.steps += 1;
            }
        }
        self.mean_s()
    }

    fn mean_s(&self) -> Option<f64> {
        (self.steps > 0).then(|| self.sum_s / f64::from(self.steps))
    }
}

#[test]
fn gaps_and_jitter_leave_the_interval_as_it_is() {
    let mut interval = SampleInterval::default();
    let mut time = Timestamp::from_nanos(1_772_359_200_000_000_000);
    assert_eq!(interval.secs(time), None);
    // The first step of all is a gap; so is every hundredth.
    for n in 0..1000_i64 {
        time =
            time + 5_000_000 + (n % 3 - 1) * 400_000 + if n % 100 == 0 { 900_000_000 } else { 0 };
        interval.secs(time);
    }
    let found = interval.secs(time).expect("many steps");
    assert!((found - 0.005).abs() < 1e-5, "{found}");
}
