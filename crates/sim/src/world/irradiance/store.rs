//! Computed light as a file, named by a hash of all that it depends on: a place that has changed finds none.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use sha2::{Digest, Sha256};

use super::super::facet::{Facet, Outline};
use super::super::light::LightGrid;
use super::lattice::Baking;
use super::optics::Optics;
use super::probes::Probes;
use super::scene::{PointLight, SunDisc};
use crate::Error;

/// Changes whenever the same place would get other light.
const VERSION: u32 = 2;
const MAGIC: &[u8; 8] = b"LSFBLUX\n";
/// Length of a SHA-256.
const HASH: usize = 32;

/// Light of a place.
#[derive(Clone, Debug)]
pub(crate) struct Baked {
    /// Of each facet, lux.
    pub grids: Vec<LightGrid>,
    pub probes: Probes,
}

/// What a file of light was found to be.
pub(crate) enum Found {
    Light(Baked),
    Nothing,
    /// What is wrong with it.
    Damaged(String),
}

/// Hash of all that the light of a place depends on.
pub(crate) fn key(
    surfaces: &[(Facet, Optics)],
    (sun, points): (Option<SunDisc>, &[PointLight]),
    void_cd_m2: f32,
    baking: &Baking,
    walked: Option<[[f32; 3]; 2]>,
) -> [u8; HASH] {
    let mut hash = Sha256::new();
    hash.update(MAGIC);
    hash.update(VERSION.to_le_bytes());
    let mut put = |numbers: &[f32]| {
        for number in numbers {
            hash.update(number.to_bits().to_le_bytes());
        }
    };
    put(&[void_cd_m2, baking.spacing_m]);
    if let Some(sun) = sun {
        put(&sun.direction);
        put(&[sun.illuminance_lx]);
    }
    for light in points {
        put(&[light.position, light.direction].concat());
        put(&[light.intensity_cd, light.cosines[0], light.cosines[1]]);
    }
    put(&[points.len() as f32]);
    put(walked.unwrap_or_default().as_flattened());
    for (facet, optics) in surfaces {
        put(&[facet.corner, facet.edge_a, facet.edge_b].concat());
        let flags = [
            facet.outline() == Outline::Triangle,
            optics.glass,
            optics.backdrop,
            optics.leaf,
        ];
        put(&flags.map(|flag| f32::from(u8::from(flag))));
        put(&[optics.albedo, optics.luminance_cd_m2]);
    }
    hash.update((baking.paths as u64).to_le_bytes());
    hash.update(baking.seed.to_le_bytes());
    hash.finalize().into()
}

/// Where light with a key lies in a folder.
pub(crate) fn path(folder: &Path, key: &[u8; HASH]) -> PathBuf {
    let name: String = key[..12].iter().map(|b| format!("{b:02x}")).collect();
    folder.join(format!("light-{name}.bin"))
}

/// Reads light that has this key.
pub(crate) fn read(path: &Path, key: &[u8; HASH]) -> Found {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Found::Nothing,
        Err(error) => return Found::Damaged(error.to_string()),
    };
    match parse(&bytes, key) {
        Ok(light) => Found::Light(light),
        Err(problem) => Found::Damaged(problem.to_owned()),
    }
}

/// Writes light, whole or not at all.
pub(crate) fn write(path: &Path, key: &[u8; HASH], light: &Baked) -> Result<(), Error> {
    let failed = |source: std::io::Error| Error::Write {
        path: path.to_owned(),
        source,
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    // Two that write at once have a file each, in one process as well.
    static WRITES: AtomicU64 = AtomicU64::new(0);
    let (process, write) = (std::process::id(), WRITES.fetch_add(1, Ordering::Relaxed));
    let begun = path.with_extension(format!("{process}-{write}.part"));
    std::fs::write(&begun, to_bytes(key, light)).map_err(failed)?;
    std::fs::rename(&begun, path).map_err(failed)
}

fn to_bytes(key: &[u8; HASH], light: &Baked) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(key);
    bytes.extend((light.grids.len() as u64).to_le_bytes());
    for grid in &light.grids {
        bytes.extend((grid.columns as u32).to_le_bytes());
        bytes.extend((grid.rows as u32).to_le_bytes());
        bytes.extend(grid.values.iter().flat_map(|v| v.to_le_bytes()));
    }
    let probes = &light.probes;
    bytes.extend(probes.low.iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend(probes.step_m.iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend(probes.counts.iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend(
        probes
            .lux
            .as_flattened()
            .iter()
            .flat_map(|v| v.to_le_bytes()),
    );
    let check = Sha256::digest(&bytes);
    bytes.extend(check);
    bytes
}

fn parse(bytes: &[u8], key: &[u8; HASH]) -> Result<Baked, &'static str> {
    let short = "it ends too early";
    let (content, check) = bytes
        .len()
        .checked_sub(HASH)
        .map(|end| bytes.split_at(end))
        .ok_or(short)?;
    if Sha256::digest(content)[..] != *check {
        return Err("its checksum is wrong");
    }
    let mut rest = Rest(content);
    if rest.take(MAGIC.len()).ok_or(short)? != MAGIC {
        return Err("not a light file");
    }
    if rest.take(HASH).ok_or(short)? != key {
        return Err("it belongs to another place");
    }
    let count = rest.array().map(u64::from_le_bytes).ok_or(short)?;
    let mut grids = Vec::new();
    for _ in 0..count {
        let columns = rest.number().ok_or(short)?;
        let rows = rest.number().ok_or(short)?;
        let nodes = columns.checked_mul(rows).ok_or(short)?;
        grids.push(LightGrid {
            columns: columns as usize,
            rows: rows as usize,
            values: rest.floats(nodes as usize).ok_or(short)?,
        });
    }
    let mut three = || -> Option<[f32; 3]> { rest.floats(3)?.try_into().ok() };
    let (low, step_m) = (three().ok_or(short)?, three().ok_or(short)?);
    let counts = [(); 3].map(|()| rest.number().unwrap_or_default());
    let rest_lux = rest.0.len() / 4;
    let flat = rest.floats(rest_lux).ok_or(short)?;
    let lux: Vec<[f32; 6]> = flat.as_chunks().0.to_vec();
    let expected = counts.into_iter().map(u64::from).product::<u64>();
    if !rest.0.is_empty() || flat.len() % 6 != 0 || lux.len() as u64 != expected {
        return Err("its parts are inconsistent");
    }
    Ok(Baked {
        grids,
        probes: Probes {
            low,
            step_m,
            counts,
            lux,
        },
    })
}

/// What has not been read.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn number(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn floats(&mut self, count: usize) -> Option<Vec<f32>> {
        let bytes = self.take(count.checked_mul(4)?)?;
        let numbers = bytes.as_chunks().0.iter();
        Some(numbers.map(|b| f32::from_le_bytes(*b)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_that_share_their_light_write_it_at_once() {
        let folder = tempfile::tempdir().expect("folder");
        let key = [7; HASH];
        let path = path(&folder.path().join("light"), &key);
        let light = Baked {
            grids: vec![LightGrid {
                columns: 300,
                rows: 200,
                values: vec![0.5; 60_000],
            }],
            probes: Probes {
                low: [0.0; 3],
                step_m: [1.0; 3],
                counts: [1; 3],
                lux: vec![[1.0; 6]],
            },
        };
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..20 {
                        write(&path, &key, &light).expect("written");
                    }
                });
            }
        });
        assert!(matches!(read(&path, &key), Found::Light(found) if found.grids.len() == 1));
        let files = std::fs::read_dir(path.parent().expect("in a folder")).expect("there");
        assert_eq!(files.count(), 1, "nothing unfinished is left");
    }
}
