//! From what is seen to pixels.

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::camera::Camera;
use super::colour;
use super::light::{Lighting, Reaching};
use super::raster::{self, NOTHING, Visible};
use super::{Picture, Scene};

/// Samples along the side of a pixel.
const SAMPLES: usize = 3;
/// Albedo of clay, linear.
pub(super) const CLAY: Vec3 = Vec3::new(0.56, 0.535, 0.50);
/// Half the width of a drawn edge, in pixels.
const LINE: f32 = 0.55;
const LINE_COLOUR: Vec3 = Vec3::new(0.012, 0.022, 0.05);
const STUDIO_TOP: Vec3 = Vec3::new(0.76, 0.78, 0.81);
const STUDIO_BOTTOM: Vec3 = Vec3::new(0.88, 0.88, 0.87);

/// What is behind the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Backdrop {
    /// A light room.
    Studio,
    /// Nothing; the shadow on the ground stays.
    Transparent,
}

/// How to draw.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    /// One normal to each triangle.
    pub(crate) flat: bool,
    /// Edges of triangles, too.
    pub(crate) wireframe: bool,
    /// Clay instead of colours and textures.
    pub(crate) clay: bool,
    /// What is behind.
    pub(crate) backdrop: Backdrop,
}

/// Draws a scene.
pub(crate) fn draw(scene: &Scene, lighting: &Lighting, camera: &Camera, style: &Style) -> Picture {
    let (width, height) = camera.size();
    let scale = SAMPLES as f32;
    let to_samples = |p: &Vec3| camera.project(*p) * Vec3::new(scale, scale, 1.0);
    let points: Vec<Vec3> = scene.points.par_iter().map(to_samples).collect();
    let seen = raster::visible(&points, &scene.triangles, width as usize * SAMPLES, height as usize * SAMPLES);
    let painter = Painter { scene, lighting, camera, style, points: &points, seen: &seen };
    let row = |y: usize| (0..width as usize).map(move |x| (x, y));
    let rows: Vec<Vec<[u8; 4]>> =
        (0..height as usize).into_par_iter().map(|y| row(y).map(|(x, y)| painter.pixel(x, y)).collect()).collect();
    Picture { width, height, pixels: rows.concat() }
}

struct Painter<'a> {
    scene: &'a Scene,
    lighting: &'a Lighting,
    camera: &'a Camera,
    style: &'a Style,
    /// Projected points, in samples.
    points: &'a [Vec3],
    seen: &'a Visible,
}

/// A point of a surface, as a sample sees it.
struct Hit {
    position: Vec3,
    normal: Vec3,
    albedo: Vec3,
    /// How much of the colour is a drawn edge.
    line: f32,
    nearness: f32,
}

impl Painter<'_> {
    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let mut known: Vec<(Vec3, Vec3, Reaching)> = Vec::new();
        let (mut light, mut cover) = (Vec3::ZERO, 0.0);
        for row in y * SAMPLES..(y + 1) * SAMPLES {
            for column in x * SAMPLES..(x + 1) * SAMPLES {
                if let Some(hit) = self.hit(column, row) {
                    let reaching = self.reaching(&hit, &mut known);
                    light += self.shaded(&hit, reaching);
                    cover += 1.0;
                }
            }
        }
        let samples = (SAMPLES * SAMPLES) as f32;
        let (light, cover) = (light / samples, cover / samples);
        let behind = if cover < 1.0 { self.behind(x as f32 + 0.5, y as f32 + 0.5) } else { Vec4::ZERO };
        let alpha = cover + (1.0 - cover) * behind.w;
        let colour = light + (1.0 - cover) * behind.w * behind.truncate();
        let encoded = colour::encoded(if alpha > 0.0 { colour / alpha } else { Vec3::ZERO });
        let byte = |x: f32| (255.0 * x.clamp(0.0, 1.0)).round() as u8;
        [byte(encoded.x), byte(encoded.y), byte(encoded.z), byte(alpha)]
    }

    fn hit(&self, column: usize, row: usize) -> Option<Hit> {
        let triangle = self.seen.triangle[row * self.seen.width + column];
        if triangle == NOTHING {
            return None;
        }
        let ids = self.scene.triangles[triangle as usize];
        let corners = ids.map(|v| self.points[v as usize]);
        let flat = screen_weights(corners, Vec2::new(column as f32 + 0.5, row as f32 + 0.5));
        let weights = Vec3::from(std::array::from_fn(|i| flat[i] * corners[i].z));
        let weights = weights / weights.element_sum();
        let blend = |values: &[Vec3]| (0..3).map(|i| weights[i] * values[ids[i] as usize]).sum::<Vec3>();
        let position = blend(&self.scene.points);
        let [a, b, c] = ids.map(|v| self.scene.points[v as usize]);
        let facet = (b - a).cross(c - a).normalize_or(Vec3::Y);
        let smooth = if self.style.flat { facet } else { blend(&self.scene.normals).normalize_or(facet) };
        let to_eye = self.camera.position - position;
        let away = facet.dot(to_eye) < 0.0;
        let normal = if away { -smooth } else { smooth };
        let albedo = if self.style.clay { CLAY } else { self.scene.albedo(triangle as usize, weights) };
        let line = if self.style.wireframe { line_share(corners, flat) } else { 0.0 };
        let nearness = self.seen.nearness[row * self.seen.width + column];
        Some(Hit { position, normal, albedo, line, nearness })
    }

    /// Light at a hit; samples of a pixel that are nearly the same place share it, which is most of the work.
    fn reaching(&self, hit: &Hit, known: &mut Vec<(Vec3, Vec3, Reaching)>) -> Reaching {
        let near = 3.0 * self.camera.pixel_size(hit.nearness);
        let same = |(position, normal, _): &&(Vec3, Vec3, Reaching)| {
            normal.dot(hit.normal) > 0.985 && position.distance_squared(hit.position) < near * near
        };
        if let Some((_, _, reaching)) = known.iter().find(same) {
            return *reaching;
        }
        let reaching = self.lighting.reaching(hit.position, hit.normal);
        known.push((hit.position, hit.normal, reaching));
        reaching
    }

    fn shaded(&self, hit: &Hit, light: Reaching) -> Vec3 {
        let eye = (self.camera.position - hit.position).normalize_or(Vec3::Z);
        let facing = hit.normal.dot(eye).clamp(0.0, 1.0);
        let half = (eye + self.lighting.key_direction()).normalize_or(eye);
        let gloss = 0.16 * light.key * hit.normal.dot(half).max(0.0).powi(28);
        let rim = 0.16 * (1.0 - facing).powi(4) * (0.4 + 0.6 * hit.normal.y.max(0.0));
        let albedo = hit.albedo.lerp(LINE_COLOUR, hit.line);
        toned(albedo * light.diffuse + (1.0 - hit.line) * Vec3::splat(gloss + rim))
    }

    /// Colour and opacity of what lies behind the scene at a place in the picture.
    fn behind(&self, x: f32, y: f32) -> Vec4 {
        let shadow = self.ground_shadow(x, y);
        match self.style.backdrop {
            Backdrop::Transparent => Vec3::ZERO.extend(0.62 * shadow),
            Backdrop::Studio => {
                let (_, height) = self.camera.size();
                let room = STUDIO_TOP.lerp(STUDIO_BOTTOM, y / height as f32);
                (room * (1.0 - 0.72 * shadow)).extend(1.0)
            }
        }
    }

    fn ground_shadow(&self, x: f32, y: f32) -> f32 {
        let ray = self.camera.ray(x, y);
        let reach = (self.scene.ground - self.camera.position.y) / ray.y;
        if ray.y >= 0.0 || reach <= 0.0 {
            return 0.0;
        }
        let point = self.camera.position + reach * ray;
        let fade = 1.0 - smooth_step(0.9, 2.4, Vec2::new(point.x, point.z).length());
        if fade > 0.0 { fade * self.lighting.shadow(point) } else { 0.0 }
    }
}

/// Barycentric weights on the screen; they add up to 1.
pub(super) fn screen_weights(corners: [Vec3; 3], at: Vec2) -> Vec3 {
    let [a, b, c] = corners.map(|p| p.truncate());
    let area = (b - a).perp_dot(c - a);
    let weights = Vec3::new((c - b).perp_dot(at - b), (a - c).perp_dot(at - c), (b - a).perp_dot(at - a));
    if area == 0.0 { Vec3::splat(1.0 / 3.0) } else { weights / area }
}

/// How much of a sample belongs to the drawn edges of its triangle. Edges fade where triangles are hardly larger than
/// the lines.
fn line_share(corners: [Vec3; 3], weights: Vec3) -> f32 {
    let [a, b, c] = corners.map(|p| p.truncate() / SAMPLES as f32);
    let area = (b - a).perp_dot(c - a).abs();
    let heights = Vec3::new(area / (c - b).length(), area / (a - c).length(), area / (b - a).length());
    let distance = (weights * heights).min_element();
    let density = ((heights.max_element() - 1.0) / 7.0).clamp(0.10, 1.0);
    (1.0 - smooth_step(LINE - 0.3, LINE + 0.3, distance)) * 0.82 * density
}

/// Leaves darks and middle tones alone and rolls off towards white.
fn toned(light: Vec3) -> Vec3 {
    let roll = |x: f32| if x < 0.6 { x } else { 1.0 - 0.4 / (1.0 + (x - 0.6) / 0.4) };
    Vec3::new(roll(light.x), roll(light.y), roll(light.z))
}

fn smooth_step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
