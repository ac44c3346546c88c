//! A page with plots and a view in space, as somebody uses it: values under the pointer, a closer look, the scene turned and enlarged,
//! on a screen and on a phone.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use crate::chromium::Tab;
use crate::process::lsfb;
use lsfb_tests::{Lacks, skip};
use serde_json::{Value, json};

/// A minute of walking in circles, with errors of some centimetres.
fn write_walk(path: &Path, error_m: f64) {
    let mut text = String::new();
    for i in 0..600 {
        let t = f64::from(i) * 0.1;
        let (sine, cosine) = (0.2 * t).sin_cos();
        let off = error_m * (1.7 * t).sin();
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{t:.3} {} {} {} 0 0 0 1",
            4.0 * cosine + off,
            3.0 * sine,
            0.05 * t
        );
    }
    std::fs::write(path, text).expect("walk");
}

/// Where a share of an element lies in the window.
fn place(tab: &mut Tab, selector: &str, [x, y]: [f64; 2]) -> [f64; 2] {
    let at = tab.value(&format!(
        "(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'center' }}); \
         const r = e.getBoundingClientRect(); return [r.x + {x} * r.width, r.y + {y} * r.height]; }})()"
    ));
    [0, 1].map(|axis| at[axis].as_f64().expect("a number"))
}

/// What the canvas shows once it is drawn anew.
fn picture(tab: &mut Tab) -> Value {
    tab.value("window.drawn = false; requestAnimationFrame(() => requestAnimationFrame(() => { window.drawn = true; }))");
    tab.wait_for("window.drawn");
    tab.value("document.querySelector('figure.scene canvas').toDataURL()")
}

/// Every drawing comes out as a file of its own, an SVG without the page's style sheet and a PNG that is not blank.
fn drawings_are_saved(tab: &mut Tab) {
    tab.value(
        "window.saved = []; HTMLAnchorElement.prototype.click = function () { \
         const name = this.download; fetch(this.href).then((r) => r.blob()).then(async (blob) => { \
         const text = blob.type === 'image/svg+xml' ? await blob.text() : ''; \
         const shades = new Set(); let width = 0; \
         if (blob.type === 'image/png') { const picture = await createImageBitmap(blob); width = picture.width; \
         const canvas = new OffscreenCanvas(picture.width, picture.height); const context = canvas.getContext('2d'); \
         context.drawImage(picture, 0, 0); const data = context.getImageData(0, 0, picture.width, picture.height).data; \
         for (let i = 0; i < data.length; i += 4) { shades.add(data[i] * 65536 + data[i + 1] * 256 + data[i + 2]); \
         if (data[i + 3] !== 255) shades.add('clear'); } } \
         window.saved.push({ name, text, width, shades: shades.size, clear: shades.has('clear') }); }); }; 0",
    );
    let press = |selector: &str| {
        format!(
            "document.querySelectorAll('{selector} > .save button').forEach((b) => b.click()); 0"
        )
    };
    tab.value(&press(".plot"));
    tab.value(&press("figure.scene"));
    tab.wait_for(
        "window.saved.length === document.querySelectorAll('.plot > .save button, figure.scene > .save button').length",
    );
    let saved = tab.value("window.saved");
    let saved = saved.as_array().expect("files");
    assert!(saved.len() >= 3, "{} files", saved.len());
    for file in saved {
        let name = file["name"].as_str().expect("a name");
        if name.ends_with(".svg") {
            let text = file["text"].as_str().expect("text");
            assert!(text.starts_with("<svg xmlns="), "{name}: {text}");
            assert!(!text.contains("var(--"), "{name}: {text}");
        } else {
            assert!(name.ends_with(".png"), "{name}");
            assert!(file["width"].as_u64() > Some(300), "{file}");
            assert!(file["shades"].as_u64() > Some(4), "{file}");
            assert_eq!(file["clear"], json!(false), "{file}");
        }
    }
}

#[test]
fn plots_and_scene_answer_the_pointer_and_fit_a_phone() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    write_walk(&root.join("truth.tum"), 0.0);
    write_walk(&root.join("walk.tum"), 0.05);
    let arguments = [
        "eval",
        "walk.tum",
        "--truth",
        "truth.tum",
        "--out",
        "page.html",
    ];
    let made = lsfb(root, &arguments);
    assert!(
        made.status.success(),
        "{}",
        String::from_utf8_lossy(&made.stderr)
    );
    let page = root.join("page.html");
    let Some(mut tab) = Tab::open(&format!("file://{}", page.display())) else {
        let test = "plots_and_scene_answer_the_pointer_and_fit_a_phone";
        return skip(test, Lacks::Program, "no Chromium is installed");
    };
    tab.wait_for("document.readyState === 'complete' && document.querySelector('.plot svg')");
    // Nothing is loaded from anywhere.
    assert_eq!(
        tab.value("performance.getEntriesByType('resource').length"),
        json!(0)
    );

    // On a phone nothing is wider than the window but what scrolls by itself.
    let wide = "document.documentElement.scrollWidth > innerWidth";
    assert_eq!(tab.value("innerWidth"), json!(390));
    assert_eq!(tab.value(wide), json!(false), "on a phone");
    tab.resize(1280, 900);
    assert_eq!(tab.value(wide), json!(false), "on a screen");

    // The value under the pointer is that of the axes: farther to the right it is later.
    let note = "document.querySelector('.plot output')";
    let plot = ".plot svg";
    assert_eq!(tab.value(&format!("{note}.hidden")), json!(true));
    let mut values = [0.4, 0.8].map(|x| {
        let at = place(&mut tab, plot, [x, 0.5]);
        tab.mouse("mouseMoved", at, &json!({}));
        tab.wait_for(&format!("!{note}.hidden"));
        let said = tab.value(&format!("{note}.textContent"));
        let said = said.as_str().expect("text").to_owned();
        let first = said.split([' ', ',']).next().map(str::parse::<f64>);
        first
            .and_then(Result::ok)
            .unwrap_or_else(|| panic!("{said}"))
    });
    assert!(values[0] < values[1], "{values:?}");
    values.reverse();

    // A part that is marked fills the plot; a double click shows the whole again.
    let whole = tab.value(&format!(
        "document.querySelector('{plot}').getAttribute('viewBox')"
    ));
    let from = place(&mut tab, plot, [0.3, 0.3]);
    let to = place(&mut tab, plot, [0.6, 0.7]);
    let button = json!({ "button": "left", "buttons": 1, "clickCount": 1 });
    tab.mouse("mousePressed", from, &button);
    tab.mouse("mouseMoved", to, &button);
    tab.mouse("mouseReleased", to, &button);
    tab.wait_for("document.querySelector('.plot.zoomed')");
    let part = tab.value(&format!(
        "document.querySelector('{plot}').getAttribute('viewBox')"
    ));
    let width = |view: &Value| -> f64 {
        let parts = view.as_str().expect("a view").split_whitespace();
        parts
            .map(|p| p.parse().expect("a number"))
            .nth(2)
            .expect("a width")
    };
    assert!(width(&part) < 0.5 * width(&whole), "{part} of {whole}");
    // There the pointer is still at the value that is under it.
    let middle = place(&mut tab, plot, [0.5, 0.5]);
    tab.mouse("mouseMoved", middle, &json!({}));
    let said = tab.value(&format!("{note}.textContent"));
    let said = said.as_str().expect("text").to_owned();
    let inside: f64 = said
        .split([' ', ','])
        .next()
        .expect("a value")
        .parse()
        .expect("a number");
    let [late, early] = values;
    assert!(
        inside > early - (late - early) && inside < late,
        "{said}: {early} to {late}"
    );
    for count in [1, 2] {
        let button = json!({ "button": "left", "buttons": 1, "clickCount": count });
        tab.mouse("mousePressed", middle, &button);
        tab.mouse("mouseReleased", middle, &button);
    }
    tab.wait_for("!document.querySelector('.plot.zoomed')");
    let again = tab.value(&format!(
        "document.querySelector('{plot}').getAttribute('viewBox')"
    ));
    assert_eq!(again, whole);

    // The scene is turned by dragging and enlarged by Ctrl and the wheel; a double click resets it.
    let scene = "figure.scene canvas";
    let middle = place(&mut tab, scene, [0.5, 0.5]);
    let first = picture(&mut tab);
    let button = json!({ "button": "left", "buttons": 1, "clickCount": 1 });
    tab.mouse("mousePressed", middle, &button);
    tab.mouse("mouseMoved", [middle[0] + 60.0, middle[1] + 30.0], &button);
    tab.mouse(
        "mouseReleased",
        [middle[0] + 60.0, middle[1] + 30.0],
        &button,
    );
    let turned = picture(&mut tab);
    assert!(turned != first, "turned");
    let wheel = |modifiers: u32| json!({ "deltaX": 0, "deltaY": -200, "modifiers": modifiers });
    tab.mouse("mouseWheel", middle, &wheel(2));
    let enlarged = picture(&mut tab);
    assert!(enlarged != turned, "enlarged");
    for count in [1, 2] {
        let button = json!({ "button": "left", "buttons": 1, "clickCount": count });
        tab.mouse("mousePressed", middle, &button);
        tab.mouse("mouseReleased", middle, &button);
    }
    assert!(picture(&mut tab) == first, "reset");
    assert!(tab.screenshot(&root.join("page.png")) > 10_000);
    drawings_are_saved(&mut tab);
    // What was set is folded away until somebody wants it.
    place(&mut tab, "summary", [0.5, 0.5]);
    tab.press("summary", Duration::from_millis(30));
    tab.wait_for("document.querySelector('details').open");
}
