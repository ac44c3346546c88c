//! Mapping, localization and motion from outside: recordings of others.

mod hololens_office;
mod learned_features;
mod posed_images;
mod visual_inertial;
