//! Scenes as pictures: an episode as an animated GIF or SVG, and one scene in the terminal.
//!
//! Every drawing works for every environment, because an environment gives its picture as shapes. The same scenes give the
//! same bytes. Another program gives its picture as pixels, which a [`Film`] holds as they are.

#[cfg(feature = "view")]
mod braille;
mod gif;
mod svg;

#[cfg(feature = "view")]
pub(crate) use braille::draw as draw_braille;
pub(crate) use gif::{Film, is_film, is_gif, write_gif};
pub(crate) use svg::{is_svg, svg};

use crate::env::scene::{Bounds, Outline, Scene, Shape};

struct Placed<'a> {
    shape: &'a Shape,
    sin: f64,
    cos: f64,
    bounds: Bounds,
}

impl<'a> Placed<'a> {
    fn new(shape: &'a Shape) -> Self {
        let (sin, cos) = (libm::sin(shape.angle), libm::cos(shape.angle));
        let bounds = Bounds { left: 0.0, right: 0.0, bottom: 0.0, top: 0.0 };
        let placed = Self { shape, sin, cos, bounds };
        let (points, margin) = match &shape.outline {
            Outline::Polygon(points) => (&points[..], 0.0),
            Outline::Circle(radius) => (&[(0.0, 0.0)][..], *radius),
            Outline::Line(points) => (&points[..], 0.5),
        };
        let points: Vec<_> = points.iter().map(|&point| placed.in_picture(point)).collect();
        let smallest =
            |value: fn(&(f64, f64)) -> f64| points.iter().map(value).fold(f64::INFINITY, f64::min) - margin;
        let (left, right) = (smallest(|point| point.0), -smallest(|point| -point.0));
        let (bottom, top) = (smallest(|point| point.1), -smallest(|point| -point.1));
        Self { bounds: Bounds { left, right, bottom, top }, ..placed }
    }

    fn in_picture(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let at = self.shape.at;
        (at.0 + x * self.cos - y * self.sin, at.1 + x * self.sin + y * self.cos)
    }

    fn contains(&self, (x, y): (f64, f64)) -> bool {
        let Bounds { left, right, bottom, top } = self.bounds;
        if x < left || x > right || y < bottom || y > top {
            return false;
        }
        let (x, y) = (x - self.shape.at.0, y - self.shape.at.1);
        let point = (x * self.cos + y * self.sin, y * self.cos - x * self.sin);
        match &self.shape.outline {
            Outline::Polygon(corners) => is_inside(point, corners),
            Outline::Circle(radius) => point.0 * point.0 + point.1 * point.1 < radius * radius,
            Outline::Line(points) => points.windows(2).any(|ends| is_on_line(point, ends[0], ends[1])),
        }
    }
}

/// Whether a point is inside of a polygon: a ray to the right crosses an odd number of sides.
fn is_inside((x, y): (f64, f64), corners: &[(f64, f64)]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crosses = |&(a, b): &(&(f64, f64), &(f64, f64))| {
        (a.1 > y) != (b.1 > y) && x < a.0 + (b.0 - a.0) * (y - a.1) / (b.1 - a.1)
    };
    corners.iter().zip(next).filter(crosses).count() % 2 == 1
}

/// Whether a point lies on the line between `a` and `b`. Most points do not even lie in its bounding box.
fn is_on_line(point: (f64, f64), a: (f64, f64), b: (f64, f64)) -> bool {
    let is_beside = |at: f64, a: f64, b: f64| at < a.min(b) - 0.5 || at > a.max(b) + 0.5;
    if is_beside(point.0, a.0, b.0) || is_beside(point.1, a.1, b.1) {
        return false;
    }
    let (across, along) = ((point.0 - a.0, point.1 - a.1), (b.0 - a.0, b.1 - a.1));
    let length = along.0 * along.0 + along.1 * along.1;
    let dot = across.0 * along.0 + across.1 * along.1;
    let share = if length > 0.0 { (dot / length).clamp(0.0, 1.0) } else { 0.0 };
    libm::hypot(across.0 - share * along.0, across.1 - share * along.1) < 0.5
}

pub(crate) struct Motion<'a> {
    pub(crate) shape: &'a Shape,
    pub(crate) at: Vec<(f64, f64)>,
    /// In every scene, in rad.
    pub(crate) angle: Vec<f64>,
}

pub(crate) fn motions(scenes: &[Scene]) -> Vec<Motion<'_>> {
    let shapes = scenes.first().map_or(&[][..], |scene| &scene.shapes);
    let motion = |(i, shape): (usize, _)| {
        let placed = scenes.iter().filter_map(|scene| scene.shapes.get(i));
        let (at, angle) = placed.map(|shape| (shape.at, shape.angle)).unzip();
        Motion { shape, at, angle }
    };
    shapes.iter().enumerate().map(motion).collect()
}

#[cfg(test)]
#[path = "../../tests/unit/draw.rs"]
mod tests;
