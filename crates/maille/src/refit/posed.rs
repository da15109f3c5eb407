//! Positions and skin weights of a simplified mesh, fitted to the original over poses.

use glam::{DAffine3, DMat3, DMat4, DVec3};
use rayon::prelude::*;

use super::least_squares::conjugate_gradients;
use super::{Sides, vertex};
use crate::Control;
use crate::control::Cancelled;
use crate::measure::triangle::{at, closest_on_triangle, scaled_normal};
use crate::measure::{Bvh, SurfaceSampler};
use crate::mesh::{Mesh, Semantic, Values};
use crate::skin::{Influences, Pose};

/// How to [`refit_in_poses`].
#[derive(Debug, Clone, PartialEq)]
pub struct PosedRefitOptions {
    /// How often nearest points are looked for anew.
    pub rounds: u32,
    /// Points of the original to each vertex of the simplified mesh, over all poses together.
    pub samples_per_vertex: f64,
    /// Moves the samples.
    pub seed: u64,
    /// Whether weights of joints are fitted, too.
    pub weights: bool,
    /// Most joints that move one vertex; `None`: as many as move the one that has most.
    pub max_influences: Option<u32>,
    /// One entry per vertex of the simplified mesh: vertices that must stay. Empty: none. Vertices on open borders keep
    /// their places, not their weights.
    pub fixed: Vec<bool>,
}

impl Default for PosedRefitOptions {
    fn default() -> Self {
        Self { rounds: 4, samples_per_vertex: 120.0, seed: 0, weights: true, max_influences: None, fixed: Vec::new() }
    }
}

/// What [`refit_in_poses`] did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PosedRefitReport {
    /// Root mean square distance, over all poses by their shares, before, in units of the poses: of samples of the original
    /// from the simplified surface, or of points of this from the original, whichever is larger.
    pub rms_before: f64,
    /// The same after: never larger.
    pub rms_after: f64,
}

/// Moves the vertices of a simplified mesh, and shifts their weights between joints, so that its surface fits the original
/// best in all poses together (seed 000, 6.1.5; Landreneau and Schaefer 2009).
///
/// With weights given, where a vertex is in a pose depends linearly on where it is stored; with that given, linearly on its
/// weights. So both are found in turn, by least squares: positions all at once, weights vertex by vertex, not negative, with sum
/// 1, and of as few joints as may be. Normals of triangles turn by no more than 60 degrees in any pose; what would make
/// the fit worse is not done.
///
/// # Panics
/// If `fixed` has another length than the mesh has vertices, or positions are not finite.
///
/// # Errors
/// [`Cancelled`]; the mesh is unchanged then.
pub fn refit_in_poses(
    mesh: &mut Mesh,
    original: &Mesh,
    poses: &[Pose],
    options: &PosedRefitOptions,
    control: Control<'_>,
) -> Result<PosedRefitReport, Cancelled> {
    assert!(options.fixed.is_empty() || options.fixed.len() == mesh.vertex_count(), "one entry per vertex");
    let mut report = PosedRefitReport::default();
    if mesh.triangles.is_empty() || original.triangles.is_empty() || poses.is_empty() {
        return Ok(report);
    }
    let samples = Samples::new(mesh, original, poses, options);
    let mut rig = Rig::new(mesh, poses, options);
    let wanted = (0..mesh.vertex_count()).map(|v| options.fixed.get(v) == Some(&true));
    let fixed = Sides::new(&rig.triangles).fixed_vertices(&rig.triangles, wanted);
    let mut rows = rig.rows(&samples);
    report.rms_before = rows.rms();
    report.rms_after = report.rms_before;
    for round in 0..options.rounds {
        control.report("fitting to poses", round as f32 / options.rounds as f32);
        if control.is_cancelled() {
            return Err(Cancelled);
        }
        let before = (rig.points.clone(), rig.influences.clone());
        if rig.fits_weights {
            rig.fit_weights(&rows, &options.fixed, &samples.candidates(&rows, rig.points.len(), &rig.triangles));
        }
        let moves = rig.moves(&rows, &fixed);
        rig.points.iter_mut().zip(&moves).for_each(|(point, by)| *point += *by);
        rig.turn_back(&before.0, &before.1);
        rows = rig.rows(&samples);
        let rms = rows.rms();
        if rms >= report.rms_after {
            (rig.points, rig.influences) = before;
            break;
        }
        report.rms_after = rms;
    }
    if report.rms_after < report.rms_before {
        rig.write(mesh);
    }
    Ok(report)
}

/// The original in the poses, and points of it.
struct Samples {
    /// Of each pose.
    poses: Vec<Vec<Sample>>,
    /// Of each pose, where the vertices are.
    positions: Vec<Vec<[f32; 3]>>,
    triangles: Vec<[u32; 3]>,
    /// What the samples on a unit of the surface count, all poses together counting 1.
    density: f64,
    /// The joints that move each sample, and by how much.
    joints: Vec<Vec<Vec<(u32, f64)>>>,
}

#[derive(Clone, Copy)]
struct Sample {
    point: DVec3,
    normal: DVec3,
    weight: f64,
}

impl Samples {
    fn new(mesh: &Mesh, original: &Mesh, poses: &[Pose], options: &PosedRefitOptions) -> Self {
        let wanted = mesh.vertex_count() as f64 * options.samples_per_vertex / poses.len() as f64;
        let count = wanted.max(8.0 * mesh.vertex_count() as f64).ceil() as u64;
        let influences = Influences::of(original);
        let total: f64 = poses.iter().map(|pose| pose.share).sum();
        let of_pose = |(k, pose): (usize, &Pose)| {
            let maps = pose.vertex_maps(original);
            let positions = (0..original.vertex_count() as u32)
                .map(|v| maps[v as usize].transform_point3(vertex(original, v)).as_vec3().to_array())
                .collect::<Vec<_>>();
            let sampler = SurfaceSampler::new(original, 0..original.triangle_count() as u32, options.seed + k as u64);
            let posed = |v: u32| maps[v as usize].transform_point3(vertex(original, v));
            let mut joints = Vec::with_capacity(count as usize);
            let samples: Vec<Sample> = sampler
                .samples(count, 0..count)
                .map(|sample| {
                    let t = sample.triangle as usize;
                    let (weights, _) = closest_on_triangle(sample.point, original.triangle_points(t));
                    let corners = original.triangle_vertices(t).map(posed);
                    joints.push(mixed(original.triangles[t].iter().zip(weights).flat_map(|(&w, share)| {
                        influences.of_wedge(w).map(move |(joint, weight)| (joint, f64::from(weight) * share))
                    })));
                    let scaled = scaled_normal(corners);
                    // samples are even where the surface is stored, not where it is stretched
                    let stretch = scaled.length() / scaled_normal(original.triangle_points(t)).length().max(1e-30);
                    Sample {
                        point: at(corners, weights),
                        normal: scaled.normalize_or_zero(),
                        weight: pose.share / total * stretch.min(4.0) / count as f64,
                    }
                })
                .collect();
            (samples, (joints, positions))
        };
        let (poses, (joints, positions)) = poses.par_iter().enumerate().map(of_pose).unzip();
        let triangles: Vec<[u32; 3]> = (0..original.triangle_count()).map(|t| original.triangle_vertices(t)).collect();
        let area = |t: usize| scaled_normal(original.triangle_points(t)).length() / 2.0;
        let density = 1.0 / (0..triangles.len()).map(area).sum::<f64>().max(f64::MIN_POSITIVE);
        Self { poses, positions, triangles, density, joints }
    }

    /// The joints that move the samples on the triangles around each vertex most.
    fn candidates(&self, rows: &Rows, vertices: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
        let mut counts: Vec<Vec<(u32, f64)>> = vec![Vec::new(); vertices];
        for (t, of_triangle) in rows.by_triangle.iter().enumerate() {
            for row in of_triangle {
                for &(joint, weight) in self.joints[row.pose as usize].get(row.sample as usize).into_iter().flatten() {
                    for (&v, share) in triangles[t].iter().zip(row.weights) {
                        add_to(&mut counts[v as usize], joint, weight * share * row.weight);
                    }
                }
            }
        }
        let most = |mut counts: Vec<(u32, f64)>| {
            counts.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            counts.truncate(MOST_CANDIDATES);
            counts.into_iter().map(|(joint, _)| joint).collect()
        };
        counts.into_iter().map(most).collect()
    }
}

/// Joints that are tried for a vertex, besides those it has.
const MOST_CANDIDATES: usize = 8;

fn add_to(sums: &mut Vec<(u32, f64)>, joint: u32, weight: f64) {
    match sums.iter_mut().find(|(known, _)| *known == joint) {
        Some((_, sum)) => *sum += weight,
        None => sums.push((joint, weight)),
    }
}

fn mixed(all: impl Iterator<Item = (u32, f64)>) -> Vec<(u32, f64)> {
    let mut sums = Vec::new();
    all.for_each(|(joint, weight)| add_to(&mut sums, joint, weight));
    sums
}

/// What each sample wants of the triangle that is nearest to it.
struct Rows {
    by_triangle: Vec<Vec<Row>>,
    /// Mean squared distance of the samples from the mesh, and of points of the mesh from the original.
    mean_sq: [f64; 2],
}

impl Rows {
    /// The larger distance of both ways.
    fn rms(&self) -> f64 {
        self.mean_sq[0].max(self.mean_sq[1]).sqrt()
    }
}

/// Points of each triangle that are looked at from the side of the mesh: the middles of its four equal parts.
const MIDDLES: [[f64; 3]; 4] = [
    [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0],
    [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
    [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0],
];
/// Number of a row that belongs to no sample.
const NO_SAMPLE: u32 = u32::MAX;
/// The part of a triangle's area that samples may leave uncovered, of what they cover.
const COVERED: f64 = 0.1;

#[derive(Clone, Copy)]
struct Row {
    pose: u32,
    sample: u32,
    /// Of the corners of the triangle.
    weights: [f64; 3],
    normal: DVec3,
    /// Where the point of the triangle should go.
    wanted: DVec3,
    weight: f64,
}

impl Row {
    /// How much a step counts.
    fn metric(&self) -> DMat3 {
        let n = self.normal;
        let across = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
        (across * (1.0 - ALONG) + DMat3::IDENTITY * ALONG) * self.weight
    }
}

/// What a distance along the surface counts, of one along the normal. By measurement: with 0.02 and with 0.002, errors
/// over clips are 1 and 3 % larger.
const ALONG: f64 = 0.1;
/// What staying counts, of what the samples of a vertex count.
const STAY: f64 = 1e-3;
/// What keeping its weights counts for a vertex, of what its samples count.
const STAY_WEIGHTS: f64 = 1e-3;

/// A mesh that moves with joints and morph targets.
struct Rig<'a> {
    poses: &'a [Pose],
    triangles: Vec<[u32; 3]>,
    points: Vec<DVec3>,
    /// What morph targets add to each vertex in each pose; empty without any.
    offsets: Vec<Vec<DVec3>>,
    has_skin: bool,
    fits_weights: bool,
    influences: Vec<Vec<(u32, f64)>>,
    influences_before: Vec<Vec<(u32, f64)>>,
    most: usize,
    scale_sq: f64,
}

impl<'a> Rig<'a> {
    fn new(mesh: &Mesh, poses: &'a [Pose], options: &PosedRefitOptions) -> Self {
        let skin = Influences::of(mesh);
        let has_skin = !skin.is_empty() && poses.iter().all(|pose| !pose.joint_matrices.is_empty());
        let mut influences = vec![Vec::new(); mesh.vertex_count()];
        if has_skin {
            for (w, &v) in (0..).zip(&mesh.wedge_vertices).collect::<Vec<_>>().into_iter().rev() {
                let all = mixed(skin.of_wedge(w).map(|(joint, weight)| (joint, f64::from(weight))));
                let sum: f64 = all.iter().map(|(_, weight)| weight).sum();
                influences[v as usize] =
                    all.into_iter().map(|(joint, weight)| (joint, weight / sum.max(f64::MIN_POSITIVE))).collect();
            }
        }
        let most = influences.iter().map(Vec::len).max().unwrap_or(0);
        let points: Vec<DVec3> = (0..mesh.vertex_count() as u32).map(|v| vertex(mesh, v)).collect();
        let has_morphs = poses.iter().any(|pose| pose.morph_weights.iter().any(|&weight| weight != 0.0));
        let offsets = if has_morphs {
            let morphed = |pose: &Pose| {
                let only = Pose { joint_matrices: Vec::new(), transform: DMat4::IDENTITY, ..pose.clone() };
                only.vertex_maps(mesh).iter().map(|map| map.translation).collect()
            };
            poses.iter().map(morphed).collect()
        } else {
            Vec::new()
        };
        Self {
            poses,
            triangles: (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)).collect(),
            points,
            offsets,
            has_skin,
            fits_weights: has_skin && options.weights,
            influences_before: influences.clone(),
            influences,
            most: options.max_influences.map_or(most, |limit| most.min(limit as usize)).max(1),
            scale_sq: mesh.diagonal().powi(2),
        }
    }

    /// Where a vertex is stored in a pose: morphed, not moved by joints yet.
    fn base(&self, pose: usize, v: u32) -> DVec3 {
        self.points[v as usize] + self.offsets.get(pose).map_or(DVec3::ZERO, |offsets| offsets[v as usize])
    }

    fn map(&self, pose: usize, v: u32) -> DAffine3 {
        let matrices = &self.poses[pose].joint_matrices;
        if !self.has_skin {
            return DAffine3::from_mat4(self.poses[pose].transform);
        }
        let influences = &self.influences[v as usize];
        if influences.is_empty() {
            return DAffine3::IDENTITY;
        }
        let blend = |sum, &(joint, weight): &(u32, f64)| {
            sum + matrices.get(joint as usize).copied().unwrap_or(DMat4::IDENTITY) * weight
        };
        DAffine3::from_mat4(influences.iter().fold(DMat4::ZERO, blend))
    }

    fn posed(&self, pose: usize) -> Vec<DVec3> {
        (0..self.points.len() as u32).map(|v| self.map(pose, v).transform_point3(self.base(pose, v))).collect()
    }

    /// Finds the nearest points of all samples and, for triangles that samples leave uncovered (they span what the original
    /// does not have, or has further away), the points of the original nearest to them.
    fn rows(&self, samples: &Samples) -> Rows {
        let total: f64 = self.poses.iter().map(|pose| pose.share).sum();
        let of_pose = |(k, of_pose): (usize, &Vec<Sample>)| {
            let share = self.poses[k].share / total;
            let points = self.posed(k);
            let positions: Vec<[f32; 3]> = points.iter().map(|p| p.as_vec3().to_array()).collect();
            let hierarchy = Bvh::of_triangles(&positions, &self.triangles);
            let mut searcher = hierarchy.searcher();
            let mut covered = vec![0.0; self.triangles.len()];
            let [mut forward, mut backward, mut areas] = [0.0; 3];
            let mut rows: Vec<(u32, Row)> = Vec::with_capacity(of_pose.len());
            for (i, sample) in (0..).zip(of_pose) {
                let Some(found) = searcher.closest(sample.point) else { continue };
                let corners = self.triangles[found.triangle as usize].map(|v| points[v as usize]);
                let wanted = sample.point - at(corners, found.barycentric);
                let Sample { normal, weight, .. } = *sample;
                covered[found.triangle as usize] += weight;
                forward += weight * found.distance_sq;
                rows.push((
                    found.triangle,
                    Row { pose: k as u32, sample: i, weights: found.barycentric, normal, wanted, weight },
                ));
            }
            let there = Bvh::of_triangles(&samples.positions[k], &samples.triangles);
            let mut searcher = there.searcher();
            for (t, corners) in (0..).zip(&self.triangles) {
                let corners = corners.map(|v| points[v as usize]);
                let area = scaled_normal(corners).length() / 2.0;
                let expected = area * samples.density * share;
                let uncovered = expected - covered[t as usize];
                for weights in MIDDLES {
                    let point = at(corners, weights);
                    let Some(found) = searcher.closest(point) else { continue };
                    backward += area * found.distance_sq / MIDDLES.len() as f64;
                    if uncovered > COVERED * covered[t as usize] {
                        let wanted = found.point - point;
                        let normal = wanted.normalize_or_zero();
                        let weight = uncovered / MIDDLES.len() as f64;
                        rows.push((t, Row { pose: k as u32, sample: NO_SAMPLE, weights, normal, wanted, weight }));
                    }
                }
                areas += area;
            }
            (rows, [forward, share * backward / areas.max(f64::MIN_POSITIVE)])
        };
        let all: Vec<(Vec<_>, [f64; 2])> = samples.poses.par_iter().enumerate().map(of_pose).collect();
        let weights: f64 = samples.poses.iter().flatten().map(|sample| sample.weight).sum();
        let mut by_triangle = vec![Vec::new(); self.triangles.len()];
        let mut mean_sq = [0.0; 2];
        for (rows, [forward, backward]) in all {
            rows.into_iter().for_each(|(t, row)| by_triangle[t as usize].push(row));
            mean_sq[0] += forward / weights.max(f64::MIN_POSITIVE);
            mean_sq[1] += backward;
        }
        Rows { by_triangle, mean_sq }
    }

    /// Steps of all vertices, where they are stored, that bring the surface nearest to the samples.
    fn moves(&self, rows: &Rows, fixed: &[bool]) -> Vec<DVec3> {
        let linear: Vec<Vec<DMat3>> = (0..self.poses.len())
            .map(|k| (0..self.points.len() as u32).map(|v| self.map(k, v).matrix3).collect())
            .collect();
        let block = |(t, of_triangle): (usize, &Vec<Row>)| {
            let mut sum = Block::default();
            for row in of_triangle {
                let r = self.triangles[t].map(|v| linear[row.pose as usize][v as usize]);
                let metric = row.metric();
                let wanted = metric * row.wanted;
                for i in 0..3 {
                    let from = r[i].transpose() * row.weights[i];
                    sum.wanted[i] += from * wanted;
                    let left = from * metric;
                    for (pair, (r, weight)) in sum.pairs[i].iter_mut().zip(r.iter().zip(row.weights)) {
                        *pair += left * *r * weight;
                    }
                }
            }
            sum
        };
        let blocks: Vec<Block> = rows.by_triangle.par_iter().enumerate().map(block).collect();
        let mut wanted = vec![DVec3::ZERO; self.points.len()];
        let mut diagonal = vec![DMat3::ZERO; self.points.len()];
        let mut counts = vec![0.0; self.points.len()];
        for (block, corners) in blocks.iter().zip(&self.triangles) {
            for (i, &v) in corners.iter().enumerate() {
                wanted[v as usize] += block.wanted[i];
                diagonal[v as usize] += block.pairs[i][i];
                counts[v as usize] += (0..3).map(|j| trace(&block.pairs[i][j])).sum::<f64>();
            }
        }
        let stay: Vec<f64> = counts.iter().map(|count| STAY * count.max(0.0)).collect();
        let inverse: Vec<DMat3> = (diagonal.iter().zip(&stay).zip(fixed))
            .map(|((d, stay), fixed)| {
                let m = *d + DMat3::IDENTITY * *stay;
                let is_regular = m.determinant().abs() > 0.0 && !fixed;
                if is_regular { m.inverse() } else { DMat3::ZERO }
            })
            .collect();
        let times = |x: &[DVec3]| {
            let mut y: Vec<DVec3> = x.iter().zip(&stay).map(|(x, stay)| *x * *stay).collect();
            for (block, corners) in blocks.iter().zip(&self.triangles) {
                for (i, &v) in corners.iter().enumerate() {
                    y[v as usize] += (0..3).map(|j| block.pairs[i][j] * x[corners[j] as usize]).sum::<DVec3>();
                }
            }
            y.iter_mut().zip(&inverse).filter(|(_, m)| **m == DMat3::ZERO).for_each(|(y, _)| *y = DVec3::ZERO);
            y
        };
        wanted.iter_mut().zip(&inverse).filter(|(_, m)| **m == DMat3::ZERO).for_each(|(w, _)| *w = DVec3::ZERO);
        let precondition = |r: &[DVec3]| r.iter().zip(&inverse).map(|(r, m)| *m * *r).collect();
        conjugate_gradients(times, precondition, wanted)
    }

    /// Finds the weights of each vertex that is not to stay, the others given.
    fn fit_weights(&mut self, rows: &Rows, fixed: &[bool], candidates: &[Vec<u32>]) {
        let mut around: Vec<Vec<(u32, u8)>> = vec![Vec::new(); self.points.len()];
        for (t, corners) in (0..).zip(&self.triangles) {
            (0..).zip(corners).for_each(|(k, &v)| around[v as usize].push((t, k)));
        }
        // what rows still want: each step takes its part
        let mut wanted: Vec<Vec<DVec3>> =
            rows.by_triangle.iter().map(|rows| rows.iter().map(|row| row.wanted).collect()).collect();
        for v in 0..self.points.len() as u32 {
            let mut joints: Vec<u32> = self.influences[v as usize].iter().map(|&(joint, _)| joint).collect();
            joints.extend(
                candidates[v as usize]
                    .iter()
                    .filter(|joint| !self.influences[v as usize].iter().any(|(known, _)| known == *joint)),
            );
            if joints.len() < 2 || fixed.get(v as usize) == Some(&true) {
                continue;
            }
            let now: Vec<f64> = joints
                .iter()
                .map(|joint| {
                    let own = self.influences[v as usize].iter().find(|(known, _)| known == joint);
                    own.map_or(0.0, |&(_, weight)| weight)
                })
                .collect();
            // where each joint alone would take the vertex, from where it is
            let steps: Vec<Vec<DVec3>> = (0..self.poses.len())
                .map(|k| {
                    let base = self.base(k, v);
                    let here = self.map(k, v).transform_point3(base);
                    let by = |&joint: &u32| {
                        let matrix = self.poses[k].joint_matrices.get(joint as usize).copied();
                        matrix.unwrap_or(DMat4::IDENTITY).transform_point3(base) - here
                    };
                    joints.iter().map(by).collect()
                })
                .collect();
            let n = joints.len();
            let (mut h, mut g) = (vec![0.0; n * n], vec![0.0; n]);
            let mut count = 0.0;
            for &(t, k) in &around[v as usize] {
                for (row, wanted) in rows.by_triangle[t as usize].iter().zip(&wanted[t as usize]) {
                    let share = row.weights[usize::from(k)];
                    let metric = row.metric();
                    let by = &steps[row.pose as usize];
                    for i in 0..n {
                        let left = metric * by[i] * share;
                        g[i] += left.dot(*wanted);
                        (0..n).for_each(|j| h[i * n + j] += left.dot(by[j]) * share);
                    }
                    count += row.weight * share * share;
                }
            }
            // steps are from where the vertex is: weights that sum to 1 give what joints want of it
            let keep = STAY_WEIGHTS * (0..n).map(|i| h[i * n + i]).fold(count * 1e-6 * self.scale_sq, f64::max);
            (0..n).for_each(|i| {
                h[i * n + i] += keep;
                g[i] += keep * now[i];
            });
            let best = simplex_least_squares(&h, &g, n, self.most);
            // as Gauss and Seidel do, the next vertex sees what this one has got
            for &(t, k) in &around[v as usize] {
                for (row, wanted) in rows.by_triangle[t as usize].iter().zip(&mut wanted[t as usize]) {
                    let by = &steps[row.pose as usize];
                    let moved: DVec3 = (0..n).map(|i| by[i] * best[i]).sum();
                    *wanted -= moved * row.weights[usize::from(k)];
                }
            }
            self.influences[v as usize] = joints.into_iter().zip(best).filter(|&(_, weight)| weight > 0.0).collect();
        }
        // positions are fitted next, to what is left
    }

    /// Takes back what turns triangles by more than 60 degrees in a pose.
    fn turn_back(&mut self, points: &[DVec3], influences: &[Vec<(u32, f64)>]) {
        let after: Vec<Vec<DVec3>> = (0..self.poses.len()).into_par_iter().map(|k| self.posed(k)).collect();
        let (moved, shifted) = (self.points.clone(), self.influences.clone());
        (self.points, self.influences) = (points.to_vec(), influences.to_vec());
        let before: Vec<Vec<DVec3>> = (0..self.poses.len()).into_par_iter().map(|k| self.posed(k)).collect();
        let mut is_back = vec![false; points.len()];
        loop {
            let place =
                |k: usize, v: u32| if is_back[v as usize] { before[k][v as usize] } else { after[k][v as usize] };
            let is_bad = |corners: &[u32; 3]| {
                if corners.iter().all(|&v| is_back[v as usize]) {
                    return false;
                }
                (0..self.poses.len()).any(|k| {
                    let [old, new] = [
                        scaled_normal(corners.map(|v| before[k][v as usize])),
                        scaled_normal(corners.map(|v| place(k, v))),
                    ];
                    old.dot(new) < 0.5 * (old.length_squared() * new.length_squared()).sqrt()
                })
            };
            let bad: Vec<[u32; 3]> = self.triangles.par_iter().filter(|corners| is_bad(corners)).copied().collect();
            if bad.is_empty() {
                break;
            }
            bad.iter().flatten().for_each(|&v| is_back[v as usize] = true);
        }
        for v in (0..points.len()).filter(|&v| !is_back[v]) {
            self.points[v] = moved[v];
            self.influences[v] = shifted[v].clone();
        }
    }

    /// Puts positions and weights into the mesh.
    fn write(&self, mesh: &mut Mesh) {
        for (position, point) in mesh.positions.iter_mut().zip(&self.points) {
            *position = point.as_vec3().to_array();
        }
        if !self.fits_weights {
            return;
        }
        let vertices = mesh.wedge_vertices.clone();
        let mut influences = self.influences.clone();
        influences.iter_mut().for_each(|all| all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0))));
        let place_of = |mesh: &Mesh, semantic| mesh.wedge_attributes.iter().position(|a| a.semantic == semantic);
        let mut first = 0;
        for set in 0.. {
            let places = [Semantic::Joints(set), Semantic::Weights(set)].map(|semantic| place_of(mesh, semantic));
            let [Some(joints), Some(weights)] = places else { break };
            for (slot, k) in (0..vertices.len()).flat_map(|w| (0..4).map(move |k| (4 * w + k, k))) {
                let vertex = vertices[slot / 4] as usize;
                if self.influences[vertex] == self.influences_before[vertex] {
                    continue; // to the bit, in the order that it has
                }
                let of_vertex = &influences[vertex];
                let (joint, weight) = of_vertex.get(first + k).copied().unwrap_or((0, 0.0));
                if let Values::U32(values) = &mut mesh.wedge_attributes[joints].values {
                    values[slot] = joint;
                }
                if let Values::F32(values) = &mut mesh.wedge_attributes[weights].values {
                    values[slot] = weight as f32;
                }
            }
            first += 4;
        }
    }
}

#[derive(Clone, Copy)]
struct Block {
    pairs: [[DMat3; 3]; 3],
    wanted: [DVec3; 3],
}

impl Default for Block {
    fn default() -> Self {
        Self { pairs: [[DMat3::ZERO; 3]; 3], wanted: [DVec3::ZERO; 3] }
    }
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// The weights, not negative and of sum 1, of at most `most` elements, for which `w' H w / 2 - g' w` is least: those that
/// would be negative go one after the other, then the least, until few enough are left.
fn simplex_least_squares(h: &[f64], g: &[f64], n: usize, most: usize) -> Vec<f64> {
    let mut active: Vec<usize> = (0..n).collect();
    loop {
        let w = solve_with_sum_one(h, g, n, &active);
        let least = (0..active.len()).min_by(|&a, &b| w[a].total_cmp(&w[b])).expect("something is active");
        if active.len() > 1 && (w[least] < 1e-4 || active.len() > most) {
            active.remove(least);
            continue;
        }
        let mut all = vec![0.0; n];
        active.iter().zip(w).for_each(|(&i, w)| all[i] = w);
        return all;
    }
}

/// Minimises over some weights of sum 1, by elimination: `H w + mu = g`, `sum w = 1`.
fn solve_with_sum_one(h: &[f64], g: &[f64], n: usize, active: &[usize]) -> Vec<f64> {
    let m = active.len();
    let mut a = vec![0.0; (m + 1) * (m + 2)];
    let width = m + 2;
    for (i, &p) in active.iter().enumerate() {
        for (j, &q) in active.iter().enumerate() {
            a[i * width + j] = h[p * n + q];
        }
        a[i * width + m] = 1.0;
        a[m * width + i] = 1.0;
        a[i * width + m + 1] = g[p];
    }
    a[m * width + m + 1] = 1.0;
    for column in 0..=m {
        let pivot = (column..=m)
            .max_by(|&i, &j| a[i * width + column].abs().total_cmp(&a[j * width + column].abs()))
            .expect("there are rows");
        if a[pivot * width + column].abs() < 1e-300 {
            return vec![1.0 / m as f64; m];
        }
        (0..width).for_each(|k| a.swap(column * width + k, pivot * width + k));
        for row in (0..=m).filter(|&row| row != column) {
            let factor = a[row * width + column] / a[column * width + column];
            if factor != 0.0 {
                (column..width).for_each(|k| a[row * width + k] -= factor * a[column * width + k]);
            }
        }
    }
    (0..m).map(|i| a[i * width + m + 1] / a[i * width + i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_of_the_closed_form() {
        // the nearest point of the triangle of unit weights to a target, with H the identity
        let nearest = |target: [f64; 3], most| {
            let h = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
            simplex_least_squares(&h, &target, 3, most)
        };
        let close =
            |a: Vec<f64>, b: [f64; 3]| assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12), "{a:?} {b:?}");
        close(nearest([0.2, 0.3, 0.5], 3), [0.2, 0.3, 0.5]);
        close(nearest([0.5, 0.6, 0.7], 3), [7.0 / 30.0, 1.0 / 3.0, 13.0 / 30.0]);
        close(nearest([0.8, 0.4, -1.0], 3), [0.7, 0.3, 0.0]);
        close(nearest([0.2, 0.3, 0.5], 2), [0.0, 0.4, 0.6]);
        close(nearest([0.2, 0.3, 0.5], 1), [0.0, 0.0, 1.0]);
    }
}
