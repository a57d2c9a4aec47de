#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::scene::Color;
use crate::env::{CartPole, Environment};

fn contains(outline: Outline, angle: f64, point: (f64, f64)) -> bool {
    let shape = Shape { outline, at: (100.0, 50.0), angle, color: Color::Ink };
    Placed::new(&shape).contains(point)
}

#[test]
fn a_shape_covers_what_lies_inside_of_it_in_its_place() {
    let bar = || Outline::rectangle(Bounds { left: -1.0, right: 1.0, bottom: 0.0, top: 10.0 });
    let quarter = std::f64::consts::FRAC_PI_2;
    assert!(contains(bar(), 0.0, (100.0, 59.0)) && !contains(bar(), 0.0, (91.0, 50.0)));
    // Counterclockwise, so that what stood lies to the left.
    assert!(contains(bar(), quarter, (91.0, 50.0)) && !contains(bar(), quarter, (100.0, 59.0)));
    // The notch of a polygon is outside.
    let notched = || Outline::Polygon(vec![(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 1.0), (0.0, 4.0)]);
    assert!(contains(notched(), 0.0, (100.5, 52.0)) && !contains(notched(), 0.0, (102.0, 52.0)));
    assert!(contains(Outline::Circle(2.0), 0.0, (101.3, 51.3)));
    assert!(!contains(Outline::Circle(2.0), 0.0, (101.5, 51.5)));
    let line = || Outline::Line(vec![(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]);
    assert!(contains(line(), 0.0, (105.0, 50.4)) && contains(line(), 0.0, (110.4, 55.0)));
    assert!(!contains(line(), 0.0, (105.0, 50.6)));
}

#[test]
fn a_motion_holds_every_place_of_its_shape() {
    let scenes = [0.0, 1.2].map(|x| CartPole::at([x, 0.0, 0.1, 0.0]).scene().unwrap());
    let motions = motions(&scenes);
    assert_eq!(motions.len(), 4);
    assert_eq!(motions[0].at, [(300.0, 107.5), (450.0, 107.5)]);
    assert_eq!(motions[1].angle, [-0.1; 2]);
    assert_eq!(motions[3].at[0], motions[3].at[1]);
}
