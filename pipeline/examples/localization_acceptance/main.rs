//! What the localizer accepts: images of the place of the map, of other places, mirrored, turned and of the wrong size.
//!
//! `cargo run --release -p lsfb-pipeline --example localization_acceptance -- DATA [--maps DIR] [--csv FILE] [--every N]`
//!
//! `DATA` is the folder of recordings made by others. A map of `--maps` that is already there is taken as it is: to be
//! removed by hand when the making of maps has changed. `--every` takes each N-th of the images that are disturbed or of another place (default 2).

#![allow(clippy::print_stdout)] // a program, not a library

mod disturbances;
mod places;
mod table;

use std::error::Error;
use std::path::{Path, PathBuf};

use disturbances::{Disturbance, Query};
use lsfb_geometry::Rig;
use lsfb_perception::image;
use lsfb_pipeline::features::{FrameFeatures, SiftConfig, SiftDetector};
use lsfb_pipeline::hd_map::{HdMap, build_map_from_posed_images};
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_types::no_progress;
use places::Place;
use rayon::prelude::*;
use table::{Outcome, Row};

struct Arguments {
    data: PathBuf,
    maps: Option<PathBuf>,
    csv: Option<PathBuf>,
    every: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = arguments()?;
    let places = places::read_all(&arguments.data)?;
    let strangers = places::strangers(&arguments.data)?;
    let mut rows = Vec::new();
    for (index, place) in places.iter().enumerate() {
        let map = map_of(place, arguments.maps.as_deref())?;
        let localizer = Localizer::new(&map, &LocalizerConfig::default())?;
        let mut queries: Vec<Query> = Vec::new();
        for disturbance in Disturbance::ALL {
            let every = match disturbance {
                Disturbance::None => 1,
                _ => arguments.every,
            };
            let images = place.queries.images.iter().step_by(every);
            queries.extend(images.map(|i| Query::of(place, i, disturbance)));
        }
        let others = places
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index);
        let elsewhere = others
            .flat_map(|(_, other)| other.images())
            .chain(strangers.iter().cloned())
            .step_by(arguments.every);
        queries.extend(elsewhere.map(|path| Query::elsewhere(place, path)));
        let found: Vec<Row> = queries
            .par_iter()
            .map_init(detector, |detector, query| {
                row(&localizer, place, query, detector)
            })
            .collect::<Result<_, _>>()?;
        rows.extend(found);
    }
    print!("{}", table::summary(&rows));
    if let Some(path) = &arguments.csv {
        std::fs::write(path, table::csv(&rows))?;
    }
    Ok(())
}

fn arguments() -> Result<Arguments, Box<dyn Error>> {
    let mut given = std::env::args().skip(1);
    let data = given.next().ok_or("give the folder of recordings")?.into();
    let mut arguments = Arguments {
        data,
        maps: None,
        csv: None,
        every: 2,
    };
    while let Some(name) = given.next() {
        let value = given.next().ok_or(format!("{name} needs a value"))?;
        match name.as_str() {
            "--maps" => arguments.maps = Some(value.into()),
            "--csv" => arguments.csv = Some(value.into()),
            "--every" => arguments.every = value.parse::<usize>()?.max(1),
            _ => return Err(format!("unknown option {name}").into()),
        }
    }
    Ok(arguments)
}

fn map_of(place: &Place, maps: Option<&Path>) -> Result<HdMap, Box<dyn Error>> {
    let folder = maps.map(|m| m.join(place.name));
    if let Some(folder) = folder.as_ref().filter(|f| f.exists()) {
        return Ok(HdMap::open(folder)?);
    }
    let map = build_map_from_posed_images(&place.mapped, &place.map_config, &no_progress)?;
    if let Some(folder) = folder {
        map.write(&folder)?;
    }
    Ok(map)
}

fn detector() -> Option<SiftDetector> {
    SiftDetector::new(&SiftConfig::default()).ok()
}

fn row(
    localizer: &Localizer,
    place: &Place,
    query: &Query,
    detector: &mut Option<SiftDetector>,
) -> Result<Row, String> {
    let detector = detector.as_mut().ok_or("no detector")?;
    let image = image::read(&query.path).map_err(|e| e.to_string())?;
    let (image, camera) = query.disturbed(image);
    let mut rig: Rig = place.queries.rig.clone();
    for mounted in rig.cameras.values_mut() {
        mounted.camera = camera;
    }
    let frame = FrameFeatures {
        camera: places::CAMERA.to_owned(),
        features: query.thinned(detector.detect(&image)),
    };
    Ok(Row {
        place: place.name,
        kind: query.kind(),
        image: query.name(),
        outcome: Outcome::new(&localizer.localize(&[frame], &rig), query, place),
    })
}
