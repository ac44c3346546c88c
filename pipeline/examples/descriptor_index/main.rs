//! The table of `docs/descriptor-index.md`: what an index of descriptors costs and finds, by its settings.
//!
//! ```sh
//! cargo run --release -p lsfb-pipeline --example descriptor_index -- FOLDER make 1000000     # made-up descriptors
//! cargo run --release -p lsfb-pipeline --example descriptor_index -- FOLDER images DATA/vision/hololens_office
//! cargo run --release -p lsfb-pipeline --example descriptor_index -- FOLDER table            # every row
//! cargo run --release -p lsfb-pipeline --example descriptor_index -- FOLDER row 16 8 1024 16 25
//! ```
//!
//! A row is bytes of a code, bits used of each, inverted lists, lists searched, and descriptors compared exactly (25: none, the codes' own
//! order). FOLDER keeps `base.bvecs`, `queries.bvecs`, `exact.ivecs` and an index for each of the first three numbers; other `.bvecs` files of
//! descriptors of 128 bytes may lie there instead. Times are CPU time of one thread, medians of three; built with all threads.

#![allow(clippy::print_stdout)] // a program, not a library

mod descriptors;
mod exact;
mod trial;

use std::error::Error;
use std::path::Path;

use lsfb_pipeline::descriptor_index::DescriptorFile;

use trial::{Row, Settings};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let [folder, what, rest @ ..] = arguments.as_slice() else {
        return Err(
            "give a folder, and make N, images FOLDER, table, or row and five numbers".into(),
        );
    };
    let folder = Path::new(folder);
    std::fs::create_dir_all(folder)?;
    match (*what, rest) {
        ("make", [count]) => descriptors::make(folder, count.parse()?),
        ("images", [images]) => descriptors::of_images(folder, Path::new(images)),
        ("table", []) => print_rows(folder, &trial::table()),
        ("row", numbers) => print_rows(folder, &[Settings::parse(numbers)?]),
        _ => Err("unknown words: see the head of this example".into()),
    }
}

fn print_rows(folder: &Path, rows: &[Settings]) -> Result<(), Box<dyn Error>> {
    let base = DescriptorFile::open(&folder.join("base.bvecs"))?;
    let queries = DescriptorFile::open(&folder.join("queries.bvecs"))?;
    let queries = queries.read(0..queries.len())?;
    let exact = exact::nearest(&folder.join("exact.ivecs"), &base, &queries)?;
    // A map has its descriptors mapped into memory.
    let mapped = match rows.iter().any(Settings::compares) {
        true => base.read(0..base.len())?,
        false => Vec::new(),
    };
    println!("{} descriptors, {} queries", base.len(), queries.len());
    println!("{}", Row::HEAD);
    for settings in rows {
        println!(
            "{}",
            trial::measure(settings, folder, &base, &mapped, &queries, &exact)?
        );
    }
    Ok(())
}
