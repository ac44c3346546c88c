use std::time::Instant;
fn main() {
    let mut files: Vec<_> = std::env::args().skip(1).collect();
    files.sort();
    let mut bad = 0;
    let mut time = 0.0;
    let mut counts = std::collections::BTreeMap::<usize, (usize, usize)>::new();
    let mut seed = 1u64;
    let mut rnd = || {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (seed >> 33) as usize
    };
    for (k, f) in files.iter().enumerate() {
        let Ok(b) = std::fs::read(f) else { continue };
        let t = Instant::now();
        let r = lsfb_perception::image::decode(&b);
        time += t.elapsed().as_secs_f64();
        if let Err(e) = &r {
            bad += 1;
            if bad < 20 {
                println!("{f}: {e}");
            }
            continue;
        }
        if k % 10 == 0 && b.starts_with(&[0xff, 0xd8]) {
            let sos = b.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap() + 14;
            for n in [8usize, 16, 32, 64, 128, 512, 2048] {
                if b.len() < sos + n + 20 {
                    continue;
                }
                for _ in 0..3 {
                    let at = sos + rnd() % (b.len() - sos - n - 2);
                    let mut d = b.clone();
                    d[at..at + n].fill(0);
                    let c = counts.entry(n).or_default();
                    c.1 += 1;
                    if lsfb_perception::image::decode(&d).is_err() {
                        c.0 += 1;
                    }
                }
            }
        }
    }
    println!(
        "{} files {bad} refused, {:.2} ms each; zeroed: {counts:?}",
        files.len(),
        1e3 * time / files.len() as f64
    );
}
