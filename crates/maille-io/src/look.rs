//! How surfaces look, for pictures.

use crate::Asset;
use crate::asset::Source;

/// The look of a material, as far as a simple picture needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// Colour and opacity, linear, 0 to 1; what a texture or vertex colours give is multiplied with it.
    pub base_color: [f32; 4],
    /// Image laid over the surface.
    pub texture: Option<Texture>,
}

impl Default for Look {
    fn default() -> Self {
        Self { base_color: [1.0; 4], texture: None }
    }
}

/// An image and how it is laid over a surface: at `offset + scale * uv`, repeating, y down, sRGB-encoded.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Which image of the file: textures may share it.
    pub image: usize,
    /// The image file (PNG, JPEG, ...).
    pub bytes: Vec<u8>,
    /// Set of texture coordinates.
    pub set: u32,
    #[expect(missing_docs, reason = "see the type")]
    pub offset: [f32; 2],
    #[expect(missing_docs, reason = "see the type")]
    pub scale: [f32; 2],
}

impl Asset {
    /// The look of a material slot of a mesh; `None` where the file tells nothing of materials.
    pub fn look(&self, mesh: usize, slot: u32) -> Option<Look> {
        match &self.source {
            Source::Gltf(document) => Some(document.look(mesh, slot as usize)),
            _ => None,
        }
    }
}
