//! What must not be seen in exported images: faces, number plates, screens.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use lsfb_types::{Image, Stamped, Timestamp};

use crate::Error;

/// A list is written by a program that finds faces, or by hand.
const MAX_BYTES: u64 = 256 << 20;

/// Regions of images that are filled with their own mean grey: nothing of what was there is left.
#[derive(Debug, Default)]
pub struct HiddenRegions {
    path: PathBuf,
    regions: Vec<Region>,
}

/// One rectangle of one camera for a while.
#[derive(Debug)]
struct Region {
    /// Line of the list.
    line: usize,
    camera: String,
    /// From and to, both included; all the time without.
    during: Option<[Timestamp; 2]>,
    from_px: [u32; 2],
    size_px: [u32; 2],
    /// Images in which it was filled.
    images: Cell<u64>,
}

impl HiddenRegions {
    /// Reads a text file: on each line camera, first and last second (or `- -` for all), and x, y, width, height in pixels; `#` begins a
    /// comment.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        if std::fs::metadata(path).map_err(io)?.len() > MAX_BYTES {
            return Err(Error::NotATrajectory {
                path: path.to_owned(),
                what: "too large for a list of regions".to_owned(),
            });
        }
        let text = std::fs::read_to_string(path).map_err(io)?;
        let mut regions = Vec::new();
        for (line, text) in (1..).zip(text.lines()) {
            let text = text.split('#').next().unwrap_or_default().trim();
            if text.is_empty() {
                continue;
            }
            let region = Region::parse(line, text).ok_or_else(|| Error::BadLine {
                path: path.to_owned(),
                line,
                what: "expected CAMERA FROM_S TO_S X Y WIDTH HEIGHT, or - - for all times"
                    .to_owned(),
            })?;
            regions.push(region);
        }
        Ok(Self {
            path: path.to_owned(),
            regions,
        })
    }

    /// The image of a camera, its topic, without what must not be seen.
    pub fn hide(&self, camera: &str, image: &Stamped<Image>) -> Image {
        let mut shown = image.sample.clone();
        for region in &self.regions {
            if region.is_of(camera, image.time) && fill(&mut shown, region) {
                region.images.set(region.images.get() + 1);
            }
        }
        shown
    }

    /// Fails where a region is in no image: a camera that is called otherwise, stamps of another clock.
    pub fn expect_used(&self) -> Result<(), Error> {
        match self.regions.iter().find(|region| region.images.get() == 0) {
            None => Ok(()),
            Some(region) => Err(Error::BadLine {
                path: self.path.clone(),
                line: region.line,
                what: "the region is in no image: check camera, times and pixels".to_owned(),
            }),
        }
    }
}

impl Region {
    fn parse(line: usize, text: &str) -> Option<Self> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let [camera, from, to, numbers @ ..] = &words[..] else {
            return None;
        };
        let numbers: Vec<u32> = numbers
            .iter()
            .map(|w| w.parse().ok())
            .collect::<Option<_>>()?;
        let [x, y, width, height] = numbers[..] else {
            return None;
        };
        let during = match (*from, *to) {
            ("-", "-") => None,
            (from, to) => {
                let secs = |text: &str| text.parse().ok().filter(|s: &f64| s.is_finite());
                let (from, to) = (secs(from)?, secs(to)?);
                if from > to {
                    return None;
                }
                Some([from, to].map(Timestamp::from_secs_f64))
            }
        };
        (width > 0 && height > 0).then(|| Self {
            line,
            camera: (*camera).to_owned(),
            during,
            from_px: [x, y],
            size_px: [width, height],
            images: Cell::new(0),
        })
    }

    fn is_of(&self, topic: &str, time: Timestamp) -> bool {
        let is_named = self.camera == topic || self.camera == super::camera_name(topic);
        is_named
            && self
                .during
                .is_none_or(|[from, to]| (from..=to).contains(&time))
    }
}

/// Whether any pixel was filled.
fn fill(image: &mut Image, region: &Region) -> bool {
    let [x, y] = region.from_px;
    let [width, height] = region.size_px;
    let (right, below) = (
        x.saturating_add(width).min(image.width),
        y.saturating_add(height).min(image.height),
    );
    let row_px = image.width as usize;
    let rows = |y: u32| y as usize * row_px + x as usize..y as usize * row_px + right as usize;
    let (mut sum, mut count) = (0_u64, 0_u64);
    for row in (y..below).filter(|_| x < right) {
        let pixels = image.pixels.get(rows(row)).unwrap_or_default();
        sum += pixels.iter().map(|p| u64::from(*p)).sum::<u64>();
        count += pixels.len() as u64;
    }
    let mean = (sum / count.max(1)) as u8;
    for row in (y..below).filter(|_| x < right) {
        if let Some(pixels) = image.pixels.get_mut(rows(row)) {
            pixels.fill(mean);
        }
    }
    count > 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(secs: f64) -> Stamped<Image> {
        let time = Timestamp::from_secs_f64(secs);
        Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: Image {
                width: 4,
                height: 2,
                pixels: vec![0, 10, 20, 30, 40, 50, 60, 70],
                exposure_ns: 0,
                frame_id: 0,
            },
        }
    }

    fn regions(text: &str) -> Result<HiddenRegions, Error> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("regions.txt");
        std::fs::write(&path, text).expect("file");
        HiddenRegions::read(&path)
    }

    #[test]
    fn what_is_hidden_is_gone_and_the_rest_is_there() {
        let hidden =
            regions("# faces\ncam0 - - 1 0 2 2\ncam0 5 6 3 1 9 9 # at the border\n").expect("list");
        let shown = hidden.hide("/sidecar/glasses/cam0/image", &image(1.0));
        assert_eq!(shown.pixels, [0, 35, 35, 30, 40, 35, 35, 70]);
        assert!(hidden.expect_used().is_err(), "the second was never there");
        let shown = hidden.hide("cam0", &image(6.0));
        assert_eq!(shown.pixels, [0, 35, 35, 30, 40, 35, 35, 70]);
        hidden.expect_used().expect("both");
        assert_eq!(
            hidden.hide("cam1", &image(1.0)).pixels,
            image(1.0).sample.pixels
        );
    }

    /// A face that is not hidden because of a slip of the pen is worse than no export.
    #[test]
    fn a_region_that_hides_nothing_is_refused() {
        for text in [
            "cam7 - - 0 0 2 2",
            "cam0 - - 4 0 2 2",
            "cam0 100 200 0 0 2 2",
        ] {
            let hidden = regions(text).expect("list");
            hidden.hide("cam0", &image(1.0));
            assert!(hidden.expect_used().is_err(), "{text}");
        }
        for text in [
            "cam0 - - 0 0 2",
            "cam0 - - 0 0 0 2",
            "cam0 2 1 0 0 1 1",
            "cam0 a b 0 0 1 1",
        ] {
            assert!(regions(text).is_err(), "{text}");
        }
    }
}
