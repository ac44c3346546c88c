//! What is asked of the leaderboard, and answered.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use lsfb_eval::dataset::{DatasetFolder, Description};
use lsfb_eval::leaderboard::{Score, Submission, score};
use lsfb_eval::{ReadOptions, TrajectoryFile, read_trajectory};
use lsfb_operator::form::{self, Field};
use lsfb_operator::http::{self, Request, Status};
use lsfb_operator::names::Names;

use super::kept::Kept;
use super::page;
use super::rate::RateLimit;
use crate::judged::printable;

/// How long an upload may take.
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(30);
/// What the fields of a form add to the file.
const FORM_BYTES: usize = 16 << 10;
/// Longest name of a team, characters.
const LONGEST_TEAM: usize = 40;
/// What a page may do: look as it looks, and send its form here.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'";

/// The leaderboard.
pub struct Site {
    title: String,
    /// Sequences whose truth is there.
    truths: BTreeMap<String, TrajectoryFile>,
    /// Where an upload is while it is judged.
    upload: PathBuf,
    kept: Kept,
    names: Names,
    most_bytes: usize,
    rate: RateLimit,
    /// One upload is judged at a time: many must not fill the memory.
    judging: Mutex<()>,
}

/// An upload that gets no score.
struct Refusal {
    status: Status,
    why: String,
}

impl Refusal {
    fn new(status: Status, why: impl Into<String>) -> Self {
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
        Ok(Self {
            title: description.title.clone(),
            truths,
            upload: out.join("upload.part"),
            kept: Kept::open(&out.join("submissions.jsonl"))?,
            names: Names::new(&[]),
            most_bytes,
            rate: RateLimit::default(),
            judging: Mutex::new(()),
        })
    }

    /// Whether nothing can be judged.
    pub fn is_empty(&self) -> bool {
        self.truths.is_empty()
    }

    /// Talks to one client. Nobody is left to be told where that fails.
    pub fn serve(&self, mut stream: TcpStream) {
        let Ok(mut request) = http::read_form(&mut stream) else {
            return;
        };
        let is_known = request
            .host
            .as_deref()
            .is_some_and(|host| self.names.include(host));
        let answered = match (request.is_post, request.path.as_str()) {
            _ if !is_known => refuse(&mut stream, Status::Misdirected, "no such site here"),
            (false, "/") => html(&mut stream, Status::Ok, &self.board()),
            (false, "/scores.json") => self.scores(&mut stream),
            (true, "/submit") => self.submit(&mut stream, &mut request),
            (true, _) => refuse(&mut stream, Status::NotAllowed, "nothing is taken here"),
            (false, _) => refuse(&mut stream, Status::NotFound, "no such page"),
        };
        if answered.is_ok() && request.is_post {
            form::end_refused(&mut stream);
        }
    }

    fn board(&self) -> String {
        let sequences = self
            .truths
            .keys()
            .map(|name| (name.as_str(), self.kept.ranking(name)));
        page::board(&self.title, &sequences.collect::<Vec<_>>(), self.most_bytes)
    }

    fn scores(&self, stream: &mut TcpStream) -> std::io::Result<()> {
        let all: BTreeMap<_, _> = self
            .truths
            .keys()
            .map(|name| (name, self.kept.ranking(name)))
            .collect();
        let text = serde_json::to_vec_pretty(&all)?;
        http::answer(stream, Status::Ok, "application/json", &text)
    }

    fn submit(&self, stream: &mut TcpStream, request: &mut Request) -> std::io::Result<()> {
        match self.judged(stream, request) {
            Ok(submission) => html(stream, Status::Ok, &page::scored(&submission)),
            Err(refusal) => html(stream, refusal.status, &page::refused(&refusal.why)),
        }
    }

    fn judged(&self, stream: &mut TcpStream, request: &mut Request) -> Result<Submission, Refusal> {
        if !request.is_ours() {
            let why = "the form of another site";
            return Err(Refusal::new(Status::Forbidden, why));
        }
        let sender = stream
            .peer_addr()
            .map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |a| a.ip());
        if !self.rate.admits(sender, Instant::now()) {
            let why = "too many uploads: six a minute, sixty an hour";
            return Err(Refusal::new(Status::TooMany, why));
        }
        let most = self.most_bytes + FORM_BYTES;
        let body = form::body(stream, request, most, UPLOAD_TIMEOUT)
            .map_err(|status| Refusal::new(status, "the upload is too large, too slow or cut"))?;
        let content_type = request.content_type.as_deref().unwrap_or_default();
        let fields = form::fields(content_type, &body)
            .ok_or_else(|| Refusal::new(Status::BadRequest, "no form that was sent whole"))?;
        let text = |name: &str| -> Option<&str> {
            let bytes = &field(&fields, name)?.bytes;
            Some(std::str::from_utf8(bytes).ok()?.trim())
        };
        let bad = |why: &str| Refusal::new(Status::BadRequest, why);
        let is_name = |name: &&str| {
            (1..=LONGEST_TEAM).contains(&name.chars().count())
                && !name.chars().any(char::is_control)
        };
        let team = text("team").filter(is_name);
        let team = team.ok_or_else(|| bad("a team has a name of 1 to 40 characters"))?;
        let known = text("sequence").and_then(|name| self.truths.get_key_value(name));
        let (sequence, truth) = known.ok_or_else(|| bad("no such sequence"))?;
        let upload = field(&fields, "trajectory").ok_or_else(|| bad("there is no trajectory"))?;
        let submission = Submission {
            unix_s: SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0, |d| d.as_secs()),
            team: team.to_owned(),
            sequence: sequence.clone(),
            score: self.score(&upload.bytes, truth)?,
        };
        let kept = self.kept.add(submission.clone());
        kept.map_err(|error| Refusal::new(Status::Unavailable, error.to_string()))?;
        Ok(submission)
    }

    fn score(&self, upload: &[u8], truth: &TrajectoryFile) -> Result<Score, Refusal> {
        // Neither archives, which may grow without end, nor recordings.
        let is_text = std::str::from_utf8(upload).is_ok_and(|text| !text.contains('\0'));
        if !is_text {
            return Err(Refusal::new(Status::BadRequest, "a trajectory is text"));
        }
        let unavailable =
            |error: std::io::Error| Refusal::new(Status::Unavailable, error.to_string());
        let _one = self.judging.lock();
        std::fs::write(&self.upload, upload).map_err(unavailable)?;
        let found = score(&self.upload, truth);
        std::fs::remove_file(&self.upload).map_err(unavailable)?;
        found.map_err(|error| {
            // Where this machine puts files is nobody's business.
            let own = self.upload.display().to_string();
            let why = printable(&error.to_string()).replace(&own, "your file");
            Refusal::new(Status::Unprocessable, why)
        })
    }
}

fn field<'a>(fields: &'a [Field], name: &str) -> Option<&'a Field> {
    fields.iter().find(|field| field.name == name)
}

fn html(stream: &mut TcpStream, status: Status, page: &str) -> std::io::Result<()> {
    http::answer_under(
        POLICY,
        stream,
        status,
        "text/html; charset=utf-8",
        page.as_bytes(),
    )
}

fn refuse(stream: &mut TcpStream, status: Status, why: &str) -> std::io::Result<()> {
    http::answer(stream, status, "text/plain", why.as_bytes())
}
