//! The simulated glasses through the whole protocol: what they measured is what is recorded.

use std::sync::Arc;

use lsfb_recording::message::{decode_image, decode_imu};
use lsfb_sim::{Pace, SimConfig, SimSession, Simulation};

use super::*;

#[test]
fn simulated_glasses_are_recorded_as_they_measured() {
    let mut settings = SimConfig::tiny();
    settings.texel_m = 0.05;
    settings.scan.duration_s = 1.2;
    settings.glasses.duration_s = 1.2;
    let simulation = Arc::new(Simulation::new(&settings, &no_progress).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let config = DevicesConfig {
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let rig = mock::invited(&session, folder.path());
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let glasses =
        SimSession::start_glasses(&simulation, &rig, Pace::Unlimited, Duration::from_secs(20))
            .unwrap();
    let sent = glasses.join(&no_progress).unwrap();
    let report = running.join().unwrap();
    assert_eq!(report.lost, 0, "{report:?}");
    assert_eq!(stream(&report, "sidecar").decoded, sent.sidecar_messages);
    let truth = simulation.glasses();
    let recording = Recording::open(&out).unwrap();
    let messages = |topic: &str| recording.messages(topic).unwrap().map(Result::unwrap);
    let mut samples = 0;
    for (message, expected) in messages("/sidecar/glasses/imu").zip(truth.imu()) {
        assert_eq!(message.time, truth.time(expected.offset_ns));
        assert_eq!(decode_imu(&message.bytes).unwrap(), expected.sample);
        samples += 1;
    }
    assert_eq!(samples, 241);
    for camera in 0..2 {
        let topic = format!("/sidecar/glasses/cam{camera}/image");
        let images: Vec<_> = messages(&topic).collect();
        assert_eq!(images.len(), 12);
        for (frame, message) in (0..).zip(&images) {
            let expected = truth.image(simulation.world(), camera, frame).unwrap();
            assert_eq!(message.time, expected.time);
            assert!(decode_image(&message.bytes).unwrap().pixels == expected.sample.pixels);
        }
    }
    // A magnetometer and a barometer among them, for 1.2 s.
    let around = sent.sidecar_messages - 241 - 24;
    let expected = simulation
        .surroundings()
        .messages(simulation.world(), truth.walk());
    assert!(around > 120 && around == expected.len() as u64, "{around}");
}
