//! One row: an index built or opened, and searched by one thread.

use std::error::Error;
use std::fmt;
use std::path::Path;
use std::time::Instant;

use lsfb_pipeline::descriptor_index::{
    DescriptorFile, DescriptorIndex, DescriptorSource, IndexConfig, SearchScratch,
};
use lsfb_pipeline::features::Descriptor;
use lsfb_pipeline::features::matching::distance_squared;
use lsfb_types::no_progress;
use nix::sys::resource::{UsageWho, getrusage};
use nix::time::{ClockId, clock_gettime};

use crate::exact::NEAREST;

/// What is measured.
pub struct Settings {
    code_bytes: usize,
    code_bits: u32,
    lists: usize,
    probes: usize,
    compared: usize,
}

impl Settings {
    /// Whether descriptors are compared exactly.
    pub fn compares(&self) -> bool {
        self.compared > NEAREST
    }

    pub fn parse(numbers: &[&str]) -> Result<Self, Box<dyn Error>> {
        let numbers: Result<Vec<usize>, _> = numbers.iter().map(|n| n.parse()).collect();
        match numbers?[..] {
            [code_bytes, code_bits, lists, probes, compared] => Ok(Self {
                code_bytes,
                code_bits: u32::try_from(code_bits)?,
                lists,
                probes,
                compared,
            }),
            _ => Err("a row has five numbers".into()),
        }
    }
}

/// The rows of the table.
pub fn table() -> Vec<Settings> {
    let row = |[code_bytes, code_bits, lists, probes, compared]: [usize; 5]| Settings {
        code_bytes,
        code_bits: code_bits as u32,
        lists,
        probes,
        compared,
    };
    let rows = [
        [8, 8, 1024, 16, 25],
        [8, 8, 1024, 16, 200],
        [16, 4, 1024, 16, 25],
        [16, 6, 1024, 16, 25],
        [16, 8, 1024, 4, 25],
        [16, 8, 1024, 8, 25],
        [16, 8, 1024, 16, 25],
        [16, 8, 1024, 32, 25],
        [16, 8, 1024, 8, 50],
        [16, 8, 1024, 16, 50],
        [16, 8, 1024, 16, 100],
        [16, 8, 1024, 16, 200],
        [16, 8, 256, 4, 50],
        [16, 8, 2500, 8, 50],
        [16, 8, 2500, 16, 50],
        [16, 8, 2500, 16, 100],
        [16, 8, 2500, 32, 100],
        [32, 8, 1024, 16, 25],
        [32, 8, 1024, 16, 50],
        [32, 8, 2500, 16, 100],
        [64, 8, 1024, 16, 25],
        [16, 8, 1, 1, 25],
        [32, 8, 1, 1, 25],
    ];
    rows.map(row).into()
}

/// What was measured.
pub struct Row {
    settings: Settings,
    /// Zero where an index that was there already was opened.
    built_s: f64,
    descriptors: usize,
    ms: f64,
    /// Of the queries made of a descriptor: it is among those found.
    source: f64,
    /// The nearest is among those found.
    first: f64,
    /// Share of the nearest that were found.
    all: f64,
    peak_mb: f64,
}

impl Row {
    pub const HEAD: &str = "bytes bits lists probes compared | built s | B/descriptor | ms/query | M codes/s | \
        source in 25 | nearest in 25 | recall@25 | peak MB";
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = &self.settings;
        // Of an index of one list, codes a second: all are looked at.
        let codes = match s.lists {
            1 => format!("{:.0}", self.descriptors as f64 / self.ms / 1e3),
            _ => "–".to_owned(),
        };
        write!(
            f,
            "{:>5} {:>4} {:>5} {:>6} {:>8} | {:>7.1} | {:>12} | {:>8.4} | {:>9} | {:>12.4} | {:>13.4} | {:>9.4} | {:>7.0}",
            s.code_bytes,
            s.code_bits,
            s.lists,
            s.probes,
            s.compared,
            self.built_s,
            s.code_bytes + 8,
            self.ms,
            codes,
            self.source,
            self.first,
            self.all,
            self.peak_mb,
        )
    }
}

/// Builds an index, or opens it where it is, and searches it. `mapped` are all descriptors, as a map has them in memory, where a row
/// compares some.
pub fn measure(
    settings: &Settings,
    folder: &Path,
    base: &DescriptorFile,
    mapped: &[Descriptor],
    queries: &[Descriptor],
    exact: &[[u32; NEAREST]],
) -> Result<Row, Box<dyn Error>> {
    let Settings {
        code_bytes,
        code_bits,
        lists,
        probes,
        compared,
    } = *settings;
    let kept = folder.join(format!("index-{code_bytes}-{code_bits}-{lists}"));
    let mut built_s = 0.0;
    if !kept.exists() {
        let config = IndexConfig {
            list_length: (base.len() / lists).max(1),
            max_lists: lists,
            code_bytes,
            code_bits,
            ..IndexConfig::default()
        };
        let begun = Instant::now();
        let index = DescriptorIndex::build(DescriptorSource::File(base), &config, &no_progress)?;
        built_s = begun.elapsed().as_secs_f64();
        let partial = folder.join("index.partial");
        std::fs::create_dir_all(&partial)?;
        index.write(&partial)?;
        std::fs::rename(&partial, &kept)?;
    }
    let index = DescriptorIndex::open(&kept)?;
    let mut scratch = SearchScratch::default();
    let mut times = Vec::new();
    let mut found: Vec<Vec<u32>> = Vec::new();
    for _ in 0..3 {
        found.clear();
        let begun = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?;
        for query in queries {
            let near = index.search(query, compared.max(NEAREST), probes, &mut scratch);
            let mut near: Vec<u32> = near.iter().map(|n| n.descriptor).collect();
            if settings.compares() {
                near = nearest_of(query, &near, mapped);
            }
            found.push(near);
        }
        let ended = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?;
        let spent = ended - begun;
        times.push(spent.tv_sec() as f64 + spent.tv_nsec() as f64 * 1e-9);
    }
    times.sort_by(f64::total_cmp);
    let has = |(found, wanted): (&Vec<u32>, u32)| u32::from(found.contains(&wanted));
    let sources = found.iter().zip(0..).map(has).sum::<u32>();
    let firsts = found
        .iter()
        .zip(exact)
        .map(|(f, e)| has((f, e[0])))
        .sum::<u32>();
    let of_exact = |(found, exact): (&Vec<u32>, &[u32; NEAREST])| {
        exact.iter().filter(|e| found.contains(e)).count()
    };
    let all: usize = found.iter().zip(exact).map(of_exact).sum();
    // Linux counts kibibytes.
    let peak_mb = getrusage(UsageWho::RUSAGE_SELF)?.max_rss() as f64 * 1.024e-3;
    Ok(Row {
        settings: Settings { ..*settings },
        built_s,
        descriptors: index.len(),
        ms: times[1] * 1e3 / queries.len() as f64,
        source: f64::from(sources) / queries.len() as f64,
        first: f64::from(firsts) / exact.len() as f64,
        all: all as f64 / (exact.len() * NEAREST) as f64,
        peak_mb,
    })
}

/// The nearest of some by their exact distances.
fn nearest_of(query: &Descriptor, some: &[u32], mapped: &[Descriptor]) -> Vec<u32> {
    let distances = some
        .iter()
        .map(|place| (distance_squared(query, &mapped[*place as usize]), *place));
    let mut compared: Vec<(u32, u32)> = distances.collect();
    compared.sort_unstable();
    compared.truncate(NEAREST);
    compared.into_iter().map(|(_, place)| place).collect()
}
