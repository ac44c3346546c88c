//! Rate and silences of each topic that a sensor fills steadily.

use std::collections::BTreeSet;

use lsfb_recording::{Recording, TopicArrivals};
use lsfb_types::{Finding, Limit, Timestamp, Verdict};

use super::file::utc;
use super::rhythm::Rhythm;
use super::stream::{Stream, possible_hz, unreal_pace};
use super::{DoctorConfig, Findings};
use crate::counted::counted;

/// Silences shorter than this are the host's, whatever the period, seconds.
const SHORTEST_SILENCE_SECS: f64 = 0.02;

impl Findings {
    pub(super) fn topics(
        &mut self,
        recording: &Recording,
        streams: &[Stream<'_>],
        arrivals: &[TopicArrivals],
        config: &DoctorConfig,
    ) {
        if streams.is_empty() {
            let found = "it has no camera, LiDAR or IMU";
            let finding = Finding::new("sensors", Verdict::Fail, "sensors", found);
            self.add(finding.value(0.0, "").limit(Limit::AtLeast(1.0)));
        }
        self.without_a_message(recording, arrivals);
        let start = streams.iter().filter_map(|s| s.arrivals.first()).min();
        let end = streams.iter().filter_map(|s| s.arrivals.last()).max();
        let (Some(start), Some(end)) = (start, end) else {
            return;
        };
        if unreal_pace(streams).is_some() {
            self.by_stamps(streams, config);
        } else {
            for stream in streams {
                let rhythm = Rhythm::of(stream.arrivals, *start, *end);
                self.rate(stream, 1.0 / rhythm.period_secs, Some(&rhythm), config);
                self.silence(stream, &rhythm, *start, config);
            }
        }
        // What comes when there is something to hear has no rhythm to miss.
        for heard in arrivals
            .iter()
            .filter(|a| crate::topics::is_occasional(&a.topic))
        {
            let rhythm = Rhythm::of(&heard.times, *start, *end);
            let found = format!(
                "{} messages, longest silence {:.1} s",
                heard.times.len(),
                rhythm.longest_secs
            );
            self.add(Finding::new(
                "heard",
                Verdict::Pass,
                heard.topic.clone(),
                found,
            ));
        }
    }

    /// Sensors that a recording names and has no message of: their topics, the cameras that the recorder asked for images, and those of the rig.
    fn without_a_message(&mut self, recording: &Recording, arrivals: &[TopicArrivals]) {
        let is_filled = |topic: &str| {
            let own = arrivals.iter().find(|a| a.topic == topic);
            own.is_some_and(|a| !a.times.is_empty())
        };
        // Another topic of the same device has what this one lacks: packets where there are clouds.
        let is_heard = |topic: &str| {
            let device = topic.rsplit_once('/').map_or(topic, |(device, _)| device);
            arrivals.iter().any(|a| {
                let own = a.topic.rsplit_once('/').is_some_and(|(of, _)| of == device);
                own && possible_hz(&a.topic).is_some() && !a.times.is_empty()
            })
        };
        let declared = arrivals.iter().map(|a| a.topic.clone());
        let declared = declared.filter(|topic| possible_hz(topic).is_some());
        let units = recording.camera_units().unwrap_or_default();
        let asked = units.into_iter().flat_map(|unit| unit.cameras);
        let asked = asked.map(|camera| format!("/{camera}/image"));
        let silent: BTreeSet<String> = declared.chain(asked).collect();
        for topic in silent.iter().filter(|t| !is_filled(t) && !is_heard(t)) {
            let [least, _] = possible_hz(topic).unwrap_or_default();
            let finding = Finding::new("rate", Verdict::Fail, topic, "no messages");
            self.add(
                finding
                    .value(0.0, "Hz")
                    .limit(Limit::AtLeast(least))
                    .remedy("check its cable, its power and its settings"),
            );
        }
    }

    /// Of a recording that was not made in real time.
    fn by_stamps(&mut self, streams: &[Stream<'_>], config: &DoctorConfig) {
        let start = streams.iter().map(|s| s.first_stamp).min();
        let end = streams.iter().map(|s| s.last_stamp).max();
        let (Some(start), Some(end)) = (start, end) else {
            return;
        };
        for stream in streams {
            if let Some(stamps) = &stream.stamps {
                let rhythm = Rhythm::of(stamps, start, end);
                self.rate(stream, 1.0 / rhythm.period_secs, Some(&rhythm), config);
                self.silence(stream, &rhythm, start, config);
                continue;
            }
            self.rate(stream, stream.rate_by_stamps_hz(), None, config);
            let found = "gaps not checked: arrivals say nothing, and stamps were not read";
            let finding = Finding::new("silence", Verdict::Unknown, stream.topic, found);
            self.add(finding.remedy("read the stamps with `--full`"));
        }
    }

    /// The mean rate, against what such a sensor can have and against its own period.
    fn rate(
        &mut self,
        stream: &Stream<'_>,
        rate_hz: f64,
        rhythm: Option<&Rhythm<'_>>,
        config: &DoctorConfig,
    ) {
        let count = stream.arrivals.len();
        let finding = |verdict, limit, found| {
            Finding::new("rate", verdict, stream.topic, found)
                .value(rate_hz, "Hz")
                .limit(limit)
        };
        let [least, most] = possible_hz(stream.topic).unwrap_or([0.0, f64::INFINITY]);
        // Whoever set a device knows better than anybody what it can be.
        let least = match stream.nominal_hz {
            Some(nominal_hz) => least.min(nominal_hz * config.fail_rate_share),
            None => least,
        };
        // What arrives in bursts shows no period of its own.
        let regular = rhythm.filter(|rhythm| rhythm.is_regular);
        let own_hz = regular.map(|rhythm| 1.0 / rhythm.median_secs);
        let own_least = own_hz.map(|hz| config.warn_rate_share * hz);
        let messages = counted(count as u64, "message", "messages");
        let said = format!("{messages}, {rate_hz:.1} Hz");
        self.add(if !(rate_hz <= most) {
            let found = format!("{said}: too fast for such a sensor; several may share the topic");
            finding(Verdict::Fail, Limit::AtMost(most), found)
                .remedy("check who sends to its port: each device needs its own port or address")
        } else if let Some(nominal_hz) = stream.nominal_hz
            && rate_hz < config.warn_rate_share * nominal_hz
        {
            let found = format!("{said} instead of the {nominal_hz:.1} Hz of this device");
            let (verdict, share) = match rate_hz < config.fail_rate_share * nominal_hz {
                true => (Verdict::Fail, config.fail_rate_share),
                false => (Verdict::Warn, config.warn_rate_share),
            };
            finding(verdict, Limit::AtLeast(share * nominal_hz), found)
                .remedy("check its cable, its settings and the load of the machine")
        } else if !(rate_hz >= least) {
            let found = format!("{said}: too slow for such a sensor");
            finding(Verdict::Fail, Limit::AtLeast(least), found)
                .remedy("check its cable, its settings and the load of the machine")
        } else if let Some((own_hz, own_least)) = own_hz.zip(own_least)
            && rate_hz < own_least
        {
            let found = format!("{said}, but its period gives {own_hz:.1} Hz");
            finding(Verdict::Warn, Limit::AtLeast(own_least), found)
                .remedy("check its cable and the load of the machine: messages are missing")
        } else if count < 2 {
            let found = format!("{messages}: a rate takes two");
            Finding::new("rate", Verdict::Unknown, stream.topic, found)
        } else {
            finding(
                Verdict::Pass,
                Limit::AtLeast(own_least.unwrap_or(least)),
                said,
            )
        });
    }

    fn silence(
        &mut self,
        stream: &Stream<'_>,
        rhythm: &Rhythm<'_>,
        start: Timestamp,
        config: &DoctorConfig,
    ) {
        let longest_secs = rhythm.longest_secs;
        let fails_from = config.fail_gap_secs.max(3.0 * rhythm.period_secs);
        let warns_from = config.warn_gap_periods * rhythm.period_secs;
        let verdict = if longest_secs >= fails_from {
            Verdict::Fail
        } else if longest_secs >= warns_from && longest_secs > SHORTEST_SILENCE_SECS {
            Verdict::Warn
        } else {
            Verdict::Pass
        };
        let mut found = format!("longest silence {:.0} ms", longest_secs * 1e3);
        if verdict != Verdict::Pass {
            let at_secs = rhythm.longest_at.secs_since(start);
            found += &format!(
                " at {} ({at_secs:.1} s after the start), {}",
                utc(rhythm.longest_at),
                match rhythm.silences(config.warn_gap_periods) {
                    0 | 1 => "the only one".to_owned(),
                    n => format!("{n} similar gaps"),
                }
            );
        }
        let limit_secs = match verdict {
            Verdict::Fail => fails_from,
            _ => warns_from.max(SHORTEST_SILENCE_SECS),
        };
        let finding = Finding::new("silence", verdict, stream.topic, found)
            .value(longest_secs * 1e3, "ms")
            .limit(Limit::AtMost((limit_secs * 1e3).round()));
        self.add(finding.remedy("check its cable, its power and the load of the machine"));
    }
}
