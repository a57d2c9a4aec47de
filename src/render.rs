//! An episode as an animated picture in the look of Gymnasium's renderer: 600 × 400 pixels, 50 frames a second.
//!
//! Lengths are in pixels and heights count upwards, as in Gymnasium's `cartpole.py`, whose numbers these are; it cuts
//! the corners to whole pixels, here they are anti-aliased. The same states give the same bytes.

mod gif;
mod svg;

pub use gif::{is_gif, write_gif};
pub use svg::{is_svg, svg};

use crate::env::CartPole;

const WIDTH: u16 = 600;
const HEIGHT: u16 = 400;
/// Pixels in a metre.
const SCALE: f64 = WIDTH as f64 / (2.0 * CartPole::MAX_POSITION);
const CART_WIDTH: f64 = 50.0;
const CART_HEIGHT: f64 = 30.0;
/// Height of the cart's middle and of the track.
const CART_Y: f64 = 100.0;
/// Height of the axle above the cart's middle.
const AXLE_OFFSET: f64 = CART_HEIGHT / 4.0;
const AXLE_RADIUS: f64 = POLE_WIDTH / 2.0;
const POLE_WIDTH: f64 = 10.0;
/// The pole reaches from here below the axle …
const POLE_BOTTOM: f64 = -POLE_WIDTH / 2.0;
/// … to here above it.
const POLE_TOP: f64 = SCALE * CartPole::POLE_LENGTH - POLE_WIDTH / 2.0;

/// The colours, as red, green and blue.
const WHITE: [u8; 3] = [255, 255, 255];
const BLACK: [u8; 3] = [0, 0, 0];
const POLE: [u8; 3] = [202, 152, 101];
const AXLE: [u8; 3] = [129, 132, 203];

/// How long the last state stays before the animation starts again, in frames.
const LAST_FRAMES: u16 = CartPole::STEPS_PER_SECOND as u16;

/// Where the cart's middle is in a state.
fn cart_x(state: &[f64; 4]) -> f64 {
    state[0] * SCALE + f64::from(WIDTH) / 2.0
}
