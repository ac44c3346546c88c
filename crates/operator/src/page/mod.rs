//! The page's files, part of the binary: no internet is needed, and no folder.

/// A file of the page.
pub(crate) struct PageFile {
    pub media_type: &'static str,
    pub body: &'static str,
}

/// The file of that name; `None` where there is none.
pub(crate) fn file(name: &str) -> Option<PageFile> {
    let (media_type, body) = match name {
        "" | "index.html" => ("text/html; charset=utf-8", include_str!("index.html")),
        "style.css" => ("text/css; charset=utf-8", include_str!("style.css")),
        "screen.js" => ("text/javascript; charset=utf-8", include_str!("screen.js")),
        "map.js" => ("text/javascript; charset=utf-8", include_str!("map.js")),
        "cameras.js" => ("text/javascript; charset=utf-8", include_str!("cameras.js")),
        "icon.svg" => ("image/svg+xml", include_str!("icon.svg")),
        "manifest.json" => ("application/manifest+json", include_str!("manifest.json")),
        _ => return None,
    };
    Some(PageFile { media_type, body })
}
