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

/// From linear sRGB light to CIE XYZ, relative to the white of D65 (IEC 61966-2-1): each row adds up to 1.
fn xyz_of_rgb() -> DMat3 {
    let xyz = DMat3::from_cols_array(&[0.4124, 0.2126, 0.0193, 0.3576, 0.7152, 0.1192, 0.1805, 0.0722, 0.9505]);
    let white = xyz * DVec3::ONE;
    DMat3::from_diagonal(white.recip()) * xyz
}

/// Where the cube root of CIE L*a*b* goes over into a line: (6/29)^3, and the slope of that.
const DARK: f64 = 216.0 / 24_389.0;
const SLOPE: f64 = 841.0 / 108.0;

/// CIE L*a*b* of linear light in the primaries of sRGB, by a hundredth: from black to white is a distance of 1, and equal
/// distances look about equally far (CIE 15:2004, white D65). Light below zero counts as none.
pub fn to_lab(rgb: [f32; 3]) -> [f32; 3] {
    let f = |t: f64| if t > DARK { t.cbrt() } else { SLOPE * t.max(0.0) + 4.0 / 29.0 };
    let [x, y, z] = (xyz_of_rgb() * DVec3::from(rgb.map(f64::from)).max(DVec3::ZERO)).to_array().map(f);
    [1.16 * y - 0.16, 5.0 * (x - y), 2.0 * (y - z)].map(|x| x as f32)
}

/// The inverse of [`to_lab`]; what no screen can show comes out as the light nearest to it in each primary.
pub fn from_lab(lab: [f32; 3]) -> [f32; 3] {
    let [l, a, b] = lab.map(f64::from);
    let y = (l + 0.16) / 1.16;
    let inverse = |f: f64| if f > 6.0 / 29.0 { f * f * f } else { (f - 4.0 / 29.0) / SLOPE };
    let xyz = DVec3::new(inverse(y + a / 5.0), inverse(y), inverse(y - b / 2.0));
    (xyz_of_rgb().inverse() * xyz).max(DVec3::ZERO).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_colors_are_where_they_belong() {
        // Lindbloom's calculator, sRGB, D65
        for (rgb, lab) in [
            ([0.0; 3], [0.0; 3]),
            ([1.0; 3], [100.0, 0.0, 0.0]),
            ([1.0, 0.0, 0.0], [53.24, 80.09, 67.20]),
            ([0.0, 1.0, 0.0], [87.73, -86.18, 83.18]),
            ([0.0, 0.0, 1.0], [32.30, 79.19, -107.86]),
        ] {
            let found = to_lab(rgb);
            assert!(found.iter().zip(lab).all(|(x, y)| (x * 100.0 - y).abs() < 0.05), "{rgb:?}: {found:?}");
        }
    }

    proptest! {
        #[test]
        fn there_and_back(rgb in prop::array::uniform3(0.0_f32..1.0)) {
            let back = from_lab(to_lab(rgb));
            prop_assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", back);
        }
    }
}
