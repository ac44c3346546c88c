//! Light on a lattice over each surface: what comes straight is computed at every node, for its shadows have borders; what comes by way of other
//! surfaces only as densely as surroundings are near (Ward, Rubinstein and Clear, "A Ray Tracing Solution for Diffuse Interreflection", 1988),
//! and is interpolated between.

use rayon::prelude::*;

use lsfb_types::{Progress, ProgressFn, Stopped};

use super::super::facet::{Facet, Outline};
use super::super::light::LightGrid;
use super::super::vector::norm;
use super::optics::Optics;
use super::scene::Scene;
use super::tracer::{Light, Spot};
use crate::noise::hash;

/// How finely light is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Baking {
    /// Distance between nodes, metres.
    pub spacing_m: f32,
    /// Paths from each node where the indirect light is computed.
    pub paths: usize,
    pub seed: u64,
}

/// Nodes along the edge of a piece of work.
const BLOCK: usize = 64;
/// Nodes of one facet at most, about: the ground around a park has wider meshes.
const MOST_NODES: f32 = 400_000.0;
/// Work between two looks at whether to go on.
const BATCH: usize = 512;
/// Longest stretch that indirect light is interpolated over, in harmonic mean distances to what is around.
const REACH: f32 = 0.4;
/// The same, metres, whatever is around.
const LONGEST_M: f32 = 6.0;
/// It is computed no more densely than this, metres.
const DENSEST_M: f32 = 0.1;
/// Contrast over a stretch above which it is halved.
const CONTRAST: f32 = 0.25;
/// A node of whose paths more begin inside something is covered by it.
const BURIED: f32 = 0.25;
/// Between the nodes of a leaf, metres, and the share of the paths (one of so many) that it gets. Trees of a park have half a million nodes otherwise,
/// each in a narrow place where nothing can be interpolated.
const LEAF_M: f32 = 0.4;
const LEAF_PATHS: usize = 4;
/// Rings of nodes to which light is carried on below what covers them, so that interpolation up to its border finds no darkness.
const RINGS: usize = 3;
/// Nodes keep this far from the border of their facet, in spacings: on the border they would lie within the neighbour.
const INSET: f32 = 0.2;

/// Illuminance of all facets, lux. Backdrops get none.
pub(crate) fn bake(
    scene: &Scene,
    surfaces: &[(Facet, Optics)],
    baking: &Baking,
    progress: ProgressFn,
) -> Result<Vec<LightGrid>, Stopped> {
    let sheets: Vec<Sheet> = surfaces
        .iter()
        .enumerate()
        .map(|(k, (facet, optics))| Sheet::new(k, facet, optics, baking))
        .collect();
    let blocks: Vec<(usize, Block)> = sheets
        .iter()
        .enumerate()
        .flat_map(|(k, sheet)| sheet.blocks().map(move |block| (k, block)))
        .collect();
    let mut nodes: Vec<Vec<Node>> = sheets
        .iter()
        .map(|sheet| vec![Node::default(); sheet.columns * sheet.rows])
        .collect();
    let mut straight: Vec<LightGrid> = Vec::new();
    for pass in [Pass::Straight, Pass::Indirect] {
        for (batch, work) in blocks.chunks(BATCH).enumerate() {
            progress(Progress {
                stage: match pass {
                    Pass::Straight => "casting shadows",
                    Pass::Indirect => "tracing light",
                },
                done: (batch * BATCH) as u64,
                total: blocks.len() as u64,
            })?;
            let done: Vec<Vec<Node>> = work
                .par_iter()
                .map(|(k, block)| {
                    let patch = Patch::new(scene, &sheets[*k], baking, *block, &nodes[*k]);
                    match pass {
                        Pass::Straight => patch.lit_straight(),
                        Pass::Indirect => patch.lit_by(&straight),
                    }
                })
                .collect();
            for ((k, block), computed) in work.iter().zip(done) {
                block.put(&computed, &sheets[*k], &mut nodes[*k]);
            }
        }
        // After the first pass, what paths look up; after the second, all of it.
        let finished = sheets
            .par_iter()
            .zip(&nodes)
            .map(|(sheet, nodes)| LightGrid {
                columns: sheet.columns,
                rows: sheet.rows,
                values: finish(sheet, nodes),
            });
        straight = finished.collect();
    }
    Ok(straight)
}

/// What is computed.
#[derive(Clone, Copy, Debug)]
enum Pass {
    /// What comes straight, and which nodes are covered.
    Straight,
    /// What comes by way of other surfaces.
    Indirect,
}

/// What is known of a node.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    straight_lx: f32,
    indirect_lx: f32,
    room_m: f32,
    buried: bool,
    computed: bool,
}

/// The lattice of one facet.
struct Sheet<'a> {
    number: usize,
    facet: &'a Facet,
    columns: usize,
    rows: usize,
    /// Between nodes along either edge, metres.
    step_m: [f32; 2],
    inset: [f32; 2],
    dark: bool,
    leaf: bool,
}

impl<'a> Sheet<'a> {
    fn new(number: usize, facet: &'a Facet, optics: &Optics, baking: &Baking) -> Self {
        let lengths = [norm(facet.edge_a), norm(facet.edge_b)];
        let sparsest_m = (lengths[0] * lengths[1] / MOST_NODES).sqrt();
        let spacing_m = match optics.leaf {
            true => baking.spacing_m.max(LEAF_M),
            false => baking.spacing_m.max(sparsest_m),
        };
        let dark = optics.backdrop || optics.glass;
        let single = dark || lengths.iter().all(|l| *l < spacing_m);
        let nodes = |length: f32| match single {
            true => 1,
            // A cast from float to integer saturates.
            false => ((length / spacing_m + 0.5) as usize + 1).clamp(2, usize::from(u16::MAX)),
        };
        let [columns, rows] = lengths.map(nodes);
        let steps = [columns, rows].map(|n| n.saturating_sub(1).max(1) as f32);
        Self {
            number,
            facet,
            columns,
            rows,
            step_m: std::array::from_fn(|i| lengths[i] / steps[i]),
            inset: lengths.map(|l| (INSET * spacing_m / l).min(0.3)),
            dark,
            leaf: optics.leaf,
        }
    }

    fn blocks(&self) -> impl Iterator<Item = Block> + use<> {
        let [columns, rows] = [self.columns, self.rows];
        let blocks = (0..rows).step_by(BLOCK).flat_map(move |y| {
            (0..columns).step_by(BLOCK).map(move |x| Block {
                low: [x, y],
                high: [(x + BLOCK).min(columns - 1), (y + BLOCK).min(rows - 1)],
            })
        });
        blocks.take(if self.dark { 0 } else { usize::MAX })
    }

    fn spot(&self, [i, j]: [usize; 2]) -> Spot {
        let along = |k: usize, count: usize, inset: f32| match count {
            1 => 0.4,
            _ => (k as f32 / (count - 1) as f32).clamp(inset, 1.0 - inset),
        };
        let mut a = along(i, self.columns, self.inset[0]);
        let mut b = along(j, self.rows, self.inset[1]);
        if self.facet.outline() == Outline::Triangle {
            // Beyond the long side: as on it, nearly.
            let over = (a + b) / (1.0 - 0.5 * (self.inset[0] + self.inset[1])).max(0.5);
            if over > 1.0 {
                (a, b) = (a / over, b / over);
            }
        }
        Spot {
            point: self.facet.point(a, b),
            normal: self.facet.normal,
        }
    }
}

/// Nodes from `low` to `high`, both included; the last ones belong to the next block, where there is one.
#[derive(Clone, Copy, Debug)]
struct Block {
    low: [usize; 2],
    high: [usize; 2],
}

impl Block {
    fn width(&self) -> usize {
        self.high[0] - self.low[0] + 1
    }

    fn put(&self, computed: &[Node], sheet: &Sheet, nodes: &mut [Node]) {
        let width = self.width();
        for y in self.low[1]..=self.high[1].min(self.low[1] + BLOCK - 1) {
            let count = width.min(BLOCK);
            let from = (y - self.low[1]) * width;
            let to = y * sheet.columns + self.low[0];
            nodes[to..to + count].copy_from_slice(&computed[from..from + count]);
        }
    }
}

/// A block being computed.
struct Patch<'a> {
    scene: &'a Scene,
    sheet: &'a Sheet<'a>,
    baking: &'a Baking,
    block: Block,
    nodes: Vec<Node>,
    straight: &'a [LightGrid],
}

impl<'a> Patch<'a> {
    fn new(
        scene: &'a Scene,
        sheet: &'a Sheet,
        baking: &'a Baking,
        block: Block,
        nodes: &[Node],
    ) -> Self {
        let row = |y: usize| y * sheet.columns + block.low[0]..=y * sheet.columns + block.high[0];
        let rows = (block.low[1]..=block.high[1]).flat_map(|y| &nodes[row(y)]);
        Self {
            scene,
            sheet,
            baking,
            block,
            nodes: rows.copied().collect(),
            straight: &[],
        }
    }

    fn lit_straight(mut self) -> Vec<Node> {
        for y in self.block.low[1]..=self.block.high[1] {
            for x in self.block.low[0]..=self.block.high[0] {
                let k = self.index([x, y]);
                let spot = self.sheet.spot([x, y]);
                let seed = !self.seed([x, y]);
                let buried = self.scene.buried(&spot, seed) > BURIED;
                self.nodes[k] = Node {
                    straight_lx: match buried {
                        true => 0.0,
                        false => self.scene.straight_lx(&spot, seed),
                    },
                    buried,
                    ..Node::default()
                };
            }
        }
        self.nodes
    }

    fn lit_by(mut self, straight: &'a [LightGrid]) -> Vec<Node> {
        self.straight = straight;
        self.interpolate(self.block.low, self.block.high);
        self.nodes
    }

    fn index(&self, [x, y]: [usize; 2]) -> usize {
        (y - self.block.low[1]) * self.block.width() + x - self.block.low[0]
    }

    fn seed(&self, [x, y]: [usize; 2]) -> u64 {
        let node = (y * self.sheet.columns + x) as u64;
        hash(self.baking.seed ^ hash((self.sheet.number as u64) << 32 | node))
    }

    /// The indirect light at a node.
    fn node(&mut self, at: [usize; 2]) -> Node {
        let k = self.index(at);
        if !self.nodes[k].computed && !self.nodes[k].buried {
            let spot = self.sheet.spot(at);
            let light = Light::Indirect(self.straight);
            let paths = match self.sheet.leaf {
                true => self.baking.paths.div_ceil(LEAF_PATHS),
                false => self.baking.paths,
            };
            let gathered = self.scene.gather(&spot, paths, self.seed(at), light);
            self.nodes[k] = Node {
                indirect_lx: gathered.illuminance_lx,
                room_m: gathered.room_m,
                computed: true,
                ..self.nodes[k]
            };
        }
        self.nodes[k]
    }

    /// Fills a rectangle of nodes, corners included.
    fn interpolate(&mut self, low: [usize; 2], high: [usize; 2]) {
        let corners = [low, [high[0], low[1]], [low[0], high[1]], high].map(|at| self.node(at));
        let count = [high[0] - low[0], high[1] - low[1]];
        let sides_m: [f32; 2] = std::array::from_fn(|i| count[i] as f32 * self.sheet.step_m[i]);
        let size_m = sides_m[0].max(sides_m[1]);
        let divisible = !self.sheet.leaf && (0..2).any(|i| count[i] > 1) && size_m > DENSEST_M;
        if divisible && needs_more(&corners, size_m) {
            // The longer side alone, where the other is much shorter.
            let halved: [bool; 2] =
                std::array::from_fn(|i| count[i] > 1 && sides_m[i] > 0.4 * size_m);
            let parts: [Vec<[usize; 2]>; 2] = std::array::from_fn(|i| {
                let middle = low[i] + count[i] / 2;
                match halved[i] {
                    true => vec![[low[i], middle], [middle, high[i]]],
                    false => vec![[low[i], high[i]]],
                }
            });
            for y in &parts[1] {
                for x in &parts[0] {
                    self.interpolate([x[0], y[0]], [x[1], y[1]]);
                }
            }
            return;
        }
        for y in low[1]..=high[1] {
            for x in low[0]..=high[0] {
                let k = self.index([x, y]);
                if self.nodes[k].computed || self.nodes[k].buried {
                    continue;
                }
                let share =
                    |at: usize, i: usize| (at - low[i]) as f32 / (high[i] - low[i]).max(1) as f32;
                let (u, v) = (share(x, 0), share(y, 1));
                let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
                self.nodes[k].indirect_lx = mixed(&corners, weights);
            }
        }
    }
}

/// Whether light between four corners cannot be told from theirs.
fn needs_more(corners: &[Node; 4], size_m: f32) -> bool {
    let open: Vec<&Node> = corners.iter().filter(|n| !n.buried).collect();
    if open.len() < corners.len() {
        // The border of what covers some of them is looked for, and so are gaps between large things.
        return !open.is_empty() || size_m > 0.5;
    }
    let over = |of: fn(&Node) -> f32, fold: fn(f32, f32) -> f32, from: f32| {
        open.iter().map(|n| of(n)).fold(from, fold)
    };
    let room_m = over(|n| n.room_m, f32::min, f32::INFINITY);
    let least = over(|n| n.indirect_lx, f32::min, f32::INFINITY);
    let most = over(|n| n.indirect_lx, f32::max, 0.0);
    size_m > (REACH * room_m).min(LONGEST_M) || most - least > CONTRAST * (most + least)
}

fn mixed(corners: &[Node; 4], weights: [f32; 4]) -> f32 {
    let (mut sum, mut light) = (0.0, 0.0);
    for (corner, weight) in corners.iter().zip(weights) {
        if !corner.buried {
            sum += weight;
            light += weight * corner.indirect_lx;
        }
    }
    light / f32::max(sum, 1e-6)
}

/// Illuminance of all nodes: the noise of the indirect light smoothed, covered nodes given what is beside them.
fn finish(sheet: &Sheet, nodes: &[Node]) -> Vec<f32> {
    let (w, h) = (sheet.columns, sheet.rows);
    let beside = |k: usize| {
        let (x, y) = (k % w, k / w);
        let (xs, ys) = (
            x.saturating_sub(1)..(x + 2).min(w),
            y.saturating_sub(1)..(y + 2).min(h),
        );
        ys.flat_map(move |j| {
            xs.clone().map(move |i| {
                let weight = |d: usize| if d == 0 { 2.0 } else { 1.0_f32 };
                (j * w + i, weight(i.abs_diff(x)) * weight(j.abs_diff(y)))
            })
        })
    };
    let mut values: Vec<Option<f32>> = (0..nodes.len())
        .map(|k| {
            if nodes[k].buried || sheet.dark {
                return None;
            }
            let (mut sum, mut light) = (0.0, 0.0);
            for (n, weight) in beside(k).filter(|(n, _)| !nodes[*n].buried) {
                sum += weight;
                light += weight * nodes[n].indirect_lx;
            }
            Some(nodes[k].straight_lx + light / f32::max(sum, 1.0))
        })
        .collect();
    for _ in 0..RINGS {
        let before = values.clone();
        for k in (0..values.len()).filter(|k| before[*k].is_none()) {
            let near = beside(k).filter_map(|(n, weight)| Some((before[n]?, weight)));
            let (light, sum) = near.fold((0.0, 0.0), |(light, sum), (value, weight)| {
                (light + weight * value, sum + weight)
            });
            if sum > 0.0 {
                values[k] = Some(light / sum);
            }
        }
    }
    values.into_iter().map(|v| v.unwrap_or(0.0)).collect()
}
