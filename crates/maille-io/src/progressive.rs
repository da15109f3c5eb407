//! Assets at any number of triangles: progressive meshes that are coarsened and refined together.

use maille::mesh::WeldOptions;
use maille::progressive::ProgressiveMesh;
use maille::simplify::{SimplifyError, SimplifyOptions, Target};
use maille::skin::Pose;
use maille::{Control, Mesh};
use rayon::prelude::*;

use crate::process::{FEWEST, ProcessError, world_scales};
use crate::{Asset, AttributeRoles};

/// How the edges of an asset collapse, where that is recorded.
#[derive(Debug, Clone, Default)]
pub struct CollapseOptions {
    /// How to simplify each mesh. The target is not looked at; `locked`, `importance` and `poses` must be empty: they are per
    /// mesh. Distances are in world units.
    pub simplify: SimplifyOptions,
    /// What the attributes of the asset mean.
    pub roles: AttributeRoles,
    /// Merge vertices at the same place first, and wedges that agree: a soup of triangles becomes a surface.
    pub weld: bool,
}

/// A progressive mesh in its asset: what its errors and costs are in world units, and how often it is drawn.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Part {
    pub(crate) mesh: ProgressiveMesh,
    /// Factor on errors, which are distances.
    pub(crate) error_scale: f64,
    /// Factor on costs.
    pub(crate) cost_scale: f64,
    pub(crate) draws: usize,
}

impl Part {
    /// How many collapses cost at most so much, in world units.
    fn collapses_within(&self, cost: f64) -> usize {
        let cheap = self.mesh.costs().partition_point(|&own| f64::from(own) * self.cost_scale <= cost);
        self.mesh.whole(cheap).min(self.most_collapses())
    }

    /// How many collapses have at most such an error, in world units.
    pub(crate) fn collapses_within_error(&self, error: f64) -> usize {
        let within = |&at: &usize| self.mesh.error_at(at) * self.error_scale <= error;
        let (mut low, mut high) = (0, self.most_collapses());
        while low < high {
            let middle = low + (high - low).div_ceil(2);
            if within(&middle) { low = middle } else { high = middle - 1 }
        }
        // whole surfaces only, without going beyond
        (0..=low).rev().find(|&at| self.mesh.whole(at) == at).unwrap_or(0)
    }

    /// How many there may be at most: none of the meshes vanishes.
    pub(crate) fn most_collapses(&self) -> usize {
        let least = FEWEST.min(self.mesh.counts_at(0).triangles as usize);
        let has_enough = |at: usize| self.mesh.counts_at(at).triangles as usize >= least;
        let places = (0..=self.mesh.collapses_to(least)).rev();
        places.into_iter().find(|&at| has_enough(at) && self.mesh.whole(at) == at).unwrap_or(0)
    }

    fn drawn_at(&self, collapses: usize) -> usize {
        self.mesh.counts_at(collapses).triangles as usize * self.draws
    }
}

/// What refuses a mesh of an asset.
pub(crate) fn refusal(asset: &Asset, index: usize) -> impl Fn(SimplifyError) -> ProcessError {
    move |error| ProcessError::Mesh { index, name: asset.meshes[index].name.clone(), error }
}

/// Simplifies each mesh of an asset once, to so many triangles, as it is seen in its poses.
///
/// # Errors
/// [`ProcessError`].
pub(crate) fn parts_of(
    asset: &Asset,
    options: &CollapseOptions,
    poses: &[Vec<Pose>],
    triangles: usize,
    control: Control<'_>,
) -> Result<Vec<Part>, ProcessError> {
    if asset.triangle_count() == 0 {
        return Err(ProcessError::NoTriangles);
    }
    options.roles.check(asset)?;
    let power = options.simplify.metric.cost_power(options.simplify.quadric_weight);
    let (scales, draws) = (world_scales(asset), asset.draws());
    let part = |index: usize| {
        let mut mesh: Mesh = asset.meshes[index].mesh.clone();
        if options.weld {
            mesh.weld(&WeldOptions::EXACT_WITH_WEDGES);
        }
        let target = Target { triangles: Some(triangles), max_error: None };
        let mut own = SimplifyOptions { poses: poses[index].clone(), target, ..options.simplify.clone() };
        own.join_distance = own.join_distance.map(|distance| distance / scales[index]);
        options.roles.apply(&mesh, options.roles.texels(asset, index), &mut own);
        let (mesh, _) = ProgressiveMesh::new(mesh, &own, control).map_err(refusal(asset, index))?;
        let (error_scale, draws) = (scales[index], draws[index]);
        Ok(Part { mesh, error_scale, cost_scale: error_scale.powi(power), draws })
    };
    (0..asset.meshes.len()).into_par_iter().map(part).collect()
}

/// How far each mesh has to be simplified so that at most so many triangles are drawn, if that is possible: all to the same
/// cost, in world units, as if they were one mesh.
pub(crate) fn collapses_for(parts: &[&Part], triangles: usize) -> Vec<usize> {
    let at = |cost: f64| -> Vec<usize> { parts.iter().map(|part| part.collapses_within(cost)).collect() };
    let drawn = |at: &[usize]| drawn_at(parts.iter().copied(), at);
    let costs = parts.iter().flat_map(|part| part.mesh.costs().iter().map(|&cost| f64::from(cost) * part.cost_scale));
    let mut costs: Vec<f64> = costs.collect();
    costs.sort_unstable_by(f64::total_cmp);
    costs.dedup();
    // the lowest cost that is enough; collapses of one mesh at that cost, so that no more go than must
    let enough = costs.partition_point(|&cost| drawn(&at(cost)) > triangles);
    let Some(&cost) = costs.get(enough) else { return parts.iter().map(|part| part.most_collapses()).collect() };
    let mut now = enough.checked_sub(1).map_or_else(|| vec![0; parts.len()], |i| at(costs[i]));
    for (i, part) in parts.iter().enumerate() {
        let last = part.collapses_within(cost);
        while drawn(&now) > triangles && now[i] < last {
            now[i] = part.mesh.whole(now[i] + 1);
        }
    }
    now
}

/// Triangles drawn after some collapses of each mesh.
pub(crate) fn drawn_at<'p>(parts: impl Iterator<Item = &'p Part>, collapses: &[usize]) -> usize {
    parts.zip(collapses).map(|(part, &at)| part.drawn_at(at)).sum()
}

/// Largest error of a collapse by the metric's estimate, in world units.
pub(crate) fn error_at<'p>(parts: impl Iterator<Item = &'p Part>, collapses: &[usize]) -> f64 {
    parts.zip(collapses).map(|(part, &at)| part.mesh.error_at(at) * part.error_scale).fold(0.0, f64::max)
}
