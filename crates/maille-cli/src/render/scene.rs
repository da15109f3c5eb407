//! What is drawn: triangles in a world of radius 1 around the origin, y up.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat3, DVec3, Vec2, Vec3};
use maille::lod::MorphedMesh;
use maille::mesh::NormalOptions;
use maille::{Attribute, Mesh, Semantic};
use maille_io::{Asset, Instance};

use super::colour;

/// Edges bent by more than this are drawn sharp where a file has no normals, in radians.
const CREASE: f64 = 0.7;

/// From the units of a file to those of the renderer. Several scenes in one frame are drawn at the same size and place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    center: DVec3,
    scale: f64,
    z_up: bool,
}

/// Triangles to draw.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) points: Vec<Vec3>,
    pub(crate) normals: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Height of the ground.
    pub(crate) ground: f32,
    /// Linear; empty: none.
    colours: Vec<Vec3>,
    uvs: Vec<Vec2>,
    /// Of each instance its number of points, and the set of texture coordinates that it is drawn with.
    parts: Vec<(usize, u32)>,
    /// Surface of each triangle.
    surfaces: Vec<u32>,
    palette: Vec<Surface>,
}

/// What a triangle is covered with.
#[derive(Clone)]
struct Surface {
    /// Linear.
    colour: Vec3,
    /// Decoded images are shared.
    image: Option<Arc<Image>>,
    offset: Vec2,
    scale: Vec2,
}

/// An image, and the same at half the size, and so on down to one pixel.
struct Image {
    levels: Vec<Pixels>,
}

/// Linear colours, rows from the top.
struct Pixels {
    width: usize,
    height: usize,
    colours: Vec<Vec3>,
}

impl Frame {
    /// A frame that fits an asset.
    pub(crate) fn around(asset: &Asset, z_up: bool) -> Self {
        let bounds = asset.merged_positions().bounds().unwrap_or_default();
        let [low, high] = [bounds.0, bounds.1].map(|corner| Vec3::from(corner).as_dvec3());
        let radius = (high - low).length() / 2.0;
        let scale = if radius > 0.0 { 1.0 / radius } else { 1.0 };
        Self { center: (low + high) / 2.0, scale, z_up }
    }

    /// The length of a world unit in scenes.
    pub(crate) fn scale(&self) -> f64 {
        self.scale
    }

    fn point(&self, p: DVec3) -> Vec3 {
        self.direction((p - self.center) * self.scale)
    }

    fn direction(&self, d: DVec3) -> Vec3 {
        let d = d.as_vec3();
        if self.z_up { Vec3::new(d.x, d.z, -d.y) } else { d }
    }
}

impl Scene {
    /// Everything that an asset draws, posed at rest.
    pub(crate) fn new(asset: &Asset, frame: &Frame) -> Self {
        let mut scene = Self {
            points: Vec::new(),
            normals: Vec::new(),
            triangles: Vec::new(),
            ground: 0.0,
            colours: Vec::new(),
            uvs: Vec::new(),
            parts: Vec::new(),
            surfaces: Vec::new(),
            palette: Vec::new(),
        };
        let meshes: Vec<Cow<'_, Mesh>> = asset.meshes.iter().map(|named| with_normals(&named.mesh)).collect();
        let coloured = meshes.iter().any(|mesh| colours(mesh).is_some());
        let mut wardrobe = Wardrobe::new(asset, coloured);
        for instance in &asset.instances {
            scene.add(instance, &meshes[instance.mesh], frame, coloured, &mut wardrobe);
        }
        scene.palette = wardrobe.palette;
        scene.ground = scene.points.iter().map(|p| p.y).filter(|y| y.is_finite()).fold(f32::INFINITY, f32::min);
        scene
    }

    fn add(&mut self, instance: &Instance, mesh: &Mesh, frame: &Frame, coloured: bool, wardrobe: &mut Wardrobe<'_>) {
        let first = self.points.len() as u32;
        let normals = mesh.wedge_attribute(&Semantic::Normal).and_then(|a| a.as_f32()).unwrap_or_default();
        for (wedge, normal) in normals.chunks_exact(3).enumerate() {
            self.points.push(frame.point(instance.posed_wedge(mesh, wedge)));
            let linear = DMat3::from_mat4(instance.wedge_matrix(mesh, wedge));
            let normal = turned(linear, Vec3::from_slice(normal).as_dvec3());
            self.normals.push(frame.direction(normal.normalize_or_zero()));
        }
        self.triangles.extend(mesh.triangles.iter().map(|t| t.map(|w| first + w)));
        if coloured {
            self.colours.extend(colours(mesh).unwrap_or_else(|| vec![Vec3::ONE; mesh.wedge_count()]));
        }
        let slots = mesh.triangle_materials.iter().max().map_or(1, |&slot| slot + 1);
        let surfaces: Vec<(u32, u32)> = (0..slots).map(|slot| wardrobe.surface(instance.mesh, slot)).collect();
        // a mesh whose slots use several sets of coordinates is drawn with the first textured one's
        let set = surfaces.iter().map(|surface| surface.1).find(|&set| set != NO_SET).unwrap_or(0);
        let uvs = mesh.wedge_attribute(&Semantic::TexCoord(set)).and_then(|a| a.as_f32());
        match uvs {
            Some(uvs) => self.uvs.extend(uvs.chunks_exact(2).map(Vec2::from_slice)),
            None => self.uvs.extend(std::iter::repeat_n(Vec2::ZERO, mesh.wedge_count())),
        }
        self.parts.push((mesh.wedge_count(), set));
        let surface = |t: usize| surfaces[mesh.triangle_material(t) as usize].0;
        self.surfaces.extend((0..mesh.triangle_count()).map(surface));
    }

    /// Takes the positions, normals, colours and texture coordinates of a mesh in world units whose wedges are those of all
    /// instances, one after the other: [`Asset::flattened`], on its way to another level.
    pub(crate) fn set(&mut self, mesh: &MorphedMesh, frame: &Frame) {
        let floats = |semantic| mesh.attribute(&semantic).and_then(Attribute::as_f32);
        self.points = mesh.positions.iter().map(|&p| frame.point(Vec3::from(p).as_dvec3())).collect();
        if let Some(normals) = floats(Semantic::Normal) {
            let normal = |n: &[f32]| frame.direction(Vec3::from_slice(n).as_dvec3());
            self.normals = normals.chunks_exact(3).map(normal).collect();
        }
        if let Some(colours) = mesh.attribute(&Semantic::Color(0)).filter(|_| !self.colours.is_empty()) {
            self.colours = decoded(colours).unwrap_or_default();
        }
        let mut first = 0;
        for &(points, set) in &self.parts {
            if let Some(uvs) = floats(Semantic::TexCoord(set)) {
                let own = uvs[2 * first..].chunks_exact(2).map(Vec2::from_slice);
                self.uvs[first..first + points].iter_mut().zip(own).for_each(|(uv, own)| *uv = own);
            }
            first += points;
        }
    }

    /// Whether colours or textures tell parts of it from others.
    pub(crate) fn has_colours(&self) -> bool {
        let mut looks = self.palette.iter().map(|surface| surface.colour);
        let first = looks.next();
        !self.colours.is_empty()
            || self.palette.iter().any(|surface| surface.image.is_some())
            || looks.any(|colour| Some(colour) != first)
    }

    /// Colour of a triangle at a point given by barycentric weights, linear.
    pub(crate) fn albedo(&self, triangle: usize, weights: Vec3) -> Vec3 {
        let (plain, surface) = self.plain_albedo(triangle, weights);
        match &surface.image {
            Some(image) => plain * image.levels[0].colour_at(surface.place(self.uv(triangle, weights))),
            None => plain,
        }
    }

    /// The same over the area of a pixel: the weights are those of the point and of the two that are a pixel away, to the
    /// right and below.
    pub(crate) fn filtered_albedo(&self, triangle: usize, weights: [Vec3; 3]) -> Vec3 {
        let (plain, surface) = self.plain_albedo(triangle, weights[0]);
        match &surface.image {
            Some(image) => plain * image.filtered(weights.map(|weights| surface.place(self.uv(triangle, weights)))),
            None => plain,
        }
    }

    /// Colour without the texture, and what covers the triangle.
    fn plain_albedo(&self, triangle: usize, weights: Vec3) -> (Vec3, &Surface) {
        let surface = &self.palette[self.surfaces[triangle] as usize];
        if self.colours.is_empty() {
            return (surface.colour, surface);
        }
        let ids = self.triangles[triangle];
        (surface.colour * (0..3).map(|i| weights[i] * self.colours[ids[i] as usize]).sum::<Vec3>(), surface)
    }

    fn uv(&self, triangle: usize, weights: Vec3) -> Vec2 {
        let ids = self.triangles[triangle];
        (0..3).map(|i| weights[i] * self.uvs[ids[i] as usize]).sum()
    }
}

impl Surface {
    /// Place in the image of texture coordinates.
    fn place(&self, uv: Vec2) -> Vec2 {
        self.offset + self.scale * uv
    }
}

/// No texture, so no set of coordinates.
const NO_SET: u32 = u32::MAX;

/// The surfaces of an asset, each made once.
struct Wardrobe<'a> {
    asset: &'a Asset,
    coloured: bool,
    palette: Vec<Surface>,
    images: BTreeMap<usize, Option<Arc<Image>>>,
    known: BTreeMap<(usize, u32), (u32, u32)>,
}

impl<'a> Wardrobe<'a> {
    fn new(asset: &'a Asset, coloured: bool) -> Self {
        Self { asset, coloured, palette: Vec::new(), images: BTreeMap::new(), known: BTreeMap::new() }
    }

    /// Index of the surface of a slot, and the set of texture coordinates it uses.
    fn surface(&mut self, mesh: usize, slot: u32) -> (u32, u32) {
        if let Some(&known) = self.known.get(&(mesh, slot)) {
            return known;
        }
        let plain = if self.coloured { Vec3::ONE } else { super::shade::CLAY };
        let mut surface = Surface { colour: plain, image: None, offset: Vec2::ZERO, scale: Vec2::ONE };
        let mut set = NO_SET;
        if let Some(look) = self.asset.look(mesh, slot) {
            let tint = Vec3::from_slice(&look.base_color[..3]).clamp(Vec3::ZERO, Vec3::ONE);
            // what is pure white and bare would only glare
            let bare = look.texture.is_none() && !self.coloured && tint == Vec3::ONE;
            surface.colour = if bare { plain } else { tint };
            if let Some(texture) = look.texture {
                surface.image =
                    self.images.entry(texture.image).or_insert_with(|| Image::decode(&texture.bytes)).clone();
                (surface.offset, surface.scale) = (texture.offset.into(), texture.scale.into());
                set = texture.set;
            }
        }
        self.palette.push(surface);
        let entry = (self.palette.len() as u32 - 1, set);
        self.known.insert((mesh, slot), entry);
        entry
    }
}

impl Image {
    /// Pixels along the longer side: more than a picture shows.
    const MOST: u32 = 1024;

    /// `None` for what is no PNG or JPEG.
    fn decode(bytes: &[u8]) -> Option<Arc<Self>> {
        let image = image::load_from_memory(bytes).ok()?;
        let longest = image.width().max(image.height());
        let image = if longest > Self::MOST { image.thumbnail(Self::MOST, Self::MOST) } else { image };
        let image = image.to_rgb8();
        let to_linear: Vec<f32> = (0..256).map(|byte| colour::linear(Vec3::splat(byte as f32 / 255.0)).x).collect();
        let colours = image.pixels().map(|p| Vec3::from_array(p.0.map(|byte| to_linear[usize::from(byte)]))).collect();
        let first = Pixels { width: image.width() as usize, height: image.height() as usize, colours };
        Some(Arc::new(Self { levels: std::iter::successors(Some(first), Pixels::halved).collect() }))
    }

    /// The mean over about the area that three places span, the last two a pixel of the picture away from the first: of the two
    /// nearest sizes, as graphics cards do (trilinear filtering).
    fn filtered(&self, [at, right, below]: [Vec2; 3]) -> Vec3 {
        let first = &self.levels[0];
        let size = Vec2::new(first.width as f32, first.height as f32);
        let span = ((right - at) * size).length().max(((below - at) * size).length());
        let last = self.levels.len() - 1;
        let level = if span.is_finite() { span.max(1.0).log2().min(last as f32) } else { last as f32 };
        let finer = level as usize;
        let colour = self.levels[finer].colour_at(at);
        match level - finer as f32 {
            0.0 => colour,
            share => colour.lerp(self.levels[finer + 1].colour_at(at), share),
        }
    }
}

impl Pixels {
    /// The image at half the size; `None` for a single pixel.
    fn halved(&self) -> Option<Self> {
        if self.width * self.height <= 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let pixel = |i: usize| {
            let (x, y) = (i % width * 2, i / width * 2);
            let at = |dx: usize, dy: usize| {
                self.colours[(y + dy).min(self.height - 1) * self.width + (x + dx).min(self.width - 1)]
            };
            (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0
        };
        Some(Self { width, height, colours: (0..width * height).map(pixel).collect() })
    }

    /// Blends the four pixels around a place; the image repeats.
    fn colour_at(&self, uv: Vec2) -> Vec3 {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let place = (uv - uv.floor()) * size - 0.5;
        let (low, part) = (place.floor(), place - place.floor());
        if !low.is_finite() {
            return Vec3::ONE;
        }
        let pixel = |dx: i64, dy: i64| {
            let column = (low.x as i64 + dx).rem_euclid(self.width as i64) as usize;
            let row = (low.y as i64 + dy).rem_euclid(self.height as i64) as usize;
            self.colours[row * self.width + column]
        };
        let upper = pixel(0, 0).lerp(pixel(1, 0), part.x);
        upper.lerp(pixel(0, 1).lerp(pixel(1, 1), part.x), part.y)
    }
}

/// A normal under a linear map: the cofactor matrix keeps it perpendicular to the surface, mirrored or not.
fn turned(linear: DMat3, normal: DVec3) -> DVec3 {
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * normal
}

/// The mesh with normals: its own, or smooth ones with creases.
pub(crate) fn with_normals(mesh: &Mesh) -> Cow<'_, Mesh> {
    if mesh.wedge_attribute(&Semantic::Normal).is_some_and(|a| a.as_f32().is_some() && a.components == 3) {
        return Cow::Borrowed(mesh);
    }
    let mut mesh = mesh.clone();
    mesh.compute_normals(&NormalOptions { crease_angle: Some(CREASE), ..NormalOptions::default() });
    Cow::Owned(mesh)
}

/// Linear colour of each wedge, where the mesh has colours.
fn colours(mesh: &Mesh) -> Option<Vec<Vec3>> {
    let is_colour = |a: &&Attribute| a.semantic == Semantic::Color(0) && a.components >= 3;
    let own = mesh.wedge_attributes.iter().find(is_colour);
    let colours = decoded(own.or_else(|| mesh.vertex_attributes.iter().find(is_colour))?)?;
    match own {
        Some(_) => Some(colours),
        None => Some(mesh.wedge_vertices.iter().map(|&v| colours[v as usize]).collect()),
    }
}

/// Linear colours of an attribute of floats.
fn decoded(attribute: &Attribute) -> Option<Vec<Vec3>> {
    let decode = |c: &[f32]| {
        let c = Vec3::from_slice(c).clamp(Vec3::ZERO, Vec3::ONE);
        if attribute.storage.srgb { colour::linear(c) } else { c }
    };
    Some(attribute.as_f32()?.chunks_exact(attribute.components).map(decode).collect())
}
