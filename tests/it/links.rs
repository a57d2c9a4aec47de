//! Below a run and a study nothing is written, replaced or removed through a link, also one that appears meanwhile.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use cartpole_dqn::files::Directory;

use crate::cli::{Sandbox, TINY, sets};

const STUDY: [&str; 8] = ["study", "--quiet", "--jobs", "1", "--seeds", "0..2", "--out", "s"];

fn study(more: &[&'static str]) -> Vec<&'static str> {
    [&STUDY[..], &sets(TINY), more].concat()
}

fn start(sandbox: &Sandbox, arguments: &[&str]) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn wait_for(path: &Path) {
    let start = Instant::now();
    while !path.exists() {
        assert!(start.elapsed() < Duration::from_secs(60), "{}", path.display());
        thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_study_with_a_link_in_it_is_refused_before_anything_is_written() {
    for (link, target) in [
        ("s/unfinished", "victim"),
        ("s/unfinished/0-0.safetensors", "victim/precious"),
        ("s/unfinished/0-1.safetensors", "victim/precious"),
        ("s/trials", "victim"),
        ("s/study.json", "victim/study.json"),
    ] {
        let sandbox = Sandbox::new();
        sandbox.run(&study(&["--plan"])).success();
        sandbox.write("victim/precious", "mine");
        match link {
            "s/study.json" => {
                fs::rename(sandbox.path(link), sandbox.path(target)).unwrap();
            }
            _ => fs::create_dir_all(sandbox.path(link).parent().unwrap()).unwrap(),
        }
        symlink(sandbox.path(target), sandbox.path(link)).unwrap();
        sandbox.refuses(&study(&[]), &[link, "is a link", "remove the link"]);
        sandbox.refuses(&["study", "s"], &[link, "is a link"]);
    }
}

#[test]
fn a_run_with_a_link_in_it_is_neither_resumed_nor_replaced() {
    for link in ["run/tensorboard", "run/checkpoints", "run/run.json", "run/summary.json", "run/report.html"]
    {
        let sandbox = Sandbox::with_run();
        sandbox.write("victim/precious", "mine");
        let target = if link.contains('.') { "victim/precious" } else { "victim" };
        if sandbox.path(link).is_dir() {
            fs::remove_dir_all(sandbox.path(link)).unwrap();
        } else {
            let _ = fs::remove_file(sandbox.path(link));
        }
        symlink(sandbox.path(target), sandbox.path(link)).unwrap();
        sandbox.refuses(&["train", "--out", "run", "--force"], &[link, "link"]);
        if link != "run/report.html" {
            sandbox.refuses(&["train", "--resume", "run", "--set", "budget.steps=300"], &[link, "link"]);
        }
    }
}

#[test]
fn a_report_follows_no_link_in_its_directory() {
    let sandbox = Sandbox::new();
    sandbox.run(&study(&[])).success();
    for file in ["s/report.json", "s/evaluations.csv", "s/learning_curves.svg"] {
        sandbox.write("victim", "");
        symlink(sandbox.path("victim"), sandbox.path(file)).unwrap();
        sandbox.refuses(&["report", "s"], &[file, "is a link"]);
        fs::remove_file(sandbox.path(file)).unwrap();
    }
}

/// A run whose checkpoints become a link while it trains: the link leads to a directory with files of the same names.
#[test]
fn a_link_that_appears_in_a_run_while_it_trains_ends_it_and_is_not_followed() {
    for link in ["run/checkpoints", "run/checkpoints/last.safetensors"] {
        let sandbox = Sandbox::new();
        for name in ["last", "best", "previous"] {
            sandbox.write(&format!("victim/{name}.safetensors"), "mine");
        }
        let more =
            sets(&["budget.steps=1000000000", "checkpoint.every_steps=1000", "stop_when_lasting_steps=null"]);
        let child =
            start(&sandbox, &[&["train", "--quiet", "--out", "run"], &sets(TINY)[..], &more].concat());
        wait_for(&sandbox.path("run/checkpoints/previous.safetensors"));
        let target = if link.ends_with("checkpoints") { "victim" } else { "victim/last.safetensors" };
        symlink(sandbox.path(target), sandbox.path("new")).unwrap();
        if link.ends_with("checkpoints") {
            // A directory cannot be replaced by a link in one step.
            while fs::rename(sandbox.path(link), sandbox.path("old")).is_err() {}
        }
        fs::rename(sandbox.path("new"), sandbox.path(link)).unwrap();
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{message}");
        // Between the two steps the directory may have been missed first.
        let named = message.contains(link) && message.contains("is a link");
        assert!(named || link.ends_with("checkpoints"), "{message}");
        let files = fs::read_dir(sandbox.path("victim")).unwrap();
        let contents = files.map(|file| fs::read_to_string(file.unwrap().path()).unwrap());
        assert_eq!(contents.collect::<Vec<_>>(), ["mine"; 3]);
    }
}

#[test]
fn a_link_that_appears_in_a_study_is_not_followed() {
    let sandbox = Sandbox::new();
    sandbox.write("victim/0-0.safetensors", "mine");
    let long = study(&["--set", "budget.steps=1000000000"]);
    let child = start(&sandbox, &long);
    wait_for(&sandbox.path("s/trials"));
    symlink(sandbox.path("victim"), sandbox.path("s/unfinished")).unwrap();
    thread::sleep(Duration::from_millis(100));
    Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    child.wait_with_output().unwrap();
    assert_eq!(sandbox.read("victim/0-0.safetensors"), "mine");
    assert_eq!(fs::read_dir(sandbox.path("victim")).unwrap().count(), 1);
}

/// What is a directory now, a link then, and missing in between is written a thousand times.
#[test]
fn no_write_slips_through_a_link_that_comes_and_goes() {
    let sandbox = Sandbox::new();
    let [root, inner, away, link, victim] =
        ["root", "root/inner", "root/away", "root/link", "victim"].map(|path| sandbox.path(path));
    fs::create_dir_all(&inner).unwrap();
    sandbox.write("victim/file", "mine");
    symlink(&victim, &link).unwrap();
    let directory = Directory::open(&root).unwrap();
    let is_over = AtomicBool::new(false);
    let (mut written, mut refused) = (0, 0);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                fs::rename(&inner, &away).unwrap();
                fs::rename(&link, &inner).unwrap();
                thread::yield_now();
                fs::rename(&inner, &link).unwrap();
                fs::rename(&away, &inner).unwrap();
                thread::yield_now();
            }
        });
        let start = Instant::now();
        while start.elapsed() < Duration::from_millis(500) {
            let file = inner.join("file");
            let results = [
                directory.write_whole(&file, Some(&inner.join("kept")), |file| file.write_all(b"ours")),
                directory.create_file(&inner.join("new")).map(drop),
                directory.remove_file(&inner.join("new")),
                directory.remove_file(&file),
            ];
            let ok = results.iter().filter(|result| result.is_ok()).count();
            (written, refused) = (written + ok, refused + results.len() - ok);
        }
        is_over.store(true, Ordering::Relaxed);
    });
    assert!(written > 0 && refused > 0, "{written} written, {refused} refused");
    assert_eq!(sandbox.read("victim/file"), "mine");
    assert_eq!(fs::read_dir(&victim).unwrap().count(), 1);
}

#[test]
fn the_directory_that_the_user_names_may_be_behind_a_link() {
    let sandbox = Sandbox::new();
    fs::create_dir_all(sandbox.path("scratch/studies")).unwrap();
    symlink("scratch", sandbox.path("runs")).unwrap();
    symlink("scratch/studies", sandbox.path("s")).unwrap();
    sandbox.train(&["--out", "runs/one", "--tensorboard"]).success();
    sandbox.run(&["train", "--quiet", "--resume", "runs/one", "--set", "budget.steps=300"]).success();
    sandbox.train(&["--out", "runs/one", "--force"]).success();
    sandbox.run(&study(&[])).success();
    sandbox.run(&["report", "s"]).success();
    assert!(sandbox.path("scratch/studies/report.json").is_file());
}
