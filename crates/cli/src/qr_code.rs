//! Links as pictures on the terminal, for a phone's camera.

use qrcodegen::{QrCode, QrCodeEcc};

/// Empty modules around a QR code.
const QUIET_ZONE: i32 = 4;

/// A text as a QR code in lines of text; empty where it is too long for one.
pub fn of(text: &str) -> String {
    QrCode::encode_text(text, QrCodeEcc::Medium)
        .map(|code| picture(&code))
        .unwrap_or_default()
}

/// Two rows of modules in each line of text, dark on light whatever the terminal's colours.
fn picture(code: &QrCode) -> String {
    let range = -QUIET_ZONE..code.size() + QUIET_ZONE;
    let mut text = String::new();
    for y in range.clone().step_by(2) {
        for x in range.clone() {
            let is_light = |y| !code.get_module(x, y);
            text.push(match (is_light(y), is_light(y + 1)) {
                (true, true) => '█',
                (true, false) => '▀',
                (false, true) => '▄',
                (false, false) => ' ',
            });
        }
        text.push('\n');
    }
    text
}
