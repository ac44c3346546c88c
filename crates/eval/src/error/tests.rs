use lsfb_types::Verdict;

use super::*;

#[test]
fn refusals_say_what_to_do_and_other_errors_are_none() {
    let refused = [
        Error::TooFewMatches {
            matched: 1,
            needed: 3,
            purpose: "an alignment",
        },
        Error::OneAxis {
            first_deg: 40.0,
            second_deg: 0.1,
        },
        Error::AmbiguousRests { rests: 4 },
        Error::Empty { role: "estimate" },
    ];
    for error in refused {
        let found = error.finding().expect("a refusal");
        let message = error.to_string();
        assert_eq!(found.verdict, Verdict::Fail);
        assert!(message.contains(&found.what), "{message}");
        assert!(
            message.ends_with(found.remedy.as_deref().expect("what to do")),
            "{message}"
        );
    }
    assert!(Error::NoMapDistance.finding().is_none());
}

/// An error whose message is that of its finding, and has none, would say nothing.
#[test]
fn no_error_is_without_words() {
    let made_of_findings = include_str!("mod.rs").matches("self.message())]").count();
    let findings = include_str!("finding.rs");
    let kinds = findings.matches("            Self::").count();
    assert_eq!(made_of_findings, kinds);
}
