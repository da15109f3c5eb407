//! Tangents by the MikkTSpace convention.

use bevy_mikktspace::{Geometry, TangentSpace};

use super::normals::WedgesAdded;
use super::weld::{first_equals, mix, random_seed};
use super::{Attribute, Mesh, Semantic};

/// Why there are no tangents.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TangentError {
    /// The mesh lacks an attribute that tangents are made from.
    #[error("tangents need the attribute '{semantic}' with {components} floats per wedge")]
    Missing {
        /// Which.
        semantic: Semantic,
        /// How many components it must have.
        components: usize,
    },
}

impl Mesh {
    /// Computes the tangent of each wedge from normals and a set of texture coordinates, in place of any there are.
    ///
    /// The values are those of MikkTSpace, the convention that normal maps are baked by, for texture coordinates with v
    /// downwards (as in glTF): the bitangent is `cross(normal, tangent.xyz) * tangent.w` and points against v. Wedges
    /// are divided where their triangles have different tangents (mirrored texture); copies go to the end. Where the
    /// texture gives no direction the tangent is any one orthogonal to the normal. Two faults of the reference code,
    /// which sorts some edges wrongly and then depends on the order of corners, are not reproduced.
    ///
    /// Cost: O(n log n), some ten times that of [`compute_normals`](Self::compute_normals).
    ///
    /// # Errors
    /// [`TangentError`] if there are no normals or no such texture coordinates.
    ///
    /// # Panics
    /// If [`check`](Self::check) fails.
    ///
    /// # References
    /// Mikkelsen: Simulation of wrinkled surfaces revisited, 2008; mikktspace.com.
    pub fn compute_tangents(&mut self, uv_set: u32) -> Result<WedgesAdded, TangentError> {
        let tangents = self.corner_tangents(uv_set)?;
        let corner_wedges = self.triangles.as_flattened();
        let bits = |c: u32| tangents[c as usize].map(f32::to_bits);
        let seed = random_seed();
        let hash = |c: u32| {
            let start = mix(seed, corner_wedges[c as usize].into());
            bits(c).iter().fold(start, |hash, &x| mix(hash, x.into()))
        };
        let wedge = |c: u32| corner_wedges[c as usize];
        let first = first_equals(tangents.len(), hash, |a, b| wedge(a) == wedge(b) && bits(a) == bits(b));

        let mut source: Vec<u32> = (0..self.wedge_count() as u32).collect();
        let mut values = vec![[1.0, 0.0, 0.0, 1.0]; self.wedge_count()];
        let mut taken = vec![false; self.wedge_count()];
        for (c, &first) in first.iter().enumerate() {
            let wedge = self.triangles.as_flattened()[c];
            let renamed = if (first as usize) < c {
                self.triangles.as_flattened()[first as usize]
            } else if !std::mem::replace(&mut taken[wedge as usize], true) {
                values[wedge as usize] = tangents[c];
                wedge
            } else {
                source.push(wedge);
                values.push(tangents[c]);
                source.len() as u32 - 1
            };
            self.triangles.as_flattened_mut()[c] = renamed;
        }
        let added = source.len() - self.wedge_count();
        if added > 0 {
            self.gather_wedges(&source);
        }
        let values = values.into_iter().flatten().collect();
        self.set_wedge_attribute(Attribute::new_f32(Semantic::Tangent, 4, values));
        Ok(WedgesAdded(added))
    }

    /// The tangent of each corner.
    fn corner_tangents(&self, uv_set: u32) -> Result<Vec<[f32; 4]>, TangentError> {
        let floats = |semantic: Semantic, components| {
            let found = self.wedge_attribute(&semantic).filter(|a| a.components == components);
            found.and_then(Attribute::as_f32).ok_or(TangentError::Missing { semantic, components })
        };
        let normals = floats(Semantic::Normal, 3)?.as_chunks().0;
        let uvs = floats(Semantic::TexCoord(uv_set), 2)?.as_chunks().0;
        let tangents = vec![[0.0; 4]; 3 * self.triangle_count()];
        let mut surface = Surface { mesh: self, normals, uvs, tangents };
        bevy_mikktspace::generate_tangents(&mut surface).expect("the error has no variants");
        Ok(surface.tangents)
    }
}

/// A mesh as MikkTSpace wants to see it.
struct Surface<'a> {
    mesh: &'a Mesh,
    normals: &'a [[f32; 3]],
    uvs: &'a [[f32; 2]],
    tangents: Vec<[f32; 4]>,
}

impl Surface<'_> {
    fn wedge(&self, face: usize, vert: usize) -> usize {
        self.mesh.triangles[face][vert] as usize
    }
}

/// Puts 0 in the place of what is not finite, which the algorithm was not made for.
fn finite<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|x| if x.is_finite() { x } else { 0.0 })
}

impl Geometry for Surface<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.triangle_count()
    }

    fn num_vertices_of_face(&self, _: usize) -> usize {
        3
    }

    fn position(&self, face: usize, vert: usize) -> [f32; 3] {
        finite(self.mesh.positions[self.mesh.wedge_vertices[self.wedge(face, vert)] as usize])
    }

    fn normal(&self, face: usize, vert: usize) -> [f32; 3] {
        finite(self.normals[self.wedge(face, vert)])
    }

    fn tex_coord(&self, face: usize, vert: usize) -> [f32; 2] {
        finite(self.uvs[self.wedge(face, vert)])
    }

    fn set_tangent(&mut self, space: Option<TangentSpace>, face: usize, vert: usize) {
        let found = space.map(|space| space.tangent_encoded()).filter(|t| glam::Vec4::from(*t).is_finite());
        let found = found.filter(|t| t[..3].iter().any(|&x| x != 0.0));
        self.tangents[3 * face + vert] = match found {
            // MikkTSpace takes v upwards
            Some([x, y, z, w]) => [x, y, z, -w],
            None => {
                let normal = glam::Vec3::from(self.normal(face, vert)).normalize_or(glam::Vec3::Z);
                normal.any_orthonormal_vector().extend(1.0).into()
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{NormalOptions, shapes};
    use crate::zoo::zoo;

    /// Texture coordinates by position.
    fn map(mesh: &mut Mesh, uv: impl Fn([f32; 3]) -> [f32; 2]) {
        let values = mesh.wedge_vertices.iter().flat_map(|&v| uv(mesh.positions[v as usize])).collect();
        mesh.set_wedge_attribute(Attribute::new_f32(Semantic::TexCoord(0), 2, values));
    }

    fn tangents(mesh: &Mesh) -> &[[f32; 4]] {
        mesh.wedge_attribute(&Semantic::Tangent).unwrap().as_f32().unwrap().as_chunks().0
    }

    #[test]
    fn tangents_follow_u_and_bitangents_go_against_v() {
        let mut mesh = shapes::grid(3);
        mesh.compute_normals(&NormalOptions::default());
        map(&mut mesh, |p| [p[0], 1.0 - p[1]]);
        assert_eq!(mesh.compute_tangents(0), Ok(WedgesAdded(0)));
        assert!(tangents(&mesh).iter().all(|t| *t == [1.0, 0.0, 0.0, 1.0]));
        map(&mut mesh, |p| [p[1], 1.0 - p[0]]);
        mesh.compute_tangents(0).unwrap();
        assert!(tangents(&mesh).iter().all(|t| *t == [0.0, 1.0, 0.0, -1.0]));
    }

    #[test]
    fn a_mirrored_texture_divides_the_wedges_on_its_axis() {
        let mut mesh = shapes::grid(4);
        mesh.compute_normals(&NormalOptions::default());
        map(&mut mesh, |p| [(p[0] - 0.5).abs(), 1.0 - p[1]]);
        assert_eq!(mesh.compute_tangents(0), Ok(WedgesAdded(5)));
        assert_eq!((mesh.check(), mesh.wedge_count(), mesh.vertex_count()), (Ok(()), 30, 25));
        for t in 0..mesh.triangle_count() {
            let left = mesh.triangle_points(t).iter().sum::<glam::DVec3>().x < 1.5;
            let expected = if left { [-1.0, 0.0, 0.0, -1.0] } else { [1.0, 0.0, 0.0, 1.0] };
            assert!(mesh.triangles[t].iter().all(|&w| tangents(&mesh)[w as usize] == expected));
        }
    }

    #[test]
    fn tangents_are_unit_and_orthogonal_to_the_normals_whatever_the_mesh() {
        for specimen in zoo() {
            for (broken, flat) in [(false, false), (true, false), (false, true)] {
                let mut mesh = specimen.mesh.clone();
                mesh.compute_normals(&NormalOptions { crease_angle: Some(0.5), ..NormalOptions::default() });
                map(&mut mesh, |p| if flat { [0.5; 2] } else { [p[0] + p[2], p[1]] });
                if let (true, Some(p)) = (broken, mesh.positions.first_mut()) {
                    p[0] = f32::NAN;
                }
                mesh.compute_tangents(0).unwrap();
                assert_eq!(mesh.check(), Ok(()));
                let normals = mesh.wedge_attribute(&Semantic::Normal).unwrap().as_f32().unwrap().as_chunks::<3>().0;
                for &w in mesh.triangles.as_flattened() {
                    let (t, n) = (glam::Vec4::from(tangents(&mesh)[w as usize]), glam::Vec3::from(normals[w as usize]));
                    let ok = (t.truncate().length() - 1.0).abs() < 1e-4 && t.truncate().dot(n).abs() < 1e-4;
                    assert!(ok && t.w.abs() == 1.0, "{} {t} {n}", specimen.name);
                }
            }
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        let mut mesh = shapes::grid(1);
        let missing = |semantic, components| Err(TangentError::Missing { semantic, components });
        assert_eq!(mesh.compute_tangents(0), missing(Semantic::Normal, 3));
        mesh.compute_normals(&NormalOptions::default());
        assert_eq!(mesh.compute_tangents(2), missing(Semantic::TexCoord(2), 2));
    }
}
