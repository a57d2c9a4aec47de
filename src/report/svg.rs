//! Plots as SVG: axes, lines, steps, bands and intervals on a light background. The same data give the same bytes.

use std::fmt::Write;

const LEGEND_LINE: f64 = 18.0;

/// The size of a plot in pixels, and what surrounds its axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    width: f64,
    height: f64,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    /// Whether title, legend and names are in the plot; a page says them around it.
    labelled: bool,
}

impl Shape {
    /// A file of its own.
    pub(super) const FILE: Self = Self {
        width: 720.0,
        height: 400.0,
        left: 64.0,
        right: 24.0,
        top: 36.0,
        bottom: 52.0,
        labelled: true,
    };
    /// In a page on a screen.
    pub(super) const WIDE: Self =
        Self { width: 960.0, height: 340.0, left: 46.0, top: 10.0, labelled: false, ..Self::FILE };
    /// In a page on a phone.
    pub(super) const NARROW: Self = Self { width: 350.0, height: 260.0, right: 20.0, ..Self::WIDE };

    /// The same, half as high.
    pub(super) const fn low(self) -> Self {
        Self { height: self.height / 2.0, bottom: 28.0, ..self }
    }
}

/// Colours that people with any colour vision can tell apart (Okabe and Ito 2008), without yellow.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
const BACKGROUND: &str = "#fff";
const GRID: &str = "#e4e4e4";
const AXIS: &str = "#444";
const LEVEL: &str = "#888";

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

/// A plot that is being drawn.
#[derive(Debug)]
pub(super) struct Plot {
    shape: Shape,
    title: String,
    labels: [String; 2],
    x: (f64, f64),
    y: (f64, f64),
    y_ticks: bool,
    /// Whether y is a power of ten.
    is_logarithmic: bool,
    marks: String,
    /// Series and what it is.
    legend: Vec<(usize, String)>,
}

impl Plot {
    /// A plot over the given ranges; an empty range is widened.
    pub(super) fn new(
        shape: Shape,
        title: &str,
        [x_label, y_label]: [&str; 2],
        x: (f64, f64),
        y: (f64, f64),
    ) -> Self {
        let widened = |(low, high): (f64, f64)| (low, if high > low { high } else { low + 1.0 });
        Self {
            shape,
            title: escaped(title),
            labels: [escaped(x_label), escaped(y_label)],
            x: widened(x),
            y: widened(y),
            y_ticks: true,
            is_logarithmic: false,
            marks: String::new(),
            legend: Vec::new(),
        }
    }

    /// With powers of ten at the y axis, where y is an exponent.
    pub(super) fn logarithmic(mut self) -> Self {
        self.is_logarithmic = true;
        self
    }

    /// Without numbers at the y axis.
    pub(super) fn without_y_ticks(mut self) -> Self {
        self.y_ticks = false;
        self
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let share = |value: f64, (low, high): (f64, f64)| ((value - low) / (high - low)).clamp(0.0, 1.0);
        let Shape { width, height, left, right, top, bottom, .. } = self.shape;
        (
            left + share(x, self.x) * (width - left - right),
            height - bottom - share(y, self.y) * (height - top - bottom),
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
        self.line_of_width(series, points, "2");
    }

    /// A line that stays in the background.
    pub(super) fn faint_line(&mut self, series: usize, points: &[(f64, f64)]) {
        self.line_of_width(series, points, r#"1" stroke-opacity="0.6"#);
    }

    fn line_of_width(&mut self, series: usize, points: &[(f64, f64)], width: &str) {
        let path = self.path(points.iter().copied());
        let _ = writeln!(
            self.marks,
            r#"<path d="{path}" fill="none" stroke="{}" stroke-width="{width}"{}/>"#,
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
        if points.is_empty() {
            return;
        }
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
        if !self.shape.labelled {
            return self.legend(series, text);
        }
        let above = height - 10.0;
        let _ = writeln!(
            self.marks,
            r#"<text x="{:.1}" y="{above:.1}">{}</text>"#,
            self.shape.left + 8.0,
            escaped(text)
        );
    }

    /// A thin horizontal line with a text.
    pub(super) fn level(&mut self, y: f64, text: &str) {
        let (left, height) = self.place((self.x.0, y));
        let right = self.shape.width - self.shape.right;
        let _ = writeln!(
            self.marks,
            r##"<path d="M{left:.1},{height:.1}L{right:.1},{height:.1}" stroke="{LEVEL}" stroke-dasharray="2 4"/><text x="{right:.1}" y="{:.1}" text-anchor="end" fill="#666">{}</text>"##,
            height + 13.0,
            escaped(text)
        );
    }

    /// A line of the legend, below the plot.
    pub(super) fn legend(&mut self, series: usize, text: &str) {
        self.legend.push((series, escaped(text)));
    }

    fn drawn_legend(&self) -> String {
        let mut legend = String::new();
        let Shape { height, left, .. } = self.shape;
        for (line, (series, text)) in self.legend.iter().enumerate() {
            let y = height + LEGEND_LINE * line as f64;
            let _ = writeln!(
                legend,
                r#"<path d="M{left},{y}h24" stroke="{}" stroke-width="3"{}/><text x="{}" y="{}">{text}</text>"#,
                colour(*series),
                dashes(*series),
                left + 32.0,
                y + 4.0,
            );
        }
        legend
    }

    /// Title, what y is, and legend as HTML, for a plot that is not labelled.
    pub(super) fn caption(&self) -> String {
        let mut caption = format!("<b>{}</b>", self.title);
        if !self.labels[1].is_empty() {
            let _ = write!(caption, " ({})", self.labels[1]);
        }
        for (series, text) in &self.legend {
            let _ = write!(
                caption,
                r#" <span><svg viewBox="0 0 24 6"><path d="M0,3h24" stroke="{}" stroke-width="3"{}/></svg> {text}</span>"#,
                colour(*series),
                dashes(*series)
            );
        }
        caption
    }

    fn axes(&self) -> String {
        let mut axes = String::new();
        let (left, bottom) = self.place((self.x.0, self.y.0));
        let (right, top) = self.place((self.x.1, self.y.1));
        for tick in ticks(self.x, 5.0) {
            let (x, _) = self.place((tick, 0.0));
            let _ = writeln!(
                axes,
                r##"<path d="M{x:.1},{top:.1}V{bottom:.1}" stroke="{GRID}"/><text x="{x:.1}" y="{:.1}" text-anchor="middle">{}</text>"##,
                bottom + 18.0,
                number(tick)
            );
        }
        for tick in self.y_tick_values() {
            let (_, y) = self.place((0.0, tick));
            let text = if self.is_logarithmic { format!("1e{tick}") } else { number(tick) };
            let _ = writeln!(
                axes,
                r##"<path d="M{left:.1},{y:.1}H{right:.1}" stroke="{GRID}"/><text x="{:.1}" y="{:.1}" text-anchor="end">{text}</text>"##,
                left - 8.0,
                y + 4.0,
            );
        }
        let _ = writeln!(
            axes,
            r##"<path d="M{left:.1},{top:.1}V{bottom:.1}H{right:.1}" fill="none" stroke="{AXIS}"/>"##
        );
        axes
    }

    fn y_tick_values(&self) -> Vec<f64> {
        let count = if self.shape.height < Shape::NARROW.height { 2.0 } else { 5.0 };
        let mut values = if self.y_ticks { ticks(self.y, count) } else { Vec::new() };
        values.retain(|tick| !self.is_logarithmic || tick.fract() == 0.0);
        values
    }

    /// The whole SVG file.
    pub(super) fn finish(self) -> String {
        let Shape { width, height: plot_height, left, right, top, bottom, labelled } = self.shape;
        let middle = (left + width - right) / 2.0;
        let side = (top + plot_height - bottom) / 2.0;
        let [x_label, y_label] = &self.labels;
        let (height, around) = if labelled {
            let around = format!(
                r#"<text x="{middle}" y="22" text-anchor="middle" font-size="15">{}</text>
<text transform="translate(16 {side}) rotate(-90)" text-anchor="middle">{y_label}</text>
{}"#,
                self.title,
                self.drawn_legend()
            );
            (plot_height + LEGEND_LINE * self.legend.len() as f64, around)
        } else {
            (plot_height, String::new())
        };
        format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="sans-serif" font-size="12">
<title>{title}</title>
<rect width="100%" height="100%" fill="{BACKGROUND}"/>
{axes}<text x="{middle}" y="{}" text-anchor="middle">{x_label}</text>
{marks}{around}</svg>
"##,
            plot_height - 14.0,
            title = self.title,
            axes = self.axes(),
            marks = self.marks,
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

/// At least `count` round numbers in a range and about so many: multiples of 1, 2 or 5 times a power of ten.
fn ticks((low, high): (f64, f64), count: f64) -> Vec<f64> {
    let rough = (high - low) / count;
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

/// A text as the content of an element, or of an attribute in double quotes.
pub(super) fn escaped(text: &str) -> String {
    let text: String = text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
