//! All that was looked at, and what follows from it.

use super::{Finding, Verdict};

/// Names that a headline has room for.
const MOST_NAMED: usize = 4;

/// All that was looked at, and what follows from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Judgement {
    findings: Vec<Finding>,
}

impl Judgement {
    /// Of findings in the order in which they are to be read.
    pub fn new(findings: Vec<Finding>) -> Self {
        Self { findings }
    }

    /// The most serious of all findings; [`Verdict::Unknown`] where there is none.
    pub fn verdict(&self) -> Verdict {
        Verdict::worst(self.findings.iter().map(|f| f.verdict))
    }

    /// What was looked at.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// Adds a finding behind the others.
    pub fn push(&mut self, finding: Finding) {
        self.findings.push(finding);
    }

    /// What somebody should look at, the most serious first, else in order.
    pub fn problems(&self) -> impl Iterator<Item = &Finding> {
        let of = |verdict| self.findings.iter().filter(move |f| f.verdict == verdict);
        of(Verdict::Fail).chain(of(Verdict::Warn))
    }

    /// The line at the top: the verdict, a few words on what was judged, and the most serious problem.
    pub fn headline(&self, summary: &str) -> String {
        let verdict = self.verdict();
        let mut problems = self.problems();
        let rest = match problems.next() {
            Some(first) => {
                let subject = match first.subject.as_str() {
                    "" => String::new(),
                    subject => format!("check {subject}: "),
                };
                let more = match problems.count() {
                    0 => String::new(),
                    more => format!("; and {more} more"),
                };
                format!("{subject}{}{more}", first.what)
            }
            None if verdict == Verdict::Pass => format!("no problems found{}", self.unchecked()),
            None => "nothing could be determined".to_owned(),
        };
        match summary {
            "" => format!("{verdict}: {rest}"),
            summary => format!("{verdict}: {summary}; {rest}"),
        }
    }

    /// What the verdict does not rest on, in words: a PASS must not be read as one for everything.
    fn unchecked(&self) -> String {
        let unknown = self.findings.iter();
        let unknown = unknown.filter(|f| f.verdict == Verdict::Unknown);
        let names: Vec<&str> = unknown.map(|f| f.subject.as_str()).collect();
        match names.as_slice() {
            [] => String::new(),
            few if few.len() <= MOST_NAMED => format!("; not checked: {}", few.join(", ")),
            many => format!("; {} things not checked", many.len()),
        }
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Judgement {
    /// The verdict and the findings, to be flattened into the result beside which they stand.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct as _;
        let mut fields = serializer.serialize_struct("Judgement", 2)?;
        fields.serialize_field("verdict", &self.verdict())?;
        fields.serialize_field("findings", &self.findings)?;
        fields.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(verdict: Verdict, subject: &str) -> Finding {
        Finding::new("test", verdict, subject, "it moved")
    }

    /// A verdict that hangs on an empty list of problems says PASS of a thing that nobody looked at.
    #[test]
    fn nothing_looked_at_is_not_a_pass() {
        let nothing = Judgement::default();
        assert_eq!(nothing.verdict(), Verdict::Unknown);
        assert_eq!(nothing.headline(""), "UNKNOWN: nothing could be determined");
        let unread = Judgement::new(vec![found(Verdict::Unknown, "checksums")]);
        assert_eq!(unread.verdict(), Verdict::Unknown);
        let mut read = unread;
        read.push(found(Verdict::Pass, "file"));
        assert_eq!(
            read.headline("2 MB"),
            "PASS: 2 MB; no problems found; not checked: checksums"
        );
    }

    #[test]
    fn the_most_serious_problem_stands_in_the_headline() {
        let judgement = Judgement::new(vec![
            found(Verdict::Warn, "cam0"),
            found(Verdict::Pass, "cam1"),
            found(Verdict::Fail, "cam2"),
        ]);
        assert_eq!(judgement.verdict(), Verdict::Fail);
        assert_eq!(
            judgement.headline("3 cameras"),
            "FAIL: 3 cameras; check cam2: it moved; and 1 more"
        );
    }
}
