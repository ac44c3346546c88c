use std::path::Path;

use arrow_buffer::ScalarBuffer;

use super::{Columns, DESCRIPTOR_LEN, DescriptorIndex, WORDS, is_code_length};
use crate::Error;
use crate::arrow_file::{Column, NamedColumn, Table, broken, write_table};

/// The files of an index; `hd_map/FORMAT.md` describes them.
pub(crate) const TABLES: [&str; 3] = [
    "index_lists.arrow",
    "index_entries.arrow",
    "index_codebook.arrow",
];
const LISTS: [&str; 2] = ["centroid", "first_entry"];
const ENTRIES: [&str; 3] = ["descriptor", "code", "offset"];
const CODEBOOK: [&str; 1] = ["words"];

impl DescriptorIndex {
    /// Writes the index's three files into a folder that is there.
    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        let u32s = |v: &ScalarBuffer<u32>| Column::U32(v.clone());
        let list = |width, values: &ScalarBuffer<f32>| Column::F32List {
            width,
            values: values.clone(),
        };
        let codes = Column::Bytes {
            width: self.columns.code_bytes,
            values: self.columns.codes.clone(),
        };
        let offsets = Column::F32(self.columns.offsets.clone());
        let lists = [
            list(DESCRIPTOR_LEN, &self.columns.centroids),
            u32s(&self.columns.first_entry),
        ];
        let tables: [Vec<NamedColumn>; 3] = [
            LISTS.into_iter().zip(lists).collect(),
            ENTRIES
                .into_iter()
                .zip([u32s(&self.columns.entries), codes, offsets])
                .collect(),
            CODEBOOK
                .into_iter()
                .zip([list(WORDS, &self.columns.words)])
                .collect(),
        ];
        for (name, columns) in TABLES.iter().zip(tables) {
            write_table(&folder.join(name), &columns)?;
        }
        Ok(())
    }

    /// Maps the three files in a folder into memory. Refuses what is cut off, has another layout or points to nothing, so that no
    /// later access can fail; a map's folder has their hashes as well.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let mut tables = Vec::new();
        for name in TABLES {
            tables.push(Table::map(folder.join(name))?);
        }
        Self::from_tables(&tables)
    }

    /// From the files in the order of [`TABLES`].
    pub(crate) fn from_tables(tables: &[Table]) -> Result<Self, Error> {
        let [lists, entries, codebook] = tables else {
            return Err(broken(
                Path::new(TABLES[0]),
                "an index must have three files",
            ));
        };
        let [centroids, first_entry] = lists.columns(LISTS)?;
        let [entry, codes, offsets] = entries.columns(ENTRIES)?;
        let [words] = codebook.columns(CODEBOOK)?;
        let (codes, code_bytes) = entries.rows(codes)?;
        let columns = Columns {
            centroids: lists.lists(centroids, DESCRIPTOR_LEN)?,
            first_entry: lists.u32(first_entry)?,
            entries: entries.u32(entry)?,
            code_bytes,
            codes,
            offsets: entries.f32(offsets)?,
            words: codebook.lists(words, WORDS)?,
        };
        if !is_code_length(code_bytes) {
            let reason = format!("codes of {code_bytes} bytes instead of 8, 16, 32 or 64");
            return Err(broken(&entries.path, &reason));
        }
        if columns.words.len() != DESCRIPTOR_LEN * WORDS {
            return Err(broken(
                &codebook.path,
                "expected 256 words of 128 dimensions",
            ));
        }
        let count = columns.entries.len();
        if columns.entries.iter().any(|e| *e as usize >= count) {
            return Err(broken(&entries.path, "a row has an index out of range"));
        }
        let first = &columns.first_entry;
        let in_order = first.windows(2).all(|w| w[0] <= w[1]);
        let ends = first
            .last()
            .map_or(count == 0, |last| *last as usize <= count);
        if first.first().is_some_and(|v| *v != 0) || !in_order || !ends {
            return Err(broken(&lists.path, "a row has an index out of range"));
        }
        Ok(Self::from_columns(columns))
    }
}
