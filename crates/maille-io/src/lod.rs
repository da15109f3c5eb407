//! Chains of levels of detail of whole assets.

use maille::control::Cancelled;
use maille::lod::{Correspondence, Geomorph, GeomorphOptions};
use maille::mesh::MorphTarget;
use maille::progressive::ProgressiveMesh;
use maille::refit::{PosedRefitOptions, RefitOptions, refit, refit_in_poses};
use maille::simplify::{SimplifyError, SimplifyOptions, Target};
use maille::skin::Pose;
use maille::{Attribute, Control, Mesh, Semantic};
use rayon::prelude::*;

use crate::process::{FEWEST, ProcessError, world_scales};
use crate::{Asset, PoseSet, order_for_display, poses_of};

/// How to make a chain of levels.
#[derive(Debug, Clone, Default)]
pub struct LodOptions {
    /// How to simplify each mesh. The target is not looked at.
    pub simplify: SimplifyOptions,
    /// The triangles of each level as it is drawn, finest first; the original is not among them.
    pub levels: Vec<usize>,
    /// In which poses the metric looks at the surface.
    pub poses: PoseSet,
    /// Whether the vertices of each level are fitted to the original: positions and weights of joints over the poses, if there
    /// are some, else positions where they are stored.
    pub refit: bool,
    /// Whether each level, the original among them, gets a morph target that takes it to the next.
    pub geomorph: bool,
}

/// Levels of detail of an asset, finest first, without the original.
#[derive(Debug, Clone, Default)]
pub struct LodChain {
    /// The meshes of the asset as they are with a morph target to the first level, in the order of [`Asset::meshes`]; empty
    /// without geomorphs.
    pub original: Vec<Mesh>,
    /// The levels.
    pub levels: Vec<LodLevel>,
    /// Diagonal of the box around the model, in world units.
    pub diameter: f64,
}

impl LodChain {
    /// The screen coverage down to which each level is good, the original first: the size of the model, as a share of the
    /// height of a picture of 1080 lines, at which the error of the next level is one pixel; last, where the model itself
    /// is one. Never rising.
    pub fn screen_coverage(&self) -> Vec<f64> {
        let lines = 1080.0;
        let of_next = |level: &LodLevel| (self.diameter / (level.error * lines)).min(1.0);
        let mut least = 1.0_f64;
        let mut falling = |coverage: f64| {
            least = least.min(if coverage.is_finite() { coverage } else { 1.0 });
            least
        };
        let mut all: Vec<f64> = self.levels.iter().map(|level| falling(of_next(level))).collect();
        all.push(falling(1.0 / lines));
        all
    }
}

impl Asset {
    /// The asset as a glTF whose nodes list the levels of a chain that was made of it (`MSFT_lod`). Skins, materials and clips
    /// are shared.
    pub fn with_levels(&self, chain: &LodChain) -> Self {
        crate::gltf::with_levels(self, chain)
    }

    /// The asset with its meshes as they are at a level of a chain that was made of it.
    pub fn at_level(&self, level: &LodLevel) -> Self {
        let mut asset = self.clone();
        asset.meshes.iter_mut().zip(&level.meshes).for_each(|(named, mesh)| named.mesh = mesh.clone());
        asset
    }
}

/// A level of detail.
#[derive(Debug, Clone, Default)]
pub struct LodLevel {
    /// The meshes, in the order of [`Asset::meshes`].
    pub meshes: Vec<Mesh>,
    /// Triangles drawn.
    pub triangles: usize,
    /// Largest error of a collapse by the metric's estimate, in world units.
    pub error: f64,
    /// What each wedge of the level before (for the first level: of [`LodChain::original`]) becomes in this one, mesh by mesh;
    /// empty without geomorphs. For an engine's own [`Geomorph`], which moves more than a morph target can.
    pub correspondences: Vec<Correspondence>,
}

/// A mesh with all its levels, and what its costs are in world units.
struct Part {
    progressive: ProgressiveMesh,
    poses: Vec<Pose>,
    /// Factor on distances.
    scale: f64,
    /// Factor on costs.
    unit: f64,
    draws: usize,
    /// The collapses that lead to each level.
    at: Vec<usize>,
    /// The meshes of the levels.
    levels: Vec<Mesh>,
    /// From each of them to the next; none without geomorphs.
    correspondences: Vec<Correspondence>,
}

impl Part {
    /// How many collapses cost at most so much, in world units.
    fn collapses_within(&self, cost: f64) -> usize {
        let cheap = self.progressive.costs().partition_point(|&own| f64::from(own) * self.unit <= cost);
        self.progressive.whole(cheap).min(self.most_collapses())
    }

    /// How many there may be at most: none of the meshes vanishes.
    fn most_collapses(&self) -> usize {
        let least = FEWEST.min(self.progressive.counts_at(0).triangles as usize);
        let has_enough = |at: usize| self.progressive.counts_at(at).triangles as usize >= least;
        let places = (0..=self.progressive.collapses_to(least)).rev();
        places.into_iter().find(|&at| has_enough(at) && self.progressive.whole(at) == at).unwrap_or(0)
    }

    fn drawn_at(&self, collapses: usize) -> usize {
        self.progressive.counts_at(collapses).triangles as usize * self.draws
    }
}

/// Makes the levels of an asset: each of its meshes is simplified once, all the way, and every level is a moment of that; all
/// meshes at a level have got there at the same cost, in world units, as if they were one mesh.
///
/// # Errors
/// [`ProcessError`].
pub fn lod_chain(asset: &Asset, options: &LodOptions, control: Control<'_>) -> Result<LodChain, ProcessError> {
    if asset.triangle_count() == 0 {
        return Err(ProcessError::NoTriangles);
    }
    let poses = control.time("poses", || poses_of(asset, &options.poses));
    let power = options.simplify.metric.cost_power(options.simplify.quadric_weight);
    let refused =
        |index: usize| move |error| ProcessError::Mesh { index, name: asset.meshes[index].name.clone(), error };
    let (scales, draws) = (world_scales(asset), asset.draws());
    let part = |index: usize| {
        let target = Target { triangles: Some(0), max_error: None };
        let poses: Vec<Pose> = poses[index].clone();
        let simplify = SimplifyOptions { poses: poses.clone(), target, ..options.simplify.clone() };
        let made = ProgressiveMesh::new(asset.meshes[index].mesh.clone(), &simplify, control);
        let (progressive, _) = made.map_err(refused(index))?;
        let scale = scales[index];
        let (unit, draws) = (scale.powi(power), draws[index]);
        Ok(Part {
            progressive,
            poses,
            scale,
            unit,
            draws,
            at: Vec::new(),
            levels: Vec::new(),
            correspondences: Vec::new(),
        })
    };
    let parts = (0..asset.meshes.len()).into_par_iter().map(part);
    let mut parts: Vec<Part> = parts.collect::<Result<_, ProcessError>>()?;
    for &target in &options.levels {
        let at = collapses_for(&parts, target);
        parts.iter_mut().zip(at).for_each(|(part, at)| part.at.push(at));
    }
    let each = parts.par_iter_mut().zip(&asset.meshes).enumerate();
    each.try_for_each(|(index, (part, named))| {
        let cancelled = |error| refused(index)(SimplifyError::Cancelled(error));
        part.make_levels(&named.mesh, options, control).map_err(cancelled)
    })?;
    let levels = (0..options.levels.len()).map(|k| {
        let errors = parts.iter().map(|part| part.progressive.error_at(part.at[k]) * part.scale);
        LodLevel {
            triangles: parts.iter().map(|part| part.drawn_at(part.at[k])).sum(),
            error: errors.fold(0.0, f64::max),
            ..LodLevel::default()
        }
    });
    let mut chain =
        LodChain { levels: levels.collect(), original: Vec::new(), diameter: asset.merged_positions().diagonal() };
    for part in parts {
        let mut meshes = part.levels.into_iter();
        if options.geomorph {
            chain.original.extend(meshes.next());
        }
        chain.levels.iter_mut().zip(meshes).for_each(|(level, mesh)| level.meshes.push(mesh));
        let correspondences = chain.levels.iter_mut().zip(part.correspondences);
        correspondences.for_each(|(level, correspondence)| level.correspondences.push(correspondence));
    }
    Ok(chain)
}

impl Part {
    /// Makes the meshes of all levels: cut out, fitted, in the order for display, and with what it takes to morph each into the
    /// next; before them the original, if it is to be morphed, too.
    fn make_levels(&mut self, original: &Mesh, options: &LodOptions, control: Control<'_>) -> Result<(), Cancelled> {
        let first = options.geomorph.then_some(0);
        let places: Vec<usize> = first.into_iter().chain(self.at.iter().copied()).collect();
        let mut levels: Vec<Mesh> = Vec::new();
        for (i, &at) in places.iter().enumerate() {
            self.progressive.seek(at);
            let mut mesh = self.progressive.to_mesh();
            let is_original = options.geomorph && i == 0;
            if options.refit && !is_original {
                self.refit(&mut mesh, original, control)?;
            }
            levels.push(mesh);
        }
        let mut correspondences = Vec::new();
        if options.geomorph {
            for (pair, meshes) in places.windows(2).zip(levels.windows(2)) {
                let meshes = [&meshes[0], &meshes[1]];
                correspondences.push(self.progressive.correspondence([pair[0], pair[1]], meshes));
            }
        }
        let orders: Vec<Vec<u32>> = levels.iter_mut().map(order_for_display).collect();
        for (k, correspondence) in correspondences.into_iter().enumerate() {
            let correspondence = correspondence.reordered(&orders[k], &orders[k + 1]);
            let geomorph = Geomorph::new(&levels[k], &levels[k + 1], &correspondence, &GeomorphOptions::default());
            let geomorph = geomorph.expect("the correspondence is of these levels");
            levels[k].morph_targets.push(geomorph.deltas());
            self.correspondences.push(correspondence);
        }
        if let (Some(last), true, false) = (levels.last_mut(), options.geomorph, original.morph_targets.is_empty()) {
            // clips that turn blend shapes on and off want the same number of them in each level
            let nothing = Attribute::new_f32(Semantic::Position, 3, vec![0.0; 3 * last.wedge_count()]);
            last.morph_targets.push(MorphTarget { name: "geomorph".into(), attributes: vec![nothing] });
        }
        self.levels = levels;
        Ok(())
    }

    fn refit(&self, mesh: &mut Mesh, original: &Mesh, control: Control<'_>) -> Result<(), Cancelled> {
        if self.poses.is_empty() {
            refit(mesh, original, &RefitOptions::default(), control).map(drop)
        } else {
            refit_in_poses(mesh, original, &self.poses, &PosedRefitOptions::default(), control).map(drop)
        }
    }
}

/// How far each mesh has to be simplified so that at most so many triangles are drawn, if that is possible.
fn collapses_for(parts: &[Part], target: usize) -> Vec<usize> {
    let at = |cost: f64| -> Vec<usize> { parts.iter().map(|part| part.collapses_within(cost)).collect() };
    let drawn = |at: &[usize]| parts.iter().zip(at).map(|(part, &at)| part.drawn_at(at)).sum::<usize>();
    let costs = parts.iter().flat_map(|part| part.progressive.costs().iter().map(|&cost| f64::from(cost) * part.unit));
    let mut costs: Vec<f64> = costs.collect();
    costs.sort_unstable_by(f64::total_cmp);
    costs.dedup();
    // the lowest cost that is enough; collapses of one mesh at that cost, so that no more go than must
    let enough = costs.partition_point(|&cost| drawn(&at(cost)) > target);
    let Some(&cost) = costs.get(enough) else { return parts.iter().map(Part::most_collapses).collect() };
    let before = enough.checked_sub(1).map_or_else(|| vec![0; parts.len()], |i| at(costs[i]));
    let mut now = before;
    for (i, part) in parts.iter().enumerate() {
        let last = part.collapses_within(cost);
        while drawn(&now) > target && now[i] < last {
            now[i] = part.progressive.whole(now[i] + 1);
        }
    }
    now
}
