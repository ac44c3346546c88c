//! Which extrema to keep: the strongest, but from everywhere in the image.

/// Where a candidate is and how strong.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub x: f32,
    pub y: f32,
    pub response: f32,
}

/// Indices of at most `limit` candidates, most wanted first. Half of the room goes to the strongest of each cell of a grid,
/// the rest to the strongest overall.
pub(crate) fn select(
    candidates: &[Candidate],
    width: u32,
    height: u32,
    limit: usize,
) -> Vec<usize> {
    const COLUMNS: usize = 8;
    const ROWS: usize = 5;
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|&a, &b| {
        let by_response = candidates[b].response.total_cmp(&candidates[a].response);
        by_response.then(a.cmp(&b))
    });
    let quota = (limit / (2 * COLUMNS * ROWS)).max(1);
    let mut taken = [0usize; COLUMNS * ROWS];
    let (mut chosen, mut rest) = (Vec::with_capacity(limit), Vec::new());
    for index in order {
        let c = &candidates[index];
        let column = (c.x.max(0.0) * COLUMNS as f32 / width as f32) as usize;
        let row = (c.y.max(0.0) * ROWS as f32 / height as f32) as usize;
        let cell = row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1);
        if taken[cell] < quota {
            taken[cell] += 1;
            chosen.push(index);
        } else {
            rest.push(index);
        }
    }
    chosen.truncate(limit);
    let room = limit - chosen.len();
    chosen.extend(rest.into_iter().take(room));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weak_corners_survive_beside_a_strong_cluster() {
        let mut candidates: Vec<Candidate> = (0..500)
            .map(|i| Candidate {
                x: 300.0 + (i % 20) as f32,
                y: 200.0 + (i / 20) as f32,
                response: 0.5,
            })
            .collect();
        candidates.push(Candidate {
            x: 10.0,
            y: 10.0,
            response: 0.01,
        });
        let chosen = select(&candidates, 640, 400, 100);
        assert_eq!(chosen.len(), 100);
        assert!(chosen.contains(&500));
        assert_eq!(select(&candidates, 640, 400, 1000).len(), 501);
    }
}
