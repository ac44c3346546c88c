//! Decoders from outside: what other programs make of the same packets.

mod examples;
mod hesai_reference;
mod mip_recording;
mod udev_rules;
mod velodyne_recordings;
mod velodyne_reference;
