//! Whether the devices' stamps and the host's clock tell about the same time.

use lsfb_types::{Finding, Limit, Verdict};

use super::stream::{Stream, unreal_pace};
use super::{DoctorConfig, Findings};

impl Findings {
    /// A device that names the wrong second, as a receiver does whose almanac is old, is as steady as any other.
    pub(super) fn stamps(&mut self, streams: &[Stream<'_>], config: &DoctorConfig) {
        // Arrivals of a replay are of another day than its stamps.
        if unreal_pace(streams).is_some() {
            return;
        }
        let limit_secs = config.warn_stamp_offset_secs;
        // Sensors that disagree cannot both be right, and the one that agrees with the host has a witness.
        let offsets = streams.iter().filter_map(Stream::stamp_offset_secs);
        let Some(usual_secs) = offsets.min_by(|a, b| a.abs().total_cmp(&b.abs())) else {
            return;
        };
        let mut all_agree = true;
        for stream in streams {
            let Some(offset_secs) = stream.stamp_offset_secs() else {
                continue;
            };
            let apart_secs = offset_secs - usual_secs;
            if apart_secs.abs() <= limit_secs {
                continue;
            }
            all_agree = false;
            let found = format!(
                "its stamps differ by {apart_secs:.1} s from those of the other sensors that arrived with them"
            );
            let verdict = match stream.is_of_a_sidecar() {
                true => Verdict::Warn,
                false => Verdict::Fail,
            };
            let finding = Finding::new("stamps", verdict, stream.topic, found)
                .value(apart_secs.abs(), "s")
                .limit(Limit::AtMost(limit_secs));
            self.add(finding.remedy("check what sets its clock: the receiver that sends its PPS, its NMEA sentence, its host"));
        }
        if usual_secs.abs() > limit_secs {
            let found = format!(
                "the sensors' stamps differ by {usual_secs:.1} s from their arrivals: this machine's clock or that of the sensors was wrong"
            );
            let finding = Finding::new("stamps", Verdict::Warn, "stamps", found)
                .value(usual_secs.abs(), "s")
                .limit(Limit::AtMost(limit_secs));
            self.add(
                finding
                    .remedy("synchronise this machine's clock with chrony or NTP before recording"),
            );
        } else if all_agree {
            let found = "the sensors' stamps agree with this machine's clock";
            let finding =
                Finding::new("stamps", Verdict::Pass, "stamps", found).value(usual_secs.abs(), "s");
            self.add(finding.limit(Limit::AtMost(limit_secs)));
        }
    }
}
