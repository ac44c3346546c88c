//! Approximate nearest descriptors: inverted lists with product-quantised residuals.
//!
//! Jégou, Douze, Schmid, "Product quantization for nearest neighbor search" (PAMI 2011), section IV. With $c$ the
//! centroid of a list and $\hat r$ the quantised residual of an entry,
//! $$|q - c - \hat r|^2 = |q - c|^2 + (|\hat r|^2 + 2 c \cdot \hat r) - 2 q \cdot \hat r,$$
//! where the bracket is stored with the entry, so that one table of products serves all lists of a query.
//!
//! An index takes `code_bytes + 8` bytes a descriptor and 512 bytes a list, and is three Arrow files that are mapped into memory
//! (`hd_map/FORMAT.md`); what its settings trade for what is measured in `docs/descriptor-index.md`. It is made of descriptors that
//! are read a piece at a time ([`DescriptorSource`]): besides the index itself that takes 4 bytes a descriptor and 512 bytes for each one
//! trained on. The same descriptors and settings give the same bytes on any processor and any number of threads.
//!
//! ```
//! use lsfb_pipeline::descriptor_index::{DescriptorIndex, DescriptorSource, IndexConfig, SearchScratch};
//!
//! let descriptors: Vec<[u8; 128]> = (0..100u8).map(|i| [i; 128]).collect();
//! let source = DescriptorSource::Memory(&descriptors);
//! let index = DescriptorIndex::build(source, &IndexConfig::default(), &lsfb_types::no_progress)?;
//! let mut scratch = SearchScratch::default();
//! let nearest = index.search(&[42; 128], 3, 8, &mut scratch);
//! assert_eq!(nearest[0].descriptor, 42);
//! # Ok::<(), lsfb_pipeline::Error>(())
//! ```

mod build;
mod file;
mod kernels;
pub(crate) mod kmeans;
mod search;
mod source;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use arrow_buffer::{Buffer, ScalarBuffer};
use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

use crate::features::DESCRIPTOR_LEN;
pub(crate) use file::TABLES;
pub(crate) use kernels::CentroidBlocks;
use kernels::WORDS;
pub use search::{Neighbour, SearchScratch};
pub use source::{DescriptorFile, DescriptorSource};

/// Configuration of the descriptor index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IndexConfig {
    /// Descriptors per inverted list, on average.
    pub list_length: usize,
    /// Most inverted lists.
    pub max_lists: usize,
    /// Bytes of a code, one for each part of the descriptor: 8, 16, 32 or 64.
    pub code_bytes: usize,
    /// Bits used of each byte of a code: a part is one of 2 to this many words.
    pub code_bits: u32,
    /// Training descriptors per centroid, at most.
    pub training_per_centroid: usize,
    /// Rounds of k-means.
    pub training_rounds: usize,
    /// Seed of the training.
    pub seed: u64,
}

impl Default for IndexConfig {
    fn default() -> Self {
        Self {
            list_length: 400,
            max_lists: 4096,
            code_bytes: 16,
            code_bits: 8,
            training_per_centroid: 100,
            training_rounds: 10,
            seed: 1,
        }
    }
}

lsfb_types::bounds! {
    IndexConfig {
        list_length: number(Bounds::AT_LEAST_ONE),
        max_lists: number(Bounds::AT_LEAST_ONE),
        code_bytes: number(Bounds::Within(8.0, 64.0)),
        code_bits: number(Bounds::Within(1.0, 8.0)),
        training_per_centroid: any,
        training_rounds: any,
        seed: any,
    }
    also has_code_length
}

impl IndexConfig {
    /// Codes are of the lengths that the search is compiled for.
    fn has_code_length(&self, section: &str) -> Result<(), OutOfBounds> {
        if is_code_length(self.code_bytes) {
            return Ok(());
        }
        let is = "8, 16, 32 or 64";
        Err(OutOfBounds::new(
            section,
            "code_bytes",
            &self.code_bytes,
            &is,
        ))
    }
}

/// Lengths of codes that [`search`] is compiled for.
fn is_code_length(bytes: usize) -> bool {
    [8, 16, 32, 64].contains(&bytes)
}

/// The index. Cloning shares what it holds.
#[derive(Clone, Debug)]
pub struct DescriptorIndex {
    columns: Columns,
    /// The centroids once more, as the search wants them.
    lists: Arc<CentroidBlocks>,
}

/// Columns as they are in the files.
#[derive(Clone, Debug)]
struct Columns {
    /// Centroid of each list, one after the other.
    centroids: ScalarBuffer<f32>,
    /// First entry of each list.
    first_entry: ScalarBuffer<u32>,
    /// Which descriptor each entry is.
    entries: ScalarBuffer<u32>,
    /// Bytes of a code.
    code_bytes: usize,
    /// Code of each entry.
    codes: Buffer,
    /// `|r̂|² + 2 c·r̂` of each entry.
    offsets: ScalarBuffer<f32>,
    /// For each dimension of the descriptor, its value in the `WORDS` words of its part.
    words: ScalarBuffer<f32>,
}

impl DescriptorIndex {
    fn from_columns(columns: Columns) -> Self {
        let lists = Arc::new(CentroidBlocks::new(&columns.centroids, DESCRIPTOR_LEN));
        Self { columns, lists }
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.columns.entries.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.columns.entries.is_empty()
    }

    /// Number of inverted lists.
    pub fn list_count(&self) -> usize {
        self.columns.first_entry.len()
    }

    /// Bytes of all its columns.
    pub fn bytes(&self) -> usize {
        let floats =
            self.columns.centroids.len() + self.columns.offsets.len() + self.columns.words.len();
        let numbers = self.columns.first_entry.len() + self.columns.entries.len();
        4 * (floats + numbers) + self.columns.codes.len()
    }
}
