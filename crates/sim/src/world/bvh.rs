//! Bounding volume hierarchy over facets, split by the surface area heuristic, traversed eight rays at a time.

use wide::f32x8;

use super::bounds::Bounds;
use super::facet::Facet;
use super::lanes::{Eight, Job, Processor};
use super::packet::Prepared;
use super::ray::{LANES, NO_FACET, Origin, PacketHit, RayPacket};

/// Facets per leaf at most, unless they cannot be told apart by their centres.
const LEAF_FACETS: usize = 4;
const BINS: usize = 16;
/// Cost of visiting a node, in units of one facet test.
const NODE_COST: f32 = 1.0;
/// Deep enough for any tree over 2³² facets that halves at least now and then; deeper branches become leaves.
const MAX_DEPTH: usize = 48;

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    /// Leaf: first facet. Inner node: left child; the right one follows it.
    first: u32,
    /// Facets of a leaf, 0 for an inner node.
    count: u32,
}

/// The nearest facet seen from its front.
const FRONT: u8 = 0;
/// The nearest facet seen from either side.
const EITHER: u8 = 1;
/// Any facet seen from either side: the nearest need not be found.
const ANY: u8 = 2;

/// The hierarchy. Its facets are in its own order.
#[derive(Clone, Debug)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    processor: Processor,
}

impl Bvh {
    /// Builds the tree and returns it with the order it wants its facets in.
    pub(crate) fn build(facets: &[Facet]) -> (Self, Vec<usize>) {
        let bounds: Vec<Bounds> = facets.iter().map(Bounds::of).collect();
        let mut order: Vec<usize> = (0..facets.len()).collect();
        let mut nodes = vec![Node {
            bounds: Bounds::EMPTY,
            first: 0,
            count: 0,
        }];
        split(&mut nodes, 0, &bounds, &mut order, 0, 0);
        let tree = Self {
            nodes,
            processor: Processor::here(),
        };
        (tree, order)
    }

    /// The nearest facet hit by each ray, seen from its front, closer than `limit`.
    pub(crate) fn cast(&self, facets: &[Facet], rays: &RayPacket, limit: f32x8) -> PacketHit {
        match rays.origin {
            Origin::Shared(_) => self.run::<true, FRONT>(facets, rays, limit),
            Origin::Each(_) => self.run::<false, FRONT>(facets, rays, limit),
        }
    }

    /// The nearest facet hit by each ray, from whichever side, closer than `limit`.
    pub(crate) fn cast_either(
        &self,
        facets: &[Facet],
        rays: &RayPacket,
        limit: f32x8,
    ) -> PacketHit {
        match rays.origin {
            Origin::Shared(_) => self.run::<true, EITHER>(facets, rays, limit),
            Origin::Each(_) => self.run::<false, EITHER>(facets, rays, limit),
        }
    }

    /// Lanes, from the lowest bit, that hit anything closer than `limit` from whichever side.
    pub(crate) fn any(&self, facets: &[Facet], rays: &RayPacket, limit: f32x8) -> u32 {
        let hit = match rays.origin {
            Origin::Shared(_) => self.run::<true, ANY>(facets, rays, limit),
            Origin::Each(_) => self.run::<false, ANY>(facets, rays, limit),
        };
        let lanes = hit.facet.into_iter().enumerate();
        lanes.fold(0, |mask, (lane, facet)| {
            mask | u32::from(facet != NO_FACET) << lane
        })
    }

    fn run<const SHARED: bool, const WANTED: u8>(
        &self,
        facets: &[Facet],
        rays: &RayPacket,
        limit: f32x8,
    ) -> PacketHit {
        if facets.is_empty() {
            return PacketHit::nothing(limit);
        }
        self.processor.run(Traversal::<'_, SHARED, WANTED> {
            nodes: &self.nodes,
            facets,
            rays,
            limit,
        })
    }
}

/// A way through the tree.
struct Traversal<'a, const SHARED: bool, const WANTED: u8> {
    nodes: &'a [Node],
    facets: &'a [Facet],
    rays: &'a RayPacket,
    limit: f32x8,
}

impl<const SHARED: bool, const WANTED: u8> Job for Traversal<'_, SHARED, WANTED> {
    type Output = PacketHit;

    #[inline(always)]
    fn run_on<E: Eight>(self, eight: E) -> PacketHit {
        let rays = Prepared::<E, SHARED>::new(eight, self.rays);
        let mut best = eight.load(self.limit);
        let mut found = eight.splat_index(NO_FACET);
        let mut stack = [(0_u32, 0.0_f32); MAX_DEPTH + 2];
        let mut depth = 0;
        let mut farthest = eight.largest(best);
        let mut current = 0_u32;
        'all: loop {
            let node = &self.nodes[current as usize];
            if node.count > 0 {
                let first = node.first as usize;
                for (k, facet) in self.facets[first..first + node.count as usize]
                    .iter()
                    .enumerate()
                {
                    let met = match WANTED {
                        FRONT => rays.meet(facet, &mut best),
                        _ => rays.meet_either(facet, &mut best),
                    };
                    if let Some(met) = met {
                        let number = eight.splat_index((first + k) as u32);
                        found = eight.select_indices(met, number, found);
                        if WANTED == ANY {
                            // What has hit something looks no further.
                            best = eight.select(met, eight.splat(0.0), best);
                        }
                    }
                }
                farthest = eight.largest(best);
                if WANTED == ANY && farthest <= 0.0 {
                    break 'all;
                }
            } else {
                let (left, right) = (node.first, node.first + 1);
                let near_left = rays.enter(&self.nodes[left as usize].bounds, best);
                let near_right = rays.enter(&self.nodes[right as usize].bounds, best);
                match (near_left, near_right) {
                    (Some(l), Some(r)) => {
                        let (near, far, far_entry) = if l <= r {
                            (left, right, r)
                        } else {
                            (right, left, l)
                        };
                        stack[depth] = (far, far_entry);
                        depth += 1;
                        current = near;
                        continue;
                    }
                    (Some(_), None) => {
                        current = left;
                        continue;
                    }
                    (None, Some(_)) => {
                        current = right;
                        continue;
                    }
                    (None, None) => {}
                }
            }
            loop {
                if depth == 0 {
                    break 'all;
                }
                depth -= 1;
                if stack[depth].1 <= farthest {
                    current = stack[depth].0;
                    break;
                }
            }
        }
        PacketHit {
            distance: eight.store(best),
            facet: eight.store_indices(found),
            carrier: [0; LANES],
        }
    }
}

fn split(
    nodes: &mut Vec<Node>,
    at: usize,
    bounds: &[Bounds],
    order: &mut [usize],
    first: usize,
    depth: usize,
) {
    let mut all = Bounds::EMPTY;
    let mut centres = Bounds::EMPTY;
    for &i in order.iter() {
        all.include(&bounds[i]);
        let c = centre(&bounds[i]);
        centres.include(&Bounds { min: c, max: c });
    }
    nodes[at].bounds = all;
    let plane = if order.len() > LEAF_FACETS / 2 && depth < MAX_DEPTH {
        best_plane(bounds, order, &all, &centres)
    } else {
        None
    };
    let Some((axis, position)) = plane else {
        nodes[at].first = first as u32;
        nodes[at].count = order.len() as u32;
        return;
    };
    let mut middle = 0;
    for i in 0..order.len() {
        if centre(&bounds[order[i]])[axis] < position {
            order.swap(i, middle);
            middle += 1;
        }
    }
    let left = nodes.len();
    nodes[at].first = left as u32;
    nodes.extend([nodes[at]; 2]);
    let (l, r) = order.split_at_mut(middle);
    split(nodes, left, bounds, l, first, depth + 1);
    split(nodes, left + 1, bounds, r, first + middle, depth + 1);
}

fn centre(b: &Bounds) -> [f32; 3] {
    std::array::from_fn(|i| 0.5 * (b.min[i] + b.max[i]))
}

/// Axis and position of the cheapest of the binned planes; `None` where a leaf is cheaper.
fn best_plane(
    bounds: &[Bounds],
    order: &[usize],
    all: &Bounds,
    centres: &Bounds,
) -> Option<(usize, f32)> {
    let mut best_cost = if order.len() <= LEAF_FACETS {
        order.len() as f32
    } else {
        f32::INFINITY
    };
    let mut best = None;
    for axis in 0..3 {
        let (low, extent) = (centres.min[axis], centres.max[axis] - centres.min[axis]);
        if extent <= 1e-6 {
            continue;
        }
        let mut bins = [(Bounds::EMPTY, 0_usize); BINS];
        let edge = |k: usize| low + extent * k as f32 / BINS as f32;
        for &i in order {
            let c = centre(&bounds[i])[axis];
            // Binned by the very comparison that partitions, so that no side can end up empty.
            let k = (1..BINS).take_while(|&k| c >= edge(k)).count();
            bins[k].0.include(&bounds[i]);
            bins[k].1 += 1;
        }
        for k in 1..BINS {
            let mut sides = [(Bounds::EMPTY, 0_usize); 2];
            for (j, bin) in bins.iter().enumerate() {
                let side = &mut sides[usize::from(j >= k)];
                side.0.include(&bin.0);
                side.1 += bin.1;
            }
            if sides[0].1 == 0 || sides[1].1 == 0 {
                continue;
            }
            let cost = NODE_COST
                + (sides[0].0.half_area() * sides[0].1 as f32
                    + sides[1].0.half_area() * sides[1].1 as f32)
                    / all.half_area();
            if cost < best_cost {
                best_cost = cost;
                best = Some((axis, edge(k)));
            }
        }
    }
    best
}
