//! Several places at the same time: what one stage leaves idle another uses.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::trial::Size;
use crate::context::Context;
use crate::memory::{self, Beside};

impl Size {
    /// The most memory that a place takes, megabytes.
    const fn place_mb(self) -> u64 {
        match self {
            Self::Full => 8_000,
            Self::Quick | Self::TryOut => 2_500,
        }
    }

    /// How many places the cores and the free memory of this machine allow; where nobody says what is free, one.
    pub fn at_once(self) -> usize {
        let in_memory = memory::free_mb().map_or(1, |free| free / self.place_mb());
        let in_memory = usize::try_from(in_memory).unwrap_or(usize::MAX);
        rayon::current_num_threads().min(in_memory).max(1)
    }
}

/// [`each`] as parts of the command that run beside one another, if there are several: what each shows begins with its name.
pub fn each_part<T: Sync, R: Send>(
    items: &[T],
    at_once: usize,
    context: &Context,
    name: impl Fn(&T) -> String + Sync,
    work: impl Fn(&T, &Context) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    match at_once.min(items.len()) {
        0 | 1 => each(items, 1, |item| work(item, context)),
        several => {
            let _beside = Beside::begin();
            each(items, several, |item| {
                work(item, &context.part(&name(item)))
            })
        }
    }
}

/// What `work` gives for each of `items`, in their order, `count` of them at the same time. After an error no other is begun, and the first is
/// returned.
fn each<T: Sync, R: Send>(
    items: &[T],
    count: usize,
    work: impl Fn(&T) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let (next, has_failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let results: Vec<Mutex<Option<anyhow::Result<R>>>> =
        items.iter().map(|_| Mutex::new(None)).collect();
    let work_through = || {
        while !has_failed.load(Ordering::Relaxed) {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let Some((item, place)) = items.get(k).zip(results.get(k)) else {
                return;
            };
            let result = work(item);
            has_failed.fetch_or(result.is_err(), Ordering::Relaxed);
            if let Ok(mut place) = place.lock() {
                *place = Some(result);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..count.clamp(1, items.len().max(1)) {
            scope.spawn(work_through);
        }
    });
    let done = results.into_iter().filter_map(|r| r.into_inner().ok()?);
    done.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_the_order_of_the_items() {
        let items: Vec<u64> = (0..20).collect();
        let slow_first = |n: &u64| {
            std::thread::sleep(std::time::Duration::from_millis(20 - n));
            Ok(n * n)
        };
        let squares: Vec<u64> = items.iter().map(|n| n * n).collect();
        for count in [0, 1, 3, 40] {
            assert_eq!(
                each(&items, count, slow_first).expect("none fails"),
                squares
            );
        }
        assert!(each(&[], 2, slow_first).expect("nothing to do").is_empty());
    }

    #[test]
    fn nothing_is_begun_after_an_error() {
        let begun = AtomicUsize::new(0);
        let refused = each(&[0, 1, 2, 3, 4, 5], 2, |n| {
            begun.fetch_add(1, Ordering::Relaxed);
            anyhow::ensure!(*n != 0, "the disk is full");
            std::thread::sleep(std::time::Duration::from_millis(50));
            Ok(())
        });
        let error = refused.expect_err("the first fails");
        assert_eq!(error.to_string(), "the disk is full");
        assert!(begun.into_inner() <= 2);
    }
}
