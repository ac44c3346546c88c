//! One unit of a group: its counter, what its frames say of where its clock lies, and those that were placed.

use std::collections::VecDeque;

use lsfb_types::Timestamp;

/// Frames of a unit that tell where its counter lies; few enough that no drift matters.
pub(super) const RECENT: usize = 64;
/// Until a unit has sent two frames its period is taken for this.
const USUAL_PERIOD_NS: i64 = 50_000_000;
/// Groups that wait for their last image, at most: minutes, since the links of two units may run far apart.
pub(super) const OPEN_GROUPS: usize = 4096;
/// Triggers of a unit whose time is remembered, for units that still have to be fitted in.
const REMEMBERED: usize = 2 * OPEN_GROUPS;

#[derive(Debug, Default)]
pub(super) struct Unit {
    /// Its frame counter, continued.
    pub(super) last_index: Option<i64>,
    /// Add this to the index for the trigger.
    pub(super) trigger_from_index: Option<i64>,
    /// Frames that wait until that is known.
    pub(super) unfitted: Vec<Frame>,
    /// What its last frames say of where its clock lies.
    pub(super) recent: VecDeque<Hint>,
    /// Its frames that are placed, in order of time.
    pub(super) placed: VecDeque<Placed>,
    /// What the frames that wait would have `trigger_from_index` be, and how many frames ago they began to.
    pub(super) proposed: Option<(i64, u32)>,
    pub(super) contradictions: u32,
    pub(super) last_trigger: Option<i64>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) camera: usize,
    pub(super) index: i64,
    pub(super) device_ns: i64,
    pub(super) time: Timestamp,
}

/// Recording time less the unit's, at most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hint {
    pub(super) index: i64,
    pub(super) device_ns: i64,
    pub(super) offset_ns: i64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) device_ns: i64,
    pub(super) trigger: i64,
}

impl Unit {
    /// Takes what a frame says of the clock; of the images of one frame the first.
    pub(super) fn hear(&mut self, hint: Hint) -> IsNew {
        if self
            .recent
            .back()
            .is_some_and(|last| last.index == hint.index)
        {
            return IsNew::No;
        }
        self.recent.push_back(hint);
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        IsNew::Yes
    }

    /// Recording time less the unit's.
    pub(super) fn offset_ns(&self) -> i64 {
        let offsets = self.recent.iter().map(|hint| hint.offset_ns);
        offsets.min().unwrap_or_default()
    }

    /// Time between two triggers.
    pub(super) fn period_ns(&self) -> i64 {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else {
            return USUAL_PERIOD_NS;
        };
        let span_ns = last.device_ns.saturating_sub(first.device_ns);
        match last.index.saturating_sub(first.index) {
            triggers @ 1.. if span_ns > 0 => span_ns / triggers,
            _ => USUAL_PERIOD_NS,
        }
    }

    /// The trigger of the frame taken nearest to a time of the unit, and how far from it.
    pub(super) fn nearest(&self, device_ns: i64) -> Option<(i64, i64)> {
        let after = self.placed.partition_point(|p| p.device_ns < device_ns);
        let around = after.saturating_sub(1)..(after + 1).min(self.placed.len());
        self.placed
            .range(around)
            .map(|p| {
                (
                    p.device_ns.saturating_sub(device_ns).saturating_abs(),
                    p.trigger,
                )
            })
            .min()
    }

    pub(super) fn remember(&mut self, placed: Placed) {
        // A late frame is no less true, but the search wants them in order.
        if self
            .placed
            .back()
            .is_none_or(|last| last.device_ns < placed.device_ns)
        {
            self.placed.push_back(placed);
        }
        if self.placed.len() > REMEMBERED {
            self.placed.pop_front();
        }
    }

    /// Its place among the others is not known any more.
    pub(super) fn forget_place(&mut self) {
        self.trigger_from_index = None;
        self.recent.clear();
        self.placed.clear();
        self.proposed = None;
        self.contradictions = 0;
    }
}

/// Whether an image is the first of its frame.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum IsNew {
    Yes,
    No,
}
