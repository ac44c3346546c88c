use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use lsfb_types::no_progress;

/// A normal number by Irwin and Hall: close enough, and exact in its variance.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
}

fn at_rest(seconds: i64, rate_hz: i64, white: f64) -> Vec<(Timestamp, ImuSample)> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    (0..seconds * rate_hz)
        .map(|k| {
            let sample = ImuSample {
                angular_velocity_rad_s: [0; 3].map(|_| white * normal(&mut rng)),
                specific_force_m_s2: [0.1, -0.2, 9.8].map(|mean| mean + white * normal(&mut rng)),
            };
            (Timestamp::from_nanos(k * 1_000_000_000 / rate_hz), sample)
        })
        .collect()
}

#[test]
fn order_of_samples_does_not_matter_and_lost_ones_are_counted() {
    let mut samples = at_rest(120, 50, 0.01);
    samples.remove(1000);
    let config = ImuNoiseConfig::default();
    let found = imu_noise(&samples, &config, &no_progress).expect("noise");
    samples.reverse();
    assert_eq!(
        imu_noise(&samples, &config, &no_progress).expect("noise"),
        found
    );
    assert!(
        found.findings[0]
            .what
            .contains("1 of 6000 samples are missing")
    );
    let expected = 0.01 / 50f64.sqrt();
    assert!((found.gyro.density / expected - 1.0).abs() < 0.03);
    // Two minutes say nothing of a walk that is not there.
    assert!(
        found
            .findings
            .iter()
            .any(|f| f.what.contains("random walk stays"))
    );
    let page = found.page("Noise").to_html();
    assert!(page.contains("WARN: ") && page.contains("noise density"));
}

/// White noise and a walk that outweighs it after half a minute, two hours at 10 Hz.
fn walking(seed: u64, white: f64, walk: f64) -> Vec<(Timestamp, ImuSample)> {
    const RATE_HZ: i64 = 10;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let root_s = (RATE_HZ as f64).sqrt();
    let mut bias = [0.0; 6];
    (0..7200 * RATE_HZ)
        .map(|k| {
            let mut value = |axis: usize| {
                bias[axis] += walk / root_s * normal(&mut rng);
                bias[axis] + white * root_s * normal(&mut rng)
            };
            let sample = ImuSample {
                angular_velocity_rad_s: [value(0), value(1), value(2)],
                specific_force_m_s2: [value(3), value(4), value(5)],
            };
            (Timestamp::from_nanos(k * 1_000_000_000 / RATE_HZ), sample)
        })
        .collect()
}

/// Each axis is a recording of its own: 8 seeds are 48.
#[test]
fn errors_are_as_large_as_their_sigma_says() {
    let (white, walk) = (1e-3, 6e-5);
    let mut densities = Vec::new();
    let mut walks = Vec::new();
    for seed in 0..8 {
        let found = imu_noise(
            &walking(seed, white, walk),
            &ImuNoiseConfig::default(),
            &no_progress,
        );
        for axis in found.expect("noise").axes {
            densities.push((axis.noise.density - white) / axis.sigma.density);
            walks.push((axis.noise.walk - walk) / axis.sigma.walk);
        }
    }
    for (name, off) in [("density", densities), ("walk", walks)] {
        let squares: f64 = off.iter().map(|x| x * x).sum();
        let rms = (squares / off.len() as f64).sqrt();
        let worst = off.iter().fold(0.0_f64, |w, x| w.max(x.abs()));
        assert!(
            (0.7..1.35).contains(&rms) && worst < 4.0,
            "{name}: {rms} {worst}"
        );
    }
}

/// Once each of these came with a rig and without a word; of a dead axis the noise was 0 ± 0.
#[test]
fn what_no_imu_at_rest_measures_fails() {
    let samples = at_rest(120, 50, 0.01);
    let judged = |change: &dyn Fn(usize, &mut ImuSample)| {
        let mut changed = samples.clone();
        for (k, (_, sample)) in changed.iter_mut().enumerate() {
            change(k, sample);
        }
        let found = imu_noise(&changed, &ImuNoiseConfig::default(), &no_progress).expect("noise");
        let is_problem = |f: &&Finding| f.verdict != Verdict::Pass && f.code != "random-walk";
        let problems = found.findings.iter().filter(is_problem);
        problems
            .map(|f| (f.verdict, f.code.to_string()))
            .collect::<Vec<_>>()
    };
    let fail = |code: &str| vec![(Verdict::Fail, code.to_owned())];
    let scaled = |by: f64| {
        move |_: usize, s: &mut ImuSample| {
            s.specific_force_m_s2 = s.specific_force_m_s2.map(|f| by * f);
        }
    };
    assert_eq!(judged(&|_, _| ()), []);
    assert_eq!(judged(&scaled(1.02)), []);
    assert_eq!(judged(&scaled(1.0 / 9.81)), fail("gravity"));
    assert_eq!(judged(&scaled(1e3 / 9.81)), fail("gravity"));
    // Between two seconds, so that none of them spreads.
    let turned = judged(&|k, s| {
        if k >= 3000 {
            s.specific_force_m_s2[2] *= -1.0;
        }
    });
    assert!(turned.contains(&fail("rest")[0]), "{turned:?}");
    assert_eq!(
        judged(&|_, s| s.angular_velocity_rad_s[2] = 0.0),
        fail("axis")
    );
    assert_eq!(
        judged(&|_, s| s.angular_velocity_rad_s[1] = s.angular_velocity_rad_s[0]),
        fail("axis")
    );
    let held = judged(&|k, s| *s = samples[k / 10 * 10].1);
    assert_eq!(held, fail("repeated"));
    let in_degrees = judged(&|_, s| {
        s.angular_velocity_rad_s = s.angular_velocity_rad_s.map(f64::to_degrees);
    });
    assert_eq!(in_degrees, [(Verdict::Warn, "gyro-unit".to_owned())]);
}

#[test]
fn bad_input_is_named() {
    let config = ImuNoiseConfig::default();
    let error = |samples: &[(Timestamp, ImuSample)]| {
        let error = imu_noise(samples, &config, &no_progress).expect_err("bad input");
        error.to_string()
    };
    assert!(error(&[]).contains("there are no samples"));
    assert!(error(&at_rest(30, 50, 0.01)).contains("it lasts 30.0 s"));
    let mut moved = at_rest(100, 50, 0.01);
    moved[42 * 50 + 3].1.angular_velocity_rad_s[1] = 1.0;
    assert!(error(&moved).contains("it moves 42 s after the start"));
    let mut broken = at_rest(100, 50, 0.01);
    broken[7].1.specific_force_m_s2[2] = f64::NAN;
    assert!(error(&broken).contains("sample 7 is not a number"));
    let mut lossy = at_rest(100, 50, 0.01);
    lossy.drain(1000..1200);
    assert!(error(&lossy).contains("samples are missing"));
}
