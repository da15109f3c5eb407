//! A gear on a ribbed flange, as a CAD program would export it.

use glam::DVec2;

use super::part::{Outline, Part, RingId, direction};
use crate::Mesh;

const TEETH: usize = 28;
const RIBS: usize = 8;
const HOLES: usize = 6;
/// Width of a broken edge.
const CHAMFER: f64 = 0.0015;

/// A gear on a ribbed flange, of about `triangles` triangles (at least some 4,000): a closed manifold with flat,
/// cylindrical, conical and involute faces, through holes, a keyway, thin fins and sharp edges. 0.24 m wide.
///
/// Normals, with creases as wedges. Flat faces are cut into few long triangles, as CAD programs do.
pub fn mechanical(triangles: usize) -> Mesh {
    // the count grows with the number of segments to a circle
    let (mut fewest, mut most) = (16, 17 + triangles / 60);
    while fewest + 1 < most {
        let middle = (fewest + most) / 2;
        if gear_flange(middle).triangle_count() <= triangles {
            fewest = middle;
        } else {
            most = middle;
        }
    }
    gear_flange(fewest).mesh()
}

/// The part, with `n` segments to a circle.
fn gear_flange(n: usize) -> Part {
    let mut part = Part::new(0.1 * n as f64);
    let bore = bore(&mut part, n, 0.0, 0.158);
    let hub = flange(&mut part, n, bore[0]);
    let hub = fins(&mut part, n, hub);
    gear(&mut part, n, hub, bore[1]);
    part
}

/// The through hole with its keyway, broken at both ends; returns the rings at the bottom and at the top.
fn bore(part: &mut Part, n: usize, bottom: f64, top: f64) -> [RingId; 2] {
    let keyed = |grow: f64| {
        let (radius, half_width, depth) = (0.022 + grow, 0.005 + grow, 0.0275 + grow);
        let cos = (radius * radius - half_width * half_width).sqrt();
        let from = (half_width / cos).atan() / std::f64::consts::TAU;
        let mut outline = Outline::default();
        outline.arc(DVec2::ZERO, radius, from, 1.0 - from, n);
        let corners = [(cos, -1.0), (depth, -1.0), (depth, 1.0), (cos, 1.0)];
        let corners = corners.map(|(x, side)| DVec2::new(x, side * half_width));
        for pair in corners.windows(2) {
            outline.line(pair[0], pair[1]);
        }
        outline.hole()
    };
    let low = part.ring(keyed(CHAMFER), bottom);
    let above = part.rise(low, keyed(0.0), bottom + CHAMFER);
    let below = part.rise(above, keyed(0.0), top - CHAMFER);
    let high = part.rise(below, keyed(CHAMFER), top);
    [low, high]
}

/// The square plate with its bolt holes and ribs; returns the ring of the hub above.
fn flange(part: &mut Part, n: usize, bore: RingId) -> RingId {
    let plate = |half: f64| {
        let corner = 0.03;
        let inner = half - corner;
        let mut outline = Outline::default();
        for k in 0..4 {
            let quarter = f64::from(k) / 4.0;
            let turned = |p: DVec2| direction(quarter).rotate(p);
            outline.arc(turned(DVec2::splat(inner)), corner, quarter, quarter + 0.25, n.div_ceil(4));
            outline.line(turned(DVec2::new(inner, half)), turned(DVec2::new(-inner, half)));
        }
        outline
    };
    let half = 0.12;
    let bottom = part.ring(plate(half - CHAMFER), 0.0);
    let low = part.rise(bottom, plate(half), CHAMFER);
    let high = part.rise(low, plate(half), 0.016 - CHAMFER);
    let top = part.rise(high, plate(half - CHAMFER), 0.016);
    let (mut below, mut above) = (vec![bottom, bore], vec![top]);
    for k in 0..4 {
        let centre = 0.129 * direction((f64::from(k) + 0.5) / 4.0);
        let (low, high) = counterbore(part, n, centre);
        below.push(low);
        above.push(high);
    }
    let foot = part.ring(ribs(n, 0.108), 0.016);
    above.push(foot);
    part.cap(&below, false);
    part.cap(&above, true);
    let tip = part.rise(foot, ribs(n, 0.052), 0.058);
    let hub = part.ring(Outline::circle(DVec2::ZERO, 0.045, n), 0.058);
    part.cap(&[tip, hub], true);
    hub
}

/// A hole for a bolt whose head is sunk; returns the rings at the bottom and at the top of the plate.
fn counterbore(part: &mut Part, n: usize, centre: DVec2) -> (RingId, RingId) {
    let hole = |radius: f64| Outline::circle(centre, radius, n.div_ceil(2)).hole();
    let low = part.ring(hole(0.0085), 0.0);
    let floor = part.rise(low, hole(0.0085), 0.009);
    let wide = part.ring(hole(0.0145), 0.009);
    part.cap(&[wide, floor], true);
    let high = part.rise(wide, hole(0.0145), 0.016);
    (low, high)
}

/// The hub with thin ribs that reach out to a radius.
fn ribs(n: usize, reach: f64) -> Outline {
    let (hub, half_width) = (0.048, 0.003);
    let mut outline = Outline::default();
    let cos = f64::sqrt(hub * hub - half_width * half_width);
    let half = (half_width / cos).atan() / std::f64::consts::TAU;
    for k in 0..RIBS {
        let at = (k as f64 + 0.5) / RIBS as f64;
        let turned = |x: f64, y: f64| direction(at).rotate(DVec2::new(x, y));
        let corners =
            [turned(cos, -half_width), turned(reach, -half_width), turned(reach, half_width), turned(cos, half_width)];
        for pair in corners.windows(2) {
            outline.line(pair[0], pair[1]);
        }
        outline.arc(DVec2::ZERO, hub, at + half, at + 1.0 / RIBS as f64 - half, n.div_ceil(RIBS));
    }
    outline
}

/// Thin discs around the hub; returns the ring of the hub above them.
fn fins(part: &mut Part, n: usize, mut hub: RingId) -> RingId {
    let circle = |radius: f64| Outline::circle(DVec2::ZERO, radius, n);
    let mut y = 0.064;
    for radius in [0.080, 0.076, 0.072] {
        let root = part.rise(hub, circle(0.045), y);
        let low = part.ring(circle(radius), y);
        part.cap(&[low, root], false);
        y += 0.0025;
        let high = part.rise(low, circle(radius), y);
        hub = part.ring(circle(0.045), y);
        part.cap(&[high, hub], true);
        y += 0.006;
    }
    hub
}

/// The gear with its pocket and lightening holes, and the collar above it, which ends around the bore.
fn gear(part: &mut Part, n: usize, hub: RingId, bore: RingId) {
    let (bottom, pocket, top) = (0.098, 0.122, 0.132);
    let root = part.rise(hub, Outline::circle(DVec2::ZERO, 0.045, n), bottom);
    let low = part.ring(teeth(n, CHAMFER), bottom);
    let rim_low = part.rise(low, teeth(n, 0.0), bottom + CHAMFER);
    let rim_high = part.rise(rim_low, teeth(n, 0.0), top - CHAMFER);
    let high = part.rise(rim_high, teeth(n, CHAMFER), top);
    // the pocket's wall leans outwards, as a cast one does
    let edge = part.ring(Outline::circle(DVec2::ZERO, 0.0785, n).hole(), top);
    part.cap(&[high, edge], true);
    let foot = part.ring(Outline::circle(DVec2::ZERO, 0.0765, n).hole(), pocket);
    part.wall(foot, edge);
    let collar = part.ring(Outline::circle(DVec2::ZERO, 0.040, n), pocket);
    let (mut below, mut above) = (vec![low, root], vec![foot, collar]);
    for k in 0..HOLES {
        let hole = || Outline::circle(0.0605 * direction(k as f64 / HOLES as f64), 0.0115, n.div_ceil(2)).hole();
        let under = part.ring(hole(), bottom);
        below.push(under);
        above.push(part.rise(under, hole(), pocket));
    }
    part.cap(&below, false);
    part.cap(&above, true);
    let neck = part.rise(collar, Outline::circle(DVec2::ZERO, 0.038, n), 0.156);
    let end = part.rise(neck, Outline::circle(DVec2::ZERO, 0.036, n), 0.158);
    part.cap(&[end, bore], true);
}

/// Involute teeth of 20 degrees pressure angle, the tips taken back by `chamfer`.
fn teeth(n: usize, chamfer: f64) -> Outline {
    let pitch = 0.096;
    let module = 2.0 * pitch / TEETH as f64;
    let (tip, root) = (pitch + module - chamfer, pitch - 1.25 * module);
    let pressure = 20_f64.to_radians();
    let base = pitch * pressure.cos();
    // half the angle that a tooth covers where its involutes start
    let half = std::f64::consts::PI / (2.0 * TEETH as f64) + pressure.tan() - pressure;
    let unit = DVec2::from_angle(-half);
    let steps = n.div_ceil(24).max(3);
    let last = ((tip / base).powi(2) - 1.0).sqrt();
    let flank = |i: usize| {
        let t = last * i as f64 / steps as f64;
        let (sin, cos) = t.sin_cos();
        let point = base * DVec2::new(cos + t * sin, sin - t * cos);
        (unit.rotate(point), unit.rotate(DVec2::new(sin, -cos)))
    };
    let right: Vec<(DVec2, DVec2)> = (0..=steps).map(flank).collect();
    let mirror = |p: DVec2| DVec2::new(p.x, -p.y);
    let left: Vec<(DVec2, DVec2)> = right.iter().rev().map(|&(p, n)| (mirror(p), mirror(n))).collect();
    let share = |p: DVec2| p.y.atan2(p.x) / std::f64::consts::TAU;
    let foot = unit * root;
    let mut outline = Outline::default();
    for k in 0..TEETH {
        let at = k as f64 / TEETH as f64;
        let turned = |samples: &[(DVec2, DVec2)]| -> Vec<(DVec2, DVec2)> {
            let turn = direction(at);
            samples.iter().map(|&(p, n)| (turn.rotate(p), turn.rotate(n))).collect()
        };
        let edge = |p: DVec2| direction(at).rotate(p);
        outline.line(edge(foot), edge(right[0].0));
        outline.curve(&turned(&right));
        outline.arc(DVec2::ZERO, tip, at + share(right[steps].0), at - share(right[steps].0), n.div_ceil(64));
        outline.curve(&turned(&left));
        outline.line(edge(mirror(right[0].0)), edge(mirror(foot)));
        outline.arc(DVec2::ZERO, root, at - share(foot), at + 1.0 / TEETH as f64 + share(foot), n.div_ceil(48));
    }
    outline
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Semantic;
    use crate::samples::testing;

    fn vertex_triangles(mesh: &Mesh) -> Vec<[u32; 3]> {
        (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect()
    }

    #[test]
    fn mechanical_is_closed_and_of_the_size_asked_for() {
        for wanted in [4_800, 9_500, 20_100, 60_000] {
            let mesh = mechanical(wanted);
            mesh.check().unwrap();
            assert!(mesh.triangle_count().abs_diff(wanted) <= wanted / 10, "{}", mesh.triangle_count());
            let triangles = vertex_triangles(&mesh);
            testing::assert_closed_manifold(&triangles);
            assert_eq!(testing::components(&triangles), 1);
            // the bore, four bolt holes and six holes in the web: genus 11
            assert_eq!(testing::euler(&triangles), 2 - 2 * 11);
            assert!(testing::volume(&mesh.positions, &triangles) > 0.0);
        }
    }

    #[test]
    fn triangles_face_as_their_normals_say() {
        let mesh = mechanical(20_000);
        let normals = mesh.wedge_attribute(&Semantic::Normal).unwrap().as_f32().unwrap();
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = mesh.triangle_points(i);
            let face = (b - a).cross(c - a).normalize();
            for &wedge in triangle {
                let normal = glam::Vec3::from_slice(&normals[3 * wedge as usize..]).as_dvec3();
                assert!((normal.length() - 1.0).abs() < 1e-5);
                let is_sliver = (b - a).cross(c - a).length() < 1e-9;
                assert!(is_sliver || face.dot(normal) > 0.97, "{face} {normal}");
            }
        }
    }
}
