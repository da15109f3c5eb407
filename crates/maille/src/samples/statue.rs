//! A seated cat on a plinth, as a scanner would bring it home from a museum.

use glam::{Vec2, Vec3};

use super::distance::{carve, ellipsoid, join, round_cone, rounded_box, torus};
use super::isosurface::Isosurface;
use super::noise::{fractal, smoothstep};
use crate::Mesh;

/// Height at which the cat sits in its own coordinates.
const FLOOR: f32 = 0.21;
/// Height of the top of the plinth.
const TOP: f32 = 0.12;

/// A statue of about `triangles` triangles (at least some 1,000): one closed manifold with tool marks in the stone and scan noise at the size
/// of a triangle. 0.92 m high, no attributes.
///
/// Time and memory grow linearly.
pub fn statue(triangles: usize) -> Mesh {
    let low = Vec3::new(-0.22, -0.01, -0.31);
    let high = Vec3::new(0.22, 0.93, 0.31);
    let surface = Isosurface { distance, low, high, noise: 0.06 }.with_triangles(triangles.max(1000));
    Mesh::from_triangles(surface.positions, surface.triangles).expect("extracted indices are in range")
}

/// A share of the sum, to keep the slope of the carved distance below 1.
const SLOPE: f32 = 0.8;

fn distance(p: Vec3) -> f32 {
    let rough = cat(p + Vec3::Y * (FLOOR - TOP)).min(plinth(p));
    if rough.abs() > 0.005 {
        // too far off for marks to matter; less than the distance with them
        return SLOPE * (rough - 0.003 * rough.signum());
    }
    // chisel marks, then grain
    let marks = 0.0025 * fractal(p * 22.0, 2, 11) + 0.0009 * fractal(p * 130.0, 2, 12);
    SLOPE * (rough + marks)
}

fn plinth(p: Vec3) -> f32 {
    let above = p.y - TOP;
    if above > 0.02 {
        return above;
    }
    let slab = |y: f32, half: Vec3| rounded_box(p - Vec3::new(0.0, y, 0.0), half, 0.006);
    let body = slab(0.062, Vec3::new(0.195, 0.05, 0.280)) + relief(p);
    let foot = slab(0.012, Vec3::new(0.212, 0.012, 0.297));
    let top = slab(TOP - 0.011, Vec3::new(0.208, 0.011, 0.293));
    join(join(body, foot, 0.012), top, 0.010)
}

/// A band of lotus petals around the plinth, carved 4 mm deep.
fn relief(p: Vec3) -> f32 {
    // the coordinate along whichever side is nearer, petals of 39 mm
    let along = if p.x.abs() - 0.195 > p.z.abs() - 0.280 { p.z } else { p.x };
    let petal = (along / 0.039 + 0.5).rem_euclid(1.0) - 0.5;
    let height = (p.y - 0.026) / 0.070;
    if !(0.0..1.0).contains(&height) {
        return 0.0;
    }
    let width = 0.46 * (1.0 - height * height);
    let line = (petal.abs() - width).abs().min((petal.abs() - 0.45 * width).abs());
    let groove = 1.0 - smoothstep(0.02, 0.09, line);
    0.004 * groove * smoothstep(0.0, 0.06, height) * smoothstep(1.0, 0.94, height)
}

/// A shape that lies within a box; far off, the distance of the box is told instead.
fn within(p: Vec3, low: [f32; 3], high: [f32; 3], shape: impl FnOnce() -> f32) -> f32 {
    let (low, high) = (Vec3::from(low), Vec3::from(high));
    let bound = (low - p).max(p - high).max(Vec3::ZERO).length();
    // more than any fillet is wide
    if bound > 0.065 { bound } else { shape() }
}

fn cat(p: Vec3) -> f32 {
    within(p, [-0.20, 0.20, -0.27], [0.20, 0.995, 0.26], || {
        // left and right are alike but for the tail
        let m = Vec3::new(p.x.abs(), p.y, p.z);
        let legs = within(m, [0.0, 0.20, -0.20], [0.20, 0.60, 0.24], || legs(m));
        let head = within(m, [0.0, 0.77, 0.02], [0.09, 0.99, 0.23], || head(m));
        let collar = within(p, [-0.08, 0.64, -0.0], [0.08, 0.76, 0.18], || collar(p));
        let tail = within(p, [-0.02, 0.20, -0.27], [0.20, 0.29, 0.21], || tail(p));
        let body = join(join(trunk(m) + necklace(p), legs, 0.035), head, 0.03);
        join(body.min(collar), tail, 0.012)
    })
}

fn trunk(m: Vec3) -> f32 {
    let back = round_cone(m, Vec3::new(0.0, 0.335, -0.10), Vec3::new(0.0, 0.60, 0.05), 0.125, 0.088);
    let chest = ellipsoid(m - Vec3::new(0.0, 0.56, 0.085), Vec3::new(0.088, 0.13, 0.075));
    let neck = round_cone(m, Vec3::new(0.0, 0.62, 0.06), Vec3::new(0.0, 0.78, 0.10), 0.076, 0.057);
    let rump = ellipsoid(m - Vec3::new(0.0, 0.29, -0.16), Vec3::new(0.115, 0.09, 0.09));
    join(join(join(back, chest, 0.06), neck, 0.06), rump, 0.06)
}

fn legs(m: Vec3) -> f32 {
    let haunch = round_cone(m, Vec3::new(0.10, 0.30, -0.11), Vec3::new(0.105, 0.375, 0.0), 0.078, 0.062);
    let knee = round_cone(m, Vec3::new(0.105, 0.36, 0.01), Vec3::new(0.115, 0.27, 0.045), 0.056, 0.045);
    let hind = paw(m, Vec3::new(0.118, FLOOR + 0.021, -0.05), Vec3::new(0.122, FLOOR + 0.019, 0.09), 0.034);
    let shoulder = round_cone(m, Vec3::new(0.066, 0.545, 0.065), Vec3::new(0.058, 0.45, 0.125), 0.052, 0.042);
    let fore = round_cone(m, Vec3::new(0.058, 0.45, 0.125), Vec3::new(0.050, 0.25, 0.155), 0.042, 0.029);
    let front = paw(m, Vec3::new(0.050, FLOOR + 0.024, 0.150), Vec3::new(0.052, FLOOR + 0.018, 0.205), 0.033);
    let back_leg = join(join(haunch, knee, 0.03), hind, 0.012);
    let front_leg = join(join(shoulder, fore, 0.03), front, 0.02);
    back_leg.min(front_leg)
}

/// A paw from heel to toes: four toes parted by grooves.
fn paw(m: Vec3, heel: Vec3, tip: Vec3, size: f32) -> f32 {
    let sole = round_cone(m, heel, tip - Vec3::Z * 0.012, 0.022, 0.020);
    let toe = |k: f32| {
        let side = (k - 1.5) * 0.34 * size * 1.35;
        let reach = 0.014 - 0.006 * (k - 1.5).abs();
        ellipsoid(m - tip - Vec3::new(side, -0.002, reach), Vec3::new(0.0105, 0.016, 0.020))
    };
    let toes = toe(0.0).min(toe(1.0)).min(toe(2.0)).min(toe(3.0));
    join(sole, toes, 0.006)
}

fn head(m: Vec3) -> f32 {
    let skull = ellipsoid(m - Vec3::new(0.0, 0.848, 0.115), Vec3::new(0.077, 0.068, 0.080));
    let cheek = ellipsoid(m - Vec3::new(0.038, 0.815, 0.155), Vec3::new(0.036, 0.032, 0.036));
    let muzzle = ellipsoid(m - Vec3::new(0.014, 0.812, 0.192), Vec3::new(0.024, 0.021, 0.026));
    let chin = ellipsoid(m - Vec3::new(0.0, 0.792, 0.186), Vec3::new(0.018, 0.014, 0.020));
    let bridge = round_cone(m, Vec3::new(0.0, 0.866, 0.175), Vec3::new(0.0, 0.832, 0.206), 0.020, 0.011);
    let nose = ellipsoid(m - Vec3::new(0.0, 0.829, 0.214), Vec3::new(0.0125, 0.008, 0.008));
    let face = join(join(skull, cheek, 0.03), bridge, 0.02);
    let face = join(join(face, muzzle, 0.014), chin, 0.008);
    let mouth = round_cone(m, Vec3::new(0.0, 0.806, 0.216), Vec3::new(0.030, 0.798, 0.203), 0.001, 0.001);
    let face = join(face, nose, 0.005) + engraving(mouth, 0.004);
    join(eyes(m, face), ears(m), 0.02)
}

fn eyes(m: Vec3, face: f32) -> f32 {
    // almonds that rise outwards: lids stand out, a groove parts them from the ball, kohl runs on to the temple
    let e = m - Vec3::new(0.0345, 0.856, 0.178);
    let e = Vec3::new(e.x * 0.95 + e.y * 0.31, e.y * 0.95 - e.x * 0.31, e.z);
    let lids = ellipsoid(e + Vec3::Z * 0.004, Vec3::new(0.0275, 0.0180, 0.0185));
    let ball = ellipsoid(e + Vec3::Z * 0.002, Vec3::new(0.0205, 0.0125, 0.0180));
    let almond = Vec2::new(e.x / 0.0215, e.y / 0.0130).length() - 1.0;
    let kohl = round_cone(e, Vec3::new(0.022, 0.0, 0.0), Vec3::new(0.046, -0.001, -0.022), 0.003, 0.002);
    let slit = round_cone(e, Vec3::new(0.0, -0.005, 0.016), Vec3::new(0.0, 0.005, 0.016), 0.001, 0.001);
    let eye = join(join(face, lids, 0.010), ball, 0.002);
    eye + engraving(0.013 * almond.abs(), 0.003) + engraving(kohl, 0.003) + engraving(slit, 0.003)
}

/// How much to cut away at a distance from a line: a groove half as deep as wide.
fn engraving(distance: f32, width: f32) -> f32 {
    0.5 * width * (1.0 - smoothstep(0.0, width, distance))
}

fn ears(m: Vec3) -> f32 {
    // upright leaves, hollow in front; flattened along z, where distances shrink by as much
    let flat = 0.55;
    let q = |z: f32| Vec3::new(m.x, m.y, (m.z - z) / flat);
    let leaf = round_cone(q(0.095), Vec3::new(0.045, 0.885, 0.0), Vec3::new(0.064, 0.980, -0.02), 0.038, 0.007);
    let hollow = round_cone(q(0.121), Vec3::new(0.047, 0.898, 0.0), Vec3::new(0.063, 0.964, -0.02), 0.028, 0.006);
    carve(leaf * flat, hollow * flat, 0.004)
}

fn collar(p: Vec3) -> f32 {
    let tilted = |p: Vec3| Vec3::new(p.x, p.y * 0.955 + p.z * 0.296, p.z * 0.955 - p.y * 0.296);
    let q = tilted(p - Vec3::new(0.0, 0.722, 0.088));
    let ring = torus(q, 0.0655, 0.0085);
    let twist = torus(q - Vec3::Y * 0.013, 0.0625, 0.005);
    let pendant = ellipsoid(p - Vec3::new(0.0, 0.672, 0.166), Vec3::new(0.020, 0.024, 0.010));
    ring.min(twist).min(pendant)
}

/// The broad collar: rows of beads engraved on the chest, around the neck.
fn necklace(p: Vec3) -> f32 {
    let from_neck = Vec3::new(p.x, p.y - 0.735, p.z - 0.075);
    let radius = from_neck.length();
    if !(0.085..0.20).contains(&radius) || p.z < 0.02 || p.y > 0.71 {
        return 0.0;
    }
    let row = radius / 0.0165;
    let groove = 1.0 - smoothstep(0.05, 0.16, (row - row.round()).abs());
    // beads: equal shares of the direction seen from the neck, shifted by half from row to row
    let direction = Vec2::new(from_neck.x, -from_neck.y).normalize_or_zero();
    let bead = direction.x * 22.0 + 0.5 * (row.round() % 2.0);
    let gap = 1.0 - smoothstep(0.06, 0.18, (bead - bead.round()).abs());
    let fade = smoothstep(0.20, 0.192, radius) * smoothstep(0.02, 0.045, p.z) * smoothstep(0.71, 0.70, p.y);
    0.0022 * groove.max(0.7 * gap) * fade
}

/// The tail lies around the right side of the cat, its tip on the front paw.
fn tail(p: Vec3) -> f32 {
    const PATH: [[f32; 4]; 9] = [
        [0.02, 0.250, -0.225, 0.034],
        [0.075, 0.236, -0.225, 0.030],
        [0.125, 0.231, -0.190, 0.027],
        [0.158, 0.229, -0.130, 0.025],
        [0.172, 0.228, -0.060, 0.024],
        [0.172, 0.228, 0.020, 0.023],
        [0.160, 0.228, 0.095, 0.022],
        [0.132, 0.229, 0.150, 0.021],
        [0.098, 0.236, 0.182, 0.017],
    ];
    let part = |w: &[[f32; 4]]| {
        let [a, b] = [w[0], w[1]].map(|[x, y, z, _]| Vec3::new(x, y, z));
        round_cone(p, a, b, w[0][3], w[1][3])
    };
    PATH.windows(2).map(part).fold(f32::INFINITY, |a, b| join(a, b, 0.01))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::testing;

    #[test]
    fn statue_is_one_closed_manifold_of_the_size_asked_for() {
        for wanted in [5_000, 60_000] {
            let mesh = statue(wanted);
            assert!(mesh.triangle_count().abs_diff(wanted) <= wanted / 10, "{}", mesh.triangle_count());
            testing::assert_closed_manifold(&mesh.triangles);
            assert_eq!(testing::components(&mesh.triangles), 1);
            assert!(testing::volume(&mesh.positions, &mesh.triangles) > 0.02);
        }
    }
}
