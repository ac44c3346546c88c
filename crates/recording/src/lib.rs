//! Recordings: MCAP files of raw packets and samples, their topics, schemas, reader and writer.
