//! Building a turned and milled part from outlines at given heights: walls between two outlines, caps within them.
//!
//! Every ring is an edge between exactly two faces, so a part whose rings are each used twice is a closed manifold with
//! exactly flat and exactly cylindrical faces, tessellated as CAD programs do: few long triangles, split normals.

use glam::{DVec2, DVec3};

use super::noise::turn;
use crate::Mesh;
use crate::mesh::{Attribute, Semantic};

/// A closed polyline in a plane y = constant, in coordinates (z, x) so that counter-clockwise is seen from above; the
/// solid is on its left.
#[derive(Debug, Clone, Default)]
pub(super) struct Outline {
    points: Vec<DVec2>,
    /// The outward normal at both ends of the segment that starts at each point.
    normals: Vec<[DVec2; 2]>,
}

impl Outline {
    /// A straight segment from `from` to wherever the next piece starts at `to`.
    pub(super) fn line(&mut self, from: DVec2, to: DVec2) {
        let normal = -(to - from).perp().normalize();
        self.points.push(from);
        self.normals.push([normal; 2]);
    }

    /// An arc of `segments` about `centre`, between two angles given as shares of a turn.
    pub(super) fn arc(&mut self, centre: DVec2, radius: f64, from: f64, to: f64, segments: usize) {
        let sign = (to - from).signum();
        let radial = |i: usize| direction(from + (to - from) * i as f64 / segments as f64);
        for i in 0..segments {
            self.points.push(centre + radius * radial(i));
            self.normals.push([sign * radial(i), sign * radial(i + 1)]);
        }
    }

    /// A smooth curve through points with their outward normals; ends where the next piece starts.
    pub(super) fn curve(&mut self, samples: &[(DVec2, DVec2)]) {
        for pair in samples.windows(2) {
            self.points.push(pair[0].0);
            self.normals.push([pair[0].1, pair[1].1]);
        }
    }

    /// A full circle.
    pub(super) fn circle(centre: DVec2, radius: f64, segments: usize) -> Self {
        let mut circle = Self::default();
        circle.arc(centre, radius, 0.0, 1.0, segments);
        circle
    }

    /// The same curve around a hole: the solid is outside.
    pub(super) fn hole(mut self) -> Self {
        self.points.reverse();
        self.normals.reverse();
        // segment i now runs from the end of the old one to its start
        self.normals.rotate_left(1);
        for normals in &mut self.normals {
            *normals = [-normals[1], -normals[0]];
        }
        self
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }
}

/// The unit vector at a share of a turn.
pub(super) fn direction(share: f64) -> DVec2 {
    let (cos, sin) = turn(share);
    DVec2::new(cos, sin)
}

/// An outline at a height.
#[derive(Debug, Clone)]
struct Ring {
    outline: Outline,
    y: f64,
}

/// Names a ring of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RingId(usize);

#[derive(Debug)]
enum Face {
    /// Between two rings of equally many points, in so many rows of quads.
    Wall { low: RingId, high: RingId, rows: usize },
    /// Within the first ring, without the others.
    Cap { rings: Vec<RingId>, up: bool },
}

/// Rings and the faces between them.
#[derive(Debug, Default)]
pub(super) struct Part {
    rings: Vec<Ring>,
    faces: Vec<Face>,
    /// Rows of quads per metre of a wall's height.
    rows_per_metre: f64,
}

impl Part {
    pub(super) fn new(rows_per_metre: f64) -> Self {
        Self { rows_per_metre, ..Self::default() }
    }

    pub(super) fn ring(&mut self, outline: Outline, y: f64) -> RingId {
        self.rings.push(Ring { outline, y });
        RingId(self.rings.len() - 1)
    }

    /// A wall from a ring up (or, inside out, down) to another one: the solid is on the left of both.
    pub(super) fn wall(&mut self, low: RingId, high: RingId) {
        let [a, b] = [low, high].map(|id| &self.rings[id.0]);
        assert_eq!(a.outline.len(), b.outline.len(), "a wall joins point to point");
        let rows = ((b.y - a.y).abs() * self.rows_per_metre).round().max(1.0) as usize;
        self.faces.push(Face::Wall { low, high, rows });
    }

    /// A wall up from a ring to a new one, which is returned.
    pub(super) fn rise(&mut self, low: RingId, outline: Outline, y: f64) -> RingId {
        let high = self.ring(outline, y);
        self.wall(low, high);
        high
    }

    /// A flat face within an outer ring, around the others.
    pub(super) fn cap(&mut self, rings: &[RingId], up: bool) {
        self.faces.push(Face::Cap { rings: rings.to_vec(), up });
    }

    /// Triangles that [`mesh`](Self::mesh) will have.
    pub(super) fn triangle_count(&self) -> usize {
        let points = |id: &RingId| self.rings[id.0].outline.len();
        let count = |face: &Face| match face {
            Face::Wall { low, rows, .. } => 2 * rows * points(low),
            Face::Cap { rings, .. } => rings.iter().map(points).sum::<usize>() + 2 * rings.len() - 4,
        };
        self.faces.iter().map(count).sum()
    }

    /// The mesh, with normals.
    pub(super) fn mesh(&self) -> Mesh {
        let mut builder = Builder::default();
        let firsts: Vec<u32> = self.rings.iter().map(|ring| builder.add_ring(ring)).collect();
        for face in &self.faces {
            match face {
                Face::Wall { low, high, rows } => {
                    let side = |id: &RingId| (&self.rings[id.0], firsts[id.0]);
                    builder.wall(side(low), side(high), *rows);
                }
                Face::Cap { rings, up } => {
                    let rings: Vec<_> = rings.iter().map(|id| (&self.rings[id.0], firsts[id.0])).collect();
                    builder.cap(&rings, *up);
                }
            }
        }
        let normals = Attribute::new_f32(Semantic::Normal, 3, builder.normals);
        builder.mesh.set_wedge_attribute(normals);
        builder.mesh
    }
}

#[derive(Default)]
struct Builder {
    mesh: Mesh,
    normals: Vec<f32>,
}

/// From (z, x) and y to x, y, z.
fn spread(p: DVec2, y: f64) -> DVec3 {
    DVec3::new(p.y, y, p.x)
}

impl Builder {
    fn vertex(&mut self, p: DVec3) -> u32 {
        self.mesh.positions.push(p.as_vec3().to_array());
        self.mesh.positions.len() as u32 - 1
    }

    fn add_ring(&mut self, ring: &Ring) -> u32 {
        let first = self.mesh.positions.len() as u32;
        for &p in &ring.outline.points {
            self.vertex(spread(p, ring.y));
        }
        first
    }

    fn wedge(&mut self, vertex: u32, normal: DVec3) -> u32 {
        self.mesh.wedge_vertices.push(vertex);
        self.normals.extend(normal.as_vec3().to_array());
        self.mesh.wedge_vertices.len() as u32 - 1
    }

    fn wall(&mut self, (low, low_first): (&Ring, u32), (high, high_first): (&Ring, u32), rows: usize) {
        let n = low.outline.len();
        let columns = 0..n as u32;
        let between = |row: usize, i: usize| {
            let t = row as f64 / rows as f64;
            spread(low.outline.points[i].lerp(high.outline.points[i], t), low.y + t * (high.y - low.y))
        };
        // vertices row by row, the first and the last are the rings'
        let mut vertices: Vec<Vec<u32>> = vec![columns.clone().map(|i| low_first + i).collect()];
        for row in 1..rows {
            vertices.push((0..n).map(|i| self.vertex(between(row, i))).collect());
        }
        vertices.push(columns.map(|i| high_first + i).collect());
        let mut earlier: Option<(DVec2, Vec<u32>)> = None;
        for i in 0..n {
            let next = (i + 1) % n;
            let [from, to] = low.outline.normals[i];
            let mut column = |at: usize, flat: DVec2| -> Vec<u32> {
                let normal = tilt(flat, high.outline.points[at] - low.outline.points[at], high.y - low.y);
                vertices.iter().map(|row| self.wedge(row[at], normal)).collect()
            };
            // smooth where this segment starts with the normal that the last one ended with
            let start = match earlier.take() {
                Some((normal, wedges)) if normal == from => wedges,
                _ => column(i, from),
            };
            let end = column(next, to);
            for row in 0..rows {
                let [a, b, c, d] = [start[row], end[row], end[row + 1], start[row + 1]];
                self.mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
            earlier = Some((to, end));
        }
    }

    fn cap(&mut self, rings: &[(&Ring, u32)], up: bool) {
        let normal = if up { DVec3::Y } else { -DVec3::Y };
        let mut points = Vec::new();
        let mut wedges = Vec::new();
        let mut holes = Vec::new();
        for (ring, first) in rings {
            holes.push(points.len());
            for (i, p) in ring.outline.points.iter().enumerate() {
                points.push(p.as_vec2().as_dvec2());
                wedges.push(self.wedge(first + i as u32, normal));
            }
        }
        let indices = triangulate(&points, &holes[1..]);
        let triangles = indices.as_chunks::<3>().0;
        // one winding for all: that of a sliver alone would be left to rounding
        let area = |&[a, b, c]: &[usize; 3]| (points[b] - points[a]).perp_dot(points[c] - points[a]);
        let is_up = triangles.iter().map(area).sum::<f64>() > 0.0;
        for triangle in triangles {
            let [a, b, c] = triangle.map(|i| wedges[i]);
            self.mesh.triangles.push(if is_up == up { [a, b, c] } else { [a, c, b] });
        }
    }
}

/// The triangles of a polygon with holes, every vertex used.
///
/// Ear clipping may leave out a vertex that comes to lie on a line between its neighbours, as can happen along the
/// bridges between symmetric holes: a crack between this face and the next. Then the points are bent by micrometres.
fn triangulate(points: &[DVec2], holes: &[usize]) -> Vec<usize> {
    let mut indices: Vec<usize> = Vec::new();
    for attempt in 0..8 {
        let bent = |p: &DVec2| DVec2::new(0.8, 0.6).rotate(*p) + 1e-4 * f64::from(attempt) * p.length_squared();
        earcut::Earcut::new().earcut(points.iter().map(|p| bent(p).to_array()), holes, &mut indices);
        if indices.len() == 3 * (points.len() + 2 * holes.len() - 2) {
            break;
        }
    }
    indices
}

/// The normal of a wall that moves by `offset` while it rises by `rise`, from its normal in the plane.
fn tilt(flat: DVec2, offset: DVec2, rise: f64) -> DVec3 {
    spread(flat * rise.abs(), -flat.dot(offset) * rise.signum()).normalize()
}
