//! How one level goes over into the next: options, and the state of an object.

use super::levels::{Levels, LevelsError};
use super::view::ScreenSize;

/// How levels go over into each other.
///
/// Two things may move t, alone or together: the object's distance within zones ([`by_distance`](Self::by_distance)), and
/// time ([`timed`](Self::timed)). What is wanted is a place among the levels, such as 1.4 for 0.4 of the way from the second
/// to the third one; what is shown follows it at a limited pace, always from where it is. So it turns round without a jump.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// Width of the zone before each switch in which the distance moves t from 0 to 1, as a share of the switch's distance,
    /// from 0 (none) to 1: with 0.3, a switch at 100 has a zone from 70 on. The measure is that of the levels: distance, size
    /// of a pixel in world units, or one over the coverage. A zone begins no sooner than the switch before it; with 1,
    /// everything morphs everywhere. Outside zones nothing is morphed.
    ///
    /// t is even in that measure. The errors of two levels, mixed by t, are then at most what is allowed.
    pub zone: f64,
    /// Shortest time in which t goes from 0 to 1, in seconds; 0 for no limit.
    pub duration: f64,
    /// A coarser level is wanted only this much farther away than its switch, as a share of the distance; a finer one is
    /// wanted at the switch. Between the two all stays as it is, so that an object going to and fro does not flicker, and
    /// what is wanted never has a larger error than allowed. It makes zones longer at their far end.
    pub hysteresis: f64,
    /// What is more than one level behind morphs in proportion faster, up to so many levels in one `duration`; 1 for never
    /// faster.
    pub catch_up: f64,
    /// Whether t starts and ends slowly: `t² (3 - 2 t)`. It is up to 1.5 times as fast halfway.
    pub smooth: bool,
}

/// What is to be drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shown {
    /// A level as it is. No morph is to be computed.
    Level(usize),
    /// Something between two levels.
    Morph {
        /// The level whose vertices move.
        finer: usize,
        /// Where they move to: the next level, or one further on where levels between are never shown.
        coarser: usize,
        /// How far, between 0 and 1 exclusively.
        t: f32,
    },
    /// A level on its way to nothing. What that looks like is up to the renderer: each part drawn together to a point (what
    /// a morph into no triangles comes to: seed 000, 5.4.1), faded out, or the level as it is until it is gone.
    Vanishing {
        /// The level.
        level: usize,
        /// How far, between 0 and 1 exclusively.
        t: f32,
    },
    /// Nothing: too small to be seen.
    Nothing,
}

/// What one object shows, and where it is going. Small; starts new (`default`).
///
/// A new state shows at its first update what is wanted, without a morph. [`reset`](Self::reset) makes a state new again: for
/// cuts of the camera, for objects that were not in the image, and for those that were moved elsewhere. Without it, what is
/// several levels behind goes through all of them, see [`Transition::catch_up`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelState {
    /// Position among the stages of the levels.
    position: f64,
    goal: f64,
    /// Seconds for which a finer level has been wanted, but not permitted.
    waited: f32,
    is_new: bool,
}

/// Where an update would go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    is_new: bool,
    goal: f64,
    position: f64,
    measure: f64,
}

/// A morph that an update would show.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wish {
    /// What it costs.
    pub(super) cost: u64,
    /// Error in pixels of the coarser level: how much the change can be seen.
    pub(super) pixels: f64,
    /// Whether the same morph is shown already.
    pub(super) is_running: bool,
    /// Seconds for which a finer level has been waited for; `None` where none is wanted.
    pub(super) waited: Option<f32>,
}

/// What becomes of a [`Wish`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Permit {
    Morph,
    Wait,
    Cut,
}

impl Transition {
    /// Distance alone: t depends on where the object is, in the last 30 % of the distance before each switch. A leap of the
    /// object is a leap of t.
    pub fn by_distance() -> Self {
        Self { zone: 0.3, ..Self::cut(0.0) }
    }

    /// Time alone: passing a switch starts a morph of so many seconds. The hysteresis is a tenth, and up to four levels are
    /// gone through in one duration. The thesis takes one second and finds a few to be enough (seed 000, 5.3.2 and 7).
    pub fn timed(duration: f64) -> Self {
        Self { duration, catch_up: 4.0, ..Self::cut(0.1) }
    }

    /// No morph at all, only levels.
    pub fn cut(hysteresis: f64) -> Self {
        Self { zone: 0.0, duration: 0.0, hysteresis, catch_up: 1.0, smooth: false }
    }

    pub(super) fn check(&self) -> Result<(), LevelsError> {
        let ranges = [
            ("zone", (0.0..=1.0).contains(&self.zone), "must be from 0 to 1"),
            ("duration", self.duration.is_finite() && self.duration >= 0.0, "must be finite and not negative"),
            ("hysteresis", self.hysteresis.is_finite() && self.hysteresis >= 0.0, "must be finite and not negative"),
            ("catch_up", self.catch_up.is_finite() && self.catch_up >= 1.0, "must be finite and not below 1"),
        ];
        match ranges.into_iter().find(|(_, is_valid, _)| !is_valid) {
            Some((name, _, reason)) => Err(LevelsError::InvalidOption { name, reason: reason.to_owned() }),
            None => Ok(()),
        }
    }

    /// How many levels may be gone in `dt` seconds towards what is so far away.
    fn pace(&self, behind: f64, dt: f64) -> f64 {
        if self.duration == 0.0 {
            return f64::INFINITY;
        }
        // `max`: NaN counts as no time
        behind.clamp(1.0, self.catch_up) * dt.max(0.0) / self.duration
    }
}

impl Default for Transition {
    /// By time, in half a second.
    fn default() -> Self {
        Self::timed(0.5)
    }
}

impl Default for LevelState {
    fn default() -> Self {
        Self { position: 0.0, goal: 0.0, waited: 0.0, is_new: true }
    }
}

impl LevelState {
    /// Goes on by `dt` seconds, with the object of this size on the screen, and tells what to draw. Where many objects morph
    /// at once, see [`MorphBudget::update`](super::MorphBudget::update).
    ///
    /// Always with the same levels; with others, [`reset`](Self::reset) comes first, or the state means a level of the same
    /// place among them.
    ///
    /// Odd numbers give no panic. Distances of zero or less count as at the eye; infinite ones, and sizes of zero or less, as
    /// infinitely far. With NaN what was wanted last is wanted still (the finest level in a new state, which stays new). A
    /// `dt` that is negative or NaN counts as 0.
    pub fn update(&mut self, levels: &Levels, size: &ScreenSize, dt: f64) -> Shown {
        let step = self.plan(levels, size, dt);
        self.take(levels, &step, Permit::Morph, dt)
    }

    /// Makes the state new: the next update shows what is wanted then, at once.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// What was shown last; of a new state, the finest level.
    pub fn shown(&self, levels: &Levels) -> Shown {
        shown_at(levels, self.position)
    }

    /// What is wanted, and will be shown once the morph has arrived: the level to be loaded.
    pub fn goal(&self, levels: &Levels) -> Shown {
        shown_at(levels, self.goal)
    }

    /// Where an update would go if it were permitted.
    pub(super) fn plan(&self, levels: &Levels, size: &ScreenSize, dt: f64) -> Step {
        let [from, goal] = [self.position, self.goal].map(|position| position.min(levels.last()));
        let follow = |goal: f64| {
            let position = towards(from, goal, levels.transition.pace((goal - from).abs(), dt));
            (goal, position)
        };
        let measure = levels.measure(size);
        let (goal, position) = if measure.is_nan() {
            follow(goal)
        } else {
            // the positions between which nothing changes; with zones of no width, the levels on both sides of a switch
            let coarsest = levels.position(measure);
            let finest = levels.position(measure / (1.0 + levels.transition.hysteresis));
            if self.is_new { (coarsest, coarsest) } else { follow(goal.clamp(finest, coarsest)) }
        };
        Step { is_new: self.is_new && measure.is_nan(), goal, position, measure }
    }

    /// The morph that a step would show, if it would show one.
    pub(super) fn wish(&self, levels: &Levels, step: &Step) -> Option<Wish> {
        let stage = step.position.floor();
        if stage == step.position {
            return None;
        }
        let pixels = levels.pixels_after(stage as usize, step.measure);
        Some(Wish {
            cost: levels.cost_after(stage as usize),
            pixels: if pixels.is_nan() { 0.0 } else { pixels },
            is_running: !self.is_new && self.is_between() && stage == self.position.floor(),
            waited: (!self.is_new && step.goal < self.position).then_some(self.waited),
        })
    }

    /// Goes where the step and the permit lead.
    pub(super) fn take(&mut self, levels: &Levels, step: &Step, permit: Permit, dt: f64) -> Shown {
        let from = self.position.min(levels.last());
        let position = match permit {
            Permit::Morph => step.position,
            // a morph on its way ends with its own two levels
            _ if !self.is_new && self.is_between() => step.position.clamp(from.floor(), from.ceil()),
            Permit::Wait if !self.is_new => from,
            _ => step.goal.floor(),
        };
        let is_waiting = permit == Permit::Wait && step.goal < position;
        let waited = if is_waiting { self.waited + dt.max(0.0) as f32 } else { 0.0 };
        *self = Self { position, goal: step.goal, waited, is_new: step.is_new };
        shown_at(levels, position)
    }

    fn is_between(&self) -> bool {
        self.position != self.position.floor()
    }
}

/// Steps that end this near to a level end there: as many times `dt` as make a duration do not add up to it exactly.
const ARRIVED: f64 = 1e-9;

/// From one position towards another, by a step of this length at most.
fn towards(from: f64, goal: f64, step: f64) -> f64 {
    if (goal - from).abs() <= step {
        return goal;
    }
    let to = from + step.copysign(goal - from);
    let level = to.round();
    if (to - level).abs() < ARRIVED && level != from { level } else { to }
}

fn shown_at(levels: &Levels, position: f64) -> Shown {
    let position = position.min(levels.last());
    let (stage, t) = (position.floor() as usize, position.fract());
    let Some(level) = levels.level_at(stage) else { return Shown::Nothing };
    if t == 0.0 {
        return Shown::Level(level);
    }
    let t = if levels.transition.smooth { t * t * (3.0 - 2.0 * t) } else { t };
    // what the budget has paid for is a morph in single precision, too
    let t = (t as f32).clamp(f32::MIN_POSITIVE, 1.0 - f32::EPSILON / 2.0);
    match levels.level_at(stage + 1) {
        Some(coarser) => Shown::Morph { finer: level, coarser, t },
        None => Shown::Vanishing { level, t },
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{at_distance, hostile};
    use super::*;

    fn levels(transition: Transition) -> Levels {
        Levels::by_distance(&[10.0, 20.0, 40.0]).unwrap().with_transition(transition).unwrap()
    }

    /// A walk of distances and times, some of them leaps.
    fn walk() -> impl Strategy<Value = Vec<(f64, f64)>> {
        prop::collection::vec((prop_oneof![0.0_f64..60.0, 8.0_f64..12.0], 0.0_f64..0.7), 1..60)
    }

    fn transition() -> impl Strategy<Value = Transition> {
        (0.0_f64..=1.0, prop_oneof![Just(0.0), 0.01_f64..2.0], 0.0_f64..0.5, 1.0_f64..5.0, any::<bool>()).prop_map(
            |(zone, duration, hysteresis, catch_up, smooth)| Transition {
                zone,
                duration,
                hysteresis,
                catch_up,
                smooth,
            },
        )
    }

    /// Level + t.
    fn height(shown: Shown) -> f64 {
        match shown {
            Shown::Level(level) => level as f64,
            Shown::Morph { finer, coarser, t } => finer as f64 + (coarser - finer) as f64 * f64::from(t),
            Shown::Vanishing { level, t } => level as f64 + f64::from(t),
            Shown::Nothing => f64::INFINITY,
        }
    }

    #[test]
    fn distance_moves_t_in_its_zone() {
        let levels = levels(Transition::by_distance());
        let mut state = LevelState::default();
        let mut shown = |distance| state.update(&levels, &at_distance(distance), 0.0);
        assert_eq!(shown(7.0), Shown::Level(0));
        assert!(matches!(shown(8.5), Shown::Morph { finer: 0, coarser: 1, t } if (t - 0.5).abs() < 1e-6));
        assert_eq!(shown(10.0), Shown::Level(1));
        assert_eq!(shown(14.0), Shown::Level(1));
        assert!(matches!(shown(17.0), Shown::Morph { finer: 1, coarser: 2, t } if (t - 0.5).abs() < 1e-6));
        // half a unit of distance back, a twelfth of the zone
        assert!(matches!(shown(16.5), Shown::Morph { finer: 1, coarser: 2, t } if (t - 5.0 / 12.0).abs() < 1e-6));
        assert_eq!(shown(1000.0), Shown::Level(3));
    }

    #[test]
    fn smooth_steps_start_and_end_slowly() {
        let levels = levels(Transition { smooth: true, ..Transition::by_distance() });
        let t_at = |distance| height(LevelState::default().update(&levels, &at_distance(distance), 0.0));
        assert!((t_at(8.5) - 0.5).abs() < 1e-6);
        assert!((t_at(7.3) - 0.028).abs() < 1e-6 && (t_at(9.7) - 0.972).abs() < 1e-6);
    }

    #[test]
    fn the_last_level_may_vanish() {
        let levels = levels(Transition::timed(1.0)).vanishing_at(80.0).unwrap();
        let mut state = LevelState::default();
        let mut shown = |distance| state.update(&levels, &at_distance(distance), 0.25);
        assert_eq!(shown(79.0), Shown::Level(3));
        assert_eq!(shown(90.0), Shown::Vanishing { level: 3, t: 0.25 });
        assert_eq!(shown(90.0), Shown::Vanishing { level: 3, t: 0.5 });
        assert_eq!(shown(79.0), Shown::Vanishing { level: 3, t: 0.25 });
        for _ in 0..4 {
            shown(f64::INFINITY);
        }
        assert_eq!(shown(90.0), Shown::Nothing);
        assert_eq!(state.shown(&levels), Shown::Nothing);
    }

    #[test]
    fn many_levels_behind_go_faster_and_a_reset_goes_at_once() {
        let far = Transition { hysteresis: 0.0, ..Transition::timed(1.0) };
        let all = |transition| {
            let (levels, mut state) = (levels(transition), LevelState::default());
            state.update(&levels, &at_distance(0.0), 0.0);
            (1..).find(|_| state.update(&levels, &at_distance(100.0), 0.01) == Shown::Level(3)).unwrap()
        };
        assert_eq!(all(Transition { catch_up: 1.0, ..far }), 300);
        // the first two levels take ln 3, the last one 1
        assert!((205..=212).contains(&all(far)), "{}", all(far));

        let (levels, mut state) = (levels(far), LevelState::default());
        state.update(&levels, &at_distance(0.0), 0.0);
        state.reset();
        assert_eq!(state.update(&levels, &at_distance(100.0), 0.0), Shown::Level(3));
    }

    #[test]
    fn steps_that_do_not_add_up_arrive_exactly() {
        let levels = levels(Transition { catch_up: 1.0, ..Transition::timed(1.0) });
        for steps in 1..200 {
            let mut state = LevelState::default();
            state.update(&levels, &at_distance(35.0), 0.0);
            for _ in 0..steps {
                assert_eq!(state.position.fract() == 0.0, state.position == 2.0);
                state.update(&levels, &at_distance(5.0), 1.0 / f64::from(steps));
            }
            assert_eq!(state.position, 1.0, "{steps}");
        }
    }

    #[test]
    fn goal_tells_what_to_load() {
        let (levels, mut state) = (levels(Transition::timed(1.0)), LevelState::default());
        state.update(&levels, &at_distance(100.0), 0.1);
        state.update(&levels, &at_distance(15.0), 0.1);
        assert_eq!(state.goal(&levels), Shown::Level(1));
        assert!(matches!(state.shown(&levels), Shown::Morph { finer: 2, coarser: 3, .. }));
    }

    #[test]
    fn no_number_leaves_what_was_wanted() {
        let (levels, mut state) = (levels(Transition::timed(1.0)), LevelState::default());
        assert_eq!(state.update(&levels, &at_distance(f64::NAN), 1.0), Shown::Level(0));
        // still new
        assert_eq!(state.update(&levels, &at_distance(15.0), 0.25), Shown::Level(1));
        assert_eq!(state.update(&levels, &at_distance(5.0), 0.25), Shown::Morph { finer: 0, coarser: 1, t: 0.75 });
        assert_eq!(state.update(&levels, &at_distance(f64::NAN), 0.25), Shown::Morph { finer: 0, coarser: 1, t: 0.5 });
        assert_eq!(state.update(&levels, &at_distance(5.0), f64::NAN), Shown::Morph { finer: 0, coarser: 1, t: 0.5 });
        assert_eq!(state.update(&levels, &at_distance(-1.0), f64::INFINITY), Shown::Level(0));
        state.reset();
        assert_eq!(state.update(&levels, &at_distance(f64::INFINITY), 0.0), Shown::Level(3));
    }

    proptest! {
        #[test]
        fn distance_alone_forgets_the_way(walk in walk()) {
            let (levels, mut state) = (levels(Transition::by_distance()), LevelState::default());
            for (distance, dt) in walk {
                let shown = state.update(&levels, &at_distance(distance), dt);
                prop_assert_eq!(shown, LevelState::default().update(&levels, &at_distance(distance), 0.0));
            }
        }

        #[test]
        fn what_is_shown_goes_no_faster_than_allowed(transition in transition(), walk in walk()) {
            let transition = Transition { duration: transition.duration.max(0.01), ..transition };
            let (levels, mut state) = (levels(transition), LevelState::default());
            state.update(&levels, &at_distance(walk[0].0), 0.0);
            for (distance, dt) in walk {
                let before = (state, height(state.shown(&levels)));
                let shown = height(state.update(&levels, &at_distance(distance), dt));
                let behind = (state.goal - before.0.position).abs();
                let allowed = behind.clamp(1.0, transition.catch_up) * dt / transition.duration;
                prop_assert!((state.position - before.0.position).abs() <= allowed + 2.0 * ARRIVED);
                let eased = if transition.smooth { 1.5 } else { 1.0 };
                prop_assert!((shown - before.1).abs() <= eased * allowed + 1e-6);
                // never beyond what is wanted, never away from it
                prop_assert!((state.goal - state.position).abs() <= behind + ARRIVED);
            }
        }

        #[test]
        fn no_level_takes_less_than_its_duration(duration in 0.01_f64..2.0, walk in walk()) {
            let transition = Transition { catch_up: 1.0, ..Transition::timed(duration) };
            let (levels, mut state) = (levels(transition), LevelState::default());
            state.update(&levels, &at_distance(walk[0].0), 0.0);
            for (distance, dt) in walk {
                let before = height(state.shown(&levels));
                let after = height(state.update(&levels, &at_distance(distance), dt));
                prop_assert!((after - before).abs() <= dt / duration + 1e-6);
            }
        }

        #[test]
        fn to_and_fro_within_the_hysteresis_changes_nothing(
            hysteresis in 0.01_f64..0.5,
            zone in 0.0_f64..=1.0,
            start in 5.0_f64..50.0,
            shares in prop::collection::vec(0.0_f64..0.999, 1..30),
            starts_near in any::<bool>(),
        ) {
            let (levels, mut state) = (levels(Transition { zone, hysteresis, ..Transition::timed(0.5) }), LevelState::default());
            // settles at one end of the band, wherever that is
            let band = [start, start * (1.0 + hysteresis)];
            state.update(&levels, &at_distance(if starts_near { band[1] } else { band[0] }), 0.0);
            state.update(&levels, &at_distance(if starts_near { band[0] } else { band[1] }), f64::INFINITY);
            let settled = state;
            for share in shares {
                state.update(&levels, &at_distance(band[0] + share * (band[1] - band[0])), 0.1);
                prop_assert_eq!(state, settled);
            }
        }

        #[test]
        fn no_morph_outside_zones_once_settled(walk in walk(), zone in 0.0_f64..=1.0) {
            let levels = levels(Transition { zone, duration: 0.5, ..Transition::cut(0.0) });
            let mut state = LevelState::default();
            for (distance, dt) in walk {
                state.update(&levels, &at_distance(distance), dt);
                let shown = state.update(&levels, &at_distance(distance), 100.0);
                let is_in_zone = levels.switches().any(|switch| switch.zone < distance && distance < switch.at);
                prop_assert_eq!(matches!(shown, Shown::Level(_)), !is_in_zone);
            }
        }

        #[test]
        fn what_is_wanted_is_allowed(hysteresis in 0.0_f64..0.5, walk in walk()) {
            let (levels, mut state) = (levels(Transition::cut(hysteresis)), LevelState::default());
            for (distance, dt) in walk {
                let Shown::Level(level) = state.update(&levels, &at_distance(distance), dt) else { unreachable!() };
                prop_assert!(level == 0 || [10.0, 20.0, 40.0][level - 1] <= distance);
            }
        }

        #[test]
        fn any_numbers_give_something_to_show(
            transition in transition(),
            steps in prop::collection::vec(prop::array::uniform4(hostile()), 1..20),
            ends in any::<bool>(),
        ) {
            let thresholds = [0.5, 1.0, 200.0];
            for made in [Levels::by_error(&thresholds, 1.0), Levels::by_distance(&thresholds), Levels::by_coverage(&thresholds)] {
                let mut levels = made.unwrap().with_transition(transition).unwrap();
                if ends {
                    levels = levels.vanishing_at(300.0).unwrap();
                }
                let mut state = LevelState::default();
                for &[distance, pixels_per_unit, coverage, dt] in &steps {
                    let shown = state.update(&levels, &ScreenSize { distance, pixels_per_unit, coverage }, dt);
                    prop_assert!((0.0..=levels.last()).contains(&state.position));
                    if let Shown::Morph { t, .. } | Shown::Vanishing { t, .. } = shown {
                        prop_assert!(0.0 < t && t < 1.0);
                    }
                }
            }
        }
    }
}
