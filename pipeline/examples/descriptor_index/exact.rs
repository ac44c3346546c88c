//! The nearest by comparing with all.

use std::error::Error;
use std::fs;
use std::path::Path;

use lsfb_pipeline::descriptor_index::DescriptorFile;
use lsfb_pipeline::features::Descriptor;
use lsfb_pipeline::features::matching::distance_squared;
use rayon::prelude::*;

/// Neighbours that count.
pub const NEAREST: usize = 25;
/// Queries that are compared with all, from the first.
const COMPARED: usize = 500;
const PIECE: usize = 1 << 16;
const RECORD: usize = 1 + NEAREST;

/// The nearest of each of the first queries, nearest first; kept in a file in the format of the public benchmarks (`.ivecs`).
pub fn nearest(
    kept: &Path,
    base: &DescriptorFile,
    queries: &[Descriptor],
) -> Result<Vec<[u32; NEAREST]>, Box<dyn Error>> {
    if let Ok(bytes) = fs::read(kept) {
        let numbers = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| u32::from_le_bytes(*b));
        let numbers: Vec<u32> = numbers.collect();
        let records = numbers.as_chunks::<RECORD>().0.iter();
        return Ok(records.map(|r| std::array::from_fn(|i| r[1 + i])).collect());
    }
    let asked = &queries[..queries.len().min(COMPARED)];
    let mut best: Vec<Vec<(u32, u32)>> = vec![Vec::new(); asked.len()];
    for from in (0..base.len()).step_by(PIECE) {
        let piece = base.read(from..base.len().min(from + PIECE))?;
        best.par_iter_mut().zip(asked).for_each(|(best, query)| {
            let places = piece.iter().zip(from as u32..);
            let farthest = best.get(NEAREST - 1).map_or(u32::MAX, |b| b.0);
            let distances = places.map(|(d, place)| (distance_squared(query, d), place));
            best.extend(distances.filter(|(distance, _)| *distance <= farthest));
            best.sort_unstable();
            *best = best[..best.len().min(NEAREST)].to_vec();
        });
    }
    let mut bytes = Vec::new();
    let mut all = Vec::new();
    for best in best {
        let found: [u32; NEAREST] = std::array::from_fn(|i| best.get(i).map_or(u32::MAX, |b| b.1));
        bytes.extend((NEAREST as u32).to_le_bytes());
        bytes.extend(found.iter().flat_map(|place| place.to_le_bytes()));
        all.push(found);
    }
    fs::write(kept, bytes)?;
    Ok(all)
}
