//! The second agent: Q-learning in a table.

use cartpole_dqn::agent::{
    Actor, Agent, AgentConfig, Bins, Policy, QLearning, QTable, QTableConfig, Transition,
};
use cartpole_dqn::config::Config;
use cartpole_dqn::mirror::Mirror;
use cartpole_dqn::tensors::{TensorError, Tensors};

use super::cli::{Sandbox, sets, stdout_json};
use super::resume::assert_same_runs;

/// A short run of a table, with and without options that have a state of their own.
const SHORT: &str = r#"{
    "agent": "q_table", "table": {"bins": [2, 3, [-0.1, 0, 0.1], 4]}, "optimizer": {"learning_rate": 0.5},
    "exploration": {"steps": 200}, "budget": {"steps": 333}, "evaluation": {"every_steps": 50, "episodes": 3},
    "checkpoint": {"every_steps": 50}
}"#;
const OPTIONS: [&[&str]; 2] =
    [&[], &["table.mirror=true", "table.initial=5", "exploration.repeat=8", "optimizer.schedule.steps=150"]];

fn settings(sets: &[&str]) -> QTableConfig {
    let sets: Vec<String> = ["agent=q_table"].iter().chain(sets).map(ToString::to_string).collect();
    let AgentConfig::QTable(config) = Config::from_layers(None, &sets).unwrap().agent else { panic!() };
    config
}

fn transition<'a>(s: &'a [f32], action: usize, reward: f32, next: &'a [f32]) -> Transition<'a> {
    Transition { observation: s, action, reward, next_observation: next, terminated: false, truncated: false }
}

/// The table in tensors that hold one with these edges and values for two coordinates and two actions.
fn read(edges: [&[f32]; 2], shape: &[usize], values: &[f32]) -> Result<QTable, TensorError> {
    let mut tensors = Tensors::default();
    tensors.put("q_table", shape, values);
    for (k, edges) in edges.iter().enumerate() {
        tensors.put(&format!("table.edges.{k}"), &[edges.len()], edges);
    }
    QTable::from_tensors(&tensors, 2, 2)
}

#[test]
fn an_update_moves_one_value_towards_the_reward_and_the_discounted_largest_next_value() {
    let mut table = read([&[0.0], &[]], &[2, 1, 2], &[1.0, 2.0, 4.0, 3.0]).unwrap();
    let (low, high) = ([-1.0, 0.0], [1.0, 0.0]);
    // 2 + 0.5 (1 + 0.5 · 4 − 2)
    assert_eq!(table.update(transition(&low, 1, 1.0, &high), 0.5, 0.5), 1.0);
    assert_eq!((table.q_values(&low), table.q_values(&high)), (&[1.0, 2.5][..], &[4.0, 3.0][..]));
    // Nothing follows a termination: 4 + 0.5 (1 − 4). What is truncated goes on.
    let ended = Transition { terminated: true, ..transition(&high, 0, 1.0, &low) };
    assert_eq!(table.update(ended, 0.5, 0.5), -3.0);
    assert_eq!(table.q_values(&high), [2.5, 3.0]);
    let cut_off = Transition { truncated: true, ..transition(&high, 1, 1.0, &low) };
    assert_eq!(table.update(cut_off, 0.5, 0.5), 1.0 + 0.5 * 2.5 - 3.0);
    assert_eq!((table.visits(&low), table.visits(&high)), (&[0, 1][..], &[1, 1][..]));
    assert_eq!((table.updates(), table.visited_cells()), (3, (2, 2)));
}

#[test]
fn an_observation_on_an_edge_belongs_to_the_cell_above_it_and_the_outermost_cells_never_end() {
    let table = read([&[-1.0, 1.0], &[]], &[3, 1, 2], &[0.0, 0.0, 1.0, 1.0, 2.0, 2.0]).unwrap();
    for (value, cell) in [(-1e30, 0.0), (-1.1, 0.0), (-1.0, 1.0), (0.0, 1.0), (1.0, 2.0), (f32::MAX, 2.0)] {
        assert_eq!(table.q_values(&[value, 7.0])[0], cell, "{value}");
    }
}

#[test]
fn equal_cells_divide_the_range_and_are_the_same_as_their_edges() {
    let equal = settings(&["table.bins=[1,1,4,2]", "table.low=[-1,-1,-2,-1]", "table.high=[1,1,2,3]"]);
    let edges = settings(&["table.bins=[[],[],[-1,0,1],[1]]"]);
    assert_eq!(equal.table.edges(), edges.table.edges());
    assert_eq!(equal.table.bins.iter().map(Bins::count).collect::<Vec<_>>(), [1, 1, 4, 2]);
}

/// Sweeps over a task of six states in a row, in which one walks left or right, pays 1 for a step and ends beyond the last.
/// Value iteration in f64 is the judge.
#[test]
fn a_table_ends_at_the_solution_of_the_bellman_equation() {
    let gamma = 0.9;
    let step = |state: usize, action: usize| (state + 2 * action).saturating_sub(1);
    let mut judge = [[0.0_f64; 2]; 7];
    let mut table = QTable::new(vec![vec![0.5, 1.5, 2.5, 3.5, 4.5, 5.5]], 2, 0.0);
    for _ in 0..200 {
        for state in 0..6 {
            for action in 0..2 {
                let next = step(state, action);
                judge[state][action] = -1.0 + gamma * judge[next][0].max(judge[next][1]);
                let (s, next_s) = ([state as f32], [next as f32]);
                let terminated = next == 6;
                table.update(Transition { terminated, ..transition(&s, action, -1.0, &next_s) }, 0.5, 0.9);
            }
        }
    }
    for (state, expected) in judge.iter().enumerate().take(6) {
        for (action, expected) in expected.iter().enumerate() {
            assert!((f64::from(table.q_values(&[state as f32])[action]) - expected).abs() < 1e-5);
        }
    }
    let mut greedy = Policy::Table(table).greedy(1);
    assert!((0..6).all(|state| greedy.act(&[state as f32]) == 1));
}

#[test]
fn a_table_with_a_mirror_learns_from_the_image_of_every_transition_too() {
    let mirror = Mirror { observation: (0..4).map(|i| (i, -1.0)).collect(), actions: vec![1, 0] };
    let (s, next) = ([0.1, 0.1, 0.15, 0.5], [0.1, 0.1, 0.16, 0.6]);
    let image = s.map(|value: f32| -value);
    for (set, visits) in [("table.mirror=false", [0, 0]), ("table.mirror=true", [1, 0])] {
        let config = settings(&[set, "table.bins=[1,1,[0],[0]]", "optimizer.learning_rate=0.5"]);
        let mut agent = QLearning::new(config, 2, Some(&mirror), 0);
        agent.observe(transition(&s, 1, 1.0, &next));
        let Policy::Table(table) = agent.policy() else { panic!() };
        assert_eq!((table.visits(&s), table.visits(&image)), (&[0, 1][..], &visits[..]));
        assert_eq!(table.q_values(&s), [0.0, 0.5]);
        assert_eq!(agent.learn_if_due(1), Ok(Some(1.0)));
        assert_eq!(agent.counters().updates, table.updates());
    }
}

#[test]
fn a_table_that_leaves_the_finite_ends_the_run() {
    let mut agent = QLearning::new(settings(&["table.bins=[1,1,1,1]"]), 2, None, 0);
    agent.observe(transition(&[0.0; 4], 0, f32::INFINITY, &[0.0; 4]));
    assert!(agent.learn_if_due(1).is_err());
}

#[test]
fn tables_that_cannot_be_played_are_refused() {
    assert!(read([&[0.0], &[]], &[2, 1, 2], &[0.0; 4]).is_ok());
    fn refused(edges: [&[f32]; 2], shape: &[usize], values: &[f32]) -> TensorError {
        read(edges, shape, values).unwrap_err()
    }
    assert!(matches!(refused([&[0.0], &[]], &[2, 1, 3], &[0.0; 6]), TensorError::WrongTable { .. }));
    assert!(matches!(refused([&[0.0], &[]], &[2, 2], &[0.0; 4]), TensorError::WrongTable { .. }));
    assert!(matches!(refused([&[], &[]], &[2, 0, 2], &[]), TensorError::NoPolicy));
    assert!(matches!(refused([&[0.0, 1.0], &[]], &[2, 1, 2], &[0.0; 4]), TensorError::Unexpected { .. }));
    for edges in [[1.0, 0.0], [0.0, 0.0], [0.0, f32::NAN]] {
        let error = refused([&edges, &[]], &[3, 1, 2], &[0.0; 6]);
        assert!(matches!(error, TensorError::EdgesDoNotAscend(_)), "{error}");
    }
    let values = [0.0, f32::INFINITY, 0.0, 0.0];
    assert!(matches!(refused([&[0.0], &[]], &[2, 1, 2], &values), TensorError::NotFinite(_)));
}

#[test]
fn a_run_of_a_table_that_is_extended_is_the_run_that_had_the_budget_from_the_start() {
    for (options, steps) in OPTIONS.into_iter().zip(["budget.steps=100", "budget.steps=137"]) {
        let sandbox = Sandbox::new();
        sandbox.write("table.json", SHORT);
        let train = |arguments: &[&str]| {
            let plain = ["train", "--quiet", "--config", "table.json"];
            sandbox.run(&[&plain[..], &sets(options), arguments].concat()).success();
        };
        train(&["--out", "whole"]);
        train(&["--out", "parts", "--set", steps]);
        sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=333"]).success();
        assert_same_runs(&sandbox, "whole", "parts");
        sandbox.run(&["verify", "parts", "--quiet"]).success().stdout("").stderr("");
    }
}

#[test]
fn every_command_that_takes_a_policy_takes_a_table() {
    let sandbox = Sandbox::new();
    sandbox.write("table.json", SHORT);
    sandbox.run(&["train", "--quiet", "--config", "table.json", "--out", "run"]).success();
    let mean = |place: &str| stdout_json(&sandbox.run(&["eval", place, "--json"]).success())["mean"].clone();
    assert!(mean("run").as_f64().unwrap() >= 8.0);
    sandbox.run(&["render", "run", "--output", "episode.svg"]).success();
    let inspected = sandbox.run(&["inspect", "run"]).success();
    let text = String::from_utf8(inspected.get_output().stdout.clone()).unwrap();
    assert!(text.contains("a table of [2, 3, 4, 4] cells with 2 actions"), "{text}");
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    let metrics = sandbox.read("run/metrics.jsonl");
    for name in ["visited_share", "visits_per_cell", "largest_update", "max_q"] {
        assert!(metrics.contains(&format!("\"{name}\":")), "{name}");
    }
    assert!(!metrics.contains("gradient_norm"));
    // A table starts from a table with the same cells, and from nothing else.
    let last = "run/checkpoints/last.safetensors";
    let from = ["train", "--quiet", "--config", "table.json", "--init-from", last];
    let one = [&from[..], &["--out", "next", "--set", "budget.steps=1"]].concat();
    sandbox.run(&one).success();
    sandbox
        .refuses(&[&from[..], &["--out", "no", "--set", "table.bins=[2,3,4,4]"]].concat(), &["other edges"]);
    sandbox
        .refuses(&[&from[..], &["--out", "no", "--set", "table.bins=[1,1,1,2]"]].concat(), &["[2, 3, 4, 4]"]);
    sandbox.refuses(
        &["train", "--init-from", last, "--out", "no"],
        &["a table of [2, 3, 4, 4] cells", "layers"],
    );
}

#[test]
fn what_is_about_networks_alone_refuses_a_table() {
    let sandbox = Sandbox::new();
    sandbox.write("table.json", SHORT);
    sandbox.run(&["train", "--quiet", "--config", "table.json", "--out", "run"]).success();
    sandbox.refuses(&["explain", "--config", "table.json", "--update", "3"], &["trains a table"]);
    sandbox.refuses(&["check", "run/checkpoints/last.safetensors"], &["holds a table of Q-values"]);
}

#[test]
fn keys_of_the_other_agent_and_tables_that_fit_no_task_are_refused() {
    let refused = |sets: &[&str], words: &[&str]| {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        let message = Config::from_layers(None, &sets).unwrap_err().to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{words:?} not in {message}");
    };
    let table = "agent=q_table";
    for key in ["replay.capacity=1", "optimizer.beta1=0.5", "target.kind=none", "double=true", "n_step=3"] {
        let name = key.split('=').next().unwrap();
        refused(&[table, key], &["misplaced key", name, "belongs to the agent \"dqn\"", "\"q_table\" here"]);
    }
    refused(&["table.mirror=true"], &["`table.mirror`", "belongs to the agent \"q_table\"", "\"dqn\" here"]);
    refused(&["agent=sarsa"], &["`agent` is \"sarsa\"", "\"dqn\" or \"q_table\""]);
    refused(&[table, "table.bins=[2,2]"], &["`table.bins`", "4 observation coordinates"]);
    refused(&[table, "table.low=[0]"], &["`table.low`", "4 observation coordinates"]);
    refused(&[table, "table.bins=[1,1,[1,0],1]"], &["`table.bins`", "coordinate 2", "ascend"]);
    refused(&[table, "table.high=[1,1,-1,1]"], &["`table.low`", "below `table.high`"]);
    refused(&[table, "table.bins=[0,1,1,1]"], &["`table.bins`", "an integer from 1 to 10000"]);
    refused(&[table, "table.bins=[9999,9999,9999,9999]"], &["`table.bins`", "fewer cells"]);
    refused(
        &[
            table,
            "environment=MountainCar-v0",
            "table.bins=[2,2]",
            "table.low=[0,0]",
            "table.high=[1,1]",
            "table.mirror=true",
        ],
        &["`table.mirror`", "not known to be its own mirror image"],
    );
}

#[test]
fn a_table_of_a_few_cells_solves_cartpole() {
    let text = include_str!("../../configs/q_table.json");
    let config = Config::from_layers(Some(("q_table.json", text)), &["seed=100000".into()]).unwrap();
    let mut trainer = config.make_trainer().unwrap();
    let never = std::sync::atomic::AtomicBool::new(false);
    trainer.run(&mut Vec::<cartpole_dqn::trainer::Event>::new(), &never).unwrap();
    assert!(trainer.progress().last_evaluation.unwrap().mean >= 475.0);
}
