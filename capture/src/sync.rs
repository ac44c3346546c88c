//! Camera groups: images of one trigger, from N units with K cameras each that know nothing of each other.
//!
//! Each unit counts its triggers. What differs between the units is where they began to count: that is settled once, by
//! the times of a few frames, and from then on the counters alone decide which images belong together. Order of arrival
//! decides nothing.

use std::collections::BTreeMap;

use lsfb_types::{Image, Stamped, Timestamp};
use serde::Serialize;

/// Frame counters of Mynt units have 16 bits.
const COUNTER_PERIOD: i64 = 1 << 16;
/// A counter that jumps further than this may have begun anew; less is a late frame, or a few that were lost.
const RESTART_STEP: i64 = 64;
/// Images of one trigger lie this close; far below half a period at 20 Hz (protocol notes on the four-camera rig).
const TOLERANCE_NS: i64 = 2_000_000;
/// Frames that must agree on where a unit began to count.
const VOTES: usize = 3;
/// Frames in a row whose time contradicts the counter: the unit began anew without our noticing.
const CONTRADICTIONS: u32 = 5;
/// Groups that wait for their last image, at most: minutes, since the links of two units may run far apart.
const OPEN_GROUPS: usize = 4096;
/// Triggers whose time is remembered, for units that still have to be fitted in.
const REMEMBERED: usize = 2 * OPEN_GROUPS;

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
    /// Triggers by their time.
    times: BTreeMap<Timestamp, i64>,
    last_arrival: Timestamp,
    report: GroupReport,
}

#[derive(Debug)]
struct Camera {
    name: String,
    unit: usize,
}

#[derive(Debug, Default)]
struct Unit {
    /// Its frame counter, continued.
    last_index: Option<i64>,
    /// Add this to the index for the trigger.
    trigger_from_index: Option<i64>,
    /// Frames that wait until that is known.
    unfitted: Vec<Frame>,
    contradictions: u32,
    last_trigger: Option<i64>,
}

#[derive(Clone, Copy, Debug)]
struct Frame {
    camera: usize,
    index: i64,
    time: Timestamp,
}

#[derive(Debug)]
struct Open {
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
            times: BTreeMap::new(),
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
        let frame = Frame {
            camera,
            index: self.index(unit, image.sample.frame_id),
            time: image.time,
        };
        match self.units.get(unit).and_then(|u| u.trigger_from_index) {
            Some(offset) => self.place(unit, frame, offset),
            None => self.fit_in(unit, frame),
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
            // Too few frames to agree on anything: the best guess there is, or triggers of their own.
            self.settle(unit, 1);
            self.start_own_count(unit);
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
        let Some(unit) = self.units.get_mut(unit) else {
            return i64::from(frame_id);
        };
        let id = i64::from(frame_id);
        let Some(last) = unit.last_index else {
            unit.last_index = Some(id);
            return id;
        };
        let half = COUNTER_PERIOD / 2;
        let step = (id - last + half).rem_euclid(COUNTER_PERIOD) - half;
        let index = last + step;
        if step.abs() <= RESTART_STEP {
            unit.last_index = Some(last.max(index));
            return index;
        }
        unit.last_index = Some(index);
        unit.last_trigger = None;
        if unit.trigger_from_index.take().is_some() {
            self.report.refitted += 1;
        }
        index
    }

    fn place(&mut self, unit: usize, frame: Frame, offset: i64) {
        let trigger = frame.index + offset;
        let known = self.open.get(&trigger).map(|open| open.time);
        let contradicts = known.is_some_and(|time| (time - frame.time).abs() > TOLERANCE_NS);
        if let Some(state) = self.units.get_mut(unit) {
            state.contradictions = if contradicts {
                state.contradictions + 1
            } else {
                0
            };
            if state.contradictions >= CONTRADICTIONS {
                state.contradictions = 0;
                state.trigger_from_index = None;
                self.report.refitted += 1;
                return self.fit_in(unit, frame);
            }
            state.last_trigger = state.last_trigger.max(Some(trigger));
        }
        let cameras = self.cameras.len();
        let open = self.open.entry(trigger).or_insert_with(|| Open {
            time: frame.time,
            seen: vec![false; cameras],
        });
        if let Some(seen) = open.seen.get_mut(frame.camera) {
            *seen = true;
        }
        self.times.insert(open.time, trigger);
        if self.times.len() > REMEMBERED {
            self.times.pop_first();
        }
    }

    /// Finds out where a unit began to count.
    fn fit_in(&mut self, unit: usize, frame: Frame) {
        if let Some(state) = self.units.get_mut(unit) {
            state.unfitted.push(frame);
        }
        let nobody_counts = self.units.iter().all(|u| u.trigger_from_index.is_none());
        if nobody_counts {
            self.start_own_count(unit);
        }
        self.settle(unit, VOTES);
        let waited_too_long = self
            .units
            .get(unit)
            .is_some_and(|u| u.unfitted.len() > OPEN_GROUPS);
        if waited_too_long {
            self.start_own_count(unit);
        }
    }

    /// Fits a unit in where enough of its frames agree.
    fn settle(&mut self, unit: usize, votes_needed: usize) {
        let Some(state) = self.units.get(unit) else {
            return;
        };
        let mut votes: BTreeMap<i64, usize> = BTreeMap::new();
        for frame in &state.unfitted {
            let window = frame.time.plus_nanos(-TOLERANCE_NS)..=frame.time.plus_nanos(TOLERANCE_NS);
            let nearest = self
                .times
                .range(window)
                .min_by_key(|(time, _)| (**time - frame.time).abs());
            if let Some((_, trigger)) = nearest {
                *votes.entry(trigger - frame.index).or_default() += 1;
            }
        }
        let best = votes.into_iter().max_by_key(|(_, votes)| *votes);
        if let Some((offset, votes)) = best
            && votes >= votes_needed
        {
            self.place_all(unit, offset);
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
        for frame in std::mem::take(&mut state.unfitted) {
            self.place(unit, frame, offset);
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
