//! One thing that was looked at.

use std::borrow::Cow;
use std::fmt;

use super::Verdict;

/// One thing that was looked at, and how it came out.
///
/// `what` is said without a full stop and without its subject, `remedy` as an order; [`Finding::sentence`] joins them, and
/// [`Finding::message`] does so where an error says it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Finding {
    /// Name of the check for programs; it stays the same when words change.
    pub code: Cow<'static, str>,
    /// How it came out.
    pub verdict: Verdict,
    /// What it is about: a topic, a camera, a setting. Empty where it is about everything.
    #[cfg_attr(feature = "serde", serde(rename = "where"))]
    pub subject: String,
    /// What was found.
    pub what: String,
    /// The number that was judged, in `unit`; `None` where there is none.
    pub value: Option<f64>,
    /// Standard deviation of `value`.
    pub sigma: Option<f64>,
    /// Unit of `value`, `sigma` and `limit`; empty for a pure number.
    pub unit: &'static str,
    /// The limit that was crossed, or would be next.
    pub limit: Option<Limit>,
    /// What to do; `None` where nothing is to be done.
    pub remedy: Option<String>,
}

/// A bound in the unit of what it bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Limit {
    /// This or less.
    AtMost(f64),
    /// This or more.
    AtLeast(f64),
}

impl Limit {
    /// Whether a value is within; what is no number is not.
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(limit) => write!(f, "at most {limit}"),
            Self::AtLeast(limit) => write!(f, "at least {limit}"),
        }
    }
}

impl Finding {
    /// What was found, without a number.
    pub fn new(
        code: impl Into<Cow<'static, str>>,
        verdict: Verdict,
        subject: impl Into<String>,
        what: impl Into<String>,
    ) -> Self {
        Self {
            code: code.into(),
            verdict,
            subject: subject.into(),
            what: what.into(),
            value: None,
            sigma: None,
            unit: "",
            limit: None,
            remedy: None,
        }
    }

    /// With the number that was judged.
    pub fn value(self, value: f64, unit: &'static str) -> Self {
        Self {
            value: Some(value),
            unit,
            ..self
        }
    }

    /// With a number and the limit that it is judged by: the verdict is [`Verdict::Pass`] where that holds. To be said before the remedy.
    pub fn judged(self, value: f64, unit: &'static str, limit: Limit) -> Self {
        Self {
            verdict: self.verdict.unless(limit.holds(value)),
            ..self.value(value, unit).limit(limit)
        }
    }

    /// With the standard deviation of that number.
    pub fn sigma(self, sigma: f64) -> Self {
        Self {
            sigma: Some(sigma),
            ..self
        }
    }

    /// With the limit that was crossed, or would be next.
    pub fn limit(self, limit: Limit) -> Self {
        Self {
            limit: Some(limit),
            ..self
        }
    }

    /// With what to do; dropped where nothing is wrong.
    pub fn remedy(self, remedy: impl Into<String>) -> Self {
        let remedy = remedy.into();
        let needed = self.verdict != Verdict::Pass && !remedy.is_empty();
        Self {
            remedy: needed.then_some(remedy),
            ..self
        }
    }

    /// The limit with its unit, where it was crossed: `at most 2 ms`. Nothing where there should be none at all, as all that is found says so.
    pub fn crossed_limit(&self) -> Option<String> {
        let limit = self.limit.filter(|_| self.verdict >= Verdict::Warn)?;
        if limit == Limit::AtMost(0.0) {
            return None;
        }
        Some(match self.unit {
            "" => limit.to_string(),
            "°" => format!("{limit}°"),
            unit => format!("{limit} {unit}"),
        })
    }

    /// All of it: `cam0: corners cover 30 % of the image. Move the target into the upper left.`
    pub fn sentence(&self) -> String {
        let mut text = match self.subject.as_str() {
            "" => self.what.clone(),
            subject => format!("{subject}: {}", self.what),
        };
        text.push('.');
        if let Some(remedy) = &self.remedy {
            let mut letters = remedy.chars();
            let first = letters.next().map(|c| c.to_uppercase().to_string());
            text += &format!(" {}{}.", first.unwrap_or_default(), letters.as_str());
        }
        text
    }

    /// All of it as an error message: `cam0: its stamps are 3 ms late (at most 2 ms): check the triggers`.
    pub fn message(&self) -> String {
        let mut text = match self.subject.as_str() {
            "" => self.what.clone(),
            subject => format!("{subject}: {}", self.what),
        };
        if let Some(limit) = self.crossed_limit() {
            text += &format!(" ({limit})");
        }
        if let Some(remedy) = &self.remedy {
            // A second colon would hide which part explains which.
            let is_split = [&self.what, remedy].iter().any(|part| part.contains(": "));
            text += if is_split { "; " } else { ": " };
            text += remedy;
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sentence_names_subject_and_remedy() {
        let found = Finding::new("clock", Verdict::Warn, "cam0", "its stamps are 3 ms late")
            .value(3.0, "ms")
            .limit(Limit::AtMost(2.0))
            .remedy("check the triggers");
        assert_eq!(
            found.sentence(),
            "cam0: its stamps are 3 ms late. Check the triggers."
        );
        assert_eq!(found.crossed_limit().as_deref(), Some("at most 2 ms"));
        assert_eq!(
            found.message(),
            "cam0: its stamps are 3 ms late (at most 2 ms): check the triggers"
        );
        let good = Finding {
            verdict: Verdict::Pass,
            ..found
        };
        assert_eq!(good.crossed_limit(), None);
        assert_eq!(good.remedy("check the triggers").remedy, None);
    }

    /// A limit that takes NaN for good passes exactly what could not be measured.
    #[test]
    fn what_is_no_number_is_within_no_limit() {
        assert!(Limit::AtMost(1.0).holds(1.0) && Limit::AtLeast(1.0).holds(1.0));
        assert!(!Limit::AtMost(1.0).holds(1.1) && !Limit::AtLeast(1.0).holds(0.9));
        assert!(!Limit::AtMost(1.0).holds(f64::NAN) && !Limit::AtLeast(1.0).holds(f64::NAN));
    }
}
