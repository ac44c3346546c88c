use lsfb_types::no_progress;
use rand::{RngExt, SeedableRng};

use rand_chacha::ChaCha8Rng;

use super::*;
use crate::Error;
use crate::features::{Descriptor, matching};

/// Descriptors like real ones: few large bins, similar ones in families.
fn descriptors(count: usize, seed: u64) -> Vec<Descriptor> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut family: Descriptor = [0; DESCRIPTOR_LEN];
    (0..count)
        .map(|i| {
            if i % 7 == 0 {
                family = std::array::from_fn(|_| {
                    let v: f32 = rng.random_range(0.0..1.0);
                    (v * v * v * 150.0) as u8
                });
            }
            family.map(|v| v.saturating_add(rng.random_range(0..40)))
        })
        .collect()
}

/// Some of them, a little changed.
fn queries(stored: &[Descriptor], count: usize) -> Vec<Descriptor> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    (0..count)
        .map(|i| stored[i * 37 % stored.len()].map(|v| v.saturating_add(rng.random_range(0..25))))
        .collect()
}

fn built(stored: &[Descriptor], config: &IndexConfig) -> DescriptorIndex {
    DescriptorIndex::build(DescriptorSource::Memory(stored), config, &no_progress).expect("built")
}

/// Share of the queries whose nearest descriptor is among the 25 found.
fn recall(index: &DescriptorIndex, stored: &[Descriptor], queries: &[Descriptor]) -> f64 {
    let mut scratch = SearchScratch::default();
    let mut found = 0;
    for query in queries {
        let truth = (0..stored.len())
            .min_by_key(|i| matching::distance_squared(query, &stored[*i]))
            .expect("not empty");
        let neighbours = index.search(query, 25, 8, &mut scratch);
        assert!(neighbours.is_sorted_by_key(|n| n.distance_squared));
        found += usize::from(neighbours.iter().any(|n| n.descriptor as usize == truth));
    }
    found as f64 / queries.len() as f64
}

#[test]
fn the_nearest_is_among_the_first_25() {
    let stored = descriptors(20_000, 1);
    let queries = queries(&stored, 300);
    let mut last = 0.0;
    for code_bytes in [8, 16, 32, 64] {
        let config = IndexConfig {
            code_bytes,
            ..IndexConfig::default()
        };
        let recall = recall(&built(&stored, &config), &stored, &queries);
        let least = if code_bytes == 8 { 0.8 } else { 0.95 };
        assert!(recall >= least, "{code_bytes} bytes: {recall}");
        assert!(
            recall >= last - 0.02,
            "{code_bytes} bytes: {recall} after {last}"
        );
        last = recall;
    }
}

/// With every list searched, an estimate is the distance to the decoded entry, whichever list that is in.
#[test]
fn estimates_are_distances_to_decoded_entries() {
    let stored = descriptors(3_000, 5);
    let index = built(&stored, &IndexConfig::default());
    assert!(index.list_count() > 5);
    let mut decoded = vec![[0.0; DESCRIPTOR_LEN]; stored.len()];
    for list in 0..index.list_count() {
        let from = index.columns.first_entry[list] as usize;
        let to = index
            .columns
            .first_entry
            .get(list + 1)
            .map_or(index.len(), |e| *e as usize);
        for entry in from..to {
            decoded[index.columns.entries[entry] as usize] = std::array::from_fn(|d| {
                let word = index.columns.codes[entry * 16 + d / 8];
                index.columns.centroids[list * DESCRIPTOR_LEN + d]
                    + index.columns.words[d * WORDS + usize::from(word)]
            });
        }
    }
    for query in queries(&stored, 20) {
        let squared = |vector: &[f32; DESCRIPTOR_LEN]| -> f64 {
            let terms = vector.iter().zip(query);
            terms
                .map(|(v, q)| f64::from(v - f32::from(q)).powi(2))
                .sum()
        };
        let mut exact: Vec<f64> = decoded.iter().map(squared).collect();
        let mut scratch = SearchScratch::default();
        let found = index.search(&query, 100, usize::MAX, &mut scratch);
        assert_eq!(found.len(), 100);
        for neighbour in found {
            let exact = exact[neighbour.descriptor as usize];
            assert!((f64::from(neighbour.distance_squared) - exact).abs() < 1.0);
        }
        exact.sort_by(f64::total_cmp);
        assert!((f64::from(found[99].distance_squared) - exact[99]).abs() < 1.0);
    }
}

/// What is read from a file in pieces, by one thread or several, gives the bytes of what is in memory.
#[test]
fn file_or_memory_one_thread_or_several_give_the_same_bytes() {
    let stored = descriptors(40_000, 8);
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("stored.bvecs");
    let record = |d: &Descriptor| [&[128, 0, 0, 0], d.as_slice()].concat();
    std::fs::write(&path, stored.iter().flat_map(record).collect::<Vec<u8>>()).expect("written");
    let file = DescriptorFile::open(&path).expect("opened");
    let config = IndexConfig {
        training_rounds: 2,
        ..IndexConfig::default()
    };
    let mut bytes = Vec::new();
    for (threads, source) in [
        (1, DescriptorSource::Memory(&stored)),
        (2, DescriptorSource::Memory(&stored)),
        (3, DescriptorSource::File(&file)),
    ] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let build = || DescriptorIndex::build(source, &config, &no_progress).expect("built");
        pool.expect("threads")
            .install(build)
            .write(folder.path())
            .expect("written");
        bytes.push(TABLES.map(|name| std::fs::read(folder.path().join(name)).expect("readable")));
    }
    assert!(bytes[0] == bytes[1] && bytes[0] == bytes[2]);

    let opened = DescriptorIndex::open(folder.path()).expect("opened");
    let index = built(&stored, &config);
    let mut scratches = [(), ()].map(|()| SearchScratch::default());
    for query in queries(&stored, 20) {
        let [first, second] = &mut scratches;
        let found = opened.search(&query, 10, 4, first);
        assert_eq!(found, index.search(&query, 10, 4, second));
    }
}

/// Who stopped a training of minutes waited for its end.
#[test]
fn a_training_is_stopped_on_its_way() {
    let stored = descriptors(20_000, 5);
    let in_training = |p: lsfb_types::Progress| match (1..stored.len() as u64).contains(&p.done) {
        true => Err(lsfb_types::Stopped),
        false => Ok(()),
    };
    let source = DescriptorSource::Memory(&stored);
    let stopped = DescriptorIndex::build(source, &IndexConfig::default(), &in_training);
    assert!(matches!(stopped, Err(Error::Stopped(_))), "{stopped:?}");
}

#[test]
fn few_descriptors_and_none() {
    let stored = descriptors(40, 3);
    let index = built(&stored, &IndexConfig::default());
    assert_eq!(recall(&index, &stored, &stored), 1.0);
    let mut scratch = SearchScratch::default();
    assert!(index.search(&stored[0], 0, 8, &mut scratch).is_empty());
    assert!(index.search(&stored[0], 25, 0, &mut scratch).is_empty());
    assert_eq!(index.search(&stored[0], 99, 8, &mut scratch).len(), 40);
    let equal = built(&[[7; DESCRIPTOR_LEN]; 1_000], &IndexConfig::default());
    let found = equal.search(&[7; DESCRIPTOR_LEN], 3, 8, &mut scratch);
    assert_eq!(found.iter().map(|n| n.distance_squared).sum::<f32>(), 0.0);
    let empty = built(&[], &IndexConfig::default());
    assert!(empty.search(&stored[0], 25, 8, &mut scratch).is_empty());
    let folder = tempfile::tempdir().expect("scratch folder");
    empty.write(folder.path()).expect("written");
    let empty = DescriptorIndex::open(folder.path()).expect("opened");
    assert!(empty.search(&stored[0], 25, 8, &mut scratch).is_empty());
}

#[test]
fn settings_without_meaning_are_refused() {
    let refused = |config: IndexConfig| {
        let source = DescriptorSource::Memory(&[]);
        let error = DescriptorIndex::build(source, &config, &no_progress).expect_err("refused");
        error.to_string()
    };
    let default = IndexConfig::default;
    let said = refused(IndexConfig {
        code_bytes: 12,
        ..default()
    });
    assert!(said.contains("index.code_bytes is 12"), "{said}");
    let said = refused(IndexConfig {
        code_bits: 9,
        ..default()
    });
    assert!(said.contains("index.code_bits is 9"), "{said}");
    let said = refused(IndexConfig {
        list_length: 0,
        ..default()
    });
    assert!(said.contains("index.list_length is 0"), "{said}");
}

/// Any byte of any file may be wrong: an error that names the file, or an index that can be searched.
#[test]
fn damaged_files_are_refused_or_searched_without_a_panic() {
    let stored = descriptors(60, 4);
    let folder = tempfile::tempdir().expect("scratch folder");
    built(&stored, &IndexConfig::default())
        .write(folder.path())
        .expect("written");
    let mut scratch = SearchScratch::default();
    for name in TABLES {
        let path = folder.path().join(name);
        let bytes = std::fs::read(&path).expect("readable");
        let mut refused = 0;
        // The ends say what a file is; the middle is numbers.
        let places = (0..600).chain(bytes.len().saturating_sub(600)..bytes.len());
        for at in places.filter(|at| *at < bytes.len()) {
            let mut lie = bytes.clone();
            lie[at] ^= 0xff;
            std::fs::write(&path, &lie).expect("written");
            match DescriptorIndex::open(folder.path()) {
                Ok(index) => assert!(index.search(&stored[7], 5, 8, &mut scratch).len() <= 5),
                Err(error) => {
                    assert!(error.to_string().contains(name), "{error}");
                    refused += 1;
                }
            }
        }
        assert!(refused > 50, "{name}: {refused}");
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("cut off");
        let error = DescriptorIndex::open(folder.path()).expect_err("cut off");
        assert!(error.to_string().contains(name), "{error}");
        std::fs::write(&path, &bytes).expect("restored");
    }
}
