//! Work on whole assets.

use std::sync::Mutex;

use glam::{DMat3, DMat4};
use maille::certified::{CertifiedOptions, simplify_certified_with};
use maille::cluster::{ClusterMethod, ClusterOptions, cluster};
use maille::control::Cancelled;
use maille::measure::area;
use maille::mesh::WeldOptions;
use maille::refit::{RefitOptions, RefitReport};
use maille::simplify::{
    AttributeError, CurvePoint, EdgePolicy, Refusals, SimplifyError, SimplifyOptions, SimplifyReport, Stop, Target,
    simplify,
};
use maille::{Control, Mesh};
use rayon::prelude::*;

use crate::{Asset, AttributeRoles, Instance};

/// Fewest triangles that sharing out a total leaves to a mesh, so that none disappears: a tetrahedron.
pub(crate) const FEWEST: usize = 4;
/// How often what a mesh could not give is asked of the others.
const ROUNDS: usize = 4;
/// How far below its share by size a mesh may go where the share is by error.
const REACH: usize = 8;
/// A mesh keeps its first share over this, whatever the others could not give: better too many triangles than a head
/// ruined because a sword is stubborn.
const MOST_CUT: usize = 2;
/// How a number of triangles is shared out over the meshes of an asset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Budget {
    /// So that the next collapse costs the same everywhere, in world units: as if all were one mesh. A mesh that turns out
    /// to need more than its share by size is simplified twice.
    #[default]
    Error,
    /// To each the same share of its own.
    Proportional,
}

/// How to simplify an [`Asset`].
#[derive(Debug, Clone, Default)]
pub struct AssetOptions {
    /// How to simplify each mesh. Here the target is one of the whole asset: the number of triangles is what is drawn (a
    /// mesh that is drawn twice counts twice), the largest error is a distance in world units. `locked` and `importance` must be
    /// empty: they are per vertex, name attributes instead.
    pub simplify: SimplifyOptions,
    /// Merge vertices at the same place first, and wedges that agree: a soup of triangles becomes a surface.
    pub weld: bool,
    /// How a number of triangles is shared out over the meshes.
    pub budget: Budget,
    /// What the attributes of the asset mean.
    pub roles: AttributeRoles,
    /// Cluster vertices this way instead of collapsing edges. Of `simplify`, only the target matters then.
    pub cluster: Option<ClusterMethod>,
    /// Whether and how the vertices that are left are fitted to the original in the end. `fixed` must be empty: what is
    /// locked stays.
    pub refit: Option<RefitOptions>,
    /// Whether the largest distance between each mesh and what becomes of it is proven to be within
    /// `simplify.target.max_error`, which must be given then: see [`maille::certified`]. Takes several times as long.
    pub certify: bool,
}

/// What simplifying an [`Asset`] did.
#[derive(Debug, Clone)]
pub struct AssetReport {
    /// The report of each distinct mesh, in the order of [`Asset::meshes`]; errors are in units of the mesh.
    pub meshes: Vec<SimplifyReport>,
    /// Triangles drawn before.
    pub triangles_in: usize,
    /// Triangles drawn after.
    pub triangles_out: usize,
    /// Edge collapses done.
    pub collapses: u64,
    /// Largest error of a collapse by the metric's estimate, in world units.
    pub error: f64,
    /// What became of the attributes that counted in the metric: the largest weight, in world units, and error of each.
    pub attributes: Vec<AttributeError>,
    /// Why the work stopped: the reason of the mesh that was furthest from the target.
    pub stopped: Stop,
    /// What the constraints refused.
    pub refused: Refusals,
    /// What fitting to the original did to each distinct mesh that has triangles, in world units, in their order; empty if
    /// it was not asked for.
    pub refits: Vec<RefitReport>,
    /// If that was asked for: no point of any mesh or of what has become of it is farther from the other than this, in world
    /// units. Of meshes moved by joints, as far as the root of how much the area of the mesh grows in its pose tells.
    pub max_error_proven: Option<f64>,
    /// The largest distance that the proof came across, in world units.
    pub max_error_found: Option<f64>,
}

/// Why an asset could not be simplified.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProcessError {
    /// A mesh could not be simplified.
    #[error("mesh {index}{}: {error}", quoted(name))]
    Mesh {
        /// Index into [`Asset::meshes`].
        index: usize,
        /// Its name, may be empty.
        name: String,
        /// What was wrong.
        error: SimplifyError,
    },
    /// No mesh has an attribute of that name.
    #[error("no mesh has a float attribute '{name}'; there are: {known}")]
    NoAttribute {
        /// What was asked for.
        name: String,
        /// The attributes there are.
        known: String,
    },
    /// Meshes that are given as a level of detail cannot be one.
    #[error("level {level}: {reason}")]
    Level {
        /// Which level, from 1 on.
        level: usize,
        /// What is wrong, in words.
        reason: String,
    },
    /// What is to be proven is not told.
    #[error("there is no largest error to be proven")]
    NothingToProve,
    /// A limit in texels was asked for, and no texture tells how large they are.
    #[error("no mesh has a texture whose size can be read, so an error in texels means nothing")]
    NoTexture,
    /// The asset holds no triangles.
    #[error("there are no triangles to simplify")]
    NoTriangles,
}

fn quoted(name: &str) -> String {
    if name.is_empty() { String::new() } else { format!(" ('{name}')") }
}

/// Simplifies every distinct mesh of an asset once, in parallel, to a common target.
///
/// A number of triangles is shared out over the meshes as the [`Budget`] tells; what one cannot give up (its constraints
/// forbid it) is asked of the others, of each at most half of its share. The result does not depend on the number of
/// threads.
///
/// # Errors
/// [`ProcessError`]; some meshes may be simplified already then, so the asset is not to be used further.
pub fn simplify_asset(
    asset: &mut Asset,
    options: &AssetOptions,
    control: Control<'_>,
) -> Result<AssetReport, ProcessError> {
    let before: Vec<usize> = asset.meshes.iter().map(|m| m.mesh.triangle_count()).collect();
    if before.iter().sum::<usize>() == 0 {
        return Err(ProcessError::NoTriangles);
    }
    if options.certify && options.simplify.target.max_error.is_none() {
        return Err(ProcessError::NothingToProve);
    }
    options.roles.check(asset)?;
    let texels: Vec<Option<f64>> = (0..asset.meshes.len()).map(|mesh| options.roles.texels(asset, mesh)).collect();
    if options.weld {
        asset.meshes.par_iter_mut().for_each(|named| {
            named.mesh.weld(&WeldOptions::EXACT_WITH_WEDGES);
        });
    }
    let scales = world_scales(asset);
    let draws = asset.draws();
    let total = options.simplify.target.triangles;
    let has_several = before.iter().filter(|&&triangles| triangles > 0).count() > 1;
    let by_error = options.budget == Budget::Error
        && options.cluster.is_none()
        && has_several
        && total.is_some()
        && !options.certify;
    let originals: Vec<Mesh> = if options.refit.is_some() || options.certify || by_error {
        asset.meshes.iter().map(|named| named.mesh.clone()).collect()
    } else {
        Vec::new()
    };
    let drawn: Vec<usize> = before.iter().zip(&draws).map(|(triangles, draws)| triangles * draws).collect();
    let targets = total.map_or_else(|| drawn.clone(), |total| share_out(total, &drawn));
    let targets = targets.iter().zip(&draws).map(|(target, draws)| target / draws);
    let mut jobs: Vec<Job> = (asset.meshes.iter_mut().zip(targets).zip(&scales).enumerate())
        .filter(|(_, ((named, _), _))| named.mesh.triangle_count() > 0)
        .map(|(index, ((named, target), &scale))| Job {
            index,
            name: &named.name,
            mesh: &mut named.mesh,
            floor: (target / MOST_CUT).max(FEWEST),
            target,
            scale,
            draws: draws[index],
            texels: texels[index],
            original: originals.get(index),
            report: None,
            proven: None,
            refit: None,
        })
        .collect();
    if let Some(total) = total.filter(|_| by_error) {
        spend_by_error(&mut jobs, &originals, total, options, control)?;
    }
    run(&mut jobs, options, control)?;
    if let Some(total) = total {
        settle(&mut jobs, total, options, control)?;
    }
    if let Some(refit) = options.refit.as_ref().filter(|_| !options.certify) {
        jobs.iter_mut().try_for_each(|job| job.refit_result(refit, options, control))?;
    }
    Ok(summary(jobs, &before, &draws, total))
}

/// How much each mesh is enlarged at most where it is drawn, posed at rest; 1 for a mesh that is not drawn or has no area.
/// Times this, distances in units of a mesh are distances in world units.
pub fn world_scales(asset: &Asset) -> Vec<f64> {
    let mut scales = vec![0.0_f64; asset.meshes.len()];
    for instance in &asset.instances {
        let mesh = &asset.meshes[instance.mesh].mesh;
        let scale = if instance.is_rigid() { longest_axis(&instance.transform) } else { posed_scale(instance, mesh) };
        scales[instance.mesh] = scales[instance.mesh].max(scale);
    }
    scales.iter().map(|&scale| if scale > 0.0 && scale.is_finite() { scale } else { 1.0 }).collect()
}

fn longest_axis(matrix: &DMat4) -> f64 {
    let linear = DMat3::from_mat4(*matrix);
    linear.x_axis.length().max(linear.y_axis.length()).max(linear.z_axis.length())
}

/// The root of how much the area of a mesh grows in its pose. The matrices of the joints would say too much: some move
/// nothing.
fn posed_scale(instance: &Instance, mesh: &Mesh) -> f64 {
    let place = |wedge| instance.posed_wedge(mesh, wedge).as_vec3().to_array();
    let posed = Mesh {
        positions: (0..mesh.wedge_count()).map(place).collect(),
        wedge_vertices: (0..mesh.wedge_count() as u32).collect(),
        triangles: mesh.triangles.clone(),
        ..Mesh::default()
    };
    (area(&posed) / area(mesh)).sqrt()
}

/// Shares `total` out over groups in proportion to their sizes (largest remainders), leaving each at least
/// [`FEWEST`] of its own, as far as the total allows.
fn share_out(total: usize, sizes: &[usize]) -> Vec<usize> {
    let sum: usize = sizes.iter().sum();
    if total >= sum {
        return sizes.to_vec();
    }
    let exact = |size: usize| total as u128 * size as u128;
    let mut shares: Vec<usize> = sizes.iter().map(|&size| (exact(size) / sum as u128) as usize).collect();
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(exact(sizes[i]) % sum as u128), i));
    let rest = total - shares.iter().sum::<usize>();
    order.iter().take(rest).for_each(|&i| shares[i] += 1);
    keep_visible(&mut shares, sizes);
    shares
}

/// Raises shares below the fewest, at the cost of the largest ones.
fn keep_visible(shares: &mut [usize], sizes: &[usize]) {
    let fewest = |i: usize| sizes[i].min(FEWEST);
    let mut order: Vec<usize> = (0..shares.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(shares[i]), i));
    let mut givers = order.iter();
    let mut giver = givers.next().copied();
    for i in 0..shares.len() {
        while shares[i] < fewest(i) {
            let Some(from) = giver else { return };
            let spare = shares[from].saturating_sub(fewest(from).max(1));
            let moved = spare.min(fewest(i) - shares[i]);
            shares[from] -= moved;
            shares[i] += moved;
            if moved == 0 {
                giver = givers.next().copied();
            }
        }
    }
}

struct Job<'a> {
    index: usize,
    name: &'a str,
    mesh: &'a mut Mesh,
    target: usize,
    /// Triangles that are left to it when others could not give theirs.
    floor: usize,
    scale: f64,
    /// How often the mesh counts in the total.
    draws: usize,
    /// Texels to a unit of texture coordinates, where that counts.
    texels: Option<f64>,
    /// The mesh as it was, where that is needed.
    original: Option<&'a Mesh>,
    report: Option<SimplifyReport>,
    /// The largest distance from the original that is proven, and that was found, in units of the mesh.
    proven: Option<[f64; 2]>,
    refit: Option<RefitReport>,
}

/// Simplifies each mesh to its share by size, to see how its costs rise, and sets the targets so that the next collapse
/// costs the same in all meshes. Those that have lost too much are as they were then.
fn spend_by_error(
    jobs: &mut [Job<'_>],
    originals: &[Mesh],
    total: usize,
    options: &AssetOptions,
    control: Control<'_>,
) -> Result<(), ProcessError> {
    run(jobs, options, control)?;
    let power = options.simplify.metric.cost_power(options.simplify.quadric_weight);
    let curves: Vec<Curve> = jobs.iter().map(|job| job.curve(&originals[job.index], power)).collect();
    let left = |level: f64| -> Vec<usize> { curves.iter().map(|curve| curve.left_at(level)).collect() };
    let drawn = |left: &[usize]| jobs.iter().zip(left).map(|(job, left)| job.draws * left).sum::<usize>();
    let level = lowest_level(&curves, |level| drawn(&left(level)) <= total);
    let mut targets = left(level);
    // what is over by rounding goes to those that the next lower level would give more
    let mut rest = total.saturating_sub(drawn(&targets));
    for ((target, job), curve) in targets.iter_mut().zip(jobs.iter()).zip(&curves) {
        let more = (rest / job.draws).min(curve.most().saturating_sub(*target)).min(*target / 16 + 1);
        *target += more;
        rest -= more * job.draws;
    }
    for (job, target) in jobs.iter_mut().zip(targets) {
        if target > job.mesh.triangle_count() {
            *job.mesh = originals[job.index].clone();
            job.report = None;
        }
        job.target = target.max(FEWEST);
        job.floor = (target / MOST_CUT).max(FEWEST);
    }
    Ok(())
}

/// How many triangles of a mesh are left while collapses cost at most so much, in world units.
struct Curve(Vec<CurvePoint>);

impl Curve {
    fn most(&self) -> usize {
        self.0[0].triangles
    }

    /// Triangles left at the logarithm of a cost.
    fn left_at(&self, level: f64) -> usize {
        let i = self.0.partition_point(|point| point.cost <= level);
        match (i.checked_sub(1).map(|i| self.0[i]), self.0.get(i)) {
            (None, _) => self.most(),
            // towards few triangles, costs rise with their third power (see the passes of the simplifier)
            (Some(last), None) => {
                let fewer = last.triangles as f64 * ((last.cost - level) / 3.0).exp();
                (fewer as usize).max(last.triangles / REACH).max(FEWEST.min(last.triangles))
            }
            (Some(a), Some(b)) => {
                let t = (level - a.cost) / (b.cost - a.cost);
                a.triangles - (t.clamp(0.0, 1.0) * (a.triangles - b.triangles) as f64) as usize
            }
        }
    }
}

/// The lowest level that is enough, by bisection.
fn lowest_level(curves: &[Curve], is_enough: impl Fn(f64) -> bool) -> f64 {
    let points = || curves.iter().flat_map(|curve| &curve.0).map(|point| point.cost);
    let (mut low, mut high) = points().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    high += 3.0 * (REACH as f64).ln();
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if is_enough(middle) { high = middle } else { low = middle }
    }
    high
}

/// Brings every mesh to its target, in parallel.
fn run(jobs: &mut [Job<'_>], options: &AssetOptions, control: Control<'_>) -> Result<(), ProcessError> {
    let gathered = Gathered::new(jobs, control);
    let done: Vec<_> = (jobs.par_iter_mut().enumerate())
        .map(|(slot, job)| {
            let report = |_: &str, done: f32| gathered.report(slot, done);
            let result = job.run(options, control.with_progress(&report));
            gathered.report(slot, 1.0);
            result.map_err(|error| ProcessError::Mesh { index: job.index, name: job.name.to_owned(), error })
        })
        .collect();
    // the first error by index, whichever thread met one first
    done.into_iter().collect()
}

/// Asks what some meshes could not give up of those that reached their target, down to their floor.
fn settle(
    jobs: &mut [Job<'_>],
    total: usize,
    options: &AssetOptions,
    control: Control<'_>,
) -> Result<(), ProcessError> {
    for _ in 0..ROUNDS {
        let count = |job: &Job<'_>| job.mesh.triangle_count();
        let excess = jobs.iter().map(|job| count(job) * job.draws).sum::<usize>().saturating_sub(total);
        let mut willing: Vec<&mut Job<'_>> = jobs.iter_mut().filter(|job| job.can_give()).collect();
        if excess == 0 || willing.is_empty() {
            break;
        }
        let sizes: Vec<usize> = willing.iter().map(|job| count(job) * job.draws).collect();
        let targets = share_out(sizes.iter().sum::<usize>().saturating_sub(excess), &sizes);
        let mut asked: Vec<Job<'_>> = (willing.iter_mut().zip(targets))
            .map(|(job, target)| {
                let target = (target / job.draws).max(job.floor);
                Job { target, mesh: &mut *job.mesh, report: job.report.take(), ..**job }
            })
            .collect();
        run(&mut asked, options, control)?;
        let results: Vec<_> = asked.into_iter().map(|job| (job.report, job.proven, job.refit)).collect();
        for (job, result) in willing.into_iter().zip(results) {
            (job.report, job.proven, job.refit) = result;
        }
    }
    Ok(())
}

impl Job<'_> {
    fn run(&mut self, options: &AssetOptions, control: Control<'_>) -> Result<(), SimplifyError> {
        if let (true, true, Some(original)) = (options.certify, self.report.is_some(), self.original) {
            self.mesh.clone_from(original); // what is proven counts from there
        }
        let mut own = options.simplify.clone();
        own.target.triangles = options.simplify.target.triangles.map(|_| self.target);
        own.target.max_error = options.simplify.target.max_error.map(|error| error / self.scale);
        own.join_distance = options.simplify.join_distance.map(|distance| distance / self.scale);
        options.roles.apply(self.mesh, self.texels, &mut own);
        if options.certify {
            return self.run_certified(own, options, control);
        }
        let report = match options.cluster {
            None => simplify(self.mesh, &own, control)?,
            Some(method) => clustered(self.mesh, method, own, control)?,
        };
        self.report = Some(match self.report.take() {
            Some(earlier) => joined(&earlier, &report),
            None => report,
        });
        Ok(())
    }

    /// How the costs have risen, as logarithms in world units, from all triangles on.
    fn curve(&self, original: &Mesh, power: i32) -> Curve {
        let scale = self.scale.powi(power);
        let level = |cost: f64| (cost * scale).max(f64::MIN_POSITIVE).ln();
        let start = CurvePoint { triangles: original.triangle_count(), cost: f64::MIN_POSITIVE.ln() };
        let points = self.report.iter().flat_map(|report| &report.curve);
        let own = points.map(|point| CurvePoint { cost: level(point.cost), ..*point });
        let end = self.mesh.triangle_count();
        let mut curve = vec![start];
        for point in own {
            let last = curve[curve.len() - 1];
            if point.triangles < last.triangles {
                curve.push(CurvePoint { cost: point.cost.max(last.cost), ..point });
            }
        }
        if let Some(last) = curve.last_mut().filter(|last| last.triangles > end) {
            last.triangles = end;
        }
        Curve(curve)
    }

    /// Simplifies with a proof, each trial fitted to the original where that is wanted.
    fn run_certified(
        &mut self,
        simplify: SimplifyOptions,
        options: &AssetOptions,
        control: Control<'_>,
    ) -> Result<(), SimplifyError> {
        let fit = |original: &Mesh, mesh: &mut Mesh| match &options.refit {
            Some(refit) => Ok(Some(fit(mesh, original, refit, options, control)?)),
            None => Ok(None),
        };
        let done = simplify_certified_with(self.mesh, &CertifiedOptions::new(simplify), fit, control)?;
        self.report = Some(done.simplify);
        self.proven = Some([done.proven, done.found]);
        self.refit = done.finished.flatten();
        Ok(())
    }

    /// Fits the result to what it was.
    fn refit_result(
        &mut self,
        refit: &RefitOptions,
        options: &AssetOptions,
        control: Control<'_>,
    ) -> Result<(), ProcessError> {
        let original = self.original.expect("kept where results are fitted");
        let done = fit(self.mesh, original, refit, options, control).map_err(|cancelled| ProcessError::Mesh {
            index: self.index,
            name: self.name.to_owned(),
            error: cancelled.into(),
        })?;
        self.refit = Some(done);
        Ok(())
    }

    fn can_give(&self) -> bool {
        self.mesh.triangle_count() > self.floor && self.report.as_ref().is_some_and(|r| r.stopped == Stop::Triangles)
    }
}

/// Clusters vertices, and tells it in the words of simplification.
fn clustered(
    mesh: &mut Mesh,
    method: ClusterMethod,
    options: SimplifyOptions,
    control: Control<'_>,
) -> Result<SimplifyReport, SimplifyError> {
    let SimplifyOptions { target, locked, importance, .. } = options;
    let own = ClusterOptions { triangles: target.triangles, max_error: target.max_error, method, locked, importance };
    let report = cluster(mesh, &own, control)?;
    let stopped = match target {
        Target { triangles: Some(wanted), .. } if report.triangles_out <= wanted => Stop::Triangles,
        Target { max_error: Some(_), .. } => Stop::MaxError,
        _ => Stop::Exhausted,
    };
    Ok(SimplifyReport {
        triangles_in: report.triangles_in,
        triangles_out: report.triangles_out,
        error: report.error,
        stopped,
        ..untouched()
    })
}

/// Fits a mesh to what it was; vertices that are locked stay.
fn fit(
    mesh: &mut Mesh,
    original: &Mesh,
    refit: &RefitOptions,
    options: &AssetOptions,
    control: Control<'_>,
) -> Result<RefitReport, Cancelled> {
    let own = RefitOptions { fixed: fixed(mesh, &options.roles, &options.simplify), ..refit.clone() };
    control.time("fitting", || maille::refit::refit(mesh, original, &own, control))
}

/// The vertices that may not move: what is locked by its attributes or lies on features that are.
pub(crate) fn fixed(mesh: &Mesh, roles: &AttributeRoles, options: &SimplifyOptions) -> Vec<bool> {
    let mut fixed = roles.locked(mesh);
    fixed.resize(mesh.vertex_count(), false);
    let lock_seams = options.seams == EdgePolicy::Lock;
    let lock_materials = options.material_borders == EdgePolicy::Lock;
    // what the first corner at each vertex has
    let mut first = vec![None; fixed.len()];
    for (t, wedges) in mesh.triangles.iter().enumerate() {
        for (&wedge, v) in wedges.iter().zip(mesh.triangle_vertices(t)) {
            let own = (wedge, mesh.triangle_material(t));
            let other = *first[v as usize].get_or_insert(own);
            fixed[v as usize] |= lock_seams && other.0 != own.0 || lock_materials && other.1 != own.1;
        }
    }
    fixed
}

/// Adds up the progress of meshes that run at the same time, weighted by their triangles.
struct Gathered<'a> {
    control: Control<'a>,
    weights: Vec<f64>,
    done: Mutex<Vec<f32>>,
}

impl<'a> Gathered<'a> {
    fn new(jobs: &[Job<'_>], control: Control<'a>) -> Self {
        let sizes = || jobs.iter().map(|job| job.mesh.triangle_count() as f64);
        let sum: f64 = sizes().sum();
        Self { control, weights: sizes().map(|size| size / sum).collect(), done: Mutex::new(vec![0.0; jobs.len()]) }
    }

    fn report(&self, slot: usize, done: f32) {
        let Ok(mut all) = self.done.lock() else { return };
        all[slot] = all[slot].max(done);
        let share: f64 = all.iter().zip(&self.weights).map(|(&done, weight)| f64::from(done) * weight).sum();
        self.control.report("simplifying", share as f32);
    }
}

fn joined(earlier: &SimplifyReport, later: &SimplifyReport) -> SimplifyReport {
    SimplifyReport {
        triangles_in: earlier.triangles_in,
        collapses: earlier.collapses + later.collapses,
        error: earlier.error.max(later.error),
        attributes: later.attributes.iter().map(|l| larger(earlier.attributes.iter(), l)).collect(),
        refused: sum(earlier.refused, later.refused),
        ..later.clone()
    }
}

/// An attribute's error, or a larger one of the same attribute.
fn larger<'a>(mut others: impl Iterator<Item = &'a AttributeError>, one: &AttributeError) -> AttributeError {
    let same = others.find(|other| other.semantic == one.semantic);
    AttributeError { error: same.map_or(one.error, |other| other.error.max(one.error)), ..one.clone() }
}

fn sum(a: Refusals, b: Refusals) -> Refusals {
    Refusals {
        topology: a.topology + b.topology,
        fold_over: a.fold_over + b.fold_over,
        normal_deviation: a.normal_deviation + b.normal_deviation,
        border: a.border + b.border,
        locked: a.locked + b.locked,
        valence: a.valence + b.valence,
        quality: a.quality + b.quality,
        texture: a.texture + b.texture,
        self_intersections: a.self_intersections + b.self_intersections,
    }
}

fn summary(jobs: Vec<Job<'_>>, before: &[usize], draws: &[usize], total: Option<usize>) -> AssetReport {
    let mut meshes: Vec<SimplifyReport> = before.iter().map(|_| untouched()).collect();
    let mut error = 0.0_f64;
    let mut attributes: Vec<AttributeError> = Vec::new();
    let mut refits = Vec::new();
    let mut proven: Option<[f64; 2]> = None;
    for job in jobs {
        let scaled = |done: RefitReport| RefitReport {
            rms_before: done.rms_before * job.scale,
            rms_after: done.rms_after * job.scale,
            max_before: done.max_before * job.scale,
            max_after: done.max_after * job.scale,
        };
        refits.extend(job.refit.map(scaled));
        if let Some(own) = job.proven {
            let [bound, found] = proven.unwrap_or_default();
            proven = Some([bound.max(own[0] * job.scale), found.max(own[1] * job.scale)]);
        }
        let report = job.report.expect("every job has run");
        error = error.max(report.error * job.scale);
        for own in &report.attributes {
            let own = AttributeError { weight: own.weight * job.scale, ..own.clone() };
            match attributes.iter_mut().find(|known| known.semantic == own.semantic) {
                Some(known) => {
                    (known.error, known.weight) = (known.error.max(own.error), known.weight.max(own.weight));
                }
                None => attributes.push(own),
            }
        }
        meshes[job.index] = report;
    }
    let drawn = |counts: &mut dyn Iterator<Item = usize>| counts.zip(draws).map(|(n, draws)| n * draws).sum();
    let triangles_out = drawn(&mut meshes.iter().map(|report| report.triangles_out));
    let others = meshes.iter().filter(|report| report.triangles_in > 0 && report.stopped != Stop::Triangles);
    let stopped = match total {
        Some(total) if triangles_out <= total => Stop::Triangles,
        _ => others.max_by_key(|report| report.triangles_out).map_or(Stop::Triangles, |report| report.stopped),
    };
    AssetReport {
        triangles_in: drawn(&mut before.iter().copied()),
        triangles_out,
        collapses: meshes.iter().map(|report| report.collapses).sum(),
        error,
        attributes,
        stopped,
        refused: meshes.iter().fold(Refusals::default(), |all, report| sum(all, report.refused)),
        refits,
        max_error_proven: proven.map(|[bound, _]| bound),
        max_error_found: proven.map(|[_, found]| found),
        meshes,
    }
}

/// The report of a mesh without triangles.
fn untouched() -> SimplifyReport {
    SimplifyReport {
        triangles_in: 0,
        triangles_out: 0,
        collapses: 0,
        error: 0.0,
        curve: Vec::new(),
        attributes: Vec::new(),
        stopped: Stop::Exhausted,
        refused: Refusals::default(),
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use maille::{Attribute, Semantic};
    use proptest::prelude::*;

    use super::*;
    use crate::Mask;

    #[test]
    fn shares_are_proportional_and_leave_small_meshes_visible() {
        assert_eq!(share_out(100, &[500, 300, 200]), [50, 30, 20]);
        assert_eq!(share_out(1000, &[10, 20]), [10, 20]);
        assert_eq!(share_out(100, &[10_000, 12, 2]), [94, 4, 2]);
        assert_eq!(share_out(0, &[5, 5]), [0, 0]);
    }

    #[test]
    fn each_mesh_of_an_asset_is_proven_in_world_units() {
        use maille::measure::{ExactOptions, hausdorff};
        let mut asset = Asset::from_mesh("near", maille::mesh::shapes::sphere(5));
        let far = Asset::from_mesh("far", maille::mesh::shapes::torus(3.0, 1.0, 60, 30));
        asset.meshes.extend(far.meshes);
        asset.instances.extend(far.instances.into_iter().map(|instance| Instance { mesh: 1, ..instance }));
        asset.instances[1].transform = DMat4::from_scale(DVec3::splat(4.0));
        let originals: Vec<Mesh> = asset.meshes.iter().map(|named| named.mesh.clone()).collect();
        let mut options =
            AssetOptions { certify: true, refit: Some(RefitOptions::default()), ..AssetOptions::default() };
        assert!(matches!(simplify_asset(&mut asset, &options, Control::default()), Err(ProcessError::NothingToProve)));
        options.simplify.target.max_error = Some(0.02);
        for triangles in [None, Some(3000)] {
            options.simplify.target.triangles = triangles;
            (asset.meshes.iter_mut().zip(&originals)).for_each(|(named, original)| named.mesh = original.clone());
            let report = simplify_asset(&mut asset, &options, Control::default()).expect("the options make sense");
            let proven = report.max_error_proven.expect("it was asked for");
            assert!(proven > 0.0 && proven <= 0.02 && report.refits.len() == 2, "{report:?}");
            for ((named, original), scale) in asset.meshes.iter().zip(&originals).zip([1.0, 4.0]) {
                let exact = hausdorff(original, &named.mesh, &ExactOptions::default(), Control::default());
                let exact = exact.expect("both are sound");
                assert!(exact.lower() * scale <= proven, "{} beside {proven}", exact.lower() * scale);
            }
        }
    }

    proptest! {
        #[test]
        fn shares_add_up_and_exceed_no_mesh(
            sizes in prop::collection::vec(0_usize..5000, 1..30), ratio in 0.0..1.0_f64
        ) {
            let total = (ratio * sizes.iter().sum::<usize>() as f64) as usize;
            let shares = share_out(total, &sizes);
            prop_assert_eq!(shares.iter().sum::<usize>(), total);
            prop_assert!(shares.iter().zip(&sizes).all(|(share, size)| share <= size));
        }
    }

    #[test]
    fn what_is_locked_stays_when_the_rest_is_fitted() {
        let mut mesh = maille::mesh::shapes::sphere(4);
        let locks = mesh.positions.iter().map(|p| if p[2] > 0.9 { 1.0 } else { 0.0 }).collect();
        mesh.vertex_attributes.push(Attribute::new_f32(Semantic::Custom("keep".to_owned()), 1, locks));
        let cap: Vec<[f32; 3]> = mesh.positions.iter().copied().filter(|p| p[2] > 0.9).collect();
        let mut asset = Asset::from_mesh("sphere", mesh);
        let mut options = AssetOptions {
            roles: AttributeRoles { lock: Some(Mask::Attribute("keep".to_owned())), ..AttributeRoles::default() },
            ..AssetOptions::default()
        };
        options.refit = Some(RefitOptions::default());
        options.simplify.target.triangles = Some(400);
        let report = simplify_asset(&mut asset, &options, Control::default()).unwrap();
        assert!(report.refits.len() == 1 && report.refits[0].rms_after < report.refits[0].rms_before, "{report:?}");
        assert!(cap.iter().all(|p| asset.meshes[0].mesh.positions.contains(p)));
    }

    #[test]
    fn fitting_is_told_in_world_units() {
        let fitted = |scale: f64| {
            let mut asset = Asset::from_mesh("sphere", maille::mesh::shapes::sphere(4));
            asset.instances[0].transform = DMat4::from_scale(DVec3::splat(scale));
            let mut options = AssetOptions { refit: Some(RefitOptions::default()), ..AssetOptions::default() };
            options.simplify.target.triangles = Some(400);
            simplify_asset(&mut asset, &options, Control::default()).unwrap().refits[0]
        };
        let (small, large) = (fitted(1.0), fitted(1024.0));
        assert_eq!((large.rms_before, large.max_after), (1024.0 * small.rms_before, 1024.0 * small.max_after));
    }

    #[test]
    fn joints_that_move_nothing_do_not_count_in_the_scale() {
        let mut mesh = maille::mesh::shapes::cube();
        let wedges = mesh.wedge_count();
        mesh.wedge_attributes.push(Attribute::new_u32(Semantic::Joints(0), 4, vec![0; 4 * wedges]));
        mesh.wedge_attributes.push(Attribute::new_f32(Semantic::Weights(0), 4, [1.0, 0.0, 0.0, 0.0].repeat(wedges)));
        let mut asset = Asset::from_mesh("cube", mesh);
        asset.instances[0].joint_matrices = Some([DMat4::from_scale(DVec3::splat(0.01)), DMat4::IDENTITY].into());
        assert!((world_scales(&asset)[0] - 0.01).abs() < 1e-6);
        asset.instances[0].joint_matrices = None;
        asset.instances[0].transform = DMat4::from_scale(DVec3::new(1.0, 2.0, 3.0));
        assert!((world_scales(&asset)[0] - 3.0).abs() < 1e-12);
    }
}
