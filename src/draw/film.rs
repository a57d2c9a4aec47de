//! A GIF of pictures that are pixels already.

use std::io::{self, Write};

use gif::{Encoder, Frame, Repeat};

use super::gif::{delay, io_error};
use crate::env::Image;

/// The bytes of a film after its size: a global palette of two black entries, because each picture has a palette of its own.
const START: [u8; 9] = [0x80, 0, 0, 0, 0, 0, 0, 0, 0];
/// How carefully the colors of a picture with more than 256 of them are chosen, from 1 (slow) to 30.
const SPEED: i32 = 10;

pub(crate) struct Film<W: Write> {
    encoder: Encoder<W>,
    size: (u16, u16),
    delay: u16,
}

impl<W: Write> Film<W> {
    /// A film of pictures with the size of this one.
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
    start.starts_with(b"GIF89a") && start.get(10..19) == Some(&START)
}
