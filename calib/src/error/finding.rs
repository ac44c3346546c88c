//! Refusals of a calibration as findings: the name of the check, what it is about, the number that was judged, and what to do.

use lsfb_types::{Finding, Limit, Verdict};

use super::reasons::{BadImu, NoRest, PoorMotion, SeenInstead, WrongSize, WrongUnit};
use super::{Error, missed};

/// Of several checks that fail: the code is that of a check of a calibration that is made, where there is one of the same.
fn fail(code: &'static str, subject: &str, what: impl Into<String>) -> Finding {
    Finding::new(code, Verdict::Fail, subject, what)
}

impl Error {
    /// What was found, where the data is refused; `None` where something could not be read or done at all, or was asked for wrongly.
    pub fn finding(&self) -> Option<Finding> {
        Some(match self {
            Self::TargetNotSeen {
                camera,
                found,
                images,
                needed,
                target,
            } => fail(
                "target-not-seen",
                camera,
                format!("the target was found in {found} of {images} images"),
            )
            .value(*found as f64, "")
            .limit(Limit::AtLeast(*needed as f64))
            .remedy(format!(
                "check the target's kind and size ({target}), the focus, and that the whole board is lit"
            )),
            Self::CopiedImages {
                camera,
                found,
                different,
                needed,
            } => fail(
                "copies",
                camera,
                format!(
                    "the target was found in {found} images, but only {different} of them differ, as the others are duplicates"
                ),
            )
            .value(*different as f64, "")
            .limit(Limit::AtLeast(*needed as f64))
            .remedy(
                "move the board or the camera between images, and check that the camera does not repeat images",
            ),
            Self::OtherTarget {
                camera,
                target,
                images,
                instead,
            } => fail(
                "other-target",
                camera,
                format!("the {target} is in none of {images} images, but {instead}"),
            )
            .remedy(instead.remedy()),
            Self::DoesNotFit {
                camera,
                rms_px,
                target,
                model,
            } => fail(
                "fit",
                camera,
                format!(
                    "{}: the target's geometry is wrong ({target}), the board is upside down or bent, or the lens is not {model}",
                    missed(*rms_px)
                ),
            )
            .value(*rms_px, "px")
            .remedy("measure the board, look at how it hangs, or name another lens model"),
            Self::AnotherModelFits {
                camera,
                model,
                rms_px,
                other,
                other_rms_px,
            } => fail(
                "lens-model",
                camera,
                format!(
                    "the lens model {model} does not fit these views ({}), but {other} does, with a reprojection error of {other_rms_px:.2} px",
                    missed(*rms_px)
                ),
            )
            .value(*rms_px, "px")
            .remedy(format!("use --model {other}")),
            Self::Undetermined {
                camera,
                parameters,
                advice,
            } => fail(
                "undetermined",
                camera,
                format!("{parameters} cannot be determined from these views"),
            )
            .remedy(*advice),
            Self::SameImages { first, second } => fail(
                "same-images",
                &format!("{first} and {second}"),
                "they show the same images",
            )
            .remedy("give each its own folder or topic"),
            Self::Unit { what, problem } => problem.finding(what),
            Self::NotJoined {
                first,
                second,
                cause,
            } => cause.finding(&format!("{first} and {second}"))?,
            Self::Motion(poor) => poor.finding(),
            Self::Imu(bad) => bad.finding(),
            Self::NotAtRest(restless) => restless.finding(),
            Self::BoardNotSeen {
                found,
                scans,
                needed,
                width_m,
                height_m,
            } => fail(
                "board-not-seen",
                "lidar",
                format!(
                    "a board of {:.0} × {:.0} mm was found in {found} of {scans} scans",
                    width_m * 1e3,
                    height_m * 1e3
                ),
            )
            .value(*found as f64, "")
            .limit(Limit::AtLeast(*needed as f64))
            .remedy(
                "check its size, that it stands free (no wall or person within 20 cm behind it), and that at least three beams hit it",
            ),
            Self::BoardSize(wrong) => wrong.finding(),
            Self::OneSided {
                tilt_deg,
                needed_deg,
                direction,
                advice,
            } => fail(
                "one-sided",
                "board",
                format!(
                    "translation along {direction} depends on its outlines alone, since its normals differ by only {tilt_deg:.1}° about a second axis"
                ),
            )
            .value(*tilt_deg, "°")
            .limit(Limit::AtLeast(*needed_deg))
            .remedy(advice.as_str()),
            Self::Solver(problem) => {
                let found = problem.finding()?;
                let what = format!("solving failed: {problem}");
                Finding { what, ..found }
            }
            Self::Io { .. }
            | Self::Image(_)
            | Self::Dataset(_)
            | Self::Parse { .. }
            | Self::Target(_)
            | Self::Setting(_)
            | Self::Stopped(_) => return None,
        })
    }
}

impl SeenInstead {
    fn remedy(self) -> &'static str {
        match self {
            Self::Mirrored { .. } => {
                "turn off image flipping in the camera driver, or print the board again"
            }
            Self::OtherTags { .. } => "name the board that is used, or use the one that is named",
        }
    }
}

impl WrongUnit {
    fn finding(&self, subject: &str) -> Finding {
        let of = |code| fail(code, subject, self.to_string());
        match self {
            Self::Stamps { step, .. } => of("stamp-unit")
                .value(*step as f64, "ns")
                .remedy("convert them to nanoseconds"),
            Self::NoStamps { step } => of("stamp-unit")
                .value(*step as f64, "ns")
                .remedy("give them in nanoseconds"),
            Self::Degrees { rate_rad_s } => of("gyro-unit")
                .value(*rate_rad_s, "rad/s")
                .remedy("convert them to radians per second"),
        }
    }
}

impl PoorMotion {
    fn finding(&self) -> Finding {
        let of = |code| fail(code, "motion", format!("it is too poor: {self}"));
        match self {
            Self::NothingSeen => {
                of("target-not-seen").remedy("keep the whole board in view, lit and in focus")
            }
            Self::OneAxis => of("motion").remedy("rotate the rig about all three"),
            Self::FewTurns { axes, needed_rad_s } => {
                let names: Vec<&str> = axes.iter().map(|(axis, _)| *axis).collect();
                let least = axes
                    .iter()
                    .map(|(_, rate)| *rate)
                    .fold(f64::INFINITY, f64::min);
                of("motion")
                    .value(least, "rad/s")
                    .limit(Limit::AtLeast(*needed_rad_s))
                    .remedy(format!("rotate more about {}", names.join(" and ")))
            }
        }
    }
}

impl BadImu {
    fn finding(&self) -> Finding {
        let of = |code| fail(code, "IMU", self.to_string());
        match self {
            Self::Gravity {
                mean_m_s2, is_in_g, ..
            } => of("gravity")
                .value(*mean_m_s2, "m/s²")
                .remedy(match is_in_g {
                    true => "convert to m/s²",
                    false => "check its unit and its range, and that gravity was not subtracted",
                }),
            Self::LeftHanded { .. } => {
                of("gyro-axes").remedy("correct signs and order of the gyroscope's axes")
            }
            Self::OtherAxes { .. } => {
                of("gyro-axes").remedy("correct scale and order of the gyroscope's axes")
            }
        }
    }
}

impl NoRest {
    fn finding(&self) -> Finding {
        let what = format!("the noise cannot be determined from it: {self}");
        let of = |code| fail(code, "recording", what.clone());
        match self {
            Self::NoSample => of("no-samples").remedy("check the file or topic of the IMU"),
            Self::BadSample { .. } => of("bad-samples").remedy("check the IMU's driver"),
            Self::Short { length_s, needed_s } => of("short")
                .value(*length_s, "s")
                .limit(Limit::AtLeast(*needed_s))
                .remedy("record for longer, and two hours for the random walk"),
            Self::Missing { missing, .. } => of("missing-samples")
                .value(*missing, "")
                .remedy("find out why they are lost (`lsfb doctor`)"),
            Self::Repeated { repeated, .. } => of("repeated")
                .value(*repeated as f64, "")
                .remedy("have the driver stamp each sample"),
            Self::Moved { .. } => of("rest")
                .remedy("put it on solid ground, away from footsteps and fans, and record again"),
        }
    }
}

impl WrongSize {
    fn finding(&self) -> Finding {
        let found = fail("board-size", "board", format!("its size is wrong: {self}"));
        match self {
            Self::OtherScale { factor, .. } => found.value(*factor, "").remedy("measure it"),
            Self::Measured { pattern, .. } => found
                .value(100.0 * pattern.share, "%")
                .sigma(100.0 * pattern.sigma)
                .remedy("measure it and correct the target"),
            Self::Exchanged { exchanged, .. } => found
                .value(*exchanged as f64, "")
                .remedy("swap width and height"),
        }
    }
}
