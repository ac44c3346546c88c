//! `lsfb completions`: what a shell needs to complete commands and options.

use clap::CommandFactory as _;
use clap_complete::{Shell, generate};

use crate::outcome::Outcome;
use crate::terminal;

/// Print a shell completion script.
///
/// Examples:
///   lsfb completions bash > ~/.local/share/bash-completion/completions/lsfb
///   lsfb completions zsh > ~/.zfunc/_lsfb
///   lsfb completions fish > ~/.config/fish/completions/lsfb.fish
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The shell to write completions for.
    shell: Shell,
}

/// Prints the script.
pub fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let mut script = Vec::new();
    let mut command = crate::Arguments::command();
    generate(arguments.shell, &mut command, "lsfb", &mut script);
    terminal::print_plain(String::from_utf8(script)?.trim_end())?;
    Ok(Outcome::Done)
}
