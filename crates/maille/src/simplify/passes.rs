//! Many collapses at once: what takes most of the triangles from large meshes, on all cores.
//!
//! A pass takes the cheapest edges, as many as it is to collapse or a few more, and collapses those of them that do not
//! touch one another. The vertices, which lie along a curve through space, are cut into parts that fit into a
//! processor's cache; each part is one piece of work, whose collapses are all inside it, and from pass to pass the cuts
//! are shifted. So the result does not depend on the number of threads. Borders, seams and all that is not plain are left
//! to [`collapse_edges`](super::collapse_edges), and so are the last collapses, where the order counts most.
//!
//! Costs are kept with the edges. They hardly ever fall, so an edge whose cost was too high in the last pass is only
//! looked at again when the passes get there.
//!
//! meshoptimizer works in passes, too, from edge ends to edge ends; the parts, the placement and the kept costs are ours.

use glam::DVec3;
use rayon::prelude::*;

use super::driver::{Observer, Request};
use super::legality::{Collapse, Limits, landing, strictest};
use super::metric::{
    Anchor, Candidate, EdgeContext, QuadricMemory, QuadricMetric, QuadricOptions, REMEMBERED, drift_after,
    faces_of_star,
};
use super::options::{CurvePoint, SimplifyOptions};
use super::quadric::Quadric;
use super::wedges::WedgeMerger;
use crate::Control;
use crate::control::Cancelled;
use crate::radix::sort_by_bits;
use crate::topology::collapse_mesh::{Frame, RingFace};
use crate::topology::edge_star::{Around, MOST};
use crate::topology::fans::{Fans, FansPart, PIECE, Pairing, PairingPart, Spoke};
use crate::topology::{CollapseMesh, EdgeStar};

/// Vertices left in a part. Fewer fit better into the caches, but more edges are lost to the cuts, which shows in the
/// result where a surface is folded up tightly (a brain).
const PART: usize = 1 << 14;

/// Largest share of the vertices that one pass is to take.
const STEP: f64 = 0.5;

/// How many edges a pass tries for each vertex that it is to take. More make the order worse, fewer make more passes.
const TRIES: f64 = 2.0;

/// Times the target at which the passes end: from there on the exact order shows in the result.
const LEAVE: f64 = 2.0;

/// How far beyond its goal a pass may go.
const QUOTA: f64 = 1.2;

/// Least share of the faces that a pass has to take for another one to follow.
const LEAST: f64 = 0.06;

/// Faces below which passes gain nothing.
const FEWEST: usize = 1 << 15;

/// A surface while passes go over it.
pub(super) struct Surface {
    /// Coordinates in which costs are computed.
    pub frame: Frame,
    /// Positions of all vertices, in model units.
    pub positions: Vec<[f32; 3]>,
    fans: Fans,
    /// The vertices that passes may touch: the surface goes all around them, no feature touches them, nobody locks them.
    plain: Vec<bool>,
    /// One factor per vertex on costs; empty: all 1.
    pub importance: Vec<f32>,
    /// One factor per vertex on errors; empty: all 1.
    pub strictness: Vec<f32>,
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
    fn add(&mut self, other: &Self) {
        self.collapses += other.collapses;
        self.error = self.error.max(other.error);
    }
}

/// Takes faces away in passes until about [`LEAVE`] times the target is left or passes are worth it no more. An
/// observer that wants to see the collapses makes that work for one thread.
///
/// # Errors
/// [`Cancelled`]; the surface is then somewhere in between.
pub(super) fn collapse_in_passes<O: Observer>(
    surface: &mut Surface,
    metric: &mut QuadricMetric,
    mut observer: Option<&mut O>,
    request: &Request<'_>,
    control: Control<'_>,
) -> Result<Done, Cancelled> {
    let target_faces = request.target_faces;
    let start = surface.fans.face_count();
    let leave = ((target_faces as f64 * LEAVE) as usize + surface.stuck_faces()).max(FEWEST);
    let mut done = Done::default();
    if start <= leave {
        return Ok(done);
    }
    control.report("preparing", 0.0);
    let rules = Rules { options: metric.options, limits: request.limits, frame: surface.frame };
    let mut pairing = Pairing::new(surface.positions.len());
    surface.start_sums(metric);
    surface.parts(2 * PART / PIECE, false, metric, &mut pairing).into_par_iter().for_each(|mut part| {
        part.rank(&rules, f32::INFINITY);
    });
    let (mut most, mut rise) = (0.0_f32, 1.0);
    for pass in 0_usize.. {
        let faces = surface.fans.face_count();
        control.report("collapsing edges", (start - faces) as f32 / (start - target_faces) as f32);
        if control.is_cancelled() {
            return Err(Cancelled);
        }
        if faces <= leave + leave / 16 {
            break;
        }
        let goal = (faces as f64 * STEP).min((faces - leave) as f64) / 2.0;
        let costs = CostCounts::of(&surface.fans);
        // the edges whose costs are known stand for all
        let known = costs.up_to(f32::MAX) / (1.5 * faces as f64);
        most = costs.cost_of(goal * TRIES * known).max(most * rise);
        let quota = QUOTA * goal / costs.up_to(most).max(1.0);
        let pieces = (2 * PART * surface.positions.len()).div_ceil(faces * PIECE);
        pairing.clear();
        let mut parts = surface.parts(pieces, pass % 2 == 1, metric, &mut pairing);
        let results: Vec<Done> = match &mut observer {
            None => parts.par_iter_mut().map(|part| part.pass::<O>(&rules, most, quota, None)).collect(),
            Some(observer) => {
                parts.iter_mut().map(|part| part.pass(&rules, most, quota, Some(&mut **observer))).collect()
            }
        };
        results.iter().for_each(|result| done.add(result));
        surface.fans = surface.fans.merged(&pairing);
        done.curve.push(CurvePoint { triangles: surface.fans.face_count(), cost: f64::from(most) });
        let share = 1.0 - surface.fans.face_count() as f64 / faces as f64;
        if share < LEAST {
            break; // most of what is cheap is blocked by now: the queue goes around it
        }
        rise = rise_after(share) as f32;
    }
    Ok(done)
}

/// By how much the highest cost rises from a pass to the next, given the share of the faces that went.
///
/// The costs counted are those of the last time that an edge was looked at, so they lag behind. On a smooth surface costs
/// grow with the third power of the triangles' area, as the squared distances do with the second; a pass that took too
/// little makes the next go a little higher.
fn rise_after(share: f64) -> f64 {
    const WANTED: f64 = 0.2;
    const HURRY: f64 = 1.3;
    (1.0 - share).powi(-3) * (WANTED / share).clamp(1.0, HURRY)
}

/// How many edges there are of each cost, as far as costs are known.
struct CostCounts(Vec<u32>);

impl CostCounts {
    /// Bits of a cost that are not looked at: costs within one part in 16 count as equal.
    const SHIFT: u32 = 19;

    fn of(fans: &Fans) -> Self {
        let zero = || vec![0_u32; 1 << (31 - Self::SHIFT)];
        let counts = fans.pieces.par_iter().fold(zero, |mut counts, piece| {
            for spoke in piece.spokes() {
                counts[(spoke.cost.abs().to_bits() >> Self::SHIFT) as usize] += 1;
            }
            counts
        });
        let mut counts = counts.reduce(zero, |mut a, b| {
            a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
            a
        });
        counts[0] = 0; // not known
        Self(counts)
    }

    /// The cost up to which there are so many edges.
    fn cost_of(&self, edges: f64) -> f32 {
        let mut spokes = 0.0;
        let bucket = self.0.iter().position(|&count| {
            spokes += f64::from(count);
            spokes >= 2.0 * edges
        });
        bucket.map_or(f32::MAX, |bucket| f32::from_bits((bucket as u32 + 1) << Self::SHIFT).min(f32::MAX))
    }

    /// How many edges cost at most so much.
    fn up_to(&self, cost: f32) -> f64 {
        let end = (cost.min(f32::MAX).to_bits() >> Self::SHIFT) as usize;
        self.0[..=end].iter().map(|&count| f64::from(count)).sum::<f64>() / 2.0
    }
}

impl Surface {
    /// The surface of a mesh whose wedges are with their merger.
    pub(super) fn new(
        frame: Frame,
        positions: Vec<[f32; 3]>,
        triangles: &[[u32; 3]],
        wedges: &WedgeMerger<'_>,
        options: &SimplifyOptions,
    ) -> Self {
        let fans = Fans::new(positions.len(), triangles);
        let is_plain = |v: u32| {
            let around = fans.around(v);
            !options.locked.get(v as usize).is_some_and(|&locked| locked)
                && Around::closed(around.iter().map(|face| [face.x, face.y])).is_some()
                && (!wedges.have_seams() && !wedges.have_materials() || is_smooth(around, wedges))
        };
        let plain = (0..positions.len() as u32).into_par_iter().map(is_plain).collect();
        Self {
            frame,
            positions,
            fans,
            plain,
            importance: options.importance.clone(),
            strictness: options.strictness.clone(),
        }
    }

    /// What is left, for the queue to go on with: `triangles` is how many there were.
    pub(super) fn into_collapse_mesh(self, triangles: usize) -> (CollapseMesh, Vec<f32>, Vec<f32>) {
        let triangles = self.fans.triangles(triangles);
        (CollapseMesh::in_frame(self.frame, self.positions, triangles.into_iter()), self.importance, self.strictness)
    }

    /// The planes around each vertex, as the metric wants to keep them.
    fn start_sums(&self, metric: &mut QuadricMetric) {
        let vertices = self.positions.len();
        if metric.options.memory == QuadricMemory::Rebuilt {
            metric.drift_sq = vec![0.0; vertices];
            return;
        }
        metric.sums = vec![Quadric::default(); vertices];
        let options = metric.options;
        let point = |v: u32| self.frame.enter(self.positions[v as usize]);
        if options.line > 0.0 {
            let planes =
                |v: u32| options.planes_at(point(v), self.fans.around(v).iter().map(|face| [face.x, face.y]), point);
            metric.sums.par_iter_mut().enumerate().for_each(|(v, sum)| *sum = planes(v as u32));
            return;
        }
        metric.sums.par_chunks_mut(PIECE).enumerate().for_each(|(i, sums)| {
            let start = (i * PIECE) as u32;
            let place = |v: u32| v.wrapping_sub(start) as usize;
            for v in start..start + sums.len() as u32 {
                for &Spoke { x, y, .. } in self.fans.around(v) {
                    let inside = [x, y].map(|v| place(v) < sums.len());
                    // a face inside the piece is looked at once, another one at each of its vertices in the piece
                    if inside == [true; 2] && (x < v || y < v) {
                        continue;
                    }
                    let planes = options.face_planes([v, x, y].map(point));
                    sums[place(v)] += planes[0];
                    if inside == [true; 2] {
                        sums[place(x)] += planes[1];
                        sums[place(y)] += planes[2];
                    }
                }
            }
        });
    }

    /// Faces at vertices that passes may not touch.
    fn stuck_faces(&self) -> usize {
        let is_stuck = |v: u32| !self.plain[v as usize];
        let vertices = (0..self.positions.len() as u32).into_par_iter().filter(|&v| is_stuck(v));
        // each face at the first of its vertices that is stuck
        let first = |v: u32| {
            let counts = |w: u32| w > v || !is_stuck(w);
            self.fans.around(v).iter().filter(|face| counts(face.x) && counts(face.y)).count()
        };
        vertices.map(first).sum()
    }

    /// Cuts all that passes change into parts of so many pieces of the fans.
    fn parts<'a>(
        &'a mut self,
        pieces: usize,
        shifted: bool,
        metric: &'a mut QuadricMetric,
        pairing: &'a mut Pairing,
    ) -> Vec<Part<'a>> {
        fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
            let count = count.min(rest.len());
            let (first, others) = std::mem::take(rest).split_at_mut(count);
            *rest = others;
            first
        }
        let mut fans = self.fans.pieces.as_mut_slice();
        let mut positions = self.positions.as_mut_slice();
        let mut partners = pairing.partners_mut();
        let mut importance = self.importance.as_mut_slice();
        let mut strictness = self.strictness.as_mut_slice();
        let (mut sums, mut drift_sq) = (metric.sums.as_mut_slice(), metric.drift_sq.as_mut_slice());
        let mut parts = Vec::new();
        let mut start = 0;
        let mut pieces_now = if shifted { pieces.div_ceil(2) } else { pieces };
        while !fans.is_empty() {
            let count = pieces_now * PIECE;
            let at = start as usize;
            parts.push(Part {
                start,
                fans: FansPart { start, pieces: take(&mut fans, pieces_now) },
                positions: take(&mut positions, count),
                pairing: PairingPart { start, partners: take(&mut partners, count) },
                sums: take(&mut sums, count),
                drift_sq: take(&mut drift_sq, count),
                plain: &self.plain[at..self.plain.len().min(at + count)],
                importance: take(&mut importance, count),
                strictness: take(&mut strictness, count),
            });
            start += count as u32;
            pieces_now = pieces;
        }
        parts
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

/// What does not change.
struct Rules {
    options: QuadricOptions,
    limits: Limits,
    frame: Frame,
}

/// What has been found out about a vertex in the course of a pass.
#[derive(Debug, Clone, Copy, Default)]
struct Known {
    is_inner: Option<bool>,
    has_quadric: bool,
}

/// A range of vertices and all about them that passes change.
struct Part<'a> {
    start: u32,
    fans: FansPart<'a>,
    positions: &'a mut [[f32; 3]],
    pairing: PairingPart<'a>,
    sums: &'a mut [Quadric],
    drift_sq: &'a mut [f32],
    plain: &'a [bool],
    importance: &'a mut [f32],
    strictness: &'a mut [f32],
}

impl Part<'_> {
    fn pass<O: Observer>(&mut self, rules: &Rules, most: f32, quota: f64, observer: Option<&mut O>) -> Done {
        let (mut ranked, considered) = self.rank(rules, most);
        sort_by_bits(&mut ranked, 32, &mut Vec::new());
        self.collapse(rules, &ranked, (quota * considered as f64) as u64, observer)
    }

    #[inline]
    fn place(&self, v: u32) -> usize {
        (v - self.start) as usize
    }

    #[inline]
    fn point(&self, rules: &Rules, v: u32) -> DVec3 {
        rules.frame.enter(self.positions[self.place(v)])
    }

    /// Brings the costs of edges up to date that are not known to be higher than `most`. Those that are not: the cost, and
    /// the lower end with the number of its spoke, in one number. And how many were looked at.
    fn rank(&mut self, rules: &Rules, most: f32) -> (Vec<u64>, usize) {
        let end = self.start + self.positions.len() as u32;
        let mut vertices = vec![Known::default(); self.positions.len()];
        let mut rebuilt = match rules.options.memory {
            QuadricMemory::Summed => Vec::new(),
            _ => vec![Quadric::default(); self.positions.len()],
        };
        let mut ranked = Vec::new();
        let mut considered = 0;
        for (a, i) in self.fans.edges_up_to(most) {
            let Spoke { x: b, mut cost, .. } = self.fans.around(a)[i];
            let is_inner = |v: u32, vertices: &mut [Known]| self.is_inner(v, &mut vertices[self.place(v)]);
            if b >= end || !is_inner(a, &mut vertices) || !is_inner(b, &mut vertices) {
                continue;
            }
            considered += 1;
            if cost <= 0.0 {
                if !rebuilt.is_empty() {
                    for v in [a, b] {
                        let place = self.place(v);
                        if !std::mem::replace(&mut vertices[place].has_quadric, true) {
                            rebuilt[place] = self.planes_around(rules, v);
                        }
                    }
                }
                cost = self.cost(rules, [a, b], || rebuilt[self.place(a)] + rebuilt[self.place(b)]);
                self.fans.around_mut(a)[i].cost = cost;
                for back in self.fans.around_mut(b).iter_mut().filter(|back| back.x == a) {
                    back.cost = cost;
                }
            }
            if cost <= most {
                ranked.push(u64::from(cost.to_bits()) << 32 | u64::from((a - self.start) << 5 | i as u32));
            }
        }
        (ranked, considered)
    }

    fn planes_around(&self, rules: &Rules, v: u32) -> Quadric {
        let point = |v: u32| self.point(rules, v);
        rules.options.planes_at(point(v), self.fans.around(v).iter().map(|face| [face.x, face.y]), point)
    }

    /// What an edge costs; infinite if it must not collapse.
    fn cost(&self, rules: &Rules, ends: [u32; 2], rebuilt: impl FnOnce() -> Quadric) -> f32 {
        let edge = EdgeContext { ends, points: ends.map(|v| self.point(rules, v)), anchor: Anchor::Free };
        let candidate = self.candidate(&rules.options, &edge, rebuilt).1;
        if candidate.cost.is_nan() || rules.limits.exceeds(candidate.error_sq, self.strictness_of(ends)) {
            return f32::INFINITY;
        }
        let importance = |v: u32| self.importance.get(self.place(v)).copied().unwrap_or(1.0);
        // zero means unknown
        (candidate.cost as f32 * importance(ends[0]).max(importance(ends[1]))).max(f32::MIN_POSITIVE)
    }

    #[inline]
    fn strictness_of(&self, ends: [u32; 2]) -> f32 {
        let [a, b] = ends.map(|v| self.strictness.get(self.place(v)).copied());
        strictest(a, b)
    }

    /// Whether passes may touch a vertex and all around it is in this part.
    #[inline]
    fn is_inner(&self, v: u32, known: &mut Known) -> bool {
        *known.is_inner.get_or_insert_with(|| {
            let around = self.fans.around(v);
            let end = self.start + self.positions.len() as u32;
            self.plain[self.place(v)]
                && around.len() <= MOST
                && around.iter().all(|face| face.x >= self.start && face.x < end)
        })
    }

    /// The quadric that places a merged vertex, and what it gives.
    #[inline]
    fn candidate(
        &self,
        options: &QuadricOptions,
        edge: &EdgeContext,
        rebuilt: impl FnOnce() -> Quadric,
    ) -> (Quadric, Candidate) {
        let [a, b] = edge.ends.map(|v| self.place(v));
        match options.memory {
            QuadricMemory::Summed => {
                let q = self.sums[a] + self.sums[b];
                (q, options.candidate(&q, None, 0.0, edge))
            }
            QuadricMemory::Rebuilt => {
                let q = rebuilt();
                (q, options.candidate(&q, None, self.drift_sq_of([a, b]), edge))
            }
            QuadricMemory::Both => {
                let q = rebuilt();
                (q, options.candidate(&q, Some((&(self.sums[a] + self.sums[b]), REMEMBERED)), 0.0, edge))
            }
        }
    }

    fn drift_sq_of(&self, places: [usize; 2]) -> f64 {
        f64::from(self.drift_sq[places[0]].max(self.drift_sq[places[1]]))
    }

    /// Collapses edges, cheapest first, as long as their ends are as they were.
    fn collapse<O: Observer>(
        &mut self,
        rules: &Rules,
        ranked: &[u64],
        quota: u64,
        mut observer: Option<&mut O>,
    ) -> Done {
        let mut done = Done::default();
        let mut rings = [Vec::new(), Vec::new()];
        for entry in ranked {
            if done.collapses >= quota {
                break;
            }
            let kept = self.start + (*entry as u32 >> 5);
            if self.pairing.is_taken(kept) {
                continue;
            }
            let removed = self.fans.around(kept)[(entry & 31) as usize].x;
            if self.pairing.is_taken(removed) {
                continue;
            }
            if let Some(error) = self.try_collapse(rules, [kept, removed], &mut rings, observer.as_deref_mut()) {
                done.collapses += 1;
                done.error = done.error.max(error);
            }
        }
        done
    }

    /// Collapses an edge unless that is forbidden; the error of the collapse, in model units.
    fn try_collapse<O: Observer>(
        &mut self,
        Rules { options, limits, frame }: &Rules,
        ends @ [kept, removed]: [u32; 2],
        rings: &mut [Vec<RingFace>; 2],
        observer: Option<&mut O>,
    ) -> Option<f64> {
        let [kept_ring, removed_ring] = rings;
        self.ring(kept, kept_ring);
        self.ring(removed, removed_ring);
        let star = EdgeStar::on_closed_surface(ends, kept_ring, removed_ring);
        if !star.is_regular() {
            return None;
        }
        let places @ [at, other] = ends.map(|v| self.place(v));
        let point = |v: u32| frame.enter(self.positions[self.place(v)]);
        let edge = EdgeContext { ends, points: ends.map(point), anchor: Anchor::Free };
        let planes =
            |p: DVec3, ring: &[RingFace]| options.planes_at(p, ring.iter().map(|face| [face.x, face.y]), point);
        let rebuilt = || planes(edge.points[0], kept_ring) + planes(edge.points[1], removed_ring);
        let (placing, candidate) = self.candidate(options, &edge, rebuilt);
        if limits.exceeds(candidate.error_sq, self.strictness_of(ends)) {
            return None;
        }
        let faces = faces_of_star(ends, [kept_ring, removed_ring], point);
        let target = options.refine(&placing, &edge, candidate.position, faces);
        let (position, t) = landing(frame, target, places.map(|place| self.positions[place]), edge.points);
        let error = candidate.error_sq.sqrt() * frame.unit();
        let collapse = Collapse { star, position, t, error };
        if limits.folds_over(frame, &collapse, point) {
            return None;
        }
        if let Some(observer) = observer {
            observer.on_collapse(&collapse);
        }
        match options.memory {
            QuadricMemory::Rebuilt => {
                self.drift_sq[at] = drift_after(&placing, frame.enter(position), self.drift_sq_of(places));
            }
            QuadricMemory::Summed | QuadricMemory::Both => self.sums[at] += self.sums[other],
        }
        if !self.importance.is_empty() {
            self.importance[at] = self.importance[at].max(self.importance[other]);
        }
        if !self.strictness.is_empty() {
            self.strictness[at] = self.strictness[at].max(self.strictness[other]);
        }
        self.positions[at] = position;
        self.pairing.pair(ends);
        Some(error)
    }

    /// The faces around a vertex without a partner, as they are now.
    #[inline]
    fn ring(&self, v: u32, ring: &mut Vec<RingFace>) {
        ring.clear();
        for spoke in self.fans.around(v) {
            let (x, y) = (self.pairing.now(spoke.x), self.pairing.now(spoke.y));
            if x != y {
                let (face, corner) = (spoke.corner / 4, (spoke.corner % 4) as u8);
                ring.push(RingFace { face, corner, x, y, edge_x: u32::MAX, edge_y: u32::MAX });
            }
        }
    }
}
