//! A whole recording from a damaged one: `recover_recording DAMAGED WHOLE`. The damaged file is not touched.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;

use lsfb_recording::{Recording, recover};
use lsfb_types::no_progress;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut path = || arguments.next().ok_or("recover_recording DAMAGED WHOLE");
    let (damaged, whole) = (path()?, path()?);
    let recovered = recover(Path::new(&damaged), Path::new(&whole), &no_progress)?;
    println!(
        "{} messages in {} chunks, {} of them from a torn chunk",
        recovered.messages, recovered.chunks, recovered.salvaged_messages
    );
    for lost in &recovered.damage {
        println!(
            "lost: {} bytes at {}: {}",
            lost.bytes, lost.offset, lost.reason
        );
    }
    // Opening reads the index alone; this reads every byte.
    let broken = Recording::open(Path::new(&whole))?.verify(&no_progress)?;
    println!("the new file has {} damaged places", broken.len());
    Ok(())
}
