use super::kernels::{WORDS, compare, estimate, multiply};
use super::{DESCRIPTOR_LEN, DescriptorIndex};
use crate::features::Descriptor;

/// A descriptor that may be near a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Its number among those that the index was made of.
    pub descriptor: u32,
    /// Estimated, in squared units of the descriptor.
    pub distance_squared: f32,
}

/// Memory of one search, to be used again.
#[derive(Clone, Debug, Default)]
pub struct SearchScratch {
    scores: Vec<f32>,
    products: Vec<[f32; WORDS]>,
    distances: Vec<f32>,
    lists: Smallest,
    entries: Smallest,
    found: Vec<Neighbour>,
    exact: Vec<u32>,
}

impl DescriptorIndex {
    /// What [`DescriptorIndex::search`] finds, and the exact distance of each in `all`, the descriptors that the index was made of.
    pub(crate) fn search_exactly<'a>(
        &self,
        query: &Descriptor,
        all: &[Descriptor],
        [count, probes]: [usize; 2],
        scratch: &'a mut SearchScratch,
    ) -> impl Iterator<Item = (u32, u32)> + 'a {
        self.search(query, count, probes, scratch);
        let found = scratch.found.iter().map(|n| n.descriptor);
        compare(query, all, found.clone(), &mut scratch.exact);
        found.zip(scratch.exact.iter().copied())
    }

    /// The `count` descriptors with the smallest estimated distances among those of the `probes` lists whose centroids are
    /// nearest, nearest first.
    pub fn search<'a>(
        &self,
        query: &Descriptor,
        count: usize,
        probes: usize,
        scratch: &'a mut SearchScratch,
    ) -> &'a [Neighbour] {
        match self.columns.code_bytes {
            8 => self.search_codes::<8>(query, count, probes, scratch),
            16 => self.search_codes::<16>(query, count, probes, scratch),
            32 => self.search_codes::<32>(query, count, probes, scratch),
            _ => self.search_codes::<64>(query, count, probes, scratch),
        }
    }

    fn search_codes<'a, const N: usize>(
        &self,
        query: &Descriptor,
        count: usize,
        probes: usize,
        scratch: &'a mut SearchScratch,
    ) -> &'a [Neighbour] {
        let query: [f32; DESCRIPTOR_LEN] = query.map(f32::from);
        let squared_norm: f32 = query.iter().map(|v| v * v).sum();
        self.lists.scores(&query, &mut scratch.scores);
        scratch.lists.restart(probes);
        scratch.lists.offer(&scratch.scores, |list| list as u32);

        scratch.products.resize(N, [0.0; WORDS]);
        multiply(&query, &self.columns.words, &mut scratch.products);
        let products = scratch.products.first_chunk::<N>();
        let codes = self.columns.codes.as_chunks::<N>().0;
        scratch.entries.restart(count);
        // The nearest list first: what it holds leaves out most of the others'.
        for (score, list) in scratch.lists.sorted() {
            let list = *list as usize;
            let from = self.columns.first_entry[list] as usize;
            let next = self.columns.first_entry.get(list + 1);
            let to = next.map_or(self.columns.entries.len(), |e| *e as usize);
            if let Some(products) = products {
                let base = squared_norm + score;
                let offsets = &self.columns.offsets[from..to];
                let distances = &mut scratch.distances;
                estimate(&codes[from..to], offsets, products, base, distances);
                let entries = &self.columns.entries[from..to];
                scratch.entries.offer(distances, |entry| entries[entry]);
            }
        }
        scratch.found.clear();
        let sorted = scratch.entries.sorted().iter();
        scratch
            .found
            .extend(sorted.map(|(distance, entry)| Neighbour {
                descriptor: *entry,
                distance_squared: *distance,
            }));
        &scratch.found
    }
}

/// The smallest of many scores, with whose they are.
#[derive(Clone, Debug, Default)]
struct Smallest {
    wanted: usize,
    /// Nothing larger is among the smallest.
    limit: f32,
    found: Vec<(f32, u32)>,
}

fn by_score(a: &(f32, u32), b: &(f32, u32)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}

impl Smallest {
    fn restart(&mut self, wanted: usize) {
        self.wanted = wanted;
        self.limit = f32::INFINITY;
        self.found.clear();
    }

    /// Looks at scores; `whose` says whose the one at a place is.
    fn offer(&mut self, scores: &[f32], whose: impl Fn(usize) -> u32) {
        const GROUP: usize = 16;
        for (group, scores) in scores.chunks(GROUP).enumerate() {
            // Most groups have none: one comparison for all of them, side by side.
            if !scores.iter().fold(false, |any, s| any | (*s <= self.limit)) {
                continue;
            }
            for (i, score) in scores.iter().enumerate() {
                if *score <= self.limit {
                    self.found.push((*score, whose(group * GROUP + i)));
                }
            }
            if self.found.len() >= self.wanted.max(8).saturating_mul(8) {
                self.drop_rest();
            }
        }
    }

    fn drop_rest(&mut self) {
        if self.wanted == 0 {
            self.found.clear();
        } else if self.found.len() > self.wanted {
            let (_, last, _) = self.found.select_nth_unstable_by(self.wanted - 1, by_score);
            self.limit = last.0;
            self.found.truncate(self.wanted);
        }
    }

    fn sorted(&mut self) -> &[(f32, u32)] {
        self.drop_rest();
        self.found.sort_unstable_by(by_score);
        &self.found
    }
}
