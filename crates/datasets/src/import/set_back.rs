//! Times that a device told twice, because its clock was set back on the way: sorted, two different seconds would be mixed into one.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use lsfb_types::Timestamp;

/// What is written by several threads, or came over a network, goes back by less, nanoseconds.
const LATE_NS: i64 = 100_000_000;
/// Where one side has fewer of the records of a time than this share of the other's, its stamps are wrong, and the other's are not.
const FEW: f64 = 0.1;

/// A stretch of time that two runs of records share.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ToldTwice {
    pub(super) times: RangeInclusive<Timestamp>,
    /// The runs whose records of that time cannot be told from the others.
    pub(super) runs: Vec<usize>,
}

/// Of each time in the order of the file the number of its run: one ends where times go back by more than they do of themselves.
pub(super) fn runs(times: impl Iterator<Item = Timestamp>) -> Vec<usize> {
    let (mut run, mut latest) = (0, None::<Timestamp>);
    times
        .map(|time| {
            match latest {
                Some(before) if before - time > LATE_NS => {
                    run += 1;
                    latest = Some(time);
                }
                _ => latest = latest.max(Some(time)),
            }
            run
        })
        .collect()
}

/// What runs share of the time, of records in order of time. Parts of a file that were written in another order share none.
pub(super) fn told_twice(records: &[(usize, Timestamp)]) -> Vec<ToldTwice> {
    let mut by_run: BTreeMap<usize, Vec<Timestamp>> = BTreeMap::new();
    for (run, time) in records {
        by_run.entry(*run).or_default().push(*time);
    }
    let inside = |run: usize, times: &RangeInclusive<Timestamp>| {
        let own = &by_run[&run];
        let before = own.partition_point(|time| time < times.start());
        own.partition_point(|time| time <= times.end()) - before
    };
    let spans = by_run.iter();
    let spans = spans.filter_map(|(run, own)| Some((*own.first()?, *own.last()?, *run)));
    let mut spans: Vec<_> = spans.collect();
    spans.sort_unstable();
    let mut found = Vec::new();
    let Some((&(_, mut reach, mut reaching), later)) = spans.split_first() else {
        return found;
    };
    for &(first, end, run) in later {
        if first <= reach {
            let times = first..=end.min(reach);
            let [a, b] = [reaching, run].map(|run| inside(run, &times) as f64);
            let runs = if a < FEW * b {
                vec![reaching]
            } else if b < FEW * a {
                vec![run]
            } else {
                vec![reaching, run]
            };
            found.push(ToldTwice { times, runs });
        }
        if end > reach {
            (reach, reaching) = (end, run);
        }
    }
    found
}

/// Of each of these records whether it is of a time that was told twice and cannot be told from the others. In one pass: stretches are in order of their begin.
pub(super) fn left_out(records: &[(usize, Timestamp)], twice: &[ToldTwice]) -> Vec<bool> {
    let mut until: BTreeMap<usize, Timestamp> = BTreeMap::new();
    let mut begun = 0;
    records
        .iter()
        .map(|(run, time)| {
            while let Some(next) = twice.get(begun).filter(|t| t.times.start() <= time) {
                for run in &next.runs {
                    let own = until.entry(*run).or_insert(*next.times.end());
                    *own = (*own).max(*next.times.end());
                }
                begun += 1;
            }
            until.get(run).is_some_and(|until| time <= until)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(millis: &[i64]) -> Vec<(i64, i64, Vec<usize>)> {
        let times = millis
            .iter()
            .map(|ms| Timestamp::from_nanos(ms * 1_000_000));
        let mut records: Vec<_> = runs(times.clone()).into_iter().zip(times).collect();
        records.sort_by_key(|(_, time)| *time);
        let found = told_twice(&records).into_iter();
        let ms = |time: &Timestamp| time.nanos() / 1_000_000;
        found
            .map(|t| (ms(t.times.start()), ms(t.times.end()), t.runs))
            .collect()
    }

    #[test]
    fn a_clock_that_was_set_back_tells_some_times_twice() {
        let steady: Vec<i64> = (0..100).map(|k| 100 * k).collect();
        assert_eq!(found(&steady), []);
        // Written the other way round, or in two parts, and a network's disorder.
        let reversed: Vec<i64> = steady.iter().rev().map(|ms| 5 * ms).collect();
        assert_eq!(found(&reversed), []);
        assert_eq!(found(&[&steady[50..], &steady[..50]].concat()), []);
        assert_eq!(found(&[0, 50, 30, 80, 60, 120]), []);
        assert_eq!(found(&[]), []);
        // Set back by 2 s at 5 s.
        let again: Vec<i64> = (30..80).map(|k| 100 * k + 40).collect();
        let set_back = [&steady[..50], &again].concat();
        assert_eq!(found(&set_back), [(3040, 4900, vec![0, 1])]);
        // One stamp in the future is that record's fault.
        let mut jumped = steady.clone();
        jumped[20] = 7_050;
        assert_eq!(found(&jumped), [(2100, 7050, vec![0])]);
    }
}
