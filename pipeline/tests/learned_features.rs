//! Features of networks with their authors' weights: what another program computes, in maps and out of them.

use std::path::Path;

use lsfb_networks::{Model, Network, Trust, agreement};
use lsfb_pipeline::Error;
use lsfb_pipeline::features::{
    Feature, FeatureDetector, FrameFeatures, LearnedConfig, LearnedFeature, SiftConfig,
};
use lsfb_pipeline::hd_map::{HdMap, PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::localization::{Localizer, LocalizerConfig, localize_posed_images};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_tests::{published_weights, recordings};
use lsfb_types::{Image, no_progress};

fn config(weights: &Path) -> LearnedConfig {
    let network = Network::read(weights, Trust::Published).expect("published weights");
    let feature = LearnedFeature {
        model: network.model().name().to_owned(),
        weights_sha256: network.weights_sha256().to_owned(),
    };
    LearnedConfig::new(weights.to_owned(), feature)
}

#[test]
fn networks_compute_what_another_program_computes() {
    for model in Model::ALL {
        let test = "networks_compute_what_another_program_computes";
        let file = &format!("{}.safetensors", model.name());
        let Some(path) = published_weights(test, file) else {
            continue;
        };
        let network = Network::read(&path, Trust::Published).expect("published weights");
        let found = agreement(&network);
        assert!(
            found.len() == 2 && found.iter().all(|a| a.holds()),
            "{file}: {found:?}"
        );
        // One weight off by a thousandth is another network.
        let mut bytes = std::fs::read(&path).expect("a file");
        let last = bytes.len() - 3;
        bytes[last] ^= 1;
        let scratch = tempfile::tempdir().expect("folder");
        let other = scratch.path().join(file);
        std::fs::write(&other, &bytes).expect("a file");
        let refused = Network::read(&other, Trust::Published).expect_err("other weights");
        assert!(
            refused
                .to_string()
                .contains("differ from the published ones"),
            "{refused}"
        );
        bytes.truncate(bytes.len() / 2);
        std::fs::write(&other, &bytes).expect("a file");
        let refused = Network::read(&other, Trust::Any).expect_err("half a file");
        assert!(refused.to_string().contains("truncated"), "{refused}");
    }
}

/// Exported, its normalisation is folded into the convolutions: the same network, and known as such.
#[test]
fn exported_graphs_compute_the_same() {
    let test = "exported_graphs_compute_the_same";
    for model in [Model::XFeat, Model::AlikeT] {
        let Some(path) = published_weights(test, &format!("{}.onnx", model.name())) else {
            continue;
        };
        let network = Network::read(&path, Trust::Published).expect("an export of these");
        assert_eq!(network.model(), model);
        assert_eq!(Some(network.weights_sha256()), model.weights_sha256());
        let found = agreement(&network);
        assert!(
            found.iter().all(|a| a.holds()),
            "{}: {found:?}",
            path.display()
        );
        // As it is kept in the folder of weights.
        let scratch = tempfile::tempdir().expect("folder");
        let kept = scratch.path().join("kept.safetensors");
        std::fs::write(&kept, network.to_safetensors()).expect("written");
        let again = Network::read(&kept, Trust::Any).expect("the same");
        assert_eq!(again.weights_sha256(), network.weights_sha256());
        // One weight off is another network.
        let mut bytes = network.to_safetensors();
        let last = bytes.len() - 3;
        bytes[last] ^= 1;
        std::fs::write(&kept, bytes).expect("written");
        let refused = Network::read(&kept, Trust::Published).expect_err("other weights");
        assert!(
            matches!(refused, lsfb_networks::Error::UnknownWeights { .. }),
            "{refused}"
        );
    }
    for (file, expected) in [
        ("superpoint_arch_random.onnx", None),
        ("aliked-t16_gs.onnx", Some("36 GridSample")),
    ] {
        let Some(path) = published_weights(test, file) else {
            continue;
        };
        let read = Network::read(&path, Trust::Any).map(|n| n.model());
        match expected {
            None => assert_eq!(read.expect("known"), Model::SuperPoint),
            Some(found) => {
                let refused = read.expect_err("without its head").to_string();
                assert!(refused.contains(found), "{refused}");
            }
        }
    }
}

#[test]
fn a_map_of_learned_features_localizes_with_them_alone() {
    let test = "a_map_of_learned_features_localizes_with_them_alone";
    let Some(folder) = recordings(test, "vision/hololens_office") else {
        return;
    };
    let Some(weights) = published_weights(test, "alike-t.safetensors") else {
        return;
    };
    let mut all = PosedImages::read(&folder).expect("the recording");
    all.images.truncate(50);
    let (mapped, held_out) = (all.without_every(5), all.every(5));
    let config = PosedMapConfig {
        learned: Some(config(&weights)),
        ..PosedMapConfig::default()
    };
    let bytes = |threads: usize, out: &Path| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().expect("a pool");
        let built = pool.install(|| build_map_from_posed_images(&mapped, &config, &no_progress));
        built.expect("a map").write(out).expect("written");
        std::fs::read(out.join(HdMap::HEADER)).expect("a header")
    };
    let scratch = tempfile::tempdir().expect("scratch folder");
    let (one, three) = (scratch.path().join("1"), scratch.path().join("3"));
    assert!(
        bytes(1, &one) == bytes(3, &three),
        "another map on other threads"
    );

    let map = HdMap::open(&one).expect("opened");
    assert!(matches!(map.feature(), Feature::Learned(f) if f.model == "alike-t"));
    let localizer = Localizer::new(&map, &LocalizerConfig::default()).expect("valid");
    let learned = FeatureDetector::new(&config.sift, config.learned.as_ref()).expect("weights");
    let found = localize_posed_images(&localizer, &held_out, &learned, &no_progress);
    let found = found.expect("readable images");
    let right = found
        .iter()
        .filter(|f| f.distance_m().is_some_and(|d| d <= 0.10));
    assert!(right.count() >= 9, "{found:?}");

    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    let refused = localize_posed_images(&localizer, &held_out, &sift, &no_progress);
    assert!(
        matches!(refused, Err(Error::WrongFeature { .. })),
        "{refused:?}"
    );
}

/// A network takes a corner for its own mirror image: 27 of 74 mirrored images were placed in the map by XFeat.
#[test]
fn mirrored_images_are_refused_with_learned_features() {
    let test = "mirrored_images_are_refused_with_learned_features";
    let Some(folder) = recordings(test, "vision/hololens_office") else {
        return;
    };
    for file in ["xfeat.safetensors", "alike-t.safetensors"] {
        let Some(weights) = published_weights(test, file) else {
            return;
        };
        let mut all = PosedImages::read(&folder).expect("the recording");
        all.images.truncate(60);
        let config = PosedMapConfig {
            learned: Some(config(&weights)),
            ..PosedMapConfig::default()
        };
        let map = build_map_from_posed_images(&all.without_every(5), &config, &no_progress);
        let localizer = Localizer::new(&map.expect("a map"), &LocalizerConfig::default());
        let localizer = localizer.expect("valid");
        let detector = FeatureDetector::new(&config.sift, config.learned.as_ref());
        let mut detector = detector.expect("weights");
        let (mut accepted, mut as_they_are, mut of) = (0, 0, 0);
        for posed in &all.every(5).images {
            let mut image = posed.read(&all.rig).expect("an image");
            let mut localized = |image: &Image| {
                let frame = FrameFeatures {
                    camera: posed.camera.clone(),
                    features: detector.detect(image),
                };
                usize::from(localizer.localize(&[frame], &all.rig).is_ok())
            };
            as_they_are += localized(&image);
            let width = image.width as usize;
            image.pixels.chunks_mut(width).for_each(<[u8]>::reverse);
            accepted += localized(&image);
            of += 1;
        }
        assert!(
            accepted == 0 && as_they_are + 1 >= of,
            "{file}: {accepted} mirrored, {as_they_are} of {of}"
        );
    }
}
