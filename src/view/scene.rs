//! The cart, the pole and the track in braille, to scale.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::widgets::Block;
use ratatui::widgets::canvas::{Canvas, Line, Painter, Shape};

use crate::env::CartPole;

/// What must be seen, in m: the track with its ends, and the height of the cart and the pole.
const WIDTH: f64 = 2.0 * CartPole::MAX_POSITION + 0.5;
const BOTTOM: f64 = -0.2;
const TOP: f64 = 1.1;

const CART: Plate = Plate { angle: 0.0, x: (-0.2, 0.2), y: (-0.12, 0.12), colour: Color::Blue };
const AXLE_Y: f64 = 0.06;
const POLE: Plate =
    Plate { angle: 0.0, x: (-0.035, 0.035), y: (-0.04, CartPole::POLE_LENGTH - 0.04), colour: Color::Yellow };

/// A filled rectangle around a point that lies at `at`, turned clockwise by `angle`.
#[derive(Clone, Copy)]
struct Plate {
    angle: f64,
    x: (f64, f64),
    y: (f64, f64),
    colour: Color,
}

/// A plate in its place.
struct Placed(Plate, (f64, f64));

impl Shape for Placed {
    fn draw(&self, painter: &mut Painter<'_, '_>) {
        /// Finer than a dot of any terminal, in m.
        const FINE: f64 = 0.005;
        let Self(Plate { angle, x, y, colour }, at) = *self;
        let (sin, cos) = angle.sin_cos();
        let points = |(low, high): (f64, f64)| {
            (0..=((high - low) / FINE) as u32).map(move |i| low + f64::from(i) * FINE)
        };
        for (x, y) in points(x).flat_map(|x| points(y).map(move |y| (x, y))) {
            if let Some((x, y)) = painter.get_point(at.0 + x * cos + y * sin, at.1 - x * sin + y * cos) {
                painter.paint(x, y, colour);
            }
        }
    }
}

/// Draws a state, framed by `block`.
pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, block: Block<'_>, state: [f64; 4]) {
    let inner = block.inner(area);
    // A character has 2 × 4 dots, and dots are about square.
    let (columns, rows) = (2.0 * f64::from(inner.width), 4.0 * f64::from(inner.height));
    let dot = (WIDTH / columns).max((TOP - BOTTOM) / rows);
    let (half, height) = (dot * columns / 2.0, dot * rows);
    let bottom = BOTTOM - (height - (TOP - BOTTOM)) / 2.0;
    let [x, _, angle, _] = state;
    let line = |x1, y1, x2, y2| Line { x1, y1, x2, y2, color: Color::DarkGray };
    let canvas = Canvas::default()
        .block(block)
        .marker(Marker::Braille)
        .x_bounds([-half, half])
        .y_bounds([bottom, bottom + height])
        .paint(|context| {
            let end = CartPole::MAX_POSITION;
            context.draw(&line(-end, 0.0, end, 0.0));
            for end in [-end, end] {
                context.draw(&line(end, -0.1, end, 0.1));
            }
            context.draw(&Placed(CART, (x, 0.0)));
            context.draw(&Placed(Plate { angle, ..POLE }, (x, AXLE_Y)));
        });
    frame.render_widget(canvas, area);
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    /// The characters of a colour: columns from the middle, and rows from above.
    fn places(state: [f64; 4], (width, height): (u16, u16), colour: Color) -> Vec<(f64, u16)> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, frame.area(), Block::new(), state)).unwrap();
        let buffer = terminal.backend().buffer();
        let cells = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        cells
            .filter(|&place| buffer[place].fg == colour)
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
        let metre = f64::from(size.0) / WIDTH;
        for (x, angle) in [(0.0, 0.0), (1.0, 0.2), (-1.0, 0.2), (-2.0, -0.2)] {
            let state = [x, 0.0, angle, 0.0];
            let cart = places(state, size, CART.colour).into_iter();
            let pole = places(state, size, POLE.colour);
            let top = pole[0].1;
            let tip = mean_column(pole.into_iter().filter(|&(_, row)| row == top));
            assert!((mean_column(cart) - x * metre).abs() < 1.5);
            assert!((tip - (x + 0.96 * angle.sin()) * metre).abs() < 1.0, "{x} {angle}: {tip}");
        }
    }

    #[test]
    fn everything_is_seen_whatever_the_shape_of_the_area() {
        for size in [(30, 8), (35, 30), (200, 10), (300, 80)] {
            let seen = |colour| places([0.0; 4], size, colour);
            let (track, cart, pole) = (seen(Color::DarkGray), seen(CART.colour), seen(POLE.colour));
            assert!(!cart.is_empty(), "{size:?}");
            let rows = |places: &[(f64, u16)]| places[places.len() - 1].1 - places[0].1 + 1;
            assert!(rows(&pole) >= 3, "{size:?}");
            let ends =
                track.iter().map(|(x, _)| *x).fold((0.0_f64, 0.0_f64), |(l, r), x| (l.min(x), r.max(x)));
            assert!((ends.0 + ends.1).abs() <= 1.0 && ends.1 >= 8.0, "{size:?}: {ends:?}");
        }
    }
}
