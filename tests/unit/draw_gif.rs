#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::scene::Color;
use crate::env::{CartPole, Environment};

/// Fast, far and beyond the picture's edge.
const STATES: [[f64; 4]; 5] =
    [[0.0; 4], [0.01, 0.0, 0.02, 0.0], [-1.3, 0.0, -0.2, 0.0], [2.39, 0.0, 0.2, 0.0], [2.45, 0.0, 0.3, 0.0]];

#[test]
fn every_frame_upon_those_before_it_shows_its_state() {
    let scenes = STATES.map(|state| CartPole::at(state).scene().unwrap());
    let palette = Palette::of(&scenes);
    let unchanged = palette.unchanged();
    let mut file = Vec::new();
    write_gif(&mut file, &scenes, 50.0).unwrap();
    let mut decoder = gif::DecodeOptions::new().read_info(&file[..]).unwrap();
    let mut shown = vec![unchanged; usize::from(WIDTH) * usize::from(HEIGHT)];
    for scene in &scenes {
        let frame = decoder.read_next_frame().unwrap().unwrap();
        for (index, &pixel) in frame.buffer.iter().enumerate().filter(|(_, pixel)| **pixel != unchanged) {
            let (row, column) = (index / usize::from(frame.width), index % usize::from(frame.width));
            shown[(usize::from(frame.top) + row) * usize::from(WIDTH) + usize::from(frame.left) + column] =
                pixel;
        }
        let mut alone = vec![unchanged; shown.len()];
        draw(scene, &palette, Area::ALL, &mut alone);
        assert!(shown == alone, "{scene:?}");
    }
    assert!(decoder.read_next_frame().unwrap().is_none());
}

#[test]
fn the_palette_holds_what_mixtures_name() {
    let palette = Palette::of(&[CartPole::default().scene().unwrap()]);
    let entries = palette.entries();
    assert_eq!(entries.len(), 3 * (usize::from(palette.unchanged()) + 1));
    let color = |[white, ink, tan, lavender]: [u16; 4]| {
        let index = palette.mixture([white, ink, tan, lavender, 0, 0]);
        &entries[3 * usize::from(index)..][..3]
    };
    assert_eq!(color([0, 0, 16, 0]), Color::Tan.rgb());
    assert_eq!(color([8, 8, 0, 0]), [128; 3]);
    assert_eq!(color([0, 4, 12, 0]), [152, 114, 76]);
    assert_eq!(color([0, 0, 4, 12]), [147, 137, 178]);
    assert_eq!(color([12, 4, 0, 0]), [191; 3]);
}
