//! Files of descriptors: an index of whatever is in them can be built and searched.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_pipeline::descriptor_index::{
    DescriptorFile, DescriptorIndex, DescriptorSource, IndexConfig, SearchScratch,
};

fuzz_target!(|bytes: &[u8]| {
    let name = format!("lsfb-fuzz-{}.bvecs", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, bytes).expect("a scratch file");
    let Ok(file) = DescriptorFile::open(&path) else {
        return;
    };
    let config = IndexConfig {
        list_length: 2,
        training_rounds: 1,
        ..IndexConfig::default()
    };
    let source = DescriptorSource::File(&file);
    let built = DescriptorIndex::build(source, &config, &lsfb_types::no_progress);
    if let (Ok(index), Ok(all)) = (built, source.read(0..file.len())) {
        let mut scratch = SearchScratch::default();
        for query in &all {
            let found = index.search(query, 3, index.list_count(), &mut scratch);
            assert_eq!(found.len(), file.len().min(3));
        }
    }
});
