//! Assets at any number of triangles: progressive meshes that are coarsened and refined together.

use std::path::Path;

use maille::mesh::WeldOptions;
use maille::progressive::ProgressiveMesh;
use maille::simplify::{SimplifyError, SimplifyOptions, Target};
use maille::skin::Pose;
use maille::{Control, Mesh};
use rayon::prelude::*;

use crate::input::Input;
use crate::output::Output;
use crate::process::{FEWEST, ProcessError, world_scales};
use crate::{Asset, AttributeRoles, PoseSet, ReadError, ReadOptions, WriteError, Written, mpm, poses_of};

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

/// An asset with all its levels, from the finest to one of a few triangles: what an `.mpm` file holds.
///
/// Every level is the whole asset. Skins, materials, clips and all else that is not mesh are shared.
///
/// # Examples
/// ```
/// use maille_io::{Asset, PoseSet, ProgressiveAsset};
/// let sphere = Asset::from_mesh("sphere", maille::mesh::shapes::sphere(4));
/// let progressive = ProgressiveAsset::new(sphere, &Default::default(), &PoseSet::Bind, Default::default());
/// let mut progressive = progressive.map_err(|error| error.to_string())?;
/// let collapses = progressive.collapses_for(500);
/// assert_eq!(progressive.level(&collapses).triangle_count(), 500);
/// # Ok::<(), String>(())
/// ```
#[derive(Debug, Clone)]
pub struct ProgressiveAsset {
    /// All but the meshes, which are left empty.
    pub(crate) asset: Asset,
    pub(crate) parts: Vec<Part>,
}

impl ProgressiveAsset {
    /// Simplifies each mesh of an asset once, all the way, and keeps what it takes to undo that.
    ///
    /// # Errors
    /// [`ProcessError`].
    pub fn new(
        asset: Asset,
        options: &CollapseOptions,
        poses: &PoseSet,
        control: Control<'_>,
    ) -> Result<Self, ProcessError> {
        let poses = control.time("poses", || poses_of(&asset, poses));
        let parts = parts_of(&asset, options, &poses, 0, control)?;
        Ok(Self::of_parts(asset, parts))
    }

    /// Takes the meshes out of an asset in favour of progressive ones.
    pub(crate) fn of_parts(mut asset: Asset, parts: Vec<Part>) -> Self {
        asset.meshes.iter_mut().for_each(|named| named.mesh = Mesh::default());
        Self { asset, parts }
    }

    /// Reads an `.mpm` file.
    ///
    /// # Errors
    /// [`ReadError`], with the path, the place in the file and what could be done.
    pub fn read(path: &Path, options: &ReadOptions) -> Result<Self, ReadError> {
        let read = || mpm::read(&Input::open(path)?, path.parent(), options);
        read().map_err(|error| error.or_damaged().at_path(path))
    }

    /// Reads an `.mpm` file that is in memory already.
    ///
    /// # Errors
    /// [`ReadError`], with the place and what could be done.
    pub fn read_bytes(bytes: &[u8], options: &ReadOptions) -> Result<Self, ReadError> {
        mpm::read(bytes, None, options).map_err(ReadError::or_damaged)
    }

    /// Writes an `.mpm` file, whole or not at all; whatever the path is called.
    ///
    /// # Errors
    /// [`WriteError`], with the path and what could be done.
    pub fn write(&self, path: &Path, control: Control<'_>) -> Result<Written, WriteError> {
        let write = || {
            let mut output = Output::new(path, control)?;
            mpm::write(self, &mut output)?;
            output.commit()
        };
        write().map_err(|error: WriteError| error.at_path(path))
    }

    /// The progressive meshes, in the order of [`Asset::meshes`].
    pub fn meshes(&self) -> impl ExactSizeIterator<Item = &ProgressiveMesh> {
        self.parts.iter().map(|part| &part.mesh)
    }

    /// What was odd in the file but could be read, one sentence each, for the user.
    pub fn warnings(&self) -> &[String] {
        &self.asset.warnings
    }

    /// How far each mesh has to be simplified so that at most so many triangles are drawn (those of a mesh as often as it is
    /// drawn); as far as no mesh vanishes, if there is no such level. All meshes get there at the same cost, in world units,
    /// as if they were one.
    pub fn collapses_for(&self, triangles: usize) -> Vec<usize> {
        collapses_for(&self.parts.iter().collect::<Vec<_>>(), triangles)
    }

    /// Number of triangles drawn after some collapses of each mesh.
    ///
    /// # Panics
    /// If a mesh has not so many collapses.
    pub fn drawn_triangle_count_at(&self, collapses: &[usize]) -> usize {
        drawn_at(self.parts.iter(), collapses)
    }

    /// Largest error after some collapses of each mesh, as the metric estimates, in world units.
    ///
    /// # Panics
    /// If a mesh has not so many collapses.
    pub fn error_at(&self, collapses: &[usize]) -> f64 {
        error_at(self.parts.iter(), collapses)
    }

    /// The asset after some collapses of each mesh (or all, where there are not so many). Its elements are in the order of their
    /// lifetimes; [`order_for_display`](crate::order_for_display) gives them one that is good for drawing.
    pub fn level(&mut self, collapses: &[usize]) -> Asset {
        let level = |(part, &at): (&mut Part, &usize)| {
            part.mesh.seek(at);
            part.mesh.to_mesh()
        };
        let meshes: Vec<Mesh> = self.parts.par_iter_mut().zip(collapses).map(level).collect();
        let mut asset = self.asset.clone();
        asset.meshes.iter_mut().zip(meshes).for_each(|(named, mesh)| named.mesh = mesh);
        asset
    }

    /// The finest level.
    pub fn finest(&mut self) -> Asset {
        self.level(&vec![0; self.parts.len()])
    }
}
