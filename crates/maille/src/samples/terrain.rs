//! A mountain lake: ridged noise, worn down by rain.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::noise::{fractal, gradient, lerp, mix, smoothstep};
use crate::mesh::{Attribute, Mesh, Semantic};

/// Length of a side, in metres.
const EXTENT: f32 = 2000.0;
/// Height of the highest peaks above the valleys before the rain, in metres.
const RELIEF: f32 = 400.0;
/// Height of the water.
const LAKE: f32 = 96.0;
/// Samples along a side of the map that the rain runs over.
const MAP: usize = 512;
const DROPS: u32 = 140_000;

/// A height field of about `triangles` triangles, 2 km on each side: open boundary, the lake flat.
///
/// Vertex colours (linear) by height and slope: water, sand, grass, rock, snow; normals. The landscape is the same for
/// any size, only its finest roughness appears with more triangles.
pub fn terrain(triangles: usize) -> Mesh {
    let steps = ((triangles as f64 / 2.0).sqrt().round() as usize).max(2);
    let ground = Ground::worn();
    let side = steps + 1;
    let place = |i: usize| Vec2::new((i % side) as f32, (i / side) as f32) * (EXTENT / steps as f32);
    let heights: Vec<f32> = (0..side * side).into_par_iter().map(|i| ground.height(place(i))).collect();
    let surface = |x: usize, z: usize| heights[z * side + x].max(LAKE);
    let normal = |i: usize| slope_normal(&surface, i % side, i / side, steps);
    let normals: Vec<[f32; 3]> = (0..side * side).into_par_iter().map(|i| normal(i).to_array()).collect();
    let color = |i: usize| color(place(i), heights[i], normals[i][1]).to_array();
    let colors: Vec<[f32; 3]> = (0..side * side).into_par_iter().map(color).collect();
    let point = |i: usize| {
        let p = place(i) - EXTENT / 2.0;
        [p.x, surface(i % side, i / side), p.y]
    };
    let positions: Vec<[f32; 3]> = (0..side * side).map(point).collect();
    let squares = (0..steps).flat_map(|z| (0..steps).map(move |x| z * side + x));
    let triangles = squares.flat_map(|first| split_square(&positions, first as u32, side as u32)).collect();
    let mut mesh = Mesh::from_triangles(positions, triangles).expect("the grid's indices are in range");
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, normals.into_flattened()));
    mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Color(0), 3, colors.into_flattened()));
    mesh
}

/// Two triangles along the flatter diagonal, so that ridges do not look sawn.
fn split_square(positions: &[[f32; 3]], a: u32, side: u32) -> [[u32; 3]; 2] {
    let [b, c, d] = [a + 1, a + side, a + side + 1];
    let drop = |p: u32, q: u32| (positions[p as usize][1] - positions[q as usize][1]).abs();
    if drop(a, d) < drop(b, c) { [[a, c, d], [a, d, b]] } else { [[a, c, b], [b, c, d]] }
}

/// Normal of the height field by central differences, one-sided at the boundary.
fn slope_normal(height: &impl Fn(usize, usize) -> f32, x: usize, z: usize, steps: usize) -> Vec3 {
    let spacing = EXTENT / steps as f32;
    let [(x0, x1), (z0, z1)] = [x, z].map(|i| (i.saturating_sub(1), (i + 1).min(steps)));
    let dx = (height(x1, z) - height(x0, z)) / (spacing * (x1 - x0) as f32);
    let dz = (height(x, z1) - height(x, z0)) / (spacing * (z1 - z0) as f32);
    Vec3::new(-dx, 1.0, -dz).normalize()
}

fn color(p: Vec2, height: f32, up: f32) -> Vec3 {
    let q = Vec3::new(p.x, 0.0, p.y);
    let mottle = fractal(q / 90.0, 4, 31);
    if height <= LAKE {
        let depth = smoothstep(0.0, 22.0, LAKE - height);
        return Vec3::new(0.065, 0.22, 0.25).lerp(Vec3::new(0.008, 0.042, 0.085), depth);
    }
    let steepness = 1.0 - up;
    let grass = Vec3::new(0.085, 0.135, 0.022).lerp(Vec3::new(0.035, 0.075, 0.014), 0.5 + 0.9 * mottle);
    // woods on the lower slopes
    let woods = smoothstep(0.02, 0.10, fractal(q / 160.0, 5, 33)) * smoothstep(220.0, 180.0, height + 50.0 * mottle);
    let grass = grass.lerp(Vec3::new(0.014, 0.036, 0.010), 0.85 * woods);
    let alpine = Vec3::new(0.16, 0.14, 0.055);
    let rock = Vec3::new(0.17, 0.155, 0.14) * (1.0 + 0.5 * fractal(q / 25.0 + Vec3::Y * height / 12.0, 3, 32));
    let snow = Vec3::new(0.86, 0.89, 0.94);
    let sand = Vec3::new(0.42, 0.34, 0.20);
    let meadow = grass.lerp(alpine, smoothstep(190.0, 280.0, height + 60.0 * mottle));
    let bare = meadow.lerp(rock, smoothstep(0.14, 0.26, steepness + 0.06 * mottle));
    let shore = bare.lerp(sand, smoothstep(LAKE + 7.0, LAKE + 2.5, height + 4.0 * mottle));
    let snow_line = smoothstep(262.0, 318.0, height + 80.0 * mottle) * smoothstep(0.46, 0.30, steepness);
    shore.lerp(snow, snow_line)
}

/// A square map of heights, in metres.
struct Ground {
    heights: Vec<f32>,
}

impl Ground {
    /// Mountains after the rain.
    fn worn() -> Self {
        let cell = EXTENT / (MAP - 1) as f32;
        let place = |i: usize| Vec2::new((i % MAP) as f32, (i / MAP) as f32) * cell;
        let heights = (0..MAP * MAP).into_par_iter().map(|i| uplift(place(i))).collect();
        let mut ground = Self { heights };
        for drop in 0..DROPS {
            ground.rain(drop);
        }
        ground
    }

    /// The height in metres at a place from (0, 0) to (EXTENT, EXTENT), with roughness finer than the map.
    fn height(&self, p: Vec2) -> f32 {
        let smooth = self.bicubic(p * ((MAP - 1) as f32 / EXTENT));
        // steep ground is rough, meadows are not, and the bottom of the lake does not show
        let (here, slope) = self.bilinear(p * ((MAP - 1) as f32 / EXTENT));
        let steep = smoothstep(0.8, 3.6, slope.length());
        let above = smoothstep(LAKE - 5.0, LAKE + 20.0, here);
        smooth + above * (0.5 + 9.0 * steep) * fractal(Vec3::new(p.x, smooth, p.y) / 24.0, 5, 21)
    }

    fn at(&self, x: isize, z: isize) -> f32 {
        let last = MAP as isize - 1;
        self.heights[(z.clamp(0, last) * MAP as isize + x.clamp(0, last)) as usize]
    }

    /// Catmull-Rom interpolation; `p` in cells of the map.
    fn bicubic(&self, p: Vec2) -> f32 {
        let base = p.floor();
        let f = p - base;
        let (x, z) = (base.x as isize, base.y as isize);
        let cubic = |[a, b, c, d]: [f32; 4], t: f32| {
            b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
        };
        let row = |k: isize| cubic([-1, 0, 1, 2].map(|i| self.at(x + i, z + k)), f.x);
        cubic([-1, 0, 1, 2].map(row), f.y)
    }

    /// Height and slope (metres per cell) by bilinear interpolation; `p` in cells of the map.
    fn bilinear(&self, p: Vec2) -> (f32, Vec2) {
        let base = p.floor().clamp(Vec2::ZERO, Vec2::splat((MAP - 2) as f32));
        let f = p - base;
        let (x, z) = (base.x as isize, base.y as isize);
        let [a, b, c, d] = [self.at(x, z), self.at(x + 1, z), self.at(x, z + 1), self.at(x + 1, z + 1)];
        let slope = Vec2::new(lerp(b - a, d - c, f.y), lerp(c - a, d - b, f.x));
        (lerp(lerp(a, b, f.x), lerp(c, d, f.x), f.y), slope)
    }

    /// Adds to the four map points around a place, by their nearness.
    fn deposit(&mut self, p: Vec2, amount: f32) {
        let base = p.floor();
        let f = p - base;
        let first = base.y as usize * MAP + base.x as usize;
        self.heights[first] += amount * (1.0 - f.x) * (1.0 - f.y);
        self.heights[first + 1] += amount * f.x * (1.0 - f.y);
        self.heights[first + MAP] += amount * (1.0 - f.x) * f.y;
        self.heights[first + MAP + 1] += amount * f.x * f.y;
    }

    /// Takes from the map points within a few cells, most in the middle: wide beds instead of scratches.
    fn erode(&mut self, p: Vec2, amount: f32) {
        const REACH: isize = 2;
        let (x, z) = (p.x.round() as isize, p.y.round() as isize);
        let weight = |i: isize, k: isize| {
            let offset = Vec2::new((x + i) as f32, (z + k) as f32) - p;
            (1.0 - offset.length() / (REACH as f32 + 0.5)).max(0.0)
        };
        let window = || (-REACH..=REACH).flat_map(|k| (-REACH..=REACH).map(move |i| (i, k)));
        let total: f32 = window().map(|(i, k)| weight(i, k)).sum();
        for (i, k) in window() {
            let (x, z) = (x + i, z + k);
            if (0..MAP as isize).contains(&x) && (0..MAP as isize).contains(&z) {
                self.heights[z as usize * MAP + x as usize] -= amount * weight(i, k) / total;
            }
        }
    }

    /// One drop runs downhill, takes soil where it is fast and leaves it where it slows down.
    ///
    /// After Hans Theobald Beyer: Implementation of a method for hydraulic erosion, 2015.
    fn rain(&mut self, drop: u32) {
        const INERTIA: f32 = 0.25;
        let unit = |salt: u32| mix(drop.wrapping_mul(2).wrapping_add(salt)) as f32 / 4_294_967_296.0;
        let mut p = Vec2::new(unit(0), unit(1)) * (MAP - 2) as f32;
        let (mut heading, mut speed_sq, mut water, mut soil) = (Vec2::ZERO, 1.0_f32, 1.0_f32, 0.0_f32);
        for _ in 0..64 {
            let (height, slope) = self.bilinear(p);
            heading = (heading * INERTIA - slope.normalize_or_zero() * (1.0 - INERTIA)).normalize_or_zero();
            let next = p + heading;
            let inside = |c: f32| c > 1.0 && c < (MAP - 2) as f32;
            if heading == Vec2::ZERO || !inside(next.x) || !inside(next.y) || height < LAKE - 12.0 {
                break;
            }
            let fall = height - self.bilinear(next).0;
            let capacity = 0.35 * fall.max(0.05) * speed_sq.sqrt() * water;
            if fall < 0.0 || soil > capacity {
                let left = if fall < 0.0 { soil.min(-fall) } else { 0.3 * (soil - capacity) };
                soil -= left;
                self.deposit(p, left);
            } else {
                let taken = (0.3 * (capacity - soil)).min(fall);
                soil += taken;
                self.erode(p, taken);
            }
            speed_sq = (speed_sq + 0.4 * fall).clamp(0.05, 30.0);
            water *= 0.98;
            p = next;
        }
    }
}

/// The land before the rain: ridges that grow out of a valley with a basin.
fn uplift(p: Vec2) -> f32 {
    let q = Vec3::new(p.x, 0.0, p.y) / EXTENT;
    let warp = Vec3::new(fractal(q * 3.0, 3, 41), 0.0, fractal(q * 3.0, 3, 42)) * 0.22;
    let w = q + warp;
    let (mut ridges, mut amplitude, mut size, mut weight) = (0.0, 0.55, 2.3, 1.0);
    for octave in 0..6 {
        let ridge = 1.0 - gradient(w * size + Vec3::splat(0.37), 90 + octave).abs();
        let ridge = ridge * ridge * weight;
        ridges += amplitude * ridge;
        // detail only where the coarser ridges are high
        weight = (1.4 * ridge).min(1.0);
        amplitude *= 0.5;
        size *= 2.05;
    }
    // the valley winds from the front to the left behind, the basin of the lake lies in it
    let bend = 0.50 + 0.16 * gradient(Vec3::new(0.3, 0.0, q.z * 2.2), 61) + 0.10 * (q.z - 0.5);
    let valley = smoothstep(0.05, 0.42, (q.x - bend).abs() + 0.06 * fractal(w * 5.0, 3, 62));
    let basin = smoothstep(0.34, 0.06, Vec2::new(q.x - bend, (q.z - 0.60) * 0.8).length());
    60.0 + RELIEF * ridges * (0.10 + 0.90 * valley) + 60.0 * (1.0 - q.z) - 75.0 * basin
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::testing;

    #[test]
    fn terrain_is_an_open_sheet_of_the_size_asked_for() {
        let mesh = terrain(20_000);
        mesh.check().unwrap();
        assert!(mesh.triangle_count().abs_diff(20_000) < 500);
        assert_eq!(testing::euler(&mesh.triangles), 1);
        assert_eq!(testing::components(&mesh.triangles), 1);
        for t in 0..mesh.triangle_count() {
            let [a, b, c] = mesh.triangle_points(t);
            assert!((b - a).cross(c - a).y > 0.0);
        }
    }

    #[test]
    fn colors_are_within_range_and_there_is_water_and_snow() {
        let mesh = terrain(80_000);
        let colors = mesh.wedge_attribute(&Semantic::Color(0)).unwrap().as_f32().unwrap();
        assert!(colors.iter().all(|c| (0.0..=1.0).contains(c)));
        let share = |test: fn(&[f32]) -> bool| {
            colors.chunks_exact(3).filter(|c| test(c)).count() as f32 / (colors.len() / 3) as f32
        };
        assert!((0.03..0.3).contains(&share(|c| c[2] > 1.1 * c[1] && c[0] < 0.1)));
        assert!((0.02..0.4).contains(&share(|c| c[0] > 0.7)));
    }
}
