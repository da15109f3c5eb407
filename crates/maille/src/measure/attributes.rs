//! How far attributes (normals, colours, texture coordinates) of two surfaces are apart.

use glam::DVec3;

use super::bvh::Bvh;
use super::chunks::map_chunks;
use super::compare::{CompareError, CompareOptions, Side, Watch, check, nearest};
use super::sample::SurfaceSampler;
use crate::control::Cancelled;
use crate::mesh::{Attribute, Semantic};
use crate::{Control, Mesh};

/// How far the values of one attribute are apart at corresponding points, both ways: of each figure the larger one.
///
/// Normals and tangents: the angle between the directions, in degrees. Colours: the root mean square over the components,
/// 0 to 1. Everything else: the Euclidean distance of the values (texture coordinates: 1 is the side of the texture).
#[derive(Debug, Clone, PartialEq)]
pub struct AttributeDeviation {
    /// Which attribute.
    pub semantic: Semantic,
    /// Mean over the area.
    pub mean: f64,
    /// Root of the mean square over the area.
    pub rms: f64,
    /// Largest over the samples. Beside a seam the nearest point may lie on its other side, whose values are others: there
    /// it tells little.
    pub max: f64,
}

/// Compares every attribute that both meshes have, interpolated over the triangles, at samples of each surface and the
/// points of the other one nearest to them. Integers and what only one mesh has are left out.
///
/// Takes the samples that [`compare`](super::compare()) takes, and as long.
///
/// # Errors
/// As [`compare`](super::compare()).
///
/// # Examples
/// ```
/// use maille::{Control, measure::{CompareOptions, compare_attributes}, mesh::shapes};
/// let mut sphere = shapes::sphere(4);
/// sphere.compute_normals(&Default::default());
/// let options = CompareOptions { samples: 1000, ..CompareOptions::default() };
/// let found = compare_attributes(&sphere, &sphere, &options, Control::default())?;
/// assert!(found.len() == 1 && found[0].max < 1e-3);
/// # Ok::<(), maille::measure::CompareError>(())
/// ```
pub fn compare_attributes(
    a: &Mesh,
    b: &Mesh,
    options: &CompareOptions,
    control: Control<'_>,
) -> Result<Vec<AttributeDeviation>, CompareError> {
    check(a, Side::A)?;
    check(b, Side::B)?;
    let fields: Vec<(Field<'_>, Field<'_>)> =
        Field::all(a).filter_map(|field| Some((field, Field::of(b, field)?))).collect();
    if fields.is_empty() || options.samples == 0 {
        return Ok(Vec::new());
    }
    let (there, back): (Vec<_>, Vec<_>) = (fields.clone(), fields.iter().map(|&(a, b)| (b, a)).collect());
    let (bvh_a, bvh_b) = (Bvh::new(a), Bvh::new(b));
    let watch = |stage| Watch::new(control, stage);
    let forward = one_sided(a, &bvh_a, &bvh_b, &there, options, &watch("comparing attributes from A to B"))?;
    let backward = one_sided(b, &bvh_b, &bvh_a, &back, options, &watch("comparing attributes from B to A"))?;
    let larger = |((field, _), (f, b)): (&(Field<'_>, Field<'_>), (&Tally, &Tally))| AttributeDeviation {
        semantic: field.attribute.semantic.clone(),
        mean: f.mean().max(b.mean()),
        rms: f.rms().max(b.rms()),
        max: f.max.max(b.max),
    };
    Ok(fields.iter().zip(forward.iter().zip(&backward)).map(larger).collect())
}

fn one_sided(
    from: &Mesh,
    from_bvh: &Bvh<'_>,
    to: &Bvh<'_>,
    fields: &[(Field<'_>, Field<'_>)],
    options: &CompareOptions,
    watch: &Watch<'_>,
) -> Result<Vec<Tally>, Cancelled> {
    let sampler = SurfaceSampler::new(from, from_bvh.triangles_in_space_order(), options.seed);
    let count = usize::try_from(options.samples).unwrap_or(usize::MAX);
    let parts = map_chunks(count, |range| {
        watch.run(range.len(), count, || {
            let mut tallies = vec![Tally::default(); fields.len()];
            let mut searcher = to.searcher();
            for sample in sampler.samples(options.samples, range.start as u64..range.end as u64) {
                let found = nearest(&mut searcher, sample.point);
                for (tally, (own, other)) in tallies.iter_mut().zip(fields) {
                    let own = |i| own.at(sample.triangle, sample.barycentric, i);
                    let other_value = |i| other.at(found.triangle, found.barycentric, i);
                    tally.add(difference(other.attribute, own, other_value));
                }
            }
            tallies
        })
    });
    let mut sums = vec![Tally::default(); fields.len()];
    for part in parts {
        sums.iter_mut().zip(part?).for_each(|(sum, part)| sum.merge(&part));
    }
    Ok(sums)
}

/// Distance of two values of an attribute, given component by component, as [`AttributeDeviation`] tells it.
fn difference(attribute: &Attribute, a: impl Fn(usize) -> f64, b: impl Fn(usize) -> f64) -> f64 {
    let count = attribute.components;
    let sum_sq = || (0..count).map(|i| (a(i) - b(i)).powi(2)).sum::<f64>();
    match attribute.semantic {
        Semantic::Normal | Semantic::Tangent if count >= 3 => {
            let (a, b) = (DVec3::from([0, 1, 2].map(a)), DVec3::from([0, 1, 2].map(b)));
            a.cross(b).length().atan2(a.dot(b)).to_degrees()
        }
        Semantic::Color(_) => (sum_sq() / count as f64).sqrt(),
        _ => sum_sq().sqrt(),
    }
}

/// A float attribute of a mesh, ready to be looked up on its triangles.
#[derive(Clone, Copy)]
struct Field<'m> {
    mesh: &'m Mesh,
    attribute: &'m Attribute,
    values: &'m [f32],
    /// One element to each wedge, not to each vertex.
    at_wedges: bool,
}

impl<'m> Field<'m> {
    fn all(mesh: &'m Mesh) -> impl Iterator<Item = Self> {
        let of_wedges = mesh.wedge_attributes.iter().map(|attribute| (attribute, true));
        let of_vertices = mesh.vertex_attributes.iter().map(|attribute| (attribute, false));
        of_wedges.chain(of_vertices).filter_map(move |(attribute, at_wedges)| {
            Some(Self { mesh, attribute, values: attribute.as_f32()?, at_wedges })
        })
    }

    /// The attribute of `mesh` that is comparable with `other`.
    fn of(mesh: &'m Mesh, other: Self) -> Option<Self> {
        let key = |attribute: &Attribute| (attribute.semantic.clone(), attribute.components);
        Self::all(mesh).find(|field| key(field.attribute) == key(other.attribute))
    }

    /// A component of the value at a point of a triangle.
    fn at(&self, triangle: u32, barycentric: [f64; 3], component: usize) -> f64 {
        let corner = |(wedge, weight): (u32, f64)| {
            let element = if self.at_wedges { wedge } else { self.mesh.wedge_vertices[wedge as usize] };
            weight * f64::from(self.values[element as usize * self.attribute.components + component])
        };
        self.mesh.triangles[triangle as usize].into_iter().zip(barycentric).map(corner).sum()
    }
}

/// Sums over samples; what is not a number is left out.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    count: u64,
    sum: f64,
    sum_sq: f64,
    max: f64,
}

impl Tally {
    fn add(&mut self, difference: f64) {
        if difference.is_finite() {
            self.merge(&Self { count: 1, sum: difference, sum_sq: difference * difference, max: difference });
        }
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.sum_sq += other.sum_sq;
        self.max = self.max.max(other.max);
    }

    fn mean(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }

    fn rms(&self) -> f64 {
        (self.sum_sq / self.count.max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn options() -> CompareOptions {
        CompareOptions { samples: 20_000, ..CompareOptions::default() }
    }

    /// A grid in the unit square with one value to each vertex.
    fn painted(semantic: Semantic, components: usize, value: impl Fn([f32; 3]) -> Vec<f32>) -> Mesh {
        let mut mesh = shapes::grid(8);
        let values = mesh.positions.iter().flat_map(|&p| value(p)).collect();
        mesh.vertex_attributes.push(Attribute::new_f32(semantic, components, values));
        mesh
    }

    #[test]
    fn a_shift_of_the_values_is_what_is_measured() {
        let field = |shift: f32| painted(Semantic::TexCoord(0), 2, move |p| vec![p[0] + shift, p[1]]);
        let found = &compare_attributes(&field(0.0), &field(0.25), &options(), Control::default()).unwrap()[0];
        for figure in [found.mean, found.rms, found.max] {
            assert!((figure - 0.25).abs() < 1e-5, "{found:?}");
        }
    }

    #[test]
    fn normals_are_compared_by_angle_and_colours_by_their_mean() {
        let leaning = |angle: f32| painted(Semantic::Normal, 3, move |_| vec![angle.sin(), 0.0, angle.cos()]);
        let turned = compare_attributes(&leaning(0.0), &leaning(0.5), &options(), Control::default()).unwrap();
        assert!((turned[0].rms - f64::from(0.5_f32.to_degrees())).abs() < 1e-3);
        let grey = |level: f32| painted(Semantic::Color(0), 3, move |_| vec![level; 3]);
        let paled = compare_attributes(&grey(0.0), &grey(1.0), &options(), Control::default()).unwrap();
        assert!((paled[0].max - 1.0).abs() < 1e-6);
    }

    #[test]
    fn what_only_one_mesh_has_is_left_out() {
        let (plain, coloured) = (shapes::grid(8), painted(Semantic::Color(0), 3, |_| vec![1.0; 3]));
        assert_eq!(compare_attributes(&plain, &coloured, &options(), Control::default()), Ok(Vec::new()));
    }

    #[test]
    fn wedges_and_vertices_are_compared_alike() {
        let at_vertices = painted(Semantic::Color(0), 3, |p| vec![p[0], p[1], 0.5]);
        let mut at_wedges = at_vertices.clone();
        at_wedges.wedge_attributes.append(&mut at_wedges.vertex_attributes);
        let found = compare_attributes(&at_vertices, &at_wedges, &options(), Control::default()).unwrap();
        assert!(found.len() == 1 && found[0].max < 1e-6, "{found:?}");
    }
}
