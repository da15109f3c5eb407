//! `maille bench popping`: how much pixels change where levels of detail are switched, with geomorphs and without.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec3, Vec3};
use maille::Mesh;
use maille::lod::{Correspondence, Geomorph, GeomorphOptions, MorphedMesh, Target};
use maille::mesh::Semantic;
use maille::scene::View;
use maille_io::{Asset, GeomorphForm, Instance, LodChain, LodLevel, LodOptions, PoseSet, lod_chain};
use serde_json::{Value, json};

use super::popping_report::Report;
use crate::args::PoppingArgs;
use crate::commands::collapse::refusal;
use crate::commands::report::ReportFiles;
use crate::commands::{lod, without_levels};
use crate::failure::Failure;
use crate::output::{self, number};
use crate::render::{Camera, Frame, Scene, draw_plain, encoded, with_normals};
use crate::session::Session;

/// The screen that a picture is a window onto: lines, and vertical angle of view.
const LINES: f64 = 1080.0;
const FIELD_OF_VIEW: f64 = PI / 3.0;
/// Changes of light below this cannot be seen: a step of 8 bits in the middle of their range.
const LEAST: f32 = 1.0 / 255.0;
/// What a geomorph is to keep below, as a share of what is seen without one.
pub(super) const BAR: f64 = 0.2;

pub(crate) fn run(args: &PoppingArgs) -> Result<(), Failure> {
    let files = match &args.output {
        Some(path) => Some(ReportFiles::new(path, &[&args.input])?),
        None => None,
    };
    let session = Session::start(&args.common)?;
    let asset = drawable(session.read(&args.input)?);
    let asset = without_levels(asset, &session);
    let poses = lod::poses(args.poses.as_deref(), &asset)?;
    let options = LodOptions {
        levels: lod::targets(&args.levels, &asset)?,
        refit: poses != PoseSet::Bind,
        poses,
        geomorph: GeomorphForm { target: true, ..GeomorphForm::default() },
        ..LodOptions::default()
    };
    let chain = lod_chain(&asset, &options, session.control()).map_err(|error| refusal(&args.input, &error))?;
    session.checkpoint()?;
    let bench = Bench { args, session: &session, frame: Frame::around(&asset, false), levels: levels(&asset, &chain) };
    let mut switches = Vec::new();
    for (coarser, level) in (1..).zip(&chain.levels) {
        // what loses nothing can be switched anywhere
        if level.error > 0.0 {
            switches.push(bench.switch(coarser, level)?);
        }
    }
    if switches.is_empty() {
        let message = "there is nothing to switch: no level loses anything (--levels tells which there are)";
        return Err(Failure::about(&args.input, message));
    }
    session.checkpoint()?;
    let told: Vec<&Path> = files.as_ref().map_or_else(Vec::new, |files| files.files().to_vec());
    let figures = || json(args, &asset, &switches, &told);
    if let Some(files) = &files {
        files.write(&session, &Report { args, switches: &switches }.html(), &figures())?;
    }
    session.result(figures, || text(args, &switches, &told))
}

/// The asset with what drawing needs: normals, and an instance at least.
fn drawable(mut asset: Asset) -> Asset {
    for named in &mut asset.meshes {
        if let std::borrow::Cow::Owned(mesh) = with_normals(&named.mesh) {
            named.mesh = mesh;
        }
    }
    if asset.instances.is_empty() {
        asset.instances = (0..asset.meshes.len()).map(|mesh| Instance { mesh, ..Instance::default() }).collect();
    }
    asset
}

/// The asset at each level, the original first.
fn levels(asset: &Asset, chain: &LodChain) -> Vec<Asset> {
    let original = LodLevel { meshes: chain.original.clone(), ..LodLevel::default() };
    std::iter::once(&original).chain(&chain.levels).map(|level| asset.at_level(level)).collect()
}

struct Bench<'a> {
    args: &'a PoppingArgs,
    session: &'a Session,
    frame: Frame,
    levels: Vec<Asset>,
}

/// What is seen where a level takes the place of the one before.
pub(super) struct Switch {
    /// Number of the coarser level; the original is 0.
    pub(super) coarser: usize,
    /// Triangles of both levels.
    pub(super) triangles: [usize; 2],
    /// Of the coarser level, in world units.
    pub(super) error: f64,
    /// From the eye to the nearest point of the sphere around the model, in world units.
    distance: f64,
    /// Of a picture, in pixels.
    pub(super) size: (u32, u32),
    pub(super) views: Vec<Seen>,
    /// From the direction where the geomorph changes most.
    pub(super) pictures: Pictures,
}

/// What is seen from one direction.
pub(super) struct Seen {
    direction: Vec3,
    /// From the finer level to the coarser one at once.
    cut: Change,
    /// From frame to frame of the geomorph; the last one from its end to the coarser level.
    steps: Vec<Change>,
    /// Of each pixel the change of light with the cut, and the largest of the steps.
    pixels: Vec<[f32; 2]>,
}

/// How pixels change from one picture to the next, in the channel that changes most.
///
/// It is light that is measured: where an outline moves through a pixel, light changes evenly. Steps of a screen do not: on black,
/// a hundredth of white is 25 steps of 255, wherever it comes from.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Change {
    /// The largest change of light; white is 1.
    pub(super) light: f32,
    /// Its mean over all pixels.
    mean: f32,
    /// The largest change of what a screen is given (sRGB), in steps of 8 bits, not rounded.
    steps: f32,
}

/// Colours of the finer level, the middle of the geomorph and the coarser level; what changes with the cut, and most in a step.
pub(super) struct Pictures {
    pub(super) colours: [Vec<Vec3>; 3],
    pub(super) changes: Vec<[f32; 2]>,
}

impl Bench<'_> {
    fn switch(&self, coarser: usize, level: &LodLevel) -> Result<Switch, Failure> {
        let pair = [&self.levels[coarser - 1], &self.levels[coarser]];
        let focal = View::new(FIELD_OF_VIEW, LINES).pixels(1.0, 1.0);
        let distance = focal * level.error / self.args.pixels;
        // scenes have radius 1
        let to_middle = (1.0 + distance * self.frame.scale()) as f32;
        let across = 4.0 + 2.0 * focal / (f64::from(to_middle).powi(2) - 1.0).sqrt();
        let size = [self.args.size.0, self.args.size.1].map(|most| most.min(across.min(1e9) as u32));
        let size = (size[0], size[1]);
        let stage = Stage::new(pair, level, self)?;
        let directions = directions(self.args.views.into());
        let mut views: Vec<Seen> = Vec::new();
        // one after the other: a picture takes all threads, and much memory
        for (i, &direction) in directions.iter().enumerate() {
            let share = (i as f32 / directions.len() as f32 + (coarser - 1) as f32) / (self.levels.len() - 1) as f32;
            self.session.progress("drawing", share);
            self.session.cancelled()?;
            let camera = Camera::at(direction, to_middle, focal as f32, size);
            views.push(stage.look(&camera, direction, self.args.frames));
        }
        let worst = views.iter().max_by(|a, b| a.morph().light.total_cmp(&b.morph().light)).expect("there is a view");
        let camera = Camera::at(worst.direction, to_middle, focal as f32, size);
        let pictures = Pictures { colours: stage.pictures(&camera), changes: worst.pixels.clone() };
        let triangles = pair.map(Asset::drawn_triangle_count);
        Ok(Switch { coarser, triangles, error: level.error, distance, size, views, pictures })
    }
}

impl Switch {
    /// The largest changes of a pixel, from any direction, with the cut.
    pub(super) fn cut(&self) -> Change {
        self.views.iter().map(|seen| seen.cut).fold(Change::default(), Change::largest)
    }

    /// The same from frame to frame of the geomorph.
    pub(super) fn morph(&self) -> Change {
        self.views.iter().map(Seen::morph).fold(Change::default(), Change::largest)
    }

    pub(super) fn ratio(&self) -> f64 {
        self.morph().over(self.cut())
    }

    /// The ratio of steps of 8 bits.
    pub(super) fn ratio_of_steps(&self) -> f64 {
        f64::from(self.morph().steps) / f64::from(self.cut().steps.max(1.0))
    }

    /// The largest ratio from one direction.
    pub(super) fn worst_ratio(&self) -> f64 {
        self.views.iter().map(Seen::ratio).fold(0.0, f64::max)
    }

    /// Means over all pixels of all views that change with the cut: of the cut, and of the largest steps; and the share of them in
    /// which a step is larger than the bar allows for the largest change.
    pub(super) fn means(&self) -> ([f64; 2], f64) {
        let allowed = BAR * f64::from(self.cut().light);
        let (mut count, mut sums, mut beyond) = (0.0, [0.0; 2], 0.0);
        for [cut, step] in self.views.iter().flat_map(|seen| &seen.pixels).filter(|pixel| pixel[0] >= LEAST) {
            count += 1.0;
            sums = [sums[0] + f64::from(*cut), sums[1] + f64::from(*step)];
            beyond += f64::from(u8::from(f64::from(*step) > allowed));
        }
        let count = f64::max(count, 1.0);
        (sums.map(|sum| sum / count), beyond / count)
    }

    /// The largest change of light in each step, from any direction.
    pub(super) fn steps(&self) -> Vec<f64> {
        let count = self.views.first().map_or(0, |seen| seen.steps.len());
        let of = |i: usize| self.views.iter().map(|seen| f64::from(seen.steps[i].light)).fold(0.0, f64::max);
        (0..count).map(of).collect()
    }
}

impl Seen {
    /// The largest of the steps.
    fn morph(&self) -> Change {
        self.steps.iter().copied().fold(Change::default(), Change::largest)
    }

    fn ratio(&self) -> f64 {
        self.morph().over(self.cut)
    }
}

impl Change {
    fn of(changes: &[[f32; 2]]) -> Self {
        let sum: f64 = changes.iter().map(|change| f64::from(change[0])).sum();
        let [light, steps] = [0, 1].map(|i| changes.iter().map(|change| change[i]).fold(0.0, f32::max));
        Self { light, steps, mean: (sum / changes.len().max(1) as f64) as f32 }
    }

    fn largest(self, other: Self) -> Self {
        Self { light: self.light.max(other.light), mean: self.mean.max(other.mean), steps: self.steps.max(other.steps) }
    }

    fn over(self, cut: Self) -> f64 {
        f64::from(self.light) / f64::from(cut.light.max(LEAST))
    }
}

/// Directions spread evenly over the sphere (a spiral of equal areas).
fn directions(count: usize) -> Vec<Vec3> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    let direction = |i: usize| {
        let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let radius = (1.0 - y * y).sqrt();
        DVec3::new(radius * cos, y, radius * sin).as_vec3()
    };
    (0..count).map(direction).collect()
}

/// Two levels, and the way from one to the other.
struct Stage<'a> {
    frame: &'a Frame,
    finer: Scene,
    coarser: Scene,
    start: MorphedMesh,
    geomorph: Geomorph,
}

impl<'a> Stage<'a> {
    fn new([finer, coarser]: [&Asset; 2], level: &LodLevel, bench: &'a Bench<'_>) -> Result<Self, Failure> {
        // in the world, posed: there a skinned level goes straight to the other, too, as `SkinnedGeomorph` does it
        let surfaces = [finer, coarser].map(Asset::flattened);
        let geomorph = if bench.args.morph_target {
            let mut end = finer.clone();
            end.meshes.iter_mut().for_each(|named| named.mesh = with_target(&named.mesh));
            let identity = Correspondence::identity(surfaces[0].wedge_count() as u32);
            Geomorph::new(&surfaces[0], &end.flattened(), &identity, &GeomorphOptions::default())
        } else {
            let correspondence = in_the_world([finer, coarser], &level.correspondences);
            Geomorph::new(&surfaces[0], &surfaces[1], &correspondence, &GeomorphOptions::default())
        };
        let geomorph = geomorph.map_err(|error| Failure::about(&bench.args.input, error))?;
        let scene = |asset: &Asset, surface: &Mesh| {
            let mut scene = Scene::new(asset, &bench.frame);
            scene.set(&MorphedMesh::new(surface), &bench.frame);
            scene
        };
        let start = MorphedMesh::new(&surfaces[0]);
        let [finer, coarser] = [scene(finer, &surfaces[0]), scene(coarser, &surfaces[1])];
        Ok(Self { frame: &bench.frame, finer, coarser, start, geomorph })
    }

    fn look(&self, camera: &Camera, direction: Vec3, frames: u16) -> Seen {
        let [before, after] = [&self.finer, &self.coarser].map(|scene| draw_plain(scene, camera));
        let cut = changes(&before, &after);
        let mut pixels: Vec<[f32; 2]> = cut.iter().map(|cut| [cut[0], 0.0]).collect();
        let (mut scene, mut shown) = (self.finer.clone(), self.start.clone());
        let (mut last, mut steps) = (before, Vec::new());
        for k in 1..=frames + 1 {
            let next = if k <= frames {
                self.geomorph.morph(f32::from(k) / f32::from(frames), &mut shown);
                scene.set(&shown, self.frame);
                draw_plain(&scene, camera)
            } else {
                after.clone()
            };
            let step = changes(&last, &next);
            pixels.iter_mut().zip(&step).for_each(|(pixel, step)| pixel[1] = pixel[1].max(step[0]));
            steps.push(Change::of(&step));
            last = next;
        }
        Seen { direction, cut: Change::of(&cut), steps, pixels }
    }

    fn pictures(&self, camera: &Camera) -> [Vec<Vec3>; 3] {
        let (mut scene, mut shown) = (self.finer.clone(), self.start.clone());
        self.geomorph.morph(0.5, &mut shown);
        scene.set(&shown, self.frame);
        [&self.finer, &scene, &self.coarser].map(|scene| draw_plain(scene, camera))
    }
}

/// Of each pixel, how much light changes in the channel that changes most, and how many steps of a screen.
fn changes(a: &[Vec3], b: &[Vec3]) -> Vec<[f32; 2]> {
    let largest = |a: Vec3, b: Vec3| (a - b).abs().max_element();
    let change = |(&a, &b): (&Vec3, &Vec3)| match a == b {
        true => [0.0; 2],
        false => [largest(a, b), 255.0 * largest(encoded(a), encoded(b))],
    };
    a.iter().zip(b).map(change).collect()
}

/// The correspondences of meshes for all that is drawn, as one mesh.
fn in_the_world([finer, coarser]: [&Asset; 2], correspondences: &[Correspondence]) -> Correspondence {
    let wedges = |instance: &Instance| coarser.meshes[instance.mesh].mesh.wedge_count() as u32;
    let coarser_wedges = coarser.instances.iter().map(wedges).sum();
    let mut world = Correspondence { coarser_wedges, ..Correspondence::default() };
    let mut first = 0;
    for instance in &finer.instances {
        let (own, mesh) = (&correspondences[instance.mesh], &finer.meshes[instance.mesh].mesh);
        for wedge in 0..own.wedges.len() {
            world.wedges.push(match own.target(wedge as u32) {
                Target::Wedge(target) => first + target,
                Target::Point(point) => {
                    let matrix = instance.wedge_matrix(mesh, wedge);
                    world.vanishing.push(matrix.transform_point3(DVec3::from(point.map(f64::from))).as_vec3().into());
                    coarser_wedges + world.vanishing.len() as u32 - 1
                }
            });
        }
        first += wedges(instance);
    }
    world
}

/// A mesh whose morph target of the geomorph is fully on.
fn with_target(mesh: &Mesh) -> Mesh {
    let mut end = mesh.clone();
    let wedges = &mesh.wedge_vertices;
    end.positions = wedges.iter().map(|&v| mesh.positions[v as usize]).collect();
    end.vertex_attributes.iter_mut().for_each(|attribute| attribute.gather(wedges));
    end.wedge_vertices = (0..wedges.len() as u32).collect();
    let Some(target) = mesh.morph_targets.iter().rfind(|target| target.name == "geomorph") else { return end };
    for deltas in &target.attributes {
        let Some(values) = deltas.as_f32() else { continue };
        if deltas.semantic == Semantic::Position {
            end.positions.as_flattened_mut().iter_mut().zip(values).for_each(|(value, delta)| *value += delta);
            continue;
        }
        let Some(own) = end.wedge_attributes.iter_mut().find(|own| own.semantic == deltas.semantic) else { continue };
        let components = own.components;
        let Some(own) = own.as_f32_mut() else { continue };
        let rows = own.chunks_exact_mut(components).zip(values.chunks_exact(deltas.components));
        rows.for_each(|(own, delta)| own.iter_mut().zip(delta).for_each(|(value, delta)| *value += delta));
    }
    end
}

fn json(args: &PoppingArgs, asset: &Asset, switches: &[Switch], files: &[&Path]) -> Value {
    let change = |change: Change| json!({ "max": change.light, "mean": change.mean, "steps": change.steps });
    let view = |seen: &Seen| {
        json!({
            "direction": seen.direction.to_array(),
            "cut": change(seen.cut),
            "morph": change(seen.morph()),
            "ratio": seen.ratio(),
        })
    };
    let switch = |switch: &Switch| {
        let ([cut_mean, morph_mean], beyond) = switch.means();
        json!({
            "level": switch.coarser,
            "triangles_finer": switch.triangles[0],
            "triangles_coarser": switch.triangles[1],
            "error": switch.error,
            "distance": switch.distance,
            "size": [switch.size.0, switch.size.1],
            "cut_max": switch.cut().light,
            "morph_max": switch.morph().light,
            "ratio": switch.ratio(),
            "cut_steps": switch.cut().steps,
            "morph_steps": switch.morph().steps,
            "ratio_of_steps": switch.ratio_of_steps(),
            "worst_view_ratio": switch.worst_ratio(),
            "cut_mean": cut_mean,
            "morph_mean": morph_mean,
            "share_beyond": beyond,
            "steps": switch.steps(),
            "views": switch.views.iter().map(view).collect::<Vec<_>>(),
        })
    };
    json!({
        "input": args.input.display().to_string(),
        "triangles": asset.drawn_triangle_count(),
        "morph_target": args.morph_target,
        "frames": args.frames,
        "pixels": args.pixels,
        "lines": LINES,
        "field_of_view_deg": FIELD_OF_VIEW.to_degrees(),
        "bar": BAR,
        "ratio": largest_ratio(switches),
        "switches": switches.iter().map(switch).collect::<Vec<_>>(),
        "files": output::paths(files),
        "warnings": asset.warnings,
    })
}

pub(super) fn largest_ratio(switches: &[Switch]) -> f64 {
    switches.iter().map(Switch::ratio).fold(0.0, f64::max)
}

/// Heads of the columns that all tables have, and their cells.
pub(super) const HEAD: [&str; 9] =
    ["triangles", "picture", "cut", "geomorph", "ratio", "worst view", "mean ratio", "beyond", "8 bits"];

pub(super) fn cells(switch: &Switch) -> Vec<String> {
    let ([cut, morph], beyond) = switch.means();
    let [finer, coarser] = switch.triangles.map(output::count);
    vec![
        format!("{finer} to {coarser}"),
        format!("{}x{}", switch.size.0, switch.size.1),
        percent(switch.cut().light.into()),
        percent(switch.morph().light.into()),
        format!("{:.3}", switch.ratio()),
        format!("{:.3}", switch.worst_ratio()),
        format!("{:.3}", if cut > 0.0 { morph / cut } else { 0.0 }),
        percent(beyond),
        format!("{:.3}", switch.ratio_of_steps()),
    ]
}

fn percent(share: f64) -> String {
    format!("{} %", number((1e4 * share).round() / 1e2))
}

/// What the figures of the tables are.
pub(super) fn meaning(args: &PoppingArgs) -> String {
    format!(
        "Cut and geomorph: the largest change of a pixel's light from one frame to the next, as a share of white, over {} \
         directions; {} frames to a geomorph; levels are switched where their error is {} px of {LINES} lines. Worst view: the \
         largest ratio from one direction. Mean ratio: over all pixels that change. Beyond: share of these in which a step is \
         larger than {BAR} times the largest change of the cut. 8 bits: the ratio in steps of the screen (sRGB) instead of light.",
        args.views,
        args.frames,
        number(args.pixels)
    )
}

fn text(args: &PoppingArgs, switches: &[Switch], files: &[&Path]) -> String {
    let mut rows = vec![HEAD.map(str::to_owned).to_vec()];
    rows.extend(switches.iter().map(cells));
    let text = format!("{}\n{}\n{}\n", args.input.display(), output::table(&rows), meaning(args));
    if files.is_empty() { text } else { format!("wrote {}\n{text}", output::written(files)) }
}
