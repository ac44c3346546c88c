//! Clouds with poses as gtsam_points keeps them: `graph.txt` beside `planes_K.bin` and `edges_K.bin`, or beside folders with `points.bin`.

use std::path::{Path, PathBuf};

use lsfb_geometry::{Quaternion, Se3, UnitQuaternion, Vector3};
use lsfb_recording::cloud::{Cloud, PointTimes};
use lsfb_recording::sort_naturally;
use lsfb_types::{LidarPoint, LidarScan};

use crate::Error;

/// The poses: a line each, its name, x y z in metres, and a quaternion x y z w.
const GRAPH: &str = "graph.txt";
/// What names of files of planes and edges begin with.
const PLANES: &str = "planes_";
const EDGES: &str = "edges_";
/// Bytes of a point: three floats of four bytes, little-endian.
const POINT_BYTES: usize = 12;

/// A cloud and its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphCloud {
    /// Where the sensor was.
    pub world_from_lidar: Se3,
    /// All of its points, or those that its maker took for points of planes; in the frame of the sensor, metres.
    pub points: Vec<Vector3<f64>>,
    /// Those that he took for points of edges.
    pub edges: Vec<Vector3<f64>>,
}

/// Whether a folder is one of these.
pub fn is_graph_folder(folder: &Path) -> bool {
    folder.join(GRAPH).is_file()
}

/// Reads such a folder: as many clouds, in order of their names, as `graph.txt` has poses.
pub fn read_graph_folder(folder: &Path) -> Result<Vec<GraphCloud>, Error> {
    let graph = folder.join(GRAPH);
    let text = std::fs::read_to_string(&graph).map_err(|source| Error::Io {
        path: graph.clone(),
        source,
    })?;
    let refuse = |path: &Path, problem: String| Error::CloudFile {
        path: path.to_owned(),
        problem,
    };
    let lines = text.lines().enumerate();
    let lines = lines.filter(|(_, line)| !line.trim().is_empty());
    let poses: Vec<Se3> = lines
        .map(|(index, line)| {
            pose(line).ok_or_else(|| {
                let expected = "a name, x y z and a quaternion x y z w";
                refuse(&graph, format!("line {}: expected {expected}", index + 1))
            })
        })
        .collect::<Result<_, _>>()?;
    let clouds = cloud_files(folder)?;
    let edges = files(folder, EDGES)?;
    if clouds.len() != poses.len() || !(edges.is_empty() || edges.len() == poses.len()) {
        let (clouds, edges) = (clouds.len(), edges.len());
        let found = format!(
            "{} poses, but {clouds} clouds and {edges} of edges",
            poses.len()
        );
        return Err(refuse(&graph, found));
    }
    let mut read = Vec::with_capacity(poses.len());
    for (k, (world_from_lidar, path)) in poses.into_iter().zip(&clouds).enumerate() {
        read.push(GraphCloud {
            world_from_lidar,
            points: points(path)?,
            edges: edges.get(k).map_or(Ok(Vec::new()), |path| points(path))?,
        });
    }
    Ok(read)
}

fn pose(line: &str) -> Option<Se3> {
    let numbers = line.split_whitespace().skip(1).map(str::parse);
    let numbers: Vec<f64> = numbers.collect::<Result<_, _>>().ok()?;
    let [x, y, z, qx, qy, qz, qw] = numbers.try_into().ok()?;
    let rotation = Quaternion::new(qw, qx, qy, qz);
    let finite = [x, y, z].iter().all(|v| v.is_finite());
    // Files print six digits.
    let is_rotation = (rotation.norm() - 1.0).abs() < 1e-3;
    (finite && is_rotation).then(|| {
        let rotation = UnitQuaternion::from_quaternion(rotation);
        Se3::new(rotation, Vector3::new(x, y, z))
    })
}

/// The files of its clouds, in order: all of their points, or those of planes.
pub(super) fn cloud_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let planes = files(folder, PLANES)?;
    match planes.is_empty() {
        true => clouds_of_folders(folder),
        false => Ok(planes),
    }
}

/// All points of one of its clouds, those of edges behind those of planes.
pub(super) fn read_whole(file: &Path) -> Result<Cloud, Error> {
    let mut positions = points(file)?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    if let Some(number) = name.strip_prefix(PLANES) {
        let edges = file.with_file_name(format!("{EDGES}{number}"));
        if edges.is_file() {
            positions.extend(points(&edges)?);
        }
    }
    let points = positions.into_iter().map(|p| LidarPoint {
        position_m: p.map(|c| c as f32).into(),
        ..LidarPoint::default()
    });
    Ok(Cloud {
        scan: LidarScan {
            points: points.collect(),
        },
        times: PointTimes::Absent,
    })
}

/// Files of a folder whose names begin so.
fn files(folder: &Path, begins: &str) -> Result<Vec<PathBuf>, Error> {
    let mut found = entries(folder)?;
    found.retain(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(begins) && name.ends_with(".bin") && path.is_file()
    });
    Ok(found)
}

fn clouds_of_folders(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let inside = entries(folder)?.into_iter().map(|f| f.join("points.bin"));
    Ok(inside.filter(|path| path.is_file()).collect())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let io = |source| Error::Io {
        path: folder.to_owned(),
        source,
    };
    let listed = std::fs::read_dir(folder).map_err(io)?;
    let paths = listed.map(|entry| Ok(entry.map_err(io)?.path()));
    let mut paths: Vec<PathBuf> = paths.collect::<Result<_, Error>>()?;
    sort_naturally(&mut paths);
    Ok(paths)
}

/// Points whose coordinates are finite.
fn points(path: &Path) -> Result<Vec<Vector3<f64>>, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })?;
    if !bytes.len().is_multiple_of(POINT_BYTES) {
        let problem = format!(
            "{} bytes are not a whole number of points of {POINT_BYTES} bytes",
            bytes.len()
        );
        return Err(Error::CloudFile {
            path: path.to_owned(),
            problem,
        });
    }
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let each = bytes.chunks_exact(POINT_BYTES);
    let points = each.map(|p| Vector3::new(float(p), float(&p[4..]), float(&p[8..])));
    Ok(points.filter(|p| p.iter().all(|v| v.is_finite())).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(points: &[[f32; 3]]) -> Vec<u8> {
        points
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect()
    }

    #[test]
    fn a_folder_is_read_in_order_and_what_is_wrong_is_named() {
        let folder = tempfile::tempdir().expect("folder");
        let write = |name: &str, what: &[u8]| {
            std::fs::write(folder.path().join(name), what).expect("write");
        };
        write("graph.txt", b"v0 0 0 0 0 0 0 1\nv1 1 2 3 0 0 0.6 0.8\n");
        write("planes_2.bin", &bytes(&[[1.0, 2.0, 3.0]]));
        write(
            "planes_10.bin",
            &bytes(&[[4.0, 5.0, 6.0], [f32::NAN, 0.0, 0.0]]),
        );
        assert!(is_graph_folder(folder.path()));
        let read = read_graph_folder(folder.path()).expect("clouds");
        let lengths: Vec<usize> = read.iter().map(|c| c.points.len()).collect();
        assert_eq!(lengths, [1, 1]);
        assert_eq!(read[1].points[0], Vector3::new(4.0, 5.0, 6.0));
        assert_eq!(
            read[1].world_from_lidar.translation,
            Vector3::new(1.0, 2.0, 3.0)
        );
        assert!(read[0].edges.is_empty());
        let whole = |name: &str| read_whole(&folder.path().join(name)).expect("a cloud").scan;
        write("edges_10.bin", &bytes(&[[7.0, 8.0, 9.0]]));
        let positions = whole("planes_10.bin").points;
        let positions: Vec<_> = positions.iter().map(|p| p.position_m).collect();
        assert_eq!(positions, [[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
        assert_eq!(whole("planes_2.bin").points.len(), 1);
        std::fs::remove_file(folder.path().join("edges_10.bin")).expect("removed");
        let problem = || {
            let error = read_graph_folder(folder.path()).expect_err("wrong");
            error.to_string()
        };
        write("edges_2.bin", &bytes(&[]));
        assert!(problem().contains("2 poses, but 2 clouds and 1 of edges"));
        write("edges_10.bin", b"seven b");
        assert!(problem().contains("7 bytes"), "{}", problem());
        write("graph.txt", b"v0 0 0 0 0 0 0 2\n");
        assert!(problem().contains("line 1"), "{}", problem());
    }
}
