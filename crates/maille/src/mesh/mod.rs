//! Indexed triangle meshes with wedges and named attributes.

mod attribute;
mod normals;
pub(crate) mod order;
pub mod shapes;
mod tangents;
mod weld;

pub use attribute::{Attribute, ComponentType, Semantic, Storage, Values};
pub use normals::{NormalOptions, NormalWeight, WedgesAdded};
pub use tangents::TangentError;
pub use weld::{WeldOptions, WeldReport};
pub(crate) use weld::{first_equals, mix, random_seed};

/// A triangle mesh as files and GPUs want it: flat arrays, no adjacency.
///
/// ```text
///      vertex: a position            wedge: a vertex and the attributes of
///                                    one smooth sector around it
///          ______                          ______
///         |\    /|                        |\ A  /|      the centre vertex has one position;
///         |  \/  |                        |  \/  |      if A and B differ there in normal or uv,
///         |  /\  |                        |B /\  |      it has two wedges
///         |/____\|                        |/____\|
/// ```
///
/// Triangles refer to wedges, wedges to vertices. A glTF vertex is a wedge. The only invariants are those that
/// [`Mesh::check`] tests: indices in range, array lengths that agree. Anything else (non-manifold edges, degenerate
/// triangles, several components) is allowed; what changes it is a named call.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Position of each vertex, in model units.
    pub positions: Vec<[f32; 3]>,
    /// Vertex of each wedge.
    pub wedge_vertices: Vec<u32>,
    /// The three wedges of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Attributes with one element per wedge: normals, texture coordinates, colours, ...
    pub wedge_attributes: Vec<Attribute>,
    /// Attributes with one element per vertex: what never has a seam.
    pub vertex_attributes: Vec<Attribute>,
    /// Attributes with one element per triangle.
    pub triangle_attributes: Vec<Attribute>,
    /// Material slot of each triangle (an index into [`material_names`](Self::material_names)); empty when all
    /// triangles have slot 0.
    pub triangle_materials: Vec<u32>,
    /// Names of the material slots; may be shorter than the number of slots.
    pub material_names: Vec<String>,
    /// Shapes to blend in, with one element per wedge in each attribute.
    pub morph_targets: Vec<MorphTarget>,
}

/// A blend shape: what to add to the wedges' attributes when it is fully on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MorphTarget {
    /// Its name, empty when it has none.
    pub name: String,
    /// Deltas with one element per wedge; [`Semantic::Position`] deltas are per wedge, too.
    pub attributes: Vec<Attribute>,
}

/// An invariant of [`Mesh`] that does not hold.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// A triangle refers to a wedge that does not exist.
    #[error("triangle {triangle} refers to wedge {wedge}, but there are only {wedges}")]
    WedgeOutOfRange {
        /// Which triangle.
        triangle: usize,
        /// What it refers to.
        wedge: u32,
        /// How many there are.
        wedges: usize,
    },
    /// A wedge refers to a vertex that does not exist.
    #[error("wedge {wedge} refers to vertex {vertex}, but there are only {vertices}")]
    VertexOutOfRange {
        /// Which wedge.
        wedge: usize,
        /// What it refers to.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// An attribute has too many or too few values.
    #[error("attribute '{attribute}' has {found} values where {expected} are expected")]
    WrongLength {
        /// Its name.
        attribute: String,
        /// Number of scalars found.
        found: usize,
        /// Number of scalars expected.
        expected: usize,
    },
    /// More elements than 32-bit indices can name.
    #[error("{count} {what} are more than 32-bit indices can name")]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
    },
    /// A position or an attribute is infinite or not a number.
    #[error("element {element} of '{attribute}' is not finite")]
    NotFinite {
        /// Its name.
        attribute: String,
        /// Which vertex, wedge or triangle.
        element: usize,
    },
}

impl Mesh {
    /// A mesh of positions and triangles over them: one wedge to each vertex, no attributes.
    ///
    /// # Errors
    /// [`MeshError`] if an index is out of range or there are more than 2^32 - 2 positions.
    pub fn from_triangles(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        let vertices = u32::try_from(positions.len()).ok().filter(|&n| n < u32::MAX);
        let vertices = vertices.ok_or(MeshError::TooMany { what: "vertices", count: positions.len() })?;
        let mesh = Self { positions, wedge_vertices: (0..vertices).collect(), triangles, ..Self::default() };
        mesh.check()?;
        Ok(mesh)
    }

    /// Number of vertices (positions).
    pub fn vertex_count(&self) -> usize {
        self.positions.len()
    }

    /// Number of wedges.
    pub fn wedge_count(&self) -> usize {
        self.wedge_vertices.len()
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// The three vertices of a triangle.
    pub fn triangle_vertices(&self, triangle: usize) -> [u32; 3] {
        self.triangles[triangle].map(|wedge| self.wedge_vertices[wedge as usize])
    }

    /// The three corner positions of a triangle, in double precision.
    pub fn triangle_points(&self, triangle: usize) -> [glam::DVec3; 3] {
        self.triangle_vertices(triangle).map(|v| glam::Vec3::from(self.positions[v as usize]).as_dvec3())
    }

    /// Material slot of a triangle.
    pub fn triangle_material(&self, triangle: usize) -> u32 {
        self.triangle_materials.get(triangle).copied().unwrap_or(0)
    }

    /// The wedge attribute of a meaning.
    pub fn wedge_attribute(&self, semantic: &Semantic) -> Option<&Attribute> {
        self.wedge_attributes.iter().find(|a| a.semantic == *semantic)
    }

    /// Puts a wedge attribute in the place of the one with the same meaning, or adds it.
    pub fn set_wedge_attribute(&mut self, attribute: Attribute) {
        match self.wedge_attributes.iter_mut().find(|a| a.semantic == attribute.semantic) {
            Some(place) => *place = attribute,
            None => self.wedge_attributes.push(attribute),
        }
    }

    /// Smallest box around the finite positions, `None` when there are none.
    pub fn bounds(&self) -> Option<([f32; 3], [f32; 3])> {
        let finite = self.positions.iter().filter(|p| p.iter().all(|x| x.is_finite()));
        finite.fold(None, |bounds, p| {
            let (low, high) = bounds.unwrap_or((*p, *p));
            let each = |f: fn(f32, f32) -> f32, a: [f32; 3]| [f(a[0], p[0]), f(a[1], p[1]), f(a[2], p[2])];
            Some((each(f32::min, low), each(f32::max, high)))
        })
    }

    /// Length of the diagonal of [`bounds`](Self::bounds), 0 for an empty mesh.
    pub fn diagonal(&self) -> f64 {
        self.bounds().map_or(0.0, |(low, high)| {
            (0..3).map(|i| (f64::from(high[i]) - f64::from(low[i])).powi(2)).sum::<f64>().sqrt()
        })
    }

    /// Tests the invariants: every index in range, every attribute as long as its elements are many.
    ///
    /// # Errors
    /// The first [`MeshError`] found. Linear in the size of the mesh.
    pub fn check(&self) -> Result<(), MeshError> {
        let (vertices, wedges, triangles) = (self.vertex_count(), self.wedge_count(), self.triangle_count());
        for (what, count) in [("vertices", vertices), ("wedges", wedges), ("corners", triangles.saturating_mul(3))] {
            if count >= u32::MAX as usize {
                return Err(MeshError::TooMany { what, count });
            }
        }
        if let Some((wedge, &vertex)) = self.wedge_vertices.iter().enumerate().find(|&(_, &v)| v as usize >= vertices) {
            return Err(MeshError::VertexOutOfRange { wedge, vertex, vertices });
        }
        let outside = |t: &[u32; 3]| t.iter().find(|&&w| w as usize >= wedges).copied();
        if let Some((triangle, wedge)) =
            self.triangles.iter().enumerate().find_map(|(i, t)| outside(t).map(|wedge| (i, wedge)))
        {
            return Err(MeshError::WedgeOutOfRange { triangle, wedge, wedges });
        }
        let groups = [
            (&self.vertex_attributes, vertices),
            (&self.wedge_attributes, wedges),
            (&self.triangle_attributes, triangles),
        ];
        let morphs = self.morph_targets.iter().map(|target| (&target.attributes, wedges));
        for (attributes, count) in groups.into_iter().chain(morphs) {
            for attribute in attributes {
                check_length(&attribute.semantic.to_string(), attribute.values.len(), count * attribute.components)?;
            }
        }
        if !self.triangle_materials.is_empty() {
            check_length("material", self.triangle_materials.len(), triangles)?;
        }
        Ok(())
    }

    /// Tests that all positions, attributes and morph targets are finite.
    ///
    /// # Errors
    /// [`MeshError::NotFinite`] with the first that is not.
    pub fn check_finite(&self) -> Result<(), MeshError> {
        let fault = |attribute: String, element| Err(MeshError::NotFinite { attribute, element });
        if let Some(vertex) = self.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return fault(Semantic::Position.to_string(), vertex);
        }
        let morphs = self.morph_targets.iter().flat_map(|target| &target.attributes);
        let groups = self.vertex_attributes.iter().chain(&self.wedge_attributes).chain(&self.triangle_attributes);
        for attribute in groups.chain(morphs) {
            if let Some(at) = attribute.as_f32().and_then(|values| values.iter().position(|x| !x.is_finite())) {
                return fault(attribute.semantic.to_string(), at / attribute.components);
            }
        }
        Ok(())
    }

    /// Keeps the triangles that `keep` wants, in their order, and returns how many went.
    pub(crate) fn retain_triangles(&mut self, keep: impl Fn(u32) -> bool) -> usize {
        let (kept, dropped) = survivors(self.triangle_count(), keep);
        if dropped > 0 {
            self.gather_triangles(&kept);
        }
        dropped
    }

    /// Keeps the wedges that `keep` wants, in their order, and returns how many went; no triangle may refer to those.
    pub(crate) fn retain_wedges(&mut self, keep: impl Fn(u32) -> bool) -> usize {
        let (kept, dropped) = survivors(self.wedge_count(), keep);
        if dropped > 0 {
            let renumber = renumbering(self.wedge_count(), &kept);
            self.gather_wedges(&kept);
            self.triangles.as_flattened_mut().iter_mut().for_each(|wedge| *wedge = renumber[*wedge as usize]);
        }
        dropped
    }

    /// Keeps the vertices that `keep` wants, in their order, and returns how many went; no wedge may refer to those.
    pub(crate) fn retain_vertices(&mut self, keep: impl Fn(u32) -> bool) -> usize {
        let (kept, dropped) = survivors(self.vertex_count(), keep);
        if dropped > 0 {
            let renumber = renumbering(self.vertex_count(), &kept);
            self.gather_vertices(&kept);
            self.wedge_vertices.iter_mut().for_each(|vertex| *vertex = renumber[*vertex as usize]);
        }
        dropped
    }

    /// Keeps only the wedges named by `source`, in that order; triangles are not touched.
    pub(crate) fn gather_wedges(&mut self, source: &[u32]) {
        self.wedge_vertices = source.iter().map(|&w| self.wedge_vertices[w as usize]).collect();
        let morphs = self.morph_targets.iter_mut().flat_map(|target| &mut target.attributes);
        for attribute in self.wedge_attributes.iter_mut().chain(morphs) {
            attribute.gather(source);
        }
    }

    /// Puts triangles and wedges in another order, and vertices in the order in which wedges name them.
    ///
    /// `triangles` are the numbers of the triangles in their new order, `corners` their wedges, by the numbers these have now (so
    /// that a triangle may begin with another corner), `wedges` the numbers of the wedges in their new order. What is not named
    /// is left out.
    ///
    /// # Panics
    /// If a number is out of range, there are not three corners to each triangle, or a corner's wedge is left out.
    pub fn reorder(&mut self, triangles: &[u32], corners: &[u32], wedges: &[u32]) {
        assert_eq!(corners.len(), 3 * triangles.len(), "three corners to each triangle");
        let mut new = vec![u32::MAX; self.wedge_count()];
        (0..).zip(wedges).for_each(|(number, &wedge)| new[wedge as usize] = number);
        self.gather_triangles(triangles);
        for (corner, &wedge) in self.triangles.as_flattened_mut().iter_mut().zip(corners) {
            *corner = new[wedge as usize];
            assert_ne!(*corner, u32::MAX, "wedge {wedge} is in use");
        }
        self.gather_wedges(wedges);
        let mut vertices = Vec::new();
        let mut new = vec![u32::MAX; self.vertex_count()];
        for vertex in &mut self.wedge_vertices {
            let number = &mut new[*vertex as usize];
            if *number == u32::MAX {
                *number = vertices.len() as u32;
                vertices.push(*vertex);
            }
            *vertex = *number;
        }
        self.gather_vertices(&vertices);
    }

    /// Keeps only the vertices named by `source`, in that order; wedges are not touched.
    pub(crate) fn gather_vertices(&mut self, source: &[u32]) {
        self.positions = source.iter().map(|&v| self.positions[v as usize]).collect();
        for attribute in &mut self.vertex_attributes {
            attribute.gather(source);
        }
    }

    /// Keeps only the triangles named by `source`, in that order.
    pub(crate) fn gather_triangles(&mut self, source: &[u32]) {
        self.triangles = source.iter().map(|&t| self.triangles[t as usize]).collect();
        if !self.triangle_materials.is_empty() {
            self.triangle_materials = source.iter().map(|&t| self.triangle_materials[t as usize]).collect();
        }
        for attribute in &mut self.triangle_attributes {
            attribute.gather(source);
        }
    }
}

/// The elements to keep, and how many go.
fn survivors(count: usize, keep: impl Fn(u32) -> bool) -> (Vec<u32>, usize) {
    let kept: Vec<u32> = (0..count as u32).filter(|&i| keep(i)).collect();
    let dropped = count - kept.len();
    (kept, dropped)
}

/// New index of each kept element; what is not kept has none that anyone may ask for.
fn renumbering(count: usize, kept: &[u32]) -> Vec<u32> {
    let mut renumber = vec![u32::MAX; count];
    kept.iter().zip(0..).for_each(|(&old, new)| renumber[old as usize] = new);
    renumber
}

fn check_length(attribute: &str, found: usize, expected: usize) -> Result<(), MeshError> {
    if found == expected {
        return Ok(());
    }
    Err(MeshError::WrongLength { attribute: attribute.to_owned(), found, expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_names_the_first_fault() {
        let mut mesh = shapes::tetrahedron();
        mesh.triangles[2][1] = 9;
        assert_eq!(mesh.check(), Err(MeshError::WedgeOutOfRange { triangle: 2, wedge: 9, wedges: 4 }));
        let mut mesh = shapes::tetrahedron();
        mesh.wedge_vertices[3] = 4;
        assert_eq!(mesh.check(), Err(MeshError::VertexOutOfRange { wedge: 3, vertex: 4, vertices: 4 }));
        let mut mesh = shapes::tetrahedron();
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Normal, 3, vec![0.0; 11]));
        assert!(matches!(mesh.check(), Err(MeshError::WrongLength { found: 11, expected: 12, .. })));
    }

    #[test]
    fn bounds_leave_out_what_is_not_finite() {
        let mut mesh = shapes::tetrahedron();
        mesh.positions.push([f32::NAN, 0.0, 0.0]);
        mesh.positions.push([0.0, f32::INFINITY, 0.0]);
        assert_eq!(mesh.bounds(), shapes::tetrahedron().bounds());
        assert_eq!(Mesh::default().bounds(), None);
    }
}
