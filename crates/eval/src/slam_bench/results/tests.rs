use std::sync::atomic::{AtomicU64, Ordering};

use super::super::plan::read_plan;
use super::*;
use lsfb_types::no_progress;

/// As this program runs what is not finished.
pub const CONFIG: RunConfig<'_> = RunConfig {
    program_sha256: "0123456789abcdef",
    finished: Finished::Keep,
};

/// A truth of a curl, ten poses a second for ten seconds, its plan, and a folder for the results.
pub fn setup(systems: &str) -> (tempfile::TempDir, Plan) {
    let folder = tempfile::tempdir().expect("folder");
    let mut truth = String::new();
    for i in 0..100 {
        let t = f64::from(i) * 0.1;
        truth += &format!("{t:.1} {} {} {} 0 0 0 1\n", t.cos(), t.sin(), 0.1 * t);
    }
    fs::write(folder.path().join("truth.tum"), truth).expect("file");
    fs::create_dir(folder.path().join("room")).expect("folder");
    let plan = format!(
        "runs = 3\ntime_limit_secs = 20\nparallel = 2\n[[sequence]]\nname = 'M0'\ninput = 'room'\ntruth = 'truth.tum'\n\
         longer_side_m = 15\n{systems}"
    );
    fs::write(folder.path().join("plan.toml"), plan).expect("file");
    let plan = read_plan(&folder.path().join("plan.toml")).expect("valid");
    (folder, plan)
}

pub fn system(name: &str, script: &str) -> String {
    format!(
        "[[system]]\nname = '{name}'\ncommand = '''sh -c \"{script}\" sh {{trajectory}} {{run}}'''\n"
    )
}

/// One result of each kind; nothing but the good one has figures.
#[test]
fn every_end_has_its_cause() {
    let copy = "cp ../../../../truth.tum $1";
    let systems = [
        system("good", copy),
        system("mute", "true"),
        system("crash", "exit 7"),
        system("lost", "head -n 20 ../../../../truth.tum > $1"),
        system("rubbish", "echo hello world > $1"),
        system("empty", "touch $1"),
        system("elsewhen", "sed s/^/9/ ../../../../truth.tum > $1"),
    ];
    let (folder, plan) = setup(&systems.concat());
    let out = folder.path().join("out");
    let results = run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
    assert_eq!(results.len(), 21);
    let marked = table_of(&plan, &results).marked();
    let figures = &marked.rows[0].1;
    assert!(figures[0].value.expect("judged") < 1e-9 && figures[0].is_bold);
    assert!(figures[3..].iter().all(|f| f.value.is_none() && f.is_grey));
    let causes: Vec<String> = marked
        .failures
        .iter()
        .map(|f| format!("{}: {}", f.1, f.2))
        .collect();
    for (cause, begins) in causes.iter().zip([
        "mute: never initialised",
        "crash: crashed (exit status: 7)",
        "lost: lost (20 % covered)",
        "rubbish: not evaluated",
        "empty: never initialised",
        "elsewhen: not evaluated: no pose of the estimate is within",
    ]) {
        assert!(cause.starts_with(begins), "{cause}");
    }
}

/// A run that is there is not run again; one made of something else is.
#[test]
fn what_was_run_is_remembered() {
    let count = "echo x >> ../../../../runs; cp ../../../../truth.tum $1";
    let (folder, mut plan) = setup(&system("good", count));
    let out = folder.path().join("out");
    let runs = || {
        fs::read_to_string(folder.path().join("runs"))
            .expect("runs")
            .lines()
            .count()
    };
    let first = run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
    assert_eq!((first.len(), runs()), (3, 3));
    fs::remove_file(out.join("M0/good/run-2/result.json")).expect("a result");
    assert_eq!(
        run_plan(&plan, &out, CONFIG, &no_progress)
            .expect("run")
            .len(),
        3
    );
    assert_eq!(runs(), 4);
    plan.time_limit_secs = 10.0;
    run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
    assert_eq!(runs(), 7);
    // Results of a folder stood though other images lay in it.
    fs::write(folder.path().join("room/0.png"), "another image").expect("file");
    run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
    assert_eq!(runs(), 10);
}

/// A program that was built anew under its old name, a script that is only listed, and settings behind `=`: the figures of the old ones stood
/// under the new.
#[test]
fn another_program_or_another_file_is_run_again() {
    let (folder, _) = setup(&system("good", "true"));
    let tool = folder.path().join("tool");
    let write = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).expect("file");
    };
    let script = "echo x >> ../../../../runs; cp ../../../../truth.tum $1";
    write("run.sh", script);
    write("settings.yaml", "fast");
    write("words.txt", "one");
    fs::copy("/bin/sh", &tool).expect("a program");
    let text = fs::read_to_string(folder.path().join("plan.toml")).expect("plan");
    let named = format!(
        "command = '{} ../../../../run.sh {{trajectory}} --settings={}'\nfiles = ['words.txt']\n",
        tool.display(),
        folder.path().join("settings.yaml").display()
    );
    let begin = text.find("command").expect("a command");
    write("plan.toml", &(text[..begin].to_owned() + &named));
    let plan = read_plan(&folder.path().join("plan.toml")).expect("valid");
    let out = folder.path().join("out");
    let runs_with = |config| {
        let results = run_plan(&plan, &out, config, &no_progress).expect("run");
        assert!(results.iter().all(|r| r.se3_m.is_some()), "{results:?}");
        let runs = fs::read_to_string(folder.path().join("runs")).expect("runs");
        runs.lines().count()
    };
    let runs = || runs_with(CONFIG);
    assert_eq!((runs(), runs()), (3, 3));
    write("settings.yaml", "slow");
    assert_eq!((runs(), runs()), (6, 6));
    write("words.txt", "two");
    assert_eq!((runs(), runs()), (9, 9));
    write("run.sh", &format!("{script}; true"));
    assert_eq!((runs(), runs()), (12, 12));
    let mut built_anew = fs::read(&tool).expect("program");
    built_anew.push(0);
    fs::write(&tool, built_anew).expect("program");
    assert_eq!((runs(), runs()), (15, 15));
    // Another judge judges anew what was run, and does not run it again: inputs were not exported.
    let other = RunConfig {
        program_sha256: "fedcba9876543210",
        ..CONFIG
    };
    assert_eq!(runs_with(other), 15);
    let repeat = RunConfig {
        finished: Finished::Repeat,
        ..CONFIG
    };
    assert_eq!(runs_with(repeat), 18);
    fs::remove_file(folder.path().join("words.txt")).expect("a file");
    let why = run_plan(&plan, &out, CONFIG, &no_progress).expect_err("a file is gone");
    assert!(why.to_string().contains("words.txt"), "{why}");
}

/// Another truth, another share that must be covered, a trajectory that was edited: what is kept is a run, and no judgement.
#[test]
fn what_was_run_is_judged_anew() {
    let count = "echo x >> ../../../../runs; head -n 60 ../../../../truth.tum > $1";
    let (folder, mut plan) = setup(&system("good", count));
    let out = folder.path().join("out");
    let judged = |plan: &Plan| {
        let results = run_plan(plan, &out, CONFIG, &no_progress).expect("run");
        let runs = fs::read_to_string(folder.path().join("runs")).expect("runs");
        (results[0].clone(), runs.lines().count())
    };
    let (first, runs) = judged(&plan);
    assert!(first.se3_m.is_some_and(|m| m < 1e-9) && runs == 3);
    plan.least_covered = 0.9;
    let (lost, runs) = judged(&plan);
    assert!(matches!(lost.cause, Some(Cause::Lost { .. })) && runs == 3);
    assert_eq!(lost.se3_m, None);
    plan.least_covered = 0.5;
    let truth = fs::read_to_string(folder.path().join("truth.tum")).expect("truth");
    let shaken: String = truth
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let (time, rest) = line.split_once(' ').expect("columns");
            let (x, rest) = rest.split_once(' ').expect("columns");
            let x: f64 = x.parse().expect("a number");
            format!("{time} {} {rest}\n", x + 0.1 * (i as f64).sin())
        })
        .collect();
    fs::write(folder.path().join("truth.tum"), shaken).expect("truth");
    let (other, runs) = judged(&plan);
    assert!(
        other.se3_m.is_some_and(|m| m > 0.01) && runs == 3,
        "{other:?}"
    );
    let edited = "0 0 0 0 0 0 0 1\n";
    fs::write(out.join("M0/good/run-1/trajectory.tum"), edited).expect("file");
    assert_eq!(judged(&plan).1, 4);
}

/// Of three runs the median; a run that failed does not hide the others.
#[test]
fn the_median_run_counts() {
    let noisy = "awk -v e=$2 '{{ $2 += 0.1 * e * sin(7 * $1); print }}' ../../../../truth.tum > $1";
    let once = "test $2 != 2 && cp ../../../../truth.tum $1";
    let (folder, plan) = setup(&[system("noisy", noisy), system("once", once)].concat());
    let results = run_plan(&plan, &folder.path().join("out"), CONFIG, &no_progress).expect("run");
    let error = |run: usize| results[run - 1].se3_m.expect("judged");
    assert!(error(1) < error(2) && error(2) < error(3));
    let table = table_of(&plan, &results);
    assert_eq!(table.rows[0].cells[0].se3_m, Some(error(2)));
    assert!(table.rows[0].cells[1].se3_m.is_some_and(|m| m < 1e-9));
    assert!(matches!(results[4].cause, Some(Cause::Crashed { .. })));
    // That one failed, and that the others are the truth, is said; the noisy ones are as they seem.
    let remarks = &table.rows[0].cells[1].remarks;
    assert!(remarks[0].contains("ground truth itself"), "{remarks:?}");
    assert!(
        remarks[1].starts_with("1 of 3 runs failed: crashed"),
        "{remarks:?}"
    );
    assert!(table.rows[0].cells[0].remarks.is_empty());
    let marked = table.marked();
    for form in [marked.to_text(), marked.page().to_html()] {
        assert!(form.contains("1 of 3 runs failed"), "{form}");
    }
}

/// A system that was lost for a second and says that it stands where it was had its figure and no remark.
#[test]
fn what_is_odd_stands_below_the_table() {
    let held = "{ $2 += 0.02 * sin(7 * NR); if (NR > 74 && NR < 97) { $2 = x; $3 = y; $4 = z } x = $2; y = $3; z = $4; print }";
    let script = format!("awk '{held}' ../../../../truth.tum > $1");
    let (folder, _) = setup(&system("held", "true"));
    fs::write(folder.path().join("held.sh"), script).expect("script");
    let text = fs::read_to_string(folder.path().join("plan.toml")).expect("plan");
    let begin = text.find("command").expect("a command");
    let text = text[..begin].to_owned() + "command = 'sh ../../../../held.sh {trajectory}'\n";
    fs::write(folder.path().join("plan.toml"), text).expect("plan");
    let plan = read_plan(&folder.path().join("plan.toml")).expect("valid");
    let out = folder.path().join("out");
    let results = run_plan(&plan, &out, CONFIG, &no_progress).expect("run");
    let remark = results[0].remark.clone().unwrap_or_default();
    assert!(results[0].se3_m.is_some(), "{results:?}");
    assert!(remark.contains("exactly equal to another"), "{remark}");
}

/// Of a system that crashed in two of three runs the table had the third one's error, and no word of the others.
#[test]
fn who_fails_most_of_the_time_has_no_figure() {
    let mostly = "test $2 = 2 && cp ../../../../truth.tum $1";
    let (folder, plan) = setup(&system("mostly", mostly));
    let results = run_plan(&plan, &folder.path().join("out"), CONFIG, &no_progress).expect("run");
    assert!(results[1].se3_m.is_some());
    let table = table_of(&plan, &results);
    let cell = &table.rows[0].cells[0];
    assert!(cell.se3_m.is_none() && matches!(cell.cause, Some(Cause::Crashed { .. })));
}

#[test]
fn a_plan_is_stopped_in_order() {
    let (folder, plan) = setup(&system("slow", "sleep 30"));
    let calls = AtomicU64::new(0);
    let stop = |_: Progress| match calls.fetch_add(1, Ordering::Relaxed) {
        0..3 => Ok(()),
        _ => Err(lsfb_types::Stopped),
    };
    let stopped = run_plan(&plan, &folder.path().join("out"), CONFIG, &stop);
    assert!(matches!(stopped, Err(Error::Stopped(_))), "{stopped:?}");
}

#[test]
fn plans_that_mean_nothing_are_refused() {
    let (folder, _) = setup(&system("good", "true"));
    let path = folder.path().join("wrong.toml");
    let sequence =
        "[[sequence]]\nname = 'M0'\ninput = 'room'\ntruth = 'truth.tum'\nlonger_side_m = 15\n";
    let good = system("good", "true");
    for (text, part) in [
        (String::new(), "at least one"),
        (format!("run = 3\n{sequence}{good}"), "run"),
        (
            format!("runs = 0\n{sequence}{good}"),
            "setting runs is 0: it must be 1 to 99",
        ),
        (
            format!("{sequence}{sequence}{good}"),
            "setting sequence.name is \"M0\": it must be a name that nothing else has",
        ),
        (
            format!("{sequence}{}", good.replace("'good'", "'../x'")),
            "setting system.name is \"../x\": it must be a name of letters",
        ),
        (
            format!("{}{good}", sequence.replace("15", "-1")),
            "setting sequence.longer_side_m is -1: it must be more than 0",
        ),
        (
            format!("{sequence}[[system]]\nname = 'q'\ncommand = \"sh 'x\"\n"),
            "quote is not closed",
        ),
    ] {
        fs::write(&path, text).expect("file");
        let why = read_plan(&path).expect_err(part).to_string();
        assert!(why.contains(part), "{why}");
    }
    let (folder, mut plan) = setup("[[system]]\nname = 'q'\ncommand = 'true {inputs}'\n");
    let out = folder.path().join("out");
    let why = run_plan(&plan, &out, CONFIG, &no_progress)
        .expect_err("placeholder")
        .to_string();
    assert!(why.contains("{inputs} is not a placeholder"), "{why}");
    plan.systems[0].layout = Layout::Euroc;
    let why = run_plan(&plan, &out, CONFIG, &no_progress)
        .expect_err("a folder")
        .to_string();
    assert!(why.contains("euroc"), "{why}");
}
