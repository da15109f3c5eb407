//! Colours: the curve of screens, linear light, and a space in which distances are what eyes see.

use glam::{DMat3, DVec3};

/// From the sRGB curve to linear light (IEC 61966-2-1).
pub fn to_linear(value: f32) -> f32 {
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// From linear light to the sRGB curve.
pub fn to_srgb(value: f32) -> f32 {
    if value <= 0.003_130_8 { value * 12.92 } else { (1.055 * f64::from(value).powf(1.0 / 2.4) - 0.055) as f32 }
}

/// From linear sRGB light to CIE XYZ, and its white, D65 (IEC 61966-2-1).
fn xyz_of_rgb() -> (DMat3, DVec3) {
    let xyz = DMat3::from_cols_array(&[0.4124, 0.2126, 0.0193, 0.3576, 0.7152, 0.1192, 0.1805, 0.0722, 0.9505]);
    (xyz, xyz * DVec3::ONE)
}

/// The same relative to the white: each row adds up to 1.
fn relative_xyz_of_rgb() -> DMat3 {
    let (xyz, white) = xyz_of_rgb();
    DMat3::from_diagonal(white.recip()) * xyz
}

/// Where the cube root of CIE L*a*b* goes over into a line: (6/29)^3, and the slope of that.
const DARK: f64 = 216.0 / 24_389.0;
const SLOPE: f64 = 841.0 / 108.0;

/// CIE L*a*b* of linear light in the primaries of sRGB, by a hundredth: from black to white is a distance of 1, and equal
/// distances look about equally far (CIE 15:2004, white D65). Light below zero counts as none.
pub fn to_lab(rgb: [f32; 3]) -> [f32; 3] {
    let f = |t: f64| if t > DARK { t.cbrt() } else { SLOPE * t.max(0.0) + 4.0 / 29.0 };
    let [x, y, z] = (relative_xyz_of_rgb() * DVec3::from(rgb.map(f64::from)).max(DVec3::ZERO)).to_array().map(f);
    [1.16 * y - 0.16, 5.0 * (x - y), 2.0 * (y - z)].map(|x| x as f32)
}

/// The inverse of [`to_lab`]; what no screen can show comes out as the light nearest to it in each primary.
pub fn from_lab(lab: [f32; 3]) -> [f32; 3] {
    let [l, a, b] = lab.map(f64::from);
    let y = (l + 0.16) / 1.16;
    let inverse = |f: f64| if f > 6.0 / 29.0 { f * f * f } else { (f - 4.0 / 29.0) / SLOPE };
    let xyz = DVec3::new(inverse(y + a / 5.0), inverse(y), inverse(y - b / 2.0));
    (relative_xyz_of_rgb().inverse() * xyz).max(DVec3::ZERO).as_vec3().to_array()
}

/// Chromaticities u' and v' of CIE XYZ: 4 X and 9 Y over X + 15 Y + 3 Z.
fn uv_of_xyz(xyz: DVec3) -> [f64; 2] {
    let sum = xyz.dot(DVec3::new(1.0, 15.0, 3.0));
    [4.0 * xyz.x / sum, 9.0 * xyz.y / sum]
}

/// CIE L*u*v* of linear light in the primaries of sRGB, by a hundredth: from black to white is a distance of 1, and equal
/// distances look about equally far (CIE 15:2004, white D65). Mixtures of lights lie on straight lines of its
/// chromaticities, so that ways between colours do not bend in hue. Light below zero counts as none.
pub fn to_luv(rgb: [f32; 3]) -> [f32; 3] {
    let (matrix, white) = xyz_of_rgb();
    let xyz = matrix * DVec3::from(rgb.map(f64::from)).max(DVec3::ZERO);
    let y = xyz.y / white.y;
    // black has no chromaticity
    if y.is_nan() || y <= 0.0 {
        return [0.0; 3];
    }
    let l = if y > DARK { 1.16 * y.cbrt() - 0.16 } else { 1.16 * SLOPE * y };
    let ([u, v], [white_u, white_v]) = (uv_of_xyz(xyz), uv_of_xyz(white));
    [l, 13.0 * l * (u - white_u), 13.0 * l * (v - white_v)].map(|x| x as f32)
}

/// The inverse of [`to_luv`]; what no screen can show comes out as the light nearest to it in each primary.
pub fn from_luv(luv: [f32; 3]) -> [f32; 3] {
    let (matrix, white) = xyz_of_rgb();
    let [l, u, v] = luv.map(f64::from);
    if l.is_nan() || l <= 0.0 {
        return [0.0; 3];
    }
    let [white_u, white_v] = uv_of_xyz(white);
    let (u, v) = (u / (13.0 * l) + white_u, v / (13.0 * l) + white_v);
    let y = white.y * if l > 0.08 { ((l + 0.16) / 1.16).powi(3) } else { l / (1.16 * SLOPE) };
    let xyz = DVec3::new(9.0 * u, 4.0 * v, 12.0 - 3.0 * u - 20.0 * v) * (y / (4.0 * v));
    (matrix.inverse() * xyz).max(DVec3::ZERO).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_colors_are_where_they_belong() {
        // Lindbloom's calculator, sRGB, D65
        for (rgb, lab, luv) in [
            ([0.0; 3], [0.0; 3], [0.0; 3]),
            ([1.0; 3], [100.0, 0.0, 0.0], [100.0, 0.0, 0.0]),
            ([1.0, 0.0, 0.0], [53.24, 80.09, 67.20], [53.24, 175.01, 37.76]),
            ([0.0, 1.0, 0.0], [87.73, -86.18, 83.18], [87.73, -83.08, 107.39]),
            ([0.0, 0.0, 1.0], [32.30, 79.19, -107.86], [32.30, -9.40, -130.34]),
        ] {
            for (found, known) in [(to_lab(rgb), lab), (to_luv(rgb), luv)] {
                assert!(found.iter().zip(known).all(|(x, y)| (x * 100.0 - y).abs() < 0.06), "{rgb:?}: {found:?}");
            }
        }
    }

    #[test]
    fn greys_and_their_dark_end_follow_the_formula() {
        // L* of Y: 116 Y^(1/3) - 16 above (6/29)^3, (29/3)^3 Y below; u* and v* of grey are 0
        for (y, l) in [(0.18, 116.0 * 0.18_f64.cbrt() - 16.0), (0.001, 24_389.0 / 27.0 * 0.001), (0.0, 0.0)] {
            let [found, u, v] = to_luv([y as f32; 3]).map(|x| f64::from(x) * 100.0);
            assert!((found - l).abs() < 1e-4 && u.abs() < 1e-4 && v.abs() < 1e-4, "{found} {u} {v}");
        }
        assert_eq!(to_luv([-1.0; 3]), [0.0; 3]);
        assert_eq!(from_luv([0.0, 0.3, 0.3]), [0.0; 3]);
    }

    proptest! {
        #[test]
        fn there_and_back(rgb in prop::array::uniform3(0.0_f32..1.0)) {
            for back in [from_lab(to_lab(rgb)), from_luv(to_luv(rgb))] {
                prop_assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", back);
            }
        }
    }
}
