//! Straight edges between saddles: dark on one side over their whole length.

use lsfb_geometry::Vector2;

use super::saddle::{Blurred, Saddle};

/// Where the edge along one ray ends: at another saddle, on one of its rays.
#[derive(Clone, Copy)]
pub(super) struct Link {
    pub saddle: usize,
    /// The ray of that saddle which points back.
    pub back: usize,
    pub length_px: f64,
}

/// For each saddle, the link along each ray.
pub(super) type Links = Vec<[Option<Link>; 4]>;

/// Cosine of the angle by which a ray may miss the saddle it leads to: lenses bend edges.
const MIN_COSINE: f64 = 0.97;
/// Saddles tried along one ray, the nearest first.
const TRIES: usize = 3;
/// Shortest edge, pixels.
const MIN_LENGTH_PX: f64 = 5.0;

/// Joins every saddle to the nearest one along each of its rays that an edge leads to; links go both ways or not at all.
pub(super) fn join(gray: &Blurred, saddles: &[Saddle]) -> Links {
    let mut links: Links = vec![[None; 4]; saddles.len()];
    for (i, from) in saddles.iter().enumerate() {
        let mut nearest = [[(f64::INFINITY, usize::MAX); TRIES]; 4];
        for (j, to) in saddles.iter().enumerate() {
            let d = to.position - from.position;
            let squared = d.norm_squared();
            if squared < MIN_LENGTH_PX * MIN_LENGTH_PX {
                continue;
            }
            for (k, direction) in from.directions.iter().enumerate() {
                let along = d.dot(direction);
                if squared < nearest[k][TRIES - 1].0
                    && along > 0.0
                    && along * along > MIN_COSINE * MIN_COSINE * squared
                {
                    insert(&mut nearest[k], squared, j);
                }
            }
        }
        for (k, candidates) in nearest.iter().enumerate() {
            links[i][k] = candidates
                .iter()
                .filter(|c| c.1 != usize::MAX)
                .find_map(|c| edge(gray, from, k, c.1, &saddles[c.1]));
        }
    }
    let one_way = links.clone();
    for (i, rays) in links.iter_mut().enumerate() {
        for (k, link) in rays.iter_mut().enumerate() {
            let mutual = link.is_some_and(|l| {
                one_way[l.saddle][l.back].is_some_and(|b| b.saddle == i && b.back == k)
            });
            if !mutual {
                *link = None;
            }
        }
    }
    links
}

fn insert(nearest: &mut [(f64, usize); TRIES], squared: f64, j: usize) {
    let mut at = TRIES - 1;
    while at > 0 && nearest[at - 1].0 > squared {
        nearest[at] = nearest[at - 1];
        at -= 1;
    }
    nearest[at] = (squared, j);
}

fn edge(gray: &Blurred, from: &Saddle, ray: usize, saddle: usize, to: &Saddle) -> Option<Link> {
    let d = to.position - from.position;
    let length_px = d.norm();
    let unit = d / length_px;
    let back = (0..4).find(|k| -unit.dot(&to.directions[*k]) > MIN_COSINE)?;
    // What is dark behind the ray is dark before the ray that points back.
    let dark_behind = from.is_dark(ray);
    if to.is_dark(back) == dark_behind {
        return None;
    }
    let behind = Vector2::new(-unit.y, unit.x);
    let toward_dark = if dark_behind { behind } else { -behind };
    let offset = (0.1 * length_px).clamp(1.5, 3.0);
    let least = 0.3 * from.contrast.min(to.contrast);
    // The edge leaves both saddles along their rays: a bent one is a cubic between them.
    let bend = |share: f64| {
        let start = from.directions[ray] - unit;
        let end = -to.directions[back] - unit;
        let rest = 1.0 - share;
        (start * (share * rest * rest) - end * (share * share * rest)) * length_px
    };
    let mut good = 0;
    for step in 1..=5 {
        let share = f64::from(step) / 6.0;
        let middle = from.position + d * share;
        let contrast_at = |p: Vector2<f64>| {
            let dark = gray.at(&(p + toward_dark * offset))?;
            let light = gray.at(&(p - toward_dark * offset))?;
            Some(light - dark)
        };
        let straight = contrast_at(middle)?;
        let bent = contrast_at(middle + bend(share)).unwrap_or(straight);
        good += usize::from(straight.max(bent) > least);
    }
    (good == 5).then_some(Link {
        saddle,
        back,
        length_px,
    })
}
