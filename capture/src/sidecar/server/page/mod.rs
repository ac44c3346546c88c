//! The page that makes any phone with a browser a sidecar: its files, part of the binary. It speaks the protocol of the other apps.
//!
//! Nothing secret is in it: the invitation comes in the part of the link that browsers send to nobody.

use lsfb_web::{Answer, StatusCode, file_of, under};

/// What the page may do: load itself, and talk to this rig.
const POLICY: &str = "default-src 'self'; connect-src 'self' wss:; img-src 'self' data:; media-src 'self' blob: mediastream:; frame-ancestors 'none'";

/// The file of that name; `None` where there is none.
pub(super) fn file(name: &str) -> Option<Answer> {
    const SCRIPT: &str = "text/javascript; charset=utf-8";
    let (media_type, body) = match name {
        "" | "index.html" => ("text/html; charset=utf-8", include_str!("index.html")),
        "style.css" => ("text/css; charset=utf-8", include_str!("style.css")),
        "sidecar.js" => (SCRIPT, include_str!("sidecar.js")),
        "spool.js" => (SCRIPT, include_str!("spool.js")),
        "link.js" => (SCRIPT, include_str!("link.js")),
        "sensors.js" => (SCRIPT, include_str!("sensors.js")),
        "wire.js" => (SCRIPT, include_str!("wire.js")),
        _ => return None,
    };
    Some(under(POLICY, file_of(StatusCode::OK, media_type, body)))
}
