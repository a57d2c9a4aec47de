//! SVG, animated by SMIL: every browser plays it, as an image too, and it stays sharp.

use super::{Motion, motions};
use crate::env::scene::{Outline, Scene, Shape};

const WIDTH: u16 = Scene::WIDTH;
const HEIGHT: u16 = Scene::HEIGHT;

/// The beginning of every picture, by which [`is_svg`] recognises it.
fn start() -> String {
    format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">
<title>"#
    )
}

pub(crate) fn is_svg(start: &[u8]) -> bool {
    start.starts_with(self::start().as_bytes())
}

/// The episode of these scenes, at least one, as an SVG file with a title without markup. The last scene stays for a second.
pub(crate) fn svg(scenes: &[Scene], frames_per_second: f64, title: &str) -> String {
    let held = frames_per_second.round().max(1.0);
    let animation =
        Animation { seconds: (scenes.len() as f64 - 1.0 + held) / frames_per_second, held: held as usize };
    let mut text = start() + title + "</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n";
    // Neighbours that move together share one animation.
    for group in motions(scenes).chunk_by(|a, b| a.at == b.at) {
        text += &moved(&group[0].at, &animation, &shapes(group, &animation));
    }
    text + "</svg>\n"
}

/// Elements at their first place, and their motion as differences from it, which take fewer digits.
fn moved(at: &[(f64, f64)], animation: &Animation, elements: &str) -> String {
    let &[first, ..] = at else { return String::new() };
    let difference = |&(x, y): &(f64, f64)| {
        let (x, y) = (short(x - first.0), short(first.1 - y));
        if y == "0" { x } else { format!("{x} {y}") }
    };
    let differences: Vec<_> = at.iter().map(difference).collect();
    let place = format!("{} {}", short(first.0), short(f64::from(HEIGHT) - first.1));
    animation.wrapped("translate", &[place], &animation.wrapped("translate", &differences, elements))
}

fn shapes(group: &[Motion<'_>], animation: &Animation) -> String {
    let turned = |motion: &Motion<'_>| {
        // Angles of SVG are clockwise.
        let angles: Vec<_> = motion.angle.iter().map(|angle| short(-angle.to_degrees())).collect();
        animation.wrapped("rotate", &angles, &element(motion.shape))
    };
    group.iter().map(turned).collect()
}

/// How long an animation lasts, and how often the last value is repeated.
struct Animation {
    seconds: f64,
    held: usize,
}

impl Animation {
    /// Elements in a group with a transform, which is animated unless it stays the same, and left out if it does nothing.
    fn wrapped(&self, kind: &str, values: &[String], elements: &str) -> String {
        let first = values.first().map_or("0", String::as_str);
        if values.iter().all(|value| value == "0") {
            return elements.into();
        }
        let mut text = format!("<g transform=\"{kind}({first})\">\n");
        if values.iter().any(|value| value != first) {
            let held = values.last().into_iter().cycle().take(self.held);
            let values: Vec<&str> = values.iter().chain(held).map(String::as_str).collect();
            let (seconds, values) = (self.seconds, values.join(";"));
            text += &format!(
                "<animateTransform attributeName=\"transform\" type=\"{kind}\" dur=\"{seconds:.2}s\" \
                 repeatCount=\"indefinite\" values=\"{values}\"/>\n"
            );
        }
        text + elements + "</g>\n"
    }
}

/// A shape around (0, 0), with heights that count downwards.
fn element(shape: &Shape) -> String {
    let points = |points: &[(f64, f64)]| {
        points.iter().map(|&(x, y)| format!("{},{}", short(x), short(-y))).collect::<Vec<_>>().join(" ")
    };
    let [red, green, blue] = shape.color.rgb();
    let color = format!("#{red:02x}{green:02x}{blue:02x}");
    match &shape.outline {
        Outline::Polygon(corners) => format!("<polygon points=\"{}\" fill=\"{color}\"/>\n", points(corners)),
        Outline::Circle(radius) => format!("<circle r=\"{}\" fill=\"{color}\"/>\n", short(*radius)),
        Outline::Line(line) => {
            format!("<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\"/>\n", points(line))
        }
    }
}

fn short(value: f64) -> String {
    // Adding 0 to -0 gives 0.
    ((value * 100.0).round() / 100.0 + 0.0).to_string()
}
