//! What is drawn: triangles in a world of radius 1 around the origin, y up.

use glam::{DMat3, DVec3, Vec3};
use maille::{Mesh, Semantic};
use maille_io::Asset;

use super::colour;

/// From the units of a file to those of the renderer. Several scenes in one frame are drawn at the same size and place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    center: DVec3,
    scale: f64,
    z_up: bool,
}

/// Triangles to draw.
pub(crate) struct Scene {
    pub(crate) points: Vec<Vec3>,
    pub(crate) normals: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Height of the ground.
    pub(crate) ground: f32,
    /// Linear; empty: none.
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
        let mut scene =
            Self { points: Vec::new(), normals: Vec::new(), triangles: Vec::new(), ground: 0.0, colours: Vec::new() };
        let coloured = asset.meshes.iter().any(|named| colours(&named.mesh).is_some());
        for instance in &asset.instances {
            let mesh = &asset.meshes[instance.mesh].mesh;
            let first = scene.points.len() as u32;
            let normals = normals(mesh);
            for (wedge, normal) in normals.iter().enumerate() {
                scene.points.push(frame.point(instance.posed_wedge(mesh, wedge)));
                let linear = DMat3::from_mat4(instance.wedge_matrix(mesh, wedge));
                let normal = turned(linear, normal.as_dvec3());
                scene.normals.push(frame.direction(normal.normalize_or_zero()));
            }
            scene.triangles.extend(mesh.triangles.iter().map(|t| t.map(|w| first + w)));
            if coloured {
                let own = colours(mesh).unwrap_or_else(|| vec![Vec3::ONE; mesh.wedge_count()]);
                scene.colours.extend(own);
            }
        }
        scene.ground = scene.points.iter().map(|p| p.y).filter(|y| y.is_finite()).fold(f32::INFINITY, f32::min);
        scene
    }

    /// Colour of a triangle at a point given by barycentric weights, linear.
    pub(crate) fn albedo(&self, triangle: usize, weights: Vec3) -> Vec3 {
        let ids = self.triangles[triangle];
        if self.colours.is_empty() {
            return super::shade::CLAY;
        }
        (0..3).map(|i| weights[i] * self.colours[ids[i] as usize]).sum()
    }
}

/// A normal under a linear map: the cofactor matrix keeps it perpendicular to the surface, mirrored or not.
fn turned(linear: DMat3, normal: DVec3) -> DVec3 {
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * normal
}

/// Normal of each wedge: the mesh's own, or smooth ones.
fn normals(mesh: &Mesh) -> Vec<Vec3> {
    if let Some(own) = mesh.wedge_attribute(&Semantic::Normal).and_then(|a| a.as_f32()) {
        return own.chunks_exact(3).map(Vec3::from_slice).collect();
    }
    let mut sums = vec![DVec3::ZERO; mesh.vertex_count()];
    for triangle in 0..mesh.triangle_count() {
        let [a, b, c] = mesh.triangle_points(triangle);
        let area = (b - a).cross(c - a);
        mesh.triangle_vertices(triangle).into_iter().for_each(|v| sums[v as usize] += area);
    }
    mesh.wedge_vertices.iter().map(|&v| sums[v as usize].normalize_or_zero().as_vec3()).collect()
}

/// Linear colour of each wedge, where the mesh has colours.
fn colours(mesh: &Mesh) -> Option<Vec<Vec3>> {
    let is_colour = |a: &&maille::Attribute| a.semantic == Semantic::Color(0) && a.components >= 3;
    let own = mesh.wedge_attributes.iter().find(is_colour);
    let attribute = own.or_else(|| mesh.vertex_attributes.iter().find(is_colour))?;
    let values = attribute.as_f32()?;
    let decode = |c: &[f32]| {
        let c = Vec3::from_slice(c).clamp(Vec3::ZERO, Vec3::ONE);
        if attribute.storage.srgb { colour::linear(c) } else { c }
    };
    let colours: Vec<Vec3> = values.chunks_exact(attribute.components).map(decode).collect();
    match own {
        Some(_) => Some(colours),
        None => Some(mesh.wedge_vertices.iter().map(|&v| colours[v as usize]).collect()),
    }
}
