//! The loop: take the cheapest collapse, test it, make it, tell everyone.

use rayon::prelude::*;

use super::crossings::Crossings;
use super::features::{Barred, Features};
use super::legality::{Collapse, Limits, landing, strictest};
use super::metric::{Anchor, Candidate, EdgeContext, Metric, Update};
use super::normal_cones::NormalCones;
use super::options::{CurvePoint, Order, Refusals, Stop, TopologyPolicy};
use super::patience::Patience;
use super::queue::Queue;
use crate::control::Cancelled;
use crate::topology::collapse_mesh::{CollapseEffect, Marks, RingFace};
use crate::topology::{CollapseMesh, EdgeStar};
use crate::{Control, Mesh};

/// Sees every collapse just before it is made.
pub trait Observer {
    /// A collapse is about to be made.
    fn on_collapse(&mut self, collapse: &Collapse<'_>);

    /// The collapse just seen is settled. `give` writes the values that the metric has chosen for some wedges into a mesh
    /// with the same wedges ([`Metric::give_values`]).
    fn on_values(&mut self, _give: &mut dyn FnMut(&[u32], &mut Mesh)) {}
}

/// Sees nothing.
impl Observer for () {
    fn on_collapse(&mut self, _: &Collapse<'_>) {}
}

/// Both see everything.
impl<A: Observer, B: Observer> Observer for (A, B) {
    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        self.0.on_collapse(collapse);
        self.1.on_collapse(collapse);
    }

    fn on_values(&mut self, give: &mut dyn FnMut(&[u32], &mut Mesh)) {
        self.0.on_values(give);
        self.1.on_values(give);
    }
}

/// What the loop did.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Collapses made.
    pub collapses: u64,
    /// Largest error of a collapse, in model units.
    pub error: f64,
    /// How the costs have risen; costs are in the frame of the mesh.
    pub curve: Vec<CurvePoint>,
    /// Why it stopped.
    pub stopped: Stop,
    /// What the constraints refused.
    pub refused: Refusals,
}

/// What the loop is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Stop at this many faces or fewer. Unless it is zero, the last faces stay.
    pub target_faces: usize,
    /// In which order edges collapse.
    pub order: Order,
    /// Tests that every collapse has to pass.
    pub limits: Limits,
    /// One factor per vertex on costs; empty: all 1.
    pub importance: &'a [f32],
    /// One factor per vertex on errors before they are compared with the largest; empty: all 1.
    pub strictness: &'a [f32],
}

/// Collapses edges of `mesh`, cheapest first, until the request is met or nothing is left to collapse.
///
/// This is the workshop door: any [`Metric`], any [`Observer`], one loop. [`simplify`](super::simplify) is the easy one.
///
/// # Errors
/// [`Cancelled`]; the mesh is then somewhere in between.
pub fn collapse_edges<M: Metric, O: Observer>(
    mesh: &mut CollapseMesh,
    metric: &mut M,
    features: &mut Features,
    observer: &mut O,
    request: &Request<'_>,
    control: Control<'_>,
) -> Result<Outcome, Cancelled> {
    control.report("preparing", 0.0);
    metric.prepare(mesh, features);
    let mut run = Loop {
        marks: Marks::new(mesh.vertex_count()),
        importance: request.importance.to_vec(),
        strictness: request.strictness.to_vec(),
        order: request.order,
        outcome: Outcome {
            collapses: 0,
            error: 0.0,
            curve: Vec::new(),
            stopped: Stop::Exhausted,
            refused: Refusals::default(),
        },
        highest_cost: 0.0,
        over_error: false,
        patience: Patience::new(mesh),
        cones: request.limits.max_normal_deviation.map(|most| NormalCones::new(mesh, most)),
        crossings: request.limits.no_self_intersections.then(|| Crossings::new(mesh)),
        mesh,
        metric,
        features,
        observer,
        limits: request.limits,
        target_faces: request.target_faces,
        kept_ring: Vec::new(),
        removed_ring: Vec::new(),
        effect: CollapseEffect::default(),
    };
    let start = run.mesh.live_face_count();
    let mut queue = run.fill_queue();
    let mut collapses_at_fill = 0;
    let mut steps = 0_u64;
    while run.mesh.live_face_count() > request.target_faces {
        if steps.is_multiple_of(4096) {
            let wanted = (start - request.target_faces) as f32;
            control.report("collapsing edges", (start - run.mesh.live_face_count()) as f32 / wanted);
            if control.is_cancelled() {
                return Err(Cancelled);
            }
        }
        steps += 1;
        run.look_ahead(&mut queue);
        if let Some((edge, cost)) = queue.peek() {
            run.step(&mut queue, edge, cost);
            continue;
        }
        // what was refused may have become legal through collapses nearby: once more, as long as that is worth it
        let progress = run.outcome.collapses - collapses_at_fill;
        if progress * 50 < run.mesh.live_face_count() as u64 || progress == 0 {
            if run.limits.parts_may_go || request.limits.max_error_sq.is_some() {
                break;
            }
            run.limits.parts_may_go = true;
        }
        collapses_at_fill = run.outcome.collapses;
        queue = run.fill_queue();
    }
    run.outcome.stopped = if run.mesh.live_face_count() <= request.target_faces {
        Stop::Triangles
    } else {
        run.count_barred();
        if run.over_error { Stop::MaxError } else { Stop::NoLegalCollapse }
    };
    Ok(run.outcome)
}

/// How much a cost may rise before an edge goes back into the queue: what `f32` rounds away, and a little more.
const SLACK: f64 = 1.0 + 1e-6;

fn has_risen(cost: f64, stored: f64) -> bool {
    cost > stored * SLACK + f64::MIN_POSITIVE && f64::from(cost as f32) > stored
}

struct Loop<'a, M, O> {
    mesh: &'a mut CollapseMesh,
    metric: &'a mut M,
    features: &'a mut Features,
    observer: &'a mut O,
    limits: Limits,
    target_faces: usize,
    importance: Vec<f32>,
    strictness: Vec<f32>,
    order: Order,
    marks: Marks,
    outcome: Outcome,
    highest_cost: f64,
    /// Whether some collapse was refused because of its error alone.
    over_error: bool,
    /// Used up, edges at vertices of very many faces are not looked at.
    patience: Patience,
    /// What normals are held against, where they are.
    cones: Option<NormalCones>,
    /// Where faces lie, if the surface must not pass through itself.
    crossings: Option<Crossings>,
    kept_ring: Vec<RingFace>,
    removed_ring: Vec<RingFace>,
    effect: CollapseEffect,
}

/// What the cost of an edge depends on.
struct Costs<'a, M> {
    mesh: &'a CollapseMesh,
    metric: &'a M,
    features: &'a Features,
    importance: &'a [f32],
    /// Whether small parts may go, at what their loss costs.
    prunes: bool,
}

/// Most faces that are looked at to find out whether a collapse makes a part of the surface vanish.
const LAST_FACES: usize = 6;

impl<M: Metric> Costs<'_, M> {
    /// What is lost with the last faces of a part, if the collapse of an edge makes it vanish: their area, and how far it
    /// is from what stays, squared, taken for their longest edge. Planes say nothing of that. `None` for an edge of
    /// anything larger than a tetrahedron.
    fn extinction(&self, ends: [u32; 2]) -> Option<(f64, f64)> {
        let [a, b] = ends.map(|v| self.mesh.faces_around(v).take(LAST_FACES + 1).count());
        if a + b > LAST_FACES + 2 {
            return None;
        }
        let mut corners = [u32::MAX; 4];
        corners[..2].copy_from_slice(&ends);
        let mut known = 2;
        let (mut area, mut length_sq) = (0.0, 0.0_f64);
        let mut i = 0;
        while i < known {
            let v = corners[i];
            let p = self.mesh.point(v);
            for (n, face) in self.mesh.faces_around(v).enumerate() {
                if n > LAST_FACES {
                    return None;
                }
                for w in [face.x, face.y] {
                    if corners[..known].contains(&w) {
                        continue;
                    }
                    if known == corners.len() {
                        return None; // larger than that
                    }
                    corners[known] = w;
                    known += 1;
                }
                let [x, y] = [face.x, face.y].map(|w| self.mesh.point(w) - p);
                area += x.cross(y).length() / 6.0; // a third of it from each corner
                length_sq = length_sq.max(x.length_squared()).max(y.length_squared());
            }
            i += 1;
        }
        Some((area, length_sq))
    }

    /// The candidate of an edge; `Ok(None)` when it is no more or the metric forbids it.
    #[inline]
    fn evaluate(&self, edge: u32) -> Result<Option<Candidate>, Barred> {
        if !self.mesh.has_edge(edge) {
            return Ok(None);
        }
        let ends = self.mesh.ends(edge);
        let anchor = self.features.anchor(edge, ends)?;
        let context = EdgeContext { ends, points: ends.map(|v| self.mesh.point(v)), anchor };
        let mut candidate = self.metric.evaluate(self.mesh, self.features, &context);
        if let (Some(candidate), true) = (&mut candidate, self.prunes)
            && let Some((area, length_sq)) = self.extinction(ends)
        {
            candidate.cost = candidate.cost.max(area * length_sq);
            candidate.error_sq = candidate.error_sq.max(length_sq);
        }
        if let (Some(candidate), false) = (&mut candidate, self.importance.is_empty()) {
            let [a, b] = ends.map(|v| f64::from(self.importance[v as usize]));
            candidate.cost *= match anchor {
                // what stays does not lose its detail
                Anchor::First => b,
                Anchor::Second => a,
                Anchor::Free => a.max(b),
            };
        }
        Ok(candidate)
    }
}

impl<M: Metric, O: Observer> Loop<'_, M, O> {
    fn costs(&self) -> Costs<'_, M> {
        let prunes = self.limits.parts_may_go;
        Costs { mesh: self.mesh, metric: self.metric, features: self.features, importance: &self.importance, prunes }
    }

    fn fill_queue(&self) -> Queue {
        let costs = self.costs();
        let cost = |edge| costs.evaluate(edge).ok().flatten().map_or(f32::NAN, |candidate| candidate.cost as f32);
        let costs: Vec<f32> = (0..self.mesh.edge_count() as u32).into_par_iter().map(cost).collect();
        Queue::new(costs.iter().map(|&cost| (!cost.is_nan()).then_some(f64::from(cost))), self.order)
    }

    /// Starts loading what the next steps need: first the edge, later its ends, last the faces around them, each once
    /// what it takes to find it has arrived. The distances are by measurement; between half and twice of them, the
    /// time hardly changes.
    ///
    /// Where costs are computed again when they come up, most have risen and go back: that is found out on the way,
    /// before the faces are loaded for nothing.
    #[inline]
    fn look_ahead(&self, queue: &mut Queue) {
        if let Some(edge) = queue.upcoming(32) {
            queue.prefetch(edge);
            self.mesh.prefetch_edge(edge);
        }
        if let Some((edge, _)) = queue.upcoming_cost(18) {
            for v in self.mesh.ends(edge) {
                self.mesh.prefetch_vertex(v);
                self.metric.prefetch(v);
            }
        }
        if self.metric.update() == Update::WhenDue
            && let Some((edge, stored)) = queue.upcoming_cost(10)
        {
            match self.costs().evaluate(edge) {
                Ok(Some(candidate)) if !has_risen(candidate.cost, stored) => {}
                Ok(Some(candidate)) => queue.set(edge, candidate.cost),
                _ => queue.remove(edge),
            }
        }
        for (step, ahead) in [9, 7, 5, 3].into_iter().enumerate() {
            if let Some((edge, _)) = queue.upcoming_cost(ahead) {
                for v in self.mesh.ends(edge) {
                    self.mesh.prefetch_ring(v, step);
                }
            }
        }
    }

    /// Looks at the cheapest edge: it collapses, goes back with a higher cost, or out of the queue.
    fn step(&mut self, queue: &mut Queue, edge: u32, stored_cost: f64) {
        let candidate = match self.costs().evaluate(edge) {
            Ok(Some(candidate)) => candidate,
            _ => return queue.remove(edge),
        };
        if has_risen(candidate.cost, stored_cost) {
            return queue.set(edge, candidate.cost);
        }
        let [a, b] = self.mesh.ends(edge).map(|v| self.strictness.get(v as usize).copied());
        if self.limits.exceeds(candidate.error_sq, strictest(a, b)) {
            self.over_error = true;
            return queue.remove(edge);
        }
        if self.try_collapse(edge, &candidate) {
            self.plot(candidate.cost);
            self.update_queue(queue);
            self.drop_leftover(queue);
        } else {
            queue.remove(edge);
        }
    }

    /// A collapse of that cost has been made.
    fn plot(&mut self, cost: f64) {
        self.highest_cost = self.highest_cost.max(cost);
        let triangles = self.mesh.live_face_count();
        if self.outcome.curve.last().is_none_or(|last| triangles <= last.triangles - last.triangles.div_ceil(16)) {
            self.outcome.curve.push(CurvePoint { triangles, cost: self.highest_cost });
        }
    }

    /// Fills the rings of both ends; false when that has taken too long already and would take long again.
    fn fill_rings(&mut self, [kept, removed]: [u32; 2]) -> bool {
        if ![kept, removed].iter().all(|&v| self.patience.allows(self.mesh, v)) {
            return false;
        }
        self.mesh.ring(kept, &mut self.kept_ring);
        self.mesh.ring(removed, &mut self.removed_ring);
        self.patience.spend(self.kept_ring.len() + self.removed_ring.len());
        true
    }

    fn try_collapse(&mut self, edge: u32, candidate: &Candidate) -> bool {
        let [kept, removed] = self.mesh.ends(edge);
        if !self.fill_rings([kept, removed]) {
            self.outcome.refused.valence += 1;
            return false;
        }
        let [a, b] = [kept, removed].map(|v| self.mesh.point(v));
        let context = EdgeContext {
            ends: [kept, removed],
            points: [a, b],
            anchor: self.features.anchor(edge, [kept, removed]).unwrap_or(Anchor::First),
        };
        let rings = [self.kept_ring.as_slice(), self.removed_ring.as_slice()];
        let Some(target) = self.metric.refine(self.mesh, &context, candidate, rings) else {
            self.outcome.refused.texture += 1;
            return false;
        };
        let stored = [kept, removed].map(|v| self.mesh.position(v));
        let (position, t) = landing(self.mesh.frame(), target, stored, [a, b]);
        let error = candidate.error_sq.sqrt() * self.mesh.frame().unit();
        self.collapse(edge, [kept, removed], position, (t, error, candidate.cost), true)
    }

    /// Makes a collapse, after the tests if they are wanted. The rings of both ends must be in place.
    fn collapse(
        &mut self,
        edge: u32,
        [kept, removed]: [u32; 2],
        position: [f32; 3],
        (t, error, cost): (f32, f64, f64),
        test: bool,
    ) -> bool {
        let star = EdgeStar::new(edge, [kept, removed], &self.kept_ring, &self.removed_ring);
        let collapse = Collapse { star, position, t, error, cost };
        if test && !self.limits.allow(self.mesh, &collapse, &mut self.marks, &mut self.outcome.refused) {
            return false;
        }
        if test && self.cones.as_ref().is_some_and(|cones| !cones.allow(self.mesh, &collapse)) {
            self.outcome.refused.normal_deviation += 1;
            return false;
        }
        let vanishes = || star.kept_ring.iter().filter(|face| star.kills(face)).count() == self.mesh.live_face_count();
        if self.target_faces > 0 && self.mesh.live_face_count() <= star.kept_ring.len() && vanishes() {
            self.outcome.refused.topology += 1;
            return false;
        }
        if strands_locked(self.mesh, self.features, &collapse) {
            self.outcome.refused.locked += 1;
            return false;
        }
        if test && self.crossings.as_mut().is_some_and(|crossings| crossings.would_cross(self.mesh, &collapse)) {
            self.outcome.refused.self_intersections += 1;
            return false;
        }
        if let Some(cones) = &mut self.cones {
            cones.commit(&collapse);
        }
        self.observer.on_collapse(&collapse);
        self.metric.on_collapse(&collapse);
        let metric = &*self.metric;
        self.observer.on_values(&mut |wedges, mesh| metric.give_values(wedges, mesh));
        self.outcome.collapses += 1;
        self.outcome.error = self.outcome.error.max(error);
        self.mesh.collapse(&star, position, &mut self.marks, &mut self.effect);
        if let Some(crossings) = &mut self.crossings {
            crossings.update(self.mesh, self.kept_ring.iter().chain(&self.removed_ring).map(|face| face.face));
        }
        self.features.commit(kept, removed, &self.effect);
        self.metric.commit(self.mesh, kept, removed, &self.effect.neighbors, self.features);
        if !self.importance.is_empty() {
            let merged = self.importance[kept as usize].max(self.importance[removed as usize]);
            self.importance[kept as usize] = merged;
        }
        if !self.strictness.is_empty() {
            let merged = self.strictness[kept as usize].max(self.strictness[removed as usize]);
            self.strictness[kept as usize] = merged;
        }
        true
    }

    /// Takes away two faces back to back, which is what the collapse just made has left of a tetrahedron.
    fn drop_leftover(&mut self, queue: &mut Queue) {
        let &[edge, _] = self.effect.edges.as_slice() else { return };
        if self.limits.topology == TopologyPolicy::Preserve || !self.limits.parts_may_go {
            return; // two faces back to back that were there before
        }
        let mut ends = self.mesh.ends(edge);
        let faces = |v: u32| self.mesh.faces_around(v).count();
        if ends.map(faces).iter().min() != Some(&2) {
            return;
        }
        ends.sort_by_key(|&v| std::cmp::Reverse(faces(v)));
        let [kept, removed] = ends;
        self.mesh.ring(kept, &mut self.kept_ring);
        self.mesh.ring(removed, &mut self.removed_ring);
        let back_to_back = self.removed_ring.iter().all(|face| face.x == kept || face.y == kept);
        let same = self.removed_ring[0].x == self.removed_ring[1].y && self.removed_ring[0].y == self.removed_ring[1].x;
        if back_to_back
            && same
            && !self.features.is_locked(removed)
            && self.collapse(edge, ends, self.mesh.position(kept), (0.0, 0.0, f64::NEG_INFINITY), false)
        {
            self.update_queue(queue);
        }
    }

    /// Counts the edges that features and locks bar in the end: most of them never were in the queue.
    fn count_barred(&mut self) {
        for edge in (0..self.mesh.edge_count() as u32).filter(|&edge| self.mesh.has_edge(edge)) {
            match self.features.anchor(edge, self.mesh.ends(edge)) {
                Err(Barred::Feature) => self.outcome.refused.border += 1,
                Err(Barred::Locked) => self.outcome.refused.locked += 1,
                Ok(_) => {}
            }
        }
    }

    /// Brings the queue up to date after a collapse.
    fn update_queue(&self, queue: &mut Queue) {
        for &edge in &self.effect.removed_edges {
            queue.remove(edge);
        }
        let lazy = self.metric.update() == Update::WhenDue;
        for &edge in &self.effect.edges {
            if lazy && queue.contains(edge) {
                continue;
            }
            match self.costs().evaluate(edge) {
                Ok(Some(candidate)) => queue.set(edge, candidate.cost),
                _ => queue.remove(edge),
            }
        }
    }
}

/// Whether a locked vertex would lose its last face.
fn strands_locked(mesh: &CollapseMesh, features: &Features, collapse: &Collapse<'_>) -> bool {
    let [kept, removed] = [collapse.star.kept, collapse.star.removed];
    let apexes =
        collapse.star.kept_ring.iter().filter(|face| collapse.star.kills(face)).flat_map(|face| [face.x, face.y]);
    let bare = |v: u32| mesh.faces_around(v).all(|face| [face.x, face.y].iter().all(|&w| w == kept || w == removed));
    let mut locked_apexes = apexes.filter(|&v| v != removed && features.is_locked(v));
    let mut rings = collapse.star.kept_ring.iter().chain(collapse.star.removed_ring);
    locked_apexes.any(bare)
        || (features.is_locked(kept) || features.is_locked(removed)) && rings.all(|face| collapse.star.kills(face))
}
