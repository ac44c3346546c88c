//! What settings may be: each module lists the bounds of its own ([`bounds!`](crate::bounds)), and whatever lies outside is
//! refused with its name, its value and its bounds.

use std::fmt;

/// A setting outside its bounds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutOfBounds {
    /// Name of the setting, with the sections it is in.
    pub field: String,
    /// Its value.
    pub value: String,
    /// What it may be.
    pub bounds: String,
}

impl OutOfBounds {
    /// For a rule that no single number can break: `bounds` continues "it must be".
    pub fn new(
        section: &str,
        field: &str,
        value: &dyn fmt::Display,
        bounds: &dyn fmt::Display,
    ) -> Self {
        Self {
            field: setting_name(section, field),
            value: value.to_string(),
            bounds: bounds.to_string(),
        }
    }
}

impl fmt::Display for OutOfBounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            field,
            value,
            bounds,
        } = self;
        write!(f, "setting {field} is {value}: it must be {bounds}")
    }
}

impl std::error::Error for OutOfBounds {}

/// Name of a field in a section; settings that are not part of others have an empty one.
pub fn setting_name(section: &str, field: &str) -> String {
    if section.is_empty() {
        field.to_owned()
    } else {
        format!("{section}.{field}")
    }
}

/// The numbers that a setting may be, in its own unit. Never infinite, never NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// More than this.
    MoreThan(f64),
    /// This or more.
    AtLeast(f64),
    /// From the first to the second, both included.
    Within(f64, f64),
    /// From the first to the second, both excluded.
    Between(f64, f64),
    /// Zero, which switches something off, or from the first to the second.
    ZeroOr(f64, f64),
    /// A multiple of the first, from the second to the third, both included.
    MultipleOf(f64, f64, f64),
    /// What this is a multiple of.
    DivisorOf(f64),
}

impl Bounds {
    /// Anything above zero.
    pub const POSITIVE: Self = Self::MoreThan(0.0);
    /// Zero and anything above.
    pub const NOT_NEGATIVE: Self = Self::AtLeast(0.0);
    /// Counts of which one is needed.
    pub const AT_LEAST_ONE: Self = Self::AtLeast(1.0);

    /// Whether a value lies inside.
    pub fn hold(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::MoreThan(limit) => value > limit,
                Self::AtLeast(least) => value >= least,
                Self::Within(least, most) => is_within(value, least, most),
                Self::Between(below, above) => value > below && value < above,
                Self::ZeroOr(least, most) => value == 0.0 || is_within(value, least, most),
                Self::MultipleOf(step, least, most) => {
                    value % step == 0.0 && is_within(value, least, most)
                }
                Self::DivisorOf(whole) => value > 0.0 && whole % value == 0.0,
            }
    }
}

/// Whether a value lies between two, both taken in. A setting of single precision lies at a bound where it is as near as it can be.
fn is_within(value: f64, least: f64, most: f64) -> bool {
    let is_at = |bound: f64| value as f32 == bound as f32;
    (least..=most).contains(&value) || is_at(least) || is_at(most)
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MoreThan(limit) => write!(f, "more than {limit}"),
            Self::AtLeast(least) => write!(f, "{least} or more"),
            Self::Within(least, most) => write!(f, "{least} to {most}"),
            Self::Between(below, above) => write!(f, "more than {below} and less than {above}"),
            Self::ZeroOr(least, f64::INFINITY) => write!(f, "0, or {least} or more"),
            Self::ZeroOr(least, most) => write!(f, "0, or {least} to {most}"),
            Self::MultipleOf(step, least, most) => {
                write!(f, "a multiple of {step} from {least} to {most}")
            }
            Self::DivisorOf(whole) => write!(f, "a divisor of {whole}"),
        }
    }
}

/// Gives a struct of settings `check_bounds(&self, section) -> Result<(), OutOfBounds>`. Every field must be listed: one that was
/// forgotten does not compile.
///
/// A field is `number(bounds)`, `each(bounds)` of an array or list, `optional(bounds)`, `section` (settings with bounds of
/// their own), `sections` of a list of those, or `any` where its type allows nothing wrong. A field that files call otherwise is
/// listed `as` they call it. What fields must be to each other stands in a method that is named behind `also`: it is asked once each
/// field is within its bounds, wherever these settings are part of others.
///
/// ```
/// use lsfb_types::{Bounds, OutOfBounds};
///
/// struct Fine { step_m: f64, reach_m: f64 }
/// struct Search { rounds: u32, window_s: [f64; 2], fine: Fine, name: String }
///
/// lsfb_types::bounds! {
///     Fine {
///         step_m: number(Bounds::POSITIVE),
///         reach_m: number(Bounds::POSITIVE),
///     }
///     also reaches_a_step
/// }
/// impl Fine {
///     fn reaches_a_step(&self, section: &str) -> Result<(), OutOfBounds> {
///         match self.reach_m >= self.step_m {
///             true => Ok(()),
///             false => Err(OutOfBounds::new(section, "reach_m", &self.reach_m, &"step_m or more")),
///         }
///     }
/// }
/// lsfb_types::bounds! {
///     Search {
///         rounds: number(Bounds::Within(1.0, 8.0)),
///         window_s: each(Bounds::NOT_NEGATIVE),
///         fine: section,
///         name: any,
///     }
/// }
///
/// let refused = |step_m: f64| {
///     let fine = Fine { step_m, reach_m: 0.5 };
///     let search = Search { rounds: 3, window_s: [0.0, 1.0], fine, name: String::new() };
///     search.check_bounds("search").unwrap_err().to_string()
/// };
/// assert_eq!(refused(f64::NAN), "setting search.fine.step_m is NaN: it must be more than 0");
/// assert_eq!(refused(1.0), "setting search.fine.reach_m is 0.5: it must be step_m or more");
/// ```
#[macro_export]
macro_rules! bounds {
    (@name $field:ident) => {
        stringify!($field)
    };
    (@name $field:ident $name:literal) => {
        $name
    };
    (@number $section:ident $field:ident ($name:expr) $bounds:expr) => {
        if !$bounds.hold(*$field as f64) {
            return Err($crate::OutOfBounds::new($section, $name, $field, &$bounds));
        }
    };
    (@each $section:ident $field:ident ($name:expr) $bounds:expr) => {
        for value in $field.iter() {
            if !$bounds.hold(*value as f64) {
                return Err($crate::OutOfBounds::new($section, $name, value, &$bounds));
            }
        }
    };
    (@optional $section:ident $field:ident ($name:expr) $bounds:expr) => {
        $crate::bounds!(@each $section $field ($name) $bounds)
    };
    (@section $section:ident $field:ident ($name:expr)) => {
        $field.check_bounds(&$crate::setting_name($section, $name))?
    };
    (@sections $section:ident $field:ident ($name:expr)) => {
        for part in $field.iter() {
            part.check_bounds(&$crate::setting_name($section, $name))?;
        }
    };
    (@any $section:ident $field:ident ($name:expr)) => {
        let _ = $field;
    };
    (
        $config:ident {
            $( $field:ident $(as $name:literal)? : $kind:ident $( ($bounds:expr) )? ),+ $(,)?
        }
        $(also $relation:ident)?
    ) => {
        impl $config {
            /// Refuses what lies outside its bounds; `section` is what these settings are called as a part of others.
            pub fn check_bounds(&self, section: &str) -> Result<(), $crate::OutOfBounds> {
                let Self { $($field),+ } = self;
                $( $crate::bounds!(@$kind section $field ($crate::bounds!(@name $field $($name)?)) $($bounds)?); )+
                $( self.$relation(section)?; )?
                Ok(())
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::{Bounds, OutOfBounds};

    struct All {
        count: usize,
        share: f32,
        pair: [f64; 2],
        maybe: Option<f64>,
        pause_s: f64,
        rpm: u16,
        rate_hz: u32,
        parts: Vec<Part>,
    }

    struct Part {
        least: u8,
        most: u8,
    }

    crate::bounds! {
        Part {
            least: any,
            most: number(Bounds::AT_LEAST_ONE),
        }
        also is_in_order
    }

    impl Part {
        fn is_in_order(&self, section: &str) -> Result<(), OutOfBounds> {
            match self.least <= self.most {
                true => Ok(()),
                false => Err(OutOfBounds::new(
                    section,
                    "most",
                    &self.most,
                    &"least or more",
                )),
            }
        }
    }

    crate::bounds! {
        All {
            count: number(Bounds::AT_LEAST_ONE),
            share: number(Bounds::Between(0.0, 1.0)),
            pair: each(Bounds::NOT_NEGATIVE),
            maybe: optional(Bounds::POSITIVE),
            pause_s: number(Bounds::ZeroOr(1.0, f64::INFINITY)),
            rpm: number(Bounds::MultipleOf(60.0, 300.0, 1200.0)),
            rate_hz: number(Bounds::DivisorOf(1e6)),
            parts as "part": sections,
        }
    }

    fn good() -> All {
        All {
            count: 1,
            share: 0.1,
            pair: [0.0, 2.0],
            maybe: None,
            pause_s: 0.0,
            rpm: 600,
            rate_hz: 200,
            parts: Vec::new(),
        }
    }

    #[test]
    fn each_value_is_refused_by_name_value_and_bounds() {
        assert_eq!(good().check_bounds(""), Ok(()));
        for (settings, expected) in [
            (
                All { count: 0, ..good() },
                "count is 0: it must be 1 or more",
            ),
            (
                All {
                    share: 1.0,
                    ..good()
                },
                "share is 1: it must be more than 0 and less than 1",
            ),
            (
                All {
                    pair: [0.0, f64::INFINITY],
                    ..good()
                },
                "pair is inf: it must be 0 or more",
            ),
            (
                All {
                    maybe: Some(f64::NAN),
                    ..good()
                },
                "maybe is NaN: it must be more than 0",
            ),
            (
                All {
                    pause_s: 0.5,
                    ..good()
                },
                "pause_s is 0.5: it must be 0, or 1 or more",
            ),
            (
                All { rpm: 610, ..good() },
                "rpm is 610: it must be a multiple of 60 from 300 to 1200",
            ),
            (
                All {
                    rate_hz: 300,
                    ..good()
                },
                "rate_hz is 300: it must be a divisor of 1000000",
            ),
            (
                All {
                    parts: vec![Part { least: 2, most: 1 }],
                    ..good()
                },
                "part.most is 1: it must be least or more",
            ),
        ] {
            let refused = settings.check_bounds("").expect_err(expected).to_string();
            assert_eq!(refused, format!("setting {expected}"));
        }
    }
}
