//! The images of a folder that are to be localized, and their cameras, by the layout that the folder has.

use std::path::Path;

use anyhow::Context as _;
use lsfb_datasets::import::{EurocImages, euroc_images};
use lsfb_geometry::Rig;
use lsfb_pipeline::posed_images::{ImageLayout, QueryImage, UnposedImages};

use super::Arguments;
use crate::context::Context;

/// As messages call a recording of EuRoC or TUM-VI.
const EUROC: &str = "EuRoC (cam0/data.csv)";

/// The images of a folder, none of them with a pose.
pub struct FolderImages {
    pub rig: Rig,
    pub images: Vec<QueryImage>,
}

/// What a folder lists, before it is known which rig counts.
struct Listed {
    /// `None` where the folder has no intrinsics.
    rig: Option<Rig>,
    /// Whether its names of cameras may be those of a rig.
    names_cameras: bool,
    images: Vec<QueryImage>,
    notes: Vec<String>,
}

/// Reads the folder; refuses one that has several layouts, and images whose camera is not known.
pub fn read(
    folder: &Path,
    arguments: &Arguments,
    context: &Context,
) -> anyhow::Result<FolderImages> {
    let mut layouts = ImageLayout::found_in(folder)?;
    if arguments.rig.is_some() {
        // The rig is given instead of K.txt.
        layouts.retain(|layout| *layout != ImageLayout::Pinhole);
    }
    let euroc = euroc_images(folder, &|p| context.show(p))?;
    let listed = match (&layouts[..], euroc) {
        ([], None) => plain(folder, arguments)?,
        ([], Some(euroc)) => of_euroc(euroc),
        ([layout], None) => of_layout(folder, *layout)?,
        (several, euroc) => {
            let names = several.iter().map(|layout| layout.name());
            let names: Vec<&str> = names.chain(euroc.map(|_| EUROC)).collect();
            anyhow::bail!(
                "{}: this may be {}: name the image folder and pass --rig",
                folder.display(),
                names.join(" or ")
            );
        }
    };
    for note in &listed.notes {
        context.say(&format!("warning: {}: {note}", folder.display()));
    }
    let with_cameras = match &arguments.rig {
        Some(rig) => with_rig(listed, Rig::read(rig)?, arguments.camera.as_deref()),
        None => with_own_rig(listed),
    };
    let mut found = with_cameras.with_context(|| folder.display().to_string())?;
    let nth = arguments.every as usize;
    found.images = found
        .images
        .into_iter()
        .skip(nth - 1)
        .step_by(nth)
        .collect();
    Ok(found)
}

/// Image files and nothing else.
fn plain(folder: &Path, arguments: &Arguments) -> anyhow::Result<Listed> {
    let files = crate::files::image_files(folder)?;
    if files.is_empty() {
        let layouts = ImageLayout::ALL.map(ImageLayout::name).join(", ");
        anyhow::bail!(
            "{}: no .png, .jpg or .jpeg file here: name the folder that holds the images, or one in a supported layout: {layouts}, {EUROC}",
            folder.display()
        );
    }
    anyhow::ensure!(
        arguments.rig.is_some(),
        "{}: a folder of images needs the intrinsics of its camera: --rig, or K.txt in it",
        folder.display()
    );
    let images = files.into_iter().map(|path| QueryImage {
        path,
        camera: String::new(),
    });
    Ok(Listed {
        rig: None,
        names_cameras: false,
        images: images.collect(),
        notes: Vec::new(),
    })
}

fn of_euroc(found: EurocImages) -> Listed {
    let images = found.images.into_iter().map(|image| QueryImage {
        path: image.path,
        camera: image.camera,
    });
    Listed {
        rig: found.rig,
        names_cameras: true,
        images: images.collect(),
        notes: found.notes,
    }
}

fn of_layout(folder: &Path, layout: ImageLayout) -> anyhow::Result<Listed> {
    let found = UnposedImages::read(folder, layout)?;
    Ok(Listed {
        rig: Some(found.rig),
        names_cameras: layout.names_cameras(),
        images: found.images,
        notes: found.notes,
    })
}

/// By the intrinsics in the folder.
fn with_own_rig(listed: Listed) -> anyhow::Result<FolderImages> {
    let rig = listed
        .rig
        .context("the intrinsics of its cameras (sensor.yaml) are missing: give them with --rig")?;
    for image in &listed.images {
        anyhow::ensure!(
            rig.cameras.contains_key(&image.camera),
            "{} has no intrinsics (sensor.yaml): give all cameras with --rig",
            image.camera
        );
    }
    Ok(FolderImages {
        rig,
        images: listed.images,
    })
}

/// By a rig instead: its cameras by their names, where the folder names its own, or the one that took all images.
fn with_rig(listed: Listed, rig: Rig, named: Option<&str>) -> anyhow::Result<FolderImages> {
    let mut images = listed.images;
    let is_there = |image: &QueryImage| rig.cameras.contains_key(&image.camera);
    if named.is_none() && listed.names_cameras && images.iter().all(is_there) {
        return Ok(FolderImages { rig, images });
    }
    let first = images.first().map(|image| image.camera.clone());
    if let Some(other) = images.iter().find(|i| Some(&i.camera) != first.as_ref()) {
        anyhow::bail!(
            "its images are of {}, {} and perhaps more, but rig {} does not have all of them by these names: name the folder of one camera's images",
            first.unwrap_or_default(),
            other.camera,
            rig.name
        );
    }
    let camera = camera_of(&rig, named)?;
    for image in &mut images {
        image.camera.clone_from(&camera);
    }
    Ok(FolderImages { rig, images })
}

fn camera_of(rig: &Rig, named: Option<&str>) -> anyhow::Result<String> {
    let cameras: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    match (named, &cameras[..]) {
        (None, [only]) => Ok((*only).to_owned()),
        (Some(name), _) if cameras.contains(&name) => Ok(name.to_owned()),
        _ => anyhow::bail!(
            "rig {} has the cameras {}: name the one that took the images with --camera",
            rig.name,
            cameras.join(", ")
        ),
    }
}
