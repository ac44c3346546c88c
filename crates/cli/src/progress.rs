//! Progress on stderr: a bar with ETA on a terminal, a line every few seconds elsewhere.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use lsfb_types::Progress;

use crate::terminal;

/// Seconds between two lines where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// The stage of lines that are no progress.
const BOARD: &str = "board";

/// Shows [`Progress`]; one per command, shared by its stages, and one more for each part of it that runs beside others.
pub struct Display {
    state: Mutex<Shown>,
    /// Those of all parts.
    bars: MultiProgress,
    /// What each line begins with: the name of the part, if it is one.
    name: String,
    terminal: bool,
    quiet: bool,
}

struct Shown {
    stage: &'static str,
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Instant,
}

impl Display {
    /// Draws on stderr, so that stdout stays clean for `--json`; quiet, it remembers the stage and shows nothing.
    pub fn new(quiet: bool) -> Self {
        let bars = MultiProgress::with_draw_target(ProgressDrawTarget::stderr());
        Self::named(String::new(), bars, quiet)
    }

    /// For a part that runs beside others, whose lines begin with its name.
    pub fn part(&self, name: &str) -> Self {
        Self::named(format!("{name}: "), self.bars.clone(), self.quiet)
    }

    fn named(name: String, bars: MultiProgress, quiet: bool) -> Self {
        let now = Instant::now();
        Self {
            bars,
            name,
            state: Mutex::new(Shown {
                stage: "",
                bar: None,
                started: now,
                last_line: now,
            }),
            terminal: std::io::stderr().is_terminal(),
            quiet,
        }
    }

    /// What stages call.
    pub fn show(&self, progress: Progress) {
        let Ok(mut state) = self.state.lock() else {
            return;
        };
        if self.quiet {
            state.stage = progress.stage;
            return;
        }
        if state.stage != progress.stage {
            self.begin(&mut state, progress);
        }
        match &state.bar {
            Some(bar) => {
                bar.set_length(progress.total);
                bar.set_position(progress.done);
            }
            None if state.last_line.elapsed() >= LINE_EVERY => {
                state.last_line = Instant::now();
                self.print(&line(&state, progress));
            }
            None => {}
        }
    }

    /// Shows some lines in place of those shown before; elsewhere than on a terminal, the first of them every few seconds.
    pub fn show_board(&self, lines: &str) {
        if self.quiet {
            return;
        }
        let Ok(mut state) = self.state.lock() else {
            return;
        };
        if state.stage != BOARD {
            self.end(&mut state);
            state.stage = BOARD;
            state.started = Instant::now();
            state.last_line = state.started;
            if self.terminal {
                let bar = self.bars.add(ProgressBar::no_length());
                bar.set_style(
                    ProgressStyle::with_template("{msg}")
                        .unwrap_or_else(|_| ProgressStyle::default_bar()),
                );
                state.bar = Some(bar);
            }
        }
        match &state.bar {
            Some(bar) => bar.set_message(terminal::for_stderr(lines)),
            None if state.last_line.elapsed() >= LINE_EVERY => {
                state.last_line = Instant::now();
                self.print(lines.lines().next().unwrap_or_default());
            }
            None => {}
        }
    }

    /// What is being done; empty where nothing is.
    pub fn stage(&self) -> &'static str {
        self.state.lock().map_or("", |state| state.stage)
    }

    /// Ends the current stage's bar; call before printing results.
    pub fn finish(&self) {
        if let Ok(mut state) = self.state.lock()
            && !self.quiet
        {
            self.end(&mut state);
        }
    }

    /// A line of its own, after the current stage.
    pub fn say(&self, line: &str) {
        self.finish();
        self.print(line);
    }

    /// Above the bars of all parts.
    fn print(&self, line: &str) {
        let line = format!("{}{line}", self.name);
        self.bars.suspend(|| terminal::say(&line));
    }

    fn begin(&self, state: &mut Shown, progress: Progress) {
        self.end(state);
        state.stage = progress.stage;
        state.started = Instant::now();
        state.last_line = state.started;
        if self.terminal {
            let bar = self.bars.add(ProgressBar::new(progress.total));
            let bar_style = match terminal::stderr_is_coloured() {
                true => "bar:32.cyan",
                false => "bar:32",
            };
            let template =
                format!("{{msg:<28}} {{{bar_style}}} {{pos}}/{{len}} {{elapsed}} (ETA {{eta}})");
            bar.set_style(
                ProgressStyle::with_template(&template)
                    .unwrap_or_else(|_| ProgressStyle::default_bar()),
            );
            bar.set_message(format!("{}{}", self.name, progress.stage));
            state.bar = Some(bar);
        } else {
            state.bar = None;
        }
    }

    fn end(&self, state: &mut Shown) {
        if state.stage.is_empty() {
            return;
        }
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
            self.bars.remove(&bar);
        }
        let stage = std::mem::take(&mut state.stage);
        if stage != BOARD {
            let secs = state.started.elapsed().as_secs_f64();
            self.print(&format!("{stage:<28} {secs:6.1} s"));
        }
    }
}

/// A part that ends takes its bar with it.
impl Drop for Display {
    fn drop(&mut self) {
        self.finish();
    }
}

fn line(state: &Shown, progress: Progress) -> String {
    let elapsed = state.started.elapsed().as_secs_f64();
    if progress.total > 0 && progress.done > 0 {
        let eta =
            elapsed * (progress.total.saturating_sub(progress.done)) as f64 / progress.done as f64;
        format!(
            "{:<28} {}/{} ETA {eta:.0} s",
            progress.stage, progress.done, progress.total
        )
    } else {
        format!(
            "{:<28} {} after {elapsed:.0} s",
            progress.stage, progress.done
        )
    }
}
