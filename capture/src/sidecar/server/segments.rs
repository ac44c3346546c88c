//! Bulk that follows later: pieces of a device's own recording, by PUT. To send one twice changes nothing.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use http_body_util::BodyExt as _;
use hyper::body::Incoming;
use hyper::header::{CONTENT_LENGTH, HeaderValue};
use hyper::{Request, StatusCode};
use lsfb_drivers::sidecar::wire::is_name;
use lsfb_recording::Recording;
use lsfb_web::{Answer, json_of, said};
use serde_json::json;
use sha2::{Digest as _, Sha256};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use super::Visit;
use crate::recorder::free_bytes_of;

/// Longest segment, bytes.
const MAX_SEGMENT_BYTES: u64 = 64 << 20;
/// Highest number of a segment.
const MAX_NUMBER: u32 = 99_999;
/// What must stay free on the disk for the recording itself, bytes.
const RESERVE_BYTES: u64 = 2 << 30;
/// Longest pause within a body.
const PAUSE: Duration = Duration::from_secs(15);

/// How far a session has got: the last message that is stored, and the segments.
pub(super) async fn session(visit: &Visit, device: &str, session: &str) -> Answer {
    let Some(folder) = folder_of(visit, device, session) else {
        return said(StatusCode::NOT_FOUND, "no such session");
    };
    let recorded = visit.shared.recording.borrow().clone();
    let stored = recorded.and_then(|recorded| recorded.sessions.stored(device, session));
    let listed = spawn_blocking(move || {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let numbers = entries.filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            name.strip_suffix(".mcap")?.parse().ok()
        });
        let mut numbers: Vec<u32> = numbers.collect();
        numbers.sort_unstable();
        numbers
    });
    let segments = listed.await.unwrap_or_default();
    json_of(
        StatusCode::OK,
        json!({ "stored": stored, "segments": segments }).to_string(),
    )
}

/// Takes a segment: 201, or 200 where the same is there already, 409 where another is.
pub(super) async fn put(
    request: Request<Incoming>,
    visit: &Visit,
    device: &str,
    session: &str,
    number: &str,
) -> Answer {
    if visit.shared.pseudonyms.is_some() {
        visit.shared.refusals.count("segment with identifiers");
        return said(
            StatusCode::FORBIDDEN,
            "identifiers are hashed here, but the segment contains them in plain form",
        );
    }
    let number = number.parse::<u32>().ok().filter(|n| *n <= MAX_NUMBER);
    let (Some(folder), Some(number)) = (folder_of(visit, device, session), number) else {
        return said(StatusCode::NOT_FOUND, "no such session or segment");
    };
    let header = |name: &str| -> Option<&str> { request.headers().get(name)?.to_str().ok() };
    let length = header(CONTENT_LENGTH.as_str()).and_then(|text| text.parse::<u64>().ok());
    let Some(length) = length else {
        return said(StatusCode::LENGTH_REQUIRED, "Content-Length is required");
    };
    let digest = header("digest")
        .and_then(|text| STANDARD.decode(text.strip_prefix("sha-256=")?).ok())
        .filter(|digest| digest.len() == 32);
    let Some(digest) = digest else {
        return said(
            StatusCode::BAD_REQUEST,
            "Digest: sha-256=BASE64 is required",
        );
    };
    if length > MAX_SEGMENT_BYTES {
        visit.shared.refusals.count("segment too long");
        return said(
            StatusCode::PAYLOAD_TOO_LARGE,
            "a segment may have at most 64 MiB",
        );
    }
    let segment = Segment {
        path: folder.join(format!("{number}.mcap")),
        unfinished: folder.join(format!("{number}-{}.part", visit.connection)),
        digest,
    };
    let received = receive(request.into_body(), &folder, &segment, length).await;
    let answer = match received {
        Ok(()) => {
            let stored = segment.clone();
            let keeping = spawn_blocking(move || stored.keep());
            keeping.await.unwrap_or(Err(Problem::Disk))
        }
        Err(problem) => Err(problem),
    };
    // Where it was kept it is there under its name.
    let _ = std::fs::remove_file(&segment.unfinished);
    match answer {
        Ok(status) => said(status, "stored"),
        Err(problem) => {
            visit.shared.refusals.count(problem.words());
            let mut answer = said(problem.status(), problem.words());
            // What is left of the body is not read.
            let close = HeaderValue::from_static("close");
            answer
                .headers_mut()
                .insert(hyper::header::CONNECTION, close);
            answer
        }
    }
}

/// Where a session's segments lie: beside the recording.
fn folder_of(visit: &Visit, device: &str, session: &str) -> Option<PathBuf> {
    let recorded = visit.shared.recording.borrow().clone()?;
    if !is_name(session) {
        return None;
    }
    let base = recorded
        .sessions
        .place()
        .recording
        .with_extension("segments");
    Some(base.join(device).join(session))
}

#[derive(Clone, Copy, Debug)]
enum Problem {
    Digest,
    Length,
    Slow,
    Full,
    Disk,
    NoRecording,
    Other,
}

impl Problem {
    fn words(self) -> &'static str {
        match self {
            Self::Digest => "segment does not match its digest",
            Self::Length => "segment does not match its length",
            Self::Slow => "segment came too slowly",
            Self::Full => "no disk space for a segment",
            Self::Disk => "segment could not be written",
            Self::NoRecording => "segment is not a complete MCAP file of the profile ros2",
            Self::Other => "another segment has this number",
        }
    }

    fn status(self) -> StatusCode {
        match self {
            Self::Digest | Self::Length => StatusCode::BAD_REQUEST,
            Self::Slow => StatusCode::REQUEST_TIMEOUT,
            Self::Full => StatusCode::INSUFFICIENT_STORAGE,
            Self::Disk => StatusCode::INTERNAL_SERVER_ERROR,
            Self::NoRecording => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Other => StatusCode::CONFLICT,
        }
    }
}

/// A segment on its way.
#[derive(Clone, Debug)]
struct Segment {
    path: PathBuf,
    unfinished: PathBuf,
    digest: Vec<u8>,
}

/// Reads a body into the unfinished file.
async fn receive(
    mut body: Incoming,
    folder: &Path,
    segment: &Segment,
    length: u64,
) -> Result<(), Problem> {
    let (folder, path) = (folder.to_owned(), segment.unfinished.clone());
    let opened = spawn_blocking(move || {
        DirBuilder::new()
            .recursive(true)
            .mode(0o755)
            .create(&folder)
            .map_err(|_| Problem::Disk)?;
        if free_bytes_of(std::slice::from_ref(&folder), RESERVE_BYTES) < length {
            return Err(Problem::Full);
        }
        create(&path).map_err(|_| Problem::Disk)
    });
    let mut file = opened.await.unwrap_or(Err(Problem::Disk))?;
    let mut hash = Sha256::new();
    let mut received = 0;
    while let Some(frame) = timeout(PAUSE, body.frame())
        .await
        .map_err(|_| Problem::Slow)?
    {
        let frame = frame.map_err(|_| Problem::Length)?;
        let Ok(bytes) = frame.into_data() else {
            continue;
        };
        received += bytes.len() as u64;
        if received > length {
            return Err(Problem::Length);
        }
        hash.update(&bytes);
        let written = spawn_blocking(move || file.write_all(&bytes).map(|()| file));
        file = match written.await {
            Ok(Ok(file)) => file,
            _ => return Err(Problem::Disk),
        };
    }
    if received != length {
        return Err(Problem::Length);
    }
    if hash.finalize().as_slice() != segment.digest {
        return Err(Problem::Digest);
    }
    spawn_blocking(move || file.sync_all().map_err(|_| Problem::Disk))
        .await
        .unwrap_or(Err(Problem::Disk))
}

/// A new file. What a rig that was killed left under this name may be a second name of a segment that is kept: it is taken away,
/// never written over.
fn create(path: &Path) -> io::Result<File> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    OpenOptions::new().write(true).create_new(true).open(path)
}

impl Segment {
    /// Gives the file its name, unless there is one.
    fn keep(&self) -> Result<StatusCode, Problem> {
        let recording = Recording::open(&self.unfinished).map_err(|_| Problem::NoRecording)?;
        if !recording.damage().is_empty() {
            return Err(Problem::NoRecording);
        }
        match std::fs::hard_link(&self.unfinished, &self.path) {
            Ok(()) => {
                let folder = self.path.parent().unwrap_or(Path::new(""));
                let synced = File::open(folder).and_then(|folder| folder.sync_all());
                synced.map_err(|_| Problem::Disk)?;
                Ok(StatusCode::CREATED)
            }
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                let there = std::fs::read(&self.path).map_err(|_| Problem::Disk)?;
                match Sha256::digest(&there).as_slice() == self.digest {
                    true => Ok(StatusCode::OK),
                    false => Err(Problem::Other),
                }
            }
            Err(_) => Err(Problem::Disk),
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_recording::{Writer, WriterConfig};
    use lsfb_types::Timestamp;

    use super::*;

    /// A recording of one message.
    fn recording(path: &Path, text: &[u8]) -> Vec<u8> {
        let mut writer = Writer::create(path, &WriterConfig::default()).unwrap();
        let channel = lsfb_recording::Channel {
            topic: "/note",
            schema_name: "std_msgs/msg/String",
            schema_text: "string data",
        };
        let time = Timestamp::from_nanos(1_772_359_200_000_000_000);
        writer.write_cdr(&channel, time, time, text).unwrap();
        writer.finish().unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn a_segment_is_kept_once_and_only_whole() {
        let folder = tempfile::tempdir().unwrap();
        let one = recording(
            &folder.path().join("one.mcap"),
            &[0, 1, 0, 0, 1, 0, 0, 0, 0],
        );
        let other = recording(
            &folder.path().join("other.mcap"),
            &[0, 1, 0, 0, 2, 0, 0, 0, 9, 0],
        );
        let path = folder.path().join("3.mcap");
        let keep = |bytes: &[u8]| {
            let segment = Segment {
                path: path.clone(),
                unfinished: folder.path().join("3-1.part"),
                digest: Sha256::digest(bytes).to_vec(),
            };
            // What was kept before has this name too.
            let mut file = create(&segment.unfinished).unwrap();
            file.write_all(bytes).unwrap();
            segment.keep().map_err(Problem::status)
        };
        let torn = one.get(..one.len() / 2).unwrap();
        for broken in [b"no recording".as_slice(), torn] {
            assert_eq!(keep(broken), Err(StatusCode::UNPROCESSABLE_ENTITY));
        }
        assert!(!path.exists());
        assert_eq!(keep(&one), Ok(StatusCode::CREATED));
        assert_eq!(keep(&one), Ok(StatusCode::OK));
        assert_eq!(keep(&other), Err(StatusCode::CONFLICT));
        assert_eq!(std::fs::read(&path).unwrap(), one);
    }
}
