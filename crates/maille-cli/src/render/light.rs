//! Light: a dome of sky and a key light, all made of directional lamps with depth maps.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::Scene;
use super::camera::Camera;
use super::raster;

/// Lamps of the sky. Steps of shadows melt together from about 50 on.
const SKY_LAMPS: usize = 64;
/// Lamps of the key light, spread over a disc so that its shadow has a soft edge.
const KEY_LAMPS: usize = 14;
const KEY_SPREAD: f32 = 0.10;
const SKY_SIDE: usize = 224;
const KEY_SIDE: usize = 512;
/// Meshes above this size get fewer lamps: each lamp draws every triangle once.
const MANY_TRIANGLES: usize = 600_000;

const KEY_RADIANCE: Vec3 = Vec3::new(1.30, 1.24, 1.14);
const ZENITH: Vec3 = Vec3::new(0.52, 0.57, 0.66);
const HORIZON: Vec3 = Vec3::new(0.40, 0.39, 0.37);
/// Light from everywhere that nothing blocks: what bounces around.
const BOUNCE: Vec3 = Vec3::new(0.06, 0.056, 0.055);

struct Lamp {
    /// Towards the lamp.
    direction: Vec3,
    /// Irradiance of a surface that faces it.
    power: Vec3,
    /// Columns: two axes across the light, and its direction.
    axes: Mat3,
    side: usize,
    nearness: Vec<f32>,
}

/// The lamps around a scene; the scene casts the shadows.
pub(crate) struct Lighting {
    sky: Vec<Lamp>,
    key: Vec<Lamp>,
    key_direction: Vec3,
}

/// Light that reaches a point.
#[derive(Clone, Copy)]
pub(crate) struct Reaching {
    /// Irradiance, over pi: multiply with the albedo.
    pub(crate) diffuse: Vec3,
    /// Share of the key light that is not blocked.
    pub(crate) key: f32,
}

impl Lighting {
    /// Sets up lamps that stand fixed to the camera's heading, key light from the upper left.
    pub(crate) fn new(scene: &Scene, camera: &Camera) -> Self {
        let axes = camera.axes();
        let forward = Vec3::new(axes.z_axis.x, 0.0, axes.z_axis.z).normalize_or(Vec3::Z);
        let right = axes.x_axis;
        let key_direction = (-0.62 * right + 0.80 * Vec3::Y + 0.62 * forward).normalize();
        let share = if scene.triangles.len() > MANY_TRIANGLES { 3 } else { 1 };
        let sky = sky_directions(SKY_LAMPS / share).into_iter().map(|(direction, power)| (direction, power, SKY_SIDE));
        let key_power = KEY_RADIANCE / (KEY_LAMPS / share) as f32;
        let key = disc_around(key_direction, KEY_LAMPS / share).into_iter();
        let key = key.map(|direction| (direction, key_power, KEY_SIDE));
        let mut lamps: Vec<Lamp> =
            sky.chain(key).collect::<Vec<_>>().into_par_iter().map(|(d, p, s)| Lamp::new(scene, d, p, s)).collect();
        let key = lamps.split_off(SKY_LAMPS / share);
        Self { sky: lamps, key, key_direction }
    }

    /// Towards the middle of the key light.
    pub(crate) fn key_direction(&self) -> Vec3 {
        self.key_direction
    }

    /// Light at a point with a unit normal.
    pub(crate) fn reaching(&self, point: Vec3, normal: Vec3) -> Reaching {
        let mut diffuse = BOUNCE;
        for lamp in &self.sky {
            diffuse += lamp.irradiance(point, normal);
        }
        let mut key = 0.0;
        for lamp in &self.key {
            let facing = normal.dot(lamp.direction);
            if facing > 0.0 {
                let lit = lamp.visibility(point, normal);
                diffuse += facing * lit * lamp.power;
                key += lit;
            }
        }
        Reaching { diffuse, key: key / self.key.len() as f32 }
    }

    /// Share of the light on open ground that the scene takes away at a point of it.
    pub(crate) fn shadow(&self, point: Vec3) -> f32 {
        let (mut open, mut lit) = (0.0, 0.0);
        for lamp in self.sky.iter().chain(&self.key) {
            let power = lamp.direction.y.max(0.0) * lamp.power.y;
            open += power;
            lit += power * lamp.visibility(point, Vec3::Y);
        }
        if open > 0.0 { 1.0 - lit / open } else { 0.0 }
    }
}

impl Lamp {
    fn new(scene: &Scene, direction: Vec3, power: Vec3, side: usize) -> Self {
        let (across, along) = direction.any_orthonormal_pair();
        let axes = Mat3::from_cols(across, along, direction);
        let turn = axes.transpose();
        let project = |p: &Vec3| {
            let q = turn * *p;
            Vec3::new(place(q.x, side), place(q.y, side), q.z)
        };
        let points: Vec<Vec3> = scene.points.iter().map(project).collect();
        let nearness = raster::depth_map(&points, &scene.triangles, side);
        Self { direction, power, axes, side, nearness }
    }

    fn irradiance(&self, point: Vec3, normal: Vec3) -> Vec3 {
        let facing = normal.dot(self.direction);
        if facing <= 0.0 { Vec3::ZERO } else { facing * self.visibility(point, normal) * self.power }
    }

    /// Share of the lamp that is seen from a point: four texels, compared and blended.
    fn visibility(&self, point: Vec3, normal: Vec3) -> f32 {
        let texel = 2.0 / self.side as f32;
        let p = self.axes.transpose() * (point + 1.6 * texel * normal);
        let (x, y) = (place(p.x, self.side) - 0.5, place(p.y, self.side) - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let lit = |dx: i64, dy: i64| {
            let (column, row) = (x0 as i64 + dx, y0 as i64 + dy);
            let side = self.side as i64;
            if !(0..side).contains(&column) || !(0..side).contains(&row) {
                return 1.0;
            }
            if p.z + 0.6 * texel >= self.nearness[(row * side + column) as usize] { 1.0 } else { 0.0 }
        };
        let near = lit(0, 0) + fx * (lit(1, 0) - lit(0, 0));
        let far = lit(0, 1) + fx * (lit(1, 1) - lit(0, 1));
        near + fy * (far - near)
    }
}

/// From -1..1 to a place on the map; scenes have radius 1.
fn place(x: f32, side: usize) -> f32 {
    (x + 1.0) / 2.0 * side as f32
}

/// Directions spread evenly over the upper half of the sphere (and a little below), with the sky's power in each.
fn sky_directions(count: usize) -> Vec<(Vec3, Vec3)> {
    let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    let lamp = |i: usize| {
        let height = 0.99 - 1.09 * (i as f32 + 0.5) / count as f32;
        let radius = (1.0 - height * height).sqrt();
        let turn = golden * i as f32;
        let direction = Vec3::new(radius * turn.cos(), height, radius * turn.sin());
        let radiance = HORIZON.lerp(ZENITH, height.max(0.0));
        (direction, radiance * 2.0 / count as f32)
    };
    (0..count).map(lamp).collect()
}

/// Directions spread evenly over a disc around one.
fn disc_around(center: Vec3, count: usize) -> Vec<Vec3> {
    let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    let (across, along) = center.any_orthonormal_pair();
    let direction = |i: usize| {
        let radius = KEY_SPREAD * ((i as f32 + 0.5) / count as f32).sqrt();
        let turn = golden * i as f32;
        (center + radius * (turn.cos() * across + turn.sin() * along)).normalize()
    };
    (0..count).map(direction).collect()
}
