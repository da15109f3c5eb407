//! Colours between the curve of screens (sRGB: PLY, OBJ, OFF, STL) and linear light (glTF).

use maille::color::{to_linear, to_srgb};

/// Colours of `components` scalars, brought onto the sRGB curve or into linear light; alpha stays.
pub(crate) fn recoded(values: &[f32], components: usize, srgb: bool) -> Vec<f32> {
    let convert = if srgb { to_srgb } else { to_linear };
    let recode = |(i, &value): (usize, &f32)| if i % components < 3 { convert(value) } else { value };
    values.iter().enumerate().map(recode).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_bytes_survive_the_way_through_linear_light() {
        for byte in 0..=255_u8 {
            let linear = to_linear(f32::from(byte) / 255.0);
            assert_eq!((to_srgb(linear) * 255.0).round() as u8, byte);
        }
        assert_eq!((to_linear(1.0), to_srgb(1.0)), (1.0, 1.0));
        assert_eq!(recoded(&[1.0, 0.0, 1.0, 0.5], 4, false), [1.0, 0.0, 1.0, 0.5]);
    }
}
