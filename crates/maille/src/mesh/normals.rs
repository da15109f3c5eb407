//! Normals computed from the triangles.

use glam::DVec3;

use super::{Attribute, Mesh, Semantic};
use crate::topology::UnionFind;
use crate::topology::edges::{deal, next, prev};

/// How much each triangle counts in the normal of its corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NormalWeight {
    /// By its angle there: the result does not depend on how a face is cut into triangles.
    #[default]
    Angle,
    /// By its area.
    Area,
}

/// How [`Mesh::compute_normals`] works.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NormalOptions {
    /// How much each triangle counts.
    pub weight: NormalWeight,
    /// Edges bent by more than this angle (between the normals of their triangles, in radians) stay sharp: the wedges
    /// on both sides get normals of their own. `None` makes everything smooth.
    pub crease_angle: Option<f64>,
}

/// Wedges that had to be divided, because their triangles got different values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WedgesAdded(pub usize);

impl Mesh {
    /// Computes the normal of each wedge from the triangles at its vertex, in place of any there are.
    ///
    /// Smooth across seams of other attributes, sharp where a crease angle says so: there, wedges are divided (copies go
    /// to the end), never merged. Sharp is decided edge by edge: triangles of a vertex that are joined by a chain of soft
    /// edges share a normal. Triangles without area count for nothing and take the normal of a neighbour. Where nothing
    /// gives a direction the normal is +z; no normal is ever NaN.
    ///
    /// Tangents and morphed normals, if there are any, stay as they are and may no longer fit.
    ///
    /// Cost: linear; with a crease angle, some 20 bytes per triangle for a while.
    ///
    /// # Panics
    /// If [`check`](Self::check) fails.
    ///
    /// # References
    /// Thürmer and Wüthrich: Computing vertex normals from polygonal facets, JGT 3(1), 1998 (angle weights).
    ///
    /// # Examples
    /// ```
    /// use maille::mesh::{NormalOptions, Semantic, shapes};
    /// let mut cube = shapes::cube();
    /// let sharp = NormalOptions { crease_angle: Some(0.5), ..Default::default() };
    /// assert_eq!(cube.compute_normals(&sharp).0, 16);
    /// assert_eq!(cube.wedge_attribute(&Semantic::Normal).unwrap().len(), 24);
    /// ```
    pub fn compute_normals(&mut self, options: &NormalOptions) -> WedgesAdded {
        let (normals, added) = match options.crease_angle {
            None => (self.smooth_normals(options.weight), 0),
            Some(angle) => self.creased_normals(options.weight, angle),
        };
        let values = normals.into_iter().flatten().collect();
        self.set_wedge_attribute(Attribute::new_f32(Semantic::Normal, 3, values));
        WedgesAdded(added)
    }

    /// One normal per vertex, given to all its wedges.
    fn smooth_normals(&self, weight: NormalWeight) -> Vec<[f32; 3]> {
        let mut sums = vec![DVec3::ZERO; self.vertex_count()];
        for t in 0..self.triangle_count() {
            for (i, v) in self.triangle_vertices(t).into_iter().enumerate() {
                sums[v as usize] += weighted_normal(&self.triangle_points(t), i, weight);
            }
        }
        // opposite triangles may cancel: the first one that has a direction decides
        if sums.contains(&DVec3::ZERO) {
            for t in 0..self.triangle_count() {
                let normal = unit_normal(&self.triangle_points(t));
                for v in self.triangle_vertices(t).into_iter().filter(|_| normal != DVec3::ZERO) {
                    if sums[v as usize] == DVec3::ZERO {
                        sums[v as usize] = normal;
                    }
                }
            }
        }
        self.wedge_vertices.iter().map(|&v| to_f32(sums[v as usize].normalize_or(DVec3::Z))).collect()
    }

    /// Normals of all wedges, after dividing those that lie on both sides of a crease; and how many were added.
    fn creased_normals(&mut self, weight: NormalWeight, angle: f64) -> (Vec<[f32; 3]>, usize) {
        let corners = self.triangles.as_flattened();
        let vertex = |c: u32| self.wedge_vertices[corners[c as usize] as usize];
        let all = || (0..corners.len() as u32).map(|c| (vertex(c), c));
        let (starts, dealt) = deal(self.vertex_count(), all, |c| c);
        let mut source: Vec<u32> = (0..self.wedge_count() as u32).collect();
        let mut normals = vec![[0.0, 0.0, 1.0]; self.wedge_count()];
        let mut renamed = Vec::new();
        for v in 0..self.vertex_count() {
            let at = &dealt[starts[v] as usize..starts[v + 1] as usize];
            let sectors = self.sectors(v as u32, at, weight, angle);
            // by wedge, then sector: the first sector of a wedge keeps it
            let mut uses: Vec<_> = at.iter().zip(&sectors).map(|(&c, s)| (corners[c as usize], s.number, c)).collect();
            uses.sort_unstable();
            for wedge in uses.chunk_by(|a, b| a.0 == b.0) {
                for (i, sector) in wedge.chunk_by(|a, b| a.1 == b.1).enumerate() {
                    let normal = sectors[sector[0].1 as usize].normal;
                    if i == 0 {
                        normals[sector[0].0 as usize] = normal;
                        continue;
                    }
                    renamed.extend(sector.iter().map(|&(.., c)| (c, source.len() as u32)));
                    source.push(sector[0].0);
                    normals.push(normal);
                }
            }
        }
        let added = source.len() - self.wedge_count();
        if added > 0 {
            renamed.iter().for_each(|&(c, wedge)| self.triangles.as_flattened_mut()[c as usize] = wedge);
            self.gather_wedges(&source);
        }
        (normals, added)
    }

    /// For each of the corners at a vertex its sector: the corners joined by soft edges, named by the first of them.
    fn sectors(&self, vertex: u32, at: &[u32], weight: NormalWeight, angle: f64) -> Vec<Sector> {
        let points = |c: u32| self.triangle_points(c as usize / 3);
        let normals: Vec<DVec3> = at.iter().map(|&c| unit_normal(&points(c))).collect();
        let mut spokes: Vec<(u32, u32)> = Vec::with_capacity(2 * at.len());
        for (i, &c) in (0..).zip(at) {
            let ends =
                [next(c), prev(c)].map(|c| self.wedge_vertices[self.triangles.as_flattened()[c as usize] as usize]);
            spokes.extend(ends.into_iter().filter(|&end| end != vertex).map(|end| (end, i)));
        }
        spokes.sort_unstable();
        let mut sets = join_soft(&spokes, &normals, angle);
        adopt(&spokes, &normals, &mut sets);
        let roots = sets.into_roots();
        let mut sums = vec![DVec3::ZERO; at.len()];
        for (i, &c) in at.iter().enumerate() {
            sums[roots[i] as usize] += weighted_normal(&points(c), c as usize % 3, weight);
        }
        // a sum can only vanish if the sector has no area or turns right back
        let first = |root: u32| (0..at.len()).find(|&i| roots[i] == root && normals[i] != DVec3::ZERO);
        let fallback = |root| first(root).map_or(DVec3::Z, |i| normals[i]);
        let mut result = vec![[0.0; 3]; at.len()];
        for root in (0..at.len() as u32).filter(|&i| roots[i as usize] == i) {
            result[root as usize] = to_f32(sums[root as usize].try_normalize().unwrap_or_else(|| fallback(root)));
        }
        roots.iter().map(|&root| Sector { number: root, normal: result[root as usize] }).collect()
    }
}

/// Corners of a vertex that share a normal.
#[derive(Clone, Copy)]
struct Sector {
    /// Lowest of them, as they are counted at the vertex.
    number: u32,
    normal: [f32; 3],
}

/// Joins corners across edges bent by no more than the angle. `spokes` are the edges at the vertex by their other end,
/// once for each corner beside them.
fn join_soft(spokes: &[(u32, u32)], normals: &[DVec3], angle: f64) -> UnionFind {
    // on an edge of very many triangles each is compared with a few before it only
    const LOOK_BACK: usize = 8;
    // a hair softer, so that an angle given as the edges' own does not hang on rounding
    let soft = angle.clamp(0.0, std::f64::consts::PI).cos() - 1e-9;
    let mut sets = UnionFind::new(normals.len());
    for edge in spokes.chunk_by(|a, b| a.0 == b.0) {
        for (k, &(_, i)) in edge.iter().enumerate() {
            for &(_, j) in &edge[k.saturating_sub(LOOK_BACK)..k] {
                let [a, b] = [i, j].map(|i| normals[i as usize]);
                if a != DVec3::ZERO && b != DVec3::ZERO && a.dot(b) >= soft {
                    sets.union(i, j);
                }
            }
        }
    }
    sets
}

/// Gives corners of triangles without area to the sector of one neighbour, or of any corner that has a direction: one
/// only, so that they do not join the sides of a crease.
fn adopt(spokes: &[(u32, u32)], normals: &[DVec3], sets: &mut UnionFind) {
    let has_direction = |i: u32| normals[i as usize] != DVec3::ZERO;
    let Some(any) = (0..normals.len() as u32).find(|&i| has_direction(i)) else {
        (1..normals.len() as u32).for_each(|i| _ = sets.union(0, i));
        return;
    };
    let mut parent = vec![any; normals.len()];
    for edge in spokes.chunk_by(|a, b| a.0 == b.0) {
        if let Some(&(_, found)) = edge.iter().find(|spoke| has_direction(spoke.1)) {
            edge.iter().for_each(|&(_, i)| parent[i as usize] = found);
        }
    }
    for i in (0..normals.len() as u32).filter(|&i| !has_direction(i)) {
        sets.union(parent[i as usize], i);
    }
}

/// Unit normal of a triangle, zero if it has none.
fn unit_normal([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}

/// Unit normal times the weight at corner `i`, zero if there is none.
fn weighted_normal(points: &[DVec3; 3], i: usize, weight: NormalWeight) -> DVec3 {
    let [at, to, from] = [points[i], points[(i + 1) % 3], points[(i + 2) % 3]];
    let (u, v) = (to - at, from - at);
    let cross = u.cross(v);
    match weight {
        NormalWeight::Area if cross.is_finite() => cross,
        NormalWeight::Area => DVec3::ZERO,
        NormalWeight::Angle => cross.normalize_or_zero() * f64::atan2(cross.length(), u.dot(v)),
    }
}

fn to_f32(normal: DVec3) -> [f32; 3] {
    normal.as_vec3().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{WeldOptions, shapes};
    use crate::zoo::zoo;

    fn normals(mesh: &Mesh) -> Vec<DVec3> {
        let values = mesh.wedge_attribute(&Semantic::Normal).unwrap().as_f32().unwrap();
        values.as_chunks::<3>().0.iter().map(|&n| glam::Vec3::from(n).as_dvec3()).collect()
    }

    fn creased(degrees: f64) -> NormalOptions {
        NormalOptions { crease_angle: Some(degrees.to_radians()), ..NormalOptions::default() }
    }

    #[test]
    fn normals_of_a_sphere_approach_its_positions_as_edges_shorten() {
        for weight in [NormalWeight::Angle, NormalWeight::Area] {
            for crease_angle in [None, Some(1.0)] {
                let error = |levels| {
                    let mut mesh = shapes::sphere(levels);
                    assert_eq!(mesh.compute_normals(&NormalOptions { weight, crease_angle }), WedgesAdded(0));
                    let points = mesh.positions.iter().map(|&p| glam::Vec3::from(p).as_dvec3());
                    normals(&mesh).iter().zip(points).map(|(n, p)| (*n - p).length()).fold(0.0, f64::max)
                };
                let (coarse, fine) = (error(3), error(5));
                // first order where the ring of a vertex is lopsided, as along the edges of the octahedron
                assert!(coarse < 0.05 && fine < coarse / 3.5, "{weight:?}: {coarse} {fine}");
            }
        }
    }

    #[test]
    fn angle_weights_do_not_see_the_diagonals_of_a_cube() {
        let mut mesh = shapes::cube();
        mesh.compute_normals(&NormalOptions::default());
        for (normal, &p) in normals(&mesh).iter().zip(&mesh.positions) {
            assert!((*normal - glam::Vec3::from(p).as_dvec3().normalize()).length() < 1e-6);
        }
    }

    #[test]
    fn creases_divide_wedges_and_keep_the_surface_closed() {
        let mut mesh = shapes::cube();
        mesh.wedge_attributes = vec![Attribute::new_u32(Semantic::Joints(0), 1, (0..8).collect())];
        assert_eq!(mesh.clone().compute_normals(&creased(90.0)), WedgesAdded(0), "90 degrees are not more than 90");
        assert_eq!(mesh.compute_normals(&creased(89.0)), WedgesAdded(16));
        assert_eq!((mesh.check(), mesh.vertex_count()), (Ok(()), 8));
        let joints = mesh.wedge_attributes[0].as_u32().unwrap();
        assert_eq!(joints, mesh.wedge_vertices, "copies carry the other attributes along");
        let normals = normals(&mesh);
        for t in 0..12 {
            let flat = unit_normal(&mesh.triangle_points(t));
            assert!(mesh.triangles[t].iter().all(|&w| (normals[w as usize] - flat).length() < 1e-6));
        }
    }

    #[test]
    fn seams_of_other_attributes_do_not_show() {
        let mut mesh = shapes::torus(2.0, 0.5, 12, 9);
        let mut smooth = mesh.clone();
        smooth.compute_normals(&creased(80.0));
        mesh.unweld();
        mesh.weld(&WeldOptions::EXACT);
        mesh.compute_normals(&creased(80.0));
        let (all, smooth) = (normals(&mesh), normals(&smooth));
        for (w, &v) in mesh.wedge_vertices.iter().enumerate() {
            let at = mesh.positions[v as usize];
            let same = shapes::torus(2.0, 0.5, 12, 9).positions.iter().position(|&p| p == at).unwrap();
            assert!((all[w] - smooth[same]).length() < 1e-6);
        }
    }

    #[test]
    fn a_needle_on_an_edge_does_not_soften_it() {
        // two faces at a right angle with a triangle without area between them
        let positions = vec![[0., 0., 0.], [2., 0., 0.], [1., 1., 0.], [1., 0., 1.], [1., 0., 0.]];
        let triangles = vec![[0, 1, 2], [0, 4, 1], [4, 0, 3], [1, 4, 3]];
        let mut mesh = Mesh::from_triangles(positions, triangles).unwrap();
        mesh.compute_normals(&creased(30.0));
        let normals = normals(&mesh);
        assert!(normals.iter().all(|n| n.x == 0.0 && (n.y == 0.0 || n.z == 0.0) && n.length() == 1.0), "{normals:?}");
    }

    #[test]
    fn every_normal_is_a_unit_vector_whatever_the_mesh() {
        for specimen in zoo() {
            for options in [NormalOptions::default(), creased(30.0)] {
                for broken in [false, true] {
                    let mut mesh = specimen.mesh.clone();
                    if let (true, Some(p)) = (broken, mesh.positions.first_mut()) {
                        p[0] = f32::NAN;
                    }
                    mesh.compute_normals(&options);
                    assert_eq!(mesh.check(), Ok(()));
                    assert!(normals(&mesh).iter().all(|n| (n.length() - 1.0).abs() < 1e-6), "{}", specimen.name);
                }
            }
        }
    }
}
