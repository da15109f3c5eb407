//! Figures of one surface: size, connectivity, and how well shaped its triangles are.

use super::chunks::{map_chunks, sum};
use super::triangle::scaled_normal;
use crate::Mesh;
use crate::topology::UnionFind;
use crate::topology::edges::{for_each_edge, is_degenerate, next};
use glam::DVec3;

/// Triangles whose smallest angle is below this count as bad: interpolation and further collapses suffer from them.
/// Chosen by convention (finite elements ask for 20 to 30 degrees, display for less).
pub const BAD_ANGLE_DEG: f64 = 10.0;

/// What can be said of a surface without another one.
///
/// Triangles with a repeated vertex count in [`triangles`](Self::triangles) and [`quality`](Self::quality) alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// Vertices that a triangle uses.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// See [`area`].
    pub area: f64,
    /// See [`volume`].
    pub volume: f64,
    /// Sets of triangles that hang together by common edges.
    pub components: u32,
    /// See [`euler_characteristic`].
    pub euler_characteristic: i64,
    /// Edges with one triangle.
    pub boundary_edges: u32,
    /// See [`boundary_length`].
    pub boundary_length: f64,
    /// Edges with more than two triangles.
    pub non_manifold_edges: u32,
    /// Shape of the triangles.
    pub quality: Quality,
}

impl Figures {
    /// All figures of a mesh whose indices are in range.
    ///
    /// Cost: linear but for sorting the edges around each vertex; 40 bytes per triangle for a while.
    pub fn of(mesh: &Mesh) -> Self {
        let connectivity = Connectivity::of(mesh);
        Self {
            vertices: connectivity.vertices,
            triangles: mesh.triangle_count() as u32,
            area: area(mesh),
            volume: volume(mesh),
            components: connectivity.components,
            euler_characteristic: connectivity.euler_characteristic(),
            boundary_edges: connectivity.boundary_edges,
            boundary_length: connectivity.boundary_length,
            non_manifold_edges: connectivity.non_manifold_edges,
            quality: Quality::of(mesh),
        }
    }
}

/// Sum of the triangles' areas, in squared model units. Triangles with a corner that is not finite are left out.
pub fn area(mesh: &Mesh) -> f64 {
    sum(mesh.triangle_count(), |t| if_finite(0.5 * scaled_normal(mesh.triangle_points(t)).length()))
}

fn if_finite(x: f64) -> f64 {
    if x.is_finite() { x } else { 0.0 }
}

/// Volume inside a closed surface, in cubic model units; negative when its triangles face inwards.
///
/// For an open surface: the volume between it and the middle of its bounding box, which is only good for comparing.
/// Triangles with a corner that is not finite are left out.
pub fn volume(mesh: &Mesh) -> f64 {
    // from the middle, so that a mesh far from the origin does not lose its volume to rounding
    let middle = mesh.bounds().map_or(DVec3::ZERO, |(low, high)| {
        (glam::Vec3::from(low).as_dvec3() + glam::Vec3::from(high).as_dvec3()) * 0.5
    });
    sum(mesh.triangle_count(), |t| {
        let [a, b, c] = mesh.triangle_points(t).map(|p| p - middle);
        if_finite(a.dot(b.cross(c)) / 6.0)
    })
}

/// Length of all edges with a single triangle, in model units.
pub fn boundary_length(mesh: &Mesh) -> f64 {
    Connectivity::of(mesh).boundary_length
}

/// Vertices minus edges plus faces: 2 for a sphere, 0 for a torus, 1 for a disc, and the sum over the components.
///
/// Edges lie between vertices, so seams do not count as boundaries; triangles with a repeated vertex are left out.
pub fn euler_characteristic(mesh: &Mesh) -> i64 {
    Connectivity::of(mesh).euler_characteristic()
}

/// Shape of the triangles of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Smallest angle of all, in degrees.
    pub min_angle_deg: f64,
    /// Mean over the triangles of each one's smallest angle, in degrees; 60 at best.
    pub mean_angle_deg: f64,
    /// Mean over the triangles of 4 sqrt(3) area / (sum of squared edges): 1 for equilateral ones, 0 for
    /// degenerate ones.
    pub mean_shape: f64,
    /// Mean of longest edge over shortest altitude, times sqrt(3)/2 (1 for equilateral ones), over the triangles that
    /// have an area.
    pub mean_aspect: f64,
    /// Share of triangles with an angle below [`BAD_ANGLE_DEG`].
    pub bad_share: f64,
    /// Triangles without area.
    pub degenerate: u32,
}

impl Quality {
    /// Measures all triangles; all zero for a mesh without any.
    pub fn of(mesh: &Mesh) -> Self {
        let count = mesh.triangle_count();
        let parts = map_chunks(count, |range| {
            range.fold(ShapeSums::default(), |sums, t| sums.with(Shape::of(mesh.triangle_points(t))))
        });
        let sums = parts.into_iter().fold(ShapeSums::default(), ShapeSums::plus);
        let mean = |sum: f64, count: u32| if count > 0 { sum / f64::from(count) } else { 0.0 };
        let triangles = count as u32;
        Self {
            min_angle_deg: if count > 0 { sums.min_angle.to_degrees() } else { 0.0 },
            mean_angle_deg: mean(sums.angle, triangles).to_degrees(),
            mean_shape: mean(sums.equilaterality, triangles),
            mean_aspect: mean(sums.aspect, triangles - sums.degenerate),
            bad_share: mean(f64::from(sums.bad), triangles),
            degenerate: sums.degenerate,
        }
    }
}

/// The smallest angle of each triangle, in degrees: 60 for equilateral ones, 0 for those without area.
pub fn smallest_angles_deg(mesh: &Mesh) -> Vec<f32> {
    let angle = |t: usize| Shape::of(mesh.triangle_points(t)).min_angle.to_degrees() as f32;
    map_chunks(mesh.triangle_count(), |range| range.map(angle).collect::<Vec<f32>>()).concat()
}

/// How well shaped one triangle is.
#[derive(Clone, Copy)]
struct Shape {
    /// Smallest angle, in radians.
    min_angle: f64,
    equilaterality: f64,
    /// `None` without area.
    aspect: Option<f64>,
}

impl Shape {
    fn of(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let double_area = scaled_normal(corners).length();
        let lengths_sq = [(b - c).length_squared(), (c - a).length_squared(), (a - b).length_squared()];
        let [short_sq, middle_sq, long_sq] = sorted(lengths_sq);
        let has_area = double_area > 0.0 && double_area.is_finite();
        // the smallest angle lies between the two longer edges
        let cosine_part = 0.5 * (middle_sq + long_sq - short_sq);
        Self {
            min_angle: if has_area { double_area.atan2(cosine_part) } else { 0.0 },
            equilaterality: if has_area { 12f64.sqrt() * double_area / lengths_sq.iter().sum::<f64>() } else { 0.0 },
            aspect: has_area.then(|| 0.75f64.sqrt() * long_sq / double_area),
        }
    }
}

fn sorted(mut values: [f64; 3]) -> [f64; 3] {
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// Sums over triangles.
#[derive(Clone, Copy)]
struct ShapeSums {
    min_angle: f64,
    angle: f64,
    equilaterality: f64,
    aspect: f64,
    bad: u32,
    degenerate: u32,
}

impl Default for ShapeSums {
    fn default() -> Self {
        Self { min_angle: f64::INFINITY, angle: 0.0, equilaterality: 0.0, aspect: 0.0, bad: 0, degenerate: 0 }
    }
}

impl ShapeSums {
    fn with(self, shape: Shape) -> Self {
        self.plus(Self {
            min_angle: shape.min_angle,
            angle: shape.min_angle,
            equilaterality: shape.equilaterality,
            aspect: shape.aspect.unwrap_or(0.0),
            bad: u32::from(shape.min_angle < BAD_ANGLE_DEG.to_radians()),
            degenerate: u32::from(shape.aspect.is_none()),
        })
    }

    fn plus(self, other: Self) -> Self {
        Self {
            min_angle: self.min_angle.min(other.min_angle),
            angle: self.angle + other.angle,
            equilaterality: self.equilaterality + other.equilaterality,
            aspect: self.aspect + other.aspect,
            bad: self.bad + other.bad,
            degenerate: self.degenerate + other.degenerate,
        }
    }
}

/// What the edges of a mesh tell, triangles with a repeated vertex left out.
#[derive(Default)]
struct Connectivity {
    vertices: u32,
    edges: u32,
    triangles: u32,
    components: u32,
    boundary_edges: u32,
    boundary_length: f64,
    non_manifold_edges: u32,
}

impl Connectivity {
    fn of(mesh: &Mesh) -> Self {
        let faces: Vec<[u32; 3]> =
            (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).filter(|face| !is_degenerate(face)).collect();
        let corners = faces.as_flattened();
        let point = |corner: u32| glam::Vec3::from(mesh.positions[corners[corner as usize] as usize]).as_dvec3();
        let mut sets = UnionFind::new(faces.len());
        let triangles = faces.len() as u32;
        let mut found = Self { triangles, components: triangles, ..Self::default() };
        for_each_edge(&faces, mesh.vertex_count(), |_, sides| {
            found.edges += 1;
            match sides {
                [side] => {
                    found.boundary_edges += 1;
                    found.boundary_length += if_finite(point(*side).distance(point(next(*side))));
                }
                [_, _] => {}
                _ => found.non_manifold_edges += 1,
            }
            for pair in sides.windows(2) {
                found.components -= u32::from(sets.union(pair[0] / 3, pair[1] / 3));
            }
        });
        let mut is_used = vec![false; mesh.vertex_count()];
        corners.iter().for_each(|&v| is_used[v as usize] = true);
        found.vertices = is_used.iter().filter(|&&used| used).count() as u32;
        found
    }

    fn euler_characteristic(&self) -> i64 {
        i64::from(self.vertices) - i64::from(self.edges) + i64::from(self.triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn cube_in_closed_form() {
        let figures = Figures::of(&shapes::cube());
        assert_eq!((figures.vertices, figures.triangles, figures.components), (8, 12, 1));
        assert_eq!((figures.area, figures.volume), (24.0, 8.0));
        assert_eq!((figures.euler_characteristic, figures.boundary_edges, figures.boundary_length), (2, 0, 0.0));
        assert_eq!(figures.non_manifold_edges, 0);
        let quality = figures.quality;
        assert!((quality.min_angle_deg - 45.0).abs() < 1e-12 && (quality.mean_angle_deg - 45.0).abs() < 1e-12);
        assert!((quality.mean_shape - 0.75f64.sqrt()).abs() < 1e-12);
        assert!((quality.mean_aspect - 3f64.sqrt()).abs() < 1e-12);
        assert_eq!((quality.bad_share, quality.degenerate), (0.0, 0));
    }

    #[test]
    fn quality_summarises_the_smallest_angles() {
        let mesh = shapes::torus(3.0, 1.0, 40, 7);
        let (angles, quality) = (smallest_angles_deg(&mesh), Quality::of(&mesh));
        let mean = angles.iter().map(|&angle| f64::from(angle)).sum::<f64>() / angles.len() as f64;
        assert!((mean - quality.mean_angle_deg).abs() < 1e-4);
        assert!((f64::from(angles.iter().copied().fold(60.0, f32::min)) - quality.min_angle_deg).abs() < 1e-4);
    }

    #[test]
    fn equilateral_triangles_are_best() {
        let quality = Quality::of(&shapes::tetrahedron());
        for (found, best) in [(quality.min_angle_deg, 60.0), (quality.mean_shape, 1.0), (quality.mean_aspect, 1.0)] {
            assert!((found - best).abs() < 1e-12);
        }
    }

    #[test]
    fn round_shapes_approach_their_closed_forms() {
        let sphere = Figures::of(&shapes::sphere(6));
        assert!((sphere.area / (4.0 * PI) - 1.0).abs() < 1e-3);
        assert!((sphere.volume / (4.0 / 3.0 * PI) - 1.0).abs() < 1e-3);
        let torus = Figures::of(&shapes::torus(3.0, 1.0, 300, 100));
        assert!((torus.area / (TAU * TAU * 3.0) - 1.0).abs() < 1e-3);
        assert!((torus.volume / (TAU * PI * 3.0) - 1.0).abs() < 1e-2);
        assert_eq!((sphere.euler_characteristic, torus.euler_characteristic), (2, 0));
    }

    #[test]
    fn volume_has_a_sign_and_no_place() {
        let mut mesh = shapes::sphere(3);
        let there = volume(&mesh);
        for triangle in &mut mesh.triangles {
            triangle.swap(0, 1);
        }
        assert!((volume(&mesh) + there).abs() < 1e-12);
        let mut far = shapes::cube();
        far.positions.iter_mut().for_each(|p| *p = p.map(|x| x + 1e6));
        assert!((volume(&far) - 8.0).abs() < 1e-9);
    }

    #[test]
    fn connectivity_of_good_and_bad_meshes() {
        for specimen in crate::zoo::zoo() {
            let figures = Figures::of(&specimen.mesh);
            let found = (figures.euler_characteristic, figures.components, figures.boundary_edges);
            assert_eq!(found, (specimen.euler, specimen.components, specimen.boundary_edges), "{}", specimen.name);
            assert_eq!(figures.non_manifold_edges, specimen.non_manifold_edges, "{}", specimen.name);
        }
    }

    #[test]
    fn open_grid_has_its_outline_as_boundary() {
        let figures = Figures::of(&shapes::grid(7));
        assert_eq!((figures.boundary_edges, figures.euler_characteristic, figures.components), (28, 1, 1));
        assert!((figures.boundary_length - 4.0).abs() < 1e-6);
        assert!((boundary_length(&shapes::grid(3)) - 4.0).abs() < 1e-6);
    }

    #[test]
    fn what_is_broken_is_counted() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [9.0; 3]];
        let fan = vec![[0, 1, 2], [0, 1, 3], [0, 1, 4], [2, 2, 2]];
        let figures = Figures::of(&Mesh::from_triangles(positions, fan).expect("indices are in range"));
        assert_eq!((figures.vertices, figures.components, figures.non_manifold_edges), (5, 1, 1));
        assert_eq!((figures.boundary_edges, figures.euler_characteristic, figures.quality.degenerate), (6, 1, 1));
        assert_eq!(figures.quality.min_angle_deg, 0.0);
        let mut broken = shapes::cube();
        broken.positions[0] = [f32::NAN; 3];
        let figures = Figures::of(&broken);
        assert!(figures.area > 0.0 && figures.area < 24.0 && figures.quality.mean_shape.is_finite());
    }

    #[test]
    fn empty_mesh_has_no_figures() {
        let figures = Figures::of(&Mesh::default());
        assert_eq!((figures.area, figures.volume, figures.components, figures.quality.mean_shape), (0.0, 0.0, 0, 0.0));
    }
}
