//! How surely a point of the map that is there is found again.

/// Share of points that are found where they are there: 1 / (1 + exp −(a + b ln size + c aside + d spread)). Fitted by logistic regression to
/// 10 800 points that nine right walks of the standard trial (seed 45 in traced light, three places and devices) looked for.
const CERTAIN: f64 = 2.55;
const BY_LOG_SIZE: f64 = 4.4;
const BY_ASIDE_RAD: f64 = -8.2;
const BY_SPREAD: f64 = -9.0;
/// Farther aside it is no less sure, radians: too few points are looked for there to say.
const FARTHEST_ASIDE_RAD: f64 = 0.35;

/// What decides it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    /// How large the point is where the walk shows it largest, as a multiple of how large it is where the map's images show it smallest: what is
    /// smaller than the detector's finest scale is not there for it.
    pub size: f64,
    /// Smallest angle between a view of the walk and one of the map, radians.
    pub aside_rad: f64,
    /// How far the map's descriptors of it are apart at most, in units of their norm, divided by the number of images that show it: what two images
    /// alone have in common, and looks different in them, is often no point at all.
    pub spread_per_image: f64,
}

impl Expected {
    /// Share of such points that are found.
    pub fn share_found(&self) -> f64 {
        let odds = CERTAIN
            + BY_LOG_SIZE * self.size.clamp(f64::MIN_POSITIVE, 1.0).ln()
            + BY_ASIDE_RAD * self.aside_rad.min(FARTHEST_ASIDE_RAD)
            + BY_SPREAD * self.spread_per_image;
        1.0 / (1.0 + (-odds).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_seen_as_it_was_mapped_is_found_more_surely() {
        let sure = Expected {
            size: 1.2,
            aside_rad: 0.0,
            spread_per_image: 0.02,
        };
        assert!(sure.share_found() > 0.9);
        for less in [
            Expected { size: 0.6, ..sure },
            Expected {
                aside_rad: 0.3,
                ..sure
            },
            Expected {
                spread_per_image: 0.3,
                ..sure
            },
        ] {
            let share = less.share_found();
            assert!((0.25..0.8).contains(&share), "{share}");
        }
        assert!(Expected { size: 0.0, ..sure }.share_found() < 1e-9);
    }
}
