//! Images: read, made smaller with their cameras, corners, and where those go from image to image.

mod alignment;
mod corners;
mod decode;
mod encode;
mod following;
mod gray;
mod interpolation;
mod patch;
mod relative_rotation;
mod tracking;

pub use alignment::{Alignment, Frame, align};
pub use corners::corners;
pub use decode::{ImageError, MAX_PIXELS, decode, grey_from_16_bits, luma, read};
pub use encode::{Compression, Samples, write_png};
pub use following::{Follower, Pyramid};
pub use gray::Gray;
pub use interpolation::Around;
pub use patch::{Patch, PatchSearch};
pub use relative_rotation::{RelativeRotation, relative_rotation};
pub use tracking::{Pair, Track};
