//! GIF: frames of 20 ms, of which each holds the rectangle that has changed.

use std::io::{self, Write};

use gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};

use super::{
    AXLE, AXLE_OFFSET, AXLE_RADIUS, BLACK, CART_HEIGHT, CART_WIDTH, CART_Y, HEIGHT, LAST_FRAMES, POLE,
    POLE_BOTTOM, POLE_TOP, POLE_WIDTH, WHITE, WIDTH, cart_x,
};
use crate::env::CartPole;

/// The colours that a sample can have.
const COLOURS: [[u8; 3]; 4] = [WHITE, BLACK, POLE, AXLE];
/// Samples of a pixel along each side.
const SAMPLES: u16 = 4;
/// All samples of a pixel; a pixel is a mixture of two colours in as many parts.
const PARTS: u16 = SAMPLES * SAMPLES;
/// The palette's index of what has not changed, after the colours and the mixtures of each of their six pairs.
const UNCHANGED: u8 = 4 + 6 * (PARTS as u8 - 1);
/// Hundredths of a second in a frame.
const DELAY: u16 = 100 / CartPole::STEPS_PER_SECOND as u16;

/// A rectangle of pixels; `right` and `bottom` are outside of it.
#[derive(Clone, Copy)]
struct Area {
    left: u16,
    top: u16,
    right: u16,
    bottom: u16,
}

/// Writes the episode of these states.
///
/// # Errors
/// When it cannot be written.
pub fn write_gif(out: impl Write, states: &[[f64; 4]]) -> io::Result<()> {
    let mut encoder = Encoder::new(out, WIDTH, HEIGHT, &palette()).map_err(io_error)?;
    encoder.set_repeat(Repeat::Infinite).map_err(io_error)?;
    let mut shown = vec![UNCHANGED; usize::from(WIDTH) * usize::from(HEIGHT)];
    let mut to_draw = Area { left: 0, top: 0, right: WIDTH, bottom: HEIGHT };
    for (index, state) in states.iter().enumerate() {
        let covered = covered(state);
        let changed = draw(state, to_draw.union(covered), &mut shown);
        to_draw = covered;
        let last = index + 1 == states.len();
        let delay = if last { DELAY * LAST_FRAMES } else { DELAY };
        encoder.write_frame(&Frame { delay, ..changed }).map_err(io_error)?;
    }
    Ok(())
}

/// Whether a file that begins like this can be one of [`write_gif`]: its size is that of the pictures.
pub fn is_gif(start: &[u8]) -> bool {
    let size = [WIDTH.to_le_bytes(), HEIGHT.to_le_bytes()].concat();
    start.strip_prefix(b"GIF89a").is_some_and(|rest| rest.starts_with(&size))
}

fn io_error(error: EncodingError) -> io::Error {
    match error {
        EncodingError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// All that a pixel can be: a colour, a mixture of two in sixteenths, or unchanged.
fn palette() -> Vec<u8> {
    let mut palette: Vec<u8> = COLOURS.concat();
    for (second, first) in pairs() {
        let channels = |channel: usize| [first, second].map(|colour| u16::from(COLOURS[colour][channel]));
        for part in 1..PARTS {
            palette.extend(
                [0, 1, 2].map(channels).map(|[first, second]| {
                    ((first * (PARTS - part) + second * part + PARTS / 2) / PARTS) as u8
                }),
            );
        }
    }
    palette.extend(WHITE);
    palette
}

/// The pairs of colours (second, first), the first being the smaller: (1, 0), (2, 0), (2, 1), ….
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (1..COLOURS.len()).flat_map(|second| (0..second).map(move |first| (second, first)))
}

/// The palette's index for how many samples have each colour: the mixture of the two that most have.
fn mixture(counts: [u16; 4]) -> u8 {
    let mut order = [0, 1, 2, 3];
    order.sort_by_key(|&colour| std::cmp::Reverse(counts[colour]));
    let (first, second) = (order[0].min(order[1]), order[0].max(order[1]));
    let both = counts[first] + counts[second];
    match (counts[second] * PARTS + both / 2) / both {
        0 => first as u8,
        PARTS => second as u8,
        part => 4 + (second * (second - 1) / 2 + first) as u8 * (PARTS as u8 - 1) + part as u8 - 1,
    }
}

impl Area {
    fn union(self, other: Self) -> Self {
        Self {
            left: self.left.min(other.left),
            top: self.top.min(other.top),
            right: self.right.max(other.right),
            bottom: self.bottom.max(other.bottom),
        }
    }
}

/// Where the cart and the pole are, as far as that is in the picture.
fn covered(state: &[f64; 4]) -> Area {
    let (cart, axle) = (cart_x(state), CART_Y + AXLE_OFFSET);
    let (tip_x, tip_y) = (cart + POLE_TOP * libm::sin(state[2]), axle + POLE_TOP * libm::cos(state[2]));
    let within = |value: f64, end: u16| value.clamp(0.0, f64::from(end)) as u16;
    let row = |height: f64| within(f64::from(HEIGHT) - height, HEIGHT);
    Area {
        left: within(cart.min(tip_x) - CART_WIDTH / 2.0, WIDTH),
        top: row(axle.max(tip_y) + CART_HEIGHT),
        right: within(cart.max(tip_x) + CART_WIDTH / 2.0 + 1.0, WIDTH),
        bottom: row(axle.min(tip_y) - CART_HEIGHT),
    }
}

/// Draws an area of a state over what is shown, and returns a frame with what has changed.
fn draw(state: &[f64; 4], area: Area, shown: &mut [u8]) -> Frame<'static> {
    let (sin, cos) = (libm::sin(state[2]), libm::cos(state[2]));
    let mut changed: Option<Area> = None;
    let mut pixels = vec![UNCHANGED; shown.len()];
    for y in area.top..area.bottom {
        for x in area.left..area.right {
            let place = usize::from(y) * usize::from(WIDTH) + usize::from(x);
            let pixel = pixel(x, y, cart_x(state), (sin, cos));
            if pixel != shown[place] {
                (shown[place], pixels[place]) = (pixel, pixel);
                let this = Area { left: x, top: y, right: x + 1, bottom: y + 1 };
                changed = Some(changed.map_or(this, |area| area.union(this)));
            }
        }
    }
    let Area { left, top, right, bottom } = changed.unwrap_or(Area { left: 0, top: 0, right: 1, bottom: 1 });
    let rows = pixels.chunks_exact(usize::from(WIDTH)).take(usize::from(bottom)).skip(usize::from(top));
    let buffer: Vec<u8> = rows.flat_map(|row| &row[usize::from(left)..usize::from(right)]).copied().collect();
    Frame {
        left,
        top,
        width: right - left,
        height: bottom - top,
        buffer: buffer.into(),
        transparent: Some(UNCHANGED),
        dispose: DisposalMethod::Keep,
        ..Frame::default()
    }
}

/// The palette's index of a pixel; it covers a square whose upper left corner is (x, y).
fn pixel(x: u16, y: u16, cart_x: f64, angle: (f64, f64)) -> u8 {
    let mut counts = [0; 4];
    let offset = |sample: u16| (f64::from(sample) + 0.5) / f64::from(SAMPLES);
    for (row, column) in (0..SAMPLES).flat_map(|row| (0..SAMPLES).map(move |column| (row, column))) {
        let up = f64::from(HEIGHT - y) - offset(row);
        counts[sample(f64::from(x) + offset(column) - cart_x, up - CART_Y, angle)] += 1;
    }
    mixture(counts)
}

/// The index of the colour at a point, seen from the cart's middle.
fn sample(x: f64, y: f64, (sin, cos): (f64, f64)) -> usize {
    let above = y - AXLE_OFFSET;
    let (across, along) = (x * cos - above * sin, x * sin + above * cos);
    if (0.0..1.0).contains(&y) {
        1
    } else if x * x + above * above < AXLE_RADIUS * AXLE_RADIUS {
        3
    } else if across.abs() < POLE_WIDTH / 2.0 && (POLE_BOTTOM..POLE_TOP).contains(&along) {
        2
    } else {
        usize::from(x.abs() < CART_WIDTH / 2.0 && y.abs() < CART_HEIGHT / 2.0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Fast, far and beyond the picture's edge.
    const STATES: [[f64; 4]; 5] = [
        [0.0; 4],
        [0.01, 0.0, 0.02, 0.0],
        [-1.3, 0.0, -0.2, 0.0],
        [2.39, 0.0, 0.2, 0.0],
        [2.45, 0.0, 0.3, 0.0],
    ];

    #[test]
    fn every_frame_upon_those_before_it_shows_its_state() {
        let mut file = Vec::new();
        write_gif(&mut file, &STATES).unwrap();
        let mut decoder = gif::DecodeOptions::new().read_info(&file[..]).unwrap();
        let mut shown = vec![UNCHANGED; usize::from(WIDTH) * usize::from(HEIGHT)];
        for state in &STATES {
            let frame = decoder.read_next_frame().unwrap().unwrap();
            for (index, &pixel) in frame.buffer.iter().enumerate().filter(|(_, pixel)| **pixel != UNCHANGED) {
                let (row, column) = (index / usize::from(frame.width), index % usize::from(frame.width));
                shown[(usize::from(frame.top) + row) * usize::from(WIDTH)
                    + usize::from(frame.left)
                    + column] = pixel;
            }
            let mut alone = vec![UNCHANGED; shown.len()];
            draw(state, Area { left: 0, top: 0, right: WIDTH, bottom: HEIGHT }, &mut alone);
            assert!(shown == alone, "{state:?}");
        }
        assert!(decoder.read_next_frame().unwrap().is_none());
    }

    #[test]
    fn the_palette_holds_what_mixtures_name() {
        let palette = palette();
        assert_eq!(palette.len(), 3 * (usize::from(UNCHANGED) + 1));
        let colour = |counts| &palette[3 * usize::from(mixture(counts))..][..3];
        assert_eq!(colour([0, 0, 16, 0]), POLE);
        assert_eq!(colour([8, 8, 0, 0]), [128; 3]);
        assert_eq!(colour([0, 4, 12, 0]), [152, 114, 76]);
        assert_eq!(colour([0, 0, 4, 12]), [147, 137, 178]);
        assert_eq!(colour([12, 4, 0, 0]), [191; 3]);
    }
}
