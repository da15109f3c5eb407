//! Where a picture is taken from.

use glam::{Mat3, Vec3};

/// Vertical angle of view: a portrait lens, little distortion.
const FIELD_OF_VIEW: f32 = 26.0_f32.to_radians();
/// Share of the picture that the model may fill.
const FILL: f32 = 0.88;

/// A perspective camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Camera {
    /// Rows: right, up, and back (towards the viewer), in the world.
    axes: Mat3,
    pub(crate) position: Vec3,
    width: f32,
    height: f32,
    /// Pixels per unit at distance 1.
    focal: f32,
}

impl Camera {
    /// Looks from a direction (degrees around the vertical axis y, and above the horizon), close enough that the
    /// points fill the picture.
    pub(crate) fn framing(points: &[Vec3], size: (u32, u32), yaw: f32, pitch: f32) -> Self {
        let (yaw, pitch) = (yaw.to_radians(), pitch.to_radians());
        let back = Vec3::new(yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos());
        let right = Vec3::new(yaw.cos(), 0.0, -yaw.sin());
        let axes = Mat3::from_cols(right, back.cross(right), back);
        let (width, height) = (size.0 as f32, size.1 as f32);
        let half = (FIELD_OF_VIEW / 2.0).tan();
        let focal = height / 2.0 / half;
        let (across, up) = (half * FILL * width / height, half * FILL);
        // a point at (x, z) is inside the left and right planes when distance - z >= |x - shift| / tangent
        let fit = |axis: Vec3, tangent: f32| {
            let reach = |side: f32| {
                points.iter().map(|p| back.dot(*p) + side * axis.dot(*p) / tangent).fold(f32::NEG_INFINITY, f32::max)
            };
            let (plus, minus) = (reach(1.0), reach(-1.0));
            ((plus + minus) / 2.0, (plus - minus) / 2.0 * tangent)
        };
        let (distance_x, x) = fit(right, across);
        let (distance_y, y) = fit(axes.y_axis, up);
        let nearest = points.iter().map(|p| back.dot(*p)).fold(f32::NEG_INFINITY, f32::max);
        let farthest = points.iter().map(|p| back.dot(*p)).fold(f32::INFINITY, f32::min);
        let depth = (nearest - farthest).max(f32::MIN_POSITIVE);
        let distance = distance_x.max(distance_y).max(nearest + 1e-3 * depth);
        let position = if points.is_empty() { back } else { x * right + y * axes.y_axis + distance * back };
        Self { axes, position, width, height, focal }
    }

    /// Looks at the origin along a direction (unit, towards the viewer) from a distance; the focal length is in pixels, so
    /// that the picture is a window of its size onto one as large as the camera's.
    pub(crate) fn at(back: Vec3, distance: f32, focal: f32, size: (u32, u32)) -> Self {
        let right = Vec3::Y.cross(back).try_normalize().unwrap_or(Vec3::X);
        let axes = Mat3::from_cols(right, back.cross(right), back);
        Self { axes, position: distance * back, width: size.0 as f32, height: size.1 as f32, focal }
    }

    /// Size of the picture in pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.width as u32, self.height as u32)
    }

    /// Right, up and back.
    pub(crate) fn axes(&self) -> Mat3 {
        self.axes
    }

    /// Pixel coordinates (y down) and nearness (1 / depth) of a point in front of the camera.
    pub(crate) fn project(&self, point: Vec3) -> Vec3 {
        let p = self.axes.transpose() * (point - self.position);
        let nearness = 1.0 / (-p.z).max(f32::MIN_POSITIVE);
        let x = self.width / 2.0 + self.focal * p.x * nearness;
        let y = self.height / 2.0 - self.focal * p.y * nearness;
        Vec3::new(x, y, nearness)
    }

    /// Direction through a place in the picture; not unit: it reaches depth 1.
    pub(crate) fn ray(&self, x: f32, y: f32) -> Vec3 {
        self.axes * Vec3::new((x - self.width / 2.0) / self.focal, (self.height / 2.0 - y) / self.focal, -1.0)
    }

    /// Size of a pixel at a point, in the world.
    pub(crate) fn pixel_size(&self, nearness: f32) -> f32 {
        1.0 / (nearness * self.focal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn framed_points_fill_the_picture_and_stay_inside() {
        let points: Vec<Vec3> =
            maille::mesh::shapes::sphere(3).positions.iter().map(|&p| Vec3::from(p) * 7.0).collect();
        let camera = Camera::framing(&points, (400, 300), 40.0, -20.0);
        let seen: Vec<Vec3> = points.iter().map(|&p| camera.project(p)).collect();
        let range = |axis: usize| {
            let values = seen.iter().map(|p| p[axis]);
            (values.clone().fold(f32::MAX, f32::min), values.fold(f32::MIN, f32::max))
        };
        let (low, high) = range(1);
        assert!((low - 18.0).abs() < 1.0 && (high - 282.0).abs() < 1.0, "{low} {high}");
        let (low, high) = range(0);
        assert!(low > 0.0 && high < 400.0 && (low + high - 400.0).abs() < 2.0, "{low} {high}");
    }

    #[test]
    fn rays_lead_back_to_the_point() {
        let camera = Camera::framing(&[Vec3::ZERO, Vec3::ONE], (100, 100), 30.0, 10.0);
        let point = Vec3::new(0.2, 0.7, 0.5);
        let seen = camera.project(point);
        assert!((camera.position + camera.ray(seen.x, seen.y) / seen.z).abs_diff_eq(point, 1e-4));
    }
}
