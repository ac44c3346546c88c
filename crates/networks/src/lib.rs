//! Learned image features on the CPU: published weights are read, checked and run without the framework that trained them.
//!
//! [`Network::read`] takes the files of the authors (`.pt`, `.pth`), `.safetensors`, wheels and ONNX files that PyTorch exported; nothing
//! in them is executed. The hash
//! that is checked is that of the tensors themselves ([`Network::weights_sha256`]), so that it does not depend on the file they came in.
//! [`Network::run`] gives maps of an image: keypoints, and descriptors at any pixel. [`agreement`] compares a network
//! with numbers that another program computed of the same weights.
//!
//! Convolutions are products of matrices in strips of rows, of fixed size: the same image gives the same bits on any number of threads.
//! Images are grey; networks trained on colours see three equal ones.

mod agreement;
mod alike;
mod aliked;
mod convolution;
mod error;
#[cfg(test)]
mod generated;
mod grey;
mod keypoints;
mod model;
mod network;
mod pattern;
mod superpoint;
mod tensor;
mod weights;
mod xfeat;

pub use agreement::{Agreement, agreement};
pub use error::{Damage, Error};
pub(crate) use grey::Grey;
pub use keypoints::NetworkKeypoint;
pub use model::Model;
pub use network::{Network, NetworkMaps, NetworksRead, Trust};
pub use weights::Weights;
