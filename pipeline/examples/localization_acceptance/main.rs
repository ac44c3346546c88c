//! What the localizer accepts: images of the place of the map, of other places, mirrored, turned and of the wrong size.
//!
//! `cargo run --release -p lsfb-pipeline --example localization_acceptance -- DATA [--feature F]… [--maps DIR] [--csv FILE] [--every N]`
//!
//! `--feature` is `sift` (the default) or a network's file of published weights (`.safetensors`), and may be given several times.
//!
//! `DATA` is the folder of recordings made by others. A map of `--maps` that is already there is taken as it is: to be
//! removed by hand when the making of maps has changed. `--every` takes each N-th of the images that are disturbed or of another place (default 2).

#![allow(clippy::print_stdout)] // a program, not a library

mod disturbances;
mod places;
mod table;

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use disturbances::{AMONG_OTHERS, Disturbance, Query};
use lsfb_geometry::Rig;
use lsfb_networks::{Network, Trust};
use lsfb_perception::image;
use lsfb_pipeline::features::{
    FeatureDetector, Features, FrameFeatures, LearnedConfig, LearnedFeature,
};
use lsfb_pipeline::hd_map::{HdMap, PosedMapConfig, build_map_from_posed_images};
use lsfb_pipeline::localization::{
    Localization, Localizer, LocalizerConfig, NotLocalized, judge_together,
};
use lsfb_types::{Image, no_progress};
use places::Place;
use rayon::prelude::*;
use table::{Outcome, Row};

struct Arguments {
    data: PathBuf,
    features: Vec<Option<LearnedConfig>>,
    maps: Option<PathBuf>,
    csv: Option<PathBuf>,
    every: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = arguments()?;
    let places = places::read_all(&arguments.data)?;
    let strangers = places::strangers(&arguments.data)?;
    let mut rows = Vec::new();
    for learned in &arguments.features {
        let config = PosedMapConfig {
            learned: learned.clone(),
            ..PosedMapConfig::default()
        };
        for (index, place) in places.iter().enumerate() {
            let queries = queries(&places, index, &strangers, arguments.every);
            rows.extend(localize(
                place,
                &queries,
                &config,
                arguments.maps.as_deref(),
            )?);
        }
    }
    print!("{}", table::summary(&rows));
    if let Some(path) = &arguments.csv {
        std::fs::write(path, table::csv(&rows))?;
    }
    Ok(())
}

fn network(weights: &Path) -> Result<LearnedConfig, Box<dyn Error>> {
    let network = Network::read(weights, Trust::Published)?;
    let feature = LearnedFeature {
        model: network.model().name().to_owned(),
        weights_sha256: network.weights_sha256().to_owned(),
    };
    Ok(LearnedConfig::new(weights.to_owned(), feature))
}

/// Images of the place, disturbed, and every so many of the other places and of strangers.
fn queries(places: &[Place], index: usize, strangers: &[PathBuf], every: usize) -> Vec<Query> {
    let place = &places[index];
    let mut queries: Vec<Query> = Vec::new();
    for (number, image) in place.queries.images.iter().enumerate() {
        let disturbances = match number % every {
            0 => &Disturbance::ALL[..],
            _ => &[Disturbance::None],
        };
        let disturbed = disturbances.iter().map(|d| Query::of(place, image, *d));
        queries.extend(disturbed);
    }
    let others = places
        .iter()
        .enumerate()
        .filter(|(other, _)| *other != index);
    let elsewhere = others
        .flat_map(|(_, other)| other.images())
        .chain(strangers.iter().cloned())
        .step_by(every);
    queries.extend(elsewhere.map(|path| Query::elsewhere(place, path)));
    queries
}

fn localize(
    place: &Place,
    queries: &[Query],
    config: &PosedMapConfig,
    maps: Option<&Path>,
) -> Result<Vec<Row>, Box<dyn Error>> {
    let detector = FeatureDetector::new(&config.sift, config.learned.as_ref())?;
    let feature = match &config.learned {
        Some(learned) => learned.feature.model.clone(),
        None => "sift".to_owned(),
    };
    let map = map_of(place, config, maps.map(|m| m.join(&feature)).as_deref())?;
    let localizer = Localizer::new(&map, &LocalizerConfig::default())?;
    let found: Result<Vec<Answer>, String> = queries
        .par_iter()
        .map_init(
            || Memory {
                detector: detector.clone(),
                last: None,
            },
            |memory, query| answer(&localizer, place, query, memory),
        )
        .collect();
    // What is done to images of the place makes a camera of its own.
    let mut of_kind: BTreeMap<String, (Vec<&Query>, Vec<Answer>)> = BTreeMap::new();
    for (query, found) in queries.iter().zip(found?) {
        let (queries, answers) = of_kind.entry(query.kind()).or_default();
        queries.push(query);
        answers.push(found);
    }
    let row = |kind: &str, query: &Query, found: &Answer| Row {
        feature: feature.clone(),
        place: place.name,
        kind: kind.to_owned(),
        image: query.name(),
        outcome: Outcome::new(found, query, place),
    };
    let mut rows = Vec::new();
    for percent in AMONG_OTHERS {
        let kind = Disturbance::WrongFocal(percent).name();
        let Some((odd, usual)) = of_kind
            .get(&kind)
            .zip(of_kind.get(&Disturbance::None.name()))
        else {
            continue;
        };
        for (query, answer) in odd.0.iter().zip(&odd.1) {
            let others = usual.0.iter().zip(&usual.1);
            let others = others.filter(|(other, _)| other.path != query.path);
            let mut all: Vec<Answer> = others.map(|(_, answer)| answer.clone()).collect();
            all.push(answer.clone());
            let judged = judge_together(all, localizer.min_probability());
            let judged = judged.last().unwrap_or(answer);
            rows.push(row(&format!("{kind}, among others"), query, judged));
        }
    }
    for (kind, (queries, answers)) in of_kind {
        let judged = match queries[0].is_elsewhere() {
            true => answers,
            false => judge_together(answers, localizer.min_probability()),
        };
        rows.extend(
            queries
                .into_iter()
                .zip(&judged)
                .map(|(query, found)| row(&kind, query, found)),
        );
    }
    Ok(rows)
}

type Answer = Result<Localization, NotLocalized>;

fn arguments() -> Result<Arguments, Box<dyn Error>> {
    let mut given = std::env::args().skip(1);
    let data = given.next().ok_or("give the folder of recordings")?.into();
    let mut arguments = Arguments {
        data,
        features: Vec::new(),
        maps: None,
        csv: None,
        every: 2,
    };
    while let Some(name) = given.next() {
        let value = given.next().ok_or(format!("{name} needs a value"))?;
        match name.as_str() {
            "--feature" if value == "sift" => arguments.features.push(None),
            "--feature" => arguments.features.push(Some(network(Path::new(&value))?)),
            "--maps" => arguments.maps = Some(value.into()),
            "--csv" => arguments.csv = Some(value.into()),
            "--every" => arguments.every = value.parse::<usize>()?.max(1),
            _ => return Err(format!("unknown option {name}").into()),
        }
    }
    if arguments.features.is_empty() {
        arguments.features.push(None);
    }
    Ok(arguments)
}

fn map_of(
    place: &Place,
    config: &PosedMapConfig,
    maps: Option<&Path>,
) -> Result<HdMap, Box<dyn Error>> {
    let folder = maps.map(|m| m.join(place.name));
    if let Some(folder) = folder.as_ref().filter(|f| f.exists()) {
        return Ok(HdMap::open(folder)?);
    }
    let map = build_map_from_posed_images(&place.mapped, config, &no_progress)?;
    if let Some(folder) = folder {
        map.write(&folder)?;
    }
    Ok(map)
}

/// The detector, and what it found last: what is done to the camera alone leaves the features as they are.
struct Memory {
    detector: FeatureDetector,
    last: Option<(Image, Features)>,
}

impl Memory {
    fn features(&mut self, image: Image) -> Features {
        match &self.last {
            Some((last, features)) if last.pixels == image.pixels => features.clone(),
            _ => {
                let features = self.detector.detect(&image);
                self.last = Some((image, features.clone()));
                features
            }
        }
    }
}

fn answer(
    localizer: &Localizer,
    place: &Place,
    query: &Query,
    memory: &mut Memory,
) -> Result<Answer, String> {
    let image = image::read(&query.path).map_err(|e| e.to_string())?;
    let (image, camera) = query.disturbed(image).map_err(|e| e.to_string())?;
    let mut rig: Rig = place.queries.rig.clone();
    for mounted in rig.cameras.values_mut() {
        mounted.camera = camera;
    }
    let frame = FrameFeatures {
        camera: places::CAMERA.to_owned(),
        features: query.thinned(memory.features(image)),
    };
    Ok(localizer.localize(&[frame], &rig))
}
