//! How a material looks, as far as a simple picture needs it.

use serde_json::Value;

use super::container::{decode_data_uri, relative_path};
use super::json::{extension, index, numbers, required_index, text};
use super::{Checked, Document};
use crate::look::{Look, Texture};

/// Largest image file that is looked at, in bytes.
const MOST_BYTES: u64 = 1 << 28;

impl Document {
    /// The look of a material slot (a primitive) of a mesh. What cannot be read is left out: it is not needed for
    /// anything but pictures.
    pub(crate) fn look(&self, mesh: usize, slot: usize) -> Look {
        let primitive = self.list("meshes").get(mesh).and_then(|mesh| mesh.get("primitives")?.get(slot));
        let number = primitive.and_then(|primitive| index(primitive, "material").ok().flatten());
        let Some(material) = number.and_then(|number| self.list("materials").get(number)) else {
            return Look::default();
        };
        let Some(surface) = material.get("pbrMetallicRoughness") else { return Look::default() };
        let factor = numbers::<4>(surface, "baseColorFactor").ok().flatten().unwrap_or([1.0; 4]);
        let texture = surface.get("baseColorTexture").and_then(|info| self.texture(info).ok());
        Look { base_color: factor.map(|x| x as f32), texture }
    }

    fn texture(&self, info: &Value) -> Checked<Texture> {
        let mut set = index(info, "texCoord")?.unwrap_or(0);
        let (mut offset, mut scale) = ([0.0; 2], [1.0; 2]);
        if let Some(transform) = extension(info, "KHR_texture_transform") {
            offset = numbers(transform, "offset")?.unwrap_or(offset);
            scale = numbers(transform, "scale")?.unwrap_or(scale);
            set = index(transform, "texCoord")?.unwrap_or(set);
        }
        let missing = || super::json::Fault::new("there is no such texture");
        let texture = self.list("textures").get(required_index(info, "index")?).ok_or_else(missing)?;
        let image = required_index(texture, "source")?;
        Ok(Texture {
            image,
            bytes: self.image(self.list("images").get(image).ok_or_else(missing)?)?,
            set: set as u32,
            offset: offset.map(|x| x as f32),
            scale: scale.map(|x| x as f32),
        })
    }

    /// The bytes of an image file.
    fn image(&self, image: &Value) -> Checked<Vec<u8>> {
        let uri = text(image, "uri");
        if uri.is_empty() {
            return Ok(self.view(required_index(image, "bufferView")?)?.0.to_vec());
        }
        if uri.starts_with("data:") {
            return decode_data_uri(uri);
        }
        let unreadable = |error: std::io::Error| super::json::Fault::new(error.to_string());
        let path = self.folder.as_deref().unwrap_or(std::path::Path::new(".")).join(relative_path(uri)?);
        if std::fs::metadata(&path).map_err(unreadable)?.len() > MOST_BYTES {
            return Err(super::json::Fault::new("the image is too large"));
        }
        std::fs::read(path).map_err(unreadable)
    }
}
