//! The last step of every reader: what no computation can use is taken out, and said.

use maille::Mesh;
use maille::mesh::{Attribute, Values};

use crate::{Asset, ReadError};

/// Makes an asset of one mesh after taking out what is not finite.
///
/// Vertices at infinity or nowhere go, with their triangles; attribute values that are no numbers become 0.
pub(crate) fn settled(name: &str, mut mesh: Mesh, mut warnings: Vec<String>) -> Result<Asset, ReadError> {
    let had_triangles = !mesh.triangles.is_empty();
    let dropped = drop_non_finite_vertices(&mut mesh);
    if dropped.0 > 0 {
        warnings.push(format!(
            "{} vertices have coordinates that are not finite: they were left out, and with them {} triangles",
            dropped.0, dropped.1
        ));
        if had_triangles && mesh.triangles.is_empty() {
            let error = ReadError::new("every triangle has a corner whose coordinates are not finite");
            return Err(error.with_remedy("export the model again"));
        }
    }
    for attribute in mesh.wedge_attributes.iter_mut().chain(&mut mesh.triangle_attributes) {
        let zeroed = zero_non_finite(attribute);
        if zeroed > 0 {
            warnings.push(format!("{zeroed} values of '{}' are not finite and were set to 0", attribute.semantic));
        }
    }
    mesh.check().map_err(|e| ReadError::new(e.to_string()))?;
    let mut asset = Asset::from_mesh(name, mesh);
    asset.warnings = warnings;
    Ok(asset)
}

/// Returns how many vertices and triangles went.
fn drop_non_finite_vertices(mesh: &mut Mesh) -> (usize, usize) {
    let finite: Vec<bool> = mesh.positions.iter().map(|p| p.iter().all(|x| x.is_finite())).collect();
    let bad = finite.iter().filter(|&&ok| !ok).count();
    if bad == 0 {
        return (0, 0);
    }
    let before = mesh.triangles.len();
    let (kept_vertices, new_vertices) = kept(finite.iter().copied());
    mesh.positions = kept_vertices.iter().map(|&v| mesh.positions[v as usize]).collect();
    mesh.vertex_attributes.iter_mut().for_each(|a| a.gather(&kept_vertices));

    let wedge_finite: Vec<bool> = mesh.wedge_vertices.iter().map(|&v| finite[v as usize]).collect();
    let (kept_wedges, new_wedges) = kept(wedge_finite.iter().copied());
    mesh.wedge_vertices = kept_wedges.iter().map(|&w| new_vertices[mesh.wedge_vertices[w as usize] as usize]).collect();
    mesh.wedge_attributes.iter_mut().for_each(|a| a.gather(&kept_wedges));

    let (kept_triangles, _) = kept(mesh.triangles.iter().map(|t| t.iter().all(|&w| wedge_finite[w as usize])));
    let renumbered = |&t: &u32| mesh.triangles[t as usize].map(|w| new_wedges[w as usize]);
    mesh.triangles = kept_triangles.iter().map(renumbered).collect();
    if !mesh.triangle_materials.is_empty() {
        mesh.triangle_materials = kept_triangles.iter().map(|&t| mesh.triangle_materials[t as usize]).collect();
    }
    mesh.triangle_attributes.iter_mut().for_each(|a| a.gather(&kept_triangles));
    (bad, before - mesh.triangles.len())
}

/// The indices of what is kept, and the new index of each old one (meaningless for those that go).
fn kept(keep: impl Iterator<Item = bool>) -> (Vec<u32>, Vec<u32>) {
    let (mut old, mut new) = (Vec::new(), Vec::new());
    for (index, keep) in keep.enumerate() {
        new.push(old.len() as u32);
        if keep {
            old.push(index as u32);
        }
    }
    (old, new)
}

fn zero_non_finite(attribute: &mut Attribute) -> usize {
    let Values::F32(values) = &mut attribute.values else { return 0 };
    let mut count = 0;
    for value in values.iter_mut().filter(|value| !value.is_finite()) {
        *value = 0.0;
        count += 1;
    }
    count
}

/// Follows how far coordinates move when they are rounded to single precision.
#[derive(Default, Clone, Copy)]
pub(crate) struct Rounding {
    largest: f64,
}

/// Rounding to be told about, as a share of the diagonal.
const TELL_ROUNDING: f64 = 2e-6;

impl Rounding {
    /// Rounds a coordinate.
    pub(crate) fn round(&mut self, value: f64) -> f32 {
        let rounded = value as f32;
        let moved = (value - f64::from(rounded)).abs();
        // comparison is false for what is not finite
        if moved > self.largest && moved < f64::INFINITY {
            self.largest = moved;
        }
        rounded
    }

    /// Joins what two parts of a file have seen.
    pub(crate) fn join(self, other: Self) -> Self {
        Self { largest: self.largest.max(other.largest) }
    }

    /// A warning where the loss could be seen.
    pub(crate) fn warning(self, mesh: &Mesh) -> Option<String> {
        let diagonal = mesh.diagonal();
        let share = self.largest / diagonal;
        (diagonal > 0.0 && share > TELL_ROUNDING).then(|| {
            format!(
                "coordinates are kept in single precision and moved by up to {:.3e} ({:.2e} of the diagonal): \
                 the model lies far from its origin; move it there before",
                self.largest, share
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use maille::Semantic;
    use maille::mesh::shapes;

    #[test]
    fn what_is_not_finite_goes_and_is_told() {
        let mut mesh = shapes::tetrahedron();
        mesh.positions.push([f32::NAN, 0.0, 0.0]);
        mesh.positions.push([7.0, 0.0, 0.0]);
        mesh.wedge_vertices.extend([4, 5]);
        mesh.triangles.insert(1, [0, 1, 4]);
        mesh.triangle_materials = vec![0, 9, 1, 2, 3];
        let mut ids: Vec<f32> = (0..6).map(|i| i as f32).collect();
        ids[2] = f32::INFINITY;
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Custom("id".into()), 1, ids));
        let asset = settled("", mesh, vec![]).unwrap();
        let mesh = &asset.meshes[0].mesh;
        assert_eq!(mesh.triangles, shapes::tetrahedron().triangles);
        assert_eq!(mesh.triangle_materials, [0, 1, 2, 3]);
        assert_eq!(mesh.positions[4], [7.0, 0.0, 0.0]);
        assert_eq!(mesh.wedge_attributes[0].as_f32().unwrap(), [0.0, 1.0, 0.0, 3.0, 5.0]);
        assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
    }

    #[test]
    fn a_mesh_of_nothing_finite_is_refused() {
        let mut mesh = shapes::tetrahedron();
        mesh.positions.iter_mut().for_each(|p| p[1] = f32::NAN);
        assert!(settled("", mesh, vec![]).is_err());
    }

    #[test]
    fn rounding_is_told_where_the_model_is_far_from_the_origin() {
        let mut near = Rounding::default();
        let mut far = Rounding::default();
        let mut mesh = shapes::tetrahedron();
        near.round(0.1);
        assert_eq!(near.warning(&mesh), None);
        mesh.positions.iter_mut().for_each(|p| p[0] = far.round(f64::from(p[0]) * 0.1 + 4_000_000.0));
        assert!(far.warning(&mesh).is_some());
    }
}
