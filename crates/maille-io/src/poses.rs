//! The poses of an asset that its simplification looks at.

use glam::DVec3;
use maille::skin::{Pose, PoseChoice};

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
/// Points by which poses are told apart.
const POINTS: usize = 300;
/// How much the pose at rest counts, relative to all clips.
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
        PoseSet::Clips { most } => chosen(asset, *most),
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

fn chosen(asset: &Asset, most: usize) -> Vec<Vec<Pose>> {
    let clips = asset.clips();
    if clips.is_empty() {
        return vec![Vec::new(); asset.meshes.len()];
    }
    let points = points_of(asset);
    let per_clip = (ALL_FRAMES / clips.len()).clamp(FEWEST_FRAMES, MOST_FRAMES);
    let mut choice = PoseChoice::new(points.len());
    let places = |instances: &[Instance]| -> Vec<DVec3> {
        let place = |&(instance, wedge): &(usize, usize)| {
            let instance: &Instance = &instances[instance];
            instance.posed_wedge(&asset.meshes[instance.mesh].mesh, wedge)
        };
        points.iter().map(place).collect()
    };
    let mut moments = vec![None];
    choice.add(&places(&asset.instances), REST);
    for (clip, info) in clips.iter().enumerate() {
        let animation = asset.animation(clip);
        let (start, end) = (info.start(), info.end());
        for k in 0..per_clip {
            let seconds = start + (end - start) * (k as f64 + 0.5) / per_clip as f64;
            choice.add(&places(&animation.instances_at(seconds)), 1.0 / (per_clip * clips.len()) as f64);
            moments.push(Some((clip, seconds)));
        }
    }
    let mut poses = vec![Vec::new(); asset.meshes.len()];
    for (moment, share) in choice.choose(most) {
        let of_moment = match moments[moment] {
            None => poses_in(asset, &asset.instances, share),
            Some((clip, seconds)) => poses_in(asset, &asset.animation(clip).instances_at(seconds), share),
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
