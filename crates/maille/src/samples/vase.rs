//! A black-figure vase: a surface of revolution with painted dolphins, waves and a Greek key.

use glam::{DVec2, Vec2, Vec3};

use super::noise::{fractal, smoothstep, turn};
use crate::mesh::{Attribute, Mesh, Semantic};

/// Radius and height in metres, from the middle of the underside over foot, body, neck and lip down to the inside.
const PROFILE: [[f64; 2]; 44] = [
    [0.0, 0.0070],
    [0.030, 0.0065],
    [0.052, 0.0040],
    [0.0590, 0.0004],
    [0.0640, 0.0010],
    [0.0670, 0.0060],
    [0.0665, 0.0115],
    [0.0620, 0.0155],
    [0.0480, 0.0195],
    [0.0375, 0.0270],
    [0.0350, 0.0360],
    [0.0370, 0.0430],
    [0.0440, 0.0530],
    [0.0600, 0.0780],
    [0.0810, 0.1100],
    [0.1030, 0.1500],
    [0.1200, 0.1950],
    [0.1265, 0.2300],
    [0.1240, 0.2620],
    [0.1110, 0.2930],
    [0.0880, 0.3182],
    [0.0640, 0.3350],
    [0.0510, 0.3500],
    [0.0455, 0.3700],
    [0.0450, 0.3900],
    [0.0500, 0.4100],
    [0.0620, 0.4250],
    [0.0720, 0.4310],
    [0.0762, 0.4355],
    [0.0755, 0.4400],
    [0.0710, 0.4415],
    [0.0640, 0.4370],
    [0.0530, 0.4240],
    [0.0430, 0.4060],
    [0.0390, 0.3880],
    [0.0395, 0.3700],
    [0.0455, 0.3510],
    [0.0620, 0.3310],
    [0.1040, 0.2920],
    [0.1185, 0.2500],
    [0.1140, 0.1970],
    [0.0840, 0.1250],
    [0.0440, 0.0680],
    [0.0, 0.0560],
];
/// The piece of the profile after which the inside begins: it takes less paint and fewer triangles.
const LIP: usize = 30;

const CLAY: Vec3 = Vec3::new(0.52, 0.165, 0.052);
const GLOSS: Vec3 = Vec3::new(0.014, 0.011, 0.010);
const PURPLE: Vec3 = Vec3::new(0.16, 0.018, 0.022);
const CREAM: Vec3 = Vec3::new(0.72, 0.60, 0.42);

/// A vase of about `triangles` triangles, 0.44 m high, with thickness, foot and lip: a closed manifold of genus 0.
///
/// Normals, one set of texture coordinates (u around, with a seam at the back; v from the lip's inside down the
/// outside) and colours (linear) painted per vertex: with half a million triangles and more the motifs are crisp.
pub fn vase(triangles: usize) -> Mesh {
    // cells about square at the widest part
    let around = ((triangles as f64 / 2.0 / 1.05).sqrt().round() as usize).max(8);
    let rows = (triangles / (2 * around)).max(8) + 1;
    let profile = sampled_profile(rows - 1);
    Revolution { profile: &profile, around }.mesh()
}

/// A point of the profile.
#[derive(Debug, Clone, Copy)]
struct Station {
    /// Radius and height.
    point: DVec2,
    /// Unit normal, outwards and upwards.
    normal: DVec2,
    /// Share of the way along the profile.
    along: f64,
    is_outside: bool,
}

/// Stations along the profile between its two ends on the axis, denser outside than inside; the ends are left out.
fn sampled_profile(count: usize) -> Vec<Station> {
    const FINE: usize = 64;
    let fine: Vec<(usize, DVec2, DVec2)> = (0..(PROFILE.len() - 1) * FINE)
        .map(|i| {
            let (point, tangent) = spline(i / FINE, (i % FINE) as f64 / FINE as f64);
            (i / FINE, point, tangent)
        })
        .collect();
    // what each piece costs: its length, but only a third of it inside
    let mut costs = vec![0.0];
    let mut lengths = vec![0.0];
    for pair in fine.windows(2) {
        let length = pair[0].1.distance(pair[1].1);
        costs.push(costs[costs.len() - 1] + if pair[0].0 < LIP { length } else { length / 3.0 });
        lengths.push(lengths[lengths.len() - 1] + length);
    }
    let (total_cost, total_length) = (costs[costs.len() - 1], lengths[lengths.len() - 1]);
    let station = |k: usize| {
        let goal = total_cost * (k + 1) as f64 / (count + 1) as f64;
        let i = costs.partition_point(|&cost| cost <= goal).clamp(1, fine.len() - 1) - 1;
        let t = (goal - costs[i]) / (costs[i + 1] - costs[i]);
        let tangent = fine[i].2.lerp(fine[i + 1].2, t).normalize();
        Station {
            point: fine[i].1.lerp(fine[i + 1].1, t),
            normal: DVec2::new(tangent.y, -tangent.x),
            along: (lengths[i] + t * (lengths[i + 1] - lengths[i])) / total_length,
            is_outside: fine[i].0 < LIP,
        }
    };
    (0..count).map(station).collect()
}

/// Point and derivative of a centripetal Catmull-Rom spline through the profile (Barry and Goldman 1988), which neither
/// overshoots nor loops where the points lie close together.
fn spline(piece: usize, t: f64) -> (DVec2, DVec2) {
    let control = |i: isize| {
        let inside = DVec2::from(PROFILE[i.clamp(0, PROFILE.len() as isize - 1) as usize]);
        // mirrored in the axis beyond the ends, so that the surface is flat there
        if i < 0 || i >= PROFILE.len() as isize {
            let next = DVec2::from(PROFILE[if i < 0 { 1 } else { PROFILE.len() - 2 }]);
            DVec2::new(-next.x, next.y)
        } else {
            inside
        }
    };
    let [a, b, c, d] = [-1, 0, 1, 2].map(|k| control(piece as isize + k));
    let knot = |p: DVec2, q: DVec2| p.distance(q).sqrt();
    let (ab, bc, cd) = (knot(a, b), knot(b, c), knot(c, d));
    // as a cubic Hermite spline over the middle piece
    let start = bc * ((b - a) / ab - (c - a) / (ab + bc) + (c - b) / bc);
    let end = bc * ((c - b) / bc - (d - b) / (bc + cd) + (d - c) / cd);
    let (u, s) = (t * t, t * t * t);
    let point = b * (2.0 * s - 3.0 * u + 1.0) + start * (s - 2.0 * u + t) + c * (3.0 * u - 2.0 * s) + end * (s - u);
    let slope = (b - c) * 6.0 * (u - t) + start * (3.0 * u - 4.0 * t + 1.0) + end * (3.0 * u - 2.0 * t);
    (point, slope)
}

struct Revolution<'a> {
    profile: &'a [Station],
    around: usize,
}

impl Revolution<'_> {
    fn mesh(&self) -> Mesh {
        let n = self.around as u32;
        let rows = self.profile.len() as u32;
        let mut mesh = Mesh::default();
        let (mut normals, mut uvs, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        let mut wedge = |mesh: &mut Mesh, vertex: u32, normal: Vec3, uv: [f32; 2], color: Vec3| {
            mesh.wedge_vertices.push(vertex);
            normals.extend(normal.to_array());
            uvs.extend(uv);
            colors.extend(color.to_array());
        };
        for (row, station) in self.profile.iter().enumerate() {
            for column in 0..=n {
                let share = f64::from(column) / f64::from(n);
                // u = 0.5 faces +z, and u grows to the right as seen from outside
                let (cos, sin) = turn(f64::from(column % n) / f64::from(n) + 0.5);
                let spread = |p: DVec2| Vec3::new((p.x * sin) as f32, p.y as f32, (p.x * cos) as f32);
                let position = spread(station.point);
                if column < n {
                    mesh.positions.push(position.to_array());
                }
                let uv = [share as f32, 1.0 - station.along as f32];
                let color = paint(station, share, position, std::f64::consts::TAU * station.point.x / f64::from(n));
                wedge(&mut mesh, row as u32 * n + column % n, spread(station.normal).normalize(), uv, color);
            }
        }
        let id = |row: u32, column: u32| row * (n + 1) + column;
        let squares = (0..rows - 1).flat_map(|row| (0..n).map(move |column| (row, column)));
        mesh.triangles = squares
            .flat_map(|(row, column)| {
                let [a, b] = [id(row, column), id(row, column + 1)];
                let [d, c] = [id(row + 1, column), id(row + 1, column + 1)];
                if (row + column) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
            })
            .collect();
        // the two poles: a wedge for each triangle, its u in the middle
        for (end, normal, row) in [(PROFILE[0], -Vec3::Y, 0), (PROFILE[PROFILE.len() - 1], Vec3::Y, rows - 1)] {
            let vertex = mesh.positions.len() as u32;
            mesh.positions.push([0.0, end[1] as f32, 0.0]);
            for column in 0..n {
                let apex = mesh.wedge_vertices.len() as u32;
                let uv = [(column as f32 + 0.5) / n as f32, if row == 0 { 1.0 } else { 0.0 }];
                wedge(&mut mesh, vertex, normal, uv, CLAY * 0.8);
                let [a, b] = [id(row, column), id(row, column + 1)];
                mesh.triangles.push(if row == 0 { [a, apex, b] } else { [a, b, apex] });
            }
        }
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, normals));
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, uvs));
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Color(0), 3, colors));
        mesh
    }
}

/// The colour at a point; `cell` is the size of the mesh there, which edges are softened by.
fn paint(station: &Station, share: f64, position: Vec3, cell: f64) -> Vec3 {
    let cell = cell.max(1e-9) as f32;
    // clay is never quite even
    let clay = CLAY * (1.0 + 0.12 * fractal(position * 30.0, 4, 71) + 0.05 * fractal(position * 400.0, 2, 72));
    let y = station.point.y as f32;
    if !station.is_outside {
        let rim = cover(0.405 - y, 0.004);
        return (clay * 0.8).lerp(GLOSS, rim);
    }
    let around = share.rem_euclid(1.0) as f32;
    let mut color = clay;
    for band in BANDS {
        if y >= band.low && y < band.high {
            // the pattern's own coordinates: y from 0 to 1 within the band, x in units of the band's height
            let height = band.high - band.low;
            let length = std::f32::consts::TAU * band.radius / height;
            let repeats = (length / band.width).round();
            let x = (around * repeats).rem_euclid(1.0) * band.width;
            let q = Vec2::new(x, (y - band.low) / height);
            color = (band.pattern)(clay, q, cell / height);
        }
    }
    color
}

/// How much of a point is covered by a shape at a signed distance, 0 to 1, softened over `width`.
fn cover(distance: f32, width: f32) -> f32 {
    (0.5 - distance / width).clamp(0.0, 1.0)
}

/// A painted band between two heights.
struct Band {
    low: f32,
    high: f32,
    /// Radius of the vase there, to fit whole repeats at about the right proportions.
    radius: f32,
    /// Width of a repeat, in heights of the band.
    width: f32,
    pattern: fn(Vec3, Vec2, f32) -> Vec3,
}

const fn band(low: f32, high: f32, radius: f32, width: f32, pattern: fn(Vec3, Vec2, f32) -> Vec3) -> Band {
    Band { low, high, radius, width, pattern }
}

const BANDS: [Band; 15] = [
    band(0.0, 0.0150, 0.065, 1.0, gloss),
    band(0.0150, 0.0200, 0.055, 1.0, purple),
    band(0.0200, 0.0520, 0.040, 1.0, gloss),
    band(0.0520, 0.0960, 0.058, 0.42, rays),
    band(0.0960, 0.1060, 0.075, 1.0, lines),
    band(0.1060, 0.1300, 0.086, 1.25, waves),
    band(0.1300, 0.1390, 0.095, 1.0, lines),
    band(0.1390, 0.2420, 0.121, 1.48, dolphins),
    band(0.2420, 0.2500, 0.126, 1.0, lines),
    band(0.2500, 0.2750, 0.122, 1.143, greek_key),
    band(0.2750, 0.2830, 0.117, 1.0, lines),
    band(0.2830, 0.3330, 0.092, 0.26, tongues),
    band(0.3330, 0.3400, 0.062, 1.0, purple),
    band(0.3470, 0.4020, 0.046, 0.56, palmettes),
    band(0.4090, 0.4500, 0.060, 1.0, gloss),
];

fn gloss(_: Vec3, _: Vec2, _: f32) -> Vec3 {
    GLOSS
}

fn purple(_: Vec3, _: Vec2, _: f32) -> Vec3 {
    PURPLE
}

fn lines(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    let line = (q.y - 0.27).abs().min((q.y - 0.73).abs()) - 0.13;
    clay.lerp(GLOSS, cover(line, cell))
}

fn rays(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    let edge = (q.x - 0.21).abs() - 0.19 * (0.96 - q.y);
    clay.lerp(GLOSS, cover(edge, cell))
}

/// The running dog: a spiral in each repeat, which rolls off the one before.
fn waves(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    let crest = Vec2::new(0.62, 0.54);
    let from = q - crest;
    let radius = from.length();
    // how far around the curl, from its foot on the right over the top to the left
    let around = (from.y.atan2(from.x) / std::f32::consts::TAU).rem_euclid(1.0);
    let arm = (radius - (0.38 - 0.26 * around)).abs() - (0.09 - 0.045 * around);
    let sea = q.y - 0.12 - 0.50 * smoothstep(0.72, 1.06, q.x) * smoothstep(1.28, 1.08, q.x);
    let curl = if radius < 0.52 { arm } else { 1.0 };
    clay.lerp(GLOSS, cover(curl.min(sea), cell))
}

const KEY: [&[u8; 8]; 7] = [b"#######.", b"#.....#.", b"#.###.#.", b"#.#...#.", b"#.#####.", b"#.......", b"########"];

fn greek_key(clay: Vec3, q: Vec2, _: f32) -> Vec3 {
    let row = ((1.0 - q.y) * 7.0).clamp(0.0, 6.0) as usize;
    let column = (q.x / 1.143 * 8.0).clamp(0.0, 7.0) as usize;
    if KEY[row][column] == b'#' { GLOSS } else { clay }
}

fn tongues(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    // two tongues to a repeat, black and purple
    let (x, ink) = if q.x < 0.13 { (q.x, GLOSS) } else { (q.x - 0.13, PURPLE) };
    let from = Vec2::new(x - 0.065, (0.10 - q.y).max(q.y - 0.92).max(0.0));
    clay.lerp(ink, cover(from.length() - 0.047, cell))
}

/// Fans of leaves, joined by arcs.
fn palmettes(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    let p = Vec2::new(q.x - 0.28, q.y - 0.24);
    let leaf = |k: f32| {
        let angle = k * 0.44;
        let axis = Vec2::new(angle.sin(), angle.cos());
        let length = 0.62 - 0.055 * k.abs() * k.abs();
        let along = p.dot(axis) / length;
        let width = 0.058 * (along * (1.0 - along)).max(0.0).sqrt() * (0.7 + 1.5 * along);
        if (0.0..1.0).contains(&along) { p.perp_dot(axis).abs() - width } else { 1.0 }
    };
    let leaves = (-3..=3).map(|k| leaf(k as f32)).fold(1.0, f32::min);
    let heart = p.length() - 0.07;
    let arcs = ((Vec2::new(p.x.abs() - 0.28, p.y + 0.02)).length() - 0.16).abs().max(p.y + 0.02) - 0.022;
    let border = q.y.min(1.0 - q.y) - 0.035;
    let color = clay.lerp(GLOSS, cover(leaves.min(arcs).min(border), cell));
    color.lerp(PURPLE, cover(heart, cell))
}

/// Leaping dolphins over a sea of dots.
fn dolphins(clay: Vec3, q: Vec2, cell: f32) -> Vec3 {
    let p = Vec2::new(q.x - 0.74, q.y - 0.60) / 1.18;
    let cell = cell / 1.18;
    // along the bent body, nose at 0.5, and across it
    let s = p.x;
    let t = p.y + 0.80 * s * s;
    let flesh = dolphin(s, t);
    let mut color = clay.lerp(GLOSS, cover(flesh, cell));
    // what a black-figure painter scratches in or lays over: flank, gill, eye, a stripe of white
    let flank = (t + 0.035 - 0.02 * (1.0 - 4.0 * s * s)).abs().max(s - 0.33).max(-0.40 - s) - 0.006;
    let gill = ((Vec2::new(s - 0.17, t)).length() - 0.085).abs().max(0.19 - s).max(t.abs() - 0.075) - 0.006;
    let eye = (Vec2::new(s - 0.355, t - 0.022)).length();
    let belly = flesh.max(t + 0.062 - 0.015 * (1.0 - 4.0 * s * s)).max(s - 0.32).max(-0.35 - s) + 0.012;
    color = color.lerp(CREAM, cover(belly, cell));
    color = color.lerp(clay, cover(flank.min(gill), cell).min(cover(flesh, cell)));
    color = color.lerp(CREAM, cover((eye - 0.019).max(0.009 - eye), cell));
    // rosettes between the dolphins, dots for spray below
    let cell = cell * 1.18;
    let rosette = rosette(Vec2::new((q.x - 1.48).abs().min(q.x), q.y - 0.78));
    let dots = Vec2::new((q.x / 0.074).rem_euclid(1.0) - 0.5, (q.y - 0.055) / 0.074).length() * 0.074 - 0.021;
    color.lerp(GLOSS, cover(rosette.min(dots), cell))
}

fn dolphin(s: f32, t: f32) -> f32 {
    let reach = (0.5 - s).max(0.0) * (s + 0.52).max(0.0);
    let body = 0.135 * (4.0 * reach).max(0.0).sqrt() * smoothstep(-0.75, 0.25, s) * smoothstep(0.60, 0.28, s);
    let trunk = if (-0.52..0.5).contains(&s) { t.abs() - body - 0.012 } else { 1.0 };
    let beak = (t + 0.014).abs().max(s - 0.56).max(0.40 - s) - 0.022 * smoothstep(0.60, 0.42, s);
    // fins lean backwards
    let fin = |x: f32, y: f32, length: f32, height: f32| {
        let lean = x + 0.75 * y;
        (y - height).max(-0.05 - y).max((lean - 0.5 * length).abs() - 0.5 * length * (1.0 - y / height).max(0.0))
    };
    let dorsal = fin(s + 0.02, t - 0.095, 0.20, 0.13);
    let flipper = fin(s - 0.12, -t - 0.075, 0.13, 0.15);
    // two lobes that sweep back from the end of the tail
    let (lobe, root) = (Vec2::new(-0.13, 0.105), Vec2::new(s + 0.47, t.abs()));
    let along = (root.dot(lobe) / lobe.length_squared()).clamp(0.0, 1.0);
    let fluke = root.distance(lobe * along) - 0.034 + 0.024 * along;
    trunk.min(beak).min(dorsal).min(flipper).min(fluke)
}

fn rosette(p: Vec2) -> f32 {
    let radius = p.length();
    let petal = (p.y.atan2(p.x) / std::f32::consts::TAU * 8.0).rem_euclid(1.0) - 0.5;
    let petals = radius - 0.075 + 0.16 * petal * petal;
    petals.max(0.030 - radius).min(radius - 0.017)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::testing;

    #[test]
    fn vase_is_a_closed_sphere_with_a_seam() {
        let mesh = vase(20_000);
        mesh.check().unwrap();
        assert!(mesh.triangle_count().abs_diff(20_000) < 1000, "{}", mesh.triangle_count());
        let triangles: Vec<[u32; 3]> = (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect();
        testing::assert_closed_manifold(&triangles);
        assert_eq!(testing::euler(&triangles), 2);
        // a wall of about 7 mm around some 4 l
        let volume = testing::volume(&mesh.positions, &triangles);
        assert!((0.0008..0.003).contains(&volume), "{volume}");
        assert!(mesh.wedge_count() > mesh.vertex_count());
    }

    #[test]
    fn no_triangle_spans_the_seam_and_normals_face_outwards() {
        let mesh = vase(20_000);
        let floats = |semantic| mesh.wedge_attribute(&semantic).unwrap().as_f32().unwrap();
        let (uvs, normals, colors) =
            (floats(Semantic::TexCoord(0)), floats(Semantic::Normal), floats(Semantic::Color(0)));
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            let us = triangle.map(|w| uvs[2 * w as usize]);
            assert!(us.iter().all(|u| (u - us[0]).abs() < 0.1));
            let [a, b, c] = mesh.triangle_points(i);
            let face = (b - a).cross(c - a).normalize().as_vec3();
            assert!(triangle.iter().all(|&w| face.dot(Vec3::from_slice(&normals[3 * w as usize..])) > 0.5));
        }
        assert!(colors.iter().all(|c| (0.0..=1.0).contains(c)));
    }
}
