//! Many collapses at once: what takes most of the triangles from large meshes, on all cores.
//!
//! The vertices, which lie along a curve through space, are cut into parts that fit into a processor's cache. In each
//! part the cheapest edges collapse, in their order, up to a cost that is the same for all; the collapses of a part are
//! all inside it. That is one pass; before the next, what is left is put together anew and the cuts are shifted. So the
//! result does not depend on the number of threads. Borders, seams and all that is not plain are left to
//! [`collapse_edges`](super::collapse_edges), and so are the last collapses of all. Near the target, where the order
//! counts most, one part is the whole surface.
//!
//! meshoptimizer works in passes, too, on the whole mesh and from edge ends to edge ends; the parts, the order in them
//! and the placement are ours.

use rayon::prelude::*;
use wide::f32x4;

use super::driver::{Observer, Outcome, Request};
use super::legality::{Collapse, Limits, strictest};
use super::local_quadric::{EdgeQuadric, LocalPlanes, LocalQuadric, Place, axes, cross, dot, minus, scaled, shortness};
use super::metric::{QuadricMemory, QuadricOptions, REMEMBERED, VOLUME_PRICE};
use super::options::{CurvePoint, PlacementKind, QuadricWeight, Refusals, SimplifyOptions, Stop};
use super::quadric::Quadric;
use super::wedges::WedgeMerger;
use crate::control::Cancelled;
use crate::topology::collapse_mesh::{Frame, RingFace};
use crate::topology::edge_star::Around;
use crate::topology::fans::{Cut, Fans, FansPart, MOST_FACES, MergedRing, Spoke};
use crate::topology::{CollapseMesh, EdgeStar};
use crate::{Control, Mesh};

/// Vertices of a part: two to this power. Fewer fit better into the caches, but more edges are lost to the cuts.
const PART: u32 = 12;

/// Share of the edges that the cuts must leave: with fewer, parts become larger. That is so where surfaces lie close to one
/// another (a brain).
const LEFT_BY_CUTS: f64 = 0.75;

/// Largest share of the vertices that one pass is to take.
const STEP: f64 = 0.4;

/// How many edges there are below the cost at which a pass ends, for each vertex that it is to take.
const TRIES: f64 = 3.0;

/// How far above the target one part becomes the whole, as a share of the target: from there on the order shows in the
/// result.
const WHOLE: f64 = 0.25;

/// The same as a share of all that goes, if that is less.
const WHOLE_OF_ALL: f64 = 0.15;

/// Times the target at which the passes end, not counting what is stuck, where the queue has to go on.
const LEAVE: f64 = 1.25;

/// How far beyond its goal a pass may go.
const QUOTA: f64 = 1.2;

/// Least share of the faces that a pass has to take for another one to follow.
const LEAST: f64 = 0.06;

/// Faces below which passes gain nothing.
pub(super) const FEWEST: usize = 1 << 15;

/// Faces at which the passes end in any case: what is left by then is soon done.
const LAST: usize = 2000;

/// A surface while passes go over it. Vertices are those that are left, in their first order.
pub(super) struct Surface {
    /// Coordinates in which costs are computed.
    frame: Frame,
    /// Positions of all vertices, in model units.
    positions: Vec<[f32; 3]>,
    fans: Fans,
    /// The vertices that passes may touch: the surface goes all around them, no feature touches them, nobody locks them.
    plain: Vec<bool>,
    /// One factor per vertex on costs; empty: all 1.
    importance: Vec<f32>,
    /// One factor per vertex on errors; empty: all 1.
    strictness: Vec<f32>,
    /// The number that each vertex had at first.
    origin: Vec<u32>,
    /// Of each vertex, the sum of all planes that it has merged with; empty where quadrics are only rebuilt.
    sums: Vec<LocalQuadric>,
    /// Squared distance from the original that the vertices have gone; empty where sums are kept.
    drift_sq: Vec<f32>,
}

/// What passes did.
#[derive(Debug, Default, Clone)]
pub(super) struct Done {
    pub collapses: u64,
    /// Largest error of a collapse, in model units.
    pub error: f64,
    /// Costs after each pass, in the frame of the mesh.
    pub curve: Vec<CurvePoint>,
}

impl Done {
    /// As if nothing else had been done: for when the target is met.
    pub(super) fn outcome(self) -> Outcome {
        let Self { collapses, error, curve } = self;
        Outcome { collapses, error, curve, stopped: Stop::Triangles, refused: Refusals::default() }
    }

    /// With what was done after it.
    pub(super) fn and(self, mut later: Outcome) -> Outcome {
        let highest = self.highest_cost();
        later.curve.iter_mut().for_each(|point| point.cost = point.cost.max(highest));
        later.curve.splice(..0, self.curve);
        later.collapses += self.collapses;
        later.error = later.error.max(self.error);
        later
    }

    fn add(&mut self, other: Self) {
        self.collapses += other.collapses;
        self.error = self.error.max(other.error);
        let highest = self.highest_cost();
        self.curve.extend(other.curve.into_iter().map(|point| CurvePoint { cost: point.cost.max(highest), ..point }));
    }

    fn highest_cost(&self) -> f64 {
        self.curve.last().map_or(0.0, |last| last.cost)
    }
}

/// Whether passes can work with such quadrics.
pub(super) fn know(options: &QuadricOptions) -> bool {
    let plain = QuadricOptions { weight: QuadricWeight::Area, ..*options }.is_plain();
    plain && options.weight != QuadricWeight::Angle
}

/// Takes faces away in passes until the target is met or passes are worth it no more. An observer that wants to see the
/// collapses makes that work for one thread.
///
/// # Errors
/// [`Cancelled`]; the surface is then somewhere in between.
pub(super) fn collapse_in_passes<O: Observer>(
    surface: &mut Surface,
    options: &QuadricOptions,
    mut observer: Option<&mut O>,
    request: &Request<'_>,
    control: Control<'_>,
) -> Result<Done, Cancelled> {
    let rules = Rules::new(*options, request.limits, surface.frame);
    let start = surface.fans.face_count();
    let stuck = surface.stuck_faces();
    let mut done = Done::default();
    control.report("preparing", 0.0);
    surface.start_quadrics(&rules);
    let target = request.target_faces.max(LAST);
    let end = if stuck == 0 { target } else { (LEAVE * target as f64) as usize + stuck };
    let extra = (end as f64 * WHOLE).min(start.saturating_sub(end) as f64 * WHOLE_OF_ALL);
    let whole = (end + extra as usize).max(FEWEST);
    let mut faces = start;
    let mut part_bits = PART;
    let (mut most, mut tries) = (0.0_f32, TRIES);
    for pass in 0_usize.. {
        control.report("collapsing edges", (start - faces) as f32 / (start - target.min(start)).max(1) as f32);
        if faces <= end {
            break;
        }
        let is_last = faces <= whole + whole / 5;
        let cut = match (is_last, pass % 2) {
            (true, _) => Cut::one(surface.positions.len()),
            (false, odd) => Cut::new(part_bits, odd == 1),
        };
        surface.compact(cut);
        let mut parts = surface.parts();
        let ranked: Vec<Ranked> = parts.par_iter().map(|part| part.rank(&rules)).collect();
        let costs = CostCounts::of(&ranked);
        let known = costs.up_to(f32::INFINITY) / (1.5 * faces as f64);
        // a collapse takes two faces: the last may take one too many
        let goal = if is_last {
            (faces - end).div_ceil(2) as f64
        } else {
            (faces as f64 * STEP).min((faces - whole) as f64) / 2.0 * known
        };
        most = if is_last { f32::MAX } else { costs.cost_of(goal * tries).max(most) };
        let share = goal / costs.up_to(most).max(1.0);
        let pass = |(part, ranked): (&mut Part<'_>, Ranked), observer: Option<&mut O>| {
            let quota = if is_last { goal } else { QUOTA * share * ranked.up_to(most) };
            part.collapse(
                &rules,
                ranked,
                Bounds { most, quota: quota as u64, faces: is_last.then_some(faces), control },
                observer,
            )
        };
        let results: Vec<Done> = match &mut observer {
            None => parts.par_iter_mut().zip(ranked).map(|work| pass(work, None)).collect(),
            Some(observer) => parts.iter_mut().zip(ranked).map(|work| pass(work, Some(&mut **observer))).collect(),
        };
        if control.is_cancelled() {
            return Err(Cancelled);
        }
        let collapses: u64 = results.iter().map(|result| result.collapses).sum();
        let left = faces - 2 * collapses as usize;
        results.into_iter().for_each(|result| done.add(result));
        if !is_last {
            done.curve.push(CurvePoint { triangles: left, cost: f64::from(most) });
        }
        let taken = 1.0 - left as f64 / faces as f64;
        faces = left;
        if is_last || taken < LEAST * known {
            break; // most of what is cheap is blocked by now: the queue goes around it
        }
        tries = (tries * goal / collapses as f64).clamp(TRIES / 2.0, TRIES * 2.0);
        part_bits += u32::from(known < LEFT_BY_CUTS);
    }
    surface.compact(Cut::one(surface.positions.len()));
    Ok(done)
}

/// How many edges there are of each cost.
struct CostCounts(Vec<u32>);

impl CostCounts {
    fn of(ranked: &[Ranked]) -> Self {
        let zero = || vec![0_u32; bucket_of(f32::INFINITY) + 1];
        let counts = ranked.par_iter().fold(zero, |mut counts, part| {
            part.costs.iter().for_each(|&cost| counts[bucket_of(cost)] += 1);
            counts
        });
        Self(counts.reduce(zero, |mut a, b| {
            a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
            a
        }))
    }

    /// The cost up to which there are so many edges.
    fn cost_of(&self, edges: f64) -> f32 {
        let mut sum = 0.0;
        let bucket = self.0.iter().position(|&count| {
            sum += f64::from(count);
            sum >= edges
        });
        bucket.map_or(f32::MAX, |bucket| cost_of(bucket + 1).min(f32::MAX))
    }

    /// How many edges cost at most so much.
    fn up_to(&self, cost: f32) -> f64 {
        self.0[..=bucket_of(cost)].iter().map(|&count| f64::from(count)).sum::<f64>()
    }
}

/// Bits of a cost that are not looked at: costs within one part in 16 count as equal.
const SHIFT: u32 = 19;

/// Where a cost belongs; costs are not negative. What is no number costs too much.
#[inline]
fn bucket_of(cost: f32) -> usize {
    (cost.to_bits().min(f32::INFINITY.to_bits()) >> SHIFT) as usize
}

/// The lowest cost of a bucket.
fn cost_of(bucket: usize) -> f32 {
    f32::from_bits((bucket as u32) << SHIFT)
}

impl Surface {
    /// The surface of a mesh whose wedges, if it is more than positions and triangles, are with their merger.
    pub(super) fn new(
        frame: Frame,
        positions: Vec<[f32; 3]>,
        triangles: &[[u32; 3]],
        wedges: Option<&WedgeMerger<'_>>,
        options: &SimplifyOptions,
    ) -> Self {
        let fans = Fans::new(positions.len(), triangles, Cut::new(PART, false), wedges.is_some());
        let wedges = wedges.filter(|wedges| wedges.have_seams() || wedges.have_materials());
        let is_plain = |part: &FansPart, v: u32| {
            !options.locked.get(v as usize).is_some_and(|&locked| locked)
                && part.ring(v).is_some()
                && wedges.is_none_or(|wedges| is_smooth(&part.around(v).collect::<Vec<_>>(), wedges))
        };
        let plain =
            fans.parts.par_iter().flat_map_iter(|part| part.vertices().map(move |v| is_plain(part, v))).collect();
        Self {
            frame,
            origin: (0..positions.len() as u32).collect(),
            positions,
            fans,
            plain,
            importance: options.importance.clone(),
            strictness: options.strictness.clone(),
            sums: Vec::new(),
            drift_sq: Vec::new(),
        }
    }

    /// Leaves out the vertices that are no more, and cuts the others into parts.
    fn compact(&mut self, cut: Cut) {
        let live = self.fans.live();
        if live.len() == self.positions.len() && self.fans.cut() == cut {
            return;
        }
        self.fans = self.fans.renamed(&live, cut);
        gather(&mut self.positions, &live);
        gather(&mut self.plain, &live);
        gather(&mut self.importance, &live);
        gather(&mut self.strictness, &live);
        gather(&mut self.origin, &live);
        gather(&mut self.sums, &live);
        gather(&mut self.drift_sq, &live);
    }

    /// Quadrics as the metric wants to keep them.
    fn start_quadrics(&mut self, rules: &Rules) {
        if rules.options.memory == QuadricMemory::Rebuilt {
            self.drift_sq = vec![0.0; self.positions.len()];
            return;
        }
        let point = |v: u32| Some(self.positions[v as usize]);
        let planes = self.fans.parts.par_iter().flat_map_iter(|part| planes_around(part, rules, point));
        self.sums = planes.map(LocalQuadric::from).collect();
    }

    /// Faces at vertices that passes may not touch.
    fn stuck_faces(&self) -> usize {
        let is_stuck = |v: u32| !self.plain[v as usize];
        let vertices = (0..self.positions.len() as u32).into_par_iter().filter(|&v| is_stuck(v));
        // each face at the first of its vertices that is stuck
        let first = |v: u32| {
            let counts = |w: u32| w > v || !is_stuck(w);
            self.fans.around(v).filter(|face| counts(face.x) && counts(face.y)).count()
        };
        vertices.map(first).sum()
    }

    /// Cuts all that passes change into the parts of the fans.
    fn parts(&mut self) -> Vec<Part<'_>> {
        fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
            let count = count.min(rest.len());
            let (first, others) = std::mem::take(rest).split_at_mut(count);
            *rest = others;
            first
        }
        let mut positions = self.positions.as_mut_slice();
        let mut importance = self.importance.as_mut_slice();
        let mut strictness = self.strictness.as_mut_slice();
        let (mut sums, mut drift_sq) = (self.sums.as_mut_slice(), self.drift_sq.as_mut_slice());
        let mut parts = Vec::with_capacity(self.fans.parts.len());
        for fans in &mut self.fans.parts {
            let (start, count) = (fans.start as usize, fans.len());
            parts.push(Part {
                start: fans.start,
                fans,
                positions: take(&mut positions, count),
                sums: take(&mut sums, count),
                drift_sq: take(&mut drift_sq, count),
                plain: &self.plain[start..start + count],
                origin: &self.origin[start..start + count],
                importance: take(&mut importance, count),
                strictness: take(&mut strictness, count),
            });
        }
        parts
    }

    /// What is left as a mesh of its own: for surfaces that are but positions and triangles.
    pub(super) fn into_mesh(self) -> (Mesh, Rest) {
        let triangles = self.fans.triangles();
        let rest = Rest {
            sums: self.quadrics(),
            drift_sq: self.drift_sq,
            importance: self.importance,
            strictness: self.strictness,
            origin: self.origin,
        };
        (Mesh::from_triangles(self.positions, triangles).expect("faces name vertices that exist"), rest)
    }

    /// What is left with the numbers that vertices and faces had at first: there were so many vertices and `triangles`.
    pub(super) fn into_collapse_mesh(self, vertices: usize, triangles: usize) -> (CollapseMesh, Rest) {
        fn spread<T: Clone>(values: &[T], origin: &[u32], vertices: usize, other: T) -> Vec<T> {
            let mut all = vec![other; if values.is_empty() { 0 } else { vertices }];
            for (value, &old) in values.iter().zip(origin) {
                all[old as usize] = value.clone();
            }
            all
        }
        let left = self.fans.followed(triangles, |v| self.origin[v as usize]);
        let spread_f32 = |values: &[f32]| spread(values, &self.origin, vertices, 0.0);
        let rest = Rest {
            sums: spread(&self.quadrics(), &self.origin, vertices, Quadric::default()),
            drift_sq: spread_f32(&self.drift_sq),
            importance: spread_f32(&self.importance),
            strictness: spread_f32(&self.strictness),
            origin: (0..vertices as u32).collect(),
        };
        let positions = spread(&self.positions, &self.origin, vertices, [0.0; 3]);
        (CollapseMesh::in_frame(self.frame, positions, left.into_iter()), rest)
    }

    /// The sums as the queue wants them.
    fn quadrics(&self) -> Vec<Quadric> {
        let quadric = |(sum, &p): (&LocalQuadric, &[f32; 3])| sum.around(self.frame.enter(p));
        self.sums.par_iter().zip(&self.positions).map(quadric).collect()
    }
}

/// What the vertices of a surface bring along when passes are done.
pub(super) struct Rest {
    /// Planes of faces, summed; empty where quadrics are only rebuilt.
    pub sums: Vec<Quadric>,
    /// Squared distance from the original that the vertices have gone; empty where sums are kept.
    pub drift_sq: Vec<f32>,
    pub importance: Vec<f32>,
    pub strictness: Vec<f32>,
    /// The number that each vertex had at first.
    pub origin: Vec<u32>,
}

/// Keeps the elements at some places, in their order.
fn gather<T: Copy + Send + Sync>(values: &mut Vec<T>, places: &[u32]) {
    if !values.is_empty() {
        *values = places.par_iter().map(|&i| values[i as usize]).collect();
    }
}

/// Whether nothing jumps at the edges around a vertex.
fn is_smooth(around: &[Spoke], wedges: &WedgeMerger<'_>) -> bool {
    let corner = |spoke: &Spoke, step: u32| ((spoke.corner / 4) as usize, ((spoke.corner % 4 + step) % 3) as usize);
    around.iter().all(|face| {
        around.iter().filter(|next| next.y == face.x).all(|next| {
            wedges.material(corner(face, 0).0) == wedges.material(corner(next, 0).0)
                && !wedges.jump_between(corner(face, 0), corner(next, 0))
                && !wedges.jump_between(corner(face, 1), corner(next, 2))
        })
    })
}

/// The planes of the faces around each vertex of a part; faces with a corner that has no position do not count.
fn planes_around(fans: &FansPart, rules: &Rules, point: impl Fn(u32) -> Option<[f32; 3]>) -> Vec<LocalPlanes> {
    let mut sums = vec![LocalPlanes::default(); fans.len()];
    let vertices = fans.vertices();
    for v in vertices.clone() {
        let Some(p) = point(v) else { continue };
        let mut add = |x: u32, y: u32| {
            let is_inside = vertices.contains(&x) & vertices.contains(&y);
            // a face inside the part is looked at once, another one at each of its vertices in the part
            if is_inside & ((x < v) | (y < v)) {
                return;
            }
            let (Some(to_x), Some(to_y)) = (point(x), point(y)) else { return };
            let planes = rules.planes_of_face(cross(rules.between(p, to_x), rules.between(p, to_y)));
            sums[(v - fans.start) as usize] += planes;
            if is_inside {
                sums[(x - fans.start) as usize] += planes;
                sums[(y - fans.start) as usize] += planes;
            }
        };
        match fans.ring(v) {
            Some(ring @ [.., last]) => {
                let mut x = *last;
                for &y in ring {
                    add(x, y);
                    x = y;
                }
            }
            _ => fans.around(v).for_each(|Spoke { x, y, .. }| add(x, y)),
        }
    }
    sums
}

/// What does not change.
struct Rules {
    options: QuadricOptions,
    limits: Limits,
    frame: Frame,
    /// One over the unit of the frame: a power of two.
    scale: f32,
}

impl Rules {
    fn new(options: QuadricOptions, limits: Limits, frame: Frame) -> Self {
        Self { options, limits, frame, scale: (1.0 / frame.unit()) as f32 }
    }

    /// From one point to another, in the frame.
    #[inline(always)]
    fn between(&self, from: [f32; 3], to: [f32; 3]) -> [f32; 3] {
        scaled(minus(to, from), self.scale)
    }

    /// A point moved by a vector of the frame.
    fn moved(&self, p: [f32; 3], by: [f32; 3]) -> [f32; 3] {
        axes(|k| {
            let moved = f64::from(p[k]) + f64::from(by[k]) * self.frame.unit();
            moved.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
        })
    }

    /// What the plane of a face gives to its corners.
    #[inline(always)]
    fn planes_of_face(&self, scaled_normal: [f32; 3]) -> LocalPlanes {
        let length_sq = dot(scaled_normal, scaled_normal);
        if length_sq <= 0.0 {
            return LocalPlanes::default();
        }
        let weight = match self.options.weight {
            QuadricWeight::Uniform => 1.0,
            QuadricWeight::AreaSquared => length_sq / 4.0,
            QuadricWeight::Area | QuadricWeight::Angle => length_sq.sqrt() / 2.0,
        };
        LocalPlanes::of_face(scaled_normal, weight, length_sq)
    }
}

/// What is found out about a part before its edges collapse.
struct Ranked {
    /// The vertices that passes may touch now: all around them is in the part.
    is_inner: Vec<bool>,
    /// The planes of the faces around each vertex; empty where quadrics are only summed.
    rebuilt: Vec<LocalPlanes>,
    /// Of each edge between inner vertices, in the order of [`Part::edges`].
    costs: Vec<f32>,
}

impl Ranked {
    /// How many edges cost at most so much.
    fn up_to(&self, most: f32) -> f64 {
        self.costs.iter().filter(|&&cost| bucket_of(cost) <= bucket_of(most)).count() as f64
    }
}

/// How far the collapses of a part may go.
struct Bounds<'a> {
    most: f32,
    quota: u64,
    /// Of the whole surface, if that is the part: costs are plotted then.
    faces: Option<usize>,
    control: Control<'a>,
}

/// Edges that wait, by cost; those within one part in 16 come in no special order.
struct Buckets {
    /// The last entry of each bucket.
    heads: Vec<u32>,
    entries: Vec<Entry>,
    /// Buckets below are empty.
    lowest: usize,
}

/// An edge that waits.
#[derive(Clone, Copy)]
struct Entry {
    ends: [u32; 2],
    /// The sum of the ends' versions.
    stamp: u32,
    /// The next entry in the same bucket.
    next: u32,
}

impl Buckets {
    fn up_to(most: f32) -> Self {
        Self { heads: vec![u32::MAX; bucket_of(most) + 1], entries: Vec::new(), lowest: 0 }
    }

    /// Adds an edge, unless it costs too much.
    #[inline]
    fn push(&mut self, cost: f32, ends: [u32; 2], stamp: u32) {
        let bucket = bucket_of(cost);
        if let Some(head) = self.heads.get_mut(bucket) {
            self.lowest = self.lowest.min(bucket);
            let next = std::mem::replace(head, self.entries.len() as u32);
            self.entries.push(Entry { ends, stamp, next });
        }
    }

    /// One of the cheapest, and its bucket.
    #[inline]
    fn pop(&mut self) -> Option<(Entry, usize)> {
        while self.lowest < self.heads.len() {
            let head = &mut self.heads[self.lowest];
            if *head != u32::MAX {
                let entry = self.entries[*head as usize];
                *head = entry.next;
                return Some((entry, self.lowest));
            }
            self.lowest += 1;
        }
        None
    }
}

/// Version of a vertex that is no more.
const GONE: u32 = 1 << 30;

/// A range of vertices and all about them that passes change. Vertices are numbered within the part, but for spokes.
struct Part<'a> {
    start: u32,
    fans: &'a mut FansPart,
    positions: &'a mut [[f32; 3]],
    sums: &'a mut [LocalQuadric],
    drift_sq: &'a mut [f32],
    plain: &'a [bool],
    origin: &'a [u32],
    importance: &'a mut [f32],
    strictness: &'a mut [f32],
}

/// A placement and what it costs.
struct Collapsing {
    edge: EdgeQuadric<f32>,
    summed: Option<EdgeQuadric<f32>>,
    half: [f32; 3],
    place: Place,
    cost: f32,
    error_sq: f32,
}

impl Part<'_> {
    /// What all edges cost.
    fn rank(&self, rules: &Rules) -> Ranked {
        let vertices = self.fans.vertices();
        let is_inside = |v: &u32| vertices.contains(v);
        let is_inner = |v: u32| {
            let ring =
                self.fans.ring(v).filter(|ring| self.plain[(v - self.start) as usize] && ring.len() <= MOST_FACES);
            ring.is_some_and(|ring| ring.iter().fold(true, |all, v| all & is_inside(v)))
        };
        let is_inner: Vec<bool> = vertices.clone().map(is_inner).collect();
        let rebuilt = match rules.options.memory {
            QuadricMemory::Summed => Vec::new(),
            _ => planes_around(self.fans, rules, |v| self.positions.get(v.wrapping_sub(self.start) as usize).copied()),
        };
        let mut costs = Vec::new();
        let mut four = [[0; 2]; 4];
        let mut count = 0;
        self.edges(&is_inner, |ends| {
            four[count] = ends;
            count += 1;
            if count == 4 {
                costs.extend(self.costs(rules, &rebuilt, four));
                count = 0;
            }
        });
        costs.extend(&self.costs(rules, &rebuilt, four)[..count]);
        Ranked { is_inner, rebuilt, costs }
    }

    /// The edges between inner vertices.
    #[inline]
    fn edges(&self, is_inner: &[bool], mut visit: impl FnMut([u32; 2])) {
        for (v, _) in (0..).zip(is_inner).filter(|(_, is_inner)| **is_inner) {
            for &x in self.fans.ring(self.start + v).unwrap_or_default() {
                let x = x - self.start;
                if x > v && is_inner[x as usize] {
                    visit([v, x]);
                }
            }
        }
    }

    /// From the middles of four edges to their second ends.
    #[inline(always)]
    fn halves(&self, rules: &Rules, ends: &[[u32; 2]; 4]) -> [f32x4; 3] {
        let mut halves = [[0.0; 4]; 3];
        for (i, &[u, v]) in ends.iter().enumerate() {
            let (u, v) = (self.positions[u as usize], self.positions[v as usize]);
            for k in 0..3 {
                halves[k][i] = v[k] - u[k];
            }
        }
        let factor = f32x4::splat(0.5 * rules.scale);
        [f32x4::new(halves[0]) * factor, f32x4::new(halves[1]) * factor, f32x4::new(halves[2]) * factor]
    }

    /// What four edges cost; infinite where they must not collapse.
    #[inline]
    fn costs(&self, rules: &Rules, rebuilt: &[LocalPlanes], ends: [[u32; 2]; 4]) -> [f32; 4] {
        let half = self.halves(rules, &ends);
        let (cost, is_sound) = match rules.options.memory {
            QuadricMemory::Summed => four_costs(LocalQuadric::of_edges(self.sums, &ends, half), None, half),
            QuadricMemory::Rebuilt => four_costs(LocalPlanes::of_edges(rebuilt, &ends, half), None, half),
            QuadricMemory::Both => {
                let summed = LocalQuadric::of_edges(self.sums, &ends, half);
                four_costs(LocalPlanes::of_edges(rebuilt, &ends, half), Some(summed), half)
            }
        };
        let is_optimal = matches!(rules.options.placement, PlacementKind::Optimal | PlacementKind::OptimalVolume);
        let is_simple = is_optimal
            && !rules.options.normalized
            && self.importance.is_empty()
            && rules.limits.max_error_sq.is_none();
        let mut costs = cost.to_array();
        if is_simple && is_sound == 0b1111 {
            return costs;
        }
        for (k, cost) in costs.iter_mut().enumerate() {
            if !is_simple || is_sound >> k & 1 == 0 {
                *cost = self.evaluate(rules, rebuilt, ends[k]).cost;
            }
        }
        costs
    }

    /// Placement and cost of one edge.
    #[inline]
    fn evaluate(&self, rules: &Rules, rebuilt: &[LocalPlanes], ends: [u32; 2]) -> Collapsing {
        let [u, v] = [ends[0] as usize, ends[1] as usize];
        let half = scaled(minus(self.positions[v], self.positions[u]), 0.5 * rules.scale);
        let planes = || LocalPlanes::of_edge(&rebuilt[u], &rebuilt[v], half);
        let sums = || LocalQuadric::of_edge(&self.sums[u], &self.sums[v], half);
        let (edge, summed) = match rules.options.memory {
            QuadricMemory::Summed => (sums(), None),
            QuadricMemory::Rebuilt => (planes(), None),
            QuadricMemory::Both => (planes(), Some(sums())),
        };
        let place = edge.place(half, rules.options.placement);
        let (mut cost, mut error_sq) = (place.value, edge.mean(place.value));
        if let Some(summed) = &summed {
            let remembered = summed.at(place.offset).max(0.0);
            cost += REMEMBERED as f32 * remembered;
            error_sq = error_sq.max(summed.mean(remembered));
        }
        if let (Some(&a), Some(&b)) = (self.drift_sq.get(u), self.drift_sq.get(v)) {
            error_sq += a.max(b);
        }
        let short = shortness(half);
        cost = if rules.options.normalized { error_sq + short } else { cost + short * edge.weight };
        if let (Some(&a), Some(&b)) = (self.importance.get(u), self.importance.get(v)) {
            cost *= a.max(b);
        }
        let strictness = strictest(self.strictness.get(u).copied(), self.strictness.get(v).copied());
        if cost.is_nan() || rules.limits.exceeds(f64::from(error_sq), strictness) {
            cost = f32::INFINITY;
        }
        Collapsing { edge, summed, half, place, cost, error_sq }
    }

    /// Collapses edges, cheapest first.
    fn collapse<O: Observer>(
        &mut self,
        rules: &Rules,
        ranked: Ranked,
        Bounds { most, quota, faces, control }: Bounds<'_>,
        mut observer: Option<&mut O>,
    ) -> Done {
        let Ranked { is_inner, mut rebuilt, costs } = ranked;
        let mut queue = Buckets::up_to(most);
        let mut costs = costs.into_iter();
        self.edges(&is_inner, |ends| queue.push(costs.next().unwrap_or(f32::INFINITY), ends, 0));
        let mut versions = vec![0_u32; is_inner.len()];
        let mut star = Star::default();
        let mut done = Done::default();
        let (mut highest, mut plotted) = (0, faces.unwrap_or(0));
        while done.collapses < quota && !(done.collapses.is_multiple_of(4096) && control.is_cancelled()) {
            let Some((Entry { ends: ends @ [kept, removed], stamp, .. }, bucket)) = queue.pop() else { break };
            if versions[kept as usize] + versions[removed as usize] != stamp {
                continue;
            }
            let collapsing = self.evaluate(rules, &rebuilt, ends);
            if bucket_of(collapsing.cost) > bucket {
                queue.push(collapsing.cost, ends, stamp);
                continue;
            }
            let Some(error) =
                self.try_collapse(rules, ends, &collapsing, &mut rebuilt, &mut star, observer.as_deref_mut())
            else {
                continue;
            };
            done.collapses += 1;
            done.error = done.error.max(error);
            highest = highest.max(bucket);
            if let Some(faces) = faces {
                let triangles = faces - 2 * done.collapses as usize;
                if done.collapses == quota || triangles <= plotted - plotted.div_ceil(16) {
                    done.curve.push(CurvePoint { triangles, cost: f64::from(cost_of(highest)) });
                    plotted = triangles;
                }
            }
            versions[kept as usize] += 1;
            versions[removed as usize] = GONE;
            // what the edges at the merged vertex cost now
            for some in star.ring.neighbors().chunks(4) {
                let mut ends = [[kept, some[0] - self.start]; 4];
                for (ends, neighbor) in ends.iter_mut().zip(some).skip(1) {
                    ends[1] = neighbor - self.start;
                }
                let costs = self.costs(rules, &rebuilt, ends);
                for (&cost, ends) in costs.iter().zip(ends).take(some.len()) {
                    if is_inner[ends[1] as usize] {
                        queue.push(cost, ends, versions[kept as usize] + versions[ends[1] as usize]);
                    }
                }
            }
        }
        done
    }

    /// Collapses an edge unless that is forbidden; the error of the collapse, in model units.
    fn try_collapse<O: Observer>(
        &mut self,
        rules: &Rules,
        ends @ [kept, _]: [u32; 2],
        collapsing: &Collapsing,
        rebuilt: &mut [LocalPlanes],
        star: &mut Star,
        observer: Option<&mut O>,
    ) -> Option<f64> {
        let names = [self.start + ends[0], self.start + ends[1]];
        let kept_ring = self.fans.ring(names[0]).unwrap_or_default();
        let removed_ring = self.fans.ring(names[1]).unwrap_or_default();
        let is_tetrahedron = kept_ring.len() + removed_ring.len() <= 6;
        if is_tetrahedron
            || !self.fans.merged_ring(names[0], names[1], &mut star.ring)
            || Around::of_ring(kept_ring).count(&Around::of_ring(removed_ring)) != 2
        {
            return None;
        }
        self.fill_star(rules, ends, star);
        let Collapsing { edge, half, mut place, .. } = *collapsing;
        if rules.options.placement == PlacementKind::OptimalVolume && place.end.is_none() {
            // relative to the middle, the ends are at -half and half
            let [at_kept, at_removed] = star.flux;
            let flux = axes(|k| at_kept[k] + at_removed[k]);
            let level = dot(minus(at_removed, at_kept), half);
            place = edge.on_plane(half, &place, flux, level, VOLUME_PRICE as f32).unwrap_or(place);
        }
        let places @ [at, other] = [ends[0] as usize, ends[1] as usize];
        let from_kept = axes(|k| half[k] + place.offset[k]);
        let position = match place.end {
            Some(end) => self.positions[places[end]],
            None => rules.moved(self.positions[at], from_kept),
        };
        let target = rules.between(self.positions[at], position);
        let along = scaled(half, 2.0);
        let length_sq = dot(along, along);
        let t = if length_sq > 0.0 { (dot(target, along) / length_sq).clamp(0.0, 1.0) } else { 0.0 };
        let error = f64::from(collapsing.error_sq).sqrt() * rules.frame.unit();
        let cost = f64::from(collapsing.cost);
        let folds = |part: &Self| {
            let rings = part.rings(ends, |v| v);
            let star = EdgeStar::on_closed_surface(ends.map(|v| v + part.start), &rings[0], &rings[1]);
            let point = |v: u32| rules.frame.enter(part.positions[(v - part.start) as usize]);
            rules.limits.folds_over(&rules.frame, &Collapse { star, position, t, error, cost }, point)
        };
        match rules.limits.min_normal_cos.map(|min_cos| star.folds_over(target, min_cos as f32)) {
            Some(Some(true)) => return None,
            Some(None) if folds(self) => return None,
            _ => {}
        }
        if let Some(observer) = observer {
            let rings = self.rings(ends, |v| self.origin[(v - self.start) as usize]);
            let star = EdgeStar::on_closed_surface(ends.map(|v| self.origin[v as usize]), &rings[0], &rings[1]);
            observer.on_collapse(&Collapse { star, position, t, error, cost });
        }
        // the rounded place, from the middle
        let offset = minus(target, half);
        if let Some(sum) = collapsing.summed.as_ref().or(rebuilt.is_empty().then_some(&edge)) {
            self.sums[at] = LocalQuadric::merged(sum, offset);
        }
        if !self.drift_sq.is_empty() {
            let drift = self.drift_sq[at].max(self.drift_sq[other]);
            self.drift_sq[at] = drift + edge.mean(edge.at(offset).max(0.0));
        }
        if !rebuilt.is_empty() {
            star.update(rules, target, [self.start, kept], rebuilt);
        }
        if !self.importance.is_empty() {
            self.importance[at] = self.importance[at].max(self.importance[other]);
        }
        if !self.strictness.is_empty() {
            self.strictness[at] = self.strictness[at].max(self.strictness[other]);
        }
        self.positions[at] = position;
        self.fans.merge(names[0], names[1], &star.ring);
        Some(error)
    }

    /// The faces around both ends, with names for the vertices.
    fn rings(&self, ends: [u32; 2], name: impl Fn(u32) -> u32) -> [Vec<RingFace>; 2] {
        let face = |spoke: Spoke| RingFace {
            face: spoke.corner / 4,
            corner: (spoke.corner % 4) as u8,
            x: name(spoke.x),
            y: name(spoke.y),
            edge_x: u32::MAX,
            edge_y: u32::MAX,
        };
        ends.map(|v| self.fans.around(self.start + v).map(&face).collect())
    }

    /// Looks at the faces around an edge.
    fn fill_star(&self, rules: &Rules, [kept, removed]: [u32; 2], star: &mut Star) {
        let origin = self.positions[kept as usize];
        let from_kept = |v: u32| rules.between(origin, self.positions[(v - self.start) as usize]);
        star.removed_at = rules.between(origin, self.positions[removed as usize]);
        let len = star.ring.len;
        for (i, &v) in star.ring.neighbors().iter().enumerate() {
            let p = from_kept(v);
            for (points, x) in star.points.iter_mut().zip(p) {
                points[i] = x;
            }
        }
        // once more the first, up to what four at a time look at
        for k in 0..3 {
            let first = star.points[k][0];
            star.points[k][len..len.next_multiple_of(4) + 1].fill(first);
        }
        star.find_normals();
    }
}

/// What four edges cost, and as bits which of them are sound: the best place is near the edge.
#[inline(always)]
fn four_costs(edges: EdgeQuadric<f32x4>, summed: Option<EdgeQuadric<f32x4>>, half: [f32x4; 3]) -> (f32x4, u32) {
    let (place, value, is_sound) = edges.optima(half);
    let zero = f32x4::splat(0.0);
    let value = value.fast_max(zero);
    let mut cost = value + shortness(half) * edges.weight;
    if let Some(summed) = summed {
        cost += summed.at(place).fast_max(zero) * f32x4::splat(REMEMBERED as f32);
    }
    (cost, is_sound)
}

/// The faces around an edge, from the vertex that stays, in the frame: those that remain when it collapses, which stand on
/// the sides of a ring.
struct Star {
    ring: MergedRing,
    /// The corners of the ring, then the first once more, several times.
    points: [[f32; ROOM]; 3],
    /// Scaled normals of the faces; those beyond the last are zero.
    normals: [[f32; ROOM]; 3],
    removed_at: [f32; 3],
    /// The scaled normals of the faces at both ends: those at the first corner and at the one that comes as the last of the
    /// vertex that stays.
    dying: [[f32; 3]; 2],
    /// Sums of the scaled normals of the faces of either end; those at both count for the one that stays.
    flux: [[f32; 3]; 2],
}

#[inline(always)]
fn splat(p: [f32; 3]) -> [f32x4; 3] {
    axes(|k| f32x4::splat(p[k]))
}

/// Room for the corners of a ring, and what comes after them.
const ROOM: usize = MergedRing::ROOM + 4;

impl Default for Star {
    fn default() -> Self {
        Self {
            ring: MergedRing::default(),
            points: [[0.0; ROOM]; 3],
            normals: [[0.0; ROOM]; 3],
            removed_at: [0.0; 3],
            dying: [[0.0; 3]; 2],
            flux: [[0.0; 3]; 2],
        }
    }
}

impl Star {
    #[inline]
    fn find_normals(&mut self) {
        let mut flux = [[f32x4::splat(0.0); 3]; 2];
        let kept_faces = f32x4::splat(self.ring.kept_faces as f32);
        let removed_at = splat(self.removed_at);
        for i in (0..self.ring.len).step_by(4) {
            let is_kept = (f32x4::splat(i as f32) + f32x4::new([0.0, 1.0, 2.0, 3.0])).simd_lt(kept_faces);
            let base = axes(|k| !is_kept & removed_at[k]);
            let [x, y] = self.sides_from(i, base);
            let normals = cross(x, y);
            for k in 0..3 {
                self.normals[k][i..i + 4].copy_from_slice(&normals[k].to_array());
                flux[0][k] += is_kept & normals[k];
                flux[1][k] += !is_kept & normals[k];
            }
        }
        self.flux = [axes(|k| flux[0][k].reduce_add()), axes(|k| flux[1][k].reduce_add())];
        let corner = |i: usize| axes(|k| self.points[k][i]);
        let last = corner(self.ring.kept_faces);
        self.dying = [cross(self.removed_at, corner(0)), cross(last, self.removed_at)];
        for normal in self.dying {
            self.flux[0].iter_mut().zip(normal).for_each(|(flux, x)| *flux += x);
        }
    }

    #[inline(always)]
    fn four(values: &[f32; ROOM], i: usize) -> f32x4 {
        values[i..].first_chunk().map_or_else(f32x4::default, |&four| f32x4::new(four))
    }

    /// From a point to the two corners of the ring that belong to each of four faces.
    #[inline(always)]
    fn sides_from(&self, i: usize, p: [f32x4; 3]) -> [[f32x4; 3]; 2] {
        [axes(|k| Self::four(&self.points[k], i) - p[k]), axes(|k| Self::four(&self.points[k], i + 1) - p[k])]
    }

    /// Whether the normal of a face turns by more than it may when the merged vertex goes to a point; `None` if single
    /// precision cannot tell.
    fn folds_over(&self, target: [f32; 3], min_cos: f32) -> Option<bool> {
        /// Of the sine of the angle at the vertex, squared: below, rounding may decide.
        const NEEDLE: f32 = 1e-9;
        const UNSURE: f32 = 1e-3;
        let mut is_sure = true;
        let target = splat(target);
        for i in (0..self.ring.len).step_by(4) {
            let [x, y] = self.sides_from(i, target);
            let after = cross(x, y);
            let before = axes(|k| Self::four(&self.normals[k], i));
            let (before_sq, after_sq) = (dot(before, before), dot(after, after));
            let turned = dot(before, after);
            let lengths = before_sq.sqrt() * after_sq.sqrt();
            let is_thick =
                after_sq.simd_gt(dot(x, x) * dot(y, y) * f32x4::splat(NEEDLE)) & before_sq.simd_gt(f32x4::splat(1e-34));
            let folds = is_thick & turned.simd_le(lengths * f32x4::splat(min_cos - UNSURE));
            if folds.any() {
                return Some(true);
            }
            let fits = is_thick & turned.simd_gt(lengths * f32x4::splat(min_cos + UNSURE));
            // those beyond the last face do not count
            let count = (self.ring.len - i).min(4);
            is_sure &= fits.to_bitmask() | 0b1111 << count & 0b1111 == 0b1111;
        }
        is_sure.then_some(false)
    }

    /// Brings the planes around vertices up to date, for a collapse to a point.
    fn update(&self, rules: &Rules, target: [f32; 3], [start, kept]: [u32; 2], rebuilt: &mut [LocalPlanes]) {
        let target = splat(target);
        let place = |i: usize| (self.ring.neighbors()[i] - start) as usize;
        let mut sum = LocalPlanes::default();
        for i in (0..self.ring.len).step_by(4) {
            let [x, y] = self.sides_from(i, target);
            let after = cross(x, y);
            let after = axes(|k| after[k].to_array());
            for k in 0..(self.ring.len - i).min(4) {
                let before = rules.planes_of_face(axes(|axis| self.normals[axis][i + k]));
                let after = rules.planes_of_face(axes(|axis| after[axis][k]));
                sum += after;
                let change = after - before;
                rebuilt[place(i + k)] += change;
                rebuilt[place(if i + k + 1 == self.ring.len { 0 } else { i + k + 1 })] += change;
            }
        }
        for (i, normal) in [0, self.ring.kept_faces].into_iter().zip(self.dying) {
            let apex = place(i);
            rebuilt[apex] = rebuilt[apex] - rules.planes_of_face(normal);
        }
        rebuilt[kept as usize] = sum;
    }
}
