#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::{CartPole, Environment};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

/// The characters of a color: columns from the middle, and rows from above.
fn places(state: [f64; 4], (width, height): (u16, u16), color: Ansi) -> Vec<(f64, u16)> {
    let scene = CartPole::at(state).scene().unwrap();
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, frame.area(), Block::new(), &scene)).unwrap();
    let buffer = terminal.backend().buffer();
    let cells = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    cells
        .filter(|&place| buffer[place].fg == color)
        .map(|(x, y)| (f64::from(x) + 0.5 - f64::from(width) / 2.0, y))
        .collect()
}

fn mean_column(places: impl Iterator<Item = (f64, u16)>) -> f64 {
    let columns: Vec<f64> = places.map(|(x, _)| x).collect();
    columns.iter().sum::<f64>() / columns.len() as f64
}

#[test]
fn the_pole_stands_on_the_cart_and_leans_to_the_side_to_which_it_falls() {
    let size = (101, 20);
    // Of a focus of 4.8 m and a quarter of a metre on each side.
    let metre = f64::from(size.0) / 5.3;
    for (x, angle) in [(0.0, 0.0), (1.0, 0.2), (-1.0, 0.2), (-2.0, -0.2)] {
        let state = [x, 0.0, angle, 0.0];
        let cart = places(state, size, Ansi::Blue).into_iter();
        let pole = places(state, size, Ansi::Yellow);
        let top = pole[0].1;
        let tip = mean_column(pole.into_iter().filter(|&(_, row)| row == top));
        assert!((mean_column(cart) - x * metre).abs() < 1.5);
        assert!((tip - (x + 0.96 * angle.sin()) * metre).abs() < 1.0, "{x} {angle}: {tip}");
    }
}

#[test]
fn everything_is_seen_whatever_the_shape_of_the_area() {
    for size in [(30, 8), (35, 30), (200, 10), (300, 80)] {
        let seen = |color| places([0.0; 4], size, color);
        let (track, cart, pole) = (seen(Ansi::DarkGray), seen(Ansi::Blue), seen(Ansi::Yellow));
        assert!(!cart.is_empty(), "{size:?}");
        let rows = |places: &[(f64, u16)]| places[places.len() - 1].1 - places[0].1 + 1;
        assert!(rows(&pole) >= 3, "{size:?}");
        let ends = track.iter().map(|(x, _)| *x).fold((0.0_f64, 0.0_f64), |(l, r), x| (l.min(x), r.max(x)));
        assert!((ends.0 + ends.1).abs() <= 1.0 && ends.1 >= 8.0, "{size:?}: {ends:?}");
    }
}
