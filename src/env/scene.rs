//! What an environment looks like at one moment, as shapes. Whoever draws a scene knows nothing of the environment.

/// A picture of [`Scene::WIDTH`] × [`Scene::HEIGHT`] pixels. Lengths are in pixels; (0, 0) is the lower left corner, and
/// heights count upwards, as in Gymnasium's renderers.
///
/// All scenes of an episode have the same shapes in the same order. Only the places and angles of the shapes change.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The part of the picture that must be seen. A small display leaves out the rest.
    pub(crate) focus: Bounds,
    /// The shapes. A later shape covers an earlier one.
    pub shapes: Vec<Shape>,
}

impl Scene {
    pub(crate) const WIDTH: u16 = 600;
    pub(crate) const HEIGHT: u16 = 400;
}

#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// The form, around (0, 0).
    pub outline: Outline,
    /// Where the outline's (0, 0) is in the picture.
    pub(crate) at: (f64, f64),
    /// How far the outline is turned around its (0, 0), in rad, counterclockwise.
    pub(crate) angle: f64,
    pub color: Color,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Outline {
    /// A filled polygon with these corners.
    Polygon(Vec<(f64, f64)>),
    /// A filled circle around (0, 0) with this radius.
    Circle(f64),
    /// A line from point to point, one pixel wide.
    Line(Vec<(f64, f64)>),
}

impl Outline {
    pub(crate) fn rectangle(bounds: Bounds) -> Self {
        let Bounds { left, right, bottom, top } = bounds;
        Self::Polygon(vec![(left, bottom), (right, bottom), (right, top), (left, top)])
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) left: f64,
    pub(crate) right: f64,
    pub(crate) bottom: f64,
    pub(crate) top: f64,
}

/// The colors of Gymnasium's renderers. A scene has at most five of them on its white ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Color {
    /// Black, or white where the ground is dark.
    Ink,
    Tan,
    Lavender,
    Cyan,
    Yellow,
    Grey,
}

impl Color {
    /// Red, green and blue on a white ground.
    pub fn rgb(self) -> [u8; 3] {
        match self {
            Self::Ink => [0, 0, 0],
            Self::Tan => [202, 152, 101],
            Self::Lavender => [129, 132, 203],
            Self::Cyan => [0, 204, 204],
            Self::Yellow => [204, 204, 0],
            Self::Grey => [128; 3],
        }
    }
}
