#![allow(clippy::unwrap_used)]

use super::*;
use crate::agent::NamedNumbers;
use crate::env::CartPole;
use crate::view::tests::{policy, text};

fn episode(env_steps: u64, mean_return_100: f64) -> Event {
    let (epsilon, loss) = (0.25, Some(0.0125));
    Event::Episode {
        env_steps,
        episode: 6,
        return_: 9.0,
        length: 9,
        mean_return_100,
        epsilon,
        loss,
        updates: 1,
    }
}

fn evaluation(env_steps: u64, mean: f64) -> Event {
    let solved = mean >= 475.0;
    let (min, max, mean_length) = (mean, mean, mean);
    Event::Evaluation { env_steps, episodes: 1, mean, std: 0.0, min, max, mean_length, best: true, solved }
}

#[test]
fn shows_what_the_events_hold() {
    let mut dashboard = Dashboard::new("runs/x", Box::new(CartPole::v1()), Budget::Steps(4000));
    let empty = text(80, 24, |frame| dashboard.draw(frame, "full speed"));
    assert!(empty.contains("train runs/x") && empty.contains("no evaluation yet"), "{empty}");

    dashboard.take(&episode(1000, 123.4));
    dashboard.take(&evaluation(1000, 456.7));
    dashboard.take(&evaluation(2000, 345.6));
    let numbers = [("max_q", 78.9), ("dead_relu_share", 0.125), ("overestimation", -4.5)];
    let numbers = NamedNumbers(numbers.map(|(name, number)| (name.to_owned(), number)).into());
    dashboard.take(&Event::Statistics { env_steps: 2000, numbers });
    dashboard.set_policy(&policy());
    dashboard.advance(Duration::from_millis(200), 2500);
    for (width, height) in [(80, 24), (70, 20), (200, 60)] {
        let shown = text(width, height, |frame| dashboard.draw(frame, "5x"));
        for part in [
            "step 2500 of 4000",
            "5x",
            "• evaluated 345.6, best 456.7 ",
            "mean return in training 123.4 ",
            "0.2500 ",
            "0.0125 ",
            "78.90 ",
            "-4.50 ",
            "0.1250 ",
            "latest policy │ step 10 of 500",
            "q stop",
        ] {
            assert!(shown.contains(part), "{part} is not in\n{shown}");
        }
        assert!(!shown.contains("visited share") && !shown.contains("action gap"), "{shown}");
    }
}

#[test]
fn an_evaluation_is_a_point_where_it_belongs() {
    let points = |mean| {
        let mut dashboard = Dashboard::new("", Box::new(CartPole::v1()), Budget::Steps(4000));
        dashboard.take(&evaluation(2000, mean));
        let shown = text(80, 24, |frame| dashboard.draw(frame, ""));
        let lines: Vec<&str> = shown.lines().collect();
        // The title has the same mark.
        let row = 3 + lines[3..].iter().position(|line| line.contains('•')).unwrap();
        (row, lines[row].chars().position(|c| c == '•').unwrap())
    };
    let ((low, x), (high, same)) = (points(100.0), points(400.0));
    assert!(low > high + 3, "row {low}, row {high}");
    assert!(x == same && (19..25).contains(&x), "column {x}");
}

#[test]
fn after_the_end_nothing_moves_but_the_player() {
    let mut dashboard = Dashboard::new("", Box::new(CartPole::v1()), Budget::Episodes(9));
    let (env_steps, episodes, updates) = (1234, 9, 7);
    let reason = crate::trainer::EndReason::Budget;
    dashboard.take(&Event::End { env_steps, episodes, updates, reason });
    dashboard.advance(Duration::from_secs(1), 9999);
    let shown = text(80, 24, |frame| dashboard.draw(frame, "finished"));
    assert!(dashboard.ended && dashboard.env_steps == env_steps);
    assert!(shown.contains("episode 9 of 9") && shown.contains("q close"), "{shown}");
}

#[test]
fn a_long_series_keeps_its_shape_in_little_memory() {
    let mut series = Series::default();
    (0..100_000).for_each(|x| series.push(x, if x < 50_000 { 0.0 } else { 1.0 }));
    assert!(series.points.len() < Series::MOST && series.points.len() >= Series::MOST / 2);
    assert!(series.points.windows(2).all(|pair| pair[0].0 < pair[1].0));
    assert_eq!(series.sparkline(6), "▁▁▁███");
    assert_eq!(series.sparkline(0), "");
}
