//! How large things are on the screen.

use std::f64::consts::PI;

/// A perspective camera, as far as sizes on the screen depend on it.
///
/// Sizes are those at the middle of the image, as is usual for levels of detail: an object does not change its level when the
/// camera turns. Towards the corners of a wide image things are drawn larger.
///
/// Odd numbers give no panic: what is negative counts as zero and an angle beyond π as π; sizes come out as zero or infinity
/// then, and as NaN only where a NaN went in or zero meets infinity. What that means for levels is told at
/// [`LevelState::update`](super::LevelState::update).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Vertical field of view, radians, between 0 and π.
    pub fov_y: f64,
    /// Height of the image, pixels.
    pub height_px: f64,
    /// Distances, in world units, count as no less than this: that of the near plane.
    pub near: f64,
}

/// How large an object is on the screen: what levels are chosen by.
///
/// Mostly from [`View::screen_size`]; for another projection fill it in (orthographic: `pixels_per_unit` is the same
/// everywhere).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScreenSize {
    /// From the eye to the nearest point of the bounding sphere, in world units; the near distance where that is larger.
    pub distance: f64,
    /// How many pixels a world unit takes at `distance`.
    pub pixels_per_unit: f64,
    /// Share of the image's height that the bounding sphere takes, see [`View::coverage`].
    pub coverage: f64,
}

impl View {
    /// From the vertical field of view in radians and the height of the image in pixels; the near distance is 0.
    pub fn new(fov_y: f64, height_px: f64) -> Self {
        Self { fov_y, height_px, near: 0.0 }
    }

    /// How many pixels a length takes at a distance, both in world units: `length height / (2 distance tan(fov / 2))`.
    ///
    /// With the error of a level for the length, this is its projected error.
    pub fn pixels(&self, length: f64, distance: f64) -> f64 {
        if length == 0.0 { 0.0 } else { length * self.pixels_per_unit(distance) }
    }

    /// Share of the image's height that a bounding sphere takes: `radius / (distance tan(fov / 2))`, with the distance to
    /// its centre; 1 fills the image from top to bottom, and near objects take more.
    ///
    /// It is what Unity means by the screen-relative height of a LOD group and Unreal by screen size, and what
    /// `MSFT_screencoverage` is taken for (glTF's `MSFT_lod` leaves the measure open). The true outline of a sphere so near
    /// that perspective shows is a little larger.
    pub fn coverage(&self, radius: f64, center_distance: f64) -> f64 {
        let radius = positive(radius);
        if radius == 0.0 { 0.0 } else { radius / (self.beyond_near(center_distance) * self.tan_half()) }
    }

    /// The size on the screen of what is in a bounding sphere (centre, and radius in world units), seen from `eye`.
    pub fn screen_size(&self, eye: [f64; 3], center: [f64; 3], radius: f64) -> ScreenSize {
        let to_center = (glam::DVec3::from(center) - glam::DVec3::from(eye)).length();
        let distance = self.beyond_near(to_center - positive(radius));
        ScreenSize {
            distance,
            pixels_per_unit: self.pixels_per_unit(distance),
            coverage: self.coverage(radius, to_center),
        }
    }

    fn pixels_per_unit(&self, distance: f64) -> f64 {
        positive(self.height_px) / (2.0 * self.beyond_near(distance) * self.tan_half())
    }

    fn tan_half(&self) -> f64 {
        let angle = positive(self.fov_y);
        (if angle > PI { PI } else { angle } / 2.0).tan()
    }

    fn beyond_near(&self, distance: f64) -> f64 {
        let near = self.near.max(0.0);
        if distance <= near { near } else { distance }
    }
}

impl ScreenSize {
    /// For an object drawn `scale` times as large as its levels are given: errors and distances of the levels are in units
    /// of the model then. Coverage stays, as the bounding sphere is that of the object as drawn. A mirror image (a negative
    /// scale) is as large as what it mirrors.
    pub fn scaled(self, scale: f64) -> Self {
        let scale = scale.abs();
        Self { distance: self.distance / scale, pixels_per_unit: self.pixels_per_unit * scale, ..self }
    }
}

/// What is negative counts as zero; NaN stays.
fn positive(x: f64) -> f64 {
    if x <= 0.0 { 0.0 } else { x }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use proptest::prelude::*;

    use super::super::testing::hostile;
    use super::*;

    #[test]
    fn sizes_have_their_closed_forms() {
        // at a right angle the image is twice as high as it is far away
        let view = View::new(FRAC_PI_2, 1000.0);
        assert!((view.pixels(1.0, 1.0) - 500.0).abs() < 1e-9);
        assert!((view.pixels(0.01, 2.0) - 2.5).abs() < 1e-9);
        assert!((view.coverage(1.0, 1.0) - 1.0).abs() < 1e-12);
        assert!((view.coverage(1.0, 4.0) - 0.25).abs() < 1e-12);
        // a third of the tangent of 60 degrees is that of 30
        let (narrow, wide) = (View::new(PI / 3.0, 1080.0), View::new(2.0 * PI / 3.0, 1080.0));
        assert!((narrow.pixels(1.0, 1.0) / wide.pixels(1.0, 1.0) - 3.0).abs() < 1e-9);

        let size = view.screen_size([0.0, 3.0, 4.0], [0.0; 3], 2.0);
        assert_eq!(size.distance, 3.0);
        assert!((size.pixels_per_unit - 500.0 / 3.0).abs() < 1e-9);
        assert!((size.coverage - 0.4).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_nearer_than_the_near_plane() {
        let view = View { near: 0.5, ..View::new(FRAC_PI_2, 1000.0) };
        let inside = view.screen_size([0.0; 3], [0.1, 0.0, 0.0], 2.0);
        assert_eq!(inside.distance, 0.5);
        assert_eq!(view.pixels(1.0, 0.1), view.pixels(1.0, 0.5));
        assert!((inside.coverage - 4.0).abs() < 1e-12);
    }

    #[test]
    fn scaled_objects_are_as_large_as_near_ones() {
        let view = View::new(1.0, 720.0);
        let scaled = view.screen_size([0.0; 3], [6.0, 0.0, 0.0], 2.0).scaled(-2.0);
        let near = view.screen_size([0.0; 3], [3.0, 0.0, 0.0], 1.0);
        assert_eq!(scaled.distance, near.distance);
        assert!((scaled.pixels_per_unit - near.pixels_per_unit).abs() < 1e-9);
        assert_eq!(scaled.coverage, near.coverage);
    }

    proptest! {
        #[test]
        fn odd_numbers_give_sizes_or_nan(
            [fov_y, height_px, near, x, radius, scale] in prop::array::uniform6(hostile()),
        ) {
            let view = View { fov_y, height_px, near };
            let size = view.screen_size([0.0; 3], [x, 0.0, 0.0], radius).scaled(scale);
            for value in [size.distance, size.pixels_per_unit, size.coverage] {
                prop_assert!(value.is_nan() || value >= 0.0, "{view:?} {size:?}");
            }
        }

        #[test]
        fn size_falls_with_distance_and_angle(near in 0.1_f64..10.0, far in 10.0_f64..1e6, fov in 0.1_f64..1.5) {
            let (view, wide) = (View::new(fov, 800.0), View::new(2.0 * fov, 800.0));
            prop_assert!(view.pixels(1.0, near) >= view.pixels(1.0, far));
            prop_assert!(view.coverage(1.0, near) >= view.coverage(1.0, far));
            prop_assert!(view.pixels(1.0, near) > wide.pixels(1.0, near));
        }
    }
}
