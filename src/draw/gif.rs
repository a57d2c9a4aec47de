//! GIF: each frame holds only the rectangle that has changed.

use std::io::{self, Write};

use gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};

use super::Placed;
use crate::env::Image;
use crate::env::scene::{Bounds, Scene};

const WIDTH: u16 = Scene::WIDTH;
const HEIGHT: u16 = Scene::HEIGHT;
const WHITE: [u8; 3] = [255; 3];
/// Most colors of a picture, with white: the palette holds the mixtures of every two.
const MAX_COLORS: usize = 6;
const SAMPLES: u16 = 4;
/// All samples of a pixel; a pixel is a mixture of two colors in as many parts.
const PARTS: u16 = SAMPLES * SAMPLES;

/// The bytes of a film after its size: a global palette of two black entries, because each picture has a palette of its own.
const FILM_START: [u8; 9] = [0x80, 0, 0, 0, 0, 0, 0, 0, 0];
/// How carefully the colors of a picture with more than 256 of them are chosen, from 1 (slow) to 30.
const SPEED: i32 = 10;

/// A rectangle of pixels; `right` and `bottom` are outside of it.
#[derive(Clone, Copy)]
struct Area {
    left: u16,
    top: u16,
    right: u16,
    bottom: u16,
}

/// Writes the episode of these scenes. The last scene stays for a second.
pub(crate) fn write_gif(out: impl Write, scenes: &[Scene], frames_per_second: f64) -> io::Result<()> {
    let palette = Palette::of(scenes);
    let delay = delay(frames_per_second);
    let mut encoder = Encoder::new(out, WIDTH, HEIGHT, &palette.entries()).map_err(io_error)?;
    encoder.set_repeat(Repeat::Infinite).map_err(io_error)?;
    let mut shown = vec![palette.unchanged(); usize::from(WIDTH) * usize::from(HEIGHT)];
    let mut before = None;
    for (index, scene) in scenes.iter().enumerate() {
        let changed = draw(scene, &palette, changed_area(before, scene), &mut shown);
        let delay = if index + 1 == scenes.len() { 100 } else { delay };
        encoder.write_frame(&Frame { delay, ..changed }).map_err(io_error)?;
        before = Some(scene);
    }
    Ok(())
}

/// How long a frame lasts, in hundredths of a second, a whole number. Browsers slow frames of one hundredth down.
fn delay(frames_per_second: f64) -> u16 {
    (100.0 / frames_per_second).round().clamp(2.0, 100.0) as u16
}

/// Whether a file with this beginning may be one of [`write_gif`]: the size of the pictures is known.
pub(crate) fn is_gif(start: &[u8]) -> bool {
    let size = [WIDTH.to_le_bytes(), HEIGHT.to_le_bytes()].concat();
    start.strip_prefix(b"GIF89a").is_some_and(|rest| rest.starts_with(&size))
}

fn io_error(error: EncodingError) -> io::Error {
    match error {
        EncodingError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// All that a pixel can be: a color, a mixture of two in sixteenths, or unchanged.
struct Palette {
    colors: Vec<[u8; 3]>,
}

impl Palette {
    fn of(scenes: &[Scene]) -> Self {
        let mut colors = vec![WHITE];
        for shape in scenes.iter().flat_map(|scene| &scene.shapes) {
            if colors.len() < MAX_COLORS && !colors.contains(&shape.color.rgb()) {
                colors.push(shape.color.rgb());
            }
        }
        Self { colors }
    }

    /// The index of a color; white for one that the palette has no room for.
    fn index(&self, color: [u8; 3]) -> usize {
        self.colors.iter().position(|&known| known == color).unwrap_or(0)
    }

    /// The index of an unchanged pixel, after the colors and the mixtures of every pair.
    fn unchanged(&self) -> u8 {
        let count = self.colors.len();
        (count + count * (count - 1) / 2 * usize::from(PARTS - 1)) as u8
    }

    fn entries(&self) -> Vec<u8> {
        let mut entries: Vec<u8> = self.colors.concat();
        // The pairs (second, first), the first being the smaller: (1, 0), (2, 0), (2, 1), ….
        let pairs = (1..self.colors.len()).flat_map(|second| (0..second).map(move |first| (second, first)));
        for (second, first) in pairs {
            let channels = |i: usize| [first, second].map(|color| u16::from(self.colors[color][i]));
            for part in 1..PARTS {
                let mixed = |[a, b]: [u16; 2]| (a * (PARTS - part) + b * part + PARTS / 2) / PARTS;
                entries.extend([0, 1, 2].map(|i| mixed(channels(i)) as u8));
            }
        }
        entries.extend(WHITE);
        entries
    }

    /// The index for how many samples have each color: the mixture of the two that most have.
    fn mixture(&self, counts: [u16; MAX_COLORS]) -> u8 {
        let mut order: [usize; MAX_COLORS] = std::array::from_fn(|i| i);
        order.sort_by_key(|&color| std::cmp::Reverse(counts[color]));
        let (first, second) = (order[0].min(order[1]), order[0].max(order[1]));
        let both = counts[first] + counts[second];
        match (counts[second] * PARTS + both / 2) / both {
            0 => first as u8,
            PARTS => second as u8,
            part => {
                let pair = second * (second - 1) / 2 + first;
                (self.colors.len() + pair * usize::from(PARTS - 1)) as u8 + part as u8 - 1
            }
        }
    }
}

impl Area {
    const ALL: Self = Self { left: 0, top: 0, right: WIDTH, bottom: HEIGHT };
    const NONE: Self = Self { left: WIDTH, top: HEIGHT, right: 0, bottom: 0 };

    /// The pixels of an area of the picture, as far as they are in the picture.
    fn of(Bounds { left, right, bottom, top }: Bounds) -> Self {
        let (width, height) = (f64::from(WIDTH), f64::from(HEIGHT));
        let [left, right] = [left.floor(), right.ceil()].map(|x| x.clamp(0.0, width) as u16);
        let [top, bottom] =
            [(height - top).floor(), (height - bottom).ceil()].map(|y| y.clamp(0.0, height) as u16);
        Self { left, top, right, bottom }
    }

    fn union(self, other: Self) -> Self {
        let (left, top) = (self.left.min(other.left), self.top.min(other.top));
        let (right, bottom) = (self.right.max(other.right), self.bottom.max(other.bottom));
        Self { left, top, right, bottom }
    }
}

/// Where a scene can differ from the one before it: at the shapes that have moved.
fn changed_area(before: Option<&Scene>, scene: &Scene) -> Area {
    let Some(before) = before else { return Area::ALL };
    let pairs = before.shapes.iter().zip(&scene.shapes);
    let moved = pairs.filter(|(old, new)| old != new).flat_map(|(old, new)| [old, new]);
    moved.map(|shape| Area::of(Placed::new(shape).bounds)).fold(Area::NONE, Area::union)
}

/// Draws an area of a scene over what is shown, and returns a frame with what has changed.
fn draw(scene: &Scene, palette: &Palette, area: Area, shown: &mut [u8]) -> Frame<'static> {
    let shapes: Vec<_> =
        scene.shapes.iter().map(|shape| (Placed::new(shape), palette.index(shape.color.rgb()))).collect();
    let unchanged = palette.unchanged();
    let mut changed = Area::NONE;
    let mut pixels = vec![unchanged; shown.len()];
    for y in area.top..area.bottom {
        for x in area.left..area.right {
            let place = usize::from(y) * usize::from(WIDTH) + usize::from(x);
            let pixel = palette.mixture(counts(x, y, &shapes));
            if pixel != shown[place] {
                (shown[place], pixels[place]) = (pixel, pixel);
                changed = changed.union(Area { left: x, top: y, right: x + 1, bottom: y + 1 });
            }
        }
    }
    if changed.right == 0 {
        // A frame has at least one pixel.
        changed = Area { left: 0, top: 0, right: 1, bottom: 1 };
    }
    let Area { left, top, right, bottom } = changed;
    let rows = pixels.chunks_exact(usize::from(WIDTH)).take(usize::from(bottom)).skip(usize::from(top));
    let buffer: Vec<u8> = rows.flat_map(|row| &row[usize::from(left)..usize::from(right)]).copied().collect();
    let (width, height, buffer, transparent) = (right - left, bottom - top, buffer.into(), Some(unchanged));
    let dispose = DisposalMethod::Keep;
    Frame { left, top, width, height, buffer, transparent, dispose, ..Frame::default() }
}

/// The number of samples of each color in the pixel with the upper left corner (x, y).
fn counts(x: u16, y: u16, shapes: &[(Placed<'_>, usize)]) -> [u16; MAX_COLORS] {
    let mut counts = [0; MAX_COLORS];
    let offset = |sample: u16| (f64::from(sample) + 0.5) / f64::from(SAMPLES);
    for (row, column) in (0..SAMPLES).flat_map(|row| (0..SAMPLES).map(move |column| (row, column))) {
        let point = (f64::from(x) + offset(column), f64::from(HEIGHT - y) - offset(row));
        let seen = shapes.iter().rev().find(|(shape, _)| shape.contains(point));
        counts[seen.map_or(0, |&(_, color)| color)] += 1;
    }
    counts
}

/// A GIF of pictures that are pixels already.
pub(crate) struct Film<W: Write> {
    encoder: Encoder<W>,
    size: (u16, u16),
    delay: u16,
}

impl<W: Write> Film<W> {
    pub fn new(out: W, first: &Image, frames_per_second: f64) -> io::Result<Self> {
        let mut encoder = Encoder::new(out, first.width, first.height, &[]).map_err(io_error)?;
        encoder.set_repeat(Repeat::Infinite).map_err(io_error)?;
        Ok(Self { encoder, size: (first.width, first.height), delay: delay(frames_per_second) })
    }

    /// Adds a picture. The last one stays for a second.
    pub(crate) fn add(&mut self, image: &Image, is_last: bool) -> io::Result<()> {
        let (width, height) = self.size;
        if (image.width, image.height) != self.size {
            let Image { width: w, height: h, .. } = image;
            return Err(io::Error::other(format!(
                "the first picture has {width} × {height} pixels and a later one {w} × {h}"
            )));
        }
        let mut frame = Frame::from_rgb_speed(width, height, &image.rgb, SPEED);
        frame.delay = if is_last { 100 } else { self.delay };
        self.encoder.write_frame(&frame).map_err(io_error)
    }
}

pub(crate) fn is_film(start: &[u8]) -> bool {
    start.starts_with(b"GIF89a") && start.get(10..19) == Some(&FILM_START)
}

#[cfg(test)]
#[path = "../../tests/unit/draw_gif.rs"]
mod tests;
