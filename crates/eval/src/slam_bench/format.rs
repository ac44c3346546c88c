//! A marked table as text, CSV, LaTeX and HTML.

use lsfb_report::{Page, scroll};
use maud::{Markup, html};

use super::table::{ColumnCount, Figure, MarkedTable, Metric};

impl Metric {
    fn label(self) -> &'static str {
        match self {
            Self::Se3 => "ATE SE(3)",
            Self::Scale => "scale error",
            Self::Sim3 => "ATE Sim(3)",
        }
    }
}

impl Figure {
    fn digits(&self) -> String {
        self.value.map_or("×".to_owned(), |v| format!("{v:.3}"))
    }
}

/// A count, and whether no other is larger.
type Count = fn(&ColumnCount) -> (usize, bool);

/// The two rows below the sequences.
const FOOTER: [(&str, Count); 2] = [
    ("#succ.", |c| (c.succeeded, c.is_most_robust)),
    ("#best", |c| (c.best, c.is_most_accurate)),
];

impl MarkedTable {
    fn count_of(&self, system: usize, metric: Metric) -> Option<&ColumnCount> {
        self.counts
            .iter()
            .find(|c| c.system == system && c.metric == metric)
    }

    /// For a terminal: grey figures in brackets, the best with a star.
    pub fn to_text(&self) -> String {
        const LEAST_WIDTH: usize = 14;
        // The name of a system stands once over its columns, which are as wide as that takes.
        let columns_of = |system: usize| self.columns.iter().filter(|(s, _)| *s == system).count();
        let widths = self.systems.iter().enumerate().map(|(system, of)| {
            let name = of.name.chars().count() + 2;
            LEAST_WIDTH.max(name.div_ceil(columns_of(system).max(1)))
        });
        let width = widths.fold(LEAST_WIDTH, usize::max);
        let names = self
            .rows
            .iter()
            .map(|(sequence, _)| sequence.chars().count() + 1);
        let first = names.fold(10, usize::max);
        let mut out = format!(
            "{} (ATE in m, scale error in %; (…) unreliable, * best)\n{:<first$}",
            self.title, ""
        );
        for own in self.columns.chunk_by(|a, b| a.0 == b.0) {
            let all = width * own.len();
            let name = own
                .first()
                .and_then(|(system, _)| self.systems.get(*system));
            out += &format!("{:>all$}", name.map_or("", |of| of.name.as_str()));
        }
        out += &format!("\n{:<first$}", "");
        for (_, metric) in &self.columns {
            out += &format!("{:>width$}", metric.label());
        }
        out.push('\n');
        for (sequence, figures) in &self.rows {
            out += &format!("{sequence:<first$}");
            for figure in figures {
                let digits = figure.digits();
                let marked = match (figure.is_grey, figure.is_bold) {
                    (true, _) => format!("({digits})"),
                    (false, true) => format!("{digits}*"),
                    (false, false) => format!("{digits} "),
                };
                out += &format!("{marked:>width$}");
            }
            out.push('\n');
        }
        for (name, of) in FOOTER {
            out += &format!("{name:<first$}");
            for (system, metric) in &self.columns {
                let cell = self.count_of(*system, *metric).map(of);
                let text = cell.map_or(String::new(), |(n, most)| {
                    format!("{n}{}", if most { "*" } else { " " })
                });
                out += &format!("{text:>width$}");
            }
            out.push('\n');
        }
        for (sequence, system, cause) in &self.failures {
            out += &format!("× {sequence} {system}: {cause}\n");
        }
        for (sequence, system, remark) in &self.remarks {
            out += &format!("! {sequence} {system}: {remark}\n");
        }
        out
    }

    /// One line per sequence, system and metric.
    pub fn to_csv(&self) -> String {
        let mut out = "sequence,system,metric,value,unreliable,best\n".to_owned();
        for (sequence, figures) in &self.rows {
            for (figure, (system, metric)) in figures.iter().zip(&self.columns) {
                let value = figure.value.map_or(String::new(), |v| v.to_string());
                out += &format!(
                    "{},{},{},{value},{},{}\n",
                    quoted(sequence),
                    quoted(&self.systems[*system].name),
                    metric.label(),
                    figure.is_grey,
                    figure.is_bold
                );
            }
        }
        for count in &self.counts {
            let system = quoted(&self.systems[count.system].name);
            let metric = count.metric.label();
            out += &format!(
                "#succ.,{system},{metric},{},,{}\n",
                count.succeeded, count.is_most_robust
            );
            out += &format!(
                "#best,{system},{metric},{},,{}\n",
                count.best, count.is_most_accurate
            );
        }
        out
    }

    /// A `tabular` for papers; it needs `xcolor` with its option `table`.
    pub fn to_latex(&self) -> String {
        let mut out = format!("% {}\n\\begin{{tabular}}{{l", escaped_comment(&self.title));
        out += &"r".repeat(self.columns.len());
        out += "}\n\\hline\n";
        for (i, system) in self.systems.iter().enumerate() {
            let width = self.columns.iter().filter(|(s, _)| *s == i).count();
            out += &format!(
                " & \\multicolumn{{{width}}}{{c}}{{{}}}",
                escaped(&system.name)
            );
        }
        out += " \\\\\n";
        for (_, metric) in &self.columns {
            out += match metric {
                Metric::Se3 => " & ATE$_{SE(3)}$",
                Metric::Scale => " & scale error",
                Metric::Sim3 => " & ATE$_{Sim(3)}$",
            };
        }
        out += " \\\\\n\\hline\n";
        for (sequence, figures) in &self.rows {
            out += &escaped(sequence);
            for figure in figures {
                let digits = figure
                    .value
                    .map_or("$\\times$".to_owned(), |v| format!("{v:.3}"));
                out += &match (figure.is_grey, figure.is_bold) {
                    (true, _) => format!(" & \\cellcolor{{gray!30}}{digits}"),
                    (false, true) => format!(" & \\textbf{{{digits}}}"),
                    (false, false) => format!(" & {digits}"),
                };
            }
            out += " \\\\\n";
        }
        out += "\\hline\n";
        for (name, of) in FOOTER {
            out += &escaped(name);
            for (system, metric) in &self.columns {
                out += &match self.count_of(*system, *metric).map(of) {
                    Some((n, true)) => format!(" & \\textbf{{{n}}}"),
                    Some((n, false)) => format!(" & {n}"),
                    None => " &".to_owned(),
                };
            }
            out += " \\\\\n";
        }
        out + "\\hline\n\\end{tabular}\n"
    }

    /// A page of its own.
    pub fn page(&self) -> Page {
        Page::new(self.title.clone()).body(self.section())
    }

    fn section(&self) -> Markup {
        let figure = |figure: &Figure| {
            html! {
                @let style = if figure.is_grey { "opacity:0.45" } else { "" };
                td.number style=(style) {
                    @if figure.is_bold { b { (figure.digits()) } } @else { (figure.digits()) }
                }
            }
        };
        let table = html! {
            table {
                thead {
                    tr {
                        th { }
                        @for (i, system) in self.systems.iter().enumerate() {
                            th.number colspan=(self.columns.iter().filter(|(s, _)| *s == i).count()) { (system.name) }
                        }
                    }
                    tr {
                        th { "sequence" }
                        @for (_, metric) in &self.columns { th.number { (metric.label()) } }
                    }
                }
                tbody {
                    @for (sequence, figures) in &self.rows {
                        tr { th scope="row" { (sequence) } @for one in figures { (figure(one)) } }
                    }
                }
                tfoot {
                    @for (name, of) in FOOTER {
                        tr {
                            th scope="row" { (name) }
                            @for (system, metric) in &self.columns {
                                td.number {
                                    @if let Some((n, is_most)) = self.count_of(*system, *metric).map(of) {
                                        @if is_most { b { (n) } } @else { (n) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        };
        html! {
            section {
                (scroll(&table))
                p { "ATE in m, scale error in %; pale: error above 10 % of the longer side, or scale error above 10 %; bold: best." }
            }
            @if !self.failures.is_empty() {
                section {
                    h2 { "Failed" }
                    ul { @for (sequence, system, cause) in &self.failures { li { (sequence) ", " (system) ": " (cause) } } }
                }
            }
            @if !self.remarks.is_empty() {
                section {
                    h2 { "Needs attention" }
                    ul { @for (sequence, system, remark) in &self.remarks { li { (sequence) ", " (system) ": " (remark) } } }
                }
            }
        }
    }
}

fn quoted(text: &str) -> String {
    match text.contains([',', '"', '\n']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}

fn escaped(text: &str) -> String {
    text.chars()
        .flat_map(|c| match c {
            '\\' => "\\textbackslash{}".chars().collect::<Vec<_>>(),
            '~' => "\\textasciitilde{}".chars().collect(),
            '^' => "\\textasciicircum{}".chars().collect(),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => vec!['\\', c],
            c if c.is_control() => vec![' '],
            c => vec![c],
        })
        .collect()
}

/// A comment ends with its line.
fn escaped_comment(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}
