//! Colours: sRGB and linear light.

use glam::Vec3;

/// Linear light of an sRGB-encoded colour.
pub(crate) fn linear(srgb: Vec3) -> Vec3 {
    let decode = |c: f32| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    Vec3::new(decode(srgb.x), decode(srgb.y), decode(srgb.z))
}

/// sRGB encoding of linear light, 0 to 1.
pub(crate) fn encoded(linear: Vec3) -> Vec3 {
    let encode = |c: f32| if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    let c = linear.clamp(Vec3::ZERO, Vec3::ONE);
    Vec3::new(encode(c.x), encode(c.y), encode(c.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_is_the_inverse_of_decoding() {
        for x in [0.0, 0.002, 0.04, 0.2, 0.5, 1.0] {
            let c = Vec3::new(x, 1.0 - x, 0.3);
            assert!(encoded(linear(c)).abs_diff_eq(c, 1e-5));
        }
    }
}
