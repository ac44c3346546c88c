//! Whether the recording was made in real time.

use lsfb_types::{Finding, Limit, Verdict};

use super::Findings;
use super::stream::{Stream, unreal_pace};

/// Seconds of one device's stamps per second of arrivals beyond which its clock was set, where the others keep real time.
const FASTEST: f64 = 1.5;

impl Findings {
    pub(super) fn pace(&mut self, streams: &[Stream<'_>]) {
        if let Some(pace) = unreal_pace(streams).filter(|pace| pace.stamped_secs <= 0.0) {
            let found = format!(
                "the stamps of all sensors advance by {:.1} s while messages arrive for {:.1} s: they stand still or go back",
                pace.stamped_secs, pace.arrived_secs
            );
            let finding =
                Finding::new("pace", Verdict::Fail, "pace", found).value(pace.factor(), "");
            let remedy = "check the program that wrote them; run `lsfb clock` for details";
            return self.add(finding.remedy(remedy));
        }
        if let Some(pace) = unreal_pace(streams) {
            let found = format!(
                "not recorded in real time ({:.1} s of stamps arrived within {:.1} s): a replay or a simulation; rates and gaps are judged by the devices' stamps",
                pace.stamped_secs, pace.arrived_secs
            );
            let finding = Finding::new("pace", Verdict::Pass, "pace", found);
            return self.add(finding.value(pace.factor(), ""));
        }
        for stream in streams {
            let Some(factor) = stream
                .pace()
                .filter(|pace| pace.is_real_time() == Some(false))
                .map(|pace| pace.factor())
                .filter(|factor| *factor > FASTEST)
            else {
                continue;
            };
            let found = format!(
                "its stamps advance by {factor:.1} s per second of arrivals, unlike those of other sensors: its clock was set"
            );
            let finding = Finding::new("pace", Verdict::Warn, stream.topic, found)
                .value(factor, "")
                .limit(Limit::AtMost(FASTEST));
            self.add(finding.remedy("run `lsfb clock` for details"));
        }
    }
}
