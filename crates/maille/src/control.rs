//! Progress and cancellation of long work.

use std::sync::atomic::{AtomicBool, Ordering};

/// Called with the name of a stage and the share of it that is done, 0 to 1.
pub type Progress<'a> = &'a (dyn Fn(&str, f32) + Sync);

/// How a caller watches and stops a long computation.
///
/// Algorithms call [`report`](Self::report) at least a few times a second, from one thread at a time per stage, and
/// stop early when [`is_cancelled`](Self::is_cancelled) turns true. [`Control::default`] watches nothing.
///
/// ```
/// use std::sync::atomic::AtomicBool;
/// let stop = AtomicBool::new(false);
/// let print = |stage: &str, done: f32| assert!(!stage.is_empty() && done <= 1.0);
/// let control = maille::Control::new(Some(&print), Some(&stop));
/// control.report("collapsing edges", 0.5);
/// assert!(!control.is_cancelled());
/// ```
#[derive(Clone, Copy, Default)]
pub struct Control<'a> {
    progress: Option<Progress<'a>>,
    cancel: Option<&'a AtomicBool>,
}

impl<'a> Control<'a> {
    /// A control that calls `progress` with the name of the stage and the share done (0 to 1), and stops once `cancel`
    /// is set.
    pub fn new(progress: Option<Progress<'a>>, cancel: Option<&'a AtomicBool>) -> Self {
        Self { progress, cancel }
    }

    /// The same way to stop, but progress goes to `progress`.
    #[must_use]
    pub fn with_progress<'b>(&self, progress: Progress<'b>) -> Control<'b>
    where
        'a: 'b,
    {
        Control { progress: Some(progress), cancel: self.cancel }
    }

    /// Tells that a share (0 to 1) of a stage is done.
    pub fn report(&self, stage: &str, done: f32) {
        if let Some(progress) = self.progress {
            progress(stage, done);
        }
    }

    /// Whether the caller wants the work to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }
}

/// The work was stopped by [`Control`]; nothing of its result is usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;
