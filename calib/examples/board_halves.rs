//! How halves of the poses of a board scatter against their standard deviations: `board_halves FOLDER` calibrates acfr_cam_lidar by each five
//! of its ten poses and by the other five. For each of the six numbers (rotation, translation, in LiDAR axes) it prints √(χ²/degrees of
//! freedom): the root of its mean square over all divisions, the share of divisions beyond 1.5, and the worst with its first half.

use std::error::Error;
use std::path::Path;

use lsfb_calib::lidar_camera::BoardPose;
use lsfb_rigs::parts::{Said, calibrate_acfr};
use lsfb_rigs::recorded::acfr;

/// What a division scatters by, with the poses of its first half.
struct Division {
    first: Vec<usize>,
    scatter: f64,
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("name the folder")?;
    let (camera, poses) = acfr(Path::new(&folder));
    let count = poses.len();
    // The first pose is in the first half: each division is looked at once.
    let masks = (0_u32..1 << count).filter(|m| m & 1 == 1 && m.count_ones() as usize == count / 2);
    let mut refused = 0;
    let mut numbers: Vec<Vec<Division>> = (0..6).map(|_| Vec::new()).collect();
    for mask in masks {
        let is_first = |k: &usize| mask >> k & 1 == 1;
        let mut said = Said::default();
        let halves = [true, false].map(|first| -> Vec<BoardPose> {
            let own = (0..count).filter(|k| is_first(k) == first);
            own.map(|k| poses[k].clone()).collect()
        });
        let found = halves.map(|half| calibrate_acfr(&camera, &half, &mut said));
        if let Some(error) = found.iter().find_map(|f| f.as_ref().err()) {
            println!("refused: {error}");
            refused += 1;
            continue;
        }
        for (number, (_, scatter)) in numbers.iter_mut().zip(said.scatter()) {
            let first = (0..count).filter(is_first).collect();
            number.push(Division { first, scatter });
        }
    }
    println!("{refused} divisions refused");
    for (k, divisions) in numbers.iter().enumerate() {
        let of = divisions.len() as f64;
        let squares: f64 = divisions.iter().map(|d| d.scatter * d.scatter).sum();
        let beyond = divisions.iter().filter(|d| d.scatter > 1.5).count();
        let worst = divisions
            .iter()
            .max_by(|a, b| a.scatter.total_cmp(&b.scatter));
        let worst = worst.ok_or("no division")?;
        println!(
            "{k}: rms {:.2}, beyond 1.5 in {beyond} of {of}, worst {:.2} with {:?}",
            (squares / of).sqrt(),
            worst.scatter,
            worst.first
        );
    }
    Ok(())
}
