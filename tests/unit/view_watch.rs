#![allow(clippy::unwrap_used)]

use super::*;
use crate::agent::Policy;
use crate::env::{Acrobot, CartPole, TimeLimit};
use crate::nn::Mlp;
use crate::view::tests::{policy, text};

fn view() -> Watch {
    Watch::new(policy().greedy(1), Box::new(CartPole::v1()), "runs/x", 7).unwrap()
}

fn press(view: &mut Watch, code: KeyCode) {
    view.press(KeyEvent::from(code)).unwrap();
}

fn shown(view: &Watch) -> String {
    text(80, 24, |frame| view.draw(frame))
}

#[test]
fn time_runs_at_50_steps_a_second_times_the_speed() {
    let second = Duration::from_secs(1);
    let mut view = view();
    view.advance(second).unwrap();
    assert_eq!(view.player.steps, 50);
    press(&mut view, KeyCode::Char('-'));
    view.advance(second).unwrap();
    assert_eq!(view.player.steps, 75);
    press(&mut view, KeyCode::Char('+'));
    press(&mut view, KeyCode::Char('+'));
    view.advance(second / 4).unwrap();
    assert_eq!(view.player.steps, 100);
    assert!(shown(&view).contains("step 100 of 500 │ 2x │ plays"), "{}", shown(&view));
}

#[test]
fn a_pause_stops_time_and_single_steps_go_through_it() {
    let mut view = view();
    press(&mut view, KeyCode::Char(' '));
    view.advance(Duration::from_secs(9)).unwrap();
    assert_eq!(view.player.steps, 0);
    press(&mut view, KeyCode::Char('s'));
    view.advance(Duration::from_secs(9)).unwrap();
    assert_eq!(view.player.steps, 1);
    assert!(shown(&view).contains("paused"));
    press(&mut view, KeyCode::Char(' '));
    view.advance(Duration::from_millis(20)).unwrap();
    assert_eq!(view.player.steps, 2);
}

#[test]
fn the_next_seed_comes_by_key_or_a_moment_after_the_end() {
    let mut view = view();
    press(&mut view, KeyCode::Char('n'));
    assert_eq!((view.player.seed, view.player.returns.len()), (8, 0));
    view.advance(Duration::from_secs(60)).unwrap();
    let total = view.player.steps;
    assert!(view.player.end.is_some());
    view.advance(REST / 2).unwrap();
    assert_eq!(view.player.steps, total, "the end stays a moment");
    assert!(shown(&view).contains(&format!("returns, latest first: {total} ")), "{}", shown(&view));
    view.advance(REST).unwrap();
    assert_eq!((view.player.seed, view.player.steps), (9, 0));
    press(&mut view, KeyCode::Char('r'));
    assert_eq!(view.player.seed, 9);
}

#[test]
fn shows_the_q_values_the_choice_and_a_push() {
    let mut view = view();
    view.advance(Duration::from_millis(100)).unwrap();
    let screen = shown(&view);
    let lines: Vec<&str> =
        screen.lines().filter(|line| line.contains("│ left ") || line.contains("│ right ")).collect();
    assert_eq!(lines.len(), 2, "{screen}");
    for (action, line) in lines.iter().enumerate() {
        assert_eq!(line.contains("◆ chosen"), action == view.player.action, "{screen}");
        assert!(line.contains(&format!("{:.2}", view.player.q_values[action])), "{screen}");
    }
    assert!(screen.contains("watch runs/x") && screen.contains("returns: none yet"));
    press(&mut view, KeyCode::Left);
    assert!(shown(&view).contains("yours: left"));
    press(&mut view, KeyCode::Right);
    assert!(shown(&view).contains("yours: right"));
}

#[test]
fn every_number_of_a_state_is_seen_whole() {
    let acrobot = Box::new(TimeLimit::new(Acrobot::default(), 500));
    let six = Policy::Network(Mlp::zeros(vec![6, 3]));
    let view = Watch::new(six.greedy(1), acrobot, "runs/x", 7).unwrap();
    for columns in [80, 70] {
        let screen = text(columns, 24, |frame| view.draw(frame));
        let bottom = screen.lines().find(|line| line.starts_with('└')).unwrap();
        let numbers = bottom.split(' ').filter(|word| word.starts_with(['+', '-'])).count();
        assert_eq!(numbers, 6, "{screen}");
        assert!(bottom.trim_end().ends_with("┘") && !bottom.contains('…'), "{screen}");
    }
}

#[test]
fn a_bar_grows_by_eighths_and_keeps_its_width() {
    let bars = [0.0, 0.125, 0.5, 1.0, 7.0].map(|share| bar(share, 4));
    assert_eq!(bars, ["    ", "▌   ", "██  ", "████", "████"]);
}
