//! MCAP files as bytes, and nothing of what their messages mean. The `mcap` crate is not used: it allocates what a length field
//! asks for, panics on some broken attachments, and knows no way back from a file that was cut.
//!
//! | what | files |
//! | --- | --- |
//! | records from bytes, and to bytes | `record.rs`, `emit.rs` |
//! | chunks from bytes, and to bytes | `chunk.rs` `unpack.rs` `chunk_cache.rs`, `open_chunk.rs` `pack.rs` |
//! | writing a file | `header.rs`, `encoder.rs`, at its end `summary_writer.rs` |
//! | reading one | `source.rs`; what is where in it: `index.rs`, from `summary_reader.rs` or, without a summary, `rescan.rs` |
//! | judging and mending one | `verify.rs`, `recover.rs` |

pub(crate) mod chunk;
pub(crate) mod chunk_cache;
mod emit;
pub(crate) mod encoder;
mod header;
pub(crate) mod index;
pub(crate) mod open_chunk;
mod pack;
pub(crate) mod record;
pub(crate) mod recover;
mod rescan;
pub(crate) mod source;
pub(crate) mod summary_reader;
mod summary_writer;
mod unpack;
pub(crate) mod verify;
