//! Chains of levels of detail of whole assets.

use maille::control::Cancelled;
use maille::lod::{Geomorph, GeomorphOptions};
use maille::mesh::MorphTarget;
use maille::refit::{PosedRefitOptions, RefitOptions, refit, refit_in_poses};
use maille::simplify::{SimplifyError, SimplifyOptions};
use maille::skin::Pose;
use maille::{Attribute, Control, Mesh, Semantic};
use rayon::prelude::*;

use crate::process::ProcessError;
use crate::progressive::{Part, collapses_for, drawn_at, error_at, parts_of, refusal};
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
}

/// A mesh with all its levels, and those of the chain.
struct Member {
    part: Part,
    poses: Vec<Pose>,
    /// The collapses that lead to each level.
    at: Vec<usize>,
    /// The meshes of the levels.
    levels: Vec<Mesh>,
}

/// Makes the levels of an asset: each of its meshes is simplified once, all the way, and every level is a moment of that; all
/// meshes at a level have got there at the same cost, in world units, as if they were one mesh.
///
/// # Errors
/// [`ProcessError`].
pub fn lod_chain(asset: &Asset, options: &LodOptions, control: Control<'_>) -> Result<LodChain, ProcessError> {
    let poses = control.time("poses", || poses_of(asset, &options.poses));
    let parts = parts_of(asset, &options.simplify, &poses, control)?;
    let member = |(part, poses)| Member { part, poses, at: Vec::new(), levels: Vec::new() };
    let mut members: Vec<Member> = parts.into_iter().zip(poses).map(member).collect();
    let mut levels = Vec::new();
    for &target in &options.levels {
        let parts: Vec<&Part> = members.iter().map(|member| &member.part).collect();
        let at = collapses_for(&parts, target);
        let parts = || parts.iter().copied();
        let (triangles, error) = (drawn_at(parts(), &at), error_at(parts(), &at));
        levels.push(LodLevel { triangles, error, meshes: Vec::new() });
        members.iter_mut().zip(at).for_each(|(member, at)| member.at.push(at));
    }
    let each = members.par_iter_mut().zip(&asset.meshes).enumerate();
    each.try_for_each(|(index, (member, named))| {
        let cancelled = |error| refusal(asset, index)(SimplifyError::Cancelled(error));
        member.make_levels(&named.mesh, options, control).map_err(cancelled)
    })?;
    let mut chain = LodChain { levels, original: Vec::new(), diameter: asset.merged_positions().diagonal() };
    for member in members {
        let mut meshes = member.levels.into_iter();
        if options.geomorph {
            chain.original.extend(meshes.next());
        }
        chain.levels.iter_mut().zip(meshes).for_each(|(level, mesh)| level.meshes.push(mesh));
    }
    Ok(chain)
}

impl Member {
    /// Makes the meshes of all levels: cut out, fitted, in the order for display, and with what it takes to morph each into the
    /// next; before them the original, if it is to be morphed, too.
    fn make_levels(&mut self, original: &Mesh, options: &LodOptions, control: Control<'_>) -> Result<(), Cancelled> {
        let first = options.geomorph.then_some(0);
        let places: Vec<usize> = first.into_iter().chain(self.at.iter().copied()).collect();
        let mut levels: Vec<Mesh> = Vec::new();
        for (i, &at) in places.iter().enumerate() {
            self.part.mesh.seek(at);
            let mut mesh = self.part.mesh.to_mesh();
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
                correspondences.push(self.part.mesh.correspondence([pair[0], pair[1]], meshes));
            }
        }
        let orders: Vec<Vec<u32>> = levels.iter_mut().map(order_for_display).collect();
        for (k, correspondence) in correspondences.into_iter().enumerate() {
            let correspondence = correspondence.reordered(&orders[k], &orders[k + 1]);
            let geomorph = Geomorph::new(&levels[k], &levels[k + 1], &correspondence, &GeomorphOptions::default());
            let geomorph = geomorph.expect("the correspondence is of these levels");
            levels[k].morph_targets.push(geomorph.deltas());
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
