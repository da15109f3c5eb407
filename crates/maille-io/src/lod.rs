//! Chains of levels of detail of whole assets.

use glam::Vec3;
use maille::control::Cancelled;
use maille::lod::{Correspondence, Geomorph, GeomorphOptions};
use maille::measure::{CompareOptions, compare};
use maille::mesh::{MorphTarget, Values};
use maille::refit::{PosedRefitOptions, RefitOptions, refit, refit_in_poses};
use maille::simplify::SimplifyError;
use maille::skin::Pose;
use maille::{Attribute, Control, Mesh, Semantic};
use rayon::prelude::*;

use crate::process::{ProcessError, fixed, world_scales};
use crate::progressive::{Part, collapses_for, error_at, parts_of, refusal};
use crate::{Asset, CollapseOptions, PoseSet, order_for_display, poses_of};

/// Lines of the pictures that screen coverages are about.
pub(crate) const LINES: f64 = 1080.0;
/// Samples by which levels are measured that come from elsewhere.
const SAMPLES: u64 = 200_000;

/// How to make a chain of levels.
#[derive(Debug, Clone, Default)]
pub struct LodOptions {
    /// How edges collapse.
    pub collapse: CollapseOptions,
    /// What each level is to be, finest first; the original is not among them. One that is no coarser than the level before is
    /// left out, unless it is given as meshes.
    pub levels: Vec<LevelTarget>,
    /// In which poses the metric looks at the surface.
    pub poses: PoseSet,
    /// Whether the vertices of each level are fitted to the original: positions and weights of joints over the poses, if there
    /// are some, else positions where they are stored.
    pub refit: bool,
    /// How each level, the original among them, tells its way to the next.
    pub geomorph: GeomorphForm,
    /// How many pixels the error of a level may take where it is switched to.
    pub pixels: Pixels,
}

/// A number of pixels in a picture of 1080 lines; one by default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixels(pub f64);

impl Default for Pixels {
    fn default() -> Self {
        Self(1.0)
    }
}

/// What a level is to be.
#[derive(Debug, Clone, PartialEq)]
pub enum LevelTarget {
    /// At most so many triangles drawn.
    Triangles(usize),
    /// As few triangles as an error by the metric's estimate leaves, in world units.
    Error(f64),
    /// As few triangles as leave an error of [`LodOptions::pixels`] where the model covers so large a share of the height of a
    /// picture.
    Screen(f64),
    /// Meshes from elsewhere.
    Meshes {
        /// In place of [`Asset::meshes`], one by one, with their joints and material slots.
        meshes: Vec<Mesh>,
        /// In world units; `None`: the largest distance from the original counts, sampled.
        error: Option<f64>,
    },
}

/// How a level tells its way to the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GeomorphForm {
    /// By a morph target named `geomorph`: at weight 1, the mesh is the next level.
    pub target: bool,
    /// By attributes named `_MORPH_POSITION` and so on: what each wedge becomes.
    pub attributes: bool,
    /// Every vertex takes the joints and weights of what it becomes, from the coarsest level up to the original: then the
    /// morph target is exact in every pose, and only the coarsest level moves as it did.
    pub merge_weights: bool,
}

impl GeomorphForm {
    /// Whether the levels tell their ways at all.
    pub fn is_some(&self) -> bool {
        self.target || self.attributes || self.merge_weights
    }
}

/// Levels of detail of an asset, finest first, without the original.
#[derive(Debug, Clone, Default)]
pub struct LodChain {
    /// The meshes of the asset as they are with a way to the first level, in the order of [`Asset::meshes`]; empty
    /// without geomorphs.
    pub original: Vec<Mesh>,
    /// The levels.
    pub levels: Vec<LodLevel>,
    /// Diagonal of the box around the model, in world units.
    pub diameter: f64,
    /// How many pixels the error of a level may take where it is switched to.
    pub pixels: Pixels,
}

impl LodChain {
    /// The screen coverage down to which each level is good, the original first: the size of the model, as a share of the
    /// height of a picture of 1080 lines, at which the error of the next level is as many pixels as are allowed; last, where
    /// the model itself is one. Never rising.
    pub fn screen_coverage(&self) -> Vec<f64> {
        let of_next = |level: &LodLevel| (self.diameter * self.pixels.0 / (level.error * LINES)).min(1.0);
        let mut least = 1.0_f64;
        let mut falling = |coverage: f64| {
            least = least.min(if coverage.is_finite() { coverage } else { 1.0 });
            least
        };
        let mut all: Vec<f64> = self.levels.iter().map(|level| falling(of_next(level))).collect();
        all.push(falling(1.0 / LINES));
        all
    }

    /// The distance from which on a level is good enough for a camera with a vertical field of view in radians: there its error
    /// is as many pixels as are allowed.
    pub fn switch_distance(&self, level: &LodLevel, field_of_view: f64) -> f64 {
        level.error * LINES / (2.0 * self.pixels.0 * (field_of_view / 2.0).tan())
    }
}

/// A level of detail.
#[derive(Debug, Clone, Default)]
pub struct LodLevel {
    /// The meshes, in the order of [`Asset::meshes`].
    pub meshes: Vec<Mesh>,
    /// Triangles drawn.
    pub triangles: usize,
    /// Largest error of a collapse by the metric's estimate, in world units; of a level from elsewhere, what was said of it, or its
    /// largest distance from the original, sampled.
    pub error: f64,
    /// Which of [`LodOptions::levels`] it is.
    pub target: usize,
    /// How far at most, in world units and over the poses that were looked at, the morph target of the level before (of the
    /// original, for the first) ends from this one: weights of joints and other morph targets do not change on the way.
    /// `None` without geomorphs.
    pub residual: Option<f64>,
    /// What each wedge of the level before (for the first level: of [`LodChain::original`]) becomes in this one, mesh by mesh;
    /// empty without geomorphs. For an engine's own [`Geomorph`], which moves more than a morph target can.
    pub correspondences: Vec<Correspondence>,
}

impl Asset {
    /// The asset as a glTF whose nodes list the levels of a chain that was made of it (`MSFT_lod`). Skins, materials and clips
    /// are shared.
    pub fn with_levels(&self, chain: &LodChain) -> Self {
        crate::gltf::with_levels(self, chain, false)
    }

    /// The asset as a glTF with a node to each level of a chain that was made of it, all in the scene and named as engines
    /// know levels: `NAME_LOD0`, `NAME_LOD1` and so on. Skins, materials and clips are shared.
    pub fn with_named_levels(&self, chain: &LodChain) -> Self {
        crate::gltf::with_levels(self, chain, true)
    }

    /// The asset with its meshes as they are at a level of a chain that was made of it.
    pub fn at_level(&self, level: &LodLevel) -> Self {
        crate::gltf::at_level(self, &level.meshes)
    }

    /// The asset without the levels of detail that its nodes list (`MSFT_lod`), and the levels, finest first, without
    /// geomorphs; `None` if there are none. Their errors are those that Maille wrote, or those that are a pixel at the screen
    /// coverages that the file tells; 0 without these.
    ///
    /// # Errors
    /// In words, if what is listed are no levels of single meshes.
    pub fn split_levels(&self) -> Option<Result<(Self, Vec<LodLevel>), String>> {
        crate::gltf::split_levels(self)
    }
}

/// A mesh with all its levels, and those of the chain.
struct Member {
    part: Part,
    poses: Vec<Pose>,
    /// The meshes of the levels, the original first if there are geomorphs.
    levels: Vec<Mesh>,
    /// From each of them to the next, and how far its morph target ends from there; none without geomorphs.
    ways: Vec<(Correspondence, f64)>,
}

/// What a level is made of.
enum Source<'a> {
    /// So many collapses of each mesh.
    Collapses(Vec<usize>),
    Meshes(&'a [Mesh]),
}

/// Makes the levels of an asset: each of its meshes is simplified once, all the way, and every level is a moment of that; all
/// meshes at a level have got there at the same cost, in world units, as if they were one mesh.
///
/// Between levels that come from elsewhere, correspondences are found by nearest points ([`Correspondence::closest`]).
///
/// # Errors
/// [`ProcessError`].
pub fn lod_chain(asset: &Asset, options: &LodOptions, control: Control<'_>) -> Result<LodChain, ProcessError> {
    for (level, target) in options.levels.iter().enumerate() {
        if let LevelTarget::Meshes { meshes, .. } = target {
            check_given(asset, meshes).map_err(|reason| ProcessError::Level { level: level + 1, reason })?;
        }
    }
    let poses = control.time("poses", || poses_of(asset, &options.poses));
    let collapses = options.levels.iter().any(|target| !matches!(target, LevelTarget::Meshes { .. }));
    let coarsest = if collapses { 0 } else { usize::MAX };
    let parts = parts_of(asset, &options.collapse, &poses, coarsest, control)?;
    let mut chain =
        LodChain { diameter: asset.merged_positions().diagonal(), pixels: options.pixels, ..LodChain::default() };
    let sources = choose(asset, &parts, options, &mut chain, control)?;
    let member = |(part, poses)| Member { part, poses, levels: Vec::new(), ways: Vec::new() };
    let mut members: Vec<Member> = parts.into_iter().zip(poses).map(member).collect();
    let each = members.par_iter_mut().enumerate();
    each.try_for_each(|(index, member)| {
        let made = member.make_levels(asset, index, &sources, options, control);
        made.map_err(|error| refusal(asset, index)(SimplifyError::Cancelled(error)))
    })?;
    for member in members {
        let mut meshes = member.levels.into_iter();
        if options.geomorph.is_some() {
            chain.original.extend(meshes.next());
        }
        chain.levels.iter_mut().zip(meshes).for_each(|(level, mesh)| level.meshes.push(mesh));
        for (level, (correspondence, residual)) in chain.levels.iter_mut().zip(member.ways) {
            level.correspondences.push(correspondence);
            level.residual = Some(level.residual.unwrap_or(0.0).max(residual));
        }
    }
    let draws = asset.draws();
    for level in &mut chain.levels {
        let drawn = level.meshes.iter().zip(&draws).map(|(mesh, draws)| mesh.triangle_count() * draws);
        level.triangles = drawn.sum();
    }
    Ok(chain)
}

/// Whether meshes can stand for those of an asset; what is wrong, in words.
fn check_given(asset: &Asset, meshes: &[Mesh]) -> Result<(), String> {
    if meshes.len() != asset.meshes.len() {
        return Err(format!("{} meshes cannot stand for {}", meshes.len(), asset.meshes.len()));
    }
    for (mesh, named) in meshes.iter().zip(&asset.meshes) {
        let name = &named.name;
        mesh.check().map_err(|error| format!("the mesh for '{name}' is not valid: {error}"))?;
        if !mesh.positions.as_flattened().iter().all(|x| x.is_finite()) {
            return Err(format!("the mesh for '{name}' has positions that are not finite"));
        }
        let targets = |mesh: &Mesh| mesh.morph_targets.len();
        let (found, expected) = (targets(mesh), targets(&named.mesh));
        if found != expected {
            return Err(format!("the mesh for '{name}' has {found} morph targets, not {expected}"));
        }
    }
    Ok(())
}

/// What each level is made of; puts the levels, still empty, into the chain.
fn choose<'a>(
    asset: &Asset,
    parts: &[Part],
    options: &'a LodOptions,
    chain: &mut LodChain,
    control: Control<'_>,
) -> Result<Vec<Source<'a>>, ProcessError> {
    let parts: Vec<&Part> = parts.iter().collect();
    let mut before = vec![0; parts.len()];
    let mut sources = Vec::new();
    for (target, wanted) in options.levels.iter().enumerate() {
        let within = |error: f64| parts.iter().map(|part| part.collapses_within_error(error)).collect();
        let at: Vec<usize> = match wanted {
            LevelTarget::Triangles(triangles) => collapses_for(&parts, *triangles),
            LevelTarget::Error(error) => within(*error),
            LevelTarget::Screen(coverage) => within(chain.diameter * chain.pixels.0 / (LINES * coverage)),
            LevelTarget::Meshes { meshes, error } => {
                let error = error.map_or_else(|| farthest(asset, meshes, control), Ok)?;
                chain.levels.push(LodLevel { error, target, ..LodLevel::default() });
                sources.push(Source::Meshes(meshes));
                continue;
            }
        };
        let at: Vec<usize> = at.iter().zip(&before).map(|(&at, &before)| at.max(before)).collect();
        if at != before {
            let error = error_at(parts.iter().copied(), &at);
            chain.levels.push(LodLevel { error, target, ..LodLevel::default() });
            before.clone_from(&at);
            sources.push(Source::Collapses(at));
        }
    }
    Ok(sources)
}

/// The largest distance between meshes of an asset and what stands for them, in world units, sampled; that of a mesh of which
/// nothing is left is its size.
fn farthest(asset: &Asset, meshes: &[Mesh], control: Control<'_>) -> Result<f64, ProcessError> {
    let sampling = CompareOptions { samples: SAMPLES, ..CompareOptions::default() };
    let distance = |((named, mesh), scale): ((&crate::NamedMesh, &Mesh), f64)| -> f64 {
        if named.mesh.triangle_count() == 0 {
            return 0.0;
        }
        let compared = compare(&named.mesh, mesh, &sampling, control);
        scale * compared.map_or_else(|_| named.mesh.diagonal(), |comparison| comparison.max())
    };
    let distances = asset.meshes.iter().zip(meshes).zip(world_scales(asset)).map(distance);
    let farthest = distances.fold(0.0, f64::max);
    if control.is_cancelled() {
        return Err(refusal(asset, 0)(SimplifyError::Cancelled(Cancelled)));
    }
    Ok(farthest)
}

impl Member {
    /// Makes the meshes of all levels: cut out, fitted, in the order for display, and with what it takes to morph each into the
    /// next; before them the original, if it is to be morphed, too.
    fn make_levels(
        &mut self,
        asset: &Asset,
        index: usize,
        sources: &[Source<'_>],
        options: &LodOptions,
        control: Control<'_>,
    ) -> Result<(), Cancelled> {
        let original = &asset.meshes[index].mesh;
        let form = options.geomorph;
        let first = form.is_some().then_some((Some(0), None));
        let own = sources.iter().map(|source| match source {
            Source::Collapses(at) => (Some(at[index]), None),
            Source::Meshes(meshes) => (None, Some(&meshes[index])),
        });
        let own: Vec<(Option<usize>, Option<&Mesh>)> = first.into_iter().chain(own).collect();
        for (i, &(at, mesh)) in own.iter().enumerate() {
            let mut mesh = mesh.cloned().unwrap_or_default();
            if let Some(at) = at {
                self.part.mesh.seek(at);
                mesh = self.part.mesh.to_mesh();
                let is_original = form.is_some() && i == 0;
                if options.refit && !is_original {
                    self.refit(&mut mesh, original, options, control)?;
                }
            }
            self.levels.push(mesh);
        }
        let mut correspondences = Vec::new();
        if form.is_some() {
            for (pair, meshes) in own.windows(2).zip(self.levels.windows(2)) {
                correspondences.push(match (pair[0].0, pair[1].0) {
                    (Some(finer), Some(coarser)) => {
                        self.part.mesh.correspondence([finer, coarser], [&meshes[0], &meshes[1]])
                    }
                    _ => Correspondence::closest(&meshes[0], &meshes[1]).expect("levels have been checked"),
                });
            }
        }
        let orders: Vec<Vec<u32>> = self.levels.iter_mut().map(order_for_display).collect();
        let correspondences = correspondences.into_iter().enumerate();
        let correspondences: Vec<Correspondence> =
            correspondences.map(|(k, way)| way.reordered(&orders[k], &orders[k + 1])).collect();
        if form.merge_weights {
            for (k, way) in correspondences.iter().enumerate().rev() {
                let [finer, coarser] = &mut self.levels[k..k + 2] else { unreachable!("a way joins two levels") };
                take_influences(finer, coarser, way);
            }
        }
        for (k, way) in correspondences.into_iter().enumerate() {
            let residual = residual([&self.levels[k], &self.levels[k + 1]], &way, &self.poses);
            self.add_way(k, &way, form);
            self.ways.push((way, residual));
        }
        if let (Some(last), true, false) = (self.levels.last_mut(), form.target, original.morph_targets.is_empty()) {
            // clips that turn blend shapes on and off want the same number of them in each level
            let nothing = Attribute::new_f32(Semantic::Position, 3, vec![0.0; 3 * last.wedge_count()]);
            last.morph_targets.push(MorphTarget { name: "geomorph".into(), attributes: vec![nothing] });
        }
        Ok(())
    }

    /// Gives a level what takes it to the next one.
    fn add_way(&mut self, k: usize, way: &Correspondence, form: GeomorphForm) {
        let geomorph = Geomorph::new(&self.levels[k], &self.levels[k + 1], way, &GeomorphOptions::default());
        // levels from elsewhere may have attributes of other forms: then only positions are told
        let geomorph = geomorph.or_else(|_| {
            let bare = |mesh: &Mesh| Mesh { wedge_attributes: Vec::new(), ..mesh.clone() };
            Geomorph::new(&bare(&self.levels[k]), &bare(&self.levels[k + 1]), way, &GeomorphOptions::default())
        });
        let geomorph = geomorph.expect("the correspondence is of these levels");
        let level = &mut self.levels[k];
        if form.attributes {
            let attributes = geomorph.targets(level);
            level.wedge_attributes.extend(attributes);
        }
        if form.target {
            let mut target = geomorph.deltas();
            if !level.morph_targets.is_empty() {
                // three.js takes the colours themselves for what other targets would add to them
                target.attributes.retain(|attribute| !matches!(attribute.semantic, Semantic::Color(_)));
            }
            level.morph_targets.push(target);
        }
    }

    fn refit(
        &self,
        mesh: &mut Mesh,
        original: &Mesh,
        options: &LodOptions,
        control: Control<'_>,
    ) -> Result<(), Cancelled> {
        let CollapseOptions { simplify, roles, .. } = &options.collapse;
        let fixed = fixed(mesh, roles, simplify);
        if self.poses.is_empty() {
            let options = RefitOptions { fixed, ..RefitOptions::default() };
            refit(mesh, original, &options, control).map(drop)
        } else {
            let max_influences = simplify.max_influences;
            let options = PosedRefitOptions { fixed, max_influences, ..PosedRefitOptions::default() };
            refit_in_poses(mesh, original, &self.poses, &options, control).map(drop)
        }
    }
}

/// Gives each vertex of a finer level the joints and weights of what it becomes.
fn take_influences(finer: &mut Mesh, coarser: &Mesh, way: &Correspondence) {
    let mut sources = vec![u32::MAX; finer.vertex_count()];
    for (&vertex, &target) in finer.wedge_vertices.iter().zip(&way.wedges) {
        let source = &mut sources[vertex as usize];
        if *source == u32::MAX && target < way.coarser_wedges {
            *source = target;
        }
    }
    let vertices = &finer.wedge_vertices;
    let is_influence =
        |attribute: &&mut Attribute| matches!(attribute.semantic, Semantic::Joints(_) | Semantic::Weights(_));
    for attribute in finer.wedge_attributes.iter_mut().filter(is_influence) {
        let n = attribute.components;
        let theirs = coarser.wedge_attributes.iter().find(|a| a.semantic == attribute.semantic && a.components == n);
        let pairs = vertices.iter().map(|&vertex| sources[vertex as usize]).enumerate();
        let pairs = pairs.filter(|&(_, source)| source != u32::MAX);
        match (&mut attribute.values, theirs.map(|theirs| &theirs.values)) {
            (Values::F32(own), Some(Values::F32(theirs))) => {
                pairs.for_each(|(w, s)| own[n * w..][..n].copy_from_slice(&theirs[n * s as usize..][..n]));
            }
            (Values::U32(own), Some(Values::U32(theirs))) => {
                pairs.for_each(|(w, s)| own[n * w..][..n].copy_from_slice(&theirs[n * s as usize..][..n]));
            }
            _ => {}
        }
    }
}

/// How far at most, over some poses, wedges that are morphed before they are posed end from what they become, in the units of
/// the poses.
fn residual([finer, coarser]: [&Mesh; 2], way: &Correspondence, poses: &[Pose]) -> f64 {
    let in_pose = |pose: &Pose| {
        let maps = [finer, coarser].map(|mesh| pose.vertex_maps(mesh));
        let pairs = finer.wedge_vertices.iter().zip(&way.wedges).filter(|&(_, &target)| target < way.coarser_wedges);
        let distances = pairs.map(|(&vertex, &target)| {
            let end = coarser.wedge_vertices[target as usize] as usize;
            let place = Vec3::from(coarser.positions[end]).as_dvec3();
            maps[0][vertex as usize].transform_point3(place).distance(maps[1][end].transform_point3(place))
        });
        distances.fold(0.0, f64::max)
    };
    poses.par_iter().map(in_pose).reduce(|| 0.0, f64::max)
}
