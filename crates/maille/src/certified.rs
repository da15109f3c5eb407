//! Simplification within a largest distance that is proven.
//!
//! The metrics of [`simplify`](mod@crate::simplify) estimate how far a collapse takes the surface away; the estimate orders
//! collapses well, but it is no bound. [`simplify_certified`] uses it as a guide only: it simplifies, proves for each part of
//! both surfaces that it is within the bound ([`hausdorff`](crate::measure::hausdorff) with an early end), and where that
//! fails, it is stricter the next time, there and only there. So the bound is made use of everywhere, and one bad spot does
//! not cost triangles elsewhere.

use crate::control::Cancelled;
use crate::measure::Watch;
use crate::measure::exact::{Goal, Ground, Proof, Shown, Spot, rounding};
use crate::simplify::{Refusals, SimplifyError, SimplifyOptions, SimplifyReport, Stop, simplify};
use crate::{Control, Mesh};

/// How to simplify with a proof.
#[derive(Debug, Clone, PartialEq)]
pub struct CertifiedOptions {
    /// How to simplify. `target.max_error` must be given: it is what is proven. `target.triangles` may be given, too: the
    /// first one reached stops the work. `strictness` must be empty.
    pub simplify: SimplifyOptions,
    /// Most simplifications made in search of few triangles. When none of them can be proven, up to 20 more follow.
    pub rounds: u32,
}

impl CertifiedOptions {
    /// The usual effort: ten rounds.
    pub fn new(simplify: SimplifyOptions) -> Self {
        Self { simplify, rounds: 10 }
    }
}

/// What [`simplify_certified`] did.
#[derive(Debug, Clone, PartialEq)]
pub struct CertifiedReport<T = ()> {
    /// The simplification that the result is of. Its `error` is an estimate as ever.
    pub simplify: SimplifyReport,
    /// What was done to the result before the proof, see [`simplify_certified_with`]; `None` when nothing was simplified.
    pub finished: Option<T>,
    /// No point of either surface is farther from the other one than this, in model units: at most `target.max_error`.
    pub proven: f64,
    /// The largest distance between them that the proof came across: the true one is between this and `proven`.
    pub found: f64,
    /// How many simplifications it took.
    pub rounds: u32,
}

/// Share of the bound that, once reached, is near enough to it.
const NEAR: f64 = 0.9;
/// The estimate at which the first round stops, in terms of the bound. Estimates are means over the planes around, so the
/// largest distance is mostly larger; what is too far gets stricter.
const START: f64 = 0.7;
/// Share of a result's triangles: when more triangles of the original than that are too far, no closer look is taken.
const ENOUGH: usize = 20;
/// Share of a result's triangles: more than that are not the last few.
const FEW: usize = 100;
/// Rounds after which what is left to mend is mended with more force.
const PATIENT_ROUNDS: u32 = 3;
/// How many rounds follow, when nothing has been proven, before the original itself is the result.
const MORE_ROUNDS: u32 = 20;
/// Distances this near below the bound count as beyond it, as a share of it, so that proofs end.
const DOUBT: f64 = 1e-4;

/// Simplifies a mesh so that the largest distance between it and the original, both ways, is proven to be at most
/// `target.max_error`.
///
/// In rounds, each from the original: simplify up to an estimated error; prove; where a triangle of the result, or a part of
/// the original nearest to it, is too far, tighten the error of the original's vertices there (see
/// [`SimplifyOptions::strictness`]), by as much as it was exceeded; where all is proven and there is room left, allow more
/// everywhere. The result is the one with the fewest triangles among those proven; in the end the original, which is at
/// distance zero, if not even collapses without an error can be proven (degenerate triangles that stand alone vanish in
/// every simplification).
///
/// The proof covers rounding as [`hausdorff`](crate::measure::hausdorff) does. The result is the same for any number of
/// threads.
///
/// Cost: each round that of [`simplify`] and about two searches for each vertex of the original.
///
/// # Errors
/// As [`simplify`]; the mesh is unchanged then.
///
/// # Examples
/// ```
/// use maille::certified::{CertifiedOptions, simplify_certified};
/// use maille::simplify::{SimplifyOptions, Target};
/// let mut mesh = maille::mesh::shapes::sphere(5);
/// let target = Target { max_error: Some(0.01), ..Target::default() };
/// let options = CertifiedOptions::new(SimplifyOptions { target, ..SimplifyOptions::default() });
/// let report = simplify_certified(&mut mesh, &options, maille::Control::default())?;
/// assert!(report.proven <= 0.01 && mesh.triangle_count() < 1000);
/// # Ok::<(), maille::simplify::SimplifyError>(())
/// ```
pub fn simplify_certified(
    mesh: &mut Mesh,
    options: &CertifiedOptions,
    control: Control<'_>,
) -> Result<CertifiedReport, SimplifyError> {
    simplify_certified_with(mesh, options, |_, _| Ok(()), control)
}

/// As [`simplify_certified`], with something to be done to each result before the proof, such as to
/// [`refit`](crate::refit::refit) it: `finish` gets the original and the result.
///
/// # Errors
/// As [`simplify`], and what `finish` gives; the mesh is unchanged then.
pub fn simplify_certified_with<T>(
    mesh: &mut Mesh,
    options: &CertifiedOptions,
    finish: impl Fn(&Mesh, &mut Mesh) -> Result<T, SimplifyError>,
    control: Control<'_>,
) -> Result<CertifiedReport<T>, SimplifyError> {
    let invalid = |name, reason: &str| Err(SimplifyError::InvalidOption { name, reason: reason.to_owned() });
    let Some(most) = options.simplify.target.max_error else {
        return invalid("max_error", "is what would be proven, but it is not given");
    };
    if !options.simplify.strictness.is_empty() {
        return invalid("strictness", "must be empty: it is found out");
    }
    if most.is_nan() || most < 0.0 {
        return invalid("max_error", "must not be negative or NaN");
    }
    mesh.check()?;
    if let Some(vertex) = mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(SimplifyError::NotFinite { vertex });
    }
    if mesh.triangles.is_empty() || !most.is_finite() {
        let mut result = mesh.clone();
        let simplify = simplify(&mut result, &options.simplify, control)?;
        let finished = Some(finish(mesh, &mut result)?);
        *mesh = result;
        let proven = if most.is_finite() { 0.0 } else { most };
        return Ok(CertifiedReport { simplify, finished, proven, found: 0.0, rounds: 1 });
    }
    let original = std::mem::take(mesh);
    let search = Search { ground: Ground::new(&original), original: &original, options, finish, most, control };
    match search.run() {
        Ok((result, report)) => {
            *mesh = result;
            Ok(report)
        }
        Err(error) => {
            drop(search);
            *mesh = original;
            Err(error)
        }
    }
}

/// The search for the fewest triangles.
struct Search<'a, F> {
    original: &'a Mesh,
    ground: Ground<'a>,
    options: &'a CertifiedOptions,
    finish: F,
    most: f64,
    control: Control<'a>,
}

/// A simplification and what is known of it.
struct Trial<T> {
    mesh: Mesh,
    simplify: SimplifyReport,
    finished: T,
    /// The proven distance; `None` when it is beyond the bound somewhere.
    proven: Option<f64>,
    /// The largest distance that the proof came across.
    found: f64,
    /// Whether all that is too far has been found.
    is_complete: bool,
    /// For each triangle, by how much the bound is exceeded there; 0 where it is not.
    excess: Vec<f64>,
    /// The triangle nearest to each vertex of the original.
    nearest: Vec<u32>,
}

impl<T, F: Fn(&Mesh, &mut Mesh) -> Result<T, SimplifyError>> Search<'_, F> {
    fn run(&self) -> Result<(Mesh, CertifiedReport<T>), SimplifyError> {
        let mut strictness = vec![1.0_f32; self.original.vertex_count()];
        let mut error = START * self.most;
        let mut best: Option<Trial<T>> = None;
        let mut rounds = 0;
        let (mut least_bad, mut in_vain) = (usize::MAX, 0);
        let wanted = self.options.rounds.max(1);
        while rounds < wanted || best.is_none() && rounds < wanted + MORE_ROUNDS {
            self.control.report("simplifying and proving", rounds.min(wanted - 1) as f32 / wanted as f32);
            rounds += 1;
            let trial = self.trial(error, &strictness)?;
            let found = trial.found;
            if trial.proven.is_none() {
                // counts can be compared where all has been looked at, and force is for the last few
                let bad = trial.excess.iter().filter(|&&excess| excess > 0.0).count();
                if trial.is_complete && bad * FEW <= trial.excess.len() {
                    in_vain = if bad < least_bad { 0 } else { in_vain + 1 };
                    least_bad = least_bad.min(bad);
                }
                tighten(&mut strictness, &trial, in_vain, rounds.saturating_sub(PATIENT_ROUNDS));
                continue;
            }
            let has_more = trial.simplify.stopped == Stop::MaxError && trial.found < NEAR * self.most;
            if best.as_ref().is_none_or(|best| trial.mesh.triangle_count() < best.mesh.triangle_count()) {
                best = Some(trial);
            }
            if !has_more {
                break;
            }
            error *= (self.most / found).clamp(1.1, 2.0);
            (least_bad, in_vain) = (usize::MAX, 0);
        }
        let Some(trial) = best else { return Ok(self.untouched(rounds)) };
        let proven = trial.proven.expect("only what is proven is kept");
        let finished = Some(trial.finished);
        Ok((trial.mesh, CertifiedReport { simplify: trial.simplify, finished, proven, found: trial.found, rounds }))
    }

    fn untouched(&self, rounds: u32) -> (Mesh, CertifiedReport<T>) {
        let triangles = self.original.triangle_count();
        let simplify = SimplifyReport {
            triangles_in: triangles,
            triangles_out: triangles,
            collapses: 0,
            error: 0.0,
            attributes: Vec::new(),
            curve: Vec::new(),
            stopped: Stop::MaxError,
            refused: Refusals::default(),
        };
        (self.original.clone(), CertifiedReport { simplify, finished: None, proven: 0.0, found: 0.0, rounds })
    }

    /// Simplifies, fits and tries to prove.
    fn trial(&self, error: f64, strictness: &[f32]) -> Result<Trial<T>, SimplifyError> {
        let control = self.control.with_progress(&|_, _| {});
        let mut options = self.options.simplify.clone();
        options.target.max_error = Some(error);
        if strictness.iter().any(|&s| s != 1.0) {
            options.strictness = strictness.to_vec();
        }
        let mut mesh = self.original.clone();
        let simplify = simplify(&mut mesh, &options, control)?;
        let finished = (self.finish)(self.original, &mut mesh)?;
        let mut trial = Trial {
            excess: vec![0.0; mesh.triangle_count()],
            nearest: Vec::new(),
            mesh,
            simplify,
            finished,
            proven: None,
            found: 0.0,
            is_complete: true,
        };
        if !trial.mesh.triangles.is_empty() {
            self.prove(&mut trial, control)?;
        }
        Ok(trial)
    }

    fn prove(&self, trial: &mut Trial<T>, control: Control<'_>) -> Result<(), Cancelled> {
        let rounding = rounding(&[self.original, &trial.mesh]);
        let doubt = (DOUBT * self.most).max(8.0 * rounding);
        let goal = Goal::Within { most: self.most, doubt };
        let ground = Ground::new(&trial.mesh);
        // as long as much is too far, a closer look tells nothing new
        let enough = trial.mesh.triangle_count() / ENOUGH;
        let one_way = |from, to| {
            let queue = crate::measure::ExactOptions::default().queue;
            Proof { from, to, goal, rounding, queue, gather: true, enough }.run(&Watch::new(control, "proving"))
        };
        let there: Shown = one_way(&self.ground, &ground)?;
        let back: Shown = one_way(&ground, &self.ground)?;
        let both = [&there, &back];
        let mut note = |triangle: u32, spot: &Spot| {
            let excess = &mut trial.excess[triangle as usize];
            *excess = excess.max(spot.distance / self.most);
        };
        // the triangle of the result, and all that the corners of the original's triangle are nearest to
        let nearest = |t: u32| self.original.triangle_vertices(t as usize).map(|v| there.nearest[v as usize]);
        for spot in &there.spots {
            note(spot.to, spot);
            nearest(spot.from).iter().for_each(|&t| note(t, spot));
        }
        for spot in &back.spots {
            note(spot.from, spot);
            nearest(spot.to).iter().for_each(|&t| note(t, spot));
        }
        trial.is_complete = both.iter().all(|shown| shown.spots.len() <= enough);
        trial.found = both.iter().map(|shown| shown.distance.lower).fold(0.0, f64::max);
        if both.iter().all(|shown| shown.distance.converged) {
            trial.proven = Some(both.iter().map(|shown| shown.distance.upper).fold(0.0, f64::max));
        } else if both.iter().all(|shown| shown.spots.is_empty()) {
            // too many pieces to tell where: all of it
            trial.excess.fill(1.0);
        }
        trial.nearest = there.nearest;
        Ok(())
    }
}

/// How much stricter a vertex gets at least, and at most.
const LEAST_STEP: f64 = 1.1;
const MOST_STEP: f64 = 3.0;

/// From here on a vertex may not move at all.
const UNMOVED: f32 = 1e4;

/// Makes the vertices of the original stricter that are nearest to triangles beyond the bound, or to their neighbours.
///
/// Where that does not help, the estimates there are blind (of a border that is drawn in, of a hole that closes): the steps
/// get much larger, until nothing may move there, and a little larger farther around. So they do, less so, in late rounds:
/// the last few spots are not worth many more.
fn tighten<T>(strictness: &mut [f32], trial: &Trial<T>, in_vain: u32, late: u32) {
    if trial.mesh.triangles.is_empty() {
        strictness.iter_mut().for_each(|strictness| *strictness *= MOST_STEP as f32); // all has vanished
    }
    let mut core = trial.excess.clone();
    widen(&mut core, &trial.mesh, 1 + in_vain / 3 + if in_vain > 6 { 1 << in_vain.min(16) } else { 0 });
    let mut around = core.clone();
    widen(&mut around, &trial.mesh, late.min(4) / 2 + in_vain.min(4));
    let least = LEAST_STEP + 0.1 * f64::from(late);
    let force = 4_f64.powi(in_vain.min(32) as i32);
    for (strictness, &nearest) in strictness.iter_mut().zip(&trial.nearest) {
        let at = |excess: &[f64]| excess.get(nearest as usize).copied().filter(|&excess| excess > 0.0);
        let step = |excess: f64| (least * excess).clamp(least, MOST_STEP.max(least));
        *strictness *= match (at(&core), at(&around)) {
            (Some(excess), _) => (step(excess) * force) as f32,
            (None, Some(_)) => LEAST_STEP as f32,
            (None, None) => continue,
        };
        if *strictness > UNMOVED {
            *strictness = f32::INFINITY;
        }
    }
}

/// Spreads the excess of triangles to those that share a vertex with them, so many times.
fn widen(excess: &mut [f64], mesh: &Mesh, times: u32) {
    let mut at_vertices = vec![0.0_f64; mesh.vertex_count()];
    for _ in 0..times {
        for (t, &excess) in excess.iter().enumerate().filter(|(_, excess)| **excess > 0.0) {
            for v in mesh.triangle_vertices(t) {
                at_vertices[v as usize] = at_vertices[v as usize].max(excess);
            }
        }
        let mut grows = false;
        for (t, excess) in excess.iter_mut().enumerate() {
            let corners = mesh.triangle_vertices(t);
            let most = corners.iter().map(|&v| at_vertices[v as usize]).fold(0.0, f64::max);
            grows |= most > *excess;
            *excess = most;
        }
        if !grows {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{ExactOptions, hausdorff};
    use crate::mesh::shapes;
    use crate::samples;
    use crate::simplify::{Order, Target, TopologyPolicy};
    use glam::DVec3;

    fn options(max_error: f64, triangles: Option<usize>) -> CertifiedOptions {
        let target = Target { max_error: Some(max_error), triangles };
        CertifiedOptions::new(SimplifyOptions { target, ..SimplifyOptions::default() })
    }

    /// Simplifies, proves once more from outside, and tells the true distance in terms of the bound.
    fn certified(mesh: &Mesh, options: &CertifiedOptions) -> (Mesh, CertifiedReport, f64) {
        let mut result = mesh.clone();
        let report = simplify_certified(&mut result, options, Control::default()).expect("the options make sense");
        let most = options.simplify.target.max_error.expect("it is given");
        assert!(report.proven <= most);
        assert_eq!(report.simplify.triangles_out, result.triangle_count());
        let distance = hausdorff(mesh, &result, &ExactOptions::default(), Control::default()).expect("both are sound");
        assert!(distance.lower() <= report.proven, "{} is beyond what is proven: {}", distance.lower(), report.proven);
        (result, report, distance.upper() / most)
    }

    #[test]
    fn the_bound_holds_and_is_made_use_of() {
        let statue = samples::statue(30_000);
        for (mesh, least) in [(shapes::sphere(5), 0.8), (shapes::torus(3.0, 1.0, 90, 60), 0.8), (statue, 0.8)] {
            let diagonal = mesh.diagonal();
            for share in [0.01, 0.002] {
                let (result, report, reached) = certified(&mesh, &options(share * diagonal, None));
                assert!(reached > least && reached <= 1.0, "{share}: {reached}, {report:?}");
                assert!(result.triangle_count() < mesh.triangle_count() / 2);
                assert_eq!(report.simplify.stopped, Stop::MaxError);
            }
        }
    }

    #[test]
    fn the_first_target_reached_counts() {
        let mesh = shapes::sphere(5);
        let (result, report, _) = certified(&mesh, &options(0.05, Some(2000)));
        assert_eq!((result.triangle_count(), report.simplify.stopped, report.rounds), (2000, Stop::Triangles, 1));
        let (result, report, _) = certified(&mesh, &options(0.01, Some(10)));
        assert!(result.triangle_count() > 100 && report.simplify.stopped == Stop::MaxError);
    }

    #[test]
    fn flat_pieces_need_no_error() {
        let (result, report, _) = certified(&shapes::grid(40), &options(1e-6, None));
        assert!(result.triangle_count() <= 8 && report.proven <= 1e-6, "{report:?}");
    }

    #[test]
    fn what_cannot_be_proven_stays() {
        // a triangle without area, far away: every simplification drops it
        let mut mesh = shapes::sphere(3);
        mesh.positions.push([5.0, 0.0, 0.0]);
        mesh.wedge_vertices.push(mesh.positions.len() as u32 - 1);
        mesh.triangles.push([mesh.wedge_vertices.len() as u32 - 1; 3]);
        let (result, report, _) = certified(&mesh, &CertifiedOptions { rounds: 2, ..options(0.1, None) });
        assert_eq!((result, report.proven, report.simplify.collapses), (mesh, 0.0, 0));
    }

    #[test]
    fn parts_that_may_vanish_do_not_beyond_the_bound() {
        let mut mesh = shapes::sphere(4);
        let (vertices, wedges) = (mesh.positions.len() as u32, mesh.wedge_vertices.len() as u32);
        let speck = shapes::tetrahedron();
        mesh.positions.extend(speck.positions.iter().map(|p| p.map(|x| 0.01 * x + 2.0)));
        mesh.wedge_vertices.extend(speck.wedge_vertices.iter().map(|v| v + vertices));
        mesh.triangles.extend(speck.triangles.iter().map(|t| t.map(|w| w + wedges)));
        let mut options = options(0.05, None);
        options.simplify.topology = TopologyPolicy::Free;
        let (result, ..) = certified(&mesh, &options);
        let far = |p: &[f32; 3]| DVec3::from(p.map(f64::from)).length() > 1.5;
        assert!(result.positions.iter().any(far));
    }

    #[test]
    fn threads_do_not_change_the_result() {
        let mesh = shapes::torus(3.0, 1.0, 300, 150);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be had");
            let mut mesh = mesh.clone();
            let report = pool.install(|| simplify_certified(&mut mesh, &options(0.005, None), Control::default()));
            (mesh, report.expect("the options make sense"))
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn strictness_holds_locally() {
        let mesh = shapes::sphere(5);
        for order in [Order::Passes, Order::Exact] {
            let strictness = mesh.positions.iter().map(|p| if p[0] > 0.0 { 10.0 } else { 1.0 }).collect();
            let target = Target { max_error: Some(0.02), triangles: None };
            let options = SimplifyOptions { target, order, strictness, ..SimplifyOptions::default() };
            let mut result = mesh.clone();
            simplify(&mut result, &options, Control::default()).expect("the options make sense");
            let right = result.positions.iter().filter(|p| p[0] > 0.2).count();
            let left = result.positions.iter().filter(|p| p[0] < -0.2).count();
            assert!(right > 4 * left, "{right} beside {left}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused_and_changes_nothing() {
        let refused = |mesh: &Mesh, options: &CertifiedOptions| {
            let mut result = mesh.clone();
            let error = simplify_certified(&mut result, options, Control::default()).expect_err("refused");
            assert_eq!(result.triangles, mesh.triangles);
            error
        };
        let cube = shapes::cube();
        let mut none = options(0.1, None);
        none.simplify.target.max_error = None;
        let mut strict = options(0.1, None);
        strict.simplify.strictness = vec![1.0; 8];
        for (options, expected) in [
            (none, "max_error"),
            (options(-1.0, None), "max_error"),
            (options(f64::NAN, None), "max_error"),
            (strict, "strictness"),
        ] {
            assert!(matches!(refused(&cube, &options), SimplifyError::InvalidOption { name, .. } if name == expected));
        }
        let mut broken = shapes::cube();
        broken.positions[3][0] = f32::NAN;
        assert_eq!(refused(&broken, &options(0.1, None)), SimplifyError::NotFinite { vertex: 3 });
        let stop = std::sync::atomic::AtomicBool::new(true);
        let mut sphere = shapes::sphere(3);
        let stopped = simplify_certified(&mut sphere, &options(0.1, None), Control::new(None, Some(&stop)));
        assert_eq!(stopped, Err(SimplifyError::Cancelled(Cancelled)));
        assert_eq!(sphere, shapes::sphere(3));
        let mut empty = Mesh::default();
        let report = simplify_certified(&mut empty, &options(0.1, None), Control::default()).expect("nothing to do");
        assert_eq!((report.proven, report.simplify.triangles_out), (0.0, 0));
    }
}
