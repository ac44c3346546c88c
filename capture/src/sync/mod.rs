//! Camera groups: images of one trigger, from N units with K cameras each that know nothing of each other.
//!
//! Each unit counts its triggers. What differs between the units is where they began to count: that is settled once, by
//! the times of several frames, and from then on the counters alone decide which images belong together. Order of arrival
//! decides nothing.
//!
//! The stamps of a unit's first frames are as late as their first arrivals were. So the times by which units are compared
//! are made anew whenever something arrives: the unit's own counter, moved to where the fastest of its last frames
//! puts it. Late frames and batches change nothing of that. A unit is fitted in when its frames lie within
//! a quarter of a period of others', and have said the same for a while; until then all of them are kept.

mod unit;

use std::collections::BTreeMap;

use lsfb_types::{Image, Stamped, Timestamp};
use serde::Serialize;

use unit::{Frame, Hint, IsNew, OPEN_GROUPS, Placed, RECENT, Unit};

/// Frame counters of Mynt units have 16 bits.
const COUNTER_PERIOD: i64 = 1 << 16;
/// A counter that jumps further than this may have begun anew; less is a late frame, or a few that were lost.
const RESTART_STEP: i64 = 64;
/// The counters of units run in microseconds.
const TICK_NS: i64 = 1_000;
/// A unit whose counter is this close to the recording's time names the second itself.
const NAMED_NS: i64 = 1_000_000_000;
/// Images of one trigger lie closer than this share of a period …
const TOLERANCE_SHARE: i64 = 4;
/// … and than this.
const MOST_TOLERANCE_NS: i64 = 15_000_000;
/// Frames that must agree on where a unit began to count …
const VOTES: usize = 3;
/// … and frames in a row after which that was the answer: two batches of a slow link.
const STEADY_FRAMES: u32 = 10;
/// Frames in a row that are half a period away from where the counter puts them: the unit began anew without our noticing.
const CONTRADICTIONS: u32 = 5;

/// How the images of the cameras fit together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GroupReport {
    /// Triggers of which every camera delivered its image.
    pub complete: u64,
    /// Triggers of which an image is missing. The others are recorded all the same.
    pub incomplete: u64,
    /// Images missing in incomplete groups, by camera.
    pub missing_by_camera: BTreeMap<String, u64>,
    /// How often a unit's counter had to be fitted in again.
    pub refitted: u64,
}

/// The images of one trigger, decided.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Group {
    pub(crate) trigger: u64,
    pub(crate) time: Timestamp,
    /// Arrival of the image that decided it.
    pub(crate) arrival: Timestamp,
    pub(crate) expected: u32,
    pub(crate) present: u32,
    pub(crate) missing: Vec<String>,
}

/// What is left at the end.
pub(crate) struct Decided {
    pub(crate) groups: Vec<Group>,
    pub(crate) report: GroupReport,
}

/// Matches images by trigger.
#[derive(Debug)]
pub(crate) struct Groups {
    cameras: Vec<Camera>,
    units: Vec<Unit>,
    open: BTreeMap<i64, Open>,
    last_arrival: Timestamp,
    report: GroupReport,
}

#[derive(Debug)]
struct Camera {
    name: String,
    unit: usize,
}

#[derive(Debug)]
struct Open {
    /// Whose frame came first, and when that was taken by its own clock.
    unit: usize,
    device_ns: i64,
    time: Timestamp,
    seen: Vec<bool>,
}

impl Groups {
    /// `cameras`: the names of each unit's cameras, unit by unit.
    pub(crate) fn new(cameras: &[Vec<String>]) -> Self {
        let named = |(unit, names): (usize, &Vec<String>)| {
            names
                .iter()
                .map(|name| Camera {
                    name: name.clone(),
                    unit,
                })
                .collect::<Vec<_>>()
        };
        Self {
            cameras: cameras.iter().enumerate().flat_map(named).collect(),
            units: cameras.iter().map(|_| Unit::default()).collect(),
            open: BTreeMap::new(),
            last_arrival: Timestamp::default(),
            report: GroupReport::default(),
        }
    }

    /// Notes an image and tells which groups that decides. Cameras that belong to no group are passed over.
    pub(crate) fn note(&mut self, camera: &str, image: &Stamped<Image>) -> Vec<Group> {
        let Some(camera) = self.cameras.iter().position(|c| c.name == camera) else {
            return Vec::new();
        };
        let Some(unit) = self.cameras.get(camera).map(|c| c.unit) else {
            return Vec::new();
        };
        self.last_arrival = image.arrival;
        let device_ns = image.device_ticks.cast_signed().saturating_mul(TICK_NS);
        let frame = Frame {
            camera,
            index: self.index(unit, image.sample.frame_id),
            device_ns,
            time: image.time,
        };
        // A unit that names the second is believed; the fitted time of another is no better at first than its arrivals.
        let named_ns = image.time.nanos().saturating_sub(device_ns);
        let arrived_ns = image.arrival.nanos().saturating_sub(device_ns);
        let hint = Hint {
            index: frame.index,
            device_ns,
            offset_ns: if named_ns.saturating_abs() < NAMED_NS {
                named_ns
            } else {
                arrived_ns
            },
        };
        let is_new = self.units.get_mut(unit).map_or(IsNew::No, |u| u.hear(hint));
        match self.units.get(unit).and_then(|u| u.trigger_from_index) {
            Some(offset) => self.place(unit, frame, offset, is_new),
            None => self.fit_in(unit, frame, is_new),
        }
        self.decide(unit)
    }

    /// How the images fit together so far.
    pub(crate) fn report(&self) -> &GroupReport {
        &self.report
    }

    /// Decides what is still open.
    pub(crate) fn finish(&mut self) -> Decided {
        for unit in 0..self.units.len() {
            self.give_up(unit);
        }
        let mut groups = Vec::new();
        while let Some((trigger, open)) = self.open.pop_first() {
            groups.push(self.judge(trigger, &open));
        }
        Decided {
            groups,
            report: self.report.clone(),
        }
    }

    /// The counter, continued beyond its wrap. A restart makes the unit's place unknown.
    fn index(&mut self, unit: usize, frame_id: u32) -> i64 {
        let id = i64::from(frame_id);
        let Some(last) = self.units.get(unit).and_then(|u| u.last_index) else {
            if let Some(state) = self.units.get_mut(unit) {
                state.last_index = Some(id);
            }
            return id;
        };
        let half = COUNTER_PERIOD / 2;
        let step = (id - last + half).rem_euclid(COUNTER_PERIOD) - half;
        let index = last + step;
        let restarts = step.abs() > RESTART_STEP;
        if restarts {
            // Frames of the old count cannot wait for what the new one tells.
            self.give_up(unit);
        }
        let Some(state) = self.units.get_mut(unit) else {
            return index;
        };
        state.last_index = Some(if restarts { index } else { last.max(index) });
        if restarts {
            state.last_trigger = None;
            state.forget_place();
            self.report.refitted += 1;
        }
        index
    }

    fn place(&mut self, unit: usize, frame: Frame, offset: i64, is_new: IsNew) {
        let trigger = frame.index + offset;
        let contradicts = self.contradicts(unit, &frame, trigger);
        if let Some(state) = self.units.get_mut(unit) {
            state.contradictions = match (contradicts, is_new) {
                (true, IsNew::Yes) => state.contradictions + 1,
                (true, IsNew::No) => state.contradictions,
                (false, _) => 0,
            };
            if state.contradictions >= CONTRADICTIONS {
                state.forget_place();
                self.report.refitted += 1;
                return self.fit_in(unit, frame, IsNew::Yes);
            }
            state.last_trigger = state.last_trigger.max(Some(trigger));
            state.remember(Placed {
                device_ns: frame.device_ns,
                trigger,
            });
        }
        let cameras = self.cameras.len();
        let open = self.open.entry(trigger).or_insert_with(|| Open {
            unit,
            device_ns: frame.device_ns,
            time: frame.time,
            seen: vec![false; cameras],
        });
        if let Some(seen) = open.seen.get_mut(frame.camera) {
            *seen = true;
        }
    }

    /// Whether a frame lies more than half a period from another of its trigger.
    fn contradicts(&self, unit: usize, frame: &Frame, trigger: i64) -> bool {
        let Some(state) = self.units.get(unit) else {
            return false;
        };
        let other = self.open.get(&trigger).filter(|open| open.unit != unit);
        other.is_some_and(|open| {
            let offset_ns = self.units.get(open.unit).map_or(0, Unit::offset_ns);
            let other_ns = open.device_ns.saturating_add(offset_ns);
            let own_ns = frame.device_ns.saturating_add(state.offset_ns());
            own_ns.saturating_sub(other_ns).saturating_abs() > state.period_ns() / 2
        })
    }

    /// Finds out where a unit began to count.
    fn fit_in(&mut self, unit: usize, frame: Frame, is_new: IsNew) {
        if let Some(state) = self.units.get_mut(unit) {
            state.unfitted.push(frame);
        }
        let nobody_counts = self.units.iter().all(|u| u.trigger_from_index.is_none());
        if nobody_counts {
            return self.start_own_count(unit);
        }
        let proposal = match is_new {
            IsNew::Yes => self.proposal(unit, VOTES),
            IsNew::No => return,
        };
        let Some(state) = self.units.get_mut(unit) else {
            return;
        };
        state.proposed = match (proposal, state.proposed) {
            (Some(offset), Some((before, frames))) if offset == before => {
                Some((offset, frames + 1))
            }
            (offset, _) => offset.map(|offset| (offset, 1)),
        };
        let waited_too_long = state.unfitted.len() > OPEN_GROUPS;
        match state.proposed {
            Some((offset, STEADY_FRAMES..)) => self.place_all(unit, offset),
            _ if waited_too_long => self.give_up(unit),
            _ => {}
        }
    }

    /// Where a unit began to count, by the frames that wait: what most of them say, if enough do.
    fn proposal(&self, unit: usize, votes_needed: usize) -> Option<i64> {
        let state = self.units.get(unit)?;
        let tolerance_ns = (state.period_ns() / TOLERANCE_SHARE).min(MOST_TOLERANCE_NS);
        let offset_ns = state.offset_ns();
        let mut votes: BTreeMap<i64, usize> = BTreeMap::new();
        let mut last = None;
        for frame in state.unfitted.iter().rev().take(RECENT) {
            if last.replace(frame.index) == Some(frame.index) {
                continue;
            }
            let time_ns = frame.device_ns.saturating_add(offset_ns);
            let nearest = self
                .units
                .iter()
                .filter(|other| other.trigger_from_index.is_some())
                .filter_map(|other| other.nearest(time_ns.saturating_sub(other.offset_ns())))
                .min();
            if let Some((away_ns, trigger)) = nearest
                && away_ns <= tolerance_ns
            {
                *votes.entry(trigger - frame.index).or_default() += 1;
            }
        }
        let best = votes.into_iter().max_by_key(|(_, votes)| *votes);
        best.filter(|(_, votes)| *votes >= votes_needed)
            .map(|(offset, _)| offset)
    }

    /// Places frames that cannot wait any longer: by the best guess there is, or as triggers of their own.
    fn give_up(&mut self, unit: usize) {
        match self.proposal(unit, 1) {
            Some(offset) => self.place_all(unit, offset),
            None => self.start_own_count(unit),
        }
    }

    /// Lets a unit count for itself, behind all triggers known so far.
    fn start_own_count(&mut self, unit: usize) {
        let Some(first) = self.units.get(unit).and_then(|u| u.unfitted.first()) else {
            return;
        };
        let newest = self
            .units
            .iter()
            .filter_map(|u| u.last_trigger)
            .chain(self.open.keys().next_back().copied())
            .max();
        let offset = newest.map_or(0, |newest| newest + 1 - first.index);
        self.place_all(unit, offset);
    }

    fn place_all(&mut self, unit: usize, offset: i64) {
        let Some(state) = self.units.get_mut(unit) else {
            return;
        };
        state.trigger_from_index = Some(offset);
        state.proposed = None;
        for frame in std::mem::take(&mut state.unfitted) {
            // What is known now has decided; the frames say nothing new.
            self.place(unit, frame, offset, IsNew::No);
        }
    }

    /// Takes out the groups that can change no more: complete, or every unit that is missing has gone on to a later one.
    fn decide(&mut self, unit: usize) -> Vec<Group> {
        let mut decided: Vec<i64> = Vec::new();
        if let Some(newest) = self.units.get(unit).and_then(|u| u.last_trigger) {
            for (trigger, open) in self.open.range(..=newest) {
                let can_change = self.cameras.iter().zip(&open.seen).any(|(camera, seen)| {
                    let last = self.units.get(camera.unit).and_then(|u| u.last_trigger);
                    !seen && last.is_none_or(|last| last <= *trigger)
                });
                if !can_change {
                    decided.push(*trigger);
                }
            }
        }
        if self.open.len() - decided.len() > OPEN_GROUPS {
            let oldest = self.open.keys().find(|t| !decided.contains(t)).copied();
            decided.extend(oldest);
            decided.sort_unstable();
        }
        let mut groups = Vec::with_capacity(decided.len());
        for trigger in decided {
            if let Some(open) = self.open.remove(&trigger) {
                groups.push(self.judge(trigger, &open));
            }
        }
        groups
    }

    fn judge(&mut self, trigger: i64, open: &Open) -> Group {
        let missing: Vec<String> = self
            .cameras
            .iter()
            .zip(&open.seen)
            .filter(|(_, seen)| !**seen)
            .map(|(camera, _)| camera.name.clone())
            .collect();
        if missing.is_empty() {
            self.report.complete += 1;
        } else {
            self.report.incomplete += 1;
        }
        for name in &missing {
            *self
                .report
                .missing_by_camera
                .entry(name.clone())
                .or_default() += 1;
        }
        Group {
            trigger: trigger.cast_unsigned(),
            time: open.time,
            arrival: self.last_arrival,
            expected: self.cameras.len() as u32,
            present: (self.cameras.len() - missing.len()) as u32,
            missing,
        }
    }
}

#[cfg(test)]
mod tests;
