//! The poses of an asset that its simplification looks at.

use glam::DVec3;
use maille::skin::{Clip, MadeUpPose, Pose, PoseChoice};

use crate::{Asset, Instance};

/// Which poses the simplifier looks at.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum PoseSet {
    /// None: vertices where they are stored (bind pose).
    #[default]
    Bind,
    /// The one in which the file shows the model at rest.
    Rest,
    /// One moment of a clip.
    Frame {
        /// Index into [`Asset::clips`].
        clip: usize,
        /// Seconds.
        seconds: f64,
    },
    /// The one in which all that clips move is in the middle of the range in which they move it.
    Middle,
    /// So many poses, chosen by [`PoseChoice`] among many that the joints and morph targets may take, and the pose at rest among
    /// them: for rigs without clips.
    Extreme {
        /// At most so many.
        most: usize,
    },
    /// So many poses that stand for all clips, chosen by [`PoseChoice`], and the pose at rest among them.
    Clips {
        /// At most so many.
        most: usize,
    },
}

/// Frames of a clip that are looked at, at most and at least, and in all of an asset, about.
const MOST_FRAMES: usize = 48;
const FEWEST_FRAMES: usize = 4;
const ALL_FRAMES: usize = 1000;
/// Poses that are made up to choose from.
const MADE_UP: usize = 96;
/// Points by which poses are told apart.
const POINTS: usize = 300;
/// How much the pose at rest counts, relative to all others.
const REST: f64 = 0.05;

/// The poses of each mesh; none for a mesh that is to be looked at as it is stored, such as one without a skin and morph
/// targets.
///
/// # Panics
/// If there is no such clip.
pub fn poses_of(asset: &Asset, set: &PoseSet) -> Vec<Vec<Pose>> {
    match set {
        PoseSet::Bind => vec![Vec::new(); asset.meshes.len()],
        PoseSet::Rest => poses_in(asset, &asset.instances, 1.0),
        PoseSet::Frame { clip, seconds } => poses_in(asset, &asset.animation(*clip).instances_at(*seconds), 1.0),
        PoseSet::Middle => match asset.rig() {
            Some(rig) => poses_in(asset, &rig.centered(asset.clips(), frames_of), 1.0),
            None => vec![Vec::new(); asset.meshes.len()],
        },
        PoseSet::Extreme { most } => extreme(asset, *most),
        PoseSet::Clips { most } => of_clips(asset, *most),
    }
}

/// The meshes as they are drawn at one moment.
fn poses_in(asset: &Asset, instances: &[Instance], share: f64) -> Vec<Vec<Pose>> {
    let mut poses = vec![Vec::new(); asset.meshes.len()];
    // what is only moved looks the same from everywhere
    let deforms = |instance: &&Instance| {
        instance.joint_matrices.is_some() || !asset.meshes[instance.mesh].mesh.morph_targets.is_empty()
    };
    for instance in instances.iter().filter(deforms) {
        poses[instance.mesh].push(Pose {
            joint_matrices: instance.joint_matrices.as_deref().map_or_else(Vec::new, <[_]>::to_vec),
            transform: instance.transform,
            morph_weights: instance.morph_weights.clone(),
            share,
        });
    }
    poses
}

/// Those that stand for all clips.
fn of_clips(asset: &Asset, most: usize) -> Vec<Vec<Pose>> {
    let clips = asset.clips();
    let per_clip = (ALL_FRAMES / clips.len().max(1)).clamp(FEWEST_FRAMES, MOST_FRAMES);
    let animations: Vec<_> = (0..clips.len()).map(|clip| asset.animation(clip)).collect();
    let moments =
        clips.iter().enumerate().flat_map(|(clip, info)| evenly(info, per_clip).map(move |seconds| (clip, seconds)));
    let moments: Vec<(usize, f64)> = moments.collect();
    chosen(asset, most, moments.len(), |i| {
        let (clip, seconds) = moments[i];
        animations[clip].instances_at(seconds)
    })
}

/// So many moments of a clip, evenly spread.
fn evenly(clip: &Clip, count: usize) -> impl Iterator<Item = f64> + use<> {
    let (start, end) = (clip.start(), clip.end());
    (0..count).map(move |k| start + (end - start) * (k as f64 + 0.5) / count as f64)
}

/// Moments that tell the range of a clip: its ends among them.
fn frames_of(clip: &Clip) -> Vec<f64> {
    let ends = [clip.start(), clip.end()];
    evenly(clip, MOST_FRAMES).chain(ends).collect()
}

/// Those that stand for all that the rigs may take.
fn extreme(asset: &Asset, most: usize) -> Vec<Vec<Pose>> {
    let Some(rig) = asset.rig().filter(|_| asset.is_articulated()) else {
        return vec![Vec::new(); asset.meshes.len()];
    };
    chosen(asset, most, MADE_UP, |i| {
        let pose = MadeUpPose(i as u64);
        let mut instances = rig.turned(|joint| pose.turn(joint));
        for (number, instance) in instances.iter_mut().enumerate() {
            let targets = asset.meshes[instance.mesh].mesh.morph_targets.len();
            instance.morph_weights = (0..targets).map(|target| pose.morph_weight(number, target) as f32).collect();
        }
        instances
    })
}

/// Of so many poses, those that stand for all; and the pose at rest.
fn chosen(asset: &Asset, most: usize, count: usize, pose: impl Fn(usize) -> Vec<Instance>) -> Vec<Vec<Pose>> {
    if count == 0 {
        return vec![Vec::new(); asset.meshes.len()];
    }
    let points = points_of(asset);
    let places = |instances: &[Instance]| -> Vec<DVec3> {
        let place = |&(instance, wedge): &(usize, usize)| {
            let instance: &Instance = &instances[instance];
            instance.posed_wedge(&asset.meshes[instance.mesh].mesh, wedge)
        };
        points.iter().map(place).collect()
    };
    let mut choice = PoseChoice::new(points.len());
    choice.add(&places(&asset.instances), REST);
    for i in 0..count {
        choice.add(&places(&pose(i)), 1.0 / count as f64);
    }
    let mut poses = vec![Vec::new(); asset.meshes.len()];
    for (number, share) in choice.choose(most) {
        let of_moment = match number.checked_sub(1) {
            None => poses_in(asset, &asset.instances, share),
            Some(i) => poses_in(asset, &pose(i), share),
        };
        poses.iter_mut().zip(of_moment).for_each(|(all, more)| all.extend(more));
    }
    poses
}

/// Some wedges, each of an instance, evenly over all that is drawn.
fn points_of(asset: &Asset) -> Vec<(usize, usize)> {
    let all: usize = asset.instances.iter().map(|instance| asset.meshes[instance.mesh].mesh.wedge_count()).sum();
    let step = all.div_ceil(POINTS).max(1);
    let wedges = asset
        .instances
        .iter()
        .enumerate()
        .flat_map(|(i, instance)| (0..asset.meshes[instance.mesh].mesh.wedge_count()).map(move |wedge| (i, wedge)));
    wedges.step_by(step).collect()
}
