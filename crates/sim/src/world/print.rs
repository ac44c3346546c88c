//! What is printed and shown: pages, posters, signs, spines of books, screens, keyboards, parcels.

use super::canvas::{Canvas, Leaves};
use super::letters::{Line, Typeface};
use super::words;
use crate::noise::{Dice, below, uniform};

type Corner = [f32; 2];

/// Dark on light, light on dark.
fn ink_on(tone: f32) -> f32 {
    if tone > 0.4 { 0.06 } else { 0.88 }
}

/// One line, level, from `foot` on.
fn write(canvas: &mut Canvas, face: &Typeface, text: &str, foot: Corner, height_m: f32, ink: f32) {
    let line = Line {
        foot,
        along: [1.0, 0.0],
        height_m,
    };
    face.write(canvas, text, &line, ink);
}

/// A title of at most `most` words that is no longer than `room_m`; shorter words are tried before smaller letters.
fn fitting_title(
    rng: &Dice,
    face: &Typeface,
    most: usize,
    height_m: f32,
    room_m: f32,
) -> (String, f32) {
    for count in (1..=most).rev().chain([1, 1]) {
        let text = words::title(rng, count);
        if face.length_m(&text, height_m) <= room_m {
            return (text, height_m);
        }
    }
    let text = words::title(rng, 1);
    let shrunk = height_m * room_m / face.length_m(&text, height_m).max(1e-6);
    (text, shrunk)
}

/// Paragraphs of words from the top down, left-aligned, capitals of `height_m`.
pub(crate) fn paragraphs(
    canvas: &mut Canvas,
    low: Corner,
    high: Corner,
    height_m: f32,
    ink: f32,
    rng: &Dice,
) {
    let face = Typeface::draw(rng);
    let mut foot = high[1] - height_m;
    while foot >= low[1] {
        let is_gap = below(rng, 7) == 0;
        let end = low[0] + (high[0] - low[0]) * uniform(rng, 0.6, 1.0);
        let mut x = low[0];
        if !is_gap {
            loop {
                let word = words::word(rng);
                let length = face.length_m(&word, height_m);
                if x + length > end {
                    break;
                }
                write(canvas, &face, &word, [x, foot], height_m, ink);
                x += length + 0.4 * height_m;
            }
        }
        foot -= 1.7 * height_m;
    }
}

/// A sheet of paper: a heading and paragraphs, a table, or, on a plate by a door, a room's number and a name.
pub(crate) fn page(canvas: &mut Canvas, height_m: f32, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let ink = ink_on(tone);
    let margin = 0.08 * w.min(h);
    if h < 0.2 && w > 1.5 * h {
        let face = Typeface::draw(rng);
        let number = words::room(rng);
        let large = (0.36 * h).min(w * 0.36 * h / face.length_m(&number, 0.42 * h).max(1e-6));
        write(canvas, &face, &number, [margin, 0.5 * h], large, ink);
        let (name, small) = fitting_title(rng, &face, 2, 0.16 * h, w - 2.0 * margin);
        write(canvas, &face, &name, [margin, 0.16 * h], small, ink);
        return;
    }
    let head = (0.1 * h).min(2.2 * height_m);
    let face = Typeface::draw(rng);
    let (text, head) = fitting_title(rng, &face, 3, head, w - 2.0 * margin);
    write(canvas, &face, &text, [margin, h - margin - head], head, ink);
    let top = h - margin - 2.0 * head;
    match below(rng, 4) {
        0 => table(
            canvas,
            [margin, margin],
            [w - margin, top],
            height_m,
            ink,
            rng,
        ),
        1 => {
            let middle = 0.5 * (margin + top);
            picture(canvas, [margin, middle], [w - margin, top], rng);
            let high = [w - margin, middle - 0.5 * height_m];
            paragraphs(canvas, [margin; 2], high, 0.7 * height_m, ink, rng);
        }
        _ => paragraphs(
            canvas,
            [margin; 2],
            [w - margin, top],
            0.7 * height_m,
            ink,
            rng,
        ),
    }
}

fn table(canvas: &mut Canvas, low: Corner, high: Corner, height_m: f32, ink: f32, rng: &Dice) {
    let face = Typeface::draw(rng);
    let (columns, pitch) = (2 + below(rng, 3), 1.8 * height_m);
    let wide = (high[0] - low[0]) / columns as f32;
    let mut y = high[1];
    while y - pitch >= low[1] {
        canvas.stroke([low[0], y], [high[0], y], 0.1 * height_m, ink);
        for column in 0..columns {
            let text = words::word(rng);
            let x = low[0] + (column as f32 + 0.08) * wide;
            if face.length_m(&text, 0.8 * height_m) < 0.9 * wide {
                let foot = [x, y - 0.75 * pitch];
                write(canvas, &face, &text, foot, 0.8 * height_m, ink);
            }
        }
        y -= pitch;
    }
    for column in 0..=columns {
        let x = low[0] + column as f32 * wide;
        canvas.stroke([x, y], [x, high[1]], 0.1 * height_m, ink);
    }
}

/// A poster: a picture, a title, and lines of text on paper of any tone; a margin around it or none.
pub(crate) fn poster(canvas: &mut Canvas, margin_m: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let paper = match below(rng, 3) {
        0 => uniform(rng, 0.06, 0.3),
        _ => uniform(rng, 0.65, 0.88),
    };
    canvas.values.fill(paper);
    let margin = if below(rng, 3) == 0 { 0.0 } else { margin_m };
    let band = uniform(rng, 0.18, 0.36) * h;
    let is_above = below(rng, 2) == 0;
    let (low, high) = match is_above {
        true => ([margin, margin], [w - margin, h - band]),
        false => ([margin, band], [w - margin, h - margin]),
    };
    picture(canvas, low, high, rng);
    let (ink, edge) = (ink_on(paper), margin_m.max(0.03 * w));
    let top = if is_above { h } else { band } - 0.1 * band;
    let face = Typeface::draw(rng);
    let (text, head) = fitting_title(rng, &face, 4, 0.3 * band, w - 2.0 * edge);
    write(canvas, &face, &text, [edge, top - head], head, ink);
    let floor = top + 0.1 * band - band + 0.05 * band;
    let high = [w - edge, top - 1.5 * head];
    paragraphs(
        canvas,
        [edge, floor],
        high,
        (0.1 * band).max(0.008),
        ink,
        rng,
    );
}

/// Something to look at: a landscape, a face, a chart, a map, plain shapes, or a confusion of things.
pub(crate) fn picture(canvas: &mut Canvas, low: Corner, high: Corner, rng: &Dice) {
    let size = [high[0] - low[0], high[1] - low[1]];
    if size[0] < 0.01 || size[1] < 0.01 {
        return;
    }
    let (edge, tone) = (size[0].min(size[1]), |l, h| uniform(rng, l, h));
    let mut inside = canvas.cut(low, high);
    let whole = inside.size_m();
    let (a, b) = (tone(0.05, 0.9), tone(0.05, 0.9));
    inside.shade(|_, y| a + (b - a) * y / whole[1]);
    let put = |a: f32, b: f32| [a * whole[0], b * whole[1]];
    match below(rng, 6) {
        0 => {
            let sun = put(tone(0.1, 0.9), tone(0.6, 0.9));
            inside.ellipse(sun, [0.06 * edge; 2], 0.0, 0.92);
            for layer in 0..4 {
                let ground = tone(0.04, 0.6);
                let base = 0.62 - 0.16 * layer as f32;
                let waves: [f32; 6] = std::array::from_fn(|_| tone(0.0, 6.3));
                inside.paint_where(ground, |x, y| {
                    let s = x / whole[0];
                    let ridge = (0..6).map(|k| {
                        let f = (k + 1) as f32 * 2.7;
                        (f * s + waves[k]).sin() / f
                    });
                    y / whole[1] < base + 0.22 * ridge.sum::<f32>()
                });
                for _ in 0..below(rng, 9) {
                    let foot = put(tone(0.0, 1.0), base + tone(-0.15, 0.02));
                    let (tall, dark) = (edge * tone(0.03, 0.16), tone(0.03, 0.25));
                    let top = [foot[0], foot[1] + tall];
                    inside.stroke(foot, top, 0.1 * tall, dark);
                    inside.ellipse(top, [0.3 * tall, 0.5 * tall], 0.0, dark);
                }
            }
        }
        1 => {
            let (x, y) = (tone(0.35, 0.65), tone(0.5, 0.62));
            let (skin, hair, coat) = (tone(0.3, 0.8), tone(0.03, 0.5), tone(0.04, 0.8));
            inside.ellipse(put(x, -0.05), [0.42 * edge, 0.36 * edge], 0.0, coat);
            inside.ellipse(put(x, y + 0.04), [0.2 * edge, 0.25 * edge], 0.0, hair);
            inside.ellipse(put(x, y), [0.15 * edge, 0.2 * edge], 0.0, skin);
            let [cx, cy] = put(x, y);
            for side in [-1.0, 1.0] {
                let eye = [cx + side * 0.06 * edge, cy + 0.04 * edge];
                inside.ellipse(eye, [0.025 * edge, 0.014 * edge], 0.0, 0.05);
                let brow = [eye[0] - 0.03 * edge, eye[1] + 0.03 * edge];
                let end = [eye[0] + 0.03 * edge, eye[1] + 0.035 * edge];
                inside.stroke(brow, end, 0.012 * edge, hair);
            }
            let mouth = [cx - 0.05 * edge, cy - 0.1 * edge];
            let end = [cx + 0.05 * edge, cy - 0.095 * edge];
            inside.stroke(mouth, end, 0.018 * edge, 0.25 * skin);
            inside.stroke(
                [cx, cy],
                [cx + 0.02 * edge, cy - 0.04 * edge],
                0.01 * edge,
                0.5 * skin,
            );
        }
        2 => chart(&mut inside, rng),
        3 => map(&mut inside, rng),
        4 => {
            for _ in 0..4 + below(rng, 9) {
                let (centre, r) = (put(tone(0.0, 1.0), tone(0.0, 1.0)), edge * tone(0.05, 0.35));
                let (shade, turn) = (tone(0.04, 0.92), tone(0.0, 3.1));
                if below(rng, 2) == 0 {
                    inside.ellipse(centre, [r, r * tone(0.3, 1.0)], turn, shade);
                } else {
                    let corners: Vec<Corner> = (0..3 + below(rng, 3))
                        .map(|k| turn + k as f32 * 1.5)
                        .map(|t| [centre[0] + r * t.cos(), centre[1] + r * t.sin()])
                        .collect();
                    inside.polygon(&corners, shade);
                }
            }
        }
        _ => {
            inside.scatter(
                &Leaves {
                    coverage: 0.4,
                    largest_m: 0.3 * edge,
                    smallest_m: 0.03 * edge,
                    tones: [0.03, 0.92],
                },
                rng,
            );
            inside.add_noise(0.03, 0.5 * edge, [1.0, 1.0], rng.bits());
        }
    }
    canvas.paste(&inside, low);
}

fn chart(canvas: &mut Canvas, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let paper = uniform(rng, 0.7, 0.9);
    canvas.values.fill(paper);
    let (edge, face) = (w.min(h), Typeface::draw(rng));
    let thin = 0.008 * edge;
    canvas.stroke([0.12 * w, 0.12 * h], [0.94 * w, 0.12 * h], thin, 0.05);
    canvas.stroke([0.12 * w, 0.12 * h], [0.12 * w, 0.92 * h], thin, 0.05);
    let count = 4 + below(rng, 8);
    let is_line = below(rng, 2) == 0;
    let mut last: Option<Corner> = None;
    for k in 0..count {
        let x = w * (0.16 + 0.76 * k as f32 / count as f32);
        let y = h * uniform(rng, 0.2, 0.88);
        if is_line {
            if let Some(from) = last {
                canvas.stroke(from, [x, y], 2.0 * thin, 0.1);
            }
            canvas.ellipse([x, y], [2.0 * thin; 2], 0.0, 0.05);
            last = Some([x, y]);
        } else {
            let right = [x + 0.5 * w / count as f32, y];
            canvas.rectangle([x, 0.12 * h], right, uniform(rng, 0.08, 0.6));
        }
        let label = (2000 + below(rng, 30)).to_string();
        write(canvas, &face, &label, [x, 0.03 * h], 0.035 * edge, 0.05);
        let y = h * (0.2 + 0.7 * k as f32 / count as f32);
        canvas.stroke([0.12 * w, y], [0.94 * w, y], 0.3 * thin, 0.5);
    }
}

fn map(canvas: &mut Canvas, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let edge = w.min(h);
    canvas.values.fill(uniform(rng, 0.55, 0.8));
    for _ in 0..3 + below(rng, 4) {
        let centre = [uniform(rng, 0.0, w), uniform(rng, 0.0, h)];
        let axes = [
            uniform(rng, 0.05, 0.25) * edge,
            uniform(rng, 0.05, 0.2) * edge,
        ];
        canvas.ellipse(centre, axes, uniform(rng, 0.0, 3.0), uniform(rng, 0.3, 0.5));
    }
    let face = Typeface::draw(rng);
    for k in 0..14 + below(rng, 14) {
        let along = uniform(rng, 0.0, 1.0);
        let (from, to) = match k % 2 {
            0 => ([0.0, along * h], [w, (along + uniform(rng, -0.3, 0.3)) * h]),
            _ => ([along * w, 0.0], [(along + uniform(rng, -0.3, 0.3)) * w, h]),
        };
        let wide = edge * uniform(rng, 0.006, 0.025);
        canvas.stroke(from, to, 1.5 * wide, 0.2);
        canvas.stroke(from, to, wide, 0.9);
    }
    for _ in 0..6 {
        let foot = [uniform(rng, 0.0, 0.8) * w, uniform(rng, 0.05, 0.9) * h];
        write(canvas, &face, &words::name(rng), foot, 0.04 * edge, 0.05);
    }
}

/// The back of a book: bands across, a title and a name down.
pub(crate) fn spine(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    for _ in 0..below(rng, 3) {
        let (y, shade) = (uniform(rng, 0.0, h), uniform(rng, 0.05, 0.9));
        canvas.rectangle([0.0, y], [w, y + uniform(rng, 0.004, 0.03)], shade);
    }
    let face = Typeface::draw(rng);
    let large = w * uniform(rng, 0.3, 0.6);
    let (text, height_m) = fitting_title(rng, &face, 3, large, 0.66 * h);
    let line = |top: f32, height_m: f32| Line {
        foot: [0.5 * (w - height_m), top],
        along: [0.0, -1.0],
        height_m,
    };
    let ink = ink_on(tone);
    face.write(canvas, &text, &line(0.94 * h, height_m), ink);
    let name = words::name(rng);
    let small = (0.4 * w).min(0.4 * w * 0.2 * h / face.length_m(&name, 0.4 * w).max(1e-6));
    face.write(canvas, &name, &line(0.24 * h, small), ink);
}

/// A sign: an arrow and what is there; where it is as high as wide, a figure.
pub(crate) fn sign(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let ink = ink_on(tone);
    let thick = 0.09 * h;
    if w < 1.4 * h {
        // A flame and a bottle, or somebody who runs.
        let at = |a: f32, b: f32| [a * w, b * h];
        if below(rng, 2) == 0 {
            canvas.rectangle(at(0.25, 0.15), at(0.45, 0.65), ink);
            canvas.stroke(at(0.35, 0.65), at(0.35, 0.8), thick, ink);
            canvas.stroke(at(0.35, 0.78), at(0.55, 0.55), 0.5 * thick, ink);
            canvas.polygon(&[at(0.6, 0.15), at(0.85, 0.15), at(0.72, 0.6)], ink);
        } else {
            canvas.ellipse(at(0.55, 0.82), [0.08 * h; 2], 0.0, ink);
            let limbs = [
                [0.55, 0.72, 0.45, 0.42],
                [0.45, 0.42, 0.6, 0.15],
                [0.45, 0.42, 0.22, 0.25],
            ];
            let arms = [[0.54, 0.68, 0.75, 0.55], [0.54, 0.68, 0.3, 0.6]];
            for [a, b, c, d] in limbs.into_iter().chain(arms) {
                canvas.stroke(at(a, b), at(c, d), thick, ink);
            }
        }
        return;
    }
    let (middle, reach) = (0.5 * h, 0.28 * h);
    let tip = if below(rng, 2) == 0 {
        0.15 * h
    } else {
        0.15 * h + 2.0 * reach
    };
    let sense = if tip < 0.2 * h { 1.0 } else { -1.0 };
    canvas.stroke(
        [tip, middle],
        [tip + sense * 2.0 * reach, middle],
        thick,
        ink,
    );
    for side in [-1.0, 1.0] {
        let end = [tip + sense * 0.8 * reach, middle + side * 0.8 * reach];
        canvas.stroke([tip, middle], end, thick, ink);
    }
    let face = Typeface::draw(rng);
    let left = 0.5 * h + 2.0 * reach;
    let (text, height_m) = fitting_title(rng, &face, 4, 0.46 * h, w - left - 0.15 * h);
    write(
        canvas,
        &face,
        &text,
        [left, 0.5 * (h - height_m)],
        height_m,
        ink,
    );
}

/// What a computer shows: windows with text, tables and pictures over a background.
pub(crate) fn desktop(canvas: &mut Canvas, rng: &Dice) {
    let [w, h] = canvas.size_m();
    picture(canvas, [0.0; 2], [w, h], rng);
    let letters = (0.022 * h).max(0.005);
    for _ in 0..1 + below(rng, 3) {
        let low = [uniform(rng, 0.0, 0.35) * w, uniform(rng, 0.06, 0.3) * h];
        let high = [uniform(rng, 0.6, 1.0) * w, uniform(rng, 0.7, 1.0) * h];
        let paper = if below(rng, 3) == 0 { 0.08 } else { 0.86 };
        let bar = high[1] - 0.05 * h;
        canvas.rectangle(low, high, paper);
        canvas.rectangle([low[0], bar], high, uniform(rng, 0.15, 0.6));
        let face = Typeface::draw(rng);
        let foot = [low[0] + 0.01 * w, bar + 0.012 * h];
        write(
            canvas,
            &face,
            &words::title(rng, 2),
            foot,
            1.2 * letters,
            0.92,
        );
        let (inner, top) = ([low[0] + 0.015 * w, low[1] + 0.02 * h], bar - 0.015 * h);
        let corner = [high[0] - 0.015 * w, top];
        match below(rng, 4) {
            0 => table(canvas, inner, corner, 1.3 * letters, ink_on(paper), rng),
            1 => picture(canvas, inner, corner, rng),
            _ => paragraphs(canvas, inner, corner, letters, ink_on(paper), rng),
        }
    }
    canvas.rectangle([0.0, 0.0], [w, 0.045 * h], 0.07);
    for k in 0..8 {
        let x = (0.02 + 0.04 * k as f32) * w;
        let shade = uniform(rng, 0.2, 0.9);
        canvas.rectangle([x, 0.01 * h], [x + 0.02 * w, 0.035 * h], shade);
    }
}

/// Keys with letters on them.
pub(crate) fn keyboard(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let pitch = (w / 13.0).min(h / 5.0).max(0.008);
    let (columns, rows) = ((w / pitch) as usize, ((0.6 * h) / pitch) as usize);
    let key = (0.5 * tone).max(0.04);
    for i in 0..columns {
        for j in 0..rows {
            let low = [i as f32 * pitch + 0.1 * pitch, 0.36 * h + j as f32 * pitch];
            let high = [low[0] + 0.8 * pitch, low[1] + 0.8 * pitch];
            canvas.rectangle(low, high, key);
            let face = Typeface::draw(rng);
            let letter = char::from(b'A' + below(rng, 26) as u8).to_string();
            let foot = [low[0] + 0.2 * pitch, low[1] + 0.25 * pitch];
            write(canvas, &face, &letter, foot, 0.4 * pitch, 0.7);
        }
    }
    canvas.rectangle([0.33 * w, 0.05 * h], [0.67 * w, 0.3 * h], 0.8 * tone);
}

/// A parcel or a packet: a make, a label with an address and a bar code, tape.
pub(crate) fn parcel(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let (edge, face) = (w.min(h), Typeface::draw(rng));
    let ink = ink_on(tone);
    if below(rng, 2) == 0 {
        canvas.rectangle([0.44 * w, 0.0], [0.56 * w, h], (tone * 1.3).min(0.9));
    }
    let make = words::name(rng);
    let tall = (0.22 * h).min(0.22 * h * 0.8 * w / face.length_m(&make, 0.22 * h).max(1e-6));
    write(canvas, &face, &make, [0.1 * w, 0.68 * h], tall, ink);
    let low = [uniform(rng, 0.06, 0.3) * w, uniform(rng, 0.06, 0.16) * h];
    let high = [low[0] + 0.6 * w, low[1] + 0.42 * h];
    canvas.rectangle(low, high, 0.85);
    let mut x = low[0] + 0.04 * w;
    while x < high[0] - 0.04 * w {
        let bar = edge * uniform(rng, 0.004, 0.016);
        canvas.rectangle([x, low[1] + 0.03 * h], [x + bar, low[1] + 0.15 * h], 0.05);
        x += bar + edge * uniform(rng, 0.006, 0.016);
    }
    let inner = [low[0] + 0.04 * w, low[1] + 0.18 * h];
    let corner = [high[0] - 0.04 * w, high[1] - 0.03 * h];
    paragraphs(canvas, inner, corner, (0.045 * h).max(0.004), 0.06, rng);
}
