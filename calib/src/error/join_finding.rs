//! Why two sensors cannot be joined, as findings.

use lsfb_types::{Finding, Limit, Verdict};

use super::join::JoinProblem;

impl JoinProblem {
    /// About `subject`, both sensors; `None` where what was given is wrong, not what was measured.
    pub(super) fn finding(&self, subject: &str) -> Option<Finding> {
        let of = |code: &'static str| Finding::new(code, Verdict::Fail, subject, self.to_string());
        Some(match self {
            Self::NamedTwice
            | Self::SameSensor
            | Self::NoChain
            | Self::NoTransform
            | Self::GivenTwice
            | Self::NoLidar => return None,
            Self::FewInstants { shared, needed } => of("few-instants")
                .value(*shared as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy(
                    "check that they are triggered together and that their fields of view overlap",
                ),
            Self::OppositeEnds => of("upside-down").remedy(
                "use a checkerboard with an odd number of inner corners along one edge and an even number along the other, whose ends can be told apart",
            ),
            Self::ShiftedPairs { by } => of("shifted-pairs")
                .value(*by as f64, "")
                .remedy("trigger them together, or give images that are paired by their stamps"),
            Self::Exchanged { exchanged, .. } => of("swapped")
                .value(*exchanged as f64, "")
                .remedy("exchange these images, or leave them out"),
            Self::MissTogether { rms_px } => of("together")
                .value(*rms_px, "px")
                .remedy("check their triggers, stamps and mounts"),
            Self::Swapped => of("swapped").remedy("exchange their names, or their images"),
            Self::Misplaced { shift_m, .. } => of("misplaced")
                .value(1e3 * shift_m, "mm")
                .remedy("check which camera is which, or calibrate the cameras first"),
            Self::NoSample => of("no-samples").remedy("check the file or topic of the IMU"),
            Self::BadSample { .. } => of("bad-samples").remedy("check the IMU's driver"),
            Self::RepeatedStamps { repeated, .. } => of("repeated")
                .value(*repeated as f64, "")
                .remedy("have the driver stamp each sample"),
            Self::FewSamples {
                samples, needed, ..
            } => of("few-samples")
                .value(*samples as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("check the clocks"),
            Self::FewRates { pairs, needed, .. } => of("few-samples")
                .value(*pairs as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("check the clocks"),
            Self::ClocksDrift {
                first_half_s,
                second_half_s,
            } => of("clock-drift")
                .value(1e3 * (second_half_s - first_half_s), "ms")
                .remedy("have both stamped by one clock (`lsfb clock` compares clocks)"),
            Self::FarOffset {
                offset_s,
                largest_s,
            } => of("clock-offset")
                .value(offset_s.abs(), "s")
                .limit(Limit::AtMost(*largest_s))
                .remedy("correct the stamps (`lsfb clock` compares clocks), or raise max_offset_s"),
            Self::InDegrees => of("gyro-unit").remedy("convert them to radians per second"),
            Self::TurnApart { agreement, .. } => of("clocks")
                .value(100.0 * agreement.max(0.0), "%")
                .remedy("check both clocks, and that one device recorded both"),
            Self::RollingShutter { found_s, .. } => of("rolling-shutter")
                .value(1e3 * found_s, "ms")
                .remedy(
                    "set the camera's readout_s in the rig (--rig), or estimate it (readout = \"estimated\" in --config)",
                ),
            Self::MissAlongMotion { together_px, .. } => of("imu-fit")
                .value(*together_px, "px")
                .remedy(
                    "check the accelerometer's axes, whether images are flipped, and the board's size",
                ),
            Self::NotSeen { .. } => of("target-not-seen")
                .value(0.0, "")
                .remedy("check its kind and size, the focus, and that the whole board is lit"),
            Self::NoSameNumber { .. } => of("no-pairs")
                .value(0.0, "")
                .remedy("name images and clouds of one pose by the same number"),
            Self::NoSameTime { .. } => of("no-pairs").value(0.0, "").remedy(
                "record both at once, and check with `lsfb clock` that their clocks agree",
            ),
            Self::AlwaysMoving { .. } => {
                of("rest").remedy("hold board and rig still for two seconds in each pose")
            }
            Self::PointsOnALine => of("points-on-a-line").remedy("remove this pose"),
            Self::NoTransformFits { found, needed, .. } => of("no-transform-fits")
                .value(*found as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy(
                    "check that scans and images belong together and that the board stood still and free",
                ),
            Self::FewPoses { left, needed } => of("poses")
                .value(*left as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("record more"),
            Self::WeightsUnsettled => of("not-converged").remedy("record more poses"),
            Self::MiddlesApart { rms_m, .. } => of("boards-apart").value(1e3 * rms_m, "mm").remedy(
                "check that images and scans belong together, and measure the board",
            ),
            Self::NoCamera => of("no-images").remedy("check the names"),
            Self::NoScans => of("no-scans").remedy("record with the LiDAR on"),
            Self::ShortScans { length_s, needed_s } => of("short")
                .value(*length_s, "s")
                .limit(Limit::AtLeast(*needed_s))
                .remedy("walk through a furnished place for 30 s, and turn"),
            Self::ScansUnregistered => of("lost")
                .remedy("record a place with walls, floor and furniture within 20 m"),
        })
    }
}
