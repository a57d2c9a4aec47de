//! SVG, animated by SMIL: every browser plays it, as an image too, and it stays sharp.

use std::fmt::Write;

use super::{
    AXLE, AXLE_OFFSET, AXLE_RADIUS, BLACK, CART_HEIGHT, CART_WIDTH, CART_Y, HEIGHT, LAST_FRAMES, POLE,
    POLE_BOTTOM, POLE_TOP, POLE_WIDTH, WHITE, WIDTH, cart_x,
};
use crate::env::CartPole;

/// The start of every picture; [`is_svg`] knows it by that.
fn start() -> String {
    format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">
<title>CartPole-v1, "#
    )
}

/// Whether a file that begins like this can be one of [`svg`].
pub fn is_svg(start: &[u8]) -> bool {
    start.starts_with(self::start().as_bytes())
}

/// The episode of these states, at least one, as an SVG file.
pub fn svg(states: &[[f64; 4]]) -> String {
    let held = states.last().into_iter().cycle().take(usize::from(LAST_FRAMES));
    let (mut positions, mut angles) = (String::new(), String::new());
    for state in states.iter().chain(held) {
        // Writing to a string cannot fail.
        let _ = write!(positions, "{:.2};", cart_x(state));
        let _ = write!(angles, "{:.2};", state[2].to_degrees());
    }
    let frames = states.len() + usize::from(LAST_FRAMES);
    let seconds = (frames - 1) as f64 / f64::from(CartPole::STEPS_PER_SECOND);
    let animation = |kind: &str, values: &str| {
        let values = values.trim_end_matches(';');
        format!(
            r#"<animateTransform attributeName="transform" type="{kind}" dur="{seconds:.2}s" repeatCount="indefinite" values="{values}"/>"#
        )
    };
    let colour = |[red, green, blue]: [u8; 3]| format!("#{red:02x}{green:02x}{blue:02x}");
    let track = f64::from(HEIGHT) - CART_Y;
    format!(
        r##"{start}{steps} steps</title>
<rect width="100%" height="100%" fill="{white}"/>
<g transform="translate({x:.2})">{moving}
<rect x="{cart_left}" y="{cart_top}" width="{CART_WIDTH}" height="{CART_HEIGHT}" fill="{black}"/>
<g transform="translate(0 {axle_y})">
<rect x="{pole_left}" y="{pole_top}" width="{POLE_WIDTH}" height="{pole_height}" fill="{pole}" transform="rotate({angle:.2})">{turning}</rect>
<circle r="{AXLE_RADIUS}" fill="{axle}"/>
</g>
</g>
<path d="M0,{line}H{WIDTH}" stroke="{black}"/>
</svg>
"##,
        start = start(),
        steps = states.len() - 1,
        x = cart_x(&states[0]),
        angle = states[0][2].to_degrees(),
        moving = animation("translate", &positions),
        turning = animation("rotate", &angles),
        cart_left = -CART_WIDTH / 2.0,
        cart_top = track - CART_HEIGHT / 2.0,
        axle_y = track - AXLE_OFFSET,
        pole_left = -POLE_WIDTH / 2.0,
        pole_top = -POLE_TOP,
        pole_height = POLE_TOP - POLE_BOTTOM,
        line = track - 0.5,
        white = colour(WHITE),
        black = colour(BLACK),
        pole = colour(POLE),
        axle = colour(AXLE),
    )
}
