//! Maps of a network's features.

use lsfb_networks::{Network, Trust};
use lsfb_recording::Recording;
use lsfb_tests::published_weights;
use lsfb_types::no_progress;

use super::recorded::{WALK_FRAMES, frame_time, map_of, record, rig};
use super::truth;
use crate::Error;
use crate::features::{FeatureDetector, LearnedConfig, LearnedFeature, SiftConfig};
use crate::ground_truth::{GroundTruthConfig, ground_truth};

#[test]
fn a_walk_is_placed_in_a_map_of_learned_features() {
    let test = "a_walk_is_placed_in_a_map_of_learned_features";
    let Some(weights) = published_weights(test, "xfeat.safetensors") else {
        return;
    };
    let network = Network::read(&weights, Trust::Published).expect("published weights");
    let feature = LearnedFeature {
        model: network.model().name().to_owned(),
        weights_sha256: network.weights_sha256().to_owned(),
    };
    let learned = LearnedConfig::new(weights, feature);
    let detector = FeatureDetector::new(&SiftConfig::default(), Some(&learned)).expect("a network");
    let map = map_of(1, &detector);
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    record(&path, 1, WALK_FRAMES, &rig(), usize::MAX);
    let recording = Recording::open(&path).expect("a recording");
    let config = GroundTruthConfig {
        learned: Some(learned),
        ..GroundTruthConfig::default()
    };
    let found = ground_truth(&recording, &map, &config, &no_progress).expect("ground truth");
    assert!(
        found.trajectory.len() + 1 >= WALK_FRAMES,
        "{:#?}",
        found.report
    );
    let first = found.trajectory.poses()[0].time;
    let skipped = (0..WALK_FRAMES)
        .find(|k| (first.nanos() as f64 * 1e-9 - frame_time(*k)).abs() < 1e-3)
        .expect("a frame");
    for (k, pose) in found.trajectory.poses().iter().enumerate() {
        let error = truth(frame_time(k + skipped)).inverse() * pose.world_from_rig;
        let distance = error.translation.norm();
        assert!(distance < 0.02, "frame {k}: {distance} m");
    }
    // Features of another kind are told before an image is read.
    let sift = GroundTruthConfig::default();
    let refused = ground_truth(&recording, &map, &sift, &no_progress).expect_err("other features");
    assert!(matches!(refused, Error::WrongFeature { .. }), "{refused}");
}
