//! What is in a recording, and what of it is damaged: `read_recording RECORDING`.

#![allow(clippy::print_stdout, reason = "an example talks to who runs it")]

use std::path::Path;

use lsfb_recording::Recording;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("read_recording RECORDING")?;
    let recording = Recording::open(Path::new(&path))?;
    let range = recording.arrival_range().ok_or("no message")?;
    let seconds = range.end.secs_since(range.start);
    println!("{seconds:.1} s");
    for topic in recording.topics() {
        // So many messages have one period less.
        let rate_hz = topic.messages.saturating_sub(1) as f64 / seconds;
        println!("{:32} {:28} {rate_hz:9.1} Hz", topic.topic, topic.schema);
    }
    for damage in recording.damage() {
        println!("damaged: {damage:?}");
    }

    // Samples come in the order of their arrival, with three stamps each: measured, arrived, the device's own counter. One that
    // cannot be read is an error, and the next one follows all the same.
    if let Ok(samples) = recording.imu() {
        let readable = samples.filter_map(Result::ok);
        let (mut n, mut sum) = (0_u32, 0.0);
        for sample in readable {
            let [x, y, z] = sample.sample.specific_force_m_s2;
            sum += (x * x + y * y + z * z).sqrt();
            n += 1;
        }
        println!("mean specific force: {:.3} m/s²", sum / f64::from(n.max(1)));
    }
    if let Ok(mut scans) = recording.scans()
        && let Some(scan) = scans.next()
    {
        println!("points of the first scan: {}", scan?.sample.points.len());
    }
    for camera in recording.rig().iter().flat_map(|rig| rig.cameras.keys()) {
        if let Ok(mut images) = recording.images(camera)
            && let Some(image) = images.next()
        {
            let image = image?;
            let (width, height) = (image.sample.width, image.sample.height);
            println!(
                "first image of {camera}: {width} × {height} at {}",
                image.time
            );
        }
    }
    Ok(())
}
