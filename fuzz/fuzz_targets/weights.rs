//! Files of weights of learned features: archives, pickled lists, safetensors, ONNX graphs.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_networks::Weights;

fuzz_target!(|bytes: &[u8]| {
    for weights in Weights::parse(bytes).into_iter().flatten() {
        let written = weights.to_safetensors();
        // Values that are no numbers differ from themselves.
        if let Ok([again]) = Weights::parse(&written).as_deref() {
            assert_eq!(again.sha256(), weights.sha256());
        }
    }
});
