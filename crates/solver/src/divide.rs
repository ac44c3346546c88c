use std::ops::Range;

/// Runs `run` on parts of a range, in parallel, each with its part of a state. Parts are found by halving down to
/// `grain`, without memory of its own; what is computed for an item must not depend on the part it falls in.
pub(crate) fn divide<S, Split, Run>(
    range: Range<usize>,
    grain: usize,
    state: S,
    split: &Split,
    run: &Run,
) where
    S: Send,
    Split: Fn(S, &Range<usize>, usize) -> (S, S) + Sync,
    Run: Fn(Range<usize>, S) + Sync,
{
    if range.len() <= grain.max(1) {
        if !range.is_empty() {
            run(range, state);
        }
        return;
    }
    let middle = range.start + range.len() / 2;
    let (left, right) = split(state, &range, middle);
    rayon::join(
        || divide(range.start..middle, grain, left, split, run),
        || divide(middle..range.end, grain, right, split, run),
    );
}

/// [`divide`] over a slice.
pub(crate) fn divide_slice<T: Send>(
    items: &mut [T],
    grain: usize,
    run: &(impl Fn(Range<usize>, &mut [T]) + Sync),
) {
    divide(
        0..items.len(),
        grain,
        items,
        &|items: &mut [T], range, middle| items.split_at_mut(middle - range.start),
        run,
    );
}

/// Runs `work` on the pool, so that what it divides is queued there once and not part by part.
pub(crate) fn on_pool<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    rayon::join(work, || ()).0
}
