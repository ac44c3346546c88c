//! Faults of `lsfb calib lidar-camera`.

use super::*;
use board_walk::{Grid, rays, seen, write_png};
use lsfb_calib::camera::pose_of_target;
use lsfb_calib::lidar_camera::{BoardPose, MountedBoard};
use lsfb_geometry::{CameraTiming, Rig, RigCamera, RigLidar, Se3};
use lsfb_rigs::board::{BOARD, Session, calibrate, camera, error, truth};

fn session() -> Session {
    Session {
        poses: 8,
        ..Session::default()
    }
}

/// Writes `images/N.png` and `clouds/N.pcd`, the latter as those of pose `N + shift`.
fn write(path: &Path, board: &MountedBoard, poses: &[BoardPose], shift: usize) {
    let grid = Grid {
        columns: 6,
        rows: 6,
        tag_m: 0.088,
        spacing: 0.3,
        tags: Tags::Own,
    };
    let rays = rays(&camera());
    for name in ["images", "clouds"] {
        std::fs::create_dir_all(path.join(name)).expect("folder");
    }
    for (k, pose) in poses.iter().enumerate() {
        let corners = &pose.sights[0].corners;
        let seen_from = pose_of_target(&board.target, &camera(), corners).expect("a pose");
        let pixels = seen(&grid, &seen_from.inverse(), &rays);
        write_png(&path.join(format!("images/{k}.png")), &camera(), &pixels);
        let other = &poses[(k + shift) % poses.len()];
        std::fs::write(path.join(format!("clouds/{k}.pcd")), pcd(other)).expect("cloud");
    }
    std::fs::write(path.join("rig.toml"), rig(Se3::identity()).to_toml()).expect("rig");
}

/// The LiDAR is the rig; the other camera looks to the left.
fn rig(of_cam0: Se3) -> Rig {
    let here = truth().inverse();
    let left = Se3::exp(&lsfb_geometry::Vector6::new(0.0, 0.0, 1.57, 0.0, 0.0, 0.0)) * here;
    let mounted = |rig_from_camera: Se3| RigCamera {
        camera: camera(),
        rig_from_camera,
        timing: CameraTiming::default(),
        sigmas: Default::default(),
    };
    Rig {
        cameras: [
            ("cam0".to_owned(), mounted(of_cam0 * here)),
            ("cam1".to_owned(), mounted(left)),
        ]
        .into(),
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: 0.03,
        }
        .alone(),
        ..Rig::empty("backpack")
    }
}

fn pcd(pose: &BoardPose) -> Vec<u8> {
    let points = &pose.scan.points;
    let mut bytes = format!(
        "VERSION 0.7\nFIELDS x y z ring\nSIZE 4 4 4 2\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary\n",
        n = points.len()
    )
    .into_bytes();
    for point in points {
        bytes.extend(point.position_m.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend(point.ring.to_le_bytes());
    }
    bytes
}

fn arguments<'a>(grid: &'a str, plate: &'a str, camera: &'a str) -> Vec<&'a str> {
    let command = [
        "calib",
        "lidar-camera",
        "--rig",
        "rig.toml",
        "--clouds",
        "clouds",
    ];
    let rest = ["--april-grid", grid, "--plate-m", plate, "--camera", camera];
    [&command[..], &rest].concat()
}

const OWN: &str = "6,6,0.088,0.3";
const PLATE: &str = "0.83,0.75";

#[test]
fn boards_and_cameras() {
    let root = folder();
    let path = root.path();
    let poses = session().simulate(5);
    write(path, &BOARD, &poses, 0);
    let own = arguments(OWN, PLATE, "cam0=images");
    ends(path, &own, "good.toml", End::Pass, &[]);
    let page = std::fs::read_to_string(path.join("good.html")).expect("a page");
    assert!(page.contains("src=\"data:image/png;base64,"), "{page}");
    assert!(path.join("good.lidar.png").exists());
    // From rendered images as from the corners themselves.
    let from_corners = calibrate(&BOARD, &poses).expect("calibrated");
    let rig = Rig::read(&path.join("good.toml")).expect("rig");
    let found = rig.lidar().expect("a LiDAR").rig_from_lidar.log();
    let apart = (error(&from_corners) + found).norm();
    assert!(apart < 5e-3, "{apart}");
    // 5 % larger than specified, and 2 %.
    let larger = arguments("6,6,0.08381,0.3", PLATE, "cam0=images");
    ends(
        path,
        &larger,
        "larger.toml",
        End::Refused,
        &["% larger than specified", "tags of 8"],
    );
    let larger = arguments("6,6,0.08627,0.3", PLATE, "cam0=images");
    let words = &["% larger than specified", "measure it"];
    ends(path, &larger, "a_little.toml", End::Warn, words);
    let gaps = arguments("6,6,0.088,0.4", "0.86,0.86", "cam0=images");
    let words = &["gaps of 0.", "correct tagSpacing"];
    ends(path, &gaps, "gaps.toml", End::Refused, words);
    let wider = arguments(OWN, "0.89,0.75", "cam0=images");
    ends(
        path,
        &wider,
        "wider.toml",
        End::Warn,
        &["-60 mm longer", "x axis"],
    );
    let exchanged = arguments(OWN, "0.75,1.1", "cam0=images");
    ends(path, &exchanged, "sides.toml", End::Refused, &["board"]);
    let middle = [&own[..], &["--plate-offset-m", "0,0.035"]].concat();
    ends(
        path,
        &middle,
        "middle.toml",
        End::Warn,
        &["the plate's centre is at", "measure it"],
    );
    let swapped = arguments(OWN, PLATE, "cam1=images");
    let words = &[
        "found where the rig has cam0",
        "their images or their names are swapped",
    ];
    ends(path, &swapped, "swapped.toml", End::Warn, words);
    for (name, change, words) in [
        (
            "dark",
            (|row: &mut [u8]| row.fill(3)) as fn(&mut [u8]),
            &["the target was found in 0 of 8 images"][..],
        ),
        ("mirrored", |row| row.reverse(), &["show its tags mirrored"]),
    ] {
        std::fs::create_dir(path.join(name)).expect("folder");
        board_walk::changed_images(&path.join("images"), &path.join(name), change);
        let images = format!("cam0={name}");
        let blind = arguments(OWN, PLATE, &images);
        ends(path, &blind, "blind.toml", End::Refused, words);
    }
}

#[test]
fn poses() {
    for (name, session, shift, words) in [
        ("strangers", session(), 3, &["belong together"][..]),
        (
            "hidden",
            Session {
                behind_wall: true,
                ..session()
            },
            0,
            &["found in 0 of 8 scans", "stands free"],
        ),
        (
            "parallel",
            Session {
                tilt_rad: 0.0,
                ..session()
            },
            0,
            &["any direction along the board", "tilt the board about"],
        ),
    ] {
        let root = folder();
        write(root.path(), &BOARD, &session.simulate(5), shift);
        let own = arguments(OWN, PLATE, "cam0=images");
        ends(
            root.path(),
            &own,
            &format!("{name}.toml"),
            End::Refused,
            words,
        );
    }
}
