//! A scene in the terminal: dots of braille, to scale.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color as Ansi;
use ratatui::symbols::Marker;
use ratatui::widgets::Block;
use ratatui::widgets::canvas::{Canvas, Context, Line, Painter, Shape as Draws};

use super::Placed;
use crate::env::scene::{Bounds, Color, Outline, Scene, Shape};

/// A filled shape, tried at points at this distance.
struct Filled<'a>(Placed<'a>, f64);

impl Draws for Filled<'_> {
    fn draw(&self, painter: &mut Painter<'_, '_>) {
        let Self(placed, distance) = self;
        let Bounds { left, right, bottom, top } = placed.bounds;
        let points = |low: f64, high: f64| {
            (0..=((high - low) / distance) as u32).map(move |i| low + f64::from(i) * distance)
        };
        for point in points(left, right).flat_map(|x| points(bottom, top).map(move |y| (x, y))) {
            if placed.contains(point)
                && let Some((column, row)) = painter.get_point(point.0, point.1)
            {
                painter.paint(column, row, filled(placed.shape.color));
            }
        }
    }
}

/// The color of a filled shape. Black and white are a terminal's ground, and neither shows on every one.
fn filled(color: Color) -> Ansi {
    match color {
        Color::Ink => Ansi::Blue,
        Color::Tan | Color::Yellow => Ansi::Yellow,
        Color::Cyan => Ansi::Cyan,
        Color::Grey => Ansi::Gray,
        Color::Lavender => Ansi::Magenta,
    }
}

/// Draws the focus of a scene as large as an area allows, framed by `block`.
pub fn draw(frame: &mut Frame<'_>, area: Rect, block: Block<'_>, scene: &Scene) {
    let inner = block.inner(area);
    let Bounds { left, right, bottom, top } = scene.focus;
    // A character has 2 × 4 dots, and dots are about square.
    let (columns, rows) = (2.0 * f64::from(inner.width), 4.0 * f64::from(inner.height));
    let dot = ((right - left) / columns).max((top - bottom) / rows);
    let bounds = |low: f64, high: f64, dots: f64| {
        let middle = f64::midpoint(low, high);
        [middle - dot * dots / 2.0, middle + dot * dots / 2.0]
    };
    let is_line = |shape: &&Shape| matches!(shape.outline, Outline::Line(_));
    let canvas = Canvas::default()
        .block(block)
        .marker(Marker::Braille)
        .x_bounds(bounds(left, right, columns))
        .y_bounds(bounds(bottom, top, rows))
        .paint(|context| {
            // A line lies below all else, because a dot gives its color to its whole character.
            scene.shapes.iter().filter(is_line).for_each(|line| draw_line(context, line));
            for shape in scene.shapes.iter().filter(|shape| !is_line(shape)) {
                context.draw(&Filled(Placed::new(shape), dot / 3.0));
            }
        });
    frame.render_widget(canvas, area);
}

fn draw_line(context: &mut Context<'_>, shape: &Shape) {
    let Outline::Line(points) = &shape.outline else { return };
    let placed = Placed::new(shape);
    for ends in points.windows(2) {
        let [(x1, y1), (x2, y2)] = [ends[0], ends[1]].map(|point| placed.in_picture(point));
        context.draw(&Line { x1, y1, x2, y2, color: Ansi::DarkGray });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
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
            let ends =
                track.iter().map(|(x, _)| *x).fold((0.0_f64, 0.0_f64), |(l, r), x| (l.min(x), r.max(x)));
            assert!((ends.0 + ends.1).abs() <= 1.0 && ends.1 >= 8.0, "{size:?}: {ends:?}");
        }
    }
}
