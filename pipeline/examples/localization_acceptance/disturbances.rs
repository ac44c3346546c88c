//! Queries: an image, what is done to it, and where it was taken if that can be found.

use std::path::PathBuf;

use lsfb_geometry::{Camera, Se3, UnitQuaternion, Vector3};
use lsfb_perception::image::{self, ImageError};
use lsfb_pipeline::features::Features;
use lsfb_pipeline::posed_images::PosedImage;
use lsfb_types::Image;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::places::Place;

/// What is done to an image of the place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// Nothing.
    None,
    /// Turned by 180°, as by a camera held upside down.
    Turned,
    /// At half of its size, with the camera that belongs to it.
    Half,
    /// At half of its size, with the intrinsics of the whole one.
    HalfWithWrongMatrix,
    /// At half of its size in the middle of a black frame, with the intrinsics of the whole one: a focal length off by two.
    HalfInFrame,
    /// As it is, with focal lengths that are off by so many per cent.
    WrongFocal(i32),
    /// With every tenth of its features only, as of a view that shows little.
    Tenth,
    /// With every thirtieth of its features only.
    Thirtieth,
    /// 60 % of it exchanged for pieces of other images of the place: of what is seen so much stands elsewhere in the map.
    Changed,
    /// Left and right exchanged: no camera sees this.
    Mirrored,
}

/// Focal lengths that are off by so much, in per cent, are also judged among images of the right size: a few that were resized.
pub const AMONG_OTHERS: [i32; 2] = [-10, 10];
/// Pieces of an image, along and across, and how many of them are exchanged.
const PIECES: [u32; 2] = [5, 4];
const EXCHANGED: usize = 12;

impl Disturbance {
    /// Those that leave the pixels as they are follow one another.
    pub const ALL: [Self; 16] = [
        Self::None,
        Self::WrongFocal(-20),
        Self::WrongFocal(-10),
        Self::WrongFocal(-2),
        Self::WrongFocal(2),
        Self::WrongFocal(10),
        Self::WrongFocal(25),
        Self::WrongFocal(100),
        Self::Tenth,
        Self::Thirtieth,
        Self::Turned,
        Self::Half,
        Self::HalfWithWrongMatrix,
        Self::HalfInFrame,
        Self::Changed,
        Self::Mirrored,
    ];

    /// Name of the row of the table.
    pub fn name(self) -> String {
        let name = match self {
            Self::None => "left out",
            Self::Turned => "turned by 180°",
            Self::Half => "half size",
            Self::HalfWithWrongMatrix => "half size, wrong matrix",
            Self::HalfInFrame => "half size in a frame",
            Self::WrongFocal(percent) => return format!("focal length {percent:+} %"),
            Self::Tenth => "every 10th feature",
            Self::Thirtieth => "every 30th feature",
            Self::Changed => "60 % changed",
            Self::Mirrored => "mirrored",
        };
        name.to_owned()
    }
}

/// An image to be localized.
pub struct Query {
    pub path: PathBuf,
    camera: Camera,
    /// `None` for an image of another place.
    disturbance: Option<Disturbance>,
    /// Where it was taken; `None` where no pose is right.
    pub world_from_rig: Option<Se3>,
    /// Other images of the place, for [`Disturbance::Changed`].
    others: Vec<PathBuf>,
}

impl Query {
    /// An image of the place, disturbed.
    pub fn of(place: &Place, image: &PosedImage, disturbance: Disturbance) -> Self {
        let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        let turned = Se3::new(half_turn, Vector3::zeros());
        let pose = image.world_from_rig;
        Self {
            path: image.path.clone(),
            camera: camera_of(place),
            disturbance: Some(disturbance),
            world_from_rig: match disturbance {
                Disturbance::Mirrored => None,
                Disturbance::Turned => Some(pose * turned),
                _ => Some(pose),
            },
            others: match disturbance {
                Disturbance::Changed => place.images().filter(|p| *p != image.path).collect(),
                _ => Vec::new(),
            },
        }
    }

    /// An image of another place, as if the camera of this one had taken it.
    pub fn elsewhere(place: &Place, path: PathBuf) -> Self {
        Self {
            path,
            camera: camera_of(place),
            disturbance: None,
            world_from_rig: None,
            others: Vec::new(),
        }
    }

    /// Whether it is an image of another place.
    pub fn is_elsewhere(&self) -> bool {
        self.disturbance.is_none()
    }

    /// Name of the row of the table.
    pub fn kind(&self) -> String {
        let elsewhere = || "another place".to_owned();
        self.disturbance.map_or_else(elsewhere, Disturbance::name)
    }

    /// The features that the localizer gets, of those that were found.
    pub fn thinned(&self, features: Features) -> Features {
        let step = match self.disturbance {
            Some(Disturbance::Tenth) => 10,
            Some(Disturbance::Thirtieth) => 30,
            _ => 1,
        };
        Features {
            keypoints: features.keypoints.into_iter().step_by(step).collect(),
            descriptors: features.descriptors.into_iter().step_by(step).collect(),
        }
    }

    /// The file, short.
    pub fn name(&self) -> String {
        let parts: Vec<_> = self.path.iter().rev().take(2).collect();
        let parts = parts.iter().rev().map(|p| p.to_string_lossy());
        parts.collect::<Vec<_>>().join("/")
    }

    /// The image as the localizer gets it, with the camera that it is told.
    pub fn disturbed(&self, image: Image) -> Result<(Image, Camera), ImageError> {
        let Some(disturbance) = self.disturbance else {
            // Its own size, the field of view of the camera of the place.
            let zoom = f64::from(image.width) / f64::from(self.camera.width);
            let focal = self.camera.focal_px().map(|f| f * zoom);
            let centre = [image.width, image.height].map(|s| f64::from(s) / 2.0 - 0.5);
            let camera = Camera::pinhole(image.width, image.height, focal, centre);
            return Ok((image, camera));
        };
        let (focal, [x, y]) = (self.camera.focal_px(), self.camera.principal_px());
        let (right, bottom) = (f64::from(image.width) - 1.0, f64::from(image.height) - 1.0);
        let pinhole = |image: &Image, focal, principal| {
            Camera::pinhole(image.width, image.height, focal, principal)
        };
        let whole = pinhole(&image, focal, [x, y]);
        Ok(match disturbance {
            Disturbance::None | Disturbance::Tenth | Disturbance::Thirtieth => (image, whole),
            Disturbance::Turned => {
                let mut turned = image;
                turned.pixels.reverse();
                let camera = pinhole(&turned, focal, [right - x, bottom - y]);
                (turned, camera)
            }
            Disturbance::Mirrored => {
                let mut mirrored = image;
                let width = mirrored.width.max(1) as usize;
                mirrored.pixels.chunks_mut(width).for_each(<[u8]>::reverse);
                let camera = pinhole(&mirrored, focal, [right - x, y]);
                (mirrored, camera)
            }
            Disturbance::Half => {
                let half = half_size(&image);
                let principal = [x, y].map(|p| (p + 0.5) / 2.0 - 0.5);
                let camera = pinhole(&half, focal.map(|f| f / 2.0), principal);
                (half, camera)
            }
            Disturbance::HalfWithWrongMatrix => {
                let half = half_size(&image);
                let camera = pinhole(&half, focal, [x, y]);
                (half, camera)
            }
            Disturbance::HalfInFrame => (framed(&half_size(&image), &image), whole),
            Disturbance::Changed => (self.changed(image)?, whole),
            Disturbance::WrongFocal(percent) => {
                let factor = 1.0 + f64::from(percent) / 100.0;
                let camera = pinhole(&image, focal.map(|f| f * factor), [x, y]);
                (image, camera)
            }
        })
    }

    /// With pieces of other images in it, each of another one and of another spot; the same ones each time.
    fn changed(&self, mut image: Image) -> Result<Image, ImageError> {
        let seed = self.name().into_bytes().into_iter();
        let seed = seed.fold(0u64, |sum, b| sum.wrapping_mul(31).wrapping_add(b.into()));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (width, height) = (image.width / PIECES[0], image.height / PIECES[1]);
        let corner = |piece: u32| [piece % PIECES[0] * width, piece / PIECES[0] * height];
        let all = PIECES[0] * PIECES[1];
        let mut pieces: Vec<u32> = (0..all).collect();
        for taken in 0..EXCHANGED.min(pieces.len()) {
            let (to, other) = (
                rng.random_range(taken..pieces.len()),
                rng.random_range(0..self.others.len().max(1)),
            );
            pieces.swap(taken, to);
            let Some(other) = self.others.get(other) else {
                continue;
            };
            let other = image::read(other)?;
            if (other.width, other.height) != (image.width, image.height) {
                continue;
            }
            let spot = (pieces[taken] + rng.random_range(1..all)) % all;
            let ([to_x, to_y], [from_x, from_y]) = (corner(pieces[taken]), corner(spot));
            for row in 0..height {
                let from = ((from_y + row) * image.width + from_x) as usize;
                let to = ((to_y + row) * image.width + to_x) as usize;
                let piece = &other.pixels[from..from + width as usize];
                image.pixels[to..to + width as usize].copy_from_slice(piece);
            }
        }
        Ok(image)
    }
}

fn camera_of(place: &Place) -> Camera {
    let mut cameras = place.queries.rig.cameras.values();
    cameras.next().map_or_else(
        || Camera::pinhole(1, 1, [1.0; 2], [0.0; 2]),
        |mounted| mounted.camera,
    )
}

/// Means of two by two pixels.
fn half_size(image: &Image) -> Image {
    let (width, height) = (image.width / 2, image.height / 2);
    let at = |x: u32, y: u32| u32::from(image.pixels[(y * image.width + x) as usize]);
    let mean = |x: u32, y: u32| {
        let (x, y) = (2 * x, 2 * y);
        ((at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1) + 2) / 4) as u8
    };
    Image {
        width,
        height,
        pixels: (0..height)
            .flat_map(|y| (0..width).map(move |x| mean(x, y)))
            .collect(),
        ..Image::default()
    }
}

/// An image in the middle of a black one as large as another.
fn framed(image: &Image, size_of: &Image) -> Image {
    let mut framed = Image {
        width: size_of.width,
        height: size_of.height,
        pixels: vec![0; size_of.pixels.len()],
        ..Image::default()
    };
    let (left, top) = (
        (size_of.width - image.width) / 2,
        (size_of.height - image.height) / 2,
    );
    for (y, row) in image.pixels.chunks(image.width.max(1) as usize).enumerate() {
        let start = (top as usize + y) * size_of.width as usize + left as usize;
        framed.pixels[start..start + row.len()].copy_from_slice(row);
    }
    framed
}
