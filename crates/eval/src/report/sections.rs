//! Sections of the page that show rather than list.

use lsfb_report::{SHADES, ink_css, rounded, scroll, significant, with_unit};
use maud::{Markup, html};

use super::errors_over_time::{self, Length, Part};
use super::histogram::{self, Histogram};
use super::{Report, course, cumulative, top_view};
use crate::statistics::Statistics;

pub(super) fn from_above(report: &Report) -> Markup {
    let Some(view) = top_view::draw(report) else {
        return html! {};
    };
    html! {
        section.above {
            h2 { @if let Some(axes) = &view.plane { "In the plane of " (axes) } @else { "From above" } }
            figure {
                (view.drawing)
                figcaption {
                    (legend(report))
                    @if report.tracks.iter().any(|t| t.truth.is_some()) {
                        span.key { span.line.truth { } "truth" }
                    }
                    @if let Some([low, high]) = view.heights_m {
                        span.key {
                            "map, height " (format!("{low:.1}").replace('-', "−")) "\u{a0}m "
                            span.ramp { @for i in 0..SHADES { span style=(format!("background:var(--shade{i})")) { } } }
                            " " (format!("{high:.1}").replace('-', "−")) "\u{a0}m"
                        }
                    }
                    span.key { "a dot marks the start" }
                }
            }
            @if !report.insets.is_empty() {
                div.pair {
                    @for (name, plot) in top_view::draw_insets(report) {
                        figure { (plot.draw()) figcaption { span.key { (name) } } }
                    }
                }
            }
        }
    }
}

fn legend(report: &Report) -> Markup {
    html! {
        @for (i, track) in report.tracks.iter().enumerate() {
            @if report.tracks[..i].iter().all(|before| before.name != track.name || track.series.is_none()) {
                span.key { span.line style=(format!("border-color:{}", ink_css(track.series.unwrap_or(i)))) { } (track.name) }
            }
        }
    }
}

pub(super) fn errors(report: &Report) -> Markup {
    let tracks = &report.tracks;
    let translation = errors_over_time::draw(tracks, Part::Translation);
    let rotation = errors_over_time::draw(tracks, Part::Rotation);
    let length = Length::of(tracks);
    let lengths: Vec<Vec<f64>> = tracks
        .iter()
        .map(|t| {
            let errors = t.errors.iter();
            errors.map(|e| length.of_metres(e.translation_m)).collect()
        })
        .collect();
    let series: Vec<&[f64]> = lengths.iter().map(Vec::as_slice).collect();
    let spread = histogram::draw(
        "distribution of translation errors",
        &format!("translation error ({})", length.unit()),
        &series,
    );
    let plot = |heading: &str, drawing: &Markup| {
        html! {
            section {
                h2 { (heading) }
                figure { (drawing) figcaption { (legend(report)) } }
            }
        }
    };
    html! {
        @if let Some(translation) = translation {
            (plot("Translation error over time", &translation))
            // Positions alone have no rotation error, not one of zero.
            @if let Some(rotation) = rotation { (plot("Rotation error over time", &rotation)) }
            @if let Some(shares) = cumulative::draw(tracks) { (plot("Share of poses by translation error", &shares)) }
            @if let Some(spread) = spread {
                section {
                    h2 { "Distribution of translation errors" }
                    figure {
                        (spread.drawing)
                        figcaption {
                            @for (i, track) in tracks.iter().enumerate() {
                                span.key {
                                    span.line style=(format!("border-color:{}", ink_css(i))) { }
                                    (track.name)
                                    @if let Some(s) = spread.statistics.get(i).copied().flatten() { ": " (in_words(&s, length.unit())) }
                                }
                            }
                            (beyond(&spread))
                        }
                    }
                }
            }
        }
    }
}

fn in_words(s: &Statistics, unit: &str) -> String {
    format!(
        "rms {}, median {}, max {}",
        with_unit(&rounded(s.rmse), unit),
        with_unit(&rounded(s.median), unit),
        with_unit(&rounded(s.max), unit)
    )
}

fn beyond(histogram: &Histogram) -> Markup {
    html! {
        @if histogram.beyond >= 5e-4 {
            span.key { (format!("{:.1}", 100.0 * histogram.beyond)) "\u{a0}% lie beyond the right edge" }
        }
    }
}

pub(super) fn courses(report: &Report) -> Markup {
    let drawn = report.courses.iter();
    let drawn = drawn.filter_map(|course| Some((course, course::draw(course)?)));
    html! {
        @for (course, drawing) in drawn {
            section { h2 { (course.title) } figure { (drawing) } }
        }
    }
}

pub(super) fn distributions(report: &Report) -> Markup {
    let drawn = report.histograms.iter().filter_map(|distribution| {
        let label = match distribution.unit.as_str() {
            "" => distribution.quantity.clone(),
            unit => format!("{} ({unit})", distribution.quantity),
        };
        let values: &[f64] = &distribution.values;
        Some((
            distribution,
            histogram::draw(&distribution.title, &label, &[values])?,
        ))
    });
    html! {
        @for (distribution, histogram) in drawn {
            section {
                h2 { (distribution.title) }
                figure {
                    (histogram.drawing)
                    figcaption {
                        @if let Some(s) = histogram.statistics.first().copied().flatten() {
                            span.key { (in_words(&s, &distribution.unit)) " over " (significant(s.count as f64)) " values" }
                        }
                        (beyond(&histogram))
                    }
                }
            }
        }
    }
}

pub(super) fn stages(report: &Report) -> Markup {
    let longest = report
        .stages
        .iter()
        .map(|s| s.wall_secs)
        .fold(0.0, f64::max)
        .max(1e-9);
    let total: f64 = report.stages.iter().map(|s| s.wall_secs).sum();
    let table = html! {
        table {
            tbody {
                @for stage in &report.stages {
                    tr {
                        th scope="row" { (stage.name) }
                        td.bar { span style=(format!("width:{:.1}%", (100.0 * stage.wall_secs / longest).clamp(0.0, 100.0))) { } }
                        td.number { (format!("{:.1}", stage.wall_secs)) "\u{a0}s" }
                    }
                }
            }
            tfoot { tr { th scope="row" { "total" } td { } td.number { (format!("{total:.1}")) "\u{a0}s" } } }
        }
    };
    html! {
        @if !report.stages.is_empty() {
            section.stages { h2 { "Time per stage" } (scroll(&table)) }
        }
    }
}
