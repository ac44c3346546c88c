use std::path::PathBuf;

/// Why weights cannot be read or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file of weights is damaged, or of a kind that is not read.
    #[error("{path}: {reason}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: Damage,
    },
    /// The tensors of a file are those of no architecture that is known.
    #[error(
        "{path}: its {tensors} tensors belong to no supported network; supported are: {known}",
        path = path.display()
    )]
    UnknownArchitecture {
        /// The file.
        path: PathBuf,
        /// How many tensors it has.
        tensors: usize,
        /// Names of those that are known.
        known: String,
    },
    /// The weights are not those that were published.
    #[error(
        "{path}: weights of {model} with SHA-256 {found}, which differ from the published ones ({expected})",
        path = path.display()
    )]
    UnknownWeights {
        /// The file.
        path: PathBuf,
        /// The network they fit.
        model: &'static str,
        /// Hash of the weights in the file.
        found: String,
        /// Hash of the published ones.
        expected: String,
    },
}

/// What is wrong with a file of weights.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Damage {
    /// Neither a .safetensors or .onnx file nor a ZIP archive (.pt, .pth, .whl).
    #[error("is neither .safetensors nor .onnx nor an archive with weights (.pt, .pth, .whl)")]
    UnknownKind,
    /// It ends too early, or something in it points beyond its end.
    #[error("is truncated or damaged: {what} is incomplete")]
    CutOff {
        /// What was being read.
        what: &'static str,
    },
    /// The list of its tensors makes no sense.
    #[error("is damaged: its list of tensors is invalid")]
    List,
    /// An archive without weights in it.
    #[error("holds no weights")]
    NoWeights,
    /// An ONNX file of a network that is not known, or one put together otherwise.
    #[error(
        "is an ONNX graph of an unsupported network (supported: XFeat, ALIKE, SuperPoint): found \
         {found}; use the authors' own weights"
    )]
    UnknownGraph {
        /// Its operators.
        found: String,
    },
    /// An ONNX file that keeps its values elsewhere.
    #[error("keeps its values in another file: export it as one file")]
    ExternalValues,
    /// A tensor that a network needs is absent or has another shape.
    #[error("tensor {name} is missing or has another shape than {shape:?}")]
    Tensor {
        /// Its name.
        name: String,
        /// The shape it should have.
        shape: Vec<usize>,
    },
    /// A weight that is no number.
    #[error("tensor {name} has a value that is not finite")]
    NotFinite {
        /// The tensor.
        name: String,
    },
}
