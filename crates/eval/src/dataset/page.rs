//! A dataset on one page: maps with all walks in them, estimates against the truth, tables, and what cannot be true.

use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_report::{Page, scroll};
use lsfb_types::Judgement;
use maud::{Markup, html};

use super::description::Description;
use super::plan::Device;
use super::sequence::SequenceFigures;
use super::tables::{cameras_table, environments_table, motion_classes_table, motions_table};
use crate::Evaluation;
use crate::report::{Inset, Report, Track, errors_section, from_above_section};

/// An environment with all walks in it, as Fig. 1 of the paper shows it.
#[derive(Clone, Debug, Default)]
pub struct EnvironmentView {
    /// Its title.
    pub title: String,
    /// What the scanner saw, in the world of the truth, metres.
    pub map_points: Vec<Vector3<f64>>,
    /// Walks, where their truth is there: device, name, poses.
    pub walks: Vec<(Device, String, Vec<StampedPose>)>,
    /// Squares that are drawn again, larger: middle and side, metres; where none are said, those where most walks pass.
    pub insets: Vec<([f64; 2], f64)>,
}

/// An estimate of a sequence against its truth, as Figs. 5 and 7 show it.
#[derive(Clone, Debug)]
pub struct EstimateView {
    /// The sequence.
    pub sequence: String,
    /// What was judged.
    pub evaluation: Evaluation,
    /// The truth.
    pub truth: Vec<StampedPose>,
}

/// All that the page shows.
#[derive(Clone, Debug, Default)]
pub struct DatasetViews {
    /// Maps.
    pub environments: Vec<EnvironmentView>,
    /// Estimates.
    pub estimates: Vec<EstimateView>,
}

impl DatasetViews {
    /// The page.
    pub fn page(
        &self,
        description: &Description,
        measured: &[SequenceFigures],
        judgement: &Judgement,
    ) -> Page {
        let tables = [
            ("Cameras", cameras_table(measured)),
            ("Environments", environments_table(description)),
            ("Motions", motions_table(description, measured)),
            ("Measured motions", motion_classes_table(measured)),
        ];
        let body = html! {
            @for own in &self.environments {
                h2 { (own.title) }
                (from_above_section(&own.report()))
            }
            @for own in &self.estimates { (own.section()) }
            @for (title, table) in tables.iter().filter(|(_, table)| !table.is_empty()) {
                section { h2 { (title) } (scroll(&html! { pre { (table) } })) }
            }
        };
        let what = format!("{} sequences", measured.len());
        Page::new(description.title.clone())
            .judged(judgement, &what)
            .body(body)
    }

    /// The same maps and estimates as drawings for papers: a name, and SVG.
    pub fn drawings(&self) -> Vec<(String, String)> {
        let of_places = self
            .environments
            .iter()
            .map(|own| (own.title.clone(), own.report()));
        let of_estimates = self
            .estimates
            .iter()
            .map(|own| (own.sequence.clone(), own.report()));
        let all = of_places.chain(of_estimates);
        let drawn = all.flat_map(|(name, report)| {
            let whole = report.above_svg().map(|svg| (name.clone(), svg));
            let insets = report.inset_svgs().into_iter();
            let insets = insets.map(move |(inset, svg)| (format!("{name} {inset}"), svg));
            whole.into_iter().chain(insets)
        });
        drawn.collect()
    }
}

impl EnvironmentView {
    fn report(&self) -> Report {
        let tracks = self.walks.iter().map(|(device, _, poses)| Track {
            name: device.name().to_owned(),
            series: Some(*device as usize),
            estimate: Trajectory::new(poses.clone()),
            truth: None,
            errors: Vec::new(),
        });
        let tracks: Vec<Track> = tracks.collect();
        Report {
            map_points: self.map_points.clone(),
            insets: match self.insets.is_empty() {
                true => Inset::chosen(&tracks),
                false => Inset::named(self.insets.iter().copied()),
            },
            tracks,
            ..Report::default()
        }
    }
}

impl EstimateView {
    fn report(&self) -> Report {
        let truth = Trajectory::new(self.truth.clone());
        Report {
            tracks: vec![Track::of(&self.sequence, &self.evaluation, &truth)],
            ..Report::default()
        }
    }

    fn section(&self) -> Markup {
        let ate = &self.evaluation.ate_translation_m;
        let report = self.report();
        html! {
            h2 { (self.sequence) " vs. its truth: ATE rms " (format!("{:.3} m, at most {:.3} m", ate.rmse, ate.max)) }
            div.pair { (from_above_section(&report)) (errors_section(&report)) }
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Se3;
    use lsfb_types::Timestamp;

    use super::*;

    #[test]
    fn every_walk_is_drawn_in_the_colour_of_its_device() {
        let walk = |y: f64| -> Vec<StampedPose> {
            (0..20)
                .map(|i| StampedPose {
                    time: Timestamp::from_secs_f64(f64::from(i)),
                    world_from_rig: Se3::new(
                        Default::default(),
                        Vector3::new(f64::from(i), y, 0.0),
                    ),
                })
                .collect()
        };
        let view = EnvironmentView {
            title: "Hall <1>".to_owned(),
            map_points: vec![Vector3::new(0.0, 0.0, 0.0), Vector3::new(19.0, 9.0, 2.0)],
            walks: vec![
                (Device::Glasses, "E0-glasses".to_owned(), walk(1.0)),
                (Device::Glasses, "E1-glasses".to_owned(), walk(2.0)),
                (Device::Android, "E0-android".to_owned(), walk(3.0)),
            ],
            insets: vec![([10.0, 2.0], 1.0)],
        };
        let views = DatasetViews {
            environments: vec![view],
            estimates: Vec::new(),
        };
        let description = Description::new("test", 30.0, 100.0);
        let page = views.page(&description, &[], &Judgement::new(Vec::new()));
        let page = page.to_html();
        assert!(page.contains("Hall &lt;1&gt;"), "{page}");
        // Each device stands in the legend once.
        let keys = |name: &str| page.matches(&format!("</span>{name}</span>")).count();
        assert_eq!(
            (keys("glasses"), keys("android"), keys("iphone")),
            (1, 1, 0)
        );
        let drawings = views.drawings();
        let [(name, svg), (inset, detail)] = &drawings[..] else {
            panic!("{drawings:?}")
        };
        assert_eq!(
            (name.as_str(), inset.as_str()),
            ("Hall <1>", "Hall <1> (b)")
        );
        // Marked and named in the whole; in the inset, of three walks the one that passes there.
        assert!(svg.contains("stroke-dasharray") && svg.contains("(b)"));
        assert!(
            svg.starts_with("<svg xmlns=") && !svg.contains("var(--"),
            "{svg}"
        );
        // Light blue is the first colour, green the third.
        let lines = |ink: &str| svg.matches(&format!("stroke=\"{ink}\"")).count();
        assert_eq!(
            (lines("#0a66c2"), lines("#d9480f"), lines("#2b8a3e")),
            (1, 0, 2),
            "{svg}"
        );
        let lines = |ink: &str| detail.matches(&format!("stroke=\"{ink}\"")).count();
        assert_eq!((lines("#0a66c2"), lines("#2b8a3e")), (0, 1), "{detail}");
    }
}
