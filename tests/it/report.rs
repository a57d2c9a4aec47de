//! `report`: the statistics against rliable and by hand, and the command line.

use std::sync::atomic::AtomicBool;

use cartpole_dqn::config::Config;
use cartpole_dqn::env::Spec;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::report::statistics::{self, Estimate, Sample, iqm, mean, median, sorted};
use cartpole_dqn::report::{self, history};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::study::{NamedConfig, Shard, Study, StudyDir};
use cartpole_dqn::trainer::Evaluation;
use serde_json::{Value, json};

use crate::cli::{Sandbox, TINY, keys, refusals, sets, stdout_json};
use crate::numbers;
use crate::study::{edit_lines, tree, trial_lines};
use crate::tasks::TwoStates;

/// Ends of intervals may differ from rliable's by this share of the interval: the resamples are others, 2,000 and not
/// 50,000, and the end of an interval is a quantile of them.
const INTERVAL_TOLERANCE: f64 = 0.06;

fn agrees(estimate: Estimate, recorded: &Value, what: &str) {
    let value = recorded["value"].as_f64().unwrap();
    assert!(
        (estimate.value - value).abs() <= 1e-12 * value.abs().max(1.0),
        "{what}: {estimate:?}, {recorded}"
    );
    let ends = numbers(&recorded["interval"]);
    // A statistic of few distinct values jumps from one to the next; the jumps of these samples are below 1.
    let tolerance = INTERVAL_TOLERANCE * (ends[1] - ends[0]) + 1e-9;
    for (ours, theirs) in [estimate.low, estimate.high].into_iter().zip(ends) {
        let ours = ours.unwrap();
        assert!((ours - theirs).abs() <= tolerance, "{what}: {ours} is not {theirs} ± {tolerance}");
    }
}

fn recording() -> Value {
    serde_json::from_str(include_str!("../data/rliable.json")).unwrap()
}

fn cartpole() -> Spec {
    EnvironmentId::CartPoleV1.spec()
}

#[test]
fn one_sample_agrees_with_rliable() {
    for (name, recorded) in recording()["single"].as_object().unwrap() {
        let scores = sorted(numbers(&recorded["scores"]));
        agrees(Estimate::of(&scores, iqm), &recorded["iqm"], &format!("{name} iqm"));
        agrees(Estimate::of(&scores, mean), &recorded["mean"], &format!("{name} mean"));
        agrees(Estimate::of(&scores, median), &recorded["median"], &format!("{name} median"));
        let profile = &recorded["profile"];
        for (tau, share) in numbers(&profile["tau"]).into_iter().zip(numbers(&profile["share"])) {
            let ours = statistics::count_above(&scores, tau) as f64 / scores.len() as f64;
            assert!((ours - share).abs() < 1e-12, "{name}: {ours} above {tau}, not {share}");
        }
    }
}

#[test]
fn two_samples_agree_with_rliable() {
    let recording = recording();
    for pair in recording["pairs"].as_array().unwrap() {
        let scores = |key: &str| {
            let name = pair[key].as_str().unwrap();
            sorted(numbers(&recording["single"][name]["scores"]))
        };
        let (x, y) = (scores("x"), scores("y"));
        let what = format!("{} against {}", pair["x"], pair["y"]);
        let improvement = Estimate::of_two(&x, &y, statistics::probability_of_improvement);
        agrees(improvement, &pair["probability_of_improvement"], &what);
        agrees(Estimate::of_two(&x, &y, |x, y| iqm(x) - iqm(y)), &pair["iqm_difference"], &what);
    }
}

#[test]
fn the_iqm_drops_a_quarter_at_either_end() {
    let of = |values: &[f64]| iqm(&sorted(values.iter().copied()));
    assert_eq!(of(&[7.0]), 7.0);
    assert_eq!(of(&[500.0, 1.0, 9.0]), 170.0);
    assert_eq!(of(&[500.0, 1.0, 9.0, 11.0]), 10.0);
    assert_eq!(of(&[1.0, 500.0, 2.0, 3.0, 4.0, 9.0, 499.0, 0.0]), 4.5);
}

#[test]
fn the_wilson_interval_is_wilsons() {
    // scipy 1.17.1: binomtest(count, total).proportion_ci(method="wilson").
    for (count, total, low, high) in [
        (8, 10, 0.490_162_47, 0.943_317_85),
        (0, 10, 0.0, 0.277_532_80),
        (10, 10, 0.722_467_20, 1.0),
        (998, 1000, 0.992_737_19, 0.999_451_36),
    ] {
        let (a, b) = statistics::wilson(count, total);
        assert!((a - low).abs() < 1e-8 && (b - high).abs() < 1e-8, "{count}/{total}: {a} {b}");
    }
}

#[test]
fn quantiles_of_steps_count_never_as_infinite() {
    let solved = [1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000];
    let quantiles = [0.1, 0.25, 0.5, 0.8, 0.9].map(|q| statistics::censored_quantile(&solved, 10, q));
    assert_eq!(quantiles, [Some(1000), Some(3000), Some(5000), Some(8000), None]);
    assert_eq!(statistics::censored_quantile(&[], 10, 0.1), None);
}

#[test]
fn intervals_take_ten_seeds() {
    let scores = |count: u32| sorted((0..count).map(f64::from));
    for (estimate, has_interval) in [
        (Estimate::of(&scores(9), mean), false),
        (Estimate::of(&scores(10), mean), true),
        (Estimate::of_two(&scores(9), &scores(20), statistics::probability_of_improvement), false),
        (Estimate::share(5, 9), false),
        (Estimate::share(5, 10), true),
    ] {
        assert_eq!((estimate.low.is_some(), estimate.high.is_some()), (has_interval, has_interval));
    }
}

/// Samples of 20,000 seeds: smooth ones, and such as trainings leave, with many equal values at the end of a quarter.
fn large_samples() -> Vec<(&'static str, Sample)> {
    let mut rng = Rng::from_seed(7);
    let mut sample = |value: &mut dyn FnMut(f64, f64) -> f64| {
        sorted((0..20_000).map(|_| value(rng.unit(), rng.unit())).collect::<Vec<_>>())
    };
    let share = |p: f64| move |x: f64, y: f64| if x < p { 475.0 * y } else { 500.0 };
    vec![
        ("uniform", sample(&mut |x, _| 500.0 * x)),
        ("skewed", sample(&mut |x, y| 500.0 * (x * y).powi(3))),
        ("evaluations of 50 episodes", sample(&mut |x, y| (25_000.0 * (x + y) / 2.0).round() / 50.0)),
        ("one in 1,000 fails", sample(&mut share(0.001))),
        ("a little more than a quarter fails", sample(&mut share(0.26))),
        ("a half fails", sample(&mut share(0.5))),
        ("two kinds of runs", sample(&mut |x, y| if x < 0.7 { 400.0 + 50.0 * y } else { 100.0 * y })),
        ("one far away", sample(&mut |x, y| if x < 5e-5 { -1e6 } else { y })),
    ]
}

/// The promise of docs/statistics.md: above 10,000 seeds the ends differ by at most a tenth of the interval's width.
#[test]
fn intervals_of_groups_agree_with_exact_ones() {
    let agree = |what: &str, grouped: Estimate, exact: Estimate| {
        let [low, high] = [exact.low.unwrap(), exact.high.unwrap()];
        let tolerance = 0.1 * (high - low) + 1e-9;
        let differs = |(a, b): (Option<f64>, f64)| (a.unwrap() - b).abs() > tolerance;
        assert_eq!(grouped.value, exact.value, "{what}");
        assert!(
            ![(grouped.low, low), (grouped.high, high)].into_iter().any(differs),
            "{what}: {grouped:?} {exact:?}"
        );
    };
    let samples = large_samples();
    for (name, sample) in &samples {
        agree(&format!("{name}: iqm"), Estimate::of(sample, iqm), Estimate::exact(sample, iqm));
        agree(&format!("{name}: mean"), Estimate::of(sample, mean), Estimate::exact(sample, mean));
        agree(&format!("{name}: median"), Estimate::of(sample, median), Estimate::exact(sample, median));
    }
    for pair in samples.windows(2) {
        let (x, y, what) = (&pair[0].1, &pair[1].1, format!("{} against {}", pair[0].0, pair[1].0));
        let improvement = statistics::probability_of_improvement;
        agree(&what, Estimate::of_two(x, y, improvement), Estimate::exact_of_two(x, y, improvement));
    }
}

fn evaluations(means: &[f64]) -> Vec<Evaluation> {
    means.iter().zip(1..).map(|(&mean, i)| Evaluation { env_steps: 100 * i, mean }).collect()
}

#[test]
fn the_course_of_a_run_by_hand() {
    let run = evaluations(&[10.0, 475.0, 500.0, 474.9, 480.0, 100.0, 90.0]);
    assert_eq!(history::steps_to_solve(&run, &cartpole()), Some(200));
    let kept = history::retention(&run, &cartpole()).unwrap();
    assert_eq!((kept.evaluations, kept.solved, kept.collapses, kept.dips), (5, 2, 1, 1));
    assert_eq!(kept.worst, Some(Evaluation { env_steps: 700, mean: 90.0 }));
    let never = evaluations(&[10.0, 474.9]);
    assert!(
        history::retention(&never, &cartpole()).is_none()
            && history::steps_to_solve(&never, &cartpole()).is_none()
    );

    let grid = [50, 100, 250, 300, 400];
    let on_grid = |failed| {
        let (steps, means) = ([100, 200, 300], [10.0, 475.0, 500.0]);
        grid.map(|step| history::value_at(step, &steps, &means, failed, &cartpole()))
    };
    assert_eq!(on_grid(false), [0.0, 10.0, 475.0, 500.0, 500.0]);
    assert_eq!(on_grid(true), [0.0, 10.0, 475.0, 500.0, 0.0]);
    // (0 + 10)/2 · 50 + (10 + 475)/2 · 150 + (475 + 500)/2 · 50 + 500 · 100 = 111,000, over 350 steps.
    let area = history::area_under_curve(&grid, &[0.0, 10.0, 475.0, 500.0, 500.0]);
    assert!((area - 111_000.0 / 350.0).abs() < 1e-12);
    assert_eq!(history::area_under_curve(&[100], &[7.0]), 7.0);
}

/// A study by hand: per config its name and the final scores of the seeds from 0; `None` for a failed run.
fn write_study(sandbox: &Sandbox, configs: &[(&str, &[Option<f64>])]) {
    let manifest: Vec<Value> = configs
        .iter()
        .map(|(name, _)| json!(NamedConfig::new((*name).into(), Config::default()).unwrap()))
        .collect();
    let seeds = configs[0].1.len();
    let manifest = json!({"format_version": 2, "version": "0", "configs": manifest, "seeds": {"start": 0, "end": seeds}});
    sandbox.write("s/study.json", manifest.to_string());
    let mut lines = String::new();
    for (name, scores) in configs {
        for (seed, score) in scores.iter().enumerate() {
            let policy = |mean: f64| json!({"env_steps": 200, "mean": mean, "std": 0.0, "min": 0.0, "median": 0.0, "max": 500.0});
            let evaluations = match score {
                Some(score) => json!([{"env_steps": 100, "mean": 480.0}, {"env_steps": 200, "mean": score}]),
                None => json!([{"env_steps": 100, "mean": 10.0}]),
            };
            let trial = json!({
                "config": name,
                "seed": seed,
                "error": score.map_or(json!("training diverged: early"), |_| Value::Null),
                "summary": score.map(|_| json!({"end_reason": "budget"})),
                "best": policy(score.unwrap_or(10.0).max(480.0)),
                "final": score.map(policy),
                "evaluations": evaluations,
            });
            lines += &format!("{trial}\n");
        }
    }
    sandbox.write("s/trials/one.jsonl", lines);
}

/// What was printed, without the breaks of lines, none of which may be wider than 80 columns.
fn unwrapped(assert: &assert_cmd::assert::Assert) -> String {
    let printed = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    assert!(printed.lines().all(|line| line.chars().count() <= 80), "{printed}");
    printed.split_whitespace().flat_map(|word| [word, " "]).collect()
}

const GOOD: [Option<f64>; 12] = [
    Some(500.0),
    Some(500.0),
    Some(500.0),
    Some(499.0),
    Some(498.0),
    Some(475.0),
    Some(474.0),
    Some(300.0),
    Some(100.0),
    Some(10.0),
    None,
    Some(500.0),
];
const BAD: [Option<f64>; 12] = [Some(100.0); 12];

#[test]
fn the_report_of_a_study_by_hand() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("bad", &BAD), ("good, \"better\"", &GOOD)]);
    let printed = stdout_json(&sandbox.run(&["report", "s", "--json"]).success());
    let report = sandbox.json("s/report.json");
    assert_eq!(printed, report);
    assert_eq!(
        [&report["kind"], &report["trials"], &report["finished"], &report["failed"]],
        [&json!("study"), &json!(24), &json!(24), &json!(1)]
    );
    let good = &report["configs"][1];
    let counts = ["seeds", "failed", "final_solved", "best_solved"].map(|key| good[key].as_u64().unwrap());
    assert_eq!(counts, [12, 1, 7, 12]);
    // Sorted: 0 10 100 | 300 474 475 498 499 500 | 500 500 500.
    let iqm = (300.0 + 474.0 + 475.0 + 498.0 + 499.0 + 500.0) / 6.0;
    assert!((good["final_iqm"]["value"].as_f64().unwrap() - iqm).abs() < 1e-12);
    assert_eq!(good["final_median"]["value"], 486.5);
    assert!((good["final_mean"]["value"].as_f64().unwrap() - 4356.0 / 12.0).abs() < 1e-12);
    let low = good["final_iqm"]["low"].as_f64().unwrap();
    assert!(low < iqm && iqm < good["final_iqm"]["high"].as_f64().unwrap());
    assert_eq!(
        good["steps_to_solve"],
        json!({"q10": 100, "q25": 100, "q50": 100, "q75": 100, "q90": 100, "never": 1})
    );
    assert_eq!(good["retention"]["share"], 7.0 / 11.0);
    assert_eq!(good["retention"]["worst"], json!({"seed": 9, "env_steps": 200, "mean": 10.0}));
    assert_eq!(
        ["collapses", "collapsed_seeds", "dips", "dipped_seeds"].map(|key| &good["retention"][key]),
        [2; 4].map(|count| json!(count)).each_ref()
    );
    let curve: Vec<&Value> =
        good["learning_curve"].as_array().unwrap().iter().map(|point| &point["value"]).collect();
    assert_eq!(curve, [&json!(480.0), &json!(iqm)]);
    // Above τ = 470 and 475: 474 only above the first.
    let profile = |tau: f64| {
        let points = good["performance_profile"].as_array().unwrap();
        points.iter().find(|point| point["tau"] == tau).unwrap()["value"].as_f64().unwrap() * 12.0
    };
    assert_eq!([profile(470.0).round(), profile(475.0).round()], [8.0, 6.0]);
    let comparison = &report["comparisons"][0];
    assert_eq!((&comparison["config"], &comparison["against"]), (&good["name"], &json!("bad")));
    // 9 of 12 above 100, one equal.
    assert_eq!(comparison["probability_of_improvement"]["value"], 9.5 / 12.0);
    assert!((comparison["iqm_difference"]["value"].as_f64().unwrap() - (iqm - 100.0)).abs() < 1e-12);
    let failure =
        json!({"trials": 1, "reason": "training diverged: early", "config": good["name"], "seed": 10});
    assert_eq!((&report["failures"], &report["warnings"]), (&json!([failure]), &json!([])));

    let csv = sandbox.read("s/evaluations.csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[..3], ["config,seed,env_steps,mean_return", "bad,0,100,480", "bad,0,200,100"]);
    assert_eq!(lines[25], "\"good, \"\"better\"\"\",0,100,480");
    assert_eq!(lines.len(), 1 + 24 * 2 - 1);
}

#[test]
fn a_report_is_the_same_bytes_again_and_can_go_elsewhere() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("a <&> b", &GOOD), ("bad", &BAD)]);
    let study = tree(&sandbox, "s");
    for out in ["one", "two"] {
        let printed = sandbox.run(&["report", "s", "--out", out]).success();
        let printed = String::from_utf8(printed.get_output().stdout.clone()).unwrap();
        assert!(
            printed.contains("Against a <&> b, the first config") && printed.contains("0.208 ["),
            "{printed}"
        );
        assert!(printed.contains("7 [32.0, 80.7 %]"), "{printed}");
    }
    assert!(study == tree(&sandbox, "s"));
    let one = tree(&sandbox, "one");
    assert!(one == tree(&sandbox, "two"));
    let plots = ["comparison.svg", "learning_curves.svg", "performance_profile.svg", "steps_to_solve.svg"];
    for plot in plots {
        let svg = sandbox.read(&format!("one/{plot}"));
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{svg}");
        assert!(svg.contains("a &lt;&amp;&gt; b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
    assert_eq!(one.len(), 1 + plots.len() + 2);
}

#[test]
fn a_report_replaces_a_report_and_nothing_else() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("one", &GOOD)]);
    let report = ["report", "s", "--out", "out"];
    sandbox.run(&report).success();
    sandbox.run(&report).success();
    let own = sandbox.files();
    for name in own.keys().filter_map(|path| path.strip_prefix("out").ok()).filter(|name| name.is_relative())
    {
        let file = format!("out/{}", name.display());
        let content = own[std::path::Path::new(&file)].clone();
        let Some(content) = content else { continue };
        sandbox.write(&file, "config;seed\n");
        sandbox.refuses(&report, &[&file, "is not of a report", "would be lost"]);
        sandbox.write(&file, content);
    }
}

#[cfg(unix)]
#[test]
fn a_report_is_not_written_into_a_device() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("one", &GOOD)]);
    std::os::unix::fs::symlink("/dev/null", sandbox.path("s/report.json")).unwrap();
    sandbox
        .run(&["report", "s"])
        .code(2)
        .stdout("")
        .stderr(predicates::str::contains("not an ordinary file"));
}

#[test]
fn fewer_than_ten_seeds_have_no_intervals_and_the_report_says_so() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("few", &GOOD[..9]), ("bad", &BAD[..9])]);
    let printed = sandbox.run(&["report", "s"]).success();
    let printed = unwrapped(&printed);
    let note = "note: all 2 configs: 9 seeds are fewer than 10; an interval over so few would mislead";
    assert!(printed.contains(note) && !printed.contains("In brackets"), "{printed}");
    assert!(!sandbox.read("s/comparison.svg").contains("95 %"));
    fn null_intervals(value: &Value) -> usize {
        let own =
            usize::from(value.get("low") == Some(&Value::Null) && value.get("high") == Some(&Value::Null));
        assert!(value.get("low").is_none() || own == 1, "{value}");
        let members = value.as_object().into_iter().flat_map(|map| map.values());
        own + members.chain(value.as_array().into_iter().flatten()).map(null_intervals).sum::<usize>()
    }
    assert!(null_intervals(&sandbox.json("s/report.json")) > 10);
}

#[test]
fn an_unfinished_study_is_reported_as_such_and_goes_on_after_the_report() {
    let sandbox = Sandbox::new();
    let study = [&["study", "--quiet", "--seeds", "0..3", "--out", "s"], &sets(TINY)[..]].concat();
    sandbox.run(&study).success();
    let lines: Vec<String> = trial_lines(&sandbox, "s");
    edit_lines(&sandbox, "s", |lines| drop(lines.remove(1)));
    sandbox.run(&["report", "s", "--out", "elsewhere"]).success();
    assert!(sandbox.read("elsewhere/report.json").contains("2 of 3 seeds are finished"));
    sandbox.run(&["report", "s"]).success();
    sandbox.run(&study).success();
    assert_eq!(trial_lines(&sandbox, "s"), lines);
}

/// The event of an evaluation, as a run writes it.
pub fn evaluation(env_steps: u64, mean: f64, best: bool) -> Value {
    json!({"event": "evaluation", "env_steps": env_steps, "episodes": 10, "mean": mean, "std": 0.0, "min": mean, "max": mean,
        "mean_length": mean, "best": best, "solved": mean >= 475.0})
}

/// A run by hand: a statistic that is quiet until step 1500, and these evaluations every 100 steps.
fn write_run(sandbox: &Sandbox, means: &[f64]) {
    let mut lines = Vec::new();
    for (i, mean) in (1_u32..).zip(means) {
        let step = u64::from(100 * i);
        let loss = if step >= 1500 { 9.0 } else { 1.0 + 0.1 * f64::from(i % 3) };
        lines.push(json!({"event": "statistics", "env_steps": step, "td_error_q90": loss}));
        lines.push(
            json!({"event": "episode", "env_steps": step, "episode": step / 100 - 1, "return": 1.0, "length": 1,
            "mean_return_100": mean, "epsilon": 0.1, "loss": null, "updates": step}),
        );
        let is_best = means[..i as usize].iter().all(|before| before <= mean);
        lines.push(evaluation(step, *mean, is_best));
    }
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    sandbox.write("r/metrics.jsonl", text + "{\"event\": \"eval");
    sandbox.write("r/config.json", "{\"seed\": 7, \"environment\": \"CartPole-v1\"}");
}

#[test]
fn the_report_of_a_run_says_what_happened_and_when() {
    let sandbox = Sandbox::new();
    let mut means = [10.0; 5].to_vec();
    means.extend([480.0; 10]);
    means.extend([120.0, 500.0]);
    write_run(&sandbox, &means);
    let printed = unwrapped(&sandbox.run(&["report", "r"]).success());
    for statement in [
        "solved at step 600: the first evaluation ≥ 475; 11 of 17 evaluations are ",
        "collapsed at step 1600: mean return 120.0 at step 1600, mean return 480.0 at step 1500 before; solved again at step 1700 ",
        " moved first: td_error_q90 was 9.0000 at step 1500, 1.1071 ± 0.0829 before ",
        "retained: 10 of the 11 evaluations after the first solution solve, collapses: 1, dips: 0, the worst is mean return 120.0",
        "training: mean return 500.0 over the last 17 training episodes; the classic criterion takes 100 ",
        "best: mean return 500.0 at step 1700 ",
        "final: mean return 500.0 at step 1700 (the run has not ended) ",
    ] {
        assert!(printed.contains(statement), "{statement:?} not in {printed}");
    }
    let report = sandbox.json("r/report.json");
    assert_eq!(
        (&report["kind"], &report["seed"], &report["solved_at_step"]),
        (&json!("run"), &json!(7), &json!(600))
    );
    assert_eq!(report["collapses"][0]["moved_first"][0]["statistic"], "td_error_q90");
    assert_eq!(sandbox.read("r/evaluations.csv").lines().nth(1), Some("r,7,100,10"));
    let svg = sandbox.read("r/learning_curve.svg");
    assert!(svg.contains("last 100 training episodes") && svg.contains("<title>Learning curve of r</title>"));
}

/// Half way from 475 back to the random policy is 248.6.
#[test]
fn a_dip_below_the_threshold_is_no_collapse_and_a_fall_in_stages_is_one() {
    let fall = |means: &[f64]| history::losses(&evaluations(means), &cartpole());
    let collapses =
        |means: &[f64]| fall(means).iter().map(|loss| loss.collapse.map(|at| at.mean)).collect::<Vec<_>>();
    assert_eq!(collapses(&[489.0, 455.0, 490.0, 249.0, 300.0]), [None, None]);
    assert_eq!(collapses(&[500.0, 470.0, 300.0, 200.0, 9.0]), [Some(200.0)]);
    let [loss] = fall(&[500.0, 470.0, 9.0, 200.0, 475.0])[..] else { panic!("one loss") };
    assert_eq!(
        [loss.before, loss.after, loss.lowest, loss.recovered.unwrap()].map(|at| at.env_steps),
        [100, 200, 300, 500]
    );
    let mountain_car = EnvironmentId::MountainCarV0.spec();
    let worst = [-105.0, -150.0, -105.0, -160.0].map(|mean| Evaluation { env_steps: 1, mean });
    let collapsed =
        history::losses(&worst, &mountain_car).iter().map(|loss| loss.collapse.is_some()).collect::<Vec<_>>();
    assert_eq!(collapsed, [false, true], "half way is -155");
    let foreign = Spec { id: "Mine-v0".into(), ..cartpole() };
    let level = |means: &[f64]| history::half_way(&evaluations(means), &foreign).unwrap();
    assert_eq!([level(&[100.0, 25.0, 480.0, 0.0]), level(&[480.0, 25.0])], [250.0, 237.5]);

    let sandbox = Sandbox::new();
    write_run(&sandbox, &[10.0, 489.0, 455.0, 480.0, 300.0]);
    let printed = unwrapped(&sandbox.run(&["report", "r"]).success());
    let said = "dipped 2 times below the threshold without a collapse, which is below 248.6, half way back to the random \
                policy: the lowest is mean return 300.0 at step 500 ";
    assert!(printed.contains(said) && !printed.contains("collapsed at"), "{printed}");
}

/// The known mean returns of the random policy.
#[test]
fn the_random_policy_is_where_it_is_said_to_be() {
    let sandbox = Sandbox::new();
    for name in EnvironmentId::NAMES {
        let arguments = ["eval", "--policy", "random", "--environment", name, "--episodes", "400", "--json"];
        let score = stdout_json(&sandbox.run(&arguments).success());
        let error = score["std"].as_f64().unwrap() / 20.0;
        let stated = EnvironmentId::from_name(name).unwrap().random_return();
        assert!((score["mean"].as_f64().unwrap() - stated).abs() <= 4.0 * error + 0.05, "{name}: {score}");
    }
}

#[test]
fn what_moved_before_later_evaluations_that_solved_did_not_move_first() {
    let sandbox = Sandbox::new();
    let mut means = [480.0; 30].to_vec();
    means.push(10.0);
    write_run(&sandbox, &means);
    let printed = unwrapped(&sandbox.run(&["report", "r"]).success());
    assert!(
        printed.contains(
            "collapsed at step 3100: mean return 10.0 at step 3100, mean return 480.0 at step 3000"
        )
    );
    assert!(
        !printed.contains("moved first") && printed.contains("no statistic left its usual range"),
        "{printed}"
    );
    assert!(printed.contains("not solved again so far"), "{printed}");
}

#[test]
fn a_run_that_ended_early_or_almost_solved_is_called_so() {
    let sandbox = Sandbox::new();
    sandbox.write("r/config.json", "{\"seed\": 7, \"environment\": \"CartPole-v1\"}");
    let end = |reason: &str| {
        json!({"event": "end", "env_steps": 100, "episodes": 1, "updates": 1, "reason": reason}).to_string()
    };
    let early = "ended early: stop_when_lasting_steps ended the run after the evaluation at step 100, so nothing shows";
    for (mean, reason, said, is_early) in [
        (500.0, "lasting", "solved at step 100: the first evaluation ≥ 475; 1 of 1 evaluations are ", true),
        (400.0, "budget", "never solved: the best of 1 evaluations is mean return 400.0", false),
        (40.0, "budget", "never learned: the best of 1 evaluations is mean return 40.0", false),
    ] {
        sandbox.write("r/metrics.jsonl", format!("{}\n{}\n", evaluation(100, mean, true), end(reason)));
        let printed = unwrapped(&sandbox.run(&["report", "r"]).success());
        assert!(printed.contains(said) && printed.contains(early) == is_early, "{printed}");
    }
}

#[test]
fn a_comparison_says_what_its_intervals_show() {
    let sandbox = Sandbox::new();
    let few = &GOOD[..9];
    for (first, second, verdict, statement) in [
        (&BAD[..], &GOOD[..], "better", "second is better than first: P(better) 0.792 ["),
        (&GOOD[..], &BAD[..], "worse", "first is better than second: P(better) 0.208 ["),
        (
            &GOOD[..],
            &GOOD[..],
            "no_difference_shown",
            "no difference shown between second and first: P(better) 0.500 [",
        ),
        (
            few,
            few,
            "too_few_seeds",
            "nothing shown of second and first: an interval takes 10 seeds of both, and there are 9",
        ),
    ] {
        write_study(&sandbox, &[("first", first), ("second", second)]);
        let printed = unwrapped(&sandbox.run(&["report", "s"]).success());
        let comparison = &sandbox.json("s/report.json")["comparisons"][0];
        assert_eq!(comparison["verdict"], verdict, "{comparison}");
        let said = comparison["statement"].as_str().unwrap();
        assert!(said.starts_with(statement) && printed.contains(said), "{said}: {printed}");
        sandbox.run(&["report", "s", "--html", "page.html"]).success();
        assert!(sandbox.read("page.html").contains(said));
        assert_eq!(said.contains("contains 0"), verdict == "no_difference_shown", "{said}");
    }
}

#[test]
fn the_picture_of_a_comparison_shows_the_difference_and_its_interval_alone() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("first", &BAD), ("second", &GOOD), ("third", &BAD)]);
    sandbox.run(&["report", "s"]).success();
    let svg = sandbox.read("s/comparison.svg");
    let report = sandbox.json("s/report.json");
    let difference = &report["comparisons"][0]["iqm_difference"];
    let [value, low, high] = ["value", "low", "high"].map(|key| difference[key].as_f64().unwrap());
    let row = format!(">second: {value:.1} [{low:.1}, {high:.1}]</text>");
    assert!(svg.contains(&row) && svg.contains(">third: 0.0 [0.0, 0.0]</text>"), "{row}: {svg}");
    assert!(svg.contains("Difference of the final IQMs from first, 95 % bootstrap interval"), "{svg}");
    // The picture begins at the lowest value of the rows, so their points are far from each other.
    let points =
        svg.split("<circle cx=\"").skip(1).filter_map(|rest| rest.split('"').next()?.parse::<f64>().ok());
    let points: Vec<f64> = points.collect();
    assert!(points.len() == 2 && points[0] > points[1] + 200.0, "{points:?}");
    // One config alone is shown with its own IQM.
    write_study(&sandbox, &[("only", &GOOD)]);
    sandbox.run(&["report", "s"]).success();
    assert!(sandbox.read("s/comparison.svg").contains("IQM of the final policies over seeds"));
}

#[test]
fn one_config_has_one_short_name_in_a_report() {
    let sandbox = Sandbox::new();
    let names = [
        "a_long_tutorial_config optimizer.learning_rate=0.001 gamma=0.95",
        "a_long_tutorial_config optimizer.learning_rate=0.001 gamma=0.99",
    ];
    write_study(&sandbox, &[(names[0], &GOOD[..10]), (names[1], &BAD[..10])]);
    let output = sandbox.run(&["report", "s"]).success();
    let printed = unwrapped(&output);
    let labels = ["… gamma=0.95", "… gamma=0.99"];
    for (label, name) in labels.iter().zip(names) {
        assert!(printed.contains(&format!("{label}: {name} ")), "{printed}");
        assert_eq!(printed.matches(name).count(), 1, "once in full: {printed}");
    }
    assert!(printed.contains("… gamma=0.95 is better than … gamma=0.99: "), "{printed}");
    assert!(sandbox.read("s/comparison.svg").contains("… gamma=0.99: "));
    sandbox.run(&["report", "s", "--html", "page.html"]).success();
    let page = sandbox.read("page.html");
    assert!(
        page.contains(&format!("<li>… gamma=0.95: {}</li>", names[0]))
            && page.contains("data-heading=\"IQM\"")
    );
}

#[test]
fn a_study_whose_runs_ended_early_says_so_wherever_it_is_shown() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("a", &GOOD), ("b", &GOOD)]);
    let budget = json!({"end_reason": "budget"}).to_string();
    edit_lines(&sandbox, "s", |lines| {
        for (reason, range) in [("lasting", 0..5), ("solved", 5..7)] {
            let ended = json!({"end_reason": reason}).to_string();
            lines[range].iter_mut().for_each(|line| *line = line.replace(&budget, &ended));
        }
    });
    let said = "7 of 24 runs ended early, so final scores hide differences; set stop_when_lasting_steps to null and \
                stop_when_solved to false to compare whole trainings";
    assert!(unwrapped(&sandbox.run(&["report", "s"]).success()).contains(said));
    let report = sandbox.json("s/report.json");
    assert!(report["warnings"][0].as_str().unwrap().starts_with(said), "{report}");
    assert_eq!(
        (&report["configs"][0]["ended_early"], &report["configs"][1]["ended_early"]),
        (&json!(7), &json!(0))
    );
    sandbox.run(&["report", "s", "--html", "page.html"]).success();
    assert!(sandbox.read("page.html").contains(said));
    // The same at the end of `study`.
    let standing = report::standing(&StudyDir::open_to_read(&sandbox.path("s")).unwrap()).unwrap();
    let standing = standing.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        standing.contains(said) && standing.contains("no difference shown between b and a"),
        "{standing}"
    );
}

#[test]
fn a_run_that_never_learned_is_called_so() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run"]).success();
    let report = stdout_json(&sandbox.run(&["report", "run", "--json"]).success());
    assert!(
        report["statements"][0]
            .as_str()
            .unwrap()
            .starts_with("never learned: the best of 2 evaluations is mean")
    );
    let expected = [
        "area_under_curve",
        "best",
        "collapses",
        "dips",
        "end_reason",
        "ended",
        "evaluations",
        "final",
        "format_version",
        "half_way",
        "kind",
        "price",
        "retention",
        "seed",
        "solved_at_step",
        "statements",
        "threshold",
        "training",
    ];
    assert_eq!(keys(&report), expected);
    // The report is part of the run: --force may replace both.
    sandbox.train(&["--out", "run", "--force"]).success();
    assert!(!sandbox.path("run/report.json").exists());
}

#[test]
fn thirty_configs_with_long_and_foreign_names_fit_80_columns_best_first() {
    let sandbox = Sandbox::new();
    let names: Vec<String> = (0..30).map(|i| format!("{i}-\u{1b}[31m<&\"\n{}", "n".repeat(200))).collect();
    let scores: Vec<[Option<f64>; 3]> = (0..30).map(|i| [Some(f64::from(i)); 3]).collect();
    let configs: Vec<_> =
        names.iter().zip(&scores).map(|(name, scores)| (name.as_str(), &scores[..])).collect();
    write_study(&sandbox, &configs);
    edit_lines(&sandbox, "s", |lines| lines.retain(|line| !line.contains("\"7-")));
    let output = sandbox.run(&["report", "s"]).success();
    let printed = String::from_utf8(output.get_output().stdout.clone()).unwrap();
    let place =
        |rank: &str, value: &str| printed.lines().any(|line| line.starts_with(rank) && line.ends_with(value));
    assert!(place("   1  29-", " 29.0  29.0") && place("  29  0-", "  0.0   0.0"), "{printed}");
    let printed = unwrapped(&output);
    let label = format!("0-\\u{{1b}}[31m<&\"\\nnn…{}", "n".repeat(19));
    assert!(printed.contains(&format!("Names in full: {label}: 0-\\u{{1b}}[31m<&\"\\nnnn")), "{printed}");
    assert_eq!(printed.matches("note: ").count(), 2, "{printed}");
    assert_eq!(printed.matches("nothing shown of").count(), 1, "{printed}");
    assert!(printed.contains("there are 3. So it is with 27 more"), "{printed}");
    assert!(
        printed.contains("nnn: 0 of 3 seeds are finished")
            && printed.contains("and 28 other configs: 3 seeds")
    );
    for plot in ["comparison.svg", "learning_curves.svg"] {
        let svg = sandbox.read(&format!("s/{plot}"));
        assert!(svg.contains("29-\\u{1b}[31m&lt;&amp;&quot;\\nn") && !svg.contains('\u{1b}'), "{svg}");
    }
}

#[test]
fn a_study_whose_trials_all_failed_has_a_report() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("a", &[None; 2])]);
    edit_lines(&sandbox, "s", |lines| {
        let mut trial: Value = serde_json::from_str(&lines[1]).unwrap();
        (trial["evaluations"], trial["best"]) = (json!([]), Value::Null);
        lines[1] = trial.to_string();
    });
    let printed = unwrapped(&sandbox.run(&["report", "s"]).success());
    assert!(
        printed.contains("2 of 2 trials failed")
            && printed.contains("2 ×: training diverged: early (first: a, seed 0)"),
        "{printed}"
    );
    sandbox.run(&["report", "s", "--html", "page.html"]).success();
}

#[test]
fn the_classic_criterion_takes_100_training_episodes() {
    let sandbox = Sandbox::new();
    for (count, said) in [(99, "the classic criterion takes 100"), (101, "≥ 475, first at step 10000")] {
        write_run(&sandbox, &vec![480.0; count]);
        let printed = unwrapped(&sandbox.run(&["report", "r"]).success());
        assert!(printed.contains(said), "{printed}");
    }
}

/// A link that leads to itself cannot be read, whoever asks.
#[test]
#[cfg(unix)]
fn what_cannot_be_read_is_not_called_missing() {
    let sandbox = Sandbox::with_run();
    std::os::unix::fs::symlink("loop", sandbox.path("loop")).unwrap();
    std::fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    std::os::unix::fs::symlink("checkpoints", sandbox.path("run/checkpoints")).unwrap();
    for (arguments, problem) in [
        (&["report", "loop"][..], "loop: cannot be read"),
        (&["report", "run", "--html", "page.html"], "checkpoints/best.safetensors: cannot be read"),
    ] {
        sandbox.run(arguments).code(2).stdout("").stderr(predicates::str::contains(problem));
    }
    assert!(!sandbox.path("page.html").exists());
}

/// `/proc` takes no files from anybody.
#[test]
#[cfg(target_os = "linux")]
fn a_report_that_can_never_be_written_there_is_printed_and_refused() {
    let sandbox = Sandbox::with_run();
    for arguments in [["--out", "/proc/1/x"], ["--out", "/proc"], ["--html", "/proc/page.html"]] {
        let output = sandbox.run(&[&["report", "run"], &arguments[..]].concat()).code(2);
        let output = output.get_output();
        let [printed, message] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
        assert!(!message.contains(".writing-"), "{message}");
        let option = if arguments[0] == "--html" { "--html " } else { "" };
        assert!(message.contains(&format!("cannot write {option}/proc")), "{message}");
        assert!(!printed.contains("written"), "{printed}");
        assert_eq!(printed.contains("never learned"), arguments[0] == "--out", "{printed}");
    }
}

const RUN: [&str; 2] = ["report", "r"];

refusals! {
    refuses_a_report_of_nothing: [], ["report"] => ["DIR"];
    refuses_a_report_of_a_missing_directory: [], RUN => ["r: there is no such directory"];
    refuses_a_report_of_a_file: [("r", b"mine")], RUN => ["r: is a file", "give the directory"];
    refuses_a_report_of_something_else: [("r/notes.txt", b"mine")], RUN => ["r: is neither a study", "study.json", "metrics.jsonl"];
    refuses_a_study_of_another_format:
        [("r/study.json", b"{\"format_version\": 99, \"configs\": [], \"seeds\": {\"start\": 0, \"end\": 1}}")], RUN
        => ["directory r", "study.json", "format_version 99", "reads 2"];
    refuses_a_run_without_an_evaluation:
        [("r/config.json", b"{\"environment\": \"CartPole-v1\"}"), ("r/metrics.jsonl", b"")], RUN => ["r/metrics.jsonl", "no evaluation"];
    refuses_damaged_metrics:
        [("r/config.json", b"{\"environment\": \"CartPole-v1\"}"), ("r/metrics.jsonl", b"{\"event\":\"statistics\",\"env_steps\":1}\nx\n")], RUN => ["r/metrics.jsonl", "line 2"];
}

#[test]
fn refuses_a_study_without_a_whole_trial() {
    let sandbox = Sandbox::new();
    write_study(&sandbox, &[("a", &[])]);
    sandbox.refuses(&["report", "s"], &["no trial is finished", "command first"]);
    write_study(&sandbox, &[("a", &[Some(1.0)])]);
    sandbox.write("s/trials/one.jsonl", "{\"config\"\n");
    sandbox.refuses(&["report", "s"], &["s/trials/one.jsonl line 1", "remove the line"]);
}

/// Three actions, negative returns: a failed run counts as the lowest return, and below every other.
#[test]
fn a_study_of_negative_returns_ranks_and_draws_them() {
    let sandbox = Sandbox::new();
    let small = ["network.hidden=[8]", "replay.warmup_steps=50", "exploration.steps=500", "budget.steps=900"];
    let config = |extra: &str| {
        let sets: Vec<String> = small.iter().chain([&extra]).map(ToString::to_string).collect();
        let task = TwoStates::make()(1).unwrap().spec().clone();
        let mut config = json!(super::plain(&sets));
        config["environment"] =
            json!({"command": ["two_states"], "processes": 1, "timeout_seconds": 60, "task": task});
        let config: Config = serde_json::from_value(config).unwrap();
        NamedConfig { name: extra.into(), config, task }
    };
    let mut configs = vec![config("gamma=0.99"), config("gamma=0.9"), config("gamma=0.5")];
    // Diverges at once.
    super::tasks::dqn_config(&mut configs[1].config).optimizer.learning_rate = 1e38;
    let study = Study::new(configs, 0..10, false);
    let trials: Vec<_> = study.trials(Shard::ALL).collect();
    let directory = StudyDir::create(&sandbox.path("s"), study).unwrap();
    let make = |_: &Config| TwoStates::make();
    directory.run(&trials, &make, 2, &AtomicBool::new(false), |_| {}).unwrap();
    drop(directory);
    sandbox.run(&["report", "s"]).success();
    let report = sandbox.json("s/report.json");
    let [good, failed, _] = [0, 1, 2].map(|i| &report["configs"][i]);
    assert_eq!((&good["final_solved"], &failed["failed"]), (&json!(10), &json!(10)), "{report}");
    assert_eq!(failed["final_iqm"]["value"], -20.0);
    assert!(good["final_iqm"]["value"].as_f64().unwrap() > -0.5);
    let points = good["performance_profile"].as_array().unwrap();
    assert_eq!((&points[0]["tau"], points.len()), (&json!(-20.0), 100));
    let plot = sandbox.read("s/learning_curves.svg");
    assert!(plot.contains("-20") || plot.contains("−20"), "{plot}");
}

#[test]
fn the_best_policy_of_a_report_is_the_one_that_the_run_keeps() {
    let sandbox = Sandbox::new();
    // Nothing is learned, so all evaluations are equal.
    sandbox.train(&["--out", "run", "--set", "optimizer.learning_rate=1e-30"]).success();
    sandbox.run(&["report", "run"]).success();
    let (report, summary) = (sandbox.json("run/report.json"), sandbox.json("run/summary.json"));
    assert_eq!(report["best"], summary["best_evaluation"]);
    assert_eq!(summary["best_evaluation"], summary["final_evaluation"], "the latest of equals");
}
