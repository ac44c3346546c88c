//! Sensors whose transforms were exchanged: with the names the other way round the loops close.

use lsfb_types::{Finding, Verdict};

use super::edge_residual::GraphEdge;
use super::{IMU, LIDAR, adjust};
use crate::Error;

/// Cost that must be left with the names exchanged, as a share.
const EXPLAINED: f64 = 0.05;

/// Two sensors whose transforms to a third kind of sensor close the loops when their names are exchanged there.
pub(super) fn swapped(
    graph: &[GraphEdge],
    names: &[&str],
    cost: f64,
) -> Result<Option<Finding>, Error> {
    let cameras: Vec<&str> = names.iter().copied().filter(|n| *n != LIDAR).collect();
    let pairs = cameras
        .iter()
        .enumerate()
        .flat_map(|(k, a)| cameras[k + 1..].iter().map(move |b| (*a, *b)));
    let mut best: Option<(f64, Finding)> = None;
    for (a, b) in pairs {
        for (third, where_to) in [(LIDAR, "the LiDAR"), (IMU, "the IMU")] {
            let mut other = graph.to_vec();
            let to_third = |e: &&mut GraphEdge| [&e.target, &e.source].iter().any(|n| *n == third);
            let mut renamed = 0;
            for edge in other.iter_mut().filter(to_third) {
                for name in [&mut edge.target, &mut edge.source] {
                    let instead = match name.as_str() {
                        n if n == a => b,
                        n if n == b => a,
                        _ => continue,
                    };
                    *name = instead.to_owned();
                    renamed += 1;
                }
            }
            if renamed < 2 {
                continue;
            }
            let left = adjust(&other)?.cost;
            if left < EXPLAINED * cost && best.as_ref().is_none_or(|b| left < b.0) {
                let what = format!(
                    "{a} and {b} are swapped in the transforms to {where_to}: the loops close if their names are exchanged there"
                );
                let finding = Finding::new("swapped", Verdict::Fail, format!("{a}, {b}"), what);
                let remedy = "check which transform belongs to which sensor";
                best = Some((left, finding.remedy(remedy)));
            }
        }
    }
    Ok(best.map(|b| b.1))
}
