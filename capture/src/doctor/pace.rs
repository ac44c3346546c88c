//! Whether the recording was made in real time.

use lsfb_types::{Finding, Limit, Verdict};

use super::Findings;
use super::stream::{Stream, pace_of};
use crate::pace::FASTEST;

impl Findings {
    pub(super) fn pace(&mut self, streams: &[Stream<'_>]) {
        if let Some(slowest) = pace_of(streams) {
            let found = format!(
                "recorded {slowest:.1} times faster than real time, a replay or a simulation: rates and silences are judged by the devices' stamps"
            );
            let finding = Finding::new("pace", Verdict::Pass, "pace", found);
            return self.add(finding.value(slowest, ""));
        }
        for stream in streams {
            let Some(pace) = stream.pace().filter(|pace| *pace > FASTEST) else {
                continue;
            };
            let found = format!(
                "its stamps advance by {pace:.1} s for each second in which they arrive, those of other sensors do not: its clock was set"
            );
            let finding = Finding::new("pace", Verdict::Warn, stream.topic, found)
                .value(pace, "")
                .limit(Limit::AtMost(FASTEST));
            self.add(finding.remedy("see when and by how much with `lsfb clock`"));
        }
    }
}
