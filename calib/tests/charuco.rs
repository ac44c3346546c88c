//! ChArUco boards drawn from their own PDF geometry by OpenCV's rules, seen through a known homography.

use lsfb_calib::Target;
use lsfb_calib::board::{MarkerDictionary, PageSize};
use lsfb_calib::detect::detect;
use lsfb_geometry::{Matrix3, Vector2, Vector3};
use lsfb_types::Image;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
/// Samples of a pixel along each axis; edges along them are a quarter of a pixel coarse, slanted ones are not.
const FINE: u32 = 4;

fn board(dictionary: MarkerDictionary) -> Target {
    Target::Charuco {
        columns: 8,
        rows: 6,
        square_m: 0.03,
        marker_m: 0.0225,
        dictionary,
    }
}

/// What is black on the printed page: rectangles of the PDF, metres from the pattern's upper left, y down.
fn black(target: &Target) -> Vec<[f64; 4]> {
    let page = PageSize {
        width_m: 0.24,
        height_m: 0.18,
    };
    let text = String::from_utf8(target.to_pdf(page).expect("a page")).expect("text");
    let metres = 0.0254 / 72.0;
    text.lines()
        .filter_map(|line| line.strip_suffix(" re"))
        .map(|line| {
            let n: Vec<f64> = line
                .split(' ')
                .map(|n| n.parse::<f64>().expect("a number") * metres)
                .collect();
            [
                n[0],
                page.height_m - n[1] - n[3],
                n[0] + n[2],
                page.height_m - n[1],
            ]
        })
        .collect()
}

/// The pattern as a camera sees it that looks through `pixel_from_page` (metres from the upper left).
fn picture(black: &[[f64; 4]], pixel_from_page: &Matrix3<f64>) -> Image {
    let page_from_pixel = pixel_from_page.try_inverse().expect("a homography");
    // Small cells are dark or light as a whole: a grid is faster than a search.
    const CELL_M: f64 = 0.00025;
    let (columns, rows) = (960, 720);
    let mut dark = vec![false; columns * rows];
    for [left, top, right, bottom] in black {
        let cells = |a: f64, b: f64| (a / CELL_M).round() as usize..(b / CELL_M).round() as usize;
        for y in cells(*top, *bottom) {
            for x in cells(*left, *right) {
                dark[y * columns + x] = true;
            }
        }
    }
    let is_dark = |p: Vector2<f64>| {
        let (x, y) = ((p.x / CELL_M).floor(), (p.y / CELL_M).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < columns as f64 && y < rows as f64;
        inside && dark[y as usize * columns + x as usize]
    };
    let mut pixels = Vec::with_capacity((WIDTH * HEIGHT) as usize);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let mut light = 0;
            for k in 0..FINE * FINE {
                let at =
                    |n: u32, k: u32| f64::from(n) + (f64::from(k) + 0.5) / f64::from(FINE) - 0.5;
                let p = page_from_pixel * Vector3::new(at(x, k % FINE), at(y, k / FINE), 1.0);
                light += u32::from(!is_dark(Vector2::new(p.x / p.z, p.y / p.z)));
            }
            pixels.push((30 + 190 * light / (FINE * FINE)) as u8);
        }
    }
    Image {
        width: WIDTH,
        height: HEIGHT,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    }
}

/// Turned by so many degrees, tilted a little, the middle of the page in the middle of the image.
fn view(degrees: f64) -> Matrix3<f64> {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (fx, fy) = (1900.0, 1850.0);
    let turned = Matrix3::new(
        fx * cos,
        -fx * sin,
        0.0,
        fy * sin,
        fy * cos,
        0.0,
        0.7,
        -0.5,
        1.0,
    );
    let centred = Matrix3::new(1.0, 0.0, -0.12, 0.0, 1.0, -0.09, 0.0, 0.0, 1.0);
    Matrix3::new(1.0, 0.0, 320.3, 0.0, 1.0, 240.2, 0.0, 0.0, 1.0) * turned * centred
}

/// Where a corner is in truth.
fn truth(target: &Target, index: usize, pixel_from_page: &Matrix3<f64>) -> Vector2<f64> {
    let corner = target.corner(index);
    // The first inner corner lies a square from the upper left.
    let p = pixel_from_page * Vector3::new(corner.x + 0.03, corner.y + 0.03, 1.0);
    Vector2::new(p.x / p.z, p.y / p.z)
}

#[test]
fn every_corner_has_its_number_however_the_board_is_turned() {
    for dictionary in [
        MarkerDictionary::Aruco4x4,
        MarkerDictionary::Aruco5x5,
        MarkerDictionary::Aruco6x6,
    ] {
        let target = board(dictionary);
        let black = black(&target);
        for degrees in [8.0, 52.0, 98.0, 187.0, 278.0] {
            let pixel_from_page = view(degrees);
            let corners = detect(&picture(&black, &pixel_from_page), &target);
            assert_eq!(corners.len(), 35, "{} at {degrees}°", dictionary.name());
            for corner in corners {
                let off = (corner.pixel - truth(&target, corner.index, &pixel_from_page)).norm();
                assert!(
                    off < 0.1,
                    "{} at {degrees}°: corner {} off {off}",
                    dictionary.name(),
                    corner.index
                );
            }
        }
    }
}

#[test]
fn a_part_of_the_board_is_enough_and_another_board_is_none() {
    let target = board(MarkerDictionary::Aruco5x5);
    let pixel_from_page = view(20.0);
    let mut image = picture(&black(&target), &pixel_from_page);
    // A hand before the upper left half.
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            if x + y < 480 {
                image.pixels[(y * WIDTH + x) as usize] = 120;
            }
        }
    }
    let corners = detect(&image, &target);
    assert!((10..30).contains(&corners.len()), "{}", corners.len());
    for corner in &corners {
        // The hand's own edge bends what is close to it.
        if (corner.pixel.x + corner.pixel.y - 480.0).abs() < 20.0 {
            continue;
        }
        let off = (corner.pixel - truth(&target, corner.index, &pixel_from_page)).norm();
        assert!(off < 0.1, "corner {} off {off}", corner.index);
    }
    for other in [
        board(MarkerDictionary::Aruco4x4),
        board(MarkerDictionary::Aruco6x6),
    ] {
        assert!(detect(&image, &other).is_empty());
    }
}
