//! Noise and trigonometry that give the same bits everywhere: only IEEE-exact operations, no libm.

use glam::Vec3;

/// Mixes the bits of an integer well: the "lowbias32" finaliser found by Chris Wellons' hash prospector.
pub(super) fn mix(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A hash of a lattice point.
pub(super) fn hash(p: [i32; 3], seed: u32) -> u32 {
    let [x, y, z] = p.map(|c| c as u32);
    mix(x ^ mix(y ^ mix(z ^ mix(seed))))
}

/// A number from -1 to 1 out of a hash.
pub(super) fn signed_unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (2.0 / 16_777_215.0) - 1.0
}

/// Gradient noise (Perlin 2002), roughly -1 to 1, features of size 1, zero at the lattice points.
pub(super) fn gradient(p: Vec3, seed: u32) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let [x, y, z] = cell.to_array().map(|c| c as i32);
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |i: i32, j: i32, k: i32| {
        let offset = f - Vec3::new(i as f32, j as f32, k as f32);
        edge_dot(hash([x.wrapping_add(i), y.wrapping_add(j), z.wrapping_add(k)], seed), offset)
    };
    let row = |j, k| lerp(corner(0, j, k), corner(1, j, k), fade.x);
    lerp(lerp(row(0, 0), row(1, 0), fade.y), lerp(row(0, 1), row(1, 1), fade.y), fade.z)
}

/// Dot product with one of the 12 directions to a cube's edges.
fn edge_dot(hash: u32, p: Vec3) -> f32 {
    let signed = |bit: u32, value: f32| if hash >> bit & 1 == 0 { value } else { -value };
    match (hash >> 8) % 3 {
        0 => signed(0, p.x) + signed(1, p.y),
        1 => signed(0, p.y) + signed(1, p.z),
        _ => signed(0, p.z) + signed(1, p.x),
    }
}

/// A sum of `octaves` of [`gradient`], each half as large and twice as fine; roughly -1 to 1.
pub(super) fn fractal(p: Vec3, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut size, mut amplitude) = (0.0, 1.0, 0.5);
    for octave in 0..octaves {
        sum += amplitude * gradient(p * size, seed.wrapping_add(octave));
        // not quite 2, so that the zeros on the lattices do not line up
        size *= 2.03;
        amplitude *= 0.5;
    }
    sum
}

/// Cosine and sine of a fraction of a whole turn, within 1e-15.
pub(super) fn turn(fraction: f64) -> (f64, f64) {
    let quarters = (fraction * 4.0).round();
    let a = (fraction - quarters / 4.0) * std::f64::consts::TAU;
    let s = a * a;
    // Taylor series; |a| <= pi/4, so the first terms left out are below 1e-16
    let series = |last: u32| {
        let term = |sum: f64, n: u32| 1.0 - sum * s / f64::from(n * (n - 1));
        (1..=8).rev().map(|k| 2 * k + last).fold(1.0, term)
    };
    let (cos, sin) = (series(0), a * series(1));
    match quarters.rem_euclid(4.0) as u32 {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    }
}

pub(super) fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turn_agrees_with_the_standard_library() {
        for i in -2000..2000 {
            let fraction = f64::from(i) / 777.0;
            let (sin, cos) = (fraction * std::f64::consts::TAU).sin_cos();
            let (c, s) = turn(fraction);
            assert!((c - cos).abs() < 1e-14 && (s - sin).abs() < 1e-14, "{fraction}");
        }
    }

    #[test]
    fn gradient_noise_is_continuous_and_bounded() {
        let mut last = gradient(Vec3::new(-3.0, 0.3, 0.7), 5);
        for i in 0..6000 {
            let next = gradient(Vec3::new(-3.0 + 0.001 * i as f32, 0.3, 0.7), 5);
            assert!(next.abs() <= 1.5 && (next - last).abs() < 0.01);
            last = next;
        }
    }
}
