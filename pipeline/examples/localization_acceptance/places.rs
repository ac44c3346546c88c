//! The places: images with poses for a map, others to be found in it, and images of anywhere else.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Camera, Matrix3, Rig, RigCamera, Se3, UnitQuaternion, Vector3};
use lsfb_perception::image;
use lsfb_pipeline::posed_images::{PosedImage, PosedImages};
use nalgebra::Rotation3;

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
    let kitchen = seven_scenes(&vision.join("sevenscenes_redkitchen"))?;
    let fountain = strecha(&vision.join("strecha_fountain_P11_half"))?;
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

/// `frame-NNNNNN.color.jpg` with `frame-NNNNNN.pose.txt`, `world_from_camera` of the depth camera.
fn seven_scenes(folder: &Path) -> Result<PosedImages, Box<dyn Error>> {
    let mut paths = Vec::new();
    collect_images(folder, &mut paths)?;
    paths.retain(|p| p.to_string_lossy().ends_with(".color.jpg"));
    paths.sort();
    let images = paths.iter().map(|path| {
        let pose = path.to_string_lossy().replace(".color.jpg", ".pose.txt");
        let v = numbers(Path::new(&pose))?;
        let rows = Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
        Ok(posed(path, &rows, Vector3::new(v[3], v[7], v[11])))
    });
    let images = images.collect::<Result<Vec<_>, Box<dyn Error>>>()?;
    // The given 585 px are the depth camera's; 525 px fit the colour images.
    let camera = Camera::pinhole(640, 480, [525.0; 2], [319.5, 239.5]);
    Ok(with_camera("redkitchen", camera, images))
}

/// Images at half of the size that their `.camera` files are for: `K`, a row of zeros, rows of `world_from_camera`, centre.
fn strecha(folder: &Path) -> Result<PosedImages, Box<dyn Error>> {
    let mut paths = Vec::new();
    collect_images(&folder.join("images"), &mut paths)?;
    paths.sort();
    let mut images = Vec::new();
    let mut camera = None;
    for path in &paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let file = folder.join("gt_dense_cameras_fullres");
        let v = numbers(&file.join(format!("{name}.camera")))?;
        let half = |pixel: f64| (pixel + 0.5) / 2.0 - 0.5;
        let size = image::read(path)?;
        let (focal, principal) = ([v[0] / 2.0, v[4] / 2.0], [half(v[2]), half(v[5])]);
        camera = Some(Camera::pinhole(size.width, size.height, focal, principal));
        let rows = Matrix3::from_row_slice(&v[12..21]);
        images.push(posed(path, &rows, Vector3::new(v[21], v[22], v[23])));
    }
    Ok(with_camera("fountain", camera.ok_or("no images")?, images))
}

fn posed(path: &Path, rotation: &Matrix3<f64>, position: Vector3<f64>) -> PosedImage {
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(rotation));
    PosedImage {
        path: path.to_owned(),
        camera: CAMERA.to_owned(),
        world_from_rig: Se3::new(rotation, position),
    }
}

fn with_camera(name: &str, camera: Camera, images: Vec<PosedImage>) -> PosedImages {
    let mounted = RigCamera {
        camera,
        rig_from_camera: Se3::identity(),
        timing: Default::default(),
    };
    PosedImages {
        rig: Rig {
            cameras: [(CAMERA.to_owned(), mounted)].into(),
            ..Rig::empty(name)
        },
        images,
    }
}

/// The numbers of a file, at least 16.
fn numbers(path: &Path) -> Result<Vec<f64>, Box<dyn Error>> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let numbers = text.split_whitespace().map(str::parse);
    let numbers = numbers.collect::<Result<Vec<f64>, _>>()?;
    if numbers.len() < 16 {
        return Err(format!("{}: {} numbers", path.display(), numbers.len()).into());
    }
    Ok(numbers)
}
