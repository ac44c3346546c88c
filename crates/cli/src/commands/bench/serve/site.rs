//! What is asked of the leaderboard, and answered.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_eval::dataset::{DatasetFolder, Description};
use lsfb_eval::leaderboard::{Score, Submission, score};
use lsfb_eval::{ReadOptions, TrajectoryFile, read_trajectory};
use lsfb_recording::Provenance;
use lsfb_web::{
    Answer, Field, Incoming, Method, Names, Request, StatusCode, Visit, blocking, body, fields,
    file_of, is_own_page, json_of, said, under,
};

use super::kept::Kept;
use super::page;
use super::rate::RateLimit;
use crate::judged::printable;
use crate::pages;

/// How long an upload may take.
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(30);
/// What the fields of a form add to the file.
const FORM_BYTES: usize = 16 << 10;
/// Longest name of a team, characters.
const LONGEST_TEAM: usize = 40;
/// Uploads that are taken at once at most, whoever sends them: each is held in memory until it is judged.
const MOST_UPLOADS: usize = 8;
/// What a page may do: look as it looks, and send its form here.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'";

/// The leaderboard.
pub struct Site {
    title: String,
    /// Of the board.
    settings: Vec<(String, String)>,
    /// Sequences whose truth is there.
    truths: BTreeMap<String, TrajectoryFile>,
    /// Where an upload is while it is judged.
    upload: PathBuf,
    kept: Kept,
    names: Names,
    most_bytes: usize,
    rate: RateLimit,
    /// Uploads that are being taken.
    uploads: AtomicUsize,
    /// One upload is judged at a time: many must not fill the memory.
    judging: Mutex<()>,
}

/// An upload that gets no score.
struct Refusal {
    status: StatusCode,
    why: String,
}

impl Refusal {
    fn new(status: StatusCode, why: impl Into<String>) -> Self {
        Self {
            status,
            why: why.into(),
        }
    }
}

impl Site {
    /// Reads the truth of all sequences that have one.
    pub fn new(
        folder: &DatasetFolder,
        description: &Description,
        out: &Path,
        most_bytes: usize,
    ) -> anyhow::Result<Self> {
        let mut truths = BTreeMap::new();
        for query in &description.queries {
            let path = folder.walk_truth(&query.name);
            if path.exists() {
                let truth = read_trajectory(&path, &ReadOptions::default())?;
                truths.insert(query.name.clone(), truth);
            }
        }
        let mut made_from = Provenance::new(&serde_json::json!({ "most_bytes": most_bytes }));
        made_from.add_input(&folder.description())?;
        Ok(Self {
            title: description.title.clone(),
            settings: pages::settings(&made_from),
            truths,
            upload: out.join("upload.part"),
            kept: Kept::open(&out.join("submissions.jsonl"))?,
            names: Names::new(&[]),
            most_bytes,
            rate: RateLimit::default(),
            uploads: AtomicUsize::new(0),
            judging: Mutex::new(()),
        })
    }

    /// Whether nothing can be judged.
    pub fn is_empty(&self) -> bool {
        self.truths.is_empty()
    }

    /// Answers one request.
    pub async fn answer(self: Arc<Self>, request: Request<Incoming>, visit: Visit) -> Answer {
        let path = request.uri().path().to_owned();
        let answer = match (request.method().clone(), path.as_str()) {
            (Method::GET | Method::POST, _) if !self.names.are_asked(&request) => {
                said(StatusCode::MISDIRECTED_REQUEST, "no such site")
            }
            (Method::GET, "/") => html(StatusCode::OK, self.board()),
            (Method::GET, "/scores.json") => self.scores(),
            (Method::GET, _) => said(StatusCode::NOT_FOUND, "no such page"),
            (Method::POST, "/submit") => match self.judged(request, &visit).await {
                Ok(submission) => html(StatusCode::OK, page::scored(&submission)),
                Err(refusal) => html(refusal.status, page::refused(&refusal.why)),
            },
            _ => said(
                StatusCode::METHOD_NOT_ALLOWED,
                "uploads are not accepted here",
            ),
        };
        under(POLICY, answer)
    }

    fn board(&self) -> String {
        let sequences = self
            .truths
            .keys()
            .map(|name| (name.as_str(), self.kept.ranking(name)));
        page::board(&self.title, &sequences.collect::<Vec<_>>(), self.most_bytes)
            .settings(self.settings.clone())
            .to_html()
    }

    fn scores(&self) -> Answer {
        let all: BTreeMap<_, _> = self
            .truths
            .keys()
            .map(|name| (name, self.kept.ranking(name)))
            .collect();
        match serde_json::to_string_pretty(&all) {
            Ok(text) => json_of(StatusCode::OK, text),
            Err(_) => said(StatusCode::INTERNAL_SERVER_ERROR, "no scores"),
        }
    }

    async fn judged(
        self: &Arc<Self>,
        request: Request<Incoming>,
        visit: &Visit,
    ) -> Result<Submission, Refusal> {
        if !is_own_page(&request, visit.is_secure) {
            let why = "form of another site";
            return Err(Refusal::new(StatusCode::FORBIDDEN, why));
        }
        if !self.rate.admits(visit.peer, Instant::now()) {
            let why = "too many uploads: six a minute, sixty an hour";
            return Err(Refusal::new(StatusCode::TOO_MANY_REQUESTS, why));
        }
        let Some(_place) = UploadSlot::take(&self.uploads) else {
            let why = "others are uploading: try again in a minute";
            return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, why));
        };
        // It may take its time now, which strangers may not.
        visit.ticket.enter();
        let content_type = request.headers().get("content-type");
        let content_type = content_type.and_then(|value| value.to_str().ok());
        let content_type = content_type.unwrap_or_default().to_owned();
        let most = self.most_bytes + FORM_BYTES;
        let body = body(request, most, UPLOAD_TIMEOUT)
            .await
            .map_err(|status| {
                Refusal::new(status, "the upload is too large, too slow or incomplete")
            })?;
        let site = Arc::clone(self);
        let judged = blocking(move || site.judge(&content_type, &body)).await;
        let unknown = || Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, "it could not be scored");
        judged.ok_or_else(unknown)?
    }

    fn judge(&self, content_type: &str, body: &[u8]) -> Result<Submission, Refusal> {
        let fields = fields(content_type, body)
            .ok_or_else(|| Refusal::new(StatusCode::BAD_REQUEST, "the form is incomplete"))?;
        let text = |name: &str| -> Option<&str> {
            let bytes = &field(&fields, name)?.bytes;
            Some(std::str::from_utf8(bytes).ok()?.trim())
        };
        let bad = |why: &str| Refusal::new(StatusCode::BAD_REQUEST, why);
        let is_name = |name: &&str| {
            (1..=LONGEST_TEAM).contains(&name.chars().count())
                && !name.chars().any(char::is_control)
        };
        let team = text("team").filter(is_name);
        let team = team.ok_or_else(|| bad("a team name has 1 to 40 characters"))?;
        let known = text("sequence").and_then(|name| self.truths.get_key_value(name));
        let (sequence, truth) = known.ok_or_else(|| bad("no such sequence"))?;
        let upload =
            field(&fields, "trajectory").ok_or_else(|| bad("the trajectory is missing"))?;
        let submission = Submission {
            unix_s: SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0, |d| d.as_secs()),
            team: team.to_owned(),
            sequence: sequence.clone(),
            score: self.score(&upload.bytes, truth)?,
        };
        let kept = self.kept.add(submission.clone());
        kept.map_err(|error| Refusal::new(StatusCode::SERVICE_UNAVAILABLE, error.to_string()))?;
        Ok(submission)
    }

    fn score(&self, upload: &[u8], truth: &TrajectoryFile) -> Result<Score, Refusal> {
        // Neither archives, which may grow without end, nor recordings.
        let is_text = std::str::from_utf8(upload).is_ok_and(|text| !text.contains('\0'));
        if !is_text {
            return Err(Refusal::new(
                StatusCode::BAD_REQUEST,
                "a trajectory must be text",
            ));
        }
        let unavailable = |error: std::io::Error| {
            Refusal::new(StatusCode::SERVICE_UNAVAILABLE, error.to_string())
        };
        let _one = self.judging.lock();
        std::fs::write(&self.upload, upload).map_err(unavailable)?;
        let found = score(&self.upload, truth);
        std::fs::remove_file(&self.upload).map_err(unavailable)?;
        found.map_err(|error| {
            // Where this machine puts files is nobody's business.
            let own = self.upload.display().to_string();
            let why = printable(&error.to_string()).replace(&own, "your file");
            Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, why)
        })
    }
}

fn field<'a>(fields: &'a [Field], name: &str) -> Option<&'a Field> {
    fields.iter().find(|field| field.name == name)
}

fn html(status: StatusCode, page: String) -> Answer {
    file_of(status, "text/html; charset=utf-8", page)
}

/// A place among those who upload, until it is dropped.
struct UploadSlot<'a>(&'a AtomicUsize);

impl<'a> UploadSlot<'a> {
    fn take(uploads: &'a AtomicUsize) -> Option<Self> {
        let free = |taken: usize| (taken < MOST_UPLOADS).then_some(taken + 1);
        let taken = uploads.fetch_update(Ordering::AcqRel, Ordering::Acquire, free);
        taken.is_ok().then_some(Self(uploads))
    }
}

impl Drop for UploadSlot<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}
