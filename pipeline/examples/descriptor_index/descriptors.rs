//! What is searched: made-up descriptors, or those of images.

use std::error::Error;
use std::f32::consts::TAU;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use lsfb_pipeline::features::{Descriptor, FeatureDetector, SiftConfig};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_types::no_progress;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Families of made-up descriptors, and how far their members scatter, in units of a descriptor's norm and for each dimension.
const FAMILIES: usize = 20_000;
const SCATTER: f32 = 0.04;
/// How far a query is from the descriptor that it was made of, likewise.
const QUERY_NOISE: f32 = 0.02;
const QUERIES: usize = 2_000;
/// Norm of a descriptor.
const NORM: f32 = 512.0;
const PIECE: usize = 10_000;

/// Descriptors in families, and queries near the first of them.
pub fn make(folder: &Path, count: usize) -> Result<(), Box<dyn Error>> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let families: Vec<[f32; 128]> = (0..FAMILIES)
        .map(|_| unit(std::array::from_fn(|_| normal(&mut rng).abs())))
        .collect();
    let mut base = create(folder, "base.bvecs")?;
    let mut queries = create(folder, "queries.bvecs")?;
    let pieces: Vec<usize> = (0..count.div_ceil(PIECE)).collect();
    for group in pieces.chunks(16) {
        let made: Vec<Vec<Descriptor>> = group
            .par_iter()
            .map(|piece| {
                let mut rng = ChaCha8Rng::seed_from_u64(1 + *piece as u64);
                let wanted = PIECE.min(count - piece * PIECE);
                (0..wanted).map(|_| member(&families, &mut rng)).collect()
            })
            .collect();
        if group[0] == 0 {
            let mut rng = ChaCha8Rng::seed_from_u64(u64::MAX);
            let sources = made.iter().flatten().take(QUERIES);
            let changed: Vec<Descriptor> = sources
                .map(|d| d.map(|v| byte(f32::from(v) + NORM * QUERY_NOISE * normal(&mut rng))))
                .collect();
            write(&mut queries, &changed)?;
        }
        for piece in &made {
            write(&mut base, piece)?;
        }
    }
    base.flush()?;
    Ok(queries.flush()?)
}

fn member(families: &[[f32; 128]], rng: &mut ChaCha8Rng) -> Descriptor {
    let family = families[rng.random_range(0..families.len())];
    unit(family.map(|v| (v + SCATTER * normal(rng)).max(0.0))).map(|v| byte(NORM * v))
}

fn unit(values: [f32; 128]) -> [f32; 128] {
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    values.map(|v| v / norm)
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let (size, angle): (f32, f32) = (rng.random(), rng.random());
    (-2.0 * (1.0 - size).ln()).sqrt() * (TAU * angle).cos()
}

/// SIFT of a folder of posed images: every fifth image asks, the others are searched.
pub fn of_images(folder: &Path, images: &Path) -> Result<(), Box<dyn Error>> {
    let all = PosedImages::read(images)?;
    let config = SiftConfig {
        max_features: 3_000,
        ..SiftConfig::default()
    };
    let detector = FeatureDetector::sift(&config)?;
    for (name, some) in [
        ("base.bvecs", all.without_every(5)),
        ("queries.bvecs", all.every(5)),
    ] {
        let mut file = create(folder, name)?;
        for group in some.images.chunks(32) {
            let read: Result<Vec<_>, _> = group.iter().map(|image| image.read(&some.rig)).collect();
            let read = read?;
            let read: Vec<_> = read.iter().collect();
            for features in detector.detect_all(&read, &no_progress)? {
                let step = if name == "base.bvecs" { 1 } else { 50 };
                let kept: Vec<_> = features.descriptors.into_iter().step_by(step).collect();
                write(&mut file, &kept)?;
            }
        }
        file.flush()?;
    }
    Ok(())
}

fn create(folder: &Path, name: &str) -> std::io::Result<BufWriter<File>> {
    Ok(BufWriter::new(File::create(folder.join(name))?))
}

fn write(file: &mut BufWriter<File>, descriptors: &[Descriptor]) -> std::io::Result<()> {
    for descriptor in descriptors {
        file.write_all(&(descriptor.len() as u32).to_le_bytes())?;
        file.write_all(descriptor)?;
    }
    Ok(())
}
