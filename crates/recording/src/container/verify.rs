//! Looking at a whole file: every checksum, or every index.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use lsfb_types::{Progress, ProgressFn, Stopped, Timestamp};

use crate::container::chunk::{self, Scratch};
use crate::container::index::Index;
use crate::container::record::timestamp;
use crate::container::record::{self, opcode};
use crate::container::source::Source;
use crate::error::{Damage, Error};

/// So many chunks are worth a thread.
const WORTH_A_THREAD: usize = 16;
/// How often progress is told.
const TELL: Duration = Duration::from_millis(100);

/// Checks every chunk. What is found does not depend on the number of threads.
pub(crate) fn all(
    source: &Source,
    index: &Index,
    progress: ProgressFn<'_>,
) -> Result<Vec<Damage>, Error> {
    let next = AtomicUsize::new(0);
    let found: Mutex<Vec<Result<Damage, Error>>> = Mutex::new(Vec::new());
    let work = || {
        let mut scratch = Scratch::default();
        while let Some(entry) = index.chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
            let problem = match chunk::verify(source, entry, &mut scratch) {
                Ok(()) => continue,
                Err(Error::Damaged { damage, .. }) => Ok(damage),
                Err(error) => Err(error),
            };
            found
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(problem);
        }
    };
    let total = index.chunks.len();
    std::thread::scope(|scope| -> Result<(), Stopped> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        // A thread costs more than a few chunks.
        let threads: Vec<_> = (0..cores.min(total / WORTH_A_THREAD))
            .filter_map(|n| {
                let name = format!("verify-{n}");
                let thread = std::thread::Builder::new().name(name);
                thread.spawn_scoped(scope, work).ok()
            })
            .collect();
        if threads.is_empty() {
            work();
        }
        // Short recordings are done at once.
        let mut patience = Duration::from_micros(200);
        while !threads.iter().all(|thread| thread.is_finished()) {
            progress(Progress {
                stage: "verifying recording",
                done: next.load(Ordering::Relaxed).min(total) as u64,
                total: total as u64,
            })
            // No chunk is left to take: the threads end with the one they have.
            .inspect_err(|_| next.store(total, Ordering::Relaxed))?;
            std::thread::sleep(patience);
            patience = (2 * patience).min(TELL);
        }
        Ok(())
    })?;
    let mut damage = index.damage.clone();
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    for problem in found {
        damage.push(problem?);
    }
    damage.sort_by_key(|d| d.offset);
    Ok(damage)
}

/// When the messages of a topic arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicArrivals {
    /// Its name.
    pub topic: String,
    /// Arrivals in ascending order.
    pub times: Vec<Timestamp>,
}

/// Reads every message index.
pub(crate) fn arrivals(
    source: &Source,
    index: &Index,
    progress: ProgressFn<'_>,
) -> Result<Vec<TopicArrivals>, Error> {
    let mut by_channel: BTreeMap<u16, Vec<u64>> = BTreeMap::new();
    let mut indices = Vec::new();
    for (done, entry) in index.chunks.iter().enumerate() {
        if done % 1024 == 0 {
            progress(Progress {
                stage: "reading indices",
                done: done as u64,
                total: index.chunks.len() as u64,
            })?;
        }
        let offset = entry.offset.saturating_add(entry.record_bytes);
        source.read_into(&mut indices, offset, entry.index_bytes)?;
        let mut rest = indices.as_slice();
        while let Some((opcode, body)) = record::next_record(&mut rest) {
            if opcode != opcode::MESSAGE_INDEX {
                break;
            }
            if let Some((channel, times)) = record::message_index_times(body) {
                by_channel.entry(channel).or_default().extend(times);
            }
        }
    }
    let mut by_topic: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for (id, times) in by_channel {
        if let Some(channel) = index.channels.get(&id) {
            by_topic.entry(&channel.topic).or_default().extend(times);
        }
    }
    Ok(by_topic
        .into_iter()
        .map(|(topic, mut times)| {
            times.sort_unstable();
            TopicArrivals {
                topic: topic.to_owned(),
                times: times.into_iter().map(timestamp).collect(),
            }
        })
        .collect())
}
