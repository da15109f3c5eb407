//! Attributes and images that say what is to be kept where.

use std::sync::Arc;

use maille::simplify::SimplifyOptions;
use maille::{Attribute, Mesh, Semantic};

use crate::Asset;
use crate::process::ProcessError;

/// Factor on the cost of collapses where an importance colour or image is white; where it is black, the factor is 1.
const WHITE_IMPORTANCE: f32 = 100.0;

/// What attributes of an asset mean for its simplification.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AttributeRoles {
    /// Factors on what single attributes count in the metric, by the names that the file gives them ([`find_attribute`]).
    pub weights: Vec<(String, f64)>,
    /// Refuse collapses after which the texture has slipped by more than so many texels of the base colour texture, by the
    /// estimate of the metric (`SimplifyOptions::max_texture_error`, which is set from it mesh by mesh).
    pub max_texel_error: Option<f64>,
    /// Factor on the cost of collapses: the first component of an attribute; of a colour or image, the brightness from black
    /// (1) to white (100).
    pub importance: Option<Mask>,
    /// Vertices stay where this is above one half.
    pub lock: Option<Mask>,
    /// Vertices stay where this is not above one half.
    pub region: Option<Mask>,
}

/// A number for each point of a surface.
#[derive(Debug, Clone, PartialEq)]
pub enum Mask {
    /// The first component of an attribute, by the name that the file gives it ([`find_attribute`]).
    Attribute(String),
    /// An image over the first texture coordinates.
    Image(Arc<MaskImage>),
}

/// A grey image, repeated over the plane of texture coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskImage {
    width: usize,
    values: Vec<f32>,
}

impl MaskImage {
    /// An image of rows of `width` pixels from 0 (black) to 1 (white), the topmost row first: that of texture coordinates from
    /// v = 0 on, as glTF has it. `None` if there is no pixel or the last row is not full.
    pub fn new(width: usize, values: Vec<f32>) -> Option<Self> {
        let is_whole = !values.is_empty() && width > 0 && values.len().is_multiple_of(width);
        is_whole.then_some(Self { width, values })
    }

    /// The pixel at texture coordinates.
    fn at(&self, [u, v]: [f32; 2]) -> f32 {
        let pixel = |x: f32, count: usize| ((x.rem_euclid(1.0) * count as f32) as usize).min(count - 1);
        let row = pixel(v, self.values.len() / self.width);
        self.values[row * self.width + pixel(u, self.width)]
    }
}

impl AttributeRoles {
    /// Refuses names that no mesh has, and what needs textures where there are none.
    pub(crate) fn check(&self, asset: &Asset) -> Result<(), ProcessError> {
        for (name, _) in &self.weights {
            require_attribute(asset, name)?;
        }
        for mask in self.importance.iter().chain(&self.lock).chain(&self.region) {
            match mask {
                Mask::Attribute(name) => require_attribute(asset, name)?,
                Mask::Image(_) => require_attribute(asset, "TEXCOORD_0")?,
            }
        }
        let has_texture = || (0..asset.meshes.len()).any(|mesh| texels_per_unit(asset, mesh).is_some());
        if self.max_texel_error.is_some() && !has_texture() {
            return Err(ProcessError::NoTexture);
        }
        Ok(())
    }

    /// Texels to a unit of the texture coordinates of a mesh, if that matters.
    pub(crate) fn texels(&self, asset: &Asset, mesh: usize) -> Option<f64> {
        self.max_texel_error.and_then(|_| texels_per_unit(asset, mesh))
    }

    /// Adds to the options of a mesh what its attributes mean.
    pub(crate) fn apply(&self, mesh: &Mesh, texels: Option<f64>, options: &mut SimplifyOptions) {
        options.importance = self.importance_of(mesh);
        options.locked = self.locked(mesh);
        for (name, factor) in &self.weights {
            if let Some(attribute) = find_attribute(mesh, name) {
                options.attributes.named.push((attribute.semantic.clone(), *factor));
            }
        }
        if let (Some(most), Some(texels)) = (self.max_texel_error, texels) {
            options.max_texture_error = Some(most / texels);
        }
    }

    fn importance_of(&self, mesh: &Mesh) -> Vec<f32> {
        let bright = |brightness: f32| 1.0 + (WHITE_IMPORTANCE - 1.0) * brightness.clamp(0.0, 1.0);
        let attribute = match &self.importance {
            Some(Mask::Attribute(name)) => find_attribute(mesh, name),
            _ => None,
        };
        let is_colour = attribute.is_none_or(|attribute| matches!(attribute.semantic, Semantic::Color(_)));
        let values = self.importance.as_ref().map(|mask| mask.over(mesh, f32::max)).unwrap_or_default();
        values.into_iter().map(|x| if is_colour { bright(x) } else { x.max(0.0) }).collect()
    }

    /// The vertices that stay; empty if none has to.
    pub(crate) fn locked(&self, mesh: &Mesh) -> Vec<bool> {
        let over = |mask: &Option<Mask>, join| mask.as_ref().map(|mask| mask.over(mesh, join)).unwrap_or_default();
        let mut locked: Vec<bool> = over(&self.lock, f32::max).iter().map(|&x| x > 0.5).collect();
        let region = over(&self.region, f32::min);
        if !region.is_empty() {
            locked.resize(region.len(), false);
            locked.iter_mut().zip(&region).for_each(|(locked, &x)| *locked |= x <= 0.5);
        }
        locked
    }
}

impl Mask {
    /// The number at each vertex of a mesh, of its wedges as `join` has it; empty if the mesh lacks the attribute. Of a colour,
    /// the brightness counts.
    fn over(&self, mesh: &Mesh, join: fn(f32, f32) -> f32) -> Vec<f32> {
        let numbers_of = |attribute: &Attribute, number: &dyn Fn(&[f32]) -> f32| -> Vec<f32> {
            let values = attribute.as_f32().expect("find_attribute gives float attributes only");
            values.chunks_exact(attribute.components).map(number).collect()
        };
        let (numbers, is_of_vertices) = match self {
            Self::Attribute(name) => {
                let Some(attribute) = find_attribute(mesh, name) else { return Vec::new() };
                let is_colour = matches!(attribute.semantic, Semantic::Color(_));
                let brightness = |rgb: &[f32]| rgb.iter().take(3).sum::<f32>() / rgb.len().min(3) as f32;
                let number: &dyn Fn(&[f32]) -> f32 = if is_colour { &brightness } else { &|value| value[0] };
                let is_of_vertices = mesh.vertex_attributes.iter().any(|own| std::ptr::eq(own, attribute));
                (numbers_of(attribute, number), is_of_vertices)
            }
            Self::Image(image) => {
                let Some(attribute) = find_attribute(mesh, "TEXCOORD_0") else { return Vec::new() };
                (numbers_of(attribute, &|uv| image.at([uv[0], uv[1]])), false)
            }
        };
        if is_of_vertices {
            return numbers;
        }
        let mut joined = vec![f32::NAN; mesh.vertex_count()];
        for (&vertex, number) in mesh.wedge_vertices.iter().zip(numbers) {
            let place = &mut joined[vertex as usize];
            *place = join(*place, number); // NaN gives way
        }
        joined.iter().map(|&x| if x.is_finite() { x } else { 1.0 }).collect()
    }
}

/// The float attribute of a mesh that a name means, of wedges or vertices: the name that the mesh itself uses
/// (`color 0`, `quality`) or that of glTF (`COLOR_0`, `_IMPORTANCE`), whatever the case.
pub fn find_attribute<'a>(mesh: &'a Mesh, name: &str) -> Option<&'a Attribute> {
    let attributes = mesh.wedge_attributes.iter().chain(&mesh.vertex_attributes);
    attributes.filter(|a| a.as_f32().is_some()).find(|a| {
        let own = a.semantic.to_string();
        own.eq_ignore_ascii_case(name) || a.semantic.gltf_name().eq_ignore_ascii_case(name)
    })
}

fn require_attribute(asset: &Asset, name: &str) -> Result<(), ProcessError> {
    let meshes = || asset.meshes.iter().map(|m| &m.mesh);
    if meshes().any(|mesh| find_attribute(mesh, name).is_some()) {
        return Ok(());
    }
    let floats = meshes().flat_map(|m| m.wedge_attributes.iter().chain(&m.vertex_attributes));
    let mut known: Vec<String> = floats.filter(|a| a.as_f32().is_some()).map(|a| a.semantic.to_string()).collect();
    known.sort();
    known.dedup();
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    Err(ProcessError::NoAttribute { name: name.to_owned(), known })
}

/// Texels to a unit of texture coordinates, by the largest texture on a mesh; `None` without one that can be read.
fn texels_per_unit(asset: &Asset, mesh: usize) -> Option<f64> {
    let slots = asset.meshes[mesh].mesh.triangle_materials.iter().copied().max().unwrap_or(0);
    let texture = |slot| asset.look(mesh, slot)?.texture;
    let texels = (0..=slots).filter_map(texture).filter_map(|texture| {
        let size = imagesize::blob_size(&texture.bytes).ok()?;
        let [u, v] = texture.scale.map(|scale| f64::from(scale.abs()));
        Some((size.width as f64 * u).max(size.height as f64 * v))
    });
    texels.filter(|texels| *texels > 0.0).max_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat sheet whose texture coordinates are its places.
    fn sheet() -> Mesh {
        let mut mesh = maille::mesh::shapes::grid(8);
        let uv = mesh.wedge_vertices.iter().flat_map(|&v| mesh.positions[v as usize][..2].to_vec()).collect();
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::TexCoord(0), 2, uv));
        mesh
    }

    #[test]
    fn images_are_looked_up_by_texture_coordinates() {
        let image = MaskImage::new(2, vec![0.0, 1.0, 0.25, 0.5]).expect("two rows of two");
        let at = |u, v| image.at([u, v]);
        assert_eq!([at(0.1, 0.1), at(0.9, 0.1), at(0.1, 0.9), at(0.9, 0.9)], [0.0, 1.0, 0.25, 0.5]);
        assert_eq!([at(-0.1, 0.1), at(1.1, 2.9)], [1.0, 0.25], "repeated");
        assert!(at(f32::NAN, f32::INFINITY).is_finite());
        assert_eq!(MaskImage::new(2, vec![0.0; 3]), None);
        assert_eq!(MaskImage::new(0, Vec::new()), None);
    }

    #[test]
    fn a_region_locks_what_is_outside() {
        let mesh = sheet();
        let right = Arc::new(MaskImage::new(2, vec![0.0, 1.0]).expect("a row of two"));
        let roles = AttributeRoles { region: Some(Mask::Image(right.clone())), ..AttributeRoles::default() };
        let is_right = |p: &[f32; 3]| p[0].rem_euclid(1.0) >= 0.5;
        let outside: Vec<bool> = mesh.positions.iter().map(|p| !is_right(p)).collect();
        assert!(outside.contains(&true) && outside.contains(&false));
        assert_eq!(roles.locked(&mesh), outside);
        let all = AttributeRoles { lock: Some(Mask::Image(right)), ..roles };
        assert!(all.locked(&mesh).iter().all(|&locked| locked));
    }

    #[test]
    fn attributes_are_found_by_their_own_and_by_gltf_names() {
        let mut mesh = maille::mesh::shapes::cube();
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Color(0), 3, vec![0.5; 24]));
        mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("quality".into()), 1, vec![2.0; 8]));
        assert!(find_attribute(&mesh, "COLOR_0").is_some() && find_attribute(&mesh, "Color 0").is_some());
        assert!(find_attribute(&mesh, "color").is_none());
        let importance = |name: &str| {
            let mask = Some(Mask::Attribute(name.to_owned()));
            AttributeRoles { importance: mask, ..AttributeRoles::default() }.importance_of(&mesh)
        };
        assert_eq!(importance("quality"), [2.0; 8]);
        assert_eq!(importance("COLOR_0"), [50.5; 8], "half way from 1 to 100");
        assert!(importance("_IMPORTANCE").is_empty());
    }
}
