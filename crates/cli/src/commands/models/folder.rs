//! The folder of weights that were added.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_networks::{Model, Network, Trust};
use lsfb_pipeline::features::{
    Feature, FeatureDetector, LearnedConfig, LearnedFeature, SiftConfig,
};
use serde::{Deserialize, Serialize};

/// Where weights are kept.
#[derive(clap::Args, Clone, Debug)]
pub struct ModelFolder {
    /// Folder of model weights; by default $LSFB_MODELS, otherwise lsfb/models in $XDG_DATA_HOME.
    #[arg(long, value_name = "FOLDER")]
    models: Option<PathBuf>,
}

/// The name by which everybody knows the built-in feature.
pub const SIFT: &str = "sift";
/// Names the folder where no option does.
const VARIABLE: &str = "LSFB_MODELS";
/// What the files in the folder are.
const EXTENSION: &str = "safetensors";
/// Digits of the hash in the name of weights that were not published.
const HASH_DIGITS: usize = 8;

impl ModelFolder {
    /// The folder that is named, else the default one.
    pub fn new(named: Option<&Path>) -> Self {
        Self {
            models: named.map(Path::to_owned),
        }
    }

    /// The folder.
    pub fn path(&self) -> anyhow::Result<PathBuf> {
        let set = std::env::var_os(VARIABLE).map(PathBuf::from);
        if let Some(folder) = self.models.clone().or(set) {
            return Ok(folder);
        }
        let absolute = |name| {
            let value = std::env::var_os(name).map(PathBuf::from);
            value.filter(|path| path.is_absolute())
        };
        absolute("XDG_DATA_HOME")
            .or_else(|| absolute("HOME").map(|home| home.join(".local/share")))
            .map(|data| data.join("lsfb/models"))
            .context("neither XDG_DATA_HOME nor HOME is set, so that there is no folder for weights: give --models")
    }

    /// The names that [`ModelFolder::feature`] knows: SIFT first, then the weights that were added.
    pub fn names(&self) -> anyhow::Result<Vec<String>> {
        let added = files(&self.path()?)?;
        let mut names = vec![SIFT.to_owned()];
        names.extend(added.iter().filter_map(|file| stem(file)));
        Ok(names)
    }

    /// What `--feature NAME` asks for: `None` for SIFT, else weights that were added.
    pub fn feature(&self, name: &str) -> anyhow::Result<Option<LearnedConfig>> {
        if name == SIFT {
            return Ok(None);
        }
        let folder = self.path()?;
        let is_plain_name = Path::new(name).file_name() == Some(name.as_ref());
        let path = match Model::named(name).filter(|model| model.weights_sha256().is_none()) {
            // No hash is known, so that no weights have the plain name.
            Some(model) => the_one_added(&folder, model)?,
            None => Some(folder.join(format!("{name}.{EXTENSION}"))),
        };
        let Some(path) = path.filter(|path| is_plain_name && path.is_file()) else {
            let known = self.names()?;
            let hint = match Model::named(name) {
                Some(model) => format!(
                    "its weights are not in {}: get {}, then `lsfb models add FILE`",
                    folder.display(),
                    model.files()
                ),
                None => "`lsfb models list` shows the others".to_owned(),
            };
            anyhow::bail!(
                "no feature {name} (available: {}): {hint}",
                known.join(", ")
            );
        };
        let trust = match Model::named(name).and_then(Model::weights_sha256) {
            Some(_) => Trust::Published,
            None => Trust::Any,
        };
        let network = Network::read(&path, trust)?;
        let feature = LearnedFeature {
            model: network.model().name().to_owned(),
            weights_sha256: network.weights_sha256().to_owned(),
        };
        Ok(Some(LearnedConfig::new(path, feature)))
    }

    /// What finds the features that a map holds.
    pub fn detector(&self, feature: &Feature) -> anyhow::Result<FeatureDetector> {
        let learned = self.learned(feature)?;
        Ok(FeatureDetector::new(
            &SiftConfig::default(),
            learned.as_ref(),
        )?)
    }

    /// The weights of the network that finds the features of a map; `None` where these are SIFT's.
    pub fn learned(&self, feature: &Feature) -> anyhow::Result<Option<LearnedConfig>> {
        let Feature::Learned(learned) = feature else {
            return Ok(None);
        };
        let folder = self.path()?;
        let name = file_name(&learned.model, &learned.weights_sha256);
        let path = folder.join(&name);
        anyhow::ensure!(
            path.is_file(),
            "the map holds {feature} features, but {name} is not in {}: add these weights with `lsfb \
             models add FILE`, or name their folder with --models",
            folder.display()
        );
        Ok(Some(LearnedConfig::new(path, learned.clone())))
    }
}

/// The weights in a folder, by name; none where there is no folder.
pub fn files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.with_context(|| folder.display().to_string())?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if path.extension().is_some_and(|e| e == EXTENSION) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Where weights that were added come from: stands beside them.
#[derive(Clone, Serialize, Deserialize)]
pub struct Origin {
    pub weights_sha256: String,
    /// Whether they are what the authors published.
    pub published: bool,
    /// `None` of weights that were not published.
    pub licence: Option<String>,
    /// Name of the file that was added.
    pub file: String,
    pub file_sha256: String,
}

impl Origin {
    /// Where it stands of these weights.
    pub fn path(weights: &Path) -> PathBuf {
        weights.with_extension("toml")
    }

    /// `None` of weights beside which nothing stands, or what is said of others that were there before.
    pub fn of(weights: &Path, network: &Network) -> Option<Self> {
        let text = std::fs::read_to_string(Self::path(weights)).ok()?;
        let said: Self = toml::from_str(&text).ok()?;
        (said.weights_sha256 == network.weights_sha256()).then_some(said)
    }
}

/// The weights of a network in a folder.
pub fn added(folder: &Path, model: Model) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = files(folder)?;
    files.retain(|file| {
        let stem = stem(file).unwrap_or_default();
        match stem.strip_prefix(model.name()) {
            Some("") => true,
            Some(rest) => rest.strip_prefix('-').is_some_and(|digits| {
                digits.len() == HASH_DIGITS && digits.bytes().all(|b| b.is_ascii_hexdigit())
            }),
            None => false,
        }
    });
    Ok(files)
}

/// The weights that are meant by the name of a network of which no hash is known: those from its authors' own file, or the only ones.
fn the_one_added(folder: &Path, model: Model) -> anyhow::Result<Option<PathBuf>> {
    let all = added(folder, model)?;
    let is_published = |file: &&PathBuf| {
        let network = Network::read(file, Trust::Any).ok();
        let origin = network.and_then(|network| Origin::of(file, &network));
        origin.is_some_and(|origin| origin.published)
    };
    let published: Vec<&PathBuf> = all.iter().filter(is_published).collect();
    match (&published[..], &all[..]) {
        ([one], _) => Ok(Some((*one).clone())),
        ([], [one]) => Ok(Some(one.clone())),
        (_, []) => Ok(None),
        _ => {
            let names: Vec<String> = all.iter().filter_map(|file| stem(file)).collect();
            anyhow::bail!(
                "several sets of weights of {} were added: choose one: {}",
                model.name(),
                names.join(", ")
            )
        }
    }
}

/// The name by which `--feature` takes a file.
pub fn stem(file: &Path) -> Option<String> {
    Some(file.file_stem()?.to_str()?.to_owned())
}

/// What weights are called in the folder: those that were published have the plain name of the network.
pub fn file_name(model: &str, weights_sha256: &str) -> String {
    let published = Model::named(model).and_then(Model::weights_sha256);
    if published == Some(weights_sha256) {
        return format!("{model}.{EXTENSION}");
    }
    let digits: String = weights_sha256.chars().take(HASH_DIGITS).collect();
    format!("{model}-{digits}.{EXTENSION}")
}
