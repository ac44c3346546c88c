//! Dominant gradient directions around an extremum (Lowe, section 5).

use std::f32::consts::PI;

use super::scale_space::Plane;

const BINS: usize = 36;

/// Angle of `(x, y)` in radians, within 2e-4: an arctangent without a library call, the same on every machine.
pub(crate) fn fast_atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = small / (large + 1e-20);
    let s = t * t;
    // Minimax polynomial of atan on [0, 1] (Abramowitz and Stegun 4.4.49).
    let mut angle =
        t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    if ay > ax {
        angle = 0.5 * PI - angle;
    }
    if x < 0.0 {
        angle = PI - angle;
    }
    if y < 0.0 { -angle } else { angle }
}

/// Directions in (−π, π] whose histogram peak reaches `peak_ratio` of the highest, strongest first.
pub(crate) fn orientations(
    plane: &Plane,
    x: f32,
    y: f32,
    sigma: f32,
    peak_ratio: f32,
    limit: usize,
) -> Vec<f32> {
    let (cx, cy) = (x.round() as isize, y.round() as isize);
    let window = 1.5 * sigma;
    let radius = (3.0 * window).round() as isize;
    let falloff: Vec<f32> = (0..=radius)
        .map(|i| (-0.5 * (i as f32 / window).powi(2)).exp())
        .collect();
    let mut histogram = [0.0f32; BINS];
    let (top, bottom) = (
        (cy - radius).max(1),
        (cy + radius).min(plane.height as isize - 2),
    );
    let (left, right) = (
        (cx - radius).max(1),
        (cx + radius).min(plane.width as isize - 2),
    );
    let count = (right - left + 1).max(0) as usize;
    let mut magnitudes = vec![0.0f32; count];
    let mut positions = vec![0.0f32; count];
    for yy in top..=bottom {
        let weight_y = falloff[(yy - cy).unsigned_abs()];
        let from = left as usize - 1;
        let above = &plane.row(yy as usize - 1)[from + 1..from + 1 + count];
        let here = &plane.row(yy as usize)[from..from + 2 + count];
        let below = &plane.row(yy as usize + 1)[from + 1..from + 1 + count];
        // A row at a time, so that the compiler takes several lanes at once.
        for i in 0..count {
            let (dx, dy) = (here[i + 2] - here[i], below[i] - above[i]);
            magnitudes[i] = (dx * dx + dy * dy).sqrt();
            positions[i] = (fast_atan2(dy, dx) + PI) * (BINS as f32 / (2.0 * PI));
        }
        for (i, (magnitude, position)) in magnitudes.iter().zip(&positions).enumerate() {
            let weight = weight_y * falloff[(left + i as isize - cx).unsigned_abs()];
            histogram[(*position as usize).min(BINS - 1)] += weight * magnitude;
        }
    }
    for _ in 0..2 {
        histogram = smoothed(&histogram);
    }
    let highest = histogram.iter().copied().fold(0.0, f32::max);
    let mut peaks: Vec<(f32, f32)> = Vec::new();
    for bin in 0..BINS {
        let before = histogram[(bin + BINS - 1) % BINS];
        let after = histogram[(bin + 1) % BINS];
        let here = histogram[bin];
        if here > before && here >= after && here >= peak_ratio * highest {
            let offset = 0.5 * (before - after) / (before - 2.0 * here + after);
            let angle = (bin as f32 + 0.5 + offset) * (2.0 * PI / BINS as f32) - PI;
            peaks.push((here, wrapped(angle)));
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(limit);
    peaks.into_iter().map(|(_, angle)| angle).collect()
}

fn wrapped(angle: f32) -> f32 {
    if angle > PI {
        angle - 2.0 * PI
    } else if angle <= -PI {
        angle + 2.0 * PI
    } else {
        angle
    }
}

fn smoothed(histogram: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|i| {
        let at = |offset: usize| histogram[(i + BINS + offset - 2) % BINS];
        (at(0) + at(4)) * (1.0 / 16.0) + (at(1) + at(3)) * (4.0 / 16.0) + at(2) * (6.0 / 16.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arctangent_is_close_everywhere() {
        for i in 0..3600 {
            let angle = (i as f32 * 0.1 - 180.0).to_radians();
            let error = fast_atan2(angle.sin() * 3.0, angle.cos() * 3.0) - angle;
            assert!(wrapped(error).abs() < 2e-4, "{angle}: {error}");
        }
        assert_eq!(fast_atan2(0.0, 0.0), 0.0);
    }

    #[test]
    fn a_ramp_points_uphill() {
        for degrees in [-150.0f32, -90.0, 0.0, 33.0, 140.0] {
            let direction = degrees.to_radians();
            let mut plane = Plane::default();
            plane.resize(41, 41);
            for y in 0..41 {
                for x in 0..41 {
                    plane.values[y * 41 + x] =
                        0.01 * (direction.cos() * x as f32 + direction.sin() * y as f32);
                }
            }
            let found = orientations(&plane, 20.0, 20.0, 2.0, 0.8, 2);
            assert_eq!(found.len(), 1);
            let error = wrapped(found[0] - direction);
            assert!(error.abs() < 5f32.to_radians(), "{degrees}: {found:?}");
        }
    }
}
