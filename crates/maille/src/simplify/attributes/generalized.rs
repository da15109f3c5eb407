//! Quadrics in the space of positions and attributes together.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::carried::{Carried, Ends, Group};
use crate::mesh::Mesh;
use crate::simplify::features::Features;
use crate::simplify::legality::Collapse;
use crate::simplify::metric::{
    Candidate, EdgeContext, Metric, QuadricMemory, QuadricMetric, QuadricOptions, Update, faces_of_star, mean,
};
use crate::simplify::options::SimplifyOptions;
use crate::simplify::quadric::Quadric;
use crate::topology::CollapseMesh;
use crate::topology::collapse_mesh::{Frame, RingFace};

/// Quadrics in as many dimensions as a wedge has coordinates and channels (Garland and Heckbert, "Simplifying surfaces with
/// color and texture using quadric error metrics", IEEE Visualization 1998).
///
/// There a face is a plane of two dimensions, through its corners with their weighted values; a wedge keeps the sum of
/// the squared distances from the planes of its faces, by area, and of all that it has merged with. Wedges at the ends of an edge
/// that share a value add theirs up; for a position p the best value s solves a linear system, and with it put in what is left is a
/// quadric of p, as with [`AttributeMetric`](super::AttributeMetric).
///
/// For comparison. Memory and time grow with the square of the number of channels (a wedge with colours keeps 29 numbers, one with
/// 45 coefficients 1,226), and planes in that space reach far beyond the faces that they come from.
#[derive(Debug)]
pub(in crate::simplify) struct GeneralizedQuadrics {
    /// The surface alone, for the error that is told.
    surface: QuadricMetric,
    /// As the surface, with planes through features.
    options: QuadricOptions,
    pub(in crate::simplify) carried: Carried,
    /// Planes through features at each vertex.
    constraints: Vec<Quadric>,
    /// The [`Form`] of each wedge, one after the other.
    forms: Vec<f64>,
}

impl GeneralizedQuadrics {
    /// The metric for a mesh whose positions will be in a [`CollapseMesh`] with that frame; `None` if no attribute counts.
    pub(in crate::simplify) fn new(
        options: QuadricOptions,
        mesh: &Mesh,
        frame: &Frame,
        asked: &SimplifyOptions,
    ) -> Option<Self> {
        let surface = QuadricOptions { memory: QuadricMemory::Summed, constraint: None, ..options };
        Some(Self {
            surface: QuadricMetric::new(surface),
            options,
            carried: Carried::new(mesh, frame, asked)?,
            constraints: Vec::new(),
            forms: Vec::new(),
        })
    }

    fn form_of(&self, wedge: u32) -> &[f64] {
        let length = Form::length(self.carried.channels);
        &self.forms[wedge as usize * length..][..length]
    }

    /// A wedge in the space of positions and weighted values.
    fn point(&self, mesh: &CollapseMesh, vertex: u32, wedge: u32) -> Vec<f64> {
        let weighted = |j: usize| f64::from(self.carried.value(wedge, j)) * self.carried.weights[j];
        let values = (0..self.carried.channels).map(weighted);
        mesh.point(vertex).to_array().into_iter().chain(values).collect()
    }

    /// What wedges that share their values keep, together.
    fn sum_of(&self, group: Group<'_>) -> Form {
        let mut sum = Form::new(self.carried.channels);
        group.members().for_each(|(wedge, _)| sum.add(self.form_of(wedge)));
        sum
    }

    fn groups(&self, ends: &Ends) -> Vec<u8> {
        self.carried.shared(0..self.carried.channels, ends)
    }

    /// The quadric of an edge, with the best values put in.
    fn quadric(&self, mesh: &CollapseMesh, edge: &EdgeContext) -> Quadric {
        let ends = self.carried.ends(edge.ends.map(|v| mesh.faces_around(v)), edge.ends);
        let [a, b] = edge.ends.map(|v| self.constraints[v as usize]);
        let mut quadric = a + b;
        quadric.weight = 0.0;
        for group in Group::all(&ends, &self.groups(&ends)) {
            quadric += self.sum_of(group).at_best_values().0;
        }
        quadric
    }
}

impl Metric for GeneralizedQuadrics {
    fn prepare(&mut self, mesh: &CollapseMesh, features: &Features) {
        self.surface.prepare(mesh, features);
        let with_features = QuadricMetric::new(self.options);
        let vertices = 0..mesh.vertex_count() as u32;
        let constraints = vertices.into_par_iter().map(|v| with_features.constraint_planes(mesh, v, features));
        self.constraints = constraints.collect();
        let channels = self.carried.channels;
        let length = Form::length(channels);
        let mut forms = vec![0.0; self.carried.wedge_count() * length];
        for vertex in 0..mesh.vertex_count() as u32 {
            for face in mesh.faces_around(vertex) {
                let own = self.carried.corners.at(&face, vertex);
                let [x, y] = self.carried.corners.opposite(&face);
                let corners = [(vertex, own), (face.x, x), (face.y, y)].map(|(v, w)| self.point(mesh, v, w));
                let [p, x, y] = [vertex, face.x, face.y].map(|v| mesh.point(v));
                let area = (x - p).cross(y - p).length() / 2.0;
                if let Some(plane) = Form::of_plane(&corners, area) {
                    let form = &mut forms[own as usize * length..][..length];
                    form.iter_mut().zip(&plane.0).for_each(|(sum, x)| *sum += x);
                }
            }
        }
        self.forms = forms;
    }

    fn evaluate(&self, mesh: &CollapseMesh, _: &Features, edge: &EdgeContext) -> Option<Candidate> {
        let candidate = self.surface.options.candidate(&self.quadric(mesh, edge), None, 0.0, edge);
        let surface = self.surface.placing(edge, 0.5);
        let error_sq = mean(surface.at(candidate.position).max(0.0), surface.weight);
        Some(Candidate { error_sq, ..candidate })
    }

    fn refine(
        &mut self,
        mesh: &CollapseMesh,
        edge: &EdgeContext,
        candidate: &Candidate,
        rings: [&[RingFace]; 2],
    ) -> Option<DVec3> {
        let faces = faces_of_star(edge.ends, rings, |v| mesh.point(v));
        let place = self.surface.options.refine(&self.quadric(mesh, edge), edge, candidate.position, faces);
        let ends = self.carried.ends(rings.map(|ring| ring.iter().copied()), edge.ends);
        let mut pending = self.carried.start(&ends);
        let mut worst: f64 = 0.0;
        for group in Group::all(&ends, &self.groups(&ends)) {
            let form = self.sum_of(group);
            let (quadric, values) = form.at_best_values();
            let error_sq = mean(quadric.at(place).max(0.0), quadric.weight);
            worst = worst.max(error_sq);
            for attribute in &self.carried.attributes {
                if attribute.is_texture() {
                    self.carried.slip(&mut pending, group, error_sq / (attribute.weight * attribute.weight));
                }
                let predicted: Vec<f64> =
                    attribute.range().map(|j| values.at(j, place) / self.carried.weights[j]).collect();
                let known = (form.area() > 0.0).then_some(&*predicted);
                self.carried.settle(&mut pending, attribute, group, (edge, rings, place), known);
            }
        }
        // a distance in the common space: no attribute is farther by itself
        pending.errors.extend(self.carried.attributes.iter().map(|attribute| worst.sqrt() / attribute.weight));
        self.carried.accepts(pending, edge, rings).then_some(place)
    }

    fn give_values(&self, wedges: &[u32], mesh: &mut Mesh) {
        self.carried.give_values(wedges, mesh);
    }

    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        let wedges = self.carried.pending_wedges().to_vec();
        self.carried.on_collapse(collapse);
        let length = Form::length(self.carried.channels);
        for wedge in wedges {
            if let Some(into) = self.carried.corners.merged(wedge).filter(|&into| into != wedge) {
                let form = self.form_of(wedge).to_vec();
                let sum = &mut self.forms[into as usize * length..][..length];
                sum.iter_mut().zip(form).for_each(|(sum, x)| *sum += x);
            }
        }
    }

    fn commit(&mut self, mesh: &CollapseMesh, kept: u32, removed: u32, neighbors: &[u32], features: &Features) {
        self.surface.commit(mesh, kept, removed, neighbors, features);
        self.constraints[kept as usize] = self.constraints[kept as usize] + self.constraints[removed as usize];
    }

    fn update(&self) -> Update {
        Update::AtVertex
    }
}

/// `x' A x + 2 b' x + c` in the space of positions and values, with the area that it stands for: the lower half of A row by
/// row, b, c and the area.
#[derive(Debug, Clone, PartialEq)]
struct Form(Vec<f64>);

/// Share of the mean eigenvalue that is added to the diagonal for values: what decides where planes do not.
const PULL: f64 = 1e-9;

impl Form {
    fn length(channels: usize) -> usize {
        let n = 3 + channels;
        n * (n + 1) / 2 + n + 2
    }

    fn new(channels: usize) -> Self {
        Self(vec![0.0; Self::length(channels)])
    }

    fn dimensions(&self) -> usize {
        // n (n + 1) / 2 + n + 2 numbers
        ((8 * self.0.len() - 7).isqrt() - 3) / 2
    }

    fn add(&mut self, other: &[f64]) {
        self.0.iter_mut().zip(other).for_each(|(sum, x)| *sum += x);
    }

    fn area(&self) -> f64 {
        self.0[self.0.len() - 1]
    }

    fn a(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.max(j), i.min(j));
        self.0[i * (i + 1) / 2 + j]
    }

    fn b(&self, i: usize) -> f64 {
        let n = self.dimensions();
        self.0[n * (n + 1) / 2 + i]
    }

    fn c(&self) -> f64 {
        self.0[self.0.len() - 2]
    }

    /// The squared distance from the plane through three points, times an area; `None` if they lie in line.
    fn of_plane([p, q, r]: &[Vec<f64>; 3], area: f64) -> Option<Self> {
        let dot = |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(x, y)| x * y).sum() };
        let less = |x: &[f64], y: &[f64], k: f64| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x - k * y).collect() };
        let unit = |x: Vec<f64>| -> Option<Vec<f64>> {
            let length = dot(&x, &x).sqrt();
            (length > 0.0).then(|| x.iter().map(|x| x / length).collect())
        };
        let first = unit(less(q, p, 1.0))?;
        let to_r = less(r, p, 1.0);
        let second = unit(less(&to_r, &first, dot(&to_r, &first)))?;
        let along = [dot(p, &first), dot(p, &second)];
        let n = p.len();
        let mut form = Vec::with_capacity(Self::length(n - 3));
        for i in 0..n {
            form.extend((0..=i).map(|j| f64::from(i == j) - first[i] * first[j] - second[i] * second[j]));
        }
        form.extend((0..n).map(|i| along[0] * first[i] + along[1] * second[i] - p[i]));
        form.extend([dot(p, p) - along[0] * along[0] - along[1] * along[1], 1.0]);
        form.iter_mut().for_each(|x| *x *= area);
        Some(Self(form))
    }

    /// What is left of it for a position when the best values are put in, and what these are.
    fn at_best_values(&self) -> (Quadric, BestValues) {
        let channels = self.dimensions() - 3;
        let trace: f64 = (0..channels).map(|i| self.a(3 + i, 3 + i)).sum();
        let pull = (trace / channels.max(1) as f64 * PULL).max(f64::MIN_POSITIVE);
        // L L' of the block of the values
        let mut l = vec![0.0; channels * channels];
        for i in 0..channels {
            for j in 0..=i {
                let inner: f64 = (0..j).map(|k| l[i * channels + k] * l[j * channels + k]).sum();
                let rest = self.a(3 + i, 3 + j) - inner;
                l[i * channels + j] = if i == j { (rest + pull).max(pull).sqrt() } else { rest / l[j * channels + j] };
            }
        }
        let solve = |mut x: Vec<f64>| {
            for i in 0..channels {
                let inner: f64 = (0..i).map(|k| l[i * channels + k] * x[k]).sum();
                x[i] = (x[i] - inner) / l[i * channels + i];
            }
            for i in (0..channels).rev() {
                let inner: f64 = (i + 1..channels).map(|k| l[k * channels + i] * x[k]).sum();
                x[i] = (x[i] - inner) / l[i * channels + i];
            }
            x
        };
        let coupling = [0, 1, 2].map(|axis| (0..channels).map(|i| self.a(3 + i, axis)).collect::<Vec<f64>>());
        let pull_of_b: Vec<f64> = (0..channels).map(|i| self.b(3 + i)).collect();
        let slopes = coupling.clone().map(solve);
        let offsets = solve(pull_of_b.clone());
        let dot = |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(x, y)| x * y).sum() };
        let column = |j: usize| DVec3::from([0, 1, 2].map(|i| self.a(i, j) - dot(&coupling[i], &slopes[j])));
        let b = DVec3::from([0, 1, 2].map(|i| self.b(i) - dot(&coupling[i], &offsets)));
        let c = self.c() - dot(&pull_of_b, &offsets);
        let a = DMat3::from_cols(column(0), column(1), column(2));
        (Quadric::centered(a, b, c, DVec3::ZERO, self.area()), BestValues { slopes, offsets })
    }
}

/// The best weighted values, as linear functions of the position.
struct BestValues {
    slopes: [Vec<f64>; 3],
    offsets: Vec<f64>,
}

impl BestValues {
    fn at(&self, channel: usize, p: DVec3) -> f64 {
        let slope = DVec3::from([0, 1, 2].map(|axis| self.slopes[axis][channel]));
        -(slope.dot(p) + self.offsets[channel])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value(form: &Form, x: &[f64]) -> f64 {
        let n = form.dimensions();
        let square = |i: usize| (0..n).map(move |j| (i, j));
        let quadratic: f64 = (0..n).flat_map(square).map(|(i, j)| x[i] * form.a(i, j) * x[j]).sum();
        quadratic + 2.0 * (0..n).map(|i| form.b(i) * x[i]).sum::<f64>() + form.c()
    }

    proptest! {
        #[test]
        fn a_form_is_the_distance_from_a_plane_and_best_values_are_best(
            corners in prop::array::uniform3(prop::collection::vec(-1.0..1.0f64, 5)),
            others in prop::array::uniform3(prop::collection::vec(-1.0..1.0f64, 5)),
            [u, v] in prop::array::uniform2(-1.0..1.0f64),
            step in prop::collection::vec(-1.0..1.0f64, 2),
        ) {
            let Some(form) = Form::of_plane(&corners, 2.0) else { return Ok(()) };
            prop_assert_eq!(form.dimensions(), 5);
            let [p, q, r] = &corners;
            let inside: Vec<f64> = (0..5).map(|i| p[i] + u * (q[i] - p[i]) + v * (r[i] - p[i])).collect();
            prop_assert!(value(&form, &inside).abs() < 1e-9, "{}", value(&form, &inside));
            // the nearest point of the plane by Gram's matrix
            let (e, f): (Vec<f64>, Vec<f64>) = (0..5).map(|i| (q[i] - p[i], r[i] - p[i])).unzip();
            let x = &others[0];
            let dot = |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(x, y)| x * y).sum() };
            let to_x: Vec<f64> = (0..5).map(|i| x[i] - p[i]).collect();
            let (ee, ef, ff, xe, xf) = (dot(&e, &e), dot(&e, &f), dot(&f, &f), dot(&to_x, &e), dot(&to_x, &f));
            let determinant = ee * ff - ef * ef;
            prop_assume!(determinant > 1e-2);
            let along = (xe * xe * ff - 2.0 * xe * xf * ef + xf * xf * ee) / determinant;
            prop_assert!((value(&form, x) - 2.0 * (dot(&to_x, &to_x) - along)).abs() < 1e-9);

            let mut sum = form.clone();
            for shift in [0, 1] {
                let mut corners = others.clone();
                corners[shift][shift] += 2.0;
                if let Some(other) = Form::of_plane(&corners, 1.0) {
                    sum.add(&other.0);
                }
            }
            let (quadric, best) = sum.at_best_values();
            let place = DVec3::new(x[0], x[1], x[2]);
            let at = |steps: [f64; 2]| {
                let values = [0, 1].map(|k| best.at(k, place) + steps[k]);
                value(&sum, &[x[0], x[1], x[2], values[0], values[1]])
            };
            prop_assert!((quadric.at(place) - at([0.0; 2])).abs() < 1e-6);
            prop_assert!(at([step[0], step[1]]) >= at([0.0; 2]) - 1e-6);
        }
    }
}
