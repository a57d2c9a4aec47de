//! Plots as SVG: axes, lines, steps, bands and intervals on a light background. The same data give the same bytes.

use std::fmt::Write;

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 36.0;
const BOTTOM: f64 = 52.0;
const LEGEND_LINE: f64 = 18.0;

/// Colours that people with any colour vision can tell apart (Okabe and Ito 2008), without yellow.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// A plot that is being drawn.
#[derive(Debug)]
pub(super) struct Plot {
    title: String,
    labels: [String; 2],
    x: (f64, f64),
    y: (f64, f64),
    y_ticks: bool,
    marks: String,
    legend: String,
    legend_lines: u32,
}

impl Plot {
    /// A plot over the given ranges; an empty range is widened.
    pub(super) fn new(title: &str, [x_label, y_label]: [&str; 2], x: (f64, f64), y: (f64, f64)) -> Self {
        let widened = |(low, high): (f64, f64)| (low, if high > low { high } else { low + 1.0 });
        Self {
            title: escaped(title),
            labels: [escaped(x_label), escaped(y_label)],
            x: widened(x),
            y: widened(y),
            y_ticks: true,
            marks: String::new(),
            legend: String::new(),
            legend_lines: 0,
        }
    }

    /// Without numbers at the y axis.
    pub(super) fn without_y_ticks(mut self) -> Self {
        self.y_ticks = false;
        self
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let share = |value: f64, (low, high): (f64, f64)| ((value - low) / (high - low)).clamp(0.0, 1.0);
        (
            LEFT + share(x, self.x) * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - share(y, self.y) * (HEIGHT - TOP - BOTTOM),
        )
    }

    fn path(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let mut path = String::new();
        for (i, point) in points.enumerate() {
            let (x, y) = self.place(point);
            let _ = write!(path, "{}{x:.1},{y:.1}", if i == 0 { "M" } else { "L" });
        }
        path
    }

    /// A line through points.
    pub(super) fn line(&mut self, series: usize, points: &[(f64, f64)]) {
        let path = self.path(points.iter().copied());
        let _ = writeln!(
            self.marks,
            r#"<path d="{path}" fill="none" stroke="{}" stroke-width="2"{}/>"#,
            colour(series),
            dashes(series)
        );
    }

    /// A line that keeps each y until the next x.
    pub(super) fn steps(&mut self, series: usize, points: &[(f64, f64)]) {
        let corners = points.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
        let corners: Vec<_> = corners.chain(points.last().copied()).collect();
        self.line(series, &corners);
    }

    /// The area between two lines: (x, low, high).
    pub(super) fn band(&mut self, series: usize, points: &[(f64, f64, f64)]) {
        let upper = points.iter().map(|&(x, _, high)| (x, high));
        let path = self.path(upper.chain(points.iter().rev().map(|&(x, low, _)| (x, low))));
        let _ = writeln!(self.marks, r#"<path d="{path}Z" fill="{}" fill-opacity="0.18"/>"#, colour(series));
    }

    /// A point at `x` in the height `y` with its interval, and a text above.
    pub(super) fn interval(&mut self, series: usize, y: f64, x: f64, ends: Option<(f64, f64)>, text: &str) {
        let (middle, height) = self.place((x, y));
        let colour = colour(series);
        if let Some((low, high)) = ends {
            let path = self.path([(low, y), (high, y)].into_iter());
            let _ = writeln!(self.marks, r#"<path d="{path}" stroke="{colour}" stroke-width="3"/>"#);
        }
        let _ = writeln!(self.marks, r#"<circle cx="{middle:.1}" cy="{height:.1}" r="5" fill="{colour}"/>"#);
        let above = height - 10.0;
        let _ =
            writeln!(self.marks, r#"<text x="{:.1}" y="{above:.1}">{}</text>"#, LEFT + 8.0, escaped(text));
    }

    /// A thin horizontal line with a text.
    pub(super) fn level(&mut self, y: f64, text: &str) {
        let (left, height) = self.place((self.x.0, y));
        let right = WIDTH - RIGHT;
        let _ = writeln!(
            self.marks,
            r##"<path d="M{left:.1},{height:.1}L{right:.1},{height:.1}" stroke="#888" stroke-dasharray="2 4"/><text x="{right:.1}" y="{:.1}" text-anchor="end" fill="#666">{}</text>"##,
            height - 4.0,
            escaped(text)
        );
    }

    /// A line of the legend, below the plot.
    pub(super) fn legend(&mut self, series: usize, text: &str) {
        let y = HEIGHT + LEGEND_LINE * f64::from(self.legend_lines);
        self.legend_lines += 1;
        let _ = writeln!(
            self.legend,
            r#"<path d="M{LEFT},{y}h24" stroke="{}" stroke-width="3"{}/><text x="{}" y="{}">{}</text>"#,
            colour(series),
            dashes(series),
            LEFT + 32.0,
            y + 4.0,
            escaped(text)
        );
    }

    fn axes(&self) -> String {
        let mut axes = String::new();
        let (left, bottom) = self.place((self.x.0, self.y.0));
        let (right, top) = self.place((self.x.1, self.y.1));
        for tick in ticks(self.x) {
            let (x, _) = self.place((tick, 0.0));
            let _ = writeln!(
                axes,
                r##"<path d="M{x:.1},{top:.1}V{bottom:.1}" stroke="#e4e4e4"/><text x="{x:.1}" y="{:.1}" text-anchor="middle">{}</text>"##,
                bottom + 18.0,
                number(tick)
            );
        }
        for tick in ticks(self.y).into_iter().filter(|_| self.y_ticks) {
            let (_, y) = self.place((0.0, tick));
            let _ = writeln!(
                axes,
                r##"<path d="M{left:.1},{y:.1}H{right:.1}" stroke="#e4e4e4"/><text x="{:.1}" y="{:.1}" text-anchor="end">{}</text>"##,
                left - 8.0,
                y + 4.0,
                number(tick)
            );
        }
        let _ = writeln!(
            axes,
            r##"<path d="M{left:.1},{top:.1}V{bottom:.1}H{right:.1}" fill="none" stroke="#444"/>"##
        );
        axes
    }

    /// The whole SVG file.
    pub(super) fn finish(self) -> String {
        let height = HEIGHT + LEGEND_LINE * f64::from(self.legend_lines);
        let [x_label, y_label] = &self.labels;
        let middle = (LEFT + WIDTH - RIGHT) / 2.0;
        let side = (TOP + HEIGHT - BOTTOM) / 2.0;
        format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" font-family="sans-serif" font-size="12">
<title>{title}</title>
<rect width="100%" height="100%" fill="#fff"/>
<text x="{middle}" y="22" text-anchor="middle" font-size="15">{title}</text>
{axes}<text x="{middle}" y="{}" text-anchor="middle">{x_label}</text>
<text transform="translate(16 {side}) rotate(-90)" text-anchor="middle">{y_label}</text>
{marks}{legend}</svg>
"##,
            HEIGHT - 14.0,
            title = self.title,
            axes = self.axes(),
            marks = self.marks,
            legend = self.legend,
        )
    }
}

fn colour(series: usize) -> &'static str {
    COLOURS[series % COLOURS.len()]
}

/// Tells apart series of the same colour.
fn dashes(series: usize) -> String {
    match series / COLOURS.len() {
        0 => String::new(),
        round => format!(r#" stroke-dasharray="{} 4""#, 8 / round.min(7) + 1),
    }
}

/// About five round numbers in a range: multiples of 1, 2 or 5 times a power of ten.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let mut power = 1.0;
    while power * 10.0 <= rough {
        power *= 10.0;
    }
    while power > rough {
        power /= 10.0;
    }
    let step = [10.0, 5.0, 2.0]
        .map(|factor| factor * power)
        .into_iter()
        .filter(|&step| step <= rough)
        .fold(power, f64::max);
    let first = (low / step).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A tick's number without the noise of its last bits.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn escaped(text: &str) -> String {
    let text: String = text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
