//! Where each level of a chain may be shown.

use super::transition::Transition;
use super::view::ScreenSize;

/// The levels of a chain, finest first: from where on each may be shown, and how one goes over into the next.
///
/// Wanted is the coarsest level whose threshold has been passed. So a level that is no better than a coarser one is never
/// shown, and neither is one whose threshold is out of reach; the switches left are those of [`switches`](Self::switches).
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    measure: Measure,
    /// Error that is allowed on the screen; 1 where no errors are known.
    max_pixels: f64,
    /// What is shown, `from` strictly ascending. The first one is there from 0 on.
    stages: Vec<Stage>,
    /// For each level, what it costs to morph it.
    costs: Vec<u64>,
    pub(super) transition: Transition,
}

/// A point where one level takes another's place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Switch {
    /// The level before it.
    pub finer: usize,
    /// The level from there on, mostly the next one; `None`: nothing is shown.
    pub coarser: Option<usize>,
    /// Where the zone before it begins, see [`Transition::zone`]; the unit is that of `at`.
    pub zone: f64,
    /// Where the coarser level may stand alone: world units per pixel ([`Levels::by_error`]), a distance in world units
    /// ([`Levels::by_distance`]) or a share of the image's height ([`Levels::by_coverage`]).
    pub at: f64,
}

/// Why levels cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LevelsError {
    /// There is no level to be shown.
    #[error("there are no levels; give one at least")]
    Empty,
    /// An error, distance or coverage is no number or negative.
    #[error("the threshold of level {level} is {value}; it must not be negative or NaN")]
    Threshold {
        /// The level that it belongs to; the number of levels for that of nothing.
        level: usize,
        /// What was given.
        value: f64,
    },
    /// An option has no meaning.
    #[error("{name} {reason}")]
    InvalidOption {
        /// The option.
        name: &'static str,
        /// What it must be.
        reason: String,
    },
}

/// What thresholds are compared with. All are turned so that they grow as the object gets smaller on the screen.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Measure {
    /// World units per pixel.
    PixelSize,
    /// World units.
    Distance,
    /// One over the share of the image's height.
    InverseCoverage,
}

impl Measure {
    /// The value at which a threshold in the user's unit is passed.
    fn of_threshold(self, threshold: f64, max_pixels: f64) -> f64 {
        match self {
            Self::PixelSize => threshold / max_pixels,
            Self::Distance => threshold,
            Self::InverseCoverage => 1.0 / threshold,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Stage {
    /// `None`: nothing is shown.
    level: Option<usize>,
    from: f64,
}

impl Levels {
    /// Each level is shown from where its error is `max_pixels` on the screen; 1 is usual.
    ///
    /// `errors`: how far each level is from the original, in world units (model units with [`ScreenSize::scaled`]); that of
    /// the finest does not matter, as there is nothing finer to be shown. Where errors do not rise from one level to the
    /// next, as measured ones may, the finer of the two is never shown.
    ///
    /// # Errors
    /// No levels, an error that is negative or NaN, or `max_pixels` that is no positive number.
    pub fn by_error(errors: &[f64], max_pixels: f64) -> Result<Self, LevelsError> {
        if !(max_pixels > 0.0 && max_pixels.is_finite()) {
            return Err(invalid("max_pixels", "must be above 0 and finite"));
        }
        let Some((finest, coarser)) = errors.split_first() else { return Err(LevelsError::Empty) };
        check(0, *finest)?;
        Self { max_pixels, ..Self::finest_alone(Measure::PixelSize) }.with_coarser(coarser)
    }

    /// Each level but the finest is shown from a distance on, in world units: one distance fewer than there are levels.
    ///
    /// The field of view does not count; where it changes, use [`by_error`](Self::by_error) or
    /// [`by_coverage`](Self::by_coverage).
    ///
    /// # Errors
    /// A distance that is negative or NaN.
    pub fn by_distance(distances: &[f64]) -> Result<Self, LevelsError> {
        Self::finest_alone(Measure::Distance).with_coarser(distances)
    }

    /// Each level but the finest is shown where the bounding sphere takes this share of the image's height or less
    /// ([`View::coverage`](super::View::coverage)): falling, and one share fewer than there are levels.
    ///
    /// `MSFT_screencoverage` has one more, below which nothing is shown: give that to [`vanishing_at`](Self::vanishing_at).
    ///
    /// # Errors
    /// A share that is negative or NaN.
    pub fn by_coverage(coverages: &[f64]) -> Result<Self, LevelsError> {
        Self::finest_alone(Measure::InverseCoverage).with_coarser(coverages)
    }

    /// Beyond this threshold nothing is shown, in the unit of the others: an error (that of nothing: about the size of the
    /// object), a distance in world units, or a share of the image's height.
    ///
    /// On the way there the coarsest level is [vanishing](super::Shown::Vanishing).
    ///
    /// # Errors
    /// A threshold that is negative or NaN.
    pub fn vanishing_at(mut self, threshold: f64) -> Result<Self, LevelsError> {
        check(self.level_count(), threshold)?;
        // a second call moves the end
        self.stages.retain(|stage| stage.level.is_some());
        self.push(None, threshold);
        Ok(self)
    }

    /// How levels go over into each other; without this, as [`Transition::default`] tells.
    ///
    /// # Errors
    /// An option out of its range.
    pub fn with_transition(mut self, transition: Transition) -> Result<Self, LevelsError> {
        transition.check()?;
        self.transition = transition;
        Ok(self)
    }

    /// What it costs to morph each level towards a coarser one, for a [`MorphBudget`](super::MorphBudget), in any unit:
    /// mostly its number of vertices, as it is the finer level's that move. Without this, each morph costs 1.
    ///
    /// # Errors
    /// Not as many costs as levels.
    pub fn with_costs(mut self, costs: &[u64]) -> Result<Self, LevelsError> {
        let levels = self.level_count();
        if costs.len() != levels {
            return Err(invalid("costs", &format!("must be as many as levels: {levels}, not {}", costs.len())));
        }
        self.costs = costs.to_vec();
        Ok(self)
    }

    /// How many levels there are; nothing is none of them.
    pub fn level_count(&self) -> usize {
        self.costs.len()
    }

    /// The points where what is shown changes, from near to far.
    pub fn switches(&self) -> impl Iterator<Item = Switch> + '_ {
        self.stages.windows(2).enumerate().map(|(i, pair)| {
            let told = |value: f64| if self.measure == Measure::InverseCoverage { 1.0 / value } else { value };
            let finer = pair[0].level.expect("nothing is the last stage");
            Switch { finer, coarser: pair[1].level, zone: told(self.zone_before(i + 1)), at: told(pair[1].from) }
        })
    }

    fn finest_alone(measure: Measure) -> Self {
        Self {
            measure,
            max_pixels: 1.0,
            stages: vec![Stage { level: Some(0), from: 0.0 }],
            costs: vec![1],
            transition: Transition::default(),
        }
    }

    fn with_coarser(mut self, thresholds: &[f64]) -> Result<Self, LevelsError> {
        for &threshold in thresholds {
            let level = self.level_count();
            check(level, threshold)?;
            self.push(Some(level), threshold);
            self.costs.push(1);
        }
        Ok(self)
    }

    /// Adds a stage beyond all others; those that begin no sooner are never shown.
    fn push(&mut self, level: Option<usize>, threshold: f64) {
        // `abs`: one over a coverage of minus zero
        let from = self.measure.of_threshold(threshold, self.max_pixels).abs();
        if from == f64::INFINITY {
            return;
        }
        while self.stages.last().is_some_and(|last| last.from >= from) {
            self.stages.pop();
        }
        self.stages.push(Stage { level, from });
    }
}

/// Stages in order have positions: 0 for the first one, i + t for what is t on the way from stage i to the next.
impl Levels {
    /// The position of the last stage.
    pub(super) fn last(&self) -> f64 {
        (self.stages.len() - 1) as f64
    }

    /// The level at a stage; `None` for nothing.
    pub(super) fn level_at(&self, stage: usize) -> Option<usize> {
        self.stages[stage].level
    }

    /// What it costs to show something between a stage and the next.
    pub(super) fn cost_after(&self, stage: usize) -> u64 {
        self.stages[stage].level.map_or(0, |level| self.costs[level])
    }

    /// The error in pixels of the stage after this one at a measure; where no errors are known, as though each switch stood
    /// where the error is a pixel.
    pub(super) fn pixels_after(&self, stage: usize, measure: f64) -> f64 {
        self.max_pixels * (self.stages[stage + 1].from / measure)
    }

    /// What the thresholds are compared with: 0 at the eye, infinity for what has no size; NaN where nothing can be said.
    pub(super) fn measure(&self, size: &ScreenSize) -> f64 {
        let inverse = |x: f64| if x <= 0.0 { f64::INFINITY } else { 1.0 / x };
        match self.measure {
            Measure::PixelSize => inverse(size.pixels_per_unit),
            Measure::Distance if size.distance <= 0.0 => 0.0,
            Measure::Distance => size.distance,
            Measure::InverseCoverage => inverse(size.coverage),
        }
    }

    /// The position wanted at a measure: continuous and rising where zones have a width.
    pub(super) fn position(&self, measure: f64) -> f64 {
        let next = self.stages.partition_point(|stage| stage.from <= measure).max(1);
        let stage = (next - 1) as f64;
        let Some(coarser) = self.stages.get(next) else { return stage };
        let zone = self.zone_before(next);
        // even in the measure, not in its logarithm: allowed errors grow with it, so a mixture of two allowed ones is allowed
        if measure > zone { stage + (measure - zone) / (coarser.from - zone) } else { stage }
    }

    /// Where the zone before a stage begins: no sooner than the stage before it.
    fn zone_before(&self, stage: usize) -> f64 {
        let [finer, coarser] = [stage - 1, stage].map(|i| self.stages[i].from);
        (coarser * (1.0 - self.transition.zone)).max(finer)
    }
}

fn check(level: usize, value: f64) -> Result<(), LevelsError> {
    if value.is_nan() || value < 0.0 { Err(LevelsError::Threshold { level, value }) } else { Ok(()) }
}

fn invalid(name: &'static str, reason: &str) -> LevelsError {
    LevelsError::InvalidOption { name, reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::{at_distance, hostile};
    use super::super::view::View;
    use super::*;

    fn wanted(levels: &Levels, size: &ScreenSize) -> Option<usize> {
        levels.level_at(levels.position(levels.measure(size)) as usize)
    }

    fn cut(levels: Result<Levels, LevelsError>) -> Levels {
        levels.and_then(|levels| levels.with_transition(Transition::cut(0.0))).unwrap()
    }

    #[test]
    fn levels_by_error_switch_where_the_error_is_allowed() {
        let (view, levels) = (View::new(0.8, 1440.0), cut(Levels::by_error(&[0.0, 0.01, 0.03], 2.0)));
        for (level, error) in [(1, 0.01), (2, 0.03)] {
            let distance = 1440.0 * error / (2.0 * 2.0 * 0.4_f64.tan());
            assert!((view.pixels(error, distance) - 2.0).abs() < 1e-9);
            let seen = |factor: f64| wanted(&levels, &view.screen_size([0.0; 3], [0.0, distance * factor, 0.0], 0.0));
            assert_eq!((seen(0.999), seen(1.001)), (Some(level - 1), Some(level)));
        }
    }

    #[test]
    fn levels_by_coverage_are_those_of_msft_lod() {
        // the example of the extension
        let levels = cut(Levels::by_coverage(&[0.5, 0.2]).and_then(|levels| levels.vanishing_at(0.01)));
        for (coverage, level) in [
            (1.0, Some(0)),
            (0.51, Some(0)),
            (0.49, Some(1)),
            (0.21, Some(1)),
            (0.19, Some(2)),
            (0.011, Some(2)),
            (0.009, None),
        ] {
            assert_eq!(wanted(&levels, &ScreenSize { coverage, ..at_distance(1.0) }), level, "{coverage}");
        }
        assert_eq!(levels.switches().map(|switch| switch.coarser).collect::<Vec<_>>(), [Some(1), Some(2), None]);
    }

    #[test]
    fn a_level_no_better_than_a_coarser_one_is_never_shown() {
        let levels = Levels::by_error(&[0.0, 0.2, 0.1, 0.1, 0.5, f64::INFINITY], 1.0).unwrap();
        let pairs: Vec<_> = levels.switches().map(|switch| (switch.finer, switch.coarser)).collect();
        assert_eq!(pairs, [(0, Some(3)), (3, Some(4))]);
        // flat parts lose nothing: the finest level is as good as the next
        let flat = Levels::by_error(&[0.0, 0.0, 1.0], 1.0).unwrap();
        assert_eq!(wanted(&flat, &at_distance(0.0)), Some(1));
        assert_eq!(flat.level_count(), 3);
    }

    #[test]
    fn the_end_can_be_moved() {
        let levels = Levels::by_distance(&[10.0]).unwrap().vanishing_at(20.0).unwrap().vanishing_at(30.0).unwrap();
        let ends: Vec<_> = levels.switches().map(|switch| (switch.coarser, switch.at)).collect();
        assert_eq!(ends, [(Some(1), 10.0), (None, 30.0)]);
    }

    #[test]
    fn zones_are_told_in_the_unit_of_the_thresholds() {
        let transition = Transition { zone: 0.5, ..Transition::by_distance() };
        let zones = |levels: Levels| {
            levels.with_transition(transition).unwrap().switches().map(|s| (s.zone, s.at)).collect::<Vec<_>>()
        };
        // the second zone begins no sooner than the first switch
        assert_eq!(zones(Levels::by_distance(&[10.0, 16.0]).unwrap()), [(5.0, 10.0), (10.0, 16.0)]);
        assert_eq!(zones(Levels::by_coverage(&[0.5, 0.125]).unwrap()), [(1.0, 0.5), (0.25, 0.125)]);
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        assert_eq!(Levels::by_error(&[], 1.0), Err(LevelsError::Empty));
        assert!(matches!(Levels::by_error(&[0.0, -1.0], 1.0), Err(LevelsError::Threshold { level: 1, .. })));
        assert!(matches!(Levels::by_distance(&[1.0, f64::NAN]), Err(LevelsError::Threshold { level: 2, .. })));
        let levels = || Levels::by_distance(&[1.0]).unwrap();
        assert!(matches!(levels().vanishing_at(-1.0), Err(LevelsError::Threshold { level: 2, .. })));
        for max_pixels in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Levels::by_error(&[0.0], max_pixels).is_err());
        }
        assert!(levels().with_costs(&[1]).is_err());
        let timed = Transition::timed(1.0);
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            for (name, transition) in [
                ("zone", Transition { zone: bad, ..timed }),
                ("duration", Transition { duration: bad, ..timed }),
                ("hysteresis", Transition { hysteresis: bad, ..timed }),
                ("catch_up", Transition { catch_up: bad, ..timed }),
            ] {
                let error = levels().with_transition(transition).unwrap_err();
                assert!(matches!(error, LevelsError::InvalidOption { name: found, .. } if found == name));
            }
        }
    }

    proptest! {
        #[test]
        fn the_coarsest_level_allowed_is_wanted(
            errors in prop::collection::vec(0.0_f64..1.0, 1..8),
            distance in 0.0_f64..2000.0,
        ) {
            let (levels, size) = (cut(Levels::by_error(&errors, 1.0)), at_distance(distance));
            let pixel = 1.0 / size.pixels_per_unit;
            let coarsest = (1..errors.len()).rev().find(|&i| errors[i] <= pixel).unwrap_or(0);
            prop_assert_eq!(wanted(&levels, &size), Some(coarsest));
        }

        #[test]
        fn errors_mixed_in_a_zone_are_allowed(
            steps in prop::collection::vec(0.001_f64..1.0, 1..6),
            zone in 0.0_f64..=1.0,
            pixel in 0.0_f64..6.0,
        ) {
            let errors: Vec<f64> = std::iter::once(0.0)
                .chain(steps.iter().scan(0.0, |sum, step| { *sum += step; Some(*sum) }))
                .collect();
            let transition = Transition { zone, ..Transition::by_distance() };
            let levels = Levels::by_error(&errors, 1.0).unwrap().with_transition(transition).unwrap();
            let position = levels.position(pixel);
            let (i, t) = (position as usize, position.fract());
            let error = if t == 0.0 { errors[i] } else { errors[i] * (1.0 - t) + errors[i + 1] * t };
            prop_assert!(error <= pixel * (1.0 + 1e-12), "{error} {pixel}");
        }

        #[test]
        fn position_rises_without_leaps_and_only_in_zones(
            mut thresholds in prop::collection::vec(0.0_f64..100.0, 0..6),
            zone in 0.01_f64..=1.0,
            ends in any::<bool>(),
            measure in 0.0_f64..120.0,
            further in 0.0_f64..1.0,
        ) {
            thresholds.sort_by(f64::total_cmp);
            let mut levels = Levels::by_distance(&thresholds).unwrap();
            if ends {
                levels = levels.vanishing_at(110.0).unwrap();
            }
            let levels = levels.with_transition(Transition { zone, ..Transition::by_distance() }).unwrap();
            let (near, far) = (levels.position(measure), levels.position(measure + further));
            prop_assert!(near <= far);
            // the steepest zone tells how far it may go
            let slope = levels.switches().map(|switch| 1.0 / (switch.at - switch.zone)).fold(0.0, f64::max);
            prop_assert!(far - near <= slope * further + 1e-9);
            let is_in_zone = levels.switches().any(|switch| switch.zone < measure && measure < switch.at);
            prop_assert_eq!(near.fract() != 0.0, is_in_zone);
        }

        #[test]
        fn any_thresholds_and_sizes_give_a_level_or_an_error(
            thresholds in prop::collection::vec(hostile(), 0..6),
            [distance, pixels_per_unit, coverage, max_pixels, zone] in prop::array::uniform5(hostile()),
        ) {
            let size = ScreenSize { distance, pixels_per_unit, coverage };
            for made in
                [Levels::by_error(&thresholds, max_pixels), Levels::by_distance(&thresholds), Levels::by_coverage(&thresholds)]
            {
                let transition = Transition { zone: zone.clamp(0.0, 1.0), ..Transition::by_distance() };
                let Ok(levels) = made.and_then(|levels| levels.with_transition(transition)) else { continue };
                let measure = levels.measure(&size);
                prop_assert!(measure.is_nan() || (0.0..=levels.last()).contains(&levels.position(measure)));
            }
        }
    }
}
