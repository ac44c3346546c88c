//! What the help of all commands has in common.

use std::collections::BTreeMap;

use clap::error::ErrorKind;
use clap::{Arg, Command, CommandFactory};

use crate::Arguments;

/// All commands with their names, subcommands of subcommands among them, without clap's own `help`.
fn commands() -> Vec<(String, Command)> {
    fn add(name: &str, command: &Command, all: &mut Vec<(String, Command)>) {
        all.push((name.to_owned(), command.clone()));
        for inner in command.get_subcommands().filter(|c| c.get_name() != "help") {
            add(&format!("{name} {}", inner.get_name()), inner, all);
        }
    }
    let mut root = Arguments::command();
    root.build();
    let mut all = Vec::new();
    add("lsfb", &root, &mut all);
    all
}

/// `--name` and what it takes, of every option that takes something.
fn options(command: &Command) -> impl Iterator<Item = (&Arg, &str, String)> {
    command.get_arguments().filter_map(|argument| {
        let takes = argument.get_action().takes_values();
        let names = argument.get_value_names().unwrap_or_default();
        let value = names.first().filter(|_| takes)?.to_string();
        Some((argument, argument.get_long()?, value))
    })
}

#[test]
fn every_command_shows_examples() {
    for (name, mut command) in commands() {
        let help = command.render_long_help().to_string();
        let examples = help.split("Examples").nth(1).unwrap_or_default();
        assert!(examples.contains("\n  lsfb "), "{name}: {help}");
    }
}

/// The examples are what people copy: each must parse.
#[test]
fn every_example_parses() {
    for (name, mut command) in commands() {
        let help = command.render_long_help().to_string();
        for line in help.lines().filter(|line| line.starts_with("  lsfb ")) {
            // Neither the comment behind it nor what is done with its output.
            let words = line.split(['#', '>']).next().unwrap_or_default();
            for part in words.split("&&") {
                let words = part.split_whitespace().map(|w| w.trim_matches('\''));
                let parsed = Arguments::command().try_get_matches_from(words);
                assert!(parsed.is_ok(), "{name}: {part}: {:?}", parsed.err());
            }
        }
    }
}

/// Commands of the documentation: those of `sh` blocks, and of the figures' table. What a shell would put in is left out.
fn documented() -> Vec<(String, String)> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../");
    let mut found = Vec::new();
    for name in [
        "README.md",
        "docs/calibration.md",
        "docs/dataset.md",
        "docs/devices.md",
        "docs/odometry.md",
        "docs/twin.md",
        "docs/from/colmap.md",
        "docs/from/euroc.md",
        "docs/from/phone.md",
        "docs/from/ros2-bag.md",
        "docs/from/slam.md",
        "docs/figures.md",
    ] {
        let text = std::fs::read_to_string(format!("{root}{name}")).expect("documentation");
        let blocks = text
            .split("```sh\n")
            .skip(1)
            .filter_map(|rest| rest.split("```").next());
        let mut lines: Vec<String> = blocks
            .flat_map(|block| {
                block
                    .replace("\\\n", " ")
                    .lines()
                    .map(str::to_owned)
                    .collect::<Vec<_>>()
            })
            .collect();
        // Odd pieces between backquotes are code.
        lines.extend(
            text.split('`')
                .skip(1)
                .step_by(2)
                .map(|code| code.replace('\n', " ")),
        );
        for line in lines {
            let is_whole =
                !line.contains("STEP") && !line.contains(['…', '(', ')', '{', '[', ';', '|', '\'']);
            if is_whole && line.trim_start().starts_with("lsfb ") && line.contains(" --") {
                found.push((name.to_owned(), line));
            }
        }
    }
    found
}

#[test]
fn every_command_in_the_documentation_parses() {
    let commands = documented();
    assert!(commands.len() > 20, "{commands:?}");
    for (name, line) in commands {
        for part in line
            .split("&&")
            .map(|part| part.split(['#', '>']).next().unwrap_or_default())
        {
            let parsed = Arguments::command().try_get_matches_from(part.split_whitespace());
            // Values may be placeholders; commands and options may not.
            let unknown = parsed.err().filter(|error| {
                matches!(
                    error.kind(),
                    ErrorKind::UnknownArgument | ErrorKind::InvalidSubcommand
                )
            });
            assert!(unknown.is_none(), "{name}: {part}: {unknown:?}");
        }
    }
}

/// Commands of the README's table: those that stand behind another in a cell are of the same parent.
fn listed() -> Vec<String> {
    let readme = concat!(env!("CARGO_MANIFEST_DIR"), "/../../README.md");
    let text = std::fs::read_to_string(readme).expect("README.md");
    let mut names = Vec::new();
    for row in text.lines().filter(|line| line.starts_with("| `lsfb ")) {
        let cell = row.split('|').nth(1).unwrap_or_default();
        let mut parent = String::new();
        for code in cell.split('`').skip(1).step_by(2) {
            let words = code.split(' ').take_while(|word| !word.starts_with('-'));
            let name = words.collect::<Vec<_>>().join(" ");
            let name = match name.starts_with("lsfb ") {
                true => name,
                false => format!("{parent} {name}"),
            };
            let (before, _) = name.rsplit_once(' ').unwrap_or_default();
            parent = before.to_owned();
            names.push(name);
        }
    }
    names
}

/// `lsfb sidecar`, `map scans`, `models codebook` and others were in none.
#[test]
fn the_readme_lists_every_command() {
    let listed = listed();
    let mut known = Vec::new();
    for (name, command) in commands().into_iter().skip(1) {
        let runs_alone = !command.has_subcommands() || !command.is_subcommand_required_set();
        assert!(
            !runs_alone || listed.contains(&name),
            "README.md lacks {name}"
        );
        known.push(name);
    }
    for name in listed {
        assert!(known.contains(&name), "README.md: there is no {name}");
    }
}

/// An option of one name takes the same thing in every command, and is said in the same words of the file system.
#[test]
fn an_option_takes_the_same_thing_everywhere() {
    let mut known: BTreeMap<String, (String, String)> = BTreeMap::new();
    for (name, command) in commands() {
        for (_, option, value) in options(&command) {
            assert!(value != "DIR", "{name} --{option}: folders are FOLDER");
            // What a command writes first is its own.
            if option == "out" {
                continue;
            }
            // What may be left out at the end is no other thing: NAME, NAME[=FOLDER].
            let value = value.split('[').next().unwrap_or_default().to_owned();
            let entry = (value.clone(), name.clone());
            let (before, where_) = known.entry(option.to_owned()).or_insert(entry);
            // Where a command takes one thing or another, the other takes one of them.
            let is_same = before
                .split('|')
                .any(|one| value.split('|').any(|two| one == two));
            assert!(
                is_same,
                "--{option} takes {before} in {where_} and {value} in {name}"
            );
        }
    }
}

/// Options of numbers without a unit: counts, seeds, factors, ports.
const WITHOUT_UNIT: [&str; 21] = [
    "threads",
    "seed",
    "fault-seed",
    "seeds",
    "every",
    "holdout-every",
    "max-poses",
    "explain",
    "loop",
    "lidar-port",
    "months-later",
    "speed",
    "rpe-delta",
    "keyframes",
    "points",
    "batch-every",
    "neighbours",
    "homography-images",
    "pose-pairs",
    "at-once",
    "words",
];
/// Options of several numbers, each with a unit of its own, which their help gives.
const MIXED_UNITS: [&str; 4] = ["april-grid", "checkerboard", "charuco", "datum"];

/// Whether an option's value is text: a name, a path, an address, one of a few words.
fn takes_text(argument: &Arg, value: &str) -> bool {
    const TEXTS: [&str; 30] = [
        "ADDR",
        "CODE",
        "COMMAND",
        "CSV",
        "FILE",
        "FOLDER",
        "HTML",
        "INTERFACE",
        "IP",
        "JSON",
        "KIND",
        "MCAP",
        "MODE",
        "MODEL",
        "NAME",
        "NAMES",
        "PCAP",
        "PDF",
        "PIN",
        "RRD",
        "SURVEY",
        "SVG",
        "TOML",
        "TOPIC",
        "TRAJECTORY",
        "TUM",
        "UNIT",
        "URL",
        "YAML",
        "GLB",
    ];
    let is_text = |word: &str| TEXTS.contains(&word) || word == "DB3" || word == "FAMILY";
    // NAME[=FOLDER] and [NAME=]IP are texts, as CSV|TOPIC is.
    let mut words = value.split(|c: char| !c.is_ascii_alphanumeric());
    words.all(|word| word.is_empty() || is_text(word)) || !argument.get_possible_values().is_empty()
}

/// A quantity has its unit at the end of the option's name, the same everywhere, however many numbers it is of.
#[test]
fn units_end_the_names_of_options() {
    const UNITS: [&str; 6] = ["secs", "hz", "mb", "m", "px", "percent"];
    let mut quantities = 0;
    for (name, command) in commands() {
        for (argument, option, value) in options(&command) {
            let unit = option.rsplit('-').next().filter(|end| UNITS.contains(end));
            let is_free = WITHOUT_UNIT.contains(&option) || MIXED_UNITS.contains(&option);
            let needs_unit = !takes_text(argument, &value) && !is_free;
            assert_eq!(unit.is_some(), needs_unit, "{name} --{option} <{value}>");
            quantities += usize::from(needs_unit);
        }
    }
    assert!(quantities >= 15, "{quantities} quantities were found");
    // What is excused is there, and says its units.
    for option in WITHOUT_UNIT.iter().chain(&MIXED_UNITS) {
        let all = commands();
        let mut found = all.iter().flat_map(|(_, command)| options(command));
        let known = found.find(|(_, name, _)| name == option);
        let (argument, ..) = known.unwrap_or_else(|| panic!("there is no --{option}"));
        let help = argument.get_help().map(ToString::to_string);
        let is_said =
            ["metres", "degrees"].map(|unit| help.as_ref().is_some_and(|h| h.contains(unit)));
        assert!(
            !MIXED_UNITS.contains(option) || is_said.contains(&true),
            "--{option}: {help:?}"
        );
    }
}

/// Words that no option has, each with the one that options have for the same thing.
const OTHER_WORDS: [(&str, &str); 7] = [
    ("to", "format"),
    ("layout", "format"),
    ("least", "min"),
    ("most", "max"),
    ("stamps", "stamp-unit"),
    ("seconds", "secs"),
    ("license", "licence"),
];
/// Options that are the plural of another, as they are something else or because both spellings were asked for.
const PLURALS: [(&str, &str); 5] = [
    ("devices", "a file; for `bench twin` the same as --device"),
    ("places", "for `bench twin` the same as --place"),
    ("seeds", "how many"),
    ("loops", "a file of loop closures; --loop plays again"),
    ("models", "a folder of weights; --model is a lens's"),
];

/// Names that options had before, which are still taken and which their help does not give.
const OLD_NAMES: [(&str, &str); 1] = [("lidar-port", "lidar-ports")];

/// The names of an option: its own and those that its help gives besides.
fn names_of(argument: &Arg) -> impl Iterator<Item = String> {
    let own = argument.get_long().map(str::to_owned);
    own.into_iter().chain(
        argument
            .get_visible_aliases()
            .unwrap_or_default()
            .into_iter()
            .map(str::to_owned),
    )
}

/// One word for one thing: no option is named by another word for what an option is named by already, nor is the plural of one.
#[test]
fn one_thing_has_one_word() {
    let mut by_singular: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (command_name, command) in commands() {
        for argument in command.get_arguments() {
            let said = argument.get_visible_aliases().unwrap_or_default();
            let option = argument.get_long().unwrap_or_default();
            for name in argument.get_all_aliases().unwrap_or_default() {
                assert!(
                    said.contains(&name) || OLD_NAMES.contains(&(option, name)),
                    "{command_name} --{name}: its help does not give this name of --{option}"
                );
            }
            for name in names_of(argument) {
                for (other, word) in OTHER_WORDS {
                    let is_used = name.split('-').any(|part| part == other);
                    assert!(!is_used, "{command_name} --{name}: {other} is {word}");
                }
                let singular: Vec<&str> = name
                    .split('-')
                    .map(|part| part.strip_suffix('s').unwrap_or(part))
                    .collect();
                let spellings = by_singular.entry(singular.join("-")).or_default();
                if !spellings.contains(&name) {
                    spellings.push(name);
                }
            }
        }
    }
    let of_several: Vec<&String> = by_singular
        .values()
        .filter(|spellings| spellings.len() > 1)
        .flat_map(|spellings| spellings.iter().filter(|name| name.ends_with('s')))
        .collect();
    let mut excused: Vec<&str> = PLURALS.iter().map(|(name, _)| *name).collect();
    excused.sort_unstable();
    assert_eq!(
        of_several, excused,
        "plurals beside their singulars; an option that may be given several times is named in the singular"
    );
}

/// What an option takes tells its name, and its name what it takes.
#[test]
fn what_is_taken_is_named_alike() {
    for (name, command) in commands() {
        let mut pages = Vec::new();
        for (_, option, value) in options(&command) {
            let last = option.rsplit('-').next().unwrap_or_default();
            for (taken, word) in [("FORMAT", "format"), ("UNIT", "unit")] {
                assert_eq!(value == taken, last == word, "{name} --{option} <{value}>");
            }
            for (word, taken) in [("secs", "SECS"), ("hz", "HZ"), ("mb", "MB"), ("every", "N")] {
                assert!(
                    last != word || value == taken,
                    "{name} --{option} <{value}>"
                );
            }
            if value == "HTML" {
                pages.push(option);
            }
        }
        // The result itself, or what is written beside it.
        let is_known = matches!(pages[..], [] | ["out"] | ["out-report"]);
        assert!(is_known, "{name}: pages {pages:?}");
    }
}

/// `--out` and `--out-…` alone name what is written: an option that says so has such a name.
#[test]
fn what_is_written_is_named_out() {
    for (name, command) in commands() {
        for (argument, option, _) in options(&command) {
            let help = argument
                .get_help()
                .map(ToString::to_string)
                .unwrap_or_default();
            let writes = help.starts_with("Also write") || help.contains(" to write");
            assert!(
                !writes || option.starts_with("out"),
                "{name} --{option}: {help}"
            );
        }
    }
}
