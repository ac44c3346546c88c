//! Images of a folder, PNG and JPEG, and the folder's lists of poses and intrinsics.
#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use lsfb_perception::image;
use lsfb_pipeline::posed_images::PosedImages;

const IMAGE: &[u8] = include_bytes!("../seeds/images/grey.png");

/// A folder with one image in it.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = std::env::temp_dir().join(format!("lsfb-fuzz-{}-images", std::process::id()));
    std::fs::create_dir_all(folder.join("images")).expect("a scratch folder");
    std::fs::write(folder.join("images/a.png"), IMAGE).expect("a scratch file");
    folder
});

fuzz_target!(|data: &[u8]| {
    if let [b'P', data @ ..] = data {
        // What follows the first zero are the intrinsics.
        let zero = data.iter().position(|byte| *byte == 0);
        let (poses, intrinsics) = data.split_at(zero.unwrap_or(data.len()));
        let write = |name: &str, bytes: &[u8]| {
            std::fs::write(FOLDER.join(name), bytes).expect("a scratch file");
        };
        write("poses_T_world_cam_rowmajor4x4.txt", poses);
        write("K.txt", intrinsics.get(1..).unwrap_or_default());
        if let Ok(found) = PosedImages::read(&FOLDER) {
            for image in &found.images {
                let shift = &image.world_from_rig.translation;
                assert!(shift.iter().all(|v| v.is_finite()));
            }
        }
        return;
    }
    // Sizes beyond this only make it slow.
    let side = |at: usize| {
        data.get(at..at + 4)
            .map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
    };
    if data.starts_with(b"\x89PNG") && (side(16) > Some(512) || side(20) > Some(512)) {
        return;
    }
    // A start of frame: length, precision, height and width follow the marker.
    let is_large = |w: &[u8]| {
        let size = [[w[5], w[6]], [w[7], w[8]]].map(u16::from_be_bytes);
        w[0] == 0xFF && matches!(w[1], 0xC0..=0xC2) && size.iter().any(|side| *side > 512)
    };
    if data.starts_with(b"\xFF\xD8") && data.windows(9).any(is_large) {
        return;
    }
    let path = FOLDER.join("image");
    std::fs::write(&path, data).expect("a scratch file");
    if let Ok(image) = image::read(&path) {
        let pixels = u64::from(image.width) * u64::from(image.height);
        assert_eq!(image.pixels.len() as u64, pixels);
    }
});
