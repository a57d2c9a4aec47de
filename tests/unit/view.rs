#![allow(clippy::unwrap_used)]

use super::*;
use crate::agent::Policy;
use crate::nn::Mlp;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

/// Pushes to the side to which the pole falls: Q = (−s, s) where s = θ + θ̇.
pub(super) fn policy() -> Policy {
    let mut policy = Mlp::zeros(vec![4, 2]);
    policy.layer_mut(0)[4..8].copy_from_slice(&[-1.0, 1.0, -1.0, 1.0]);
    Policy::Network(policy)
}

/// What a terminal of this size shows.
pub(super) fn text(width: u16, height: u16, content: impl FnOnce(&mut Frame<'_>)) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(content).unwrap();
    let cells = terminal.backend().buffer().content();
    let rows = cells.chunks(usize::from(width));
    rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n").collect()
}

#[test]
fn a_view_draws_to_no_more_than_its_largest_area() {
    assert_eq!(drawn_area((80, 24)), Rect::new(0, 0, 80, 24));
    assert_eq!(drawn_area((u16::MAX, u16::MAX)), Rect::new(0, 0, LARGEST.width, LARGEST.height));
}

#[test]
fn q_escape_and_control_c_quit_and_nothing_else() {
    let key = |code, modifiers| is_quit(KeyEvent::new(code, modifiers));
    assert!(key(KeyCode::Char('q'), KeyModifiers::NONE) && key(KeyCode::Esc, KeyModifiers::NONE));
    assert!(key(KeyCode::Char('c'), KeyModifiers::CONTROL));
    assert!(!key(KeyCode::Char('c'), KeyModifiers::NONE) && !key(KeyCode::Enter, KeyModifiers::NONE));
}
