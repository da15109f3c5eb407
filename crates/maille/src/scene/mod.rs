//! Which level of detail an object shows, and how far it has morphed to the next one.
//!
//! No meshes and no GPU: numbers in, a choice out. A [`View`] tells how large an object is on the screen, [`Levels`] where
//! each level of a chain may be shown, a [`LevelState`] (one to each object) how one level goes over into the next, and a
//! [`MorphBudget`] which of many objects may morph at once (seed 000, 6.2.3). What is to be drawn comes back as [`Shown`].
//!
//! # Examples
//! ```
//! use maille::scene::{LevelState, Levels, Shown, Transition, View};
//! // four levels with their distances from the original in world units; each is shown where that is a pixel at most
//! let levels = Levels::by_error(&[0.0, 0.002, 0.01, 0.05], 1.0)?.with_transition(Transition::timed(0.5))?;
//! let view = View::new(60_f64.to_radians(), 1080.0);
//!
//! let mut state = LevelState::default();
//! let mut frame = |z: f64| state.update(&levels, &view.screen_size([0.0, 0.0, z], [0.0; 3], 1.0), 0.125);
//! assert_eq!(frame(5.0), Shown::Level(1));
//! // 0.01 is less than a pixel from here on: half a second later level 2 stands alone
//! assert_eq!(frame(20.0), Shown::Morph { finer: 1, coarser: 2, t: 0.25 });
//! assert_eq!(frame(20.0), Shown::Morph { finer: 1, coarser: 2, t: 0.5 });
//! // back, before it has arrived: it turns round where it is
//! assert_eq!(frame(5.0), Shown::Morph { finer: 1, coarser: 2, t: 0.25 });
//! assert_eq!(frame(5.0), Shown::Level(1));
//! # Ok::<(), maille::scene::LevelsError>(())
//! ```

mod budget;
mod levels;
mod transition;
mod view;

pub use budget::{LodObject, MorphBudget};
pub use levels::{Levels, LevelsError, Switch};
pub use transition::{LevelState, Shown, Transition};
pub use view::{ScreenSize, View};

#[cfg(test)]
mod testing;
