//! Finished pixels.

use std::io::Cursor;

use glam::Vec3;
use image::RgbaImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// An image of 8-bit sRGB with straight alpha.
pub(crate) struct Picture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Rows from the top, pixels from the left.
    pub(crate) pixels: Vec<[u8; 4]>,
}

impl Picture {
    /// From colours of a screen (sRGB), 0 to 1.
    pub(crate) fn of(width: u32, height: u32, colours: &[Vec3]) -> Self {
        let pixel = |c: &Vec3| [c.x, c.y, c.z, 1.0].map(|x| (255.0 * x).round() as u8);
        Self { width, height, pixels: colours.iter().map(pixel).collect() }
    }

    /// The bytes of a PNG file.
    pub(crate) fn to_png(&self) -> Vec<u8> {
        let bytes = self.pixels.as_flattened().to_vec();
        let image = RgbaImage::from_raw(self.width, self.height, bytes).expect("there is a pixel for each place");
        let mut png = Cursor::new(Vec::new());
        let opaque = self.pixels.iter().all(|pixel| pixel[3] == 255);
        let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::Adaptive);
        let written = match opaque {
            true => image::DynamicImage::from(image).to_rgb8().write_with_encoder(encoder),
            false => image.write_with_encoder(encoder),
        };
        written.expect("memory takes all bytes");
        png.into_inner()
    }
}
