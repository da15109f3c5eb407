//! Which of many objects may morph at once.

use super::levels::Levels;
use super::transition::{LevelState, Permit, Shown, Wish};
use super::view::ScreenSize;

/// How much may be morphed in one frame, over all objects.
///
/// - A morph on its way goes on, whatever it costs, until it arrives at one of its two levels. So nothing jumps.
/// - What is left of the budget goes to those that want to begin, by how much of the change can be seen (the error in pixels
///   of the coarser level), and in the order of the objects where that is equal. One that does not fit is passed over.
/// - The others wait. Who wants a coarser level shows the finer one as long; who wants a finer one is cut to it after
///   `max_wait`.
/// - A morph that costs more than the whole budget would wait for ever: it is a cut at once. With a budget of 0 nothing morphs.
///
/// Each level on the way is a morph of its own. An object in a zone that was not allowed to morph comes in later, from the
/// level that it shows to where its distance wants it; [`Transition::duration`](super::Transition::duration) above 0 makes
/// that no jump.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MorphBudget {
    /// Most that all morphs may cost together, in the unit of [`Levels::with_costs`].
    pub cost: u64,
    /// Seconds after which an object that waits for a finer level is cut to it; infinite for never.
    pub max_wait: f64,
}

/// An object that is to be drawn.
#[derive(Debug)]
pub struct LodObject<'a> {
    /// What it shows; goes on.
    pub state: &'a mut LevelState,
    /// Its levels.
    pub levels: &'a Levels,
    /// How large it is on the screen.
    pub size: ScreenSize,
}

impl Default for MorphBudget {
    /// No limit.
    fn default() -> Self {
        Self { cost: u64::MAX, max_wait: 0.5 }
    }
}

impl MorphBudget {
    /// Goes on by `dt` seconds, as [`LevelState::update`] does with each object alone, and tells what to draw, in the order
    /// of the objects.
    ///
    /// All morphs together cost at most the budget, unless those alone do that were on their way before.
    ///
    /// Cost: O(n log n) for the objects that want to begin, O(n) for the others.
    ///
    /// # Examples
    /// ```
    /// use maille::scene::{LevelState, Levels, LodObject, MorphBudget, Shown, Transition, View};
    /// let (view, budget) = (View::new(1.0, 1080.0), MorphBudget { cost: 5000, max_wait: 0.5 });
    /// let levels = Levels::by_error(&[0.0, 0.01], 1.0)?.with_costs(&[4000, 1000])?;
    /// let mut states = [LevelState::default(); 2];
    /// let mut frame = |distance: f64| {
    ///     let place = |i| [0.0, 0.0, distance + i as f64];
    ///     let mut objects: Vec<_> = states
    ///         .iter_mut()
    ///         .enumerate()
    ///         .map(|(i, state)| LodObject { state, levels: &levels, size: view.screen_size([0.0; 3], place(i), 1.0) })
    ///         .collect();
    ///     budget.update(&mut objects, 0.25)
    /// };
    /// assert_eq!(frame(5.0), [Shown::Level(0), Shown::Level(0)]);
    /// // both want a coarser level: in the nearer one the change is larger, the other one waits
    /// assert_eq!(frame(20.0), [Shown::Morph { finer: 0, coarser: 1, t: 0.5 }, Shown::Level(0)]);
    /// assert_eq!(frame(20.0), [Shown::Level(1), Shown::Morph { finer: 0, coarser: 1, t: 0.5 }]);
    /// # Ok::<(), maille::scene::LevelsError>(())
    /// ```
    pub fn update(&self, objects: &mut [LodObject<'_>], dt: f64) -> Vec<Shown> {
        let steps: Vec<_> = objects.iter().map(|object| object.state.plan(object.levels, &object.size, dt)).collect();
        let wishes: Vec<_> =
            objects.iter().zip(&steps).map(|(object, step)| object.state.wish(object.levels, step)).collect();
        let permits = self.permits(&wishes);
        let each = objects.iter_mut().zip(&steps).zip(permits);
        each.map(|((object, step), permit)| object.state.take(object.levels, step, permit, dt)).collect()
    }

    fn permits(&self, wishes: &[Option<Wish>]) -> Vec<Permit> {
        let mut permits = vec![Permit::Morph; wishes.len()];
        let mut left = self.cost;
        let mut new = Vec::new();
        for (index, wish) in wishes.iter().enumerate() {
            match wish {
                Some(wish) if wish.is_running => left = left.saturating_sub(wish.cost),
                Some(wish) => new.push((index, wish)),
                None => {}
            }
        }
        new.sort_unstable_by(|(i, a), (j, b)| b.pixels.total_cmp(&a.pixels).then(i.cmp(j)));
        for (index, wish) in new {
            if wish.cost <= left {
                left -= wish.cost;
                continue;
            }
            let is_due = wish.waited.is_some_and(|waited| f64::from(waited) >= self.max_wait);
            permits[index] = if is_due || wish.cost > self.cost { Permit::Cut } else { Permit::Wait };
        }
        permits
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::at_distance;
    use super::super::transition::Transition;
    use super::*;

    const COSTS: [u64; 4] = [8, 4, 2, 1];

    fn levels(transition: Transition) -> Levels {
        let levels = Levels::by_distance(&[10.0, 20.0, 40.0]).unwrap();
        levels.with_transition(transition).unwrap().with_costs(&COSTS).unwrap()
    }

    fn timed() -> Levels {
        levels(Transition { hysteresis: 0.0, ..Transition::timed(1.0) })
    }

    fn frame(
        budget: MorphBudget,
        levels: &Levels,
        states: &mut [LevelState],
        distances: &[f64],
        dt: f64,
    ) -> Vec<Shown> {
        let mut objects: Vec<_> = states
            .iter_mut()
            .zip(distances)
            .map(|(state, &distance)| LodObject { state, levels, size: at_distance(distance) })
            .collect();
        budget.update(&mut objects, dt)
    }

    /// The level that is morphed.
    fn morphed(shown: Shown) -> Option<usize> {
        match shown {
            Shown::Morph { finer: level, .. } | Shown::Vanishing { level, .. } => Some(level),
            Shown::Level(_) | Shown::Nothing => None,
        }
    }

    #[test]
    fn larger_changes_come_first() {
        let (levels, mut states) = (timed(), [LevelState::default(); 3]);
        let budget = MorphBudget { cost: 6, max_wait: f64::INFINITY };
        frame(budget, &levels, &mut states, &[15.0, 15.0, 35.0], 0.0);
        // the errors are 20 / 25, 20 / 21 and 40 / 45 pixels, the costs 4, 4 and 2
        let shown = frame(budget, &levels, &mut states, &[25.0, 21.0, 45.0], 0.5);
        assert_eq!(shown.into_iter().map(morphed).collect::<Vec<_>>(), [None, Some(1), Some(2)]);
    }

    #[test]
    fn what_does_not_fit_is_passed_over() {
        let (levels, mut states) = (timed(), [LevelState::default(); 3]);
        let budget = MorphBudget { cost: 9, max_wait: f64::INFINITY };
        frame(budget, &levels, &mut states, &[15.0, 5.0, 35.0], 0.0);
        // 20 / 21, 10 / 10.6 and 40 / 45 pixels; 4, 8 and 2
        let shown = frame(budget, &levels, &mut states, &[21.0, 10.6, 45.0], 0.5);
        assert_eq!(shown.into_iter().map(morphed).collect::<Vec<_>>(), [Some(1), None, Some(2)]);
    }

    #[test]
    fn who_waits_for_a_finer_level_is_cut_to_it() {
        let (levels, mut states) = (timed(), [LevelState::default(); 2]);
        let budget = MorphBudget { cost: 4, max_wait: 0.5 };
        frame(budget, &levels, &mut states, &[25.0, 25.0], 0.0);
        let mut shown = |distance| frame(budget, &levels, &mut states, &[15.0, distance], 0.25)[1];
        for _ in 0..2 {
            assert_eq!(shown(15.0), Shown::Level(2));
        }
        assert_eq!(shown(15.0), Shown::Level(1));
    }

    #[test]
    fn who_waits_for_a_coarser_level_stays_fine() {
        let (levels, mut states) = (timed(), [LevelState::default(); 2]);
        let budget = MorphBudget { cost: 4, max_wait: 0.0 };
        frame(budget, &levels, &mut states, &[15.0, 15.0], 0.0);
        for _ in 0..3 {
            assert_eq!(frame(budget, &levels, &mut states, &[25.0, 25.0], 0.25)[1], Shown::Level(1));
        }
        frame(budget, &levels, &mut states, &[25.0, 25.0], 0.25);
        assert_eq!(
            frame(budget, &levels, &mut states, &[25.0, 25.0], 0.25)[1],
            Shown::Morph { finer: 1, coarser: 2, t: 0.5 }
        );
    }

    #[test]
    fn what_costs_more_than_the_budget_is_cut() {
        let (levels, mut states) = (timed(), [LevelState::default()]);
        let budget = MorphBudget { cost: 3, max_wait: f64::INFINITY };
        frame(budget, &levels, &mut states, &[5.0], 0.0);
        assert_eq!(frame(budget, &levels, &mut states, &[15.0], 0.1), [Shown::Level(1)]);
        assert_eq!(frame(budget, &levels, &mut states, &[5.0], 0.1), [Shown::Level(0)]);
        // from level 2 on the costs are within it
        frame(budget, &levels, &mut states, &[25.0], 0.1);
        assert_eq!(frame(budget, &levels, &mut states, &[45.0], 0.5), [Shown::Morph { finer: 2, coarser: 3, t: 0.5 }]);
    }

    #[test]
    fn a_morph_on_its_way_ends_at_its_own_level() {
        let (levels, mut states) = (timed(), [LevelState::default()]);
        frame(MorphBudget::default(), &levels, &mut states, &[25.0], 0.0);
        frame(MorphBudget::default(), &levels, &mut states, &[5.0], 0.3);
        assert_eq!(morphed(states[0].shown(&levels)), Some(1));
        // no budget any more: on to level 1, and from there it is a cut
        let none = MorphBudget { cost: 0, max_wait: 0.0 };
        assert_eq!(morphed(frame(none, &levels, &mut states, &[5.0], 0.1)[0]), Some(1));
        assert_eq!(frame(none, &levels, &mut states, &[5.0], 0.5), [Shown::Level(1)]);
        assert_eq!(frame(none, &levels, &mut states, &[5.0], 0.1), [Shown::Level(0)]);
    }

    /// For some objects, their distances over some frames.
    fn walks() -> impl Strategy<Value = Vec<Vec<f64>>> {
        (1..8_usize).prop_flat_map(|objects| {
            prop::collection::vec(prop::collection::vec(prop_oneof![0.0_f64..60.0, 17.0_f64..23.0], objects), 1..30)
        })
    }

    fn cost_of(shown: &[Shown]) -> u64 {
        shown.iter().filter_map(|&shown| morphed(shown)).map(|level| COSTS[level]).sum()
    }

    proptest! {
        #[test]
        fn the_budget_holds_but_for_what_was_on_its_way(
            walks in walks(),
            costs in prop::collection::vec(0_u64..20, 30),
            zone in prop_oneof![Just(0.0), 0.0_f64..1.0],
            max_wait in 0.0_f64..2.0,
        ) {
            let levels = levels(Transition { zone, ..Transition::timed(1.0) });
            let mut states = vec![LevelState::default(); walks[0].len()];
            let mut before = vec![Shown::Nothing; states.len()];
            for (distances, cost) in walks.iter().zip(costs) {
                let shown = frame(MorphBudget { cost, max_wait }, &levels, &mut states, distances, 0.2);
                let running: Vec<_> =
                    before.iter().zip(&shown).filter(|(a, b)| morphed(**a) == morphed(**b)).map(|(_, b)| *b).collect();
                prop_assert!(cost_of(&shown) <= cost.max(cost_of(&running)));
                before = shown;
            }
        }

        #[test]
        fn waiting_makes_no_jumps(walks in walks(), cost in 8_u64..20, zone in prop_oneof![Just(0.0), 0.0_f64..1.0]) {
            let levels = levels(Transition { zone, catch_up: 1.0, ..Transition::timed(1.0) });
            let budget = MorphBudget { cost, max_wait: f64::INFINITY };
            let mut states = vec![LevelState::default(); walks[0].len()];
            frame(budget, &levels, &mut states, &walks[0], 0.0);
            for distances in &walks {
                let height = |state: &LevelState| match state.shown(&levels) {
                    Shown::Morph { finer, t, .. } => finer as f32 + t,
                    Shown::Level(level) => level as f32,
                    Shown::Vanishing { .. } | Shown::Nothing => unreachable!("the last level stays"),
                };
                let before: Vec<f32> = states.iter().map(height).collect();
                frame(budget, &levels, &mut states, distances, 0.2);
                for (before, state) in before.iter().zip(&states) {
                    prop_assert!((height(state) - before).abs() <= 0.2 + 1e-5);
                }
            }
        }

        #[test]
        fn the_order_of_objects_does_not_matter(
            walks in walks(),
            cost in 0_u64..20,
            max_wait in 0.0_f64..2.0,
            shift in 0_usize..8,
        ) {
            // equal priorities go by index: made different
            let apart = |walk: &[f64]| walk.iter().enumerate().map(|(i, d)| d + i as f64 * 1e-6).collect::<Vec<f64>>();
            let (levels, budget) = (timed(), MorphBudget { cost, max_wait });
            let mut states = vec![LevelState::default(); walks[0].len()];
            let mut shifted = states.clone();
            let shift = shift % states.len();
            for distances in &walks {
                let mut distances = apart(distances);
                let mut shown = frame(budget, &levels, &mut states, &distances, 0.2);
                distances.rotate_left(shift);
                let other = frame(budget, &levels, &mut shifted, &distances, 0.2);
                shown.rotate_left(shift);
                prop_assert_eq!(shown, other);
            }
        }

        #[test]
        fn without_a_limit_each_object_is_on_its_own(walks in walks()) {
            let levels = timed();
            let mut states = vec![LevelState::default(); walks[0].len()];
            let mut alone = states.clone();
            for distances in &walks {
                let shown = frame(MorphBudget::default(), &levels, &mut states, distances, 0.2);
                for (i, (state, &distance)) in alone.iter_mut().zip(distances).enumerate() {
                    prop_assert_eq!(shown[i], state.update(&levels, &at_distance(distance), 0.2));
                }
            }
        }
    }
}
