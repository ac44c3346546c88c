use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use arrow_buffer::{Buffer, ScalarBuffer};
use lsfb_geometry::{Rig, StampedPose};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    CovarianceColumns, DescriptorColumns, HdMap, KeyframeColumns, ObservationColumns, PointColumns,
    QualityColumns, SiteFrame,
};
use crate::Error;
use crate::arrow_file::{
    Column, Fingerprint, NamedColumn, Table, broken, length_and_crc32c, write_table,
};
use crate::descriptor_index::{self, DescriptorIndex};
use crate::features::{DESCRIPTOR_LEN, Feature, LearnedFeature};

/// Version of the folder's layout that is written.
pub const FORMAT_VERSION: u32 = 4;
/// The oldest version that is read: keyframes without covariances, which are unknown there.
const WITHOUT_COVARIANCES: u32 = 2;

const HEADER: &str = HdMap::HEADER;
const RIG: &str = "rig.toml";
/// Cameras as they were stated, where `RIG` has them as their images showed them; absent where there is none.
const STATED: &str = "rig_stated.toml";
/// Numbers of a quaternion are of length 1 up to this.
const UNIT_WITHIN: f64 = 1e-6;

const TABLES: [&str; 4] = [
    "points.arrow",
    "keyframes.arrow",
    "observations.arrow",
    "descriptors.arrow",
];
const POINTS: [&str; 16] = [
    "x_m",
    "y_m",
    "z_m",
    "first_observation",
    "first_descriptor",
    "cov_xx_m2",
    "cov_xy_m2",
    "cov_xz_m2",
    "cov_yy_m2",
    "cov_yz_m2",
    "cov_zz_m2",
    "rms_px",
    "view_x",
    "view_y",
    "view_z",
    "view_cos",
];
const KEYFRAMES: [&str; 8] = ["time_ns", "qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m"];
const COVARIANCES: [&str; 21] = [
    "cov_rx_rx_rad2",
    "cov_rx_ry_rad2",
    "cov_rx_rz_rad2",
    "cov_rx_tx_rad_m",
    "cov_rx_ty_rad_m",
    "cov_rx_tz_rad_m",
    "cov_ry_ry_rad2",
    "cov_ry_rz_rad2",
    "cov_ry_tx_rad_m",
    "cov_ry_ty_rad_m",
    "cov_ry_tz_rad_m",
    "cov_rz_rz_rad2",
    "cov_rz_tx_rad_m",
    "cov_rz_ty_rad_m",
    "cov_rz_tz_rad_m",
    "cov_tx_tx_m2",
    "cov_tx_ty_m2",
    "cov_tx_tz_m2",
    "cov_ty_ty_m2",
    "cov_ty_tz_m2",
    "cov_tz_tz_m2",
];
const OBSERVATIONS: [&str; 5] = ["point", "keyframe", "camera", "u_px", "v_px"];
const SIFT_DESCRIPTORS: [&str; 2] = ["point", "root_sift"];
const LEARNED_DESCRIPTORS: [&str; 2] = ["point", "learned"];

/// `map.toml`: only what decides whether the rest can be read comes first.
#[derive(Serialize, Deserialize)]
struct Version {
    format_version: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format_version: u32,
    provenance: String,
    points: usize,
    keyframes: usize,
    observations: usize,
    descriptors: usize,
    /// The network whose descriptors they are; absent of SIFT's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    learned: Option<LearnedFeature>,
    /// What was found wrong with the map when it was made.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    failures: Vec<String>,
    /// The surveyed frame that its world is; absent where nothing was surveyed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    site: Option<SiteFrame>,
    files: Vec<FileHash>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileHash {
    name: String,
    bytes: u64,
    sha256: String,
    /// Absent before version 4.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    crc32c: Option<String>,
}

impl FileHash {
    fn of(folder: &Path, name: &str) -> Result<Self, Error> {
        let Fingerprint {
            bytes,
            sha256,
            crc32c,
        } = Fingerprint::of(&folder.join(name))?;
        Ok(Self {
            name: name.to_owned(),
            bytes,
            sha256,
            crc32c: Some(crc32c),
        })
    }

    /// Refuses a file that is not the one listed, by its checksum, or its hash where it has none.
    fn check(&self, path: &Path) -> Result<(), Error> {
        let (bytes, is_listed, what) = match &self.crc32c {
            Some(listed) => {
                let (bytes, found) = length_and_crc32c(path)?;
                (bytes, found == *listed, "CRC-32C")
            }
            None => {
                let found = Fingerprint::of(path)?;
                (found.bytes, found.sha256 == self.sha256, "SHA-256")
            }
        };
        if bytes != self.bytes {
            let reason = format!("has {bytes} bytes instead of {}", self.bytes);
            return Err(broken(path, &reason));
        }
        if !is_listed {
            return Err(broken(
                path,
                &format!("its {what} is not the one in map.toml"),
            ));
        }
        Ok(())
    }
}

impl HdMap {
    /// Writes the map into a folder, which is made if need be: the files that `FORMAT.md` beside this module describes.
    ///
    /// `map.toml` is removed first and written last: a folder without it is half a map. The same map gives the same
    /// bytes.
    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
        let header_path = folder.join(HEADER);
        match fs::remove_file(&header_path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(Error::io(&header_path)(e));
            }
            _ => {}
        }
        let rig_path = folder.join(RIG);
        fs::write(&rig_path, self.rig.to_toml()).map_err(Error::io(&rig_path))?;
        let mut files = vec![FileHash::of(folder, RIG)?];
        if !self.stated.is_empty() {
            let mut stated = Rig::empty(&self.rig.name);
            stated.cameras = self.stated.clone();
            let path = folder.join(STATED);
            fs::write(&path, stated.to_toml()).map_err(Error::io(&path))?;
            files.push(FileHash::of(folder, STATED)?);
        }
        for (name, columns) in TABLES.iter().zip(self.tables()) {
            write_table(&folder.join(name), &columns)?;
            files.push(FileHash::of(folder, name)?);
        }
        self.index.write(folder)?;
        for name in descriptor_index::TABLES {
            files.push(FileHash::of(folder, name)?);
        }
        let header = Header {
            format_version: FORMAT_VERSION,
            provenance: self.provenance.clone(),
            points: self.point_count(),
            keyframes: self.keyframe_count(),
            observations: self.observation_count(),
            descriptors: self.descriptor_count(),
            learned: match &self.feature {
                Feature::Sift => None,
                Feature::Learned(learned) => Some(learned.clone()),
            },
            failures: self.failures.clone(),
            site: self.site.clone(),
            files,
        };
        let text = toml::to_string(&header)
            .map_err(|e| Error::io(&header_path)(std::io::Error::other(e)))?;
        let partial = folder.join("map.toml.partial");
        fs::write(&partial, text).map_err(Error::io(&partial))?;
        fs::rename(&partial, &header_path).map_err(Error::io(&header_path))
    }

    fn tables(&self) -> [Vec<NamedColumn>; 4] {
        let (p, k, o) = (&self.points, &self.keyframes, &self.observations);
        let d = &self.descriptors;
        let f64s = |v: &ScalarBuffer<f64>| Column::F64(v.clone());
        let u32s = |v: &ScalarBuffer<u32>| Column::U32(v.clone());
        let f32s = |v: &ScalarBuffer<f32>| Column::F32(v.clone());
        let bytes = |width, values: &Buffer| Column::Bytes {
            width,
            values: values.clone(),
        };
        let mut point_columns = vec![f64s(&p.x_m), f64s(&p.y_m), f64s(&p.z_m)];
        point_columns.extend([u32s(&p.first_observation), u32s(&p.first_descriptor)]);
        point_columns.extend(self.quality.columns().map(f32s));
        let mut keyframes = vec![Column::I64(k.time_ns.clone())];
        keyframes.extend(k.pose.iter().map(f64s));
        keyframes.extend(k.covariance.columns().iter().map(f64s));
        let named = |names: &[&'static str], columns: Vec<Column>| {
            names
                .iter()
                .copied()
                .zip(columns)
                .collect::<Vec<NamedColumn>>()
        };
        [
            named(&POINTS, point_columns),
            named(&[&KEYFRAMES[..], &COVARIANCES].concat(), keyframes),
            named(
                &OBSERVATIONS,
                vec![
                    u32s(&o.point),
                    u32s(&o.keyframe),
                    Column::U16(o.camera.clone()),
                    f32s(&o.u_px),
                    f32s(&o.v_px),
                ],
            ),
            named(
                descriptor_names(&self.feature),
                vec![u32s(&d.point), bytes(DESCRIPTOR_LEN, &d.values)],
            ),
        ]
    }

    /// Opens the map in a folder: checks version, lengths, checksums and that every reference leads somewhere, and maps
    /// the files into memory.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let header = read_header(folder)?;
        let feature = header.learned.clone().map_or(Feature::Sift, |learned| {
            Feature::Learned(learned.into_known())
        });
        let rig = open_rig(folder, &header, RIG)?;
        let stated = match header.files.iter().any(|f| f.name == STATED) {
            true => open_rig(folder, &header, STATED)?.cameras,
            false => BTreeMap::new(),
        };
        let names: Vec<&str> = TABLES.into_iter().chain(descriptor_index::TABLES).collect();
        // Every file is read whole for its checksum, each on a core of its own: of a large map that is what opening takes.
        let opened: Vec<Result<Table, Error>> = names
            .par_iter()
            .map(|name| open_table(folder, &header, name))
            .collect();
        let opened: Vec<Table> = opened.into_iter().collect::<Result<_, _>>()?;
        let [points, keyframes, observations, descriptors, index @ ..] = &opened[..] else {
            return Err(broken(&folder.join(HEADER), "some tables are missing"));
        };
        let [
            x_m,
            y_m,
            z_m,
            first_observation,
            first_descriptor,
            quality @ ..,
        ] = points.columns(POINTS)?;
        let [time_ns, pose @ ..] = keyframes.columns(KEYFRAMES)?;
        let [point, keyframe, camera, u_px, v_px] = observations.columns(OBSERVATIONS)?;
        let [owner, values] = descriptors.columns(*descriptor_names(&feature))?;
        let mut quality_columns = Vec::new();
        for column in quality {
            quality_columns.push(points.f32(column)?);
        }
        let time_ns = keyframes.i64(time_ns)?;
        let covariance = match header.format_version {
            WITHOUT_COVARIANCES => CovarianceColumns::unknown(time_ns.len()),
            _ => covariances(keyframes)?,
        };
        let mut pose_columns = Vec::new();
        for column in pose {
            pose_columns.push(keyframes.f64(column)?);
        }
        let map = Self {
            points: PointColumns {
                x_m: points.f64(x_m)?,
                y_m: points.f64(y_m)?,
                z_m: points.f64(z_m)?,
                first_observation: points.u32(first_observation)?,
                first_descriptor: points.u32(first_descriptor)?,
            },
            quality: QualityColumns::from_columns(quality_columns).ok_or_else(|| {
                broken(
                    &points.path,
                    "expected eleven columns for the quality of a point",
                )
            })?,
            keyframes: KeyframeColumns {
                time_ns,
                pose: pose_columns
                    .try_into()
                    .map_err(|_| broken(&keyframes.path, "expected seven columns for a pose"))?,
                covariance,
            },
            observations: ObservationColumns {
                point: observations.u32(point)?,
                keyframe: observations.u32(keyframe)?,
                camera: observations.u16(camera)?,
                u_px: observations.f32(u_px)?,
                v_px: observations.f32(v_px)?,
            },
            descriptors: DescriptorColumns {
                point: descriptors.u32(owner)?,
                values: descriptors.bytes(values, DESCRIPTOR_LEN)?,
            },
            index: DescriptorIndex::from_tables(index)?,
            cameras: rig.cameras.keys().cloned().collect(),
            rig,
            stated,
            feature,
            provenance: header.provenance.clone(),
            failures: header.failures.clone(),
            site: header.site.clone(),
        };
        map.check(folder, &header)?;
        Ok(map)
    }

    /// Every count and every reference, so that no later access can fail.
    fn check(&self, folder: &Path, header: &Header) -> Result<(), Error> {
        let within = |values: &[u32], limit: usize| values.iter().all(|v| (*v as usize) < limit);
        let ascending = |first: &[u32], limit: usize| {
            first.first().is_none_or(|v| *v == 0)
                && first.windows(2).all(|w| w[0] <= w[1])
                && first.last().is_none_or(|v| *v as usize <= limit)
        };
        let o = &self.observations;
        let counts_agree = [
            self.point_count() == header.points,
            self.keyframe_count() == header.keyframes,
            self.observation_count() == header.observations,
            self.descriptor_count() == header.descriptors,
            self.index.len() == header.descriptors,
        ];
        let checks: [(&str, bool); 3] = [
            (
                TABLES[0],
                ascending(&self.points.first_observation, header.observations)
                    && ascending(&self.points.first_descriptor, header.descriptors),
            ),
            (
                TABLES[2],
                within(&o.point, header.points)
                    && within(&o.keyframe, header.keyframes)
                    && o.camera
                        .iter()
                        .all(|c| usize::from(*c) < self.cameras.len()),
            ),
            (TABLES[3], within(&self.descriptors.point, header.points)),
        ];
        if counts_agree.contains(&false) {
            return Err(broken(
                &folder.join(HEADER),
                "its counts do not match the tables",
            ));
        }
        let is_pose = |pose: StampedPose| {
            let StampedPose { world_from_rig, .. } = pose;
            let is_turn = (world_from_rig.rotation.coords.norm() - 1.0).abs() < UNIT_WITHIN;
            is_turn && world_from_rig.translation.iter().all(|m| m.is_finite())
        };
        if !self.keyframes().all(is_pose) {
            return Err(broken(&folder.join(TABLES[1]), "a pose is invalid"));
        }
        let p = &self.points;
        let mut metres = p.x_m.iter().chain(p.y_m.iter()).chain(p.z_m.iter());
        if !metres.all(|m| m.is_finite()) {
            return Err(broken(&folder.join(TABLES[0]), "a position is invalid"));
        }
        match checks.iter().find(|(_, sound)| !sound) {
            Some((name, _)) => Err(broken(
                &folder.join(name),
                "a row has an index out of range",
            )),
            None => Ok(()),
        }
    }
}

/// What a table of keyframes says of how well they are known.
fn covariances(keyframes: &Table) -> Result<CovarianceColumns, Error> {
    let columns = keyframes.columns(COVARIANCES)?.into_iter();
    let columns: Vec<_> = columns
        .map(|column| keyframes.f64(column))
        .collect::<Result<_, _>>()?;
    CovarianceColumns::from_columns(columns)
        .ok_or_else(|| broken(&keyframes.path, "expected 21 columns for a covariance"))
}

/// Names of the descriptors' columns: a reader of one feature finds no other.
fn descriptor_names(feature: &Feature) -> &'static [&'static str; 2] {
    match feature {
        Feature::Sift => &SIFT_DESCRIPTORS,
        Feature::Learned(_) => &LEARNED_DESCRIPTORS,
    }
}

fn read_header(folder: &Path) -> Result<Header, Error> {
    let path = folder.join(HEADER);
    let text = match fs::read_to_string(&path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(Error::NoMap {
                folder: folder.to_owned(),
            });
        }
        other => other.map_err(Error::io(&path))?,
    };
    let version: Version = toml::from_str(&text).map_err(|e| broken(&path, e.message()))?;
    if !(WITHOUT_COVARIANCES..=FORMAT_VERSION).contains(&version.format_version) {
        return Err(Error::MapVersion {
            path,
            found: version.format_version,
            oldest: WITHOUT_COVARIANCES,
            expected: FORMAT_VERSION,
        });
    }
    toml::from_str(&text).map_err(|e| broken(&path, e.message()))
}

fn open_rig(folder: &Path, header: &Header, name: &str) -> Result<Rig, Error> {
    let Table { path, bytes } = open_table(folder, header, name)?;
    let text = std::str::from_utf8(&bytes).map_err(|_| broken(&path, "it is not text"))?;
    Rig::from_toml(text, &path.display().to_string()).map_err(|e| broken(&path, &e.to_string()))
}

fn open_table(folder: &Path, header: &Header, name: &str) -> Result<Table, Error> {
    let path = folder.join(name);
    let Some(expected) = header.files.iter().find(|f| f.name == name) else {
        return Err(broken(
            &folder.join(HEADER),
            &format!("does not list {name}"),
        ));
    };
    expected.check(&path)?;
    Table::map(path)
}
