//! `lsfb calib import` and `lsfb calib export`: rigs from and for other programs.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_calib::exchange::{
    Format, ImportedRig, PosesOf, export, implausible, import_basalt, import_camera_info,
    import_colmap, import_kalibr, import_kalibr_imu,
};
use lsfb_geometry::{Rig, RigCamera, Se3};
use lsfb_recording::Provenance;
use lsfb_types::{Finding, Judgement, Verdict};

use super::calib_result::Results;
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::judged::{Judged, printable, problem_lines};
use crate::one_of::one_of;
use crate::outcome::Outcome;

/// Import a rig from files of Kalibr or OpenVINS, ROS or OpenCV, COLMAP, or Basalt.
///
/// Anything that was not understood is listed.
///
/// Examples:
///   lsfb calib import kalibr camchain-imucam.yaml imu.yaml --out rig.toml
///   lsfb calib import kalibr imu.yaml --rig rig.toml --out rig.toml
///   lsfb calib import ros left.yaml right.yaml --rig rig.toml --out rig.toml
///   lsfb calib import colmap cameras.txt rig_config.json --out rig.toml
///   lsfb calib import basalt calibration.json --out rig.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct ImportArguments {
    /// The program whose files these are.
    #[arg(value_parser = one_of(&Format::ALL, Format::key))]
    program: Format,
    /// The files, in the order of the examples.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Rig to put the cameras into; anything that the files do not specify is kept.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// The rig to write; may be the one given with --rig.
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
}

/// Export a rig for Kalibr, ROS, COLMAP or Basalt.
///
/// Examples:
///   lsfb calib export kalibr rig.toml --out kalibr
///   lsfb calib export colmap rig.toml --out colmap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct ExportArguments {
    /// The program to write files for.
    #[arg(value_parser = one_of(&Format::ALL, Format::key))]
    program: Format,
    /// The rig to export.
    #[arg(value_name = "TOML")]
    rig: PathBuf,
    /// Folder to write the files to.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// IMU samples per second, which a rig does not hold.
    #[arg(long, value_name = "HZ", default_value_t = 200.0)]
    imu_rate_hz: f64,
}

/// Reads the files, writes the rig.
pub fn run_import(arguments: &ImportArguments, context: &Context) -> anyhow::Result<Outcome> {
    let results = Results {
        out: &arguments.out,
        transforms: &[],
        others: &[],
        rig: arguments.rig.as_deref(),
        read: arguments.files.iter().map(PathBuf::as_path).collect(),
    };
    results.claim(context)?;
    let ImportedRig {
        rig: found,
        poses,
        notes,
    } = read(arguments)?;
    let of = names_of(&arguments.files);
    let mut findings: Vec<Finding> =
        noted(notes, "imported", &of, "compare the rig with the file").collect();
    let remedy = "check the values in the file, or calibrate again";
    findings.extend(noted(implausible(&found), "implausible", &of, remedy));
    let mut provenance = Provenance::new(&());
    for path in &arguments.files {
        provenance.add_input(path)?;
    }
    let rig = match &arguments.rig {
        Some(path) => {
            provenance.add_input(path)?;
            let mut rig = Rig::read(path)?;
            let put = put(&found, poses, &mut rig)?;
            let remedy = "measure the offset with `lsfb calib camera-imu`";
            findings.extend(noted(put, "clock-offset", &of, remedy));
            if !found.cameras.is_empty() {
                // None of these files says when it was made.
                rig.calibrated_unix_s = None;
            }
            rig
        }
        None => found,
    };
    if let Some(problem) = rig.problem() {
        anyhow::bail!("{}: {problem}", names_of(&arguments.files));
    }
    context.check_stop()?;
    super::write(&arguments.out, rig.to_toml())?;
    provenance.write(&arguments.out)?;
    let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let judgement = or_whole(findings, &of, "all of it was taken over");
    let printed = serde_json::json!({ "cameras": &names });
    context.print(&Judged::new(&judgement, &of, &printed), || {
        let imu = rig.imu_noise().map(|_| "noise of the IMU");
        let held: Vec<&str> = names.iter().copied().chain(imu).collect();
        let text = format!("{}: {}", arguments.out.display(), held.join(", "));
        printable(format!("{text}\n{}", problem_lines(&judgement)).trim_end())
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// What is to be said of files that were read or written, each a finding.
fn noted(
    notes: Vec<String>,
    code: &'static str,
    subject: &str,
    remedy: &'static str,
) -> impl Iterator<Item = Finding> {
    let finding = move |note| Finding::new(code, Verdict::Warn, subject, note).remedy(remedy);
    notes.into_iter().map(finding)
}

/// Where nothing is to be said, that nothing was left out.
fn or_whole(findings: Vec<Finding>, subject: &str, whole: &'static str) -> Judgement {
    Judgement::new(match findings.is_empty() {
        true => vec![Finding::new("whole", Verdict::Pass, subject, whole)],
        false => findings,
    })
}

fn names_of(files: &[PathBuf]) -> String {
    let names: Vec<String> = files.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}

fn text(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

fn read(arguments: &ImportArguments) -> anyhow::Result<ImportedRig> {
    let files = &arguments.files;
    let most = match arguments.program {
        Format::Ros => usize::MAX,
        Format::Basalt => 1,
        Format::Kalibr | Format::Colmap => 2,
    };
    anyhow::ensure!(
        files.len() <= most,
        BadArgument::new(format!(
            "{} files, but at most {most} are expected: see --help for their order",
            files.len()
        ))
    );
    let Some(first) = files.first() else {
        anyhow::bail!("no file was given");
    };
    let name = first.display().to_string();
    let second = files.get(1);
    Ok(match arguments.program {
        Format::Kalibr => {
            let found = read_kalibr(files)?;
            anyhow::ensure!(
                !found.rig.cameras.is_empty() || arguments.rig.is_some(),
                "{name} has no camera: give the rig for this IMU with --rig"
            );
            found
        }
        Format::Colmap => {
            let config = second.map(|p| text(p)).transpose()?;
            import_colmap(&text(first)?, config.as_deref(), &name)?
        }
        Format::Basalt => import_basalt(&text(first)?, &name)?,
        Format::Ros => {
            let mut rig = Rig::empty("ros");
            let mut notes = Vec::new();
            for (k, path) in files.iter().enumerate() {
                let found = import_camera_info(&text(path)?, &path.display().to_string())?;
                notes.extend(found.notes);
                let name = found.name.unwrap_or_else(|| format!("cam{k}"));
                anyhow::ensure!(
                    !rig.cameras.contains_key(&name),
                    "{}: a second camera named {name}",
                    path.display()
                );
                let mounted = RigCamera {
                    camera: found.camera,
                    rig_from_camera: Se3::identity(),
                    timing: Default::default(),
                    sigmas: Default::default(),
                };
                rig.cameras.insert(name, mounted);
            }
            if arguments.rig.is_none() {
                notes.push("CameraInfo has no poses: all cameras are put at the origin".to_owned());
            }
            ImportedRig {
                rig,
                poses: PosesOf::Nothing,
                notes,
            }
        }
    })
}

/// A camera chain, the noise of an IMU, or both in either order.
fn read_kalibr(files: &[PathBuf]) -> anyhow::Result<ImportedRig> {
    let mut rig = Rig::empty("kalibr");
    let mut poses = PosesOf::Imu;
    let mut notes = Vec::new();
    for path in files {
        let (text, name) = (text(path)?, path.display().to_string());
        if text.contains("noise_density") {
            anyhow::ensure!(rig.imus.is_empty(), "{name}: a second IMU");
            let found = import_kalibr_imu(&text, &name)?;
            rig.set_imu_noise(found.noise);
            notes.extend(found.notes);
        } else {
            anyhow::ensure!(rig.cameras.is_empty(), "{name}: a second camera chain");
            let found = import_kalibr(&text, &name)?;
            rig.cameras = found.rig.cameras;
            poses = found.poses;
            notes.extend(found.notes);
        }
    }
    Ok(ImportedRig { rig, poses, notes })
}

/// What was read put into a rig, with what is to be said of it. Where poses are those of cameras to each other, the first camera that
/// the rig has too keeps its own and the others follow; without one they cannot be placed.
fn put(found: &Rig, poses: PosesOf, rig: &mut Rig) -> anyhow::Result<Vec<String>> {
    let mut notes = Vec::new();
    let rig_from_origin = found.cameras.iter().find_map(|(name, c)| {
        Some(rig.cameras.get(name)?.rig_from_camera * c.rig_from_camera.inverse())
    });
    for (name, camera) in &found.cameras {
        let before = rig.cameras.get(name).cloned();
        let pose = match (poses, &before, rig_from_origin) {
            (PosesOf::Imu, ..) => camera.rig_from_camera,
            (PosesOf::FirstCamera, _, Some(rig_from_origin)) => {
                rig_from_origin * camera.rig_from_camera
            }
            (PosesOf::Nothing, Some(before), _) => before.rig_from_camera,
            _ => anyhow::bail!(
                "the pose of {name} on the rig is unknown; the rig has {}: give the cameras these names",
                rig.cameras.keys().cloned().collect::<Vec<_>>().join(", ")
            ),
        };
        // Clocks are those of the IMU.
        let timing = match (poses, before) {
            (PosesOf::FirstCamera | PosesOf::Nothing, Some(before)) => before.timing,
            (PosesOf::FirstCamera, None) => {
                notes.push(format!(
                    "{name}: the offset between its clock and the IMU's is unknown: zero is assumed"
                ));
                camera.timing
            }
            _ => camera.timing,
        };
        rig.cameras.insert(
            name.clone(),
            RigCamera {
                camera: camera.camera,
                rig_from_camera: pose,
                timing,
                sigmas: Default::default(),
            },
        );
    }
    if found.imu().is_some() {
        rig.imus.clone_from(&found.imus);
    }
    Ok(notes)
}

/// Writes the files.
pub fn run_export(arguments: &ExportArguments, context: &Context) -> anyhow::Result<Outcome> {
    let rig = Rig::read(&arguments.rig)?;
    let exported = export(&rig, arguments.program, arguments.imu_rate_hz);
    let exported = exported.map_err(|error| match error {
        // The rate is the one setting of an export.
        lsfb_calib::Error::Setting(error) => BadArgument::of_option(&error, &[]).into(),
        error => anyhow::Error::new(error),
    })?;
    let files = exported.files.iter();
    let paths: Vec<PathBuf> = files.map(|f| arguments.out.join(&f.name)).collect();
    paths
        .iter()
        .try_for_each(|path| context.claim(path, &[&arguments.rig]))?;
    context.check_stop()?;
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    for (path, file) in paths.iter().zip(&exported.files) {
        super::write(path, &file.text)?;
    }
    let of = arguments.rig.display().to_string();
    let findings = noted(exported.notes, "exported", &of, "");
    let judgement = or_whole(findings.collect(), &of, "all of it is in the files");
    let printed = serde_json::json!({ "files": &paths });
    context.print(&Judged::new(&judgement, &of, &printed), || {
        let mut text = String::new();
        for path in &paths {
            text += &format!("{}\n", path.display());
        }
        printable(format!("{text}{}", problem_lines(&judgement)).trim_end())
    })?;
    Ok(Outcome::of(judgement.verdict()))
}
