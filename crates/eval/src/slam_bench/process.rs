//! A program that is run within limits of time and memory.

use std::fs::File;
use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use lsfb_types::Stopped;
use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;

use super::cause::Cause;

/// How often is looked at time and memory.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// What a run may take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub time_secs: f64,
    pub memory_mb: u64,
}

/// What a run took.
#[derive(Clone, Debug)]
pub(super) struct Ended {
    /// `None` where it ended well.
    pub cause: Option<Cause>,
    pub wall_secs: f64,
    /// Largest memory of the program and those it started, MB, as seen every 50 ms.
    pub peak_mb: u64,
}

/// Runs `words` in `folder`, with what it says in `log.txt` there. It and all it started are ended at a limit, or where `check` says so.
pub(super) fn run(
    words: &[String],
    folder: &Path,
    limits: Limits,
    check: &dyn Fn() -> Result<(), Stopped>,
) -> io::Result<Result<Ended, Stopped>> {
    let log = File::create(folder.join("log.txt"))?;
    let start = Instant::now();
    let Some((program, arguments)) = words.split_first() else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    let started = Command::new(program)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        // A group of its own, so that what it starts ends with it.
        .process_group(0)
        .spawn();
    let mut child = match started {
        Ok(child) => child,
        Err(error) => {
            return Ok(Ok(Ended {
                cause: Some(Cause::NotStarted {
                    why: format!("{program}: {error}"),
                }),
                wall_secs: 0.0,
                peak_mb: 0,
            }));
        }
    };
    let mut peak_mb = 0;
    let cause = loop {
        if let Some(status) = child.try_wait()? {
            break crashed(status);
        }
        if let Err(stopped) = check() {
            end(&mut child)?;
            return Ok(Err(stopped));
        }
        let memory_mb = memory_of_group_mb(child.id());
        peak_mb = peak_mb.max(memory_mb);
        if memory_mb > limits.memory_mb {
            end(&mut child)?;
            break Some(Cause::OutOfMemory {
                limit_mb: limits.memory_mb,
            });
        }
        if start.elapsed().as_secs_f64() > limits.time_secs {
            end(&mut child)?;
            break Some(Cause::TimedOut {
                limit_secs: limits.time_secs,
            });
        }
        std::thread::sleep(LOOK_EVERY);
    };
    // What it left running in the background would go on beside the next run.
    let _ = killpg(group(child.id()), Signal::SIGKILL);
    Ok(Ok(Ended {
        cause,
        wall_secs: start.elapsed().as_secs_f64(),
        peak_mb,
    }))
}

fn group(id: u32) -> Pid {
    Pid::from_raw(i32::try_from(id).unwrap_or(i32::MAX))
}

fn end(child: &mut Child) -> io::Result<()> {
    // Gone already is as good as ended.
    let _ = killpg(group(child.id()), Signal::SIGKILL);
    child.wait().map(|_| ())
}

fn crashed(status: ExitStatus) -> Option<Cause> {
    (!status.success()).then(|| Cause::Crashed {
        how: status.to_string(),
    })
}

/// Resident memory of all processes of a group; what cannot be read has ended.
fn memory_of_group_mb(group: u32) -> u64 {
    let Ok(processes) = std::fs::read_dir("/proc") else {
        return 0;
    };
    let resident_kb = |entry: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
        // Behind the name, which may hold anything: state, parent, group.
        let (_, rest) = stat.rsplit_once(')')?;
        let of_group: u32 = rest.split_whitespace().nth(2)?.parse().ok()?;
        if of_group != group {
            return None;
        }
        let status = std::fs::read_to_string(entry.path().join("status")).ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))?;
        line.trim()
            .trim_end_matches("kB")
            .trim()
            .parse::<u64>()
            .ok()
    };
    let numbered = processes.flatten().filter(|entry| {
        let name = entry.file_name();
        name.to_string_lossy().bytes().all(|b| b.is_ascii_digit())
    });
    numbered.filter_map(resident_kb).sum::<u64>() / 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ended(script: &str, limits: Limits) -> Ended {
        let folder = tempfile::tempdir().expect("folder");
        let words = ["sh", "-c", script].map(str::to_owned);
        let run = run(&words, folder.path(), limits, &|| Ok(())).expect("a process");
        run.expect("not stopped")
    }

    const WIDE: Limits = Limits {
        time_secs: 20.0,
        memory_mb: 4000,
    };

    #[test]
    fn ends_are_told_apart() {
        assert_eq!(ended("true", WIDE).cause, None);
        assert!(
            matches!(ended("exit 3", WIDE).cause, Some(Cause::Crashed { how }) if how.contains('3'))
        );
        assert!(
            matches!(ended("kill -SEGV $$", WIDE).cause, Some(Cause::Crashed { how }) if how.contains("11"))
        );
        let quick = Limits {
            time_secs: 0.2,
            ..WIDE
        };
        let slow = ended("sleep 30 & sleep 30", quick);
        assert!(matches!(slow.cause, Some(Cause::TimedOut { .. })) && slow.wall_secs < 5.0);
        let small = Limits {
            memory_mb: 30,
            ..WIDE
        };
        // Doubling a string takes what it needs to a child of the shell that was started.
        let hungry = "sh -c 'x=aaaaaaaaaaaaaaaa; while true; do x=$x$x; done'";
        assert!(matches!(
            ended(hungry, small).cause,
            Some(Cause::OutOfMemory { limit_mb: 30 })
        ));
    }

    #[test]
    fn what_is_no_program_is_said() {
        let folder = tempfile::tempdir().expect("folder");
        let words = ["no-such-program-here".to_owned()];
        let run = run(&words, folder.path(), WIDE, &|| Ok(()))
            .expect("tried")
            .expect("not stopped");
        assert!(
            matches!(run.cause, Some(Cause::NotStarted { why }) if why.contains("no-such-program-here"))
        );
    }

    #[test]
    fn a_run_is_stopped_with_all_it_started() {
        let folder = tempfile::tempdir().expect("folder");
        let words = ["sh", "-c", "sleep 30 & sleep 30"].map(str::to_owned);
        let start = Instant::now();
        let run = run(&words, folder.path(), WIDE, &|| Err(Stopped)).expect("tried");
        assert!(run.is_err() && start.elapsed().as_secs() < 5);
    }
}
