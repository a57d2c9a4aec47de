//! A scene in the terminal: dots of braille, to scale.

use ratatui::style::Color as Ansi;
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
pub fn draw(frame: &mut ratatui::Frame<'_>, area: ratatui::layout::Rect, block: Block<'_>, scene: &Scene) {
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
        .marker(ratatui::symbols::Marker::Braille)
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
#[path = "../../tests/unit/draw_braille.rs"]
mod tests;
