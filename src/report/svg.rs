//! Plots as SVG: axes, lines, steps, bands and intervals on a light background. The same data give the same bytes.

use crate::text::{lines, visible};

pub(super) const START: &str = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 720 "#;
const LEGEND_LINE: f64 = 18.0;
/// Widest line of text in a plot, in characters.
const LINE: usize = 84;
/// Pixels that a number takes along the x axis and along the y axis.
const TICK: (f64, f64) = (48.0, 32.0);

/// The size of a plot in pixels, and what surrounds its axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    width: f64,
    height: f64,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    /// Whether the plot has title, legend and axis names; a page has them around the plot.
    named: bool,
}

impl Layout {
    pub(super) const FILE: Self =
        Self { width: 720.0, height: 400.0, left: 64.0, right: 24.0, top: 36.0, bottom: 52.0, named: true };
    /// In a page on a screen.
    pub(super) const WIDE: Self =
        Self { width: 960.0, height: 340.0, left: 46.0, top: 10.0, named: false, ..Self::FILE };
    /// In a page on a phone.
    pub(super) const NARROW: Self = Self { width: 350.0, height: 260.0, right: 20.0, ..Self::WIDE };

    pub(super) const fn low(self) -> Self {
        Self { height: self.height / 2.0, bottom: 28.0, ..self }
    }

    /// Just high enough for this many rows, each with a name above it.
    pub(super) fn for_rows(self, rows: usize) -> Self {
        Self { height: self.top + self.bottom + 44.0 * rows as f64, ..self }
    }
}

/// Colours that people with any colour vision can tell apart (Okabe and Ito 2008), without yellow.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
const BACKGROUND: &str = "#fff";
const GRID: &str = "#e4e4e4";
const AXIS: &str = "#444";
const LEVEL: &str = "#888";
/// The style of a line that only helps to read.
const THIN: &str = r##"stroke="#888" stroke-dasharray="2 4""##;

/// What a dark page shows instead of the colours.
pub(super) const DARK: [(&str, &str); 11] = [
    ("#0072b2", "#4da6e0"),
    ("#d55e00", "#ff8a3d"),
    ("#009e73", "#2cc79b"),
    ("#cc79a7", "#e096c0"),
    ("#e69f00", "#ffc04d"),
    ("#56b4e9", "#8fd0f7"),
    ("#000000", "#f0f0f0"),
    (BACKGROUND, "none"),
    (GRID, "#333a42"),
    (AXIS, "#a0a8b0"),
    (LEVEL, "#8a929a"),
];

pub(super) struct Plot {
    layout: Layout,
    title: Vec<String>,
    labels: [String; 2],
    x: (f64, f64),
    y: (f64, f64),
    pub(super) has_y_ticks: bool,
    /// Whether y is an exponent, and the y axis has powers of ten.
    pub(super) is_logarithmic: bool,
    marks: String,
    legend: Vec<(usize, String)>,
}

impl Plot {
    /// A plot over these ranges, which are widened if they are too narrow.
    pub(super) fn new(layout: Layout, title: &str, labels: [&str; 2], x: (f64, f64), y: (f64, f64)) -> Self {
        let title = lines(&visible(title), LINE);
        let more = if layout.named { LEGEND_LINE * (title.len() - 1) as f64 } else { 0.0 };
        let layout = Layout { top: layout.top + more, height: layout.height + more, ..layout };
        let (x, y, labels) = (drawable(x), drawable(y), labels.map(escaped));
        let (marks, legend) = (String::new(), Vec::new());
        Self { layout, title, labels, x, y, has_y_ticks: true, is_logarithmic: false, marks, legend }
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        // Halves, as the width of a range of the largest numbers is no number.
        let share = |value: f64, (low, high): (f64, f64)| {
            ((value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0)).clamp(0.0, 1.0)
        };
        let Layout { width, height, left, right, top, bottom, .. } = self.layout;
        let (across, up) =
            (share(x, self.x) * (width - left - right), share(y, self.y) * (height - top - bottom));
        (left + across, height - bottom - up)
    }

    fn path(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let mut path = String::new();
        for (i, point) in points.filter(|(x, y)| x.is_finite() && y.is_finite()).enumerate() {
            let (x, y) = self.place(point);
            path += &format!("{}{x:.1},{y:.1}", if i == 0 { "M" } else { "L" });
        }
        path
    }

    pub(super) fn line(&mut self, series: usize, points: &[(f64, f64)]) {
        self.line_of_width(series, points, "2");
    }

    pub(super) fn faint_line(&mut self, series: usize, points: &[(f64, f64)]) {
        self.line_of_width(series, points, r#"1" stroke-opacity="0.6"#);
    }

    fn line_of_width(&mut self, series: usize, points: &[(f64, f64)], width: &str) {
        let colour = colour(series);
        // A line through one point has no length.
        if let &[(x, y)] = points
            && x.is_finite()
            && y.is_finite()
        {
            self.dot((x, y), 3, colour);
        }
        let style = format!(r#"fill="none" stroke="{colour}" stroke-width="{width}"{}"#, dashes(series));
        self.marks += &(path(&self.path(points.iter().copied()), &style) + "\n");
    }

    /// A line that keeps each y until the next x.
    pub(super) fn steps(&mut self, series: usize, points: &[(f64, f64)]) {
        let corners = points.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
        let corners: Vec<_> = corners.chain(points.last().copied()).collect();
        self.line(series, &corners);
    }

    /// The area between two lines: (x, low, high).
    pub(super) fn band(&mut self, series: usize, points: &[(f64, f64, f64)]) {
        if points.is_empty() {
            return;
        }
        let upper = points.iter().map(|&(x, _, high)| (x, high));
        let outline = self.path(upper.chain(points.iter().rev().map(|&(x, low, _)| (x, low)))) + "Z";
        let style = format!(r#"fill="{}" fill-opacity="0.18""#, colour(series));
        self.marks += &(path(&outline, &style) + "\n");
    }

    /// A point at `x` in the height `y` with its interval, and a text above.
    pub(super) fn interval(&mut self, series: usize, y: f64, x: f64, ends: Option<(f64, f64)>, said: &str) {
        if !x.is_finite() {
            return;
        }
        let colour = colour(series);
        if let Some((low, high)) = ends {
            let style = format!(r#"stroke="{colour}" stroke-width="3""#);
            self.marks += &(path(&self.path([(low, y), (high, y)].into_iter()), &style) + "\n");
        }
        let (_, height) = self.dot((x, y), 5, colour);
        self.marks += &(text(self.layout.left + 8.0, height - 10.0, "", &escaped(said)) + "\n");
    }

    fn dot(&mut self, point: (f64, f64), radius: u8, colour: &str) -> (f64, f64) {
        let (x, y) = self.place(point);
        self.marks += &format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{colour}\"/>\n");
        (x, y)
    }

    pub(super) fn upright(&mut self, x: f64) {
        self.marks += &(path(&self.path([(x, self.y.0), (x, self.y.1)].into_iter()), THIN) + "\n");
    }

    /// A thin horizontal line with a text.
    pub(super) fn level(&mut self, y: f64, said: &str) {
        if !y.is_finite() {
            return;
        }
        let (left, height) = self.place((self.x.0, y));
        let right = self.layout.width - self.layout.right;
        self.marks += &path(&format!("M{left:.1},{height:.1}L{right:.1},{height:.1}"), THIN);
        let style = r##" text-anchor="end" fill="#666""##;
        self.marks += &(text(right, height + 13.0, style, &escaped(said)) + "\n");
    }

    pub(super) fn legend(&mut self, series: usize, text: &str) {
        self.legend.push((series, visible(text)));
    }

    /// The legend, and the height with it.
    fn drawn_legend(&self) -> (String, f64) {
        let (Layout { left, height: mut y, .. }, mut legend) = (self.layout, String::new());
        for (series, text) in &self.legend {
            legend += &(sample(&format!("M{left},{y}h24"), *series) + "\n");
            for line in lines(text, LINE) {
                let (x, baseline, line) = (left + 32.0, y + 4.0, escaped(&line));
                legend += &format!("<text x=\"{x}\" y=\"{baseline}\">{line}</text>\n");
                y += LEGEND_LINE;
            }
        }
        (legend, y)
    }

    /// Title, what y is, and legend as HTML, for a plot that is not labelled.
    pub(super) fn caption(&self) -> String {
        let mut caption = format!("<b>{}</b>", self.escaped_title());
        if !self.labels[1].is_empty() {
            caption += &format!(" ({})", self.labels[1]);
        }
        for (series, text) in &self.legend {
            let (line, text) = (sample("M0,3h24", *series), escaped(text));
            caption += &format!(r#" <span><svg viewBox="0 0 24 6">{line}</svg> {text}</span>"#);
        }
        caption
    }

    fn escaped_title(&self) -> String {
        escaped(&self.title.join(" "))
    }

    fn drawn_title(&self, middle: f64) -> String {
        let line = |(i, line): (usize, &String)| {
            let (y, line) = (22.0 + LEGEND_LINE * i as f64, escaped(line));
            format!("<text x=\"{middle}\" y=\"{y}\" text-anchor=\"middle\" font-size=\"15\">{line}</text>\n")
        };
        self.title.iter().enumerate().map(line).collect()
    }

    fn axes(&self) -> String {
        let mut axes = String::new();
        let (left, bottom) = self.place((self.x.0, self.y.0));
        let (right, top) = self.place((self.x.1, self.y.1));
        let grid = format!("stroke=\"{GRID}\"");
        let Layout { width, height, left: before, right: after, top: above, bottom: below, .. } = self.layout;
        let x_ticks = ticks(self.x, ((width - before - after) / TICK.0).min(10.0));
        for (&tick, number) in x_ticks.iter().zip(numbers(&x_ticks)) {
            let (x, _) = self.place((tick, 0.0));
            axes += &path(&format!("M{x:.1},{top:.1}V{bottom:.1}"), &grid);
            axes += &(text(x, bottom + 18.0, r#" text-anchor="middle""#, &number) + "\n");
        }
        let mut y_ticks = ticks(self.y, ((height - above - below) / TICK.1).min(10.0));
        y_ticks.retain(|tick| self.has_y_ticks && (!self.is_logarithmic || tick.fract() == 0.0));
        for (&tick, number) in y_ticks.iter().zip(numbers(&y_ticks)) {
            let (_, y) = self.place((0.0, tick));
            let number = if self.is_logarithmic { format!("1e{tick}") } else { number };
            axes += &path(&format!("M{left:.1},{y:.1}H{right:.1}"), &grid);
            axes += &(text(left - 8.0, y + 4.0, r#" text-anchor="end""#, &number) + "\n");
        }
        let frame = format!("M{left:.1},{top:.1}V{bottom:.1}H{right:.1}");
        axes + &path(&frame, &format!(r#"fill="none" stroke="{AXIS}""#)) + "\n"
    }

    pub(super) fn finish(self) -> String {
        let Layout { width, height: plot_height, left, right, top, bottom, named } = self.layout;
        let (middle, side) = ((left + width - right) / 2.0, (top + plot_height - bottom) / 2.0);
        let [x_label, y_label] = &self.labels;
        let (mut height, mut around) = (plot_height, String::new());
        if named {
            let (legend, end) = self.drawn_legend();
            around = self.drawn_title(middle)
                + &format!(
                    "<text transform=\"translate(16 {side}) rotate(-90)\" text-anchor=\"middle\">{y_label}</text>\n"
                )
                + &legend;
            height = end;
        }
        format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="sans-serif" font-size="12">
<title>{title}</title>
<rect width="100%" height="100%" fill="{BACKGROUND}"/>
{axes}<text x="{middle}" y="{}" text-anchor="middle">{x_label}</text>
{marks}{around}</svg>
"##,
            plot_height - 14.0,
            title = self.escaped_title(),
            axes = self.axes(),
            marks = self.marks,
        )
    }
}

fn path(commands: &str, style: &str) -> String {
    format!("<path d=\"{commands}\" {style}/>")
}

fn text(x: f64, y: f64, style: &str, content: &str) -> String {
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\"{style}>{content}</text>")
}

fn sample(commands: &str, series: usize) -> String {
    path(commands, &format!(r#"stroke="{}" stroke-width="3"{}"#, colour(series), dashes(series)))
}

fn colour(series: usize) -> &'static str {
    COLOURS[series % COLOURS.len()]
}

fn dashes(series: usize) -> String {
    match series / COLOURS.len() {
        0 => String::new(),
        round => format!(r#" stroke-dasharray="{} 4""#, 8 / round.min(7) + 1),
    }
}

/// A range, widened if it is too narrow for different numbers along an axis.
fn drawable((low, high): (f64, f64)) -> (f64, f64) {
    let bounded = |end: f64| if end.is_nan() { 0.0 } else { end.clamp(-1e308, 1e308) };
    let (low, high) = (bounded(low), bounded(high));
    let least = (1e-9 * low.abs().max(high.abs())).max(1e-300);
    if high - low >= least { (low, high) } else { (low, low + least.max(1.0)) }
}

/// Round numbers in a range, multiples of 1, 2 or 5 times a power of ten, in at most so many steps.
fn ticks((low, high): (f64, f64), most: f64) -> Vec<f64> {
    let most = most.max(1.0);
    let least = (high / most - low / most).max(1e-300);
    let power = libm::pow(10.0, libm::log10(least).floor());
    let rounded = [1.0, 2.0, 5.0].map(|factor| factor * power).into_iter().find(|step| *step >= least);
    let step = rounded.unwrap_or(10.0 * power).min(1e308);
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    let count = (last - first).clamp(-1.0, most + 1.0) as i64 + 1;
    // A multiple can lie outside by a rounding error, and two can be the same number.
    let tick = |i: i64| ((first + i as f64) * step).max(low).min(high);
    let mut ticks: Vec<f64> = (0..count).map(tick).filter(|tick| tick.is_finite()).collect();
    ticks.dedup();
    ticks
}

/// The numbers of an axis as texts with just enough digits to differ: `50k` and `1.5M` if the largest has five digits or more.
fn numbers(ticks: &[f64]) -> Vec<String> {
    let largest = ticks.iter().fold(0.0_f64, |largest, tick| largest.max(tick.abs()));
    let with = |digits| ticks.iter().map(|&tick| number(tick, largest, digits)).collect::<Vec<_>>();
    let differ = |numbers: &Vec<String>| numbers.windows(2).all(|pair| pair[0] != pair[1]);
    (1..17).map(with).find(differ).unwrap_or_else(|| with(17))
}

/// A number with this many digits of its mantissa, or three more behind the decimal point.
fn number(value: f64, largest: f64, digits: usize) -> String {
    const UNITS: [(f64, &str); 4] = [(1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")];
    if value == 0.0 {
        return "0".into();
    }
    let trimmed = |text: &str| text.trim_end_matches('0').trim_end_matches('.').to_owned();
    if !(1e-2..1e15).contains(&largest) {
        let text = format!("{value:.digits$e}");
        let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{exponent}", trimmed(mantissa));
    }
    let unit = UNITS.into_iter().find(|(unit, _)| largest >= 1e4 && value.abs() >= *unit);
    let (unit, name) = unit.unwrap_or((1.0, ""));
    trimmed(&format!("{:.*}", digits + 3, value / unit)) + name
}

/// A text as the content of an element, or of an attribute in double quotes.
pub(super) fn escaped(text: &str) -> String {
    visible(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
#[path = "../../tests/unit/report_svg.rs"]
mod tests;
