//! A map of posed images: built unless it stands, written, and what is to be said of it.

use std::path::Path;

use lsfb_eval::report::{Figure, Report};
use lsfb_pipeline::hd_map::{
    HdMap, PosedMapConfig, PosedMapReport, build_map_from_posed_images_in_stages,
};
use lsfb_pipeline::posed_images::PosedImages;
use lsfb_recording::Provenance;
use lsfb_types::{Finding, Verdict};
use serde::{Deserialize, Serialize};

use super::map_coverage::Coverage;
use super::map_report::by_camera;
use crate::context::Context;
use crate::standing;

/// A map to be built of posed images.
pub struct PosedMapJob<'a> {
    pub folder: &'a Path,
    /// Every so many images are left out; none for 0.
    pub holdout_every: u32,
    pub out: &'a Path,
    pub out_report: Option<&'a Path>,
    pub config: &'a PosedMapConfig,
}

/// A map that was written.
pub struct WrittenPosedMap {
    pub map: HdMap,
    pub report: PosedMapReport,
    pub findings: Vec<Finding>,
}

/// What is said of a map that stands.
#[derive(Serialize, Deserialize)]
struct Said {
    report: PosedMapReport,
}

impl PosedMapJob<'_> {
    /// Builds the map and writes it, its page and where both come from, unless they stand.
    pub fn build(&self, context: &Context) -> anyhow::Result<WrittenPosedMap> {
        crate::files::expect_file(self.folder, "give a folder of posed images")?;
        let outputs: Vec<&Path> = [Some(self.out), self.out_report]
            .into_iter()
            .flatten()
            .collect();
        let posed = PosedImages::read(self.folder)?.without_every(self.holdout_every as usize);
        let provenance = self.provenance(&posed)?;
        if let Some(Said { report }) = context.standing(&outputs, &provenance) {
            let map = super::open_map(self.out)?;
            return Ok(WrittenPosedMap {
                findings: findings(&map, &posed),
                map,
                report,
            });
        }
        outputs
            .iter()
            .try_for_each(|result| context.claim(result, &[]))?;
        let stages = context.kept_stages(self.out, &provenance)?;
        let built = stages.kept_if_stopped(build_map_from_posed_images_in_stages(
            &posed,
            self.config,
            &stages,
            &|p| context.show(p),
        ))?;
        let (map, report) = (built.map, built.report);
        standing::forget(&outputs)?;
        map.write(self.out)?;
        let failures = map.failures().to_vec();
        provenance.with_failures(failures).write(self.out)?;
        let findings = findings(&map, &posed);
        if let Some(path) = self.out_report {
            crate::files::write(path, self.page(&map, &report, &findings, &provenance))?;
            provenance.write(path)?;
        }
        let said = Said { report };
        standing::finish(&outputs, &[], &provenance, &said)?;
        stages.remove()?;
        Ok(WrittenPosedMap {
            map,
            report: said.report,
            findings,
        })
    }

    /// Where the map comes from: the images are one input, with their poses and cameras.
    fn provenance(&self, posed: &PosedImages) -> anyhow::Result<Provenance> {
        let mut provenance = Provenance::new(self.config);
        let name = match crate::files::name_of(self.folder) {
            none if none.is_empty() => "images".to_owned(),
            name => name,
        };
        let hash = posed.content_hash()?;
        provenance.inputs.insert(name, hash);
        provenance.add_rig(&posed.rig);
        Ok(provenance)
    }

    fn page(
        &self,
        map: &HdMap,
        report: &PosedMapReport,
        findings: &[Finding],
        made_from: &Provenance,
    ) -> String {
        let coverage = Coverage::of(map);
        let px = |name: &str, px: f64| Figure::new(name, px, "px");
        let listed = report.as_listed.iter().flat_map(|listed| {
            [
                px(
                    "reprojection with the cameras and poses given, rms",
                    listed.reprojection_rms_px,
                ),
                px(
                    "reprojection with the cameras and poses given, median",
                    listed.reprojection_median_px,
                ),
            ]
        });
        let own = [
            px("reprojection, rms", report.reprojection_rms_px),
            px("reprojection, median", report.reprojection_median_px),
        ];
        let content = coverage.figures(report.dropped_observations, report.outlier_share);
        Report {
            title: format!("Map of {}", self.folder.display()),
            figures: listed.chain(own).chain(content).collect(),
            tables: vec![by_camera(&report.by_camera)],
            map_points: map.positions().collect(),
            tracks: coverage.tracks("cameras"),
            histograms: coverage.histograms(report.reprojection_errors_px.iter().copied()),
            findings: findings.to_vec(),
            introduction: "Lengths are in the unit of the poses given.".to_owned(),
            provenance: crate::pages::settings(made_from),
            ..Report::default()
        }
        .to_html()
    }
}

/// Everything that was looked at, good or not.
fn findings(map: &HdMap, posed: &PosedImages) -> Vec<Finding> {
    let mut findings = vec![Coverage::of(map).finding()];
    findings.extend(posed.notes.iter().map(|note| {
        Finding::new("images-left-out", Verdict::Warn, "images", note.clone())
            .remedy("give the poses of all images")
    }));
    findings.extend(cameras(map));
    findings.extend(map.failures().iter().map(|what| {
        Finding::new("poses-contradicted", Verdict::Fail, "poses", what.clone())
            .remedy("give each image its own pose, in the convention of its layout")
    }));
    findings
}

/// Cameras that the images showed to be other than the list says.
fn cameras(map: &HdMap) -> Vec<Finding> {
    let stated = map.stated_cameras().iter();
    let found = stated.filter_map(|(name, stated)| {
        let found = map.rig().cameras.get(name)?;
        let [stated_px, found_px] = [stated, found].map(|c| c.camera.focal_px()[0]);
        let moved = found.rig_from_camera.inverse() * stated.rig_from_camera;
        let what = format!(
            "its focal length is {found_px:.1} px according to the images, {stated_px:.1} px \
             according to the list; rotated by {:.2}°, shifted by {:.3} (in the unit of the poses): \
             the map uses the values from the images",
            moved.rotation.angle().to_degrees(),
            moved.translation.norm()
        );
        let finding = Finding::new("camera-differs", Verdict::Warn, name, what)
            .value(100.0 * (found_px / stated_px - 1.0), "%")
            .remedy("calibrate it; refine_cameras = false in --config uses the values of the list");
        Some(finding)
    });
    found.collect()
}
