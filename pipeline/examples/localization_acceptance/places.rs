//! The places: images with poses for a map, others to be found in it, and images of anywhere else.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use lsfb_pipeline::posed_images::PosedImages;

/// Name of the one camera of each place.
pub const CAMERA: &str = "cam0";

/// A place with a map to be made and queries with answers.
pub struct Place {
    pub name: &'static str,
    pub mapped: PosedImages,
    pub queries: PosedImages,
    /// A pose is right within this distance, metres, and 5°.
    pub right_m: f64,
}

impl Place {
    fn new(name: &'static str, all: &PosedImages, every: usize, right_m: f64) -> Self {
        Self {
            name,
            mapped: all.without_every(every),
            queries: all.every(every),
            right_m,
        }
    }

    /// Its images that are not in the map.
    pub fn images(&self) -> impl Iterator<Item = PathBuf> + '_ {
        self.queries.images.iter().map(|i| i.path.clone())
    }
}

/// The three places with known poses below `data`.
pub fn read_all(data: &Path) -> Result<Vec<Place>, Box<dyn Error>> {
    let vision = data.join("vision");
    let office = PosedImages::read(&vision.join("hololens_office"))?;
    let kitchen = PosedImages::read(&vision.join("sevenscenes_redkitchen"))?;
    let fountain = PosedImages::read(&vision.join("strecha_fountain_P11_half"))?;
    Ok(vec![
        Place::new("office", &office, 5, 0.10),
        Place::new("kitchen", &kitchen, 2, 0.10),
        Place::new("fountain", &fountain, 3, 0.3),
    ])
}

/// Images of other places, without poses: indoors, outdoors, streets, boards.
pub fn strangers(data: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    const FOLDERS: [(&str, usize); 9] = [
        ("vision/euroc_stereo_pairs", 1),
        ("vision/kapture_samples/maupertuis/sensors/records_data", 1),
        ("vision/calib_opencv_stereo", 6),
        ("vision/calib_camodocal_fisheye", 6),
        ("vision/calib_aprilgrid", 1),
        ("vision/tumvi_calib_imu1/mav0/cam0/data", 50),
        ("lidar/acfr_cam_lidar/images", 3),
        ("lidar/gtsfm_hilti/images", 2),
        ("lidar/mmdet3d_demo/nuscenes", 1),
    ];
    let mut images = Vec::new();
    for (folder, every) in FOLDERS {
        let mut here = Vec::new();
        collect_images(&data.join(folder), &mut here)?;
        here.sort();
        images.extend(here.into_iter().step_by(every));
    }
    Ok(images)
}

fn collect_images(folder: &Path, images: &mut Vec<PathBuf>) -> Result<(), Box<dyn Error>> {
    for entry in fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() {
            collect_images(&path, images)?;
        } else if path.extension().is_some_and(|e| e == "jpg" || e == "png") {
            images.push(path);
        }
    }
    Ok(())
}
