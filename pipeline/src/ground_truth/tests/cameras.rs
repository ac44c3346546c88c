//! Cameras that are not what the rig file says, and read their rows out one after the other.

use super::*;
use crate::residuals::entry;

/// Wrong by 0.2 % of the focal length, 0.2°, 2 mm and 1 ms; rows read out in 20 ms, which the file does not say.
fn off() -> CameraCorrection {
    let mut off = CameraCorrection::zeros();
    off[entry::TURN + 1] = 3.5e-3;
    off[entry::SHIFT] = 2e-3;
    off[entry::FOCAL] = 2e-3;
    off[entry::CLOCK] = 1e-3;
    off[entry::READOUT] = 0.02;
    off
}

fn solved(config: &GroundTruthConfig) -> (Walk, Solved) {
    let MadeUp { mut walk, features } = make_walk_with(220, 220, |_| true, &off());
    let start = started(&walk, config);
    let solved = solve_walk(&mut walk, &start, &features, config, &no_progress).expect("solves");
    (walk, solved)
}

#[test]
fn readout_clock_and_lens_are_found() {
    let (walk, found) = solved(&GroundTruthConfig::default());
    let estimate = &found.last.estimate;
    let found_m = errors(&walk, &estimate.states).rms_m;
    assert!(found_m < 0.003, "rms {found_m} m");
    for correction in &estimate.corrections {
        let wrong = correction - off();
        assert!(wrong[entry::READOUT].abs() < 1e-3, "{wrong}");
        assert!(wrong[entry::CLOCK].abs() < 1e-3, "{wrong}");
        assert!(wrong[entry::FOCAL].abs() < 1e-3, "{wrong}");
        // A turn that all cameras share is told from one of the rig by the IMU alone: it stays where the file has it, nearly.
        let turn = wrong.fixed_rows::<3>(entry::TURN).norm();
        assert!(turn < off()[entry::TURN + 1], "{wrong}");
    }

    // As well as it is said to be known.
    let config = GroundTruthConfig::default();
    let points = &found.last.points;
    let said = uncertainty(&walk, estimate, points, &config, &no_progress).expect("covariances");
    let found = estimate.corrections.iter().zip(&said.corrections);
    for ((correction, sigmas), camera) in found.zip(&walk.cameras) {
        let wrong = (correction - off()).component_div(sigmas);
        for named in [entry::FOCAL, entry::CLOCK, entry::READOUT] {
            assert!(wrong[named].abs() < 4.0, "{named}: {wrong} of {sigmas}");
        }
        let known = config.calibration_sigmas(camera);
        assert!(
            sigmas[entry::READOUT] < 0.1 * known[entry::READOUT],
            "{sigmas}"
        );
    }

    // Taken at its word, the rig file spoils the walk.
    let certain = GroundTruthConfig {
        extrinsics_sigma_rad: 1e-9,
        extrinsics_sigma_m: 1e-9,
        focal_sigma: 1e-9,
        camera_clock_sigma_s: 1e-9,
        readout_sigma_s: 1e-9,
        ..GroundTruthConfig::default()
    };
    let (walk, believed) = solved(&certain);
    let believed_m = errors(&walk, &believed.last.estimate.states).rms_m;
    assert!(believed_m > 2.0 * found_m, "{believed_m} m, {found_m} m");
}

/// What the rig file says of how well a camera is known counts, and what it leaves out is as the settings say.
#[test]
fn a_camera_is_known_as_well_as_its_calibration_says() {
    let config = GroundTruthConfig::default();
    let known = |sigmas| config.calibration_sigmas(&camera_of_glasses(0.0, sigmas));
    let unsaid = known(CameraSigmas::default());
    assert_eq!(unsaid[entry::TURN], config.extrinsics_sigma_rad);
    assert_eq!(unsaid[entry::READOUT], config.readout_sigma_s);
    let said = known(CameraSigmas {
        rotation_rad: Some([1e-3, 5e-4, 1e-9]),
        focal_share: Some(4e-3),
        ..CameraSigmas::default()
    });
    assert!(said[entry::TURN] < config.extrinsics_sigma_rad);
    assert!(said[entry::TURN + 1] < said[entry::TURN]);
    // It was warm since, and fell down once.
    assert!(said[entry::TURN + 2] > 1e-4, "{said}");
    assert!(said[entry::FOCAL] > config.focal_sigma);
    let rest = [entry::SHIFT, entry::CLOCK, entry::READOUT];
    assert!(rest.iter().all(|k| said[*k] == unsaid[*k]), "{said}");
}
