//! The frame of all pages.

use lsfb_types::Judgement;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::findings;

pub(crate) const STYLE: &str = include_str!("style.css");
const SCRIPTS: [&str; 3] = [
    include_str!("plot.js"),
    include_str!("scene.js"),
    include_str!("save.js"),
];

/// A page: a title, a verdict, what is to be seen, and folded away where it comes from.
#[derive(Clone, Debug, Default)]
pub struct Page {
    title: String,
    verdict: Markup,
    body: Markup,
    settings: Vec<(String, String)>,
}

impl Page {
    /// A page without anything but a title.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            ..Self::default()
        }
    }

    /// With a verdict at the top; `summary` says in a few words what was judged.
    pub fn judged(self, judgement: &Judgement, summary: &str) -> Self {
        Self {
            verdict: findings::draw(judgement, summary),
            ..self
        }
    }

    /// With what is to be seen, mostly sections.
    pub fn body(self, body: Markup) -> Self {
        Self { body, ..self }
    }

    /// With settings, versions and hashes: name and value, which may have several lines.
    pub fn settings(self, settings: Vec<(String, String)>) -> Self {
        Self { settings, ..self }
    }

    /// The page as text.
    pub fn to_html(&self) -> String {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    header { h1 { (self.title) } (self.verdict) }
                    main { (self.body) (self.folded_settings()) }
                    @for script in SCRIPTS { script { (PreEscaped(script)) } }
                }
            }
        };
        page.into_string()
    }

    fn folded_settings(&self) -> Markup {
        html! {
            @if !self.settings.is_empty() {
                details.settings {
                    summary { "Settings and inputs" }
                    dl {
                        @for (name, value) in &self.settings {
                            dt { (name) }
                            dd { pre { (value) } }
                        }
                    }
                }
            }
        }
    }
}

/// A table, or whatever is wide, that scrolls sideways by itself where the screen is narrow.
pub fn scroll(wide: &Markup) -> Markup {
    html! { div.scroll tabindex="0" { (wide) } }
}

#[cfg(test)]
mod tests {
    use lsfb_types::{Finding, Verdict};

    use super::*;
    use crate::png;

    #[test]
    fn hostile_words_stay_words() {
        let hostile = "<script>alert(1)</script>";
        let found = Finding::new("x", Verdict::Fail, hostile, hostile).remedy(hostile);
        let page = Page::new(hostile)
            .judged(&Judgement::new(vec![found]), hostile)
            .settings(vec![(hostile.to_owned(), hostile.to_owned())])
            .to_html();
        assert!(!page.contains("<script>alert"), "{page}");
        assert!(page.contains("verdict fail"));
    }

    /// A page that fetched anything would be blank in the field, and tell somebody that it was opened.
    #[test]
    fn nothing_is_fetched() {
        let page = Page::new("x").body(png(&[0, 159, 146], "x")).to_html();
        assert!(page.contains(r#"<img src="data:image/png;base64,AJ+S" alt="x">"#));
        let page = page.replace(r#"src="data:"#, "");
        for part in ["http:", "https:", "src=", "@import", "fetch(", "url("] {
            assert!(!page.contains(part), "{part}");
        }
    }
}
