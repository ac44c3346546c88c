//! Tracks as a front end of ICE-BA wrote them: one `.dat` file a frame, little endian, packed like its C structs.

use std::error::Error;
use std::io::Read;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{
    Camera, Matrix3, RigCamera, Se3, StampedPose, Trajectory, UnitQuaternion, Vector2, Vector3,
};
use lsfb_types::{ImuSample, Stamped, Timestamp};

/// Begin of the sequence: times in the files count from here.
const BEGIN: Timestamp = Timestamp::from_nanos(1_403_636_579_763_555_584);

/// Focal length of the undistorted images.
pub const FOCAL_PX: f64 = 458.0;

/// A point seen by one camera of a keyframe.
pub struct Sight {
    pub point: i32,
    /// 0 left, 1 right.
    pub camera: usize,
    /// Without distortion, from the optical axis.
    pub pixel: Vector2<f64>,
}

pub struct Keyframe {
    pub time: Timestamp,
    pub sights: Vec<Sight>,
}

/// Everything in the archive.
pub struct Tracks {
    pub frame_count: usize,
    pub keyframes: Vec<Keyframe>,
    pub imu: Vec<Stamped<ImuSample>>,
    /// Left and right, undistorted; the rig is the IMU.
    pub cameras: [RigCamera; 2],
    pub truth: Trajectory,
}

impl Tracks {
    pub fn read(path: &str) -> Result<Self, Box<dyn Error>> {
        let mut archive = Vec::new();
        flate2::read::GzDecoder::new(std::fs::File::open(path)?).read_to_end(&mut archive)?;
        let mut files = unpack(&archive)?;
        files.sort();
        let find = |end: &str| {
            let file = files.iter().find(|(name, _)| name.ends_with(end));
            file.map(|(_, bytes)| *bytes)
                .ok_or(format!("{path} has no {end}"))
        };
        let lenses = Lenses::read(find("calibration.dat")?)?;
        let truth = read_truth(std::str::from_utf8(find("gt_tum.txt")?)?)?;
        let mut tracks = Self {
            frame_count: 0,
            keyframes: Vec::new(),
            imu: Vec::new(),
            cameras: [0, 1].map(|k| RigCamera {
                camera: Camera::pinhole(752, 480, [FOCAL_PX; 2], [0.0; 2]),
                rig_from_camera: lenses.rig_from_camera[k],
                timing: Default::default(),
                sigmas: Default::default(),
            }),
            truth,
        };
        for (_, bytes) in files.iter().filter(|(name, _)| name.ends_with(".png.dat")) {
            tracks.frame_count += 1;
            tracks.read_frame(Bytes(bytes), &lenses)?;
        }
        // A sample at the seam of two frames may be in both.
        tracks.imu.sort_by_key(|sample| sample.time);
        tracks.imu.dedup_by_key(|sample| sample.time);
        Ok(tracks)
    }

    fn read_frame(&mut self, mut from: Bytes<'_>, lenses: &Lenses) -> Result<(), Box<dyn Error>> {
        from.int()?;
        from.floats(21)?;
        from.sights()?;
        for _ in 0..from.count()? {
            let sample = from.floats(7)?;
            let time = BEGIN.plus_secs(sample[6]);
            self.imu.push(Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: ImuSample {
                    angular_velocity_rad_s: [sample[3], sample[4], sample[5]],
                    specific_force_m_s2: [sample[0], sample[1], sample[2]],
                },
            });
        }
        let time = BEGIN.plus_secs(from.floats(1)?[0]);
        from.floats(2)?;
        from.line()?;
        from.line()?;
        if from.int()? < 0 {
            return Ok(());
        }
        from.floats(12)?;
        let mut seen = from.sights()?;
        for _ in 0..from.count()? {
            let sights = from.sights()?;
            let point = from.int()?;
            from.floats(3)?;
            seen.extend(sights.into_iter().map(|s| RawSight { point, ..s }));
        }
        let mut sights = Vec::new();
        for raw in seen {
            let ray = lenses.cameras[raw.camera]
                .unproject(&raw.pixel)
                .ok_or("a pixel outside the lens")?;
            sights.push(Sight {
                point: raw.point,
                camera: raw.camera,
                pixel: ray.xy() * (FOCAL_PX / ray.z),
            });
        }
        self.keyframes.push(Keyframe { time, sights });
        Ok(())
    }
}

/// What the calibration file says.
struct Lenses {
    cameras: [Camera; 2],
    rig_from_camera: [Se3; 2],
}

impl Lenses {
    fn read(bytes: &[u8]) -> Result<Self, Box<dyn Error>> {
        let mut from = Bytes(bytes);
        from.take(12)?;
        let left_from_rig = pose(&from.floats(12)?);
        from.floats(6)?;
        let left = lens(&from.floats(12)?);
        let left_from_right = pose(&from.floats(12)?);
        let right = lens(&from.floats(12)?);
        let rig_from_left = left_from_rig.inverse();
        Ok(Self {
            cameras: [left, right],
            rig_from_camera: [rig_from_left, rig_from_left * left_from_right],
        })
    }
}

fn lens(k: &[f64]) -> Camera {
    Camera {
        width: 752,
        height: 480,
        lens: Lens::PinholeRadtan {
            focal_px: [k[0], k[1]],
            principal_px: [k[2], k[3]],
            distortion: [k[4], k[5], k[6], k[7], 0.0],
        },
    }
}

/// Three rows of rotation and translation, in single precision.
fn pose(m: &[f64]) -> Se3 {
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    Se3::new(
        UnitQuaternion::from_matrix(&rotation),
        Vector3::new(m[3], m[7], m[11]),
    )
}

fn read_truth(text: &str) -> Result<Trajectory, Box<dyn Error>> {
    let mut poses = Vec::new();
    for line in text.lines() {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<_, _>>()?;
        let &[time, x, y, z, i, j, k, w] = numbers.as_slice() else {
            return Err(format!("not a pose: {line}").into());
        };
        poses.push(StampedPose {
            time: Timestamp::from_secs_f64(time),
            world_from_rig: Se3::new(
                UnitQuaternion::new_normalize(lsfb_geometry::Quaternion::new(w, i, j, k)),
                Vector3::new(x, y, z),
            ),
        });
    }
    Ok(Trajectory::new(poses))
}

/// Name and contents.
type File<'a> = (&'a str, &'a [u8]);

/// Files of a tar archive: a header of 512 bytes, the contents, zeros up to the next 512.
fn unpack(archive: &[u8]) -> Result<Vec<File<'_>>, Box<dyn Error>> {
    let text = |bytes| std::str::from_utf8(bytes).map(|s| s.trim_matches(['\0', ' ']));
    let mut files = Vec::new();
    let mut rest = archive;
    while let Some((header, after)) = rest.split_at_checked(512) {
        if header[0] == 0 {
            break;
        }
        let name = text(&header[..100])?;
        let size = usize::from_str_radix(text(&header[124..136])?, 8)?;
        let contents = after.get(..size).ok_or("the archive is torn")?;
        files.push((name, contents));
        rest = after.get(size.next_multiple_of(512)..).unwrap_or_default();
    }
    Ok(files)
}

struct RawSight {
    point: i32,
    camera: usize,
    pixel: Vector2<f64>,
}

/// The rest of a file.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Box<dyn Error>> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("a file is torn")?;
        self.0 = rest;
        Ok(taken)
    }

    fn int(&mut self) -> Result<i32, Box<dyn Error>> {
        Ok(i32::from_le_bytes(self.take(4)?.try_into()?))
    }

    fn count(&mut self) -> Result<usize, Box<dyn Error>> {
        Ok(usize::try_from(self.int()?)?)
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
        let (numbers, _) = self.take(4 * count)?.as_chunks();
        Ok(numbers
            .iter()
            .map(|b| f64::from(f32::from_le_bytes(*b)))
            .collect())
    }

    fn line(&mut self) -> Result<(), Box<dyn Error>> {
        let end = self.0.iter().position(|b| *b == b'\n');
        self.take(end.ok_or("a line without end")? + 1)?;
        Ok(())
    }

    fn sights(&mut self) -> Result<Vec<RawSight>, Box<dyn Error>> {
        let count = self.count()?;
        let mut sights = Vec::new();
        for _ in 0..count {
            let point = self.int()?;
            let pixel = self.floats(2)?;
            // The covariance, which is one pixel.
            self.take(16)?;
            let camera = usize::from(self.take(4)?[0] != 0);
            sights.push(RawSight {
                point,
                camera,
                pixel: Vector2::new(pixel[0], pixel[1]),
            });
        }
        Ok(sights)
    }
}
