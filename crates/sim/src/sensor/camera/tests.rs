use super::*;
use crate::config::{CameraConfig, LensKind, SimConfig};
use crate::simulation::Simulation;
use crate::world::canvas::Canvas;
use crate::world::{Facet, Outline, World};
use lsfb_geometry::{Vector3, so3};
use lsfb_types::no_progress;

fn camera(config: &SimConfig) -> RigCamera {
    crate::rigs::backpack(config).cameras["cam0"].clone()
}

/// Brightness between pixels.
fn at(image: &Image, x: f64, y: f64) -> f64 {
    let (i, j) = (x as usize, y as usize);
    let (u, v) = (x - i as f64, y - j as f64);
    let p = |i: usize, j: usize| f64::from(image.pixels[j * image.width as usize + i]);
    (p(i, j) * (1.0 - u) + p(i + 1, j) * u) * (1.0 - v)
        + (p(i, j + 1) * (1.0 - u) + p(i + 1, j + 1) * u) * v
}

/// A line in the image through which the border between dark and light passes: fitted to the places where the
/// brightness along the normal of the expected border crosses half. Returns the offsets from the expected line at
/// the first and the second end.
fn fitted_border(image: &Image, project: &dyn Fn(f64) -> Vector2<f64>) -> [f64; 2] {
    let mut sums = [0.0; 5];
    for k in 0..60 {
        // Away from the ends, where the next border is near.
        let s = 0.1 + 0.8 * (f64::from(k) + 0.5) / 60.0;
        let here = project(s);
        let along = (project(s + 0.01) - project(s - 0.01)).normalize();
        let normal = Vector2::new(-along.y, along.x);
        let value = |d: f64| at(image, here.x + d * normal.x, here.y + d * normal.y);
        let half = 0.5 * (value(-4.0) + value(4.0));
        let rising = value(4.0) > value(-4.0);
        let steps: Vec<f64> = (-30..=30).map(|i| 0.1 * f64::from(i)).collect();
        let crossing = steps
            .windows(2)
            .find(|w| (value(w[0]) > half) != rising && (value(w[1]) > half) == rising)
            .map(|w| 0.5 * (w[0] + w[1]))
            .expect("a border");
        sums[0] += 1.0;
        sums[1] += s;
        sums[2] += s * s;
        sums[3] += crossing;
        sums[4] += s * crossing;
    }
    let determinant = sums[0] * sums[2] - sums[1] * sums[1];
    let offset = (sums[2] * sums[3] - sums[1] * sums[4]) / determinant;
    let slope = (sums[0] * sums[4] - sums[1] * sums[3]) / determinant;
    [offset, offset + slope]
}

/// A card turned in its plane in front of the camera, and how far its four corners appear from where they should.
fn corner_errors(
    turn_rad: f32,
    centre: [f32; 3],
    side: f32,
    paint: Paint,
    cameras: &CameraConfig,
    motion: PoseAt,
) -> Vec<f64> {
    let config = SimConfig {
        scan_cameras: CameraConfig {
            read_noise: 0.5,
            ..cameras.clone()
        },
        ..SimConfig::default()
    };
    let camera = camera(&config);
    let sim = CameraSim::new(&camera, &config.scan_cameras, 1).expect("lens");
    let (sin, cos) = turn_rad.sin_cos();
    let a = [0.0, side * cos, side * sin];
    let b = [0.0, side * sin, -side * cos];
    let corner = std::array::from_fn(|i| centre[i] - 0.5 * (a[i] + b[i]));
    let facet = Facet::new(corner, a, b, Outline::Parallelogram);
    let (world, inset) = match paint {
        Paint::Silhouette => (World::test_card(facet, |_| {}), 0.0),
        Paint::Picture => {
            let low = 0.25 * side;
            let dark = |canvas: &mut Canvas| canvas.rectangle([low; 2], [side - low; 2], 0.2);
            (World::test_card(facet, dark), 0.25)
        }
    };
    let image = sim.render(&world, motion, 0.0, 4);
    let place = |s: f64, t: f64| {
        let [s, t] = [s, t].map(|v| inset + v * (1.0 - 2.0 * inset));
        let point = Vector3::from_fn(|i, _| {
            f64::from(corner[i]) + s * f64::from(a[i]) + t * f64::from(b[i])
        });
        // Where a row sees the point decides when, and when decides where.
        let mut row = 0.5 * f64::from(camera.camera.height);
        let mut pixel = Vector2::zeros();
        for _ in 0..8 {
            let world_from_camera = motion(sim.row_offset_s(row)) * camera.rig_from_camera;
            let in_camera = world_from_camera.inverse() * point;
            pixel = camera.camera.project(&in_camera).expect("before the lens");
            row = pixel.y;
        }
        pixel
    };
    let borders = [
        fitted_border(&image, &|s| place(s, 0.0)),
        fitted_border(&image, &|s| place(s, 1.0)),
        fitted_border(&image, &|s| place(0.0, s)),
        fitted_border(&image, &|s| place(1.0, s)),
    ];
    // The borders that meet at a corner are at right angles on the card, nearly so in the image.
    [
        borders[0][0].hypot(borders[2][0]),
        borders[0][1].hypot(borders[3][0]),
        borders[1][0].hypot(borders[2][1]),
        borders[1][1].hypot(borders[3][1]),
    ]
    .to_vec()
}

#[derive(Clone, Copy)]
enum Paint {
    /// The card is light, what is behind it black.
    Silhouette,
    /// A dark square on the card.
    Picture,
}

#[test]
fn corners_appear_where_the_rig_projects_them() {
    corners_are_right(&CameraConfig::default(), &|_| Se3::identity());
}

#[test]
fn corners_are_right_row_by_row_with_a_rolling_shutter_in_motion() {
    let phone = CameraConfig {
        lens: LensKind::PinholeRadtan,
        readout_ns: 25_000_000,
        width: 640,
        height: 480,
        focal_per_width: 0.55,
        ..CameraConfig::default()
    };
    // A brisk turn of the head while walking sideways.
    let motion = |t: f64| {
        let turned = so3::exp(&Vector3::new(0.3 * t, -0.4 * t, 1.2 * t));
        Se3::new(turned, Vector3::new(0.3 * t, 0.9 * t, -0.2 * t))
    };
    corners_are_right(&phone, &motion);
}

fn corners_are_right(cameras: &CameraConfig, motion: PoseAt) {
    for paint in [Paint::Silhouette, Paint::Picture] {
        let mut errors = Vec::new();
        for (k, [y, z]) in [[0.0, 0.1], [1.2, 0.5], [-1.3, -0.3], [0.9, -0.4]]
            .into_iter()
            .enumerate()
        {
            // Upright, almost upright, and turned; near, and so far that coarser mip levels are seen.
            for (turn, distance) in [(0.0, 1.0), (0.02, 2.0), (0.4, 2.0), (0.8, 3.0)] {
                let turn_rad = turn + 0.01 * k as f32;
                let centre = [2.0 * distance, y * distance, z * distance];
                errors.extend(corner_errors(
                    turn_rad,
                    centre,
                    0.6 * distance,
                    paint,
                    cameras,
                    motion,
                ));
            }
        }
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        assert!(
            worst < 0.3 && rms < 0.1,
            "corners off by {rms} px, at worst {worst} px"
        );
    }
}

#[test]
fn images_have_texture_everywhere_and_sound_brightness() {
    let mut config = SimConfig {
        texel_m: 0.006,
        ..SimConfig::default()
    };
    config.scan.duration_s = 12.0;
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    for camera in 0..4 {
        for frame in [5, 60] {
            let image = simulation
                .scan()
                .image(simulation.world(), camera, frame)
                .expect("camera")
                .sample;
            let mean =
                image.pixels.iter().map(|p| f64::from(*p)).sum::<f64>() / image.pixels.len() as f64;
            assert!(
                (50.0..190.0).contains(&mean),
                "camera {camera}: mean {mean}"
            );
            let clipped = image
                .pixels
                .iter()
                .filter(|p| **p == 255 || **p == 0)
                .count();
            assert!(clipped * 20 < image.pixels.len());
            // Cells of 40×40 pixels that hold a gradient well above the noise.
            let w = image.width as usize;
            let mut strong = 0;
            let mut cells = 0;
            for cy in 0..image.height as usize / 40 {
                for cx in 0..w / 40 {
                    cells += 1;
                    let mut best = 0;
                    for y in cy * 40 + 1..cy * 40 + 39 {
                        for x in cx * 40 + 1..cx * 40 + 39 {
                            let p = |x: usize, y: usize| i32::from(image.pixels[y * w + x]);
                            let gx = (p(x + 1, y) - p(x - 1, y)).abs();
                            let gy = (p(x, y + 1) - p(x, y - 1)).abs();
                            best = best.max(gx.min(gy));
                        }
                    }
                    strong += usize::from(best > 10);
                }
            }
            assert!(
                strong * 10 > cells * 8,
                "camera {camera}: {strong} of {cells} cells"
            );
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_image() {
    let simulation = Simulation::new(&SimConfig::tiny(), &no_progress).expect("valid");
    let on = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool")
            .install(|| simulation.glasses().image(simulation.world(), 1, 9))
    };
    assert_eq!(on(1), on(3));
    let again = Simulation::new(&SimConfig::tiny(), &no_progress).expect("valid");
    assert_eq!(on(2), again.glasses().image(again.world(), 1, 9));
    let other = SimConfig {
        seed: 2,
        ..SimConfig::tiny()
    };
    let other = Simulation::new(&other, &no_progress).expect("valid");
    assert_ne!(on(2), other.glasses().image(other.world(), 1, 9));
}

#[test]
fn automatic_exposure_brings_any_light_to_a_good_level() {
    let mut cameras = CameraConfig {
        auto_exposure: true,
        width: 160,
        height: 104,
        ..CameraConfig::default()
    };
    cameras.longest_exposure_ns = 8_000_000;
    let camera = camera(&SimConfig {
        scan_cameras: cameras.clone(),
        ..SimConfig::default()
    });
    let sim = CameraSim::new(&camera, &cameras, 1).expect("lens");
    let facet = Facet::new(
        [2.0, 9.0, -9.0],
        [0.0, -18.0, 0.0],
        [0.0, 0.0, 18.0],
        Outline::Parallelogram,
    );
    let mut exposures = Vec::new();
    for tone in [0.15, 0.4, 0.9] {
        let world = World::test_card(facet, |canvas| canvas.values.fill(tone));
        let image = sim.render(&world, &|_| Se3::identity(), 1.0, 0);
        let sum: f64 = image.pixels.iter().map(|p| f64::from(*p)).sum();
        let mean = sum / image.pixels.len() as f64;
        assert!((95.0..160.0).contains(&mean), "tone {tone}: {mean}");
        exposures.push(image.exposure_ns);
    }
    assert!(
        exposures[0] == 8_000_000 && exposures[2] < 3_000_000,
        "{exposures:?}"
    );
}

#[test]
fn motion_during_the_exposure_blurs_along_the_motion_only() {
    let cameras = CameraConfig {
        motion_blur: true,
        exposure_ns: 20_000_000,
        read_noise: 0.0,
        shot_noise: 0.0,
        ..CameraConfig::default()
    };
    let camera = camera(&SimConfig {
        scan_cameras: cameras.clone(),
        ..SimConfig::default()
    });
    let sim = CameraSim::new(&camera, &cameras, 1).expect("lens");
    let (corner, a, b) = ([2.0, 0.5, -0.35], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
    let facet = Facet::new(corner, a, b, Outline::Parallelogram);
    let world = World::test_card(facet, |_| {});
    let spread = |motion: PoseAt| {
        let image = sim.render(&world, motion, 0.0, 0);
        // Pixels between dark and light, across the row and down the column through the card's middle.
        let middle = camera.rig_from_camera.inverse() * Vector3::new(2.0, 0.0, 0.15);
        let pixel = camera.camera.project(&middle).expect("before the lens");
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let between = |p: &u8| (20..140).contains(p);
        let w = image.width as usize;
        let row = image.pixels[y * w..(y + 1) * w]
            .iter()
            .filter(|p| between(p))
            .count();
        let column = image
            .pixels
            .iter()
            .skip(x)
            .step_by(w)
            .filter(|p| between(p))
            .count();
        [row, column]
    };
    let still = spread(&|_| Se3::identity());
    let turning =
        spread(&|t| Se3::new(so3::exp(&Vector3::new(0.0, 0.0, 1.5 * t)), Vector3::zeros()));
    assert!(turning[0] >= still[0] + 8, "{still:?} {turning:?}");
    assert!(turning[1] <= still[1] + 4, "{still:?} {turning:?}");
}
