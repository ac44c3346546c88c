//! Frames of a video, decoded by the system's `ffmpeg` as grey images of a size that each says itself (PGM).

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use lsfb_perception::image::MAX_PIXELS;
use lsfb_types::Image;

/// The program.
const FFMPEG: &str = "ffmpeg";
/// Most bytes of a line in the head of an image.
const MOST_HEAD: u64 = 64;

/// How many frames a video holds, without decoding them; why that is not known, in words.
pub(super) fn count_frames(video: &Path) -> Result<u64, String> {
    let output = base(video)
        .args(["-map", "0:v:0", "-c", "copy", "-f", "framecrc", "-"])
        .output()
        .map_err(|e| absent(&e))?;
    if !output.status.success() {
        return Err(refused(video));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let frames = text.lines().filter(|l| !l.starts_with('#'));
    Ok(frames.count() as u64)
}

fn base(video: &Path) -> Command {
    let mut command = Command::new(FFMPEG);
    // The name is a file's, whatever it looks like; pixels stay where the sensor has them.
    let mut name = std::ffi::OsString::from("file:");
    name.push(video);
    command
        .args(["-nostdin", "-v", "error", "-noautorotate", "-i"])
        .arg(name)
        .stdin(Stdio::null())
        .stderr(Stdio::null());
    command
}

fn absent(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => {
            "`ffmpeg` is missing, which decodes the video: install it (apt install ffmpeg), and import again".to_owned()
        }
        _ => format!("ffmpeg cannot be started: {error}"),
    }
}

fn refused(video: &Path) -> String {
    format!(
        "ffmpeg cannot read it: run `ffmpeg -i {} -f null -` for the reason",
        video.display()
    )
}

/// A video that is being decoded, frame by frame.
pub(super) struct Frames {
    child: Child,
    pixels: BufReader<ChildStdout>,
    next: u32,
}

impl Frames {
    /// Starts to decode.
    pub(super) fn open(video: &Path) -> Result<Self, String> {
        let mut child = base(video)
            .args([
                "-map",
                "0:v:0",
                "-fps_mode",
                "passthrough",
                "-pix_fmt",
                "gray",
            ])
            .args(["-c:v", "pgm", "-f", "image2pipe", "-"])
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|e| absent(&e))?;
        let pixels = child.stdout.take().ok_or("ffmpeg has no output")?;
        Ok(Self {
            child,
            pixels: BufReader::new(pixels),
            next: 0,
        })
    }

    /// A frame by its number, which is larger than that of the one before.
    pub(super) fn read(&mut self, number: u32) -> Result<Image, String> {
        if number < self.next {
            return Err(format!(
                "frame {number} has a stamp later than the next one"
            ));
        }
        loop {
            let image = self.decode()?;
            self.next += 1;
            if self.next > number {
                return Ok(image);
            }
        }
    }

    fn decode(&mut self) -> Result<Image, String> {
        let ends = || "the video ends before its stamps".to_owned();
        if self.line()? != "P5" {
            return Err(ends());
        }
        let size = self.line()?;
        let parsed = size.split_once(' ').and_then(|(width, height)| {
            Some((width.parse::<u32>().ok()?, height.parse::<u32>().ok()?))
        });
        let (width, height) = parsed.ok_or_else(ends)?;
        let count = u64::from(width) * u64::from(height);
        if self.line()? != "255" || !(1..=MAX_PIXELS).contains(&count) {
            return Err(format!("a frame of {width} × {height} pixels"));
        }
        let mut pixels = vec![0; count as usize];
        self.pixels.read_exact(&mut pixels).map_err(|_| ends())?;
        Ok(Image {
            width,
            height,
            pixels,
            exposure_ns: 0,
            frame_id: 0,
        })
    }

    fn line(&mut self) -> Result<String, String> {
        let mut line = String::new();
        (&mut self.pixels)
            .take(MOST_HEAD)
            .read_line(&mut line)
            .map_err(|e| format!("ffmpeg: {e}"))?;
        Ok(line.trim_end().to_owned())
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        // It may wait for its output to be read; when it has ended by itself there is nothing to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
