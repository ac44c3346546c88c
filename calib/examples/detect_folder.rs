//! Finds a board in every image of a folder: `detect_folder FOLDER aprilgrid 6 6 0.088 0.3`, `… checkerboard 9 6 1` or
//! `… charuco 11 8 0.03 0.022 5x5`.
//! Prints the corners with `--corners`, and the time per image without reading; `--repeat 10` looks at each image ten times, for
//! measurements of CPU time from outside.

use std::path::Path;
use std::time::Instant;

use lsfb_calib::board::MarkerDictionary;
use lsfb_calib::camera::image_files;
use lsfb_calib::{Target, detect};
use lsfb_perception::image;

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let word = |k: usize| arguments.get(k).map_or("", String::as_str);
    let target = match word(1) {
        "aprilgrid" => Target::AprilGrid {
            columns: word(2).parse()?,
            rows: word(3).parse()?,
            tag_size_m: word(4).parse()?,
            spacing_ratio: word(5).parse()?,
        },
        "charuco" => Target::Charuco {
            columns: word(2).parse()?,
            rows: word(3).parse()?,
            square_m: word(4).parse()?,
            marker_m: word(5).parse()?,
            dictionary: MarkerDictionary::named(word(6)).ok_or("bits: 4x4, 5x5 or 6x6")?,
        },
        _ => Target::Checkerboard {
            columns: word(2).parse()?,
            rows: word(3).parse()?,
            square_m: word(4).parse()?,
        },
    };
    let print = arguments.iter().any(|a| a == "--corners");
    let repeat = arguments.iter().position(|a| a == "--repeat");
    let times: usize = repeat.map_or(Ok(1), |k| word(k + 1).parse())?;
    let (mut seconds, mut corners_seen, mut images_seen, mut pixels) = (0.0, 0, 0, 0);
    let files = image_files(Path::new(word(0)))?;
    for path in &files {
        let image = image::read(path)?;
        let start = Instant::now();
        let mut corners = detect::detect(&image, &target);
        for _ in 1..times {
            corners = detect::detect(std::hint::black_box(&image), &target);
        }
        seconds += start.elapsed().as_secs_f64() / times as f64;
        pixels += image.pixels.len();
        corners_seen += corners.len();
        images_seen += usize::from(!corners.is_empty());
        if print {
            for c in &corners {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                println!("{name} {} {:.4} {:.4}", c.index, c.pixel.x, c.pixel.y);
            }
        }
    }
    println!(
        "{images_seen} of {} images, {corners_seen} corners, {:.2} ms per image, {:.1} ms per megapixel",
        files.len(),
        seconds * 1e3 / files.len() as f64,
        seconds * 1e9 / pixels as f64
    );
    Ok(())
}
